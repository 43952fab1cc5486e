"""From the ground's clock to the vehicle's: the clock offset, its drift and the error bound of both.

Messages that carry the vehicle's time give a one-sided bound each, since delays only ever add: the least delayed of each few
seconds follow the drift (which is not always linear: a busy flight controller loses ticks). What they cannot determine is the shortest
one-way delay itself. A TIMESYNC round trip bounds that from both sides: the sample with the smallest round trip is used, not the mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flighttest.errors import RecordingError

FloatArray = NDArray[np.float64]

_DRIFT_MAX = (
    5e-4  # a worse crystal than this does not fly; above it the vehicle is a simulator that runs at its own pace
)
_WINDOW_S = 10.0  # long enough to hold an undelayed message, short against the changes of a drift
_PACED_WINDOW_S = 0.5
_QUICK_S = 1e-3  # round trips this near to the quickest give the offset as well as it does
_ONE_WAY_ERROR_S = 0.05  # what a one-way estimate may be wrong by: the shortest delay of a usual telemetry link


@dataclass(frozen=True)
class ClockEstimate:
    """Vehicle time as a piecewise linear function of ground time.

    ground_s, vehicle_s: (m,) s, knots, m >= 1, both increasing. rate: vehicle seconds per ground second beyond the knots.
    error_s: half the smallest round trip, or the usual one-way delay. method: timesync, target stamps, one-way or paced.
    """

    ground_s: FloatArray
    vehicle_s: FloatArray
    rate: float
    error_s: float
    method: str

    @property
    def offset_s(self) -> float:
        """Ground minus vehicle time at the first knot, s."""
        return float(self.ground_s[0] - self.vehicle_s[0])

    def shifted(self, shift_s: float, error_s: float, method: str) -> ClockEstimate:
        """The same course of the drift, with vehicle times later by shift_s."""
        return replace(self, vehicle_s=self.vehicle_s + shift_s, error_s=error_s, method=method)

    def to_vehicle(self, ground_s: ArrayLike) -> FloatArray:
        """Ground times, any shape, s, as vehicle times, s."""
        g = np.asarray(ground_s, dtype=float)
        inside = np.interp(g, self.ground_s, self.vehicle_s)
        before = np.minimum(g - self.ground_s[0], 0.0) * self.rate
        after = np.maximum(g - self.ground_s[-1], 0.0) * self.rate
        return np.asarray(inside + before + after)


def estimate_clock(ground_s: ArrayLike, vehicle_s: ArrayLike, round_trips: ArrayLike = ()) -> ClockEstimate:
    """Estimate the vehicle's clock from what was received.

    ground_s, vehicle_s: (n,) s, receive times and stamps of messages with the vehicle's time. round_trips: (k, 3) s,
    ground time of a TIMESYNC request, the vehicle's time in the answer, ground time of the answer. RecordingError when both are empty.
    """
    g = np.asarray(ground_s, dtype=float)
    v = np.asarray(vehicle_s, dtype=float)
    trips = np.asarray(round_trips, dtype=float).reshape(-1, 3)
    if g.size == 0 and trips.shape[0] == 0:
        raise RecordingError(
            "no message carries the vehicle's time", "request ATTITUDE or LOCAL_POSITION_NED, or answer TIMESYNC"
        )
    if g.size == 0:
        g, v = trips[:, 2], trips[:, 1]
    order = np.argsort(g, kind="stable")
    g, v = g[order], v[order]
    pace = _pace(g, v)
    if abs(pace - 1.0) > _DRIFT_MAX and g[-1] - g[0] > 2.0:
        knots_g, knots_v = _paced_knots(g, v, pace)
        return ClockEstimate(knots_g, knots_v, pace, _ONE_WAY_ERROR_S * pace, "paced")
    knots_g, offset = _least_delayed(g, g - v)
    one_way = ClockEstimate(knots_g, knots_g - offset, 1.0, _ONE_WAY_ERROR_S, "one-way")
    if not trips.shape[0]:
        return one_way
    round_trip = trips[:, 2] - trips[:, 0]
    best = float(np.min(round_trip))
    # Of the quickest trips the median: one of them may lie before a simulator took up the ground's pace.
    quick = trips[round_trip <= best + _QUICK_S]
    shift = float(np.median(quick[:, 1] - one_way.to_vehicle(0.5 * (quick[:, 0] + quick[:, 2]))))
    return one_way.shifted(shift, 0.5 * best, "timesync")


def _pace(g: FloatArray, v: FloatArray) -> float:
    """Vehicle seconds per ground second, overall."""
    if g.size < 2 or g[-1] - g[0] < 1e-3:
        return 1.0
    tenth = max(g.size // 10, 1)
    span = float(np.median(g[-tenth:]) - np.median(g[:tenth]))
    if span < 2.0:  # too short to distinguish a pace from jitter
        return 1.0
    pace = float((np.median(v[-tenth:]) - np.median(v[:tenth])) / span)
    return pace if abs(pace - 1.0) > _DRIFT_MAX + 0.05 / span else 1.0


def _least_delayed(g: FloatArray, late: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Knots (ground time, offset) of the least delayed messages, no steeper than a crystal can drift (a congested link is)."""
    first = _first_by_window(g, late, _WINDOW_S)
    knots, least = g[first], late[first]
    reach = least[None, :] + _DRIFT_MAX * np.abs(knots[:, None] - knots[None, :])
    return knots, np.asarray(reach.min(axis=1))


def _first_by_window(g: FloatArray, late: FloatArray, width_s: float) -> NDArray[np.int64]:
    """Index of the least late sample in each window of ground time."""
    window = np.floor((g - g[0]) / width_s).astype(int)
    order = np.lexsort((late, window))
    first = order[np.unique(window[order], return_index=True)[1]]
    return np.asarray(first[np.argsort(g[first], kind="stable")])


def _paced_knots(g: FloatArray, v: FloatArray, pace: float) -> tuple[FloatArray, FloatArray]:
    """Knots of a clock that runs at its own pace: in each window the sample that came with the least delay."""
    first = _first_by_window(g, g - v / pace, _PACED_WINDOW_S)
    knots_g, knots_v = g[first], v[first]
    keep = np.concatenate([[True], np.diff(np.maximum.accumulate(knots_v)) > 0])
    return knots_g[keep], knots_v[keep]
