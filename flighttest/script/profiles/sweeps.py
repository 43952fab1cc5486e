"""Yaw rate steps, chirps and ramps of any one input."""

from __future__ import annotations

import math
from typing import Literal

from flighttest.script.profiles.declare import COAST, ENTRY, SIGN, Field, Profile, Settings, StepCell, signs
from flighttest.script.profiles.timeline import Chirp, Piece, Ramp, Wave

INPUTS = ("roll", "pitch", "yaw_rate", "throttle")
# Which setting carries the size of which input.
_SIZE = {"roll": "amplitude_rad", "pitch": "amplitude_rad", "yaw_rate": "rate_rad_s", "throttle": "throttle"}
_SIZES = (
    Field("amplitude_rad", "number", "tilt asked for (roll, pitch)", "rad", 0.02, 1.05, optional=True),
    Field("rate_rad_s", "number", "yaw rate asked for (yaw_rate)", "rad/s", 0.05, 10.0, optional=True),
    Field("throttle", "number", "how far throttle leaves hover (throttle)", throttle=True, optional=True),
)


def _size_given(settings: Settings) -> str | None:
    needed = _SIZE[settings["input"]]
    given = [field.key for field in _SIZES if settings[field.key] is not None]
    return None if given == [needed] else f"`input: {settings['input']}` needs `{needed}` and no other size"


def drive(name: str, duration_s: float, which: str, wave: Wave, record: bool = True) -> Piece:
    """A recorded piece in which one input follows a wave."""
    if which == "roll":
        return Piece(name, duration_s, roll_rad=wave, record=record)
    if which == "pitch":
        return Piece(name, duration_s, pitch_rad=wave, record=record)
    if which == "yaw_rate":
        return Piece(name, duration_s, yaw_rate_rad_s=wave, record=record)
    return Piece(name, duration_s, throttle=wave, record=record)


def _stop(which: str) -> tuple[Literal["vertical"], ...]:
    return ("vertical",) if which == "throttle" else ()


def _yaw_steps(settings: Settings, throttle_unit: float) -> list[StepCell]:
    return [
        StepCell(
            label=f"yaw{sign * rate:+.2f}",
            kind="yaw_rate_step",
            values={"rate_rad_s": sign * rate},
            lead=(
                Piece("entry", settings["entry_s"]),
                Piece("step", settings["hold_s"], yaw_rate_rad_s=sign * rate, record=True),
            ),
            tail=(Piece("coast", settings["coast_s"]),),
        )
        for rate in settings["rate_rad_s"]
        for sign in signs(settings["sign"])
    ]


YAW_RATE_STEP = Profile(
    "yaw_rate_step",
    "turn at a constant rate, then stop turning",
    (
        Field("rate_rad_s", "numbers", "yaw rate asked for, positive to the left", "rad/s", 0.05, 10.0),
        SIGN,
        Field("hold_s", "number", "how long the turn lasts", "s", 0.3, 30.0, default=1.5),
        ENTRY,
        COAST,
    ),
    _yaw_steps,
)


def _banked_turns(settings: Settings, throttle_unit: float) -> list[StepCell]:
    return [
        StepCell(
            label=f"roll{tilt:+.2f}_yaw{sign * rate:+.2f}",
            kind="free",
            values={"amplitude_rad": tilt, "rate_rad_s": sign * rate},
            lead=(
                Piece("entry", settings["entry_s"]),
                Piece("turn", 2.0 * math.pi / rate, roll_rad=tilt, yaw_rate_rad_s=sign * rate, record=True),
            ),
            tail=(Piece("coast", settings["coast_s"]),),
        )
        for tilt in settings["tilt_rad"]
        for rate in settings["rate_rad_s"]
        for sign in signs(settings["sign"])
    ]


BANKED_TURN = Profile(
    "banked_turn",
    "one whole turn at a constant rate while rolled, after which the vehicle is at rest again, aside of where it began",
    (
        Field("tilt_rad", "numbers", "roll asked for", "rad", 0.02, 1.05),
        Field("rate_rad_s", "numbers", "yaw rate asked for, positive to the left", "rad/s", 0.5, 10.0),
        SIGN,
        ENTRY,
        COAST,
    ),
    _banked_turns,
)


def _chirps(settings: Settings, throttle_unit: float) -> list[StepCell]:
    which, seconds = settings["input"], settings["duration_s"]
    size = settings[_SIZE[which]]
    centre = throttle_unit if which == "throttle" else 0.0
    scale = throttle_unit if which == "throttle" else 1.0
    wave = Chirp(size * scale, settings["from_hz"], settings["to_hz"], seconds, centre)
    return [
        StepCell(
            label=f"chirp {which} {size:.2f}",
            kind="free",
            values={_SIZE[which]: size * scale},
            lead=(Piece("entry", settings["entry_s"]), drive("chirp", seconds, which, wave)),
            stops=_stop(which),
            tail=(Piece("coast", settings["coast_s"]),),
        )
    ]


CHIRP = Profile(
    "chirp",
    "a sine of rising frequency on one input",
    (
        Field("input", "choice", "roll, pitch, yaw_rate or throttle", choices=INPUTS),
        *_SIZES,
        Field("from_hz", "number", "frequency at the start", "Hz", 0.05, 10.0, default=0.5),
        Field("to_hz", "number", "frequency at the end", "Hz", 0.05, 10.0, default=4.0),
        Field("duration_s", "number", "length of the sweep", "s", 1.0, 120.0, default=10.0),
        ENTRY,
        COAST,
    ),
    _chirps,
    _size_given,
)


def _ramps(settings: Settings, throttle_unit: float) -> list[StepCell]:
    which, seconds = settings["input"], settings["duration_s"]
    size = settings[_SIZE[which]]
    scale = throttle_unit if which == "throttle" else 1.0
    start = throttle_unit if which == "throttle" else 0.0
    cells = []
    for sign in signs(settings["sign"]):
        end = start + sign * size * scale
        row = (
            drive("ramp", seconds, which, Ramp(start, end, seconds)),
            drive("hold", settings["hold_s"], which, end),
            drive("back", seconds, which, Ramp(end, start, seconds)),
        )
        cells.append(
            StepCell(
                label=f"ramp {which}{sign * size:+.2f}",
                kind="free",
                values={_SIZE[which]: sign * size * scale},
                lead=(Piece("entry", settings["entry_s"]), *(piece for piece in row if piece.duration_s > 0)),
                stops=_stop(which),
                tail=(Piece("coast", settings["coast_s"]),),
            )
        )
    return cells


RAMP = Profile(
    "ramp",
    "one input up (or down) slowly, held, and back",
    (
        Field("input", "choice", "roll, pitch, yaw_rate or throttle", choices=INPUTS),
        *_SIZES,
        SIGN,
        Field("duration_s", "number", "length of each slope", "s", 0.1, 60.0, default=1.0),
        Field("hold_s", "number", "time between the slopes", "s", 0.0, 60.0, default=0.5),
        ENTRY,
        COAST,
    ),
    _ramps,
    _size_given,
)
