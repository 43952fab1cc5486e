"""Every fault in every state, as a table: `python -m tests.faults.table [-o docs/faults.md]` (or `make faults`).

With --sitl the dangerous cells are flown on a real ArduCopter instead, with --endurance an hour and long flights with faults at random,
with --lines flights over serial lines, with --interrupts Ctrl-C is pressed in each state, with --changes each change of state that no
cell makes is flown. Each writes its own part of the page and keeps
the others.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.faults.cells import CHANGES, FAULTS, STATES, Cell, fly_cell
from tests.faults.changes import PROVOKED, Provoked
from tests.faults.defects import HEADING as DEFECTS_HEADING
from tests.faults.defects import table as of_defects
from tests.faults.endurance import GROWTH_MAX_MB, RANDOM_FLIGHTS, Drawn, Soak, live_soak, random_flight, soak
from tests.faults.interrupts import HEADING as INTERRUPTS_HEADING
from tests.faults.interrupts import measure, of_interrupts
from tests.faults.lines import OverLine, fly_script
from tests.faults.proxy import Fault, When

INTRODUCTION = """Written by `make faults`. The built-in vehicle flies two steps in real time (virtual: it takes as long as its computation)
behind a link that fails as the row says, from the moment that the column names: the first parameter that is set, arming, the climb, the way
to the second step, the entry into GUIDED_NOGPS, the first step, the abort after a stop, the landing.
A cell says why the flight ended and how the vehicle was left ([operations.md](operations.md) has the words), and after how many seconds.
It is right where the flight ended in time, what is said of the vehicle is so, a pilot who chose LOITER or BRAKE kept it (BRAKE not
during an abort, which asks for the same mode), no vehicle stayed in the air after a fault that passed, and parameters are restored
after a landing. Time is the computation's, so another program's load changes no cell."""


def one(fault: Fault, when: When) -> Cell:
    """One cell, in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        return fly_cell(fault, when, Path(folder) / "run")


def provoke(provoked: Provoked) -> Cell:
    """A flight for one change of state."""
    return provoked.fly()


def page(cells: list[Cell]) -> str:
    """docs/faults.md."""
    wrong = [cell for cell in cells if not cell.ok]
    by_place = {(cell.fault.name, cell.when): cell for cell in cells}
    lines = [
        "# Faults of the link in every state of a flight", "",
        INTRODUCTION, "",
        f"{sum(cell.ok for cell in cells)} of {len(cells)} cells are right.", "",
        "| fault | " + " | ".join(when.value for when in STATES) + " |", "|---|" + "---|" * len(STATES),
    ]  # fmt: skip
    for fault in FAULTS:
        row = [by_place[fault.name, when] for when in STATES]
        cells_of = [f"{'' if c.ok else '**wrong:** '}{c.ended.split(':')[0]} ({c.seconds:.0f} s)" for c in row]
        lines.append(f"| {fault.name} | " + " | ".join(cells_of) + " |")
    seen = frozenset().union(*(cell.changes for cell in cells)) & CHANGES
    unseen = ", ".join(sorted(f"{state.name} {event.name}" for state, event in CHANGES - seen))
    lines += [
        "",
        f"Of the {len(CHANGES)} changes of state ([operations.md](operations.md)) {len(seen)} happened in these flights.",
    ]
    lines += [f"{NOT_IN_THEM} {unseen}."] if unseen else []
    if wrong:
        lines += ["", "What is wrong:", ""]
        lines += [f"- {c.fault.name}, {c.when.value}: {'; '.join(c.wrong)}" for c in wrong]
    return "\n".join(lines) + "\n"


NOT_IN_THEM = "Not in them (flown below, a flight for each):"
CHANGES_HEADING = "## Changes of state that no cell makes"


def of_changes(cells: list[Cell]) -> str:
    """The page's part of the flights of `PROVOKED`."""
    lines = [
        CHANGES_HEADING, "",
        "Written by `make faults-changes`: the same flights, but the fault begins when the flight's state is the one named.",
        "A flight is right where the change happened, the flight ended as the table of states says, and by the rules above.",
        "BROKEN: the transport raised an error of an unexpected kind; it is raised again after the vehicle's state was settled.", "",
        f"{sum(cell.ok for cell in cells)} of {len(cells)} are right.", "",
        "| state | event | fault | how it ended | s |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for p, cell in zip(PROVOKED, cells, strict=True):
        ended = cell.ended if cell.ok else f"**wrong:** {cell.ended}: {'; '.join(cell.wrong)}"
        lines.append(f"| {p.state.name} | {p.event.name} | {p.fault.name} | {ended} | {cell.seconds:.0f} |")
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


ENDURANCE_HEADING = "## An hour, and faults at random"
LINES_HEADING = "## Over serial lines"
HEADINGS = (CHANGES_HEADING, SITL_HEADING, ENDURANCE_HEADING, LINES_HEADING, INTERRUPTS_HEADING, DEFECTS_HEADING)


def of_soak(hour: Soak, what: str) -> str:
    """A long flight in one sentence, and what is wrong with it."""
    warm = next(mb for t, mb in hour.memory if t >= hour.warm_s)
    wrong = "" if not hour.wrong else f" **wrong:** {'; '.join(hour.wrong)}"
    return (
        f"{what}: {hour.seconds:.0f} s, {hour.ended}, {hour.flown} of {hour.legs} steps flown, {hour.written_mb:.0f} MB recorded, "
        f"{hour.host_s:.0f} s on this host. Memory {warm:.1f} MB after {hour.warm_s / 60:.0f} min, "
        f"at most {hour.growth_mb:.1f} MB more since then (looked at every minute; allowed are {GROWTH_MAX_MB:.0f} MB).{wrong}"
    )


def of_endurance(hours: tuple[Soak, Soak], flights: list[Drawn]) -> str:
    """The page's part of long flights: an hour of the host's time, an hour of virtual time, flights with faults."""
    lines = [
        ENDURANCE_HEADING, "",
        "Written by `make faults-endurance`: an hour of real time, and an hour of virtual time (as many targets, messages, clock",
        "questions and records, computed faster).",
        "", of_soak(hours[0], REAL_TIME),
        "", of_soak(hours[1], "Virtual time, memory of client and vehicle in one process"),
        "",
        *_of_drawn(flights),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _of_drawn(flights: list[Drawn]) -> list[str]:
    """The lines on flights with faults at random."""
    right = sum(d.cell.ok for d in flights)
    lines = [
        f"{right} of {len(flights)} {DRAWN} are right, by the same rules as above. ",
        "The last fault may be one that ends the flight.", "",
        "| seed | faults (from, s) | how it ended | steps | s | memory, MB |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for d in flights:
        reported = ", ".join(f"{name} ({t:.0f})" for name, t, _ in d.faults)
        ended = d.cell.ended if d.cell.ok else f"**wrong:** {d.cell.ended}: {'; '.join(d.cell.wrong)}"
        lines.append(f"| {d.seed} | {reported} | {ended} | {d.flown} | {d.cell.seconds:.0f} | {d.growth_mb:+.1f} |")
    return lines


def of_lines(flights: list[OverLine]) -> str:
    """The page's part of flights over serial lines."""
    right = sum(not f.wrong for f in flights)
    lines = [
        LINES_HEADING, "",
        "Written by `make faults-lines`. The built-in vehicle at the other end of a line that carries what the baud rate does; half a",
        "second of it waits in a buffer, what comes on top is dropped, a radio's loss is drawn frame by frame each way. All scripts are",
        "flown whole, in virtual time: the same flight on any computer, however busy. Those that say so were flown at the time of day over",
        "a pty; `late` is how far the simulation fell behind it at most: that is the computer's, not the line's.",
        "Rates are those measured before arming; `dropped` counts frames that found the buffer full (most of them while all parameters are",
        "read).",
        "",
        f"{right} of {len(flights)} are right.", "",
        "| baud | loss | script | time | how it ended | steps flown | s | ATTITUDE, Hz | HIGHRES_IMU, Hz | dropped up, down |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for f in flights:
        ended = f.ended if not f.wrong else f"**wrong:** {'; '.join(f.wrong)}"
        rates = " | ".join(f"{f.rates_hz.get(name, 0.0):.0f}" for name in ("ATTITUDE", "HIGHRES_IMU"))
        timed = "virtual" if f.late_s is None else f"of day, late {f.late_s:.2f} s"
        lines.append(
            f"| {f.baud} | {100 * f.loss:.0f} % | {f.script} | {timed} | {ended} | {f.flown} of {f.legs} | {f.seconds:.0f} | {rates} | "
            f"{f.dropped[0]}, {f.dropped[1]} |"
        )
    return "\n".join(lines) + "\n"


def parts_of(text: str) -> dict[str, str]:
    """A page's parts by their heading, '' for the first."""
    parts, heading = {"": ""}, ""
    for line in text.splitlines(keepends=True):
        if line.strip() in HEADINGS:
            heading = line.strip()
        parts[heading] = parts.get(heading, "") + line
    return parts


def endure(jobs: int) -> tuple[str, bool]:
    """An hour, and long flights with random faults: the page's part, and whether all is right."""
    with ProcessPoolExecutor(jobs, max_tasks_per_child=1) as pool, ProcessPoolExecutor(1) as beside:
        hour_of = pool.submit(soak)
        live_of = beside.submit(live_soak)  # it waits most of the time
        flights = list(pool.map(random_flight, range(1, RANDOM_FLIGHTS + 1)))
        hours = (live_of.result(), hour_of.result())
    for d in flights:
        tell(d.cell)
    return of_endurance(hours, flights), not any(h.wrong for h in hours) and all(d.cell.ok for d in flights)


DRAWN = "flights of ten minutes with faults drawn at random"
REAL_TIME = "Real time, the vehicle at the other end of a pty, memory of the client's process"


def of_hour(before: str, hour: Soak) -> str:
    """The page's part of long flights, `before`, with its hour of real time flown again."""
    lines = before.splitlines()
    (place,) = (k for k, line in enumerate(lines) if line.startswith(REAL_TIME))
    end = lines.index("", place)
    return "\n".join([*lines[:place], of_soak(hour, REAL_TIME), *lines[end:]]) + "\n"


def of_random(before: str, flights: list[Drawn]) -> str:
    """The page's part of long flights, `before`, with its flights at random flown again."""
    lines = before.splitlines()
    end = next((k for k, line in enumerate(lines) if DRAWN in line), len(lines))
    return "\n".join([*lines[:end], *_of_drawn(flights)]) + "\n"


def fly_random(jobs: int) -> list[Drawn]:
    """Long flights with random faults, in virtual time."""
    flights = []
    with ProcessPoolExecutor(jobs, max_tasks_per_child=1) as pool:
        for drawn in pool.map(random_flight, range(1, RANDOM_FLIGHTS + 1)):
            flights.append(drawn)
            tell(drawn.cell)
    return flights


def over_lines(jobs: int) -> tuple[str, bool]:
    """Flights over serial lines: the page's part, and whether all is right."""
    from flighttest.script.shipped import shipped_names

    radio, wire = (57600, 0.05), (115200, 0.0)
    todo = [(*radio, "roll_pitch", True), (*wire, "yaw_rate", True)]
    todo += [(*line, name, False) for line in (radio, wire) for name in shipped_names()]
    with ProcessPoolExecutor(jobs) as pool:
        flights = list(pool.map(fly_script, *zip(*todo, strict=True)))
    return of_lines(flights), not any(f.wrong for f in flights)


def main() -> int:
    """Fly all cells on all cores, write the page, and fail where one is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="otherwise it is written to the terminal")
    parser.add_argument("-j", "--jobs", type=int, default=os.cpu_count())
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--sitl", action="store_true", help="the dangerous cells, on a real ArduCopter")
    what.add_argument("--endurance", action="store_true", help="an hour, and long flights with faults at random")
    what.add_argument("--hour", action="store_true", help="of the endurance, the hour of real time alone")
    what.add_argument("--random", action="store_true", help="of the endurance, the flights with faults at random alone")
    what.add_argument("--lines", action="store_true", help="flights over serial lines")
    what.add_argument("--interrupts", action="store_true", help="how soon Ctrl-C is answered in each state")
    what.add_argument("--changes", action="store_true", help="a flight for each change of state that no cell makes")
    words = parser.parse_args()
    if words.sitl:
        cells = fly_on_sitl(words.jobs)
        heading, part, right = SITL_HEADING, of_sitl(cells), all(cell.ok for cell in cells)
    elif words.endurance:
        heading, (part, right) = ENDURANCE_HEADING, endure(words.jobs)
    elif words.hour:
        hour = live_soak()
        before = (
            parts_of(words.output.read_text(encoding="utf-8"))[ENDURANCE_HEADING]
            if words.output
            else f"{REAL_TIME}\n\n"
        )
        heading, part, right = ENDURANCE_HEADING, of_hour(before, hour), not hour.wrong
    elif words.random:
        drawn = fly_random(words.jobs)
        before = parts_of(words.output.read_text(encoding="utf-8"))[ENDURANCE_HEADING] if words.output else ""
        heading, part, right = ENDURANCE_HEADING, of_random(before, drawn), all(d.cell.ok for d in drawn)
    elif words.interrupts:
        pressed = measure()
        heading, part, right = INTERRUPTS_HEADING, of_interrupts(pressed), all(p.ok for p in pressed)
    elif words.changes:
        cells = fly_changes(words.jobs)
        heading, part, right = CHANGES_HEADING, of_changes(cells), all(cell.ok for cell in cells)
    elif words.lines:
        heading, (part, right) = LINES_HEADING, over_lines(words.jobs)
    else:
        cells = fly_all(words.jobs)
        heading, part, right = "", page(cells), all(cell.ok for cell in cells)
    if words.output is None:
        sys.stdout.write(part)
        return 0 if right else 1
    # Read only now: another part may have been written meanwhile.
    parts = parts_of(words.output.read_text(encoding="utf-8") if words.output.exists() else "")
    parts |= {heading: part, DEFECTS_HEADING: of_defects()}
    text = "\n".join(parts[h].strip("\n") + "\n" for h in ("", *HEADINGS) if parts.get(h, "").strip())
    words.output.write_text(text, encoding="utf-8")
    return 0 if right else 1


def fly_on_sitl(jobs: int) -> list[Cell]:
    """The dangerous cells, on as many vehicles at once as there are jobs."""
    from tests.faults.live import DANGEROUS

    parts = [list(DANGEROUS[k::jobs]) for k in range(jobs)]
    with ProcessPoolExecutor(jobs) as pool:
        found = {(c.fault.name, c.when): c for part in pool.map(some_on_sitl, parts) for c in part}
    return [found[place] for place in DANGEROUS]


def fly_changes(jobs: int) -> list[Cell]:
    """A flight for each change of state that no cell makes."""
    with ProcessPoolExecutor(jobs) as pool:
        cells: list[Cell] = []
        for cell in pool.map(provoke, PROVOKED):
            cells.append(cell)
            tell(cell)
    return cells


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
