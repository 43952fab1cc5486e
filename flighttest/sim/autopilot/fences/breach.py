"""Which parts of the fence a place breaches, and the mode that follows. Pure functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.autopilot import modes
from flighttest.sim.autopilot.parameters import ParameterStore
from flighttest.sim.autopilot.vehicle import FenceArea

MAX_ALTITUDE, CIRCLE, POLYGON = 1, 2, 4
_INCLUSION = dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
_EXCLUSION = dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
_CIRCLES = (dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)


@dataclass(frozen=True)
class Area:
    """A part of the fence in the vehicle's frame (NWU about home, m): a polygon's corners, or the centre and radius of a circle.

    inclusion: whether it must not be left, instead of not be entered.
    """

    inclusion: bool
    corners: tuple[tuple[float, float], ...]
    radius_m: float | None = None

    def holds(self, px: float, py: float) -> bool:
        """Whether a place lies in it."""
        if self.radius_m is not None:
            (x, y) = self.corners[0]
            return math.hypot(px - x, py - y) <= self.radius_m
        inside, last = False, self.corners[-1]
        for corner in self.corners:  # even-odd rule
            (x0, y0), (x1, y1) = last, corner
            if (y0 > py) != (y1 > py) and px < x0 + (py - y0) * (x1 - x0) / (y1 - y0):
                inside = not inside
            last = corner
        return inside


def areas_of(items: Sequence[tuple[int, float, tuple[float, float]]]) -> tuple[Area, ...] | None:
    """Areas from items (command, param1, place), None where they do not make a fence: a polygon's corners must all be there."""
    found: list[Area] = []
    at = 0
    while at < len(items):
        command, first, place = items[at]
        if command in _CIRCLES:
            if not first > 0.0:
                return None
            found.append(Area(command == _CIRCLES[0], (place,), first))
            at += 1
            continue
        count = int(first)
        part = items[at : at + count]
        alike = len(part) == count and all(c == command and n == first for c, n, _ in part)
        if command not in (_INCLUSION, _EXCLUSION) or count < 3 or not alike:
            return None
        found.append(Area(command == _INCLUSION, tuple(p for _, _, p in part)))
        at += count
    return tuple(found)


def fence_breaches(
    store: ParameterStore,
    in_force: int,
    areas: Sequence[FenceArea],
    px: float,
    py: float,
    pz: float,
    *,
    has_position: bool,
) -> int:
    """FENCE_TYPE bits that are breached now, of those in force: 1 ceiling, 2 circle about home, 4 polygons and circles brought aboard."""
    kind, found = in_force, 0
    if kind & MAX_ALTITUDE and pz > store["FENCE_ALT_MAX"]:
        found |= MAX_ALTITUDE
    if kind & CIRCLE and has_position and math.hypot(px, py) > store["FENCE_RADIUS"]:
        found |= CIRCLE
    if kind & POLYGON and has_position and any(area.holds(px, py) != area.inclusion for area in areas):
        found |= POLYGON
    return found


def fence_mode(action: int, *, has_position: bool) -> int | None:
    """The mode FENCE_ACTION asks for, or None for a report only."""
    if action <= 0:
        return None
    if action in (1, 3):
        return modes.RTL if has_position else modes.LAND
    if action == 4:
        return modes.BRAKE if has_position else modes.LAND
    return modes.LAND


def breach_words(breaches: int) -> str:
    """What the firmware reports of a new breach."""
    if breaches & MAX_ALTITUDE:
        return "Max Alt fence breached"
    return "Circle fence breached" if breaches & CIRCLE else "Polygon fence breached"
