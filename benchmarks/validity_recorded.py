"""Validity of a model on recorded flights of a Crazyflie with damaged propellers or a weight (CrazyPAD, `controller_data`).

    python -m benchmarks.validity_recorded --write docs/validity.md

Fits the undamaged flights together and asks of every folder whether that model still holds. The recordings lie in
`propeller_damage/controller_data` of $FLIGHTTEST_DATA, or of ../shared/data beside the checkout. It takes a minute.
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


def folder_of_recordings() -> Path:
    """Where the recordings are; SystemExit with a sentence where they are not."""
    data = Path(os.environ.get("FLIGHTTEST_DATA") or REPOSITORY.parent / "shared" / "data")
    folder = data / "propeller_damage" / "controller_data"
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
    folder = folder_of_recordings()
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


def main() -> None:
    """Measure, and print or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, help="page whose measured block is replaced")
    asked = parser.parse_args()
    table = measured()
    if asked.write is None:
        print(table, end="")
        return
    write_block(asked.write, "benchmarks/validity_recorded.py", table)


if __name__ == "__main__":
    main()
