"""Validity of a model on recorded flights of two Crazyflies with damaged propellers or a weight (CrazyPAD).

    python -m benchmarks.validity_recorded --write docs/validity.md

Fits the undamaged flights of each vehicle together and asks of every folder whether that model still holds: by the throttle that holds
height and by the load of each motor, which `motor_data` recorded and the commands of `controller_data` mix to. The recordings lie in
`propeller_damage` of $FLIGHTTEST_DATA, or of ../shared/data beside the checkout. It takes two minutes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.page import write_block
from flighttest.pipeline.identification import fitting as analysis
from flighttest.pipeline.validity.status import status

REPOSITORY = Path(__file__).resolve().parents[1]
UNDAMAGED = "normal_flight"
MOTORS_HEAD = "| vehicle | flights | number | largest change of a motor's command | chance without a change | shows from | answer |"


def folder_of_recordings(name: str) -> Path:
    """Where the recordings are; SystemExit with a sentence where they are not. name: of the folder with what was recorded."""
    data = Path(os.environ.get("FLIGHTTEST_DATA") or REPOSITORY.parent / "shared" / "data")
    folder = data / "propeller_damage" / name
    if not (folder / UNDAMAGED).is_dir():
        raise SystemExit(f"{folder} is not here: set FLIGHTTEST_DATA to the folder of recordings")
    return folder


def cells(test: Mapping[str, Any], name: str) -> str:
    """How a quantity moved, the chance of it without a change, and from what change on it shows."""
    return f"{test['shifts'][name][0]:+.1%} | {test['p_value']:.2g} | {test['detectable'][name]:.1%}"


def row(vehicle: str, name: str, flights: int, data: Mapping[str, Any]) -> str:
    """One line of the table by the throttle that holds height, with the answer of `status`."""
    test = next((t for t in data["tests"] if "hover_throttle" in t["shifts"]), None)
    found = "- | - | -" if test is None else cells(test, "hover_throttle")
    return f"| {vehicle} | {name} | {flights} | {found} | {answer(data)} |"


def motors_row(vehicle: str, name: str, flights: int, data: Mapping[str, Any]) -> str:
    """One line of the table by the motor whose share of the load changed most."""
    test = next(t for t in data["tests"] if t["subset"] == "motors")
    motor = max(test["shifts"], key=lambda n: abs(test["shifts"][n][1]))
    return f"| {vehicle} | {name} | {flights} | {motor.replace('_', ' ')} {cells(test, motor)} | {answer(data)} |"


def answer(data: Mapping[str, Any]) -> str:
    """The verdict, and what it is by."""
    changed = [t["subset"] for t in data["tests"] if t["alarm"]] + [a["term"] or "no name" for a in data["appeared"]]
    by = f" ({', '.join(changed)})" if changed else ""
    return f"{data['verdict'].lower()}{by}"


def judged(folder: Path, pattern: str) -> Iterator[tuple[str, int, Mapping[str, Any]]]:
    """(name, number of flights, answer of `status`) of each folder, by the model of the undamaged flights of a file name pattern."""
    with tempfile.TemporaryDirectory() as scratch:
        model = Path(scratch) / "model.yaml"
        analysis.fit(sorted((folder / UNDAMAGED).glob(pattern)), model)
        for one in sorted(p for p in folder.iterdir() if p.is_dir()):
            if runs := tuple(sorted(one.glob(pattern))):
                yield one.name, len(runs), dict(status(runs, None, model, Path(scratch) / "runs", None).data)


def measured() -> Iterator[str]:
    """Both tables of the controller log."""
    answers = list(of_each_vehicle("controller_data"))
    yield "| vehicle | flights | number | throttle that holds height | chance without a change | shows from | answer |"
    yield "|---|---|---|---|---|---|---|"
    yield from (row(*found) for found in answers)
    yield ""
    yield MOTORS_HEAD
    yield "|---|---|---|---|---|---|---|"
    yield from (motors_row(*found) for found in answers)


def motors_measured() -> Iterator[str]:
    """The table of the motor log by the load of the motors."""
    yield MOTORS_HEAD
    yield "|---|---|---|---|---|---|---|"
    yield from (motors_row(*found) for found in of_each_vehicle("motor_data"))


def of_each_vehicle(log: str) -> Iterator[tuple[str, str, int, Mapping[str, Any]]]:
    """(vehicle, name, number of flights, answer) of every folder of a log: each vehicle against its own undamaged flights."""
    folder = folder_of_recordings(log)
    for vehicle in sorted({p.name.split("_")[0] for p in (folder / UNDAMAGED).iterdir()}):
        for found in judged(folder, f"{vehicle}_*"):
            yield vehicle, *found


def printed(lines: Iterable[str]) -> Iterator[str]:
    """The same, each shown when it is there."""
    for line in lines:
        print(line, file=sys.stderr)
        yield line


def main() -> None:
    """Measure, and print or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, help="page whose measured block is replaced")
    asked = parser.parse_args()
    for benchmark, measure in (
        ("benchmarks/validity_recorded.py", measured),
        ("benchmarks/validity_recorded.py, motors", motors_measured),
    ):
        table = "\n".join(printed(measure())) + "\n"
        if asked.write is None:
            print(table, end="")
        else:
            write_block(asked.write, benchmark, table)


if __name__ == "__main__":
    main()
