"""Diagnosis of recordings that others made, against what their documentation supports.

    python -m benchmarks.real_flights [WORD...] [--write docs/real_flights.md]

Diagnoses every set of $FLIGHTTEST_DATA, or of ../shared/data beside the checkout, as `flighttest diagnose` does, one after the other, in a
process of its own; WORD: only sets whose name has it in it. An answer is right when its verdict is one of those expected, everything
required is named and nothing else than what is allowed. Wall and processor time are per 100 s of recorded flight.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from benchmarks.page import write_block
from flighttest.proof.recorded.sets import read_sets
from flighttest.proof.recorded.wind_pairs import agrees

REPOSITORY = Path(__file__).resolve().parents[1]
LISTED = REPOSITORY / "examples" / "recordings" / "public.yaml"
CALM = ("NOTHING_MISSING", "EXPLAINED")
ANY = (*CALM, "PARTLY")


@dataclass(frozen=True)
class Recordings:
    """One question: files, what is expected and why. allowed: names that are no error; required: names without which it is a miss; winds:
    pattern of flights' names to their wind, m/s."""

    name: str
    files: tuple[str, ...]
    supports: str
    verdicts: tuple[str, ...] = CALM
    allowed: frozenset[str] = frozenset()
    required: frozenset[str] = frozenset()
    columns: Path | None = None
    winds: dict[str, float] = field(default_factory=dict)
    refused: str = ""


# What a set's documentation supports, by words of its name, and the verdicts that fit it; the first that matches counts.
SUPPORTS = (
    ("weight_on_string", "a load on a string; a change of mass or of a propeller shows against the undamaged model only", ANY),
    ("controller_data, E9, add_weight", "the thrust curve, and a motor at its limit by the log's own torque commands", CALM),
    ("propeller damage", "nothing but the thrust curve: a change shows against the undamaged model only", CALM),
    ("still air", "no wind", ANY),
    ("failure", "a mechanical failure in flight: located, or outside what a flight model holds", (*ANY, "UNKNOWN_PHYSICS")),
    ("ArduCopter SITL", "the autopilot's own, and what its simulator flies", ANY),
    ("ArduCopter", "pilot's flight outdoors: wind possible, nothing else documented", ANY),
    ("real firmware", "the autopilot's own", CALM),
)  # fmt: skip


def flights_of() -> list[Recordings]:
    """Every set that is listed, and three questions beside them."""
    listed = {one.name: one for one in read_sets(LISTED)}
    normal = listed["propeller damage, controller_data, E8, normal_flight"]
    tunnel = [one for one in listed.values() if one.source == "wind tunnel"]
    own = frozenset(term for one in tunnel for term in one.own)
    found = [
        Recordings(
            "propeller damage, two undamaged flights", tuple(f.replace("*", f"log0{k}") for k in (0, 1) for f in normal.files),
            "nothing but the thrust curve", allowed=frozenset(normal.own),
        ),
        Recordings(
            "wind tunnel, nine flights", tuple(f for one in tunnel for f in one.files), "winds of 0, 4.2 and 8.5 m/s along x", ANY,
            own, frozenset({"steady_wind"}), tunnel[0].columns,
            {Path(f).name.split(".")[0]: math.hypot(*one.wind_m_s) for one in tunnel if one.wind_m_s for f in one.files},
        ),
        Recordings(
            "thrust stand", ("thrust_stand/data/single_rotor/xNova-SR-ramp.csv",), "refused: no flight", refused="RecordingError",
        ),
    ]  # fmt: skip
    for one in listed.values():
        if one in tunnel and "still air" not in one.name:
            continue  # asked of all nine
        supports, verdicts = next((text, fit) for words, text, fit in SUPPORTS if words in one.name)
        found.append(Recordings(one.name, one.files, supports, verdicts, frozenset(one.own), columns=one.columns))
    return found


def diagnosed(files: list[Path], columns: Path | None) -> tuple[dict[str, Any], float, float]:
    """(answer of `flighttest diagnose --json`, or {'error': its message}, wall s, processor s)."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "flighttest",
            "diagnose",
            *map(str, files),
            "-o",
            f"{folder}/diagnosis",
            "--json",
        ]
        command += ["--columns", str(columns)] if columns is not None else []
        begun, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        ended = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
        after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic() - begun
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    try:
        return json.loads(ended.stdout), wall, used
    except json.JSONDecodeError:
        return {"error": (ended.stderr.strip().splitlines() or [""])[-1]}, wall, used


def seconds_of(files: list[Path], columns: Path | None) -> float:
    """Recorded flight, s, from take-off to landing; nan where it cannot be read."""
    from flighttest.errors import FlighttestError
    from flighttest.pipeline.recordings.sources import Reading, open_recordings
    from flighttest.segments.airborne import flights

    try:
        recordings = open_recordings(files, Reading(columns))
    except FlighttestError:
        return float("nan")
    return sum(b - a for r in recordings for a, b in flights(r))


def judged(one: Recordings, found: dict[str, Any]) -> str:
    """'right', or what is wrong."""
    if "verdict" not in found:
        message = json.dumps(found)
        return "right" if one.refused and one.refused in message else f"refused: {message[:120]}"
    if one.refused:
        return "not refused"
    named = {f["term"] for f in found["findings"]}
    wrong = [f"{t} not named" for t in sorted(one.required - named)]
    wrong += [f"{t} named" for t in sorted(named - one.allowed - one.required)]
    if found["verdict"] not in one.verdicts:
        wrong.append(found["verdict"])
    for pattern, speed in one.winds.items():
        for w in (w for w in found["winds"] if fnmatch(w["flight"], pattern)):
            if speed == 0.0 and w["verdict"] == "wind":
                wrong.append(f"{w['flight']}: still air called wind")
            if speed and not agrees(w["speed_m_s"], speed, w["speed_std"]):
                wrong.append(f"{w['flight']}: {w['speed_m_s']:.1f} ± {w['speed_std']:.1f} m/s")
    return "; ".join(wrong) or "right"


def row(one: Recordings, data: Path) -> str:
    """One line of the table."""
    files = sorted(f for pattern in one.files for f in data.glob(pattern))
    if not files:
        return f"| {one.name} | - | - | not here | - | - | - |"
    found, wall, used = diagnosed(files, one.columns)
    flown = seconds_of(files, one.columns)
    named = ", ".join(f["term"] for f in found.get("findings", [])) or "nothing"
    winds = ", ".join(f"{w['speed_m_s']:.1f} ± {w['speed_std']:.1f}" for w in found.get("winds", []))
    said = f"{found['verdict']}: {named}" if "verdict" in found else "refused"
    said += f" (m/s: {winds})" if winds else ""
    seconds = f"{flown:.0f}" if flown > 0 else "-"
    time_of = f"{100 * wall / flown:.0f} / {100 * used / flown:.0f}" if flown > 0 else f"({wall:.0f} / {used:.0f})"
    return f"| {one.name} | {len(files)} | {seconds} | {one.supports} | {said} | {judged(one, found)} | {time_of} |"


def main() -> None:
    """Measure, and print or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="only sets whose name has one of these in it")
    parser.add_argument("--write", type=Path, help="page whose measured block is replaced")
    asked = parser.parse_args()
    data = Path(os.environ.get("FLIGHTTEST_DATA") or REPOSITORY.parent / "shared" / "data")
    if not data.is_dir():
        raise SystemExit(f"{data} is not here: set FLIGHTTEST_DATA to the folder of recordings")
    lines = [
        "| recordings | files | flown, s | documentation supports | answer | judged | s per 100 s of flight: wall / processor |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in flights_of():
        if not asked.words or any(w in one.name for w in asked.words):
            lines.append(row(one, data))
            print(lines[-1], file=sys.stderr, flush=True)
    table = "\n".join(lines) + "\n"
    if asked.write is None:
        print(table, end="")
        return
    write_block(asked.write, "benchmarks/real_flights.py", table)


if __name__ == "__main__":
    main()
