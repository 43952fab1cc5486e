"""Every fault in every state, as a table: `python -m tests.faults.table [-o docs/faults.md]` (or `make faults`)."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.faults.cells import FAULTS, STATES, Cell, fly_cell
from tests.faults.proxy import Fault, When

INTRODUCTION = """Written by `make faults`. The built-in vehicle flies two steps in real time (virtual: it takes as long as its computation)
behind a link that fails as the row says, from the moment that the column names: the first parameter that is set, arming, the climb, the way
to the second step, the entry into GUIDED_NOGPS, the first step, the abort after a stop, the landing.
A cell says why the flight ended and how
the vehicle was left ([operations.md](operations.md) has the words), and after how many seconds. It is right where the flight ended in time,
what is said of the vehicle is so, a pilot who chose LOITER kept it, a fault that passed left nobody in the air, and parameters are
restored after a landing."""


def one(fault: Fault, when: When) -> Cell:
    """One cell, in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        return fly_cell(fault, when, Path(folder) / "run")


def page(cells: list[Cell]) -> str:
    """docs/faults.md."""
    wrong = [cell for cell in cells if not cell.ok]
    by_place = {(cell.fault.name, cell.when): cell for cell in cells}
    lines = [
        "# Faults of the link in every state of a flight", "",
        INTRODUCTION, "",
        f"{len(cells) - len(wrong)} of {len(cells)} cells are right.", "",
        "| fault | " + " | ".join(when.value for when in STATES) + " |", "|---|" + "---|" * len(STATES),
    ]  # fmt: skip
    for fault in FAULTS:
        row = [by_place[fault.name, when] for when in STATES]
        cells_of = [f"{'' if c.ok else '**wrong:** '}{c.ended.split(':')[0]} ({c.seconds:.0f} s)" for c in row]
        lines.append(f"| {fault.name} | " + " | ".join(cells_of) + " |")
    if wrong:
        lines += ["", "What is wrong:", ""]
        lines += [f"- {c.fault.name}, {c.when.value}: {'; '.join(c.wrong)}" for c in wrong]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Fly all cells on all cores, write the page, and fail where one is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="otherwise it is written to the terminal")
    parser.add_argument("-j", "--jobs", type=int, default=os.cpu_count())
    words = parser.parse_args()
    places = [(fault, when) for fault in FAULTS for when in STATES]
    with ProcessPoolExecutor(words.jobs) as pool:
        cells = []
        for cell in pool.map(one, *zip(*places, strict=True)):
            cells.append(cell)
            said = "; ".join(cell.wrong) or "right"
            sys.stderr.write(
                f"{len(cells)}/{len(places)} {cell.fault.name}, {cell.when.value}: {cell.ended} ({said})\n"
            )
    text = page(cells)
    if words.output is None:
        sys.stdout.write(text)
    else:
        words.output.write_text(text, encoding="utf-8")
    return 1 if any(not cell.ok for cell in cells) else 0


if __name__ == "__main__":
    raise SystemExit(main())
