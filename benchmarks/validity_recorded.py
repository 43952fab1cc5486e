"""Validity of a model on recorded flights of two Crazyflies with damaged propellers or a weight (CrazyPAD).

    python -m benchmarks.validity_recorded --write docs/validity.md

Fits the undamaged flights together and asks of every folder whether that model still holds: of `controller_data` by the throttle, of
`motor_data`, where the motors' commands were recorded, by vehicle and by the load of each motor. The recordings lie in
`propeller_damage` of $FLIGHTTEST_DATA, or of ../shared/data beside the checkout. It takes two minutes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.page import write_block
from flighttest.pipeline.identification import fitting as analysis
from flighttest.pipeline.validity.status import status

REPOSITORY = Path(__file__).resolve().parents[1]
UNDAMAGED = "normal_flight"


def folder_of_recordings(name: str) -> Path:
    """Where the recordings are; SystemExit with a sentence where they are not. name: of the folder with what was recorded."""
    data = Path(os.environ.get("FLIGHTTEST_DATA") or REPOSITORY.parent / "shared" / "data")
    folder = data / "propeller_damage" / name
    if not (folder / UNDAMAGED).is_dir():
        raise SystemExit(f"{folder} is not here: set FLIGHTTEST_DATA to the folder of recordings")
    return folder


def row(name: str, flights: int, data: dict[str, Any]) -> str:
    """One line of the table: how the throttle that holds height moved, its chance, and the answer of `status`."""
    test = next((t for t in data["tests"] if "hover_throttle" in t["shifts"]), None)
    if test is None:
        return f"| {name} | {flights} | - | - | - | {data['verdict'].lower()} |"
    moved, detectable = test["shifts"]["hover_throttle"][0], test["detectable"]["hover_throttle"]
    return (
        f"| {name} | {flights} | {moved:+.1%} | {test['p_value']:.2g} | {detectable:.1%} | {data['verdict'].lower()} |"
    )


def measured() -> str:
    """The table."""
    folder = folder_of_recordings("controller_data")
    lines = [
        "| flights | number | throttle that holds height | chance without a change | shows from | answer |",
        "|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as scratch:
        model = Path(scratch) / "model.yaml"
        analysis.fit(sorted((folder / UNDAMAGED).iterdir()), model)
        for one in sorted(p for p in folder.iterdir() if p.is_dir()):
            runs = tuple(sorted(one.iterdir()))
            found = status(runs, None, model, Path(scratch) / "runs", None)
            lines.append(row(one.name, len(runs), dict(found.data)))
            print(lines[-1], file=sys.stderr)
    return "\n".join(lines) + "\n"


def motors_measured() -> str:
    """The table by the load of the motors."""
    folder = folder_of_recordings("motor_data")
    lines = [
        "| vehicle | flights | number | largest change of a motor's command | chance without a change | shows from | answer |",
        "|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as scratch:
        for vehicle in sorted({p.name.split("_")[0] for p in (folder / UNDAMAGED).iterdir()}):
            model = Path(scratch) / f"{vehicle}.yaml"
            analysis.fit(sorted((folder / UNDAMAGED).glob(f"{vehicle}_*")), model)
            for one in sorted(p for p in folder.iterdir() if p.is_dir()):
                runs = tuple(sorted(one.glob(f"{vehicle}_*")))
                if not runs:
                    continue
                data = dict(status(runs, None, model, Path(scratch) / "runs", None).data)
                test = next(t for t in data["tests"] if t["subset"] == "motors")
                name = max(test["shifts"], key=lambda n: abs(test["shifts"][n][1]))
                changed = " and ".join(t["subset"] for t in data["tests"] if t["alarm"])
                answer = f"{data['verdict'].lower()}{f' ({changed})' if changed else ''}"
                lines.append(
                    f"| {vehicle} | {one.name} | {len(runs)} | {name.replace('_', ' ')} {test['shifts'][name][0]:+.1%} "
                    f"| {test['p_value']:.2g} | {test['detectable'][name]:.1%} | {answer} |"
                )
                print(lines[-1], file=sys.stderr)
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and print or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, help="page whose measured block is replaced")
    asked = parser.parse_args()
    for benchmark, measure in (
        ("benchmarks/validity_recorded.py", measured),
        ("benchmarks/validity_recorded.py, motors", motors_measured),
    ):
        table = measure()
        if asked.write is None:
            print(table, end="")
        else:
            write_block(asked.write, benchmark, table)


if __name__ == "__main__":
    main()
