"""Diagnosis of recordings that others made, against what their documentation supports.

    python -m benchmarks.real_flights [WORD...] [--write docs/real_flights.md]

Diagnoses every set of $FLIGHTTEST_DATA, or of ../shared/data beside the checkout, as `flighttest diagnose` does, one after the other, in a
process of its own; WORD: only sets whose name has it in it. An answer is right when its verdict is one of those expected, everything
required is named and nothing else than what is allowed. Wall and processor time are per 100 s of recorded flight.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.page import write_block

REPOSITORY = Path(__file__).resolve().parents[1]
NEURAL_FLY = REPOSITORY / "examples" / "columns" / "neural_fly.yaml"
CALM = ("NOTHING_MISSING", "EXPLAINED")
ANY = (*CALM, "PARTLY")
# A small quadrotor's thrust is quadratic in its command (Foerster 2015, system identification of the Crazyflie).
THRUST = frozenset({"throttle_curve", "throttle_offset"})
# What ArduCopter's own loops do: boost by lean angle, shaped references, heading hold (AC_AttitudeControl).
AUTOPILOT = frozenset(
    {"angle_boost", "reference_shaping", "yaw_rate_shaping", "heading_hold", "heading_rate_reference", "turn_axes",
     "rotor_speed_lag", "attitude_extra_pole", "roll_pitch_coupling"}
)  # fmt: skip

# What ArduPilot's own simulator flies: drag by areaCd v^2, rotors that lose outflow with the speed of the air into them, momentum drag
# with the square root of thrust, a battery with a resistance (libraries/SITL: SIM_Frame.cpp calculate_forces, SIM_Motor.cpp
# calculate_forces and calc_thrust, SIM_Battery.cpp).
ARDUPILOT_SITL = frozenset({"quadratic_drag", "axial_inflow", "thrust_scaled_drag", "voltage_sag"})


@dataclass(frozen=True)
class Recordings:
    """One question: files, what is expected and why. allowed: names that are no error; required: names without which it is a miss; winds:
    part of a flight's name to its wind, m/s."""

    name: str
    files: tuple[str, ...]
    supports: str
    verdicts: tuple[str, ...] = CALM
    allowed: frozenset[str] = frozenset()
    required: frozenset[str] = frozenset()
    columns: Path | None = None
    winds: dict[str, float] = field(default_factory=dict)
    refused: str = ""


def flights_of(data: Path) -> list[Recordings]:
    """Every set that is here."""
    tunnel = "wind_tunnel/custom_figure8_*_{}.csv.gz"
    drag = frozenset({"thrust_scaled_drag", "quadratic_drag", "attitude_offset", "translational_lift", *THRUST})
    normal = "propeller_damage/controller_data/normal_flight/E8_log0{}"
    found = [
        Recordings(
            "propeller damage, two undamaged flights", (normal.format(0), normal.format(1)), "nothing but the thrust curve",
            allowed=THRUST,
        ),
        Recordings(
            "wind tunnel, nine flights", (tunnel.format("*wind"),), "winds of 0, 4.2 and 8.5 m/s along x", ANY,
            drag | {"steady_wind"}, frozenset({"steady_wind"}), NEURAL_FLY, {"35wind": 4.2, "70wind": 8.5, "nowind": 0.0},
        ),
        Recordings(
            "wind tunnel, still air", (tunnel.format("nowind"),), "no wind", ANY, drag, columns=NEURAL_FLY
        ),
    ]  # fmt: skip
    for kind in ("controller_data", "motor_data"):
        root = data / "propeller_damage" / kind
        for folder in sorted(root.iterdir()) if root.is_dir() else []:
            loaded = "weight_on_string" in folder.name
            found.append(
                Recordings(
                    f"propeller damage, {kind}, {folder.name}", (f"propeller_damage/{kind}/{folder.name}/*",),
                    "a load on a string; a change of mass or of a propeller shows against the undamaged model only" if loaded
                    else "nothing but the thrust curve: a change shows against the undamaged model only",
                    ANY if loaded else CALM, THRUST | ({"slung_payload"} if loaded else set()),
                )
            )  # fmt: skip
    for file in ("copter_3.2_2014.BIN", "copter_3.4_erlebrain3.BIN", "copter_3.4_mechanical_failure.bin"):
        found.append(
            Recordings(
                f"ArduCopter, {file}", (f"arducopter_logs/{file}",),
                "pilot's flight outdoors: wind possible, nothing else documented" if "failure" not in file
                else "a mechanical failure in flight: located, or outside what a flight model holds",
                ANY if "failure" not in file else (*ANY, "UNKNOWN_PHYSICS"), AUTOPILOT | THRUST | {"steady_wind", "attitude_offset"},
            )
        )  # fmt: skip
    for file in ("sitl_4.7dev_steps.BIN", "sitl_4.7dev_steps.tlog"):
        found.append(
            Recordings(
                f"ArduCopter SITL, {file}",
                (f"arducopter_logs/{file}",),
                "the autopilot's own, and what its simulator flies",
                ANY,
                AUTOPILOT | THRUST | ARDUPILOT_SITL,
            )
        )
    for file in ("recording.BIN.xz", "recording.tlog.gz"):
        found.append(
            Recordings(
                f"real firmware, clean, {file}",
                (f"real_firmware_clean/{file}",),
                "the autopilot's own",
                CALM,
                AUTOPILOT,
            )
        )
    found.append(
        Recordings(
            "thrust stand", ("thrust_stand/data/single_rotor/xNova-SR-ramp.csv",), "refused: no flight", refused="RecordingError",
        )
    )  # fmt: skip
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
    for part, speed in one.winds.items():
        for w in (w for w in found["winds"] if part in w["flight"]):
            if speed == 0.0 and w["verdict"] == "wind":
                wrong.append(f"{w['flight']}: still air called wind")
            if speed and abs(w["speed_m_s"] - speed) > max(2.0 * w["speed_std"], 1.0):
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
    time_of = f"{100 * wall / flown:.0f} / {100 * used / flown:.0f}" if flown > 0 else f"({wall:.0f} / {used:.0f})"
    return f"| {one.name} | {len(files)} | {flown:.0f} | {one.supports} | {said} | {judged(one, found)} | {time_of} |"


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
    for one in flights_of(data):
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
