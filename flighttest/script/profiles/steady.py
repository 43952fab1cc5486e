"""Flights without a step: hover, rest with motors off, and free flight through waypoints."""

from __future__ import annotations

import math
from itertools import pairwise

from flighttest.script.profiles.declare import Field, Profile, Settings, StepCell
from flighttest.script.profiles.timeline import Piece


def _hover(settings: Settings, throttle_unit: float) -> list[StepCell]:
    return [
        StepCell(
            label="hover" + ("" if height is None else f"@{height:g}m"),
            kind="free",
            values={} if height is None else {"height_m": height},
            lead=(Piece("hover", settings["duration_s"], record=True),),
            height_m=height,
        )
        for height in settings["height_m"] or (None,)
    ]


HOVER = Profile(
    "hover",
    "level flight at hover throttle",
    (
        Field("duration_s", "number", "how long", "s", 0.5, 60.0, default=5.0),
        Field("height_m", "numbers", "height above the ground", "m", 0.1, 120.0, optional=True),
    ),
    _hover,
)


def _rest(settings: Settings, throttle_unit: float) -> list[StepCell]:
    return [
        StepCell(
            label="rest",
            kind="rest",
            values={},
            lead=(Piece("rest", settings["duration_s"], throttle=0.0, record=True),),
            motors_off=True,
        )
    ]


REST = Profile(
    "rest",
    "on the ground with motors off: shows the accelerometer's bias",
    (Field("duration_s", "number", "how long", "s", 1.0, 300.0, default=5.0),),
    _rest,
)


def _free_flight(settings: Settings, throttle_unit: float) -> list[StepCell]:
    points, speed = settings["waypoints"], settings["speed_m_s"]
    cells = []
    for pace in speed:
        t = 0.0
        timed = [(0.0, *points[0])]
        for here, there in pairwise(points):
            t += max(math.dist(here, there) / pace, 0.2)
            timed.append((t, *there))
        cells.append(
            StepCell(
                label=f"free {pace:g}m/s",
                kind="free",
                values={"speed_m_s": pace},
                lead=(Piece("free", t + settings["settle_s"], record=True),),
                waypoints=tuple(timed),
            )
        )
    return cells


FREE_FLIGHT = Profile(
    "free_flight",
    "through waypoints, flown by an outer loop over attitude targets",
    (
        Field("waypoints", "points", "list of [x, y, z] in the zone's frame", "m", -2000.0, 2000.0),
        Field("speed_m_s", "numbers", "pace along the straight lines between them", "m/s", 0.2, 25.0, default=(3.0,)),
        Field("settle_s", "number", "time at the last waypoint", "s", 0.0, 20.0, default=1.0),
    ),
    _free_flight,
)
