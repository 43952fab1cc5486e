"""Steps, doublets and sweeps of roll and pitch, with the counter-step that stops the vehicle and a level coast after it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from flighttest.script.profiles.declare import (
    COAST,
    ENTRY,
    SIGN,
    Duration,
    Field,
    Profile,
    Settings,
    StepCell,
    shortest,
    signs,
)
from flighttest.script.profiles.timeline import Piece, Wave

AXES = ("roll", "pitch")
AXIS = Field("axis", "choices", "roll, pitch or both as a list", choices=AXES)


def tilt(
    name: str, duration_s: float, axis: str, angle: Wave, record: bool = False, throttle: Wave | None = None
) -> Piece:
    """A piece tilted about one axis, with level-flight throttle unless one is given."""
    if axis == "roll":
        return Piece(name, duration_s, roll_rad=angle, record=record, throttle=throttle)
    return Piece(name, duration_s, pitch_rad=angle, record=record, throttle=throttle)


def tilts(settings: Settings, size: str = "amplitude_rad") -> Iterator[tuple[str, float]]:
    """Every (axis, angle) that axis, size and sign ask for."""
    for axis in settings["axis"]:
        for amplitude in settings[size]:
            for sign in signs(settings["sign"]):
                yield axis, sign * amplitude


def countered(cell: StepCell, axis: str, angle: float, settings: Settings, *, vertical: bool = False) -> StepCell:
    """The cell with its level entry, and its ending: the tilt's other side until the vehicle stands, then level. vertical: a throttle of
    its own stops a climb after that.
    """
    return replace(
        cell,
        lead=(Piece("entry", settings["entry_s"]), *cell.lead),
        stops=("counter", "vertical") if vertical else ("counter",),
        counter=tilt("counter", 0.0, axis, -angle),
        tail=(Piece("coast", settings["coast_s"]),),
    )


def _steps(settings: Settings, throttle_unit: float) -> list[StepCell]:
    hold, dash = settings["hold_s"], settings["dash_s"]
    level = (Piece("dash", dash, record=True),) if dash else ()
    cells = []
    for axis, angle in tilts(settings):
        cell = StepCell(
            label=f"{axis}{angle:+.2f}",
            kind=f"{axis}_step",
            values={"amplitude_rad": angle},
            lead=(tilt("step", hold.seconds, axis, angle, record=True), *level),
            shortest_s=shortest(step=(hold, None)),
        )
        cells.append(countered(cell, axis, angle, settings))
    return cells


ATTITUDE_STEP = Profile(
    "attitude_step",
    "tilt, hold, tilt the other way until the vehicle stands, coast level",
    (
        AXIS,
        Field("amplitude_rad", "numbers", "tilt asked for", "rad", 0.02, 1.05),
        SIGN,
        Field("hold_s", "duration", "how long the tilt is held", "s", 0.1, 20.0, default=Duration(1.0)),
        Field("dash_s", "number", "level flight at speed before the counter-step", "s", 0.0, 20.0, default=0.0),
        ENTRY,
        COAST,
    ),
    _steps,
)


def _doublets(settings: Settings, throttle_unit: float) -> list[StepCell]:
    half = settings["half_s"]
    cells = []
    for axis, angle in tilts(settings):
        # A full swing is entered and left at half length, so that the vehicle ends where it began and at rest.
        row = [tilt("up", half, axis, angle, record=True)]
        for k in range(settings["reversals"]):
            row.append(tilt(f"reversal {k + 1}", 2.0 * half, axis, angle * (-1) ** (k + 1), record=True))
        row.append(tilt("back", half, axis, angle * (-1) ** (settings["reversals"] + 1), record=True))
        cells.append(
            StepCell(
                label=f"{axis}{angle:+.2f}x{settings['reversals']}",
                kind="free",
                values={"amplitude_rad": angle},
                lead=(Piece("entry", settings["entry_s"]), *row),
                tail=(Piece("coast", settings["coast_s"]),),
            )
        )
    return cells


DOUBLET = Profile(
    "doublet",
    "tilt to and fro, each full swing twice as long as the first half",
    (
        AXIS,
        Field("amplitude_rad", "numbers", "tilt asked for", "rad", 0.02, 1.05),
        SIGN,
        Field("half_s", "number", "length of the first half swing", "s", 0.1, 10.0, default=0.4),
        Field("reversals", "count", "full swings between the first and the last half", low=1, high=20, default=1),
        ENTRY,
        COAST,
    ),
    _doublets,
)


def _three_two_one_one(settings: Settings, throttle_unit: float) -> list[StepCell]:
    unit = settings["unit_s"]
    cells = []
    for axis, angle in tilts(settings):
        row = tuple(
            tilt(str(count), count * unit, axis, angle * direction, record=True)
            for count, direction in ((3, 1), (2, -1), (1, 1), (1, -1))
        )
        cell = StepCell(label=f"{axis}{angle:+.2f}", kind="free", values={"amplitude_rad": angle}, lead=row)
        cells.append(countered(cell, axis, angle, settings))
    return cells


THREE_TWO_ONE_ONE = Profile(
    "3-2-1-1",
    "tilt for 3, 2, 1 and 1 units of time, to alternate sides",
    (
        AXIS,
        Field("amplitude_rad", "numbers", "tilt asked for", "rad", 0.02, 1.05),
        SIGN,
        Field("unit_s", "number", "one unit of time", "s", 0.05, 5.0, default=0.3),
        ENTRY,
        COAST,
    ),
    _three_two_one_one,
)
