"""Every fault in every state, as a table: `python -m tests.faults.table [-o docs/faults.md]` (or `make faults`).

With --sitl the dangerous cells are flown on a real ArduCopter instead; either keeps what the page has of the other.
"""

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
A cell says why the flight ended and how the vehicle was left ([operations.md](operations.md) has the words), and after how many seconds.
It is right where the flight ended in time, what is said of the vehicle is so, a pilot who chose LOITER kept it, no vehicle stayed in the
air after a fault that passed, and parameters are restored after a landing."""


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


SITL_HEADING = "## On a real ArduCopter"
SITL_INTRODUCTION = """Written by `make faults-sitl`: the cells that were wrong once, or could hurt most, with ArduPilot's own physics in
real time. The truth is seen over a second link, which is the pilot's, too."""


def of_sitl(cells: list[Cell]) -> str:
    """The page's part of what the real firmware did."""
    right = sum(cell.ok for cell in cells)
    lines = [SITL_HEADING, "", SITL_INTRODUCTION, "", f"{right} of {len(cells)} cells are right.", ""]
    lines += ["| fault | from | how it ended | s |", "|---|---|---|---|"]
    for c in cells:
        ended = c.ended if c.ok else f"**wrong:** {c.ended}: {'; '.join(c.wrong)}"
        lines.append(f"| {c.fault.name} | {c.when.value} | {ended} | {c.seconds:.0f} |")
    return "\n".join(lines) + "\n"


def some_on_sitl(part: list[tuple[str, When]]) -> list[Cell]:
    """Cells on one vehicle, one after the other."""
    from flighttest.sim.sitl.launcher import SitlOptions, launch
    from tests.faults.live import fly_live

    cells: list[Cell] = []
    todo = list(part)
    while todo:  # on another vehicle, where one could not be brought down for the next cell
        with launch(SitlOptions(airframe="paper", speedup=1.0)) as vehicle:
            down = True
            while todo and down:
                cell, down = fly_live(vehicle, *todo.pop(0))
                tell(cell)
                cells.append(cell)
    return cells


def tell(cell: Cell) -> None:
    """One line of progress."""
    said = "; ".join(cell.wrong) or "right"
    sys.stderr.write(f"{cell.fault.name}, {cell.when.value}: {cell.ended} in {cell.seconds:.0f} s ({said})\n")
    sys.stderr.flush()


def main() -> int:
    """Fly all cells on all cores, write the page, and fail where one is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="otherwise it is written to the terminal")
    parser.add_argument("-j", "--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--sitl", action="store_true", help="the dangerous cells, on a real ArduCopter")
    words = parser.parse_args()
    kept = words.output.read_text(encoding="utf-8") if words.output is not None and words.output.exists() else ""
    built_in, _, real = kept.partition(SITL_HEADING)
    if words.sitl:
        cells = fly_on_sitl(words.jobs)
        built_in, real = built_in.rstrip() + "\n\n", of_sitl(cells)
    else:
        cells = fly_all(words.jobs)
        built_in, real = page(cells), f"\n{SITL_HEADING}{real}" if real else ""
    if words.output is None:
        sys.stdout.write(built_in + real)
    else:
        words.output.write_text(built_in + real, encoding="utf-8")
    return 1 if any(not cell.ok for cell in cells) else 0


def fly_on_sitl(jobs: int) -> list[Cell]:
    """The dangerous cells, on as many vehicles at once as there are jobs."""
    from tests.faults.live import DANGEROUS

    parts = [list(DANGEROUS[k::jobs]) for k in range(jobs)]
    with ProcessPoolExecutor(jobs) as pool:
        found = {(c.fault.name, c.when): c for part in pool.map(some_on_sitl, parts) for c in part}
    return [found[place] for place in DANGEROUS]


def fly_all(jobs: int) -> list[Cell]:
    """Every cell on the built-in vehicle."""
    places = [(fault, when) for fault in FAULTS for when in STATES]
    with ProcessPoolExecutor(jobs) as pool:
        cells: list[Cell] = []
        for cell in pool.map(one, *zip(*places, strict=True)):
            cells.append(cell)
            tell(cell)
    return cells


if __name__ == "__main__":
    raise SystemExit(main())
