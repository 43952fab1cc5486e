"""Throttle steps: pairs T_0 to T_1 as in the paper, and the same while tilted. Each gets a throttle stop phase of its own."""

from __future__ import annotations

from itertools import product

from flighttest.script.profiles.attitude import AXIS, countered, tilt, tilts
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
)
from flighttest.script.profiles.timeline import Piece

# Six time constants of the paper's thrust lag: what was asked before the step has then died away to 0.2 %.
SHORTEST_HOLD_S = 0.3

THROTTLE_0 = Field("throttle_0", "numbers", "throttle before the step", throttle=True)
THROTTLE_1 = Field("throttle_1", "numbers", "throttle after the step", throttle=True)
HOLD_0 = Field("hold_0_s", "duration", "how long throttle_0 is held", "s", 0.1, 20.0, default=Duration(0.6, True))
RECORD_1 = Field("record_1_s", "duration", "how long throttle_1 is held", "s", 0.1, 20.0, default=Duration(1.5, True))


def _no_step(settings: Settings) -> str | None:
    if any(first != second for first, second in product(settings["throttle_0"], settings["throttle_1"])):
        return None
    return "throttle_0 and throttle_1 are the same: there is no step"


def _pairs(settings: Settings, throttle_unit: float) -> list[StepCell]:
    hold, record = settings["hold_0_s"], settings["record_1_s"]
    cells = []
    for height in settings["height_m"] or (None,):
        for first in settings["throttle_0"]:
            for second in settings["throttle_1"]:
                if first == second:
                    continue
                values = {"throttle_0": first * throttle_unit, "throttle_1": second * throttle_unit}
                if height is not None:
                    values["height_m"] = height
                cells.append(
                    StepCell(
                        label=f"{first:.2f}-{second:.2f}" + ("" if height is None else f"@{height:g}m"),
                        kind="throttle_step",
                        values=values,
                        lead=(
                            Piece("entry", settings["entry_s"]),
                            Piece("hold_0", hold.seconds, throttle=first * throttle_unit),
                            Piece("step", record.seconds, throttle=second * throttle_unit, record=True),
                        ),
                        shortest_s=shortest(hold_0=(hold, min(SHORTEST_HOLD_S, hold.seconds)), step=(record, None)),
                        stops=("vertical",),
                        tail=(Piece("settle", settings["settle_s"]),),
                        height_m=height,
                    )
                )
    return cells


THROTTLE_PAIR = Profile(
    "throttle_pair",
    "throttle T_0, then a step to T_1, then whatever throttle stops the climb or descent",
    (
        THROTTLE_0,
        THROTTLE_1,
        HOLD_0,
        RECORD_1,
        Field("height_m", "numbers", "height above the ground at the step", "m", 0.1, 120.0, optional=True),
        Field("entry_s", "number", "level flight before throttle_0", "s", 0.1, 10.0, default=0.3),
        Field("settle_s", "number", "level flight after the stop", "s", 0.0, 20.0, default=0.3),
    ),
    _pairs,
    check=_no_step,
)


def _tilted(settings: Settings, throttle_unit: float) -> list[StepCell]:
    hold, record = settings["hold_0_s"], settings["record_1_s"]
    cells = []
    for axis, angle in tilts(settings, "tilt_rad"):
        for first, second in product(settings["throttle_0"], settings["throttle_1"]):
            if first == second:
                continue
            before, after = first * throttle_unit, second * throttle_unit
            cell = StepCell(
                label=f"{axis}{angle:+.2f},{first:.2f}-{second:.2f}",
                kind="tilt_throttle",
                values={"amplitude_rad": angle, "throttle_0": before, "throttle_1": after},
                lead=(
                    tilt("hold_0", hold.seconds, axis, angle, throttle=before),
                    tilt("step", record.seconds, axis, angle, record=True, throttle=after),
                ),
                shortest_s=shortest(hold_0=(hold, min(0.5, hold.seconds)), step=(record, None)),
            )
            cells.append(countered(cell, axis, angle, settings, vertical=True))
    return cells


TILT_THROTTLE = Profile(
    "tilt_throttle",
    "a throttle step while tilted: separates drag that scales with thrust from drag that does not",
    (
        AXIS,
        Field("tilt_rad", "numbers", "tilt asked for", "rad", 0.02, 1.05),
        SIGN,
        THROTTLE_0,
        THROTTLE_1,
        HOLD_0,
        RECORD_1,
        ENTRY,
        COAST,
    ),
    _tilted,
    check=_no_step,
)
