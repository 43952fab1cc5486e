"""The space a step needs, and where in the zone it can start: boxes about the start, rotated by heading, with the link lost too."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flighttest.plan.model import FloatArray
from flighttest.script.model import Limits
from flighttest.vehicle.model import Zone

# What BRAKE can be relied on for, of the 7.5 m/s^2 that ArduCopter asks of itself: from 5 m/s it took 9 m, from 8.5 m/s 16 m (flown).
BRAKE_M_S2 = 3.0
# The gate judges what is measured; measured heights differ from predicted ones by as much.
GATE_SLACK_M = 0.4
# What a start that just fits loses to rounding.
ROUNDING_M = 1e-3
AXIS_WORDS = ("along the zone", "across the zone", "in height")


@dataclass(frozen=True)
class Clearance:
    """Where the vehicle may be: inner box for the flight as planned, outer for a lost link; (3,) low and high, zone frame.

    gate_m: (low, high) heights the gate allows, counting where the supervisor's stop would end.
    """

    inner_low: FloatArray
    inner_high: FloatArray
    outer_low: FloatArray
    outer_high: FloatArray
    gate_m: tuple[float, float]

    @classmethod
    def of(cls, zone: Zone, limits: Limits) -> Clearance:
        """The zone with its margin, cut to the script's heights; a script's own floor replaces the zone's."""
        low = np.array([zone.x_m[0], zone.y_m[0], zone.z_m[0]])
        high = np.array([zone.x_m[1], zone.y_m[1], zone.z_m[1]])
        inner_low, inner_high = low + zone.margin_m, high - zone.margin_m
        floor = float(low[2])
        if limits.floor_m is not None:
            floor = limits.floor_m
            inner_low[2], low[2] = floor, 0.5 * floor
        inner_low[2] = max(inner_low[2], limits.height_m[0])
        inner_high[2] = min(inner_high[2], limits.height_m[1])
        gate = (max(floor, limits.height_m[0]), min(float(high[2]), limits.height_m[1]))
        return cls(inner_low, inner_high, low, high, gate)


@dataclass(frozen=True)
class Track:
    """A predicted flight relative to its start, vehicle's starting heading along x: p_m, v_m_s (m, 3), t_s (m,).

    reach_m: (low, high) heights it would stay between if the supervisor stopped it at its worst moment; of a flight as planned.
    """

    t_s: FloatArray
    p_m: FloatArray
    v_m_s: FloatArray
    reach_m: tuple[float, float] = (0.0, 0.0)

    def turned(self, angle_rad: float) -> Track:
        """The same flight with the vehicle turned by angle_rad."""
        turn = turning(angle_rad)
        return Track(self.t_s, self.p_m @ turn.T, self.v_m_s @ turn.T, self.reach_m)


def turning(angle_rad: float) -> FloatArray:
    """The matrix that turns vectors by an angle about the vertical, (3, 3)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Excess:
    """By how much a flight leaves where it may be: metres, seconds from the leg's start, which axis and side, and when: as planned, with
    the link lost, or stopped by the supervisor."""

    metres: float
    t_s: float
    axis: int
    high: bool
    lost: bool
    stopped: bool = False

    @property
    def words(self) -> str:
        """Where it leaves, in an operator's words."""
        side = ("below the floor", "above the ceiling")[self.high] if self.axis == 2 else AXIS_WORDS[self.axis]
        lost = " with the link lost at the worst moment" if self.lost else ""
        if self.stopped:
            return f"{self.metres:.2f} m {side} if it had to be stopped at the worst moment"
        return f"{max(self.metres, 0.01):.{1 if self.metres >= 0.1 else 2}f} m {side} at {self.t_s:.1f} s{lost}"


@dataclass(frozen=True)
class Placement:
    """A start in the zone, the heading it was found for, and the worst excess there (None: it fits).

    fence: a lost link is contained only because a fence brakes the vehicle at the zone's margin.
    """

    start_m: tuple[float, float, float]
    heading_rad: float
    excess: Excess | None
    fence: bool = False


def box(tracks: list[Track]) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner of all tracks: two (3,)."""
    return (
        np.min([track.p_m.min(axis=0) for track in tracks], axis=0),
        np.max([track.p_m.max(axis=0) for track in tracks], axis=0),
    )


def place(
    nominal: list[Track],
    lost: list[Track],
    clearance: Clearance,
    wish_m: tuple[float, float, float],
    headings_rad: list[float],
    height_m: float | None = None,
) -> Placement:
    """A start near the wish from which every flight stays where it may be, under the first heading that allows one.

    headings_rad: relative to the zone's x axis, in order of preference. height_m: start height, where it is not free.
    """
    best: Placement | None = None
    flights = _Flights(nominal, lost)
    # A heading under which even a lost link stays inside by itself goes before one that needs the fence.
    for heading, fence in [(heading, fence) for fence in (False, True) for heading in headings_rad]:
        found = _place(flights, clearance, wish_m, heading, height_m, fence)
        if found.excess is None:
            return found
        if best is None or best.excess is None or found.excess.metres < best.excess.metres:
            best = found
    assert best is not None
    return best


class _Flights:
    """All flights of a step, and the boxes they take under each heading that was asked for."""

    def __init__(self, nominal: list[Track], lost: list[Track]) -> None:
        self.nominal, self.lost = nominal, lost
        self._places = [np.concatenate([track.p_m.T for track in some], axis=1) for some in (nominal, lost or nominal)]
        self._boxes: dict[float, list[tuple[FloatArray, FloatArray]]] = {}

    def boxes(self, heading_rad: float) -> list[tuple[FloatArray, FloatArray]]:
        """Lowest and highest corner of the flights as planned, and of those with the link lost."""
        if heading_rad not in self._boxes:
            turned = [turning(heading_rad) @ p for p in self._places]
            self._boxes[heading_rad] = [(p.min(axis=1), p.max(axis=1)) for p in turned]
        return self._boxes[heading_rad]

    def worst(self, clearance: Clearance, start: FloatArray, heading_rad: float, fence: bool) -> Excess | None:
        """See `worst`. What stays inside by its boxes needs no closer look."""
        (low, high), (lost_low, lost_high) = self.boxes(heading_rad)
        outside = max(
            float(np.max([clearance.inner_low - start - low, start + high - clearance.inner_high])),
            float(np.max([clearance.outer_low - start - lost_low, start + lost_high - clearance.outer_high])),
        )
        below, above = _reach(self.nominal)
        if (
            max(outside, clearance.gate_m[0] - start[2] - below, start[2] + above - clearance.gate_m[1])
            <= 0.5 * ROUNDING_M
        ):
            return None
        turned = [[track.turned(heading_rad) for track in some] for some in (self.nominal, self.lost)]
        return worst(turned[0], turned[1], clearance, start, fence)


def _place(
    flights: _Flights,
    clearance: Clearance,
    wish_m: tuple[float, float, float],
    heading: float,
    height_m: float | None,
    fence: bool,
) -> Placement:
    (low, high), (lost_low, lost_high) = flights.boxes(heading)
    # Starts that keep the flight as planned inside, and those that contain a lost link without a fence as well.
    from_inner, to_inner = clearance.inner_low - low, clearance.inner_high - high
    reach = _reach(flights.nominal)
    from_inner[2] = max(from_inner[2], clearance.gate_m[0] + GATE_SLACK_M - reach[0])
    to_inner[2] = min(to_inner[2], clearance.gate_m[1] - GATE_SLACK_M - reach[1])
    from_outer, to_outer = (
        np.maximum(from_inner, clearance.outer_low - lost_low),
        np.minimum(to_inner, clearance.outer_high - lost_high),
    )
    candidates: list[list[float]] = []
    for axis in range(3):
        if axis == 2 and height_m is not None:
            candidates.append([height_m])
        elif from_outer[axis] <= to_outer[axis]:
            candidates.append([float(np.clip(wish_m[axis], from_outer[axis], to_outer[axis]))])
        elif fence and from_inner[axis] <= to_inner[axis] and axis < 2:
            # The fence has to help: try the wish and both ends.
            span = (float(from_inner[axis]), float(to_inner[axis]))
            candidates.append([float(np.clip(wish_m[axis], *span)), *span])
        else:
            middle = 0.5 * (from_outer[axis] + to_outer[axis])
            candidates.append([float(middle)])
    best: Placement | None = None
    for x in candidates[0]:
        for y in candidates[1]:
            start = np.array([x, y, candidates[2][0]])
            excess = flights.worst(clearance, start, heading, fence)
            found = Placement((float(x), float(y), float(start[2])), heading, excess, fence)
            if excess is None:
                return found
            if best is None or best.excess is None or excess.metres < best.excess.metres:
                best = found
    assert best is not None
    return best


def worst(
    nominal: list[Track], lost: list[Track], clearance: Clearance, start: FloatArray, fence: bool
) -> Excess | None:
    """The largest excess of flights that start there (already turned), None when all stay where they may be.

    fence: sideways, a fence at the inner line may brake a vehicle whose link is lost.
    """
    found: Excess | None = None
    for track in nominal:
        over = _beyond(track.p_m + start, clearance.inner_low, clearance.inner_high)
        found = _larger(found, _excess(track, over, lost=False))
    below, above = _reach(nominal)
    for metres, high in (
        (clearance.gate_m[0] - start[2] - below, False),
        (start[2] + above - clearance.gate_m[1], True),
    ):
        if metres > ROUNDING_M:
            found = _larger(found, Excess(float(metres), 0.0, 2, high, lost=False, stopped=True))
    for track in lost:
        p = track.p_m + start
        over = _beyond(p, clearance.outer_low, clearance.outer_high)
        # Sideways the fence brakes at the inner line: what counts is where that stops the vehicle. Before it, nothing does.
        stop = _beyond(p, clearance.inner_low, clearance.inner_high)
        for axis in (0, 1) if fence else ():
            for side in (0, 1):
                crossed = stop[:, axis, side] > 0.0
                if bool(np.any(crossed)):
                    k = int(np.argmax(crossed))
                    speed = max(0.0, float(track.v_m_s[k, axis]) * (1.0 if side else -1.0))
                    margin = float(
                        clearance.outer_high[axis] - clearance.inner_high[axis]
                        if side
                        else clearance.inner_low[axis] - clearance.outer_low[axis]
                    )
                    # The product is infinite where the power of a float raises OverflowError: a model that diverges.
                    over[:, axis, side] = np.minimum(over[:, axis, side], speed * speed / (2.0 * BRAKE_M_S2) - margin)
        found = _larger(found, _excess(track, over, lost=True))
    return found


def _reach(tracks: list[Track]) -> tuple[float, float]:
    return min((track.reach_m[0] for track in tracks), default=0.0), max(
        (track.reach_m[1] for track in tracks), default=0.0
    )


def _beyond(p: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """How far each sample is beyond each side: (m, 3, 2) m, negative inside."""
    return np.stack([low - p, p - high], axis=-1)


def _excess(track: Track, over: FloatArray, lost: bool) -> Excess | None:
    if float(over.max()) <= ROUNDING_M:
        return None
    k, axis, side = np.unravel_index(int(np.argmax(over)), over.shape)
    return Excess(float(over.max()), float(track.t_s[k]), int(axis), bool(side), lost)


def _larger(a: Excess | None, b: Excess | None) -> Excess | None:
    if a is None or b is None:
        return a or b
    return a if a.metres >= b.metres else b
