"""What a step response looks like in the numbers engineers ask for first. None where a number has no meaning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

_BEFORE_S = 0.2
_TAIL_S = 0.15
_ONSET = 0.05  # of the change
_BAND = 0.05
_NOISE_SIGMAS = 4.0
_CHANNEL = {
    "roll_step": ("roll_rad", "roll_ref_rad"), "pitch_step": ("pitch_rad", "pitch_ref_rad"),
    "yaw_rate_step": ("r_rad_s", "yaw_rate_ref_rad_s"), "throttle_step": ("f_z_m_s2", None), "tilt_throttle": ("f_z_m_s2", None),
}  # fmt: skip


@dataclass(frozen=True)
class Metrics:
    """Of one step response, on the channel that was stepped.

    delay_s: from the recorded step to the first 5 % of the change (or where it leaves the noise, if later). rise_s: rise time, 10 to 90 %.
    overshoot: beyond the final value, as a share of the change. settling_s: from the step until it stays within 5 % of the change.
    steady_error: final value minus reference, rad or rad/s; None for throttle, whose reference is no acceleration.
    change: final minus initial value, rad, rad/s or m/s^2.
    """

    channel: str
    change: float | None = None
    delay_s: float | None = None
    rise_s: float | None = None
    overshoot: float | None = None
    settling_s: float | None = None
    steady_error: float | None = None


def metrics_of(segment: Segment) -> Metrics | None:
    """Metrics of a step; None for free flight and for steps whose channel was not recorded."""
    if segment.kind not in _CHANNEL:
        return None
    channel, reference = _CHANNEL[segment.kind]
    if channel not in segment.y:
        channel = "a_z_m_s2" if channel == "f_z_m_s2" else channel
        if channel not in segment.y:
            return None
    later = segment.context.later_edges_s
    end = min(later) if later else float(segment.t_s[-1]) if segment.t_s.size else segment.t_step_s
    good = np.isfinite(segment.y[channel]) & (segment.t_s <= end)
    t, y = segment.t_s[good] - segment.t_step_s, segment.y[channel][good]
    before = y[(t >= -_BEFORE_S) & (t <= 0.0)]
    after_t, after = t[t >= 0.0], y[t >= 0.0]
    if before.size < 2 or after.size < 4:
        return Metrics(channel)
    start = float(np.mean(before))
    tail = after[after_t >= after_t[-1] - _TAIL_S]
    final = float(np.mean(tail))
    wanted = _wanted(segment, reference)
    change = wanted if wanted is not None else final - start
    noise = float(np.std(before))
    if abs(change) < max(3.0 * noise, 1e-6):
        return Metrics(channel, change=final - start)
    part = (after - start) / change
    threshold = max(_ONSET, _NOISE_SIGMAS * noise / abs(change))
    reached = (final - start) / change
    settled = bool(np.all(np.abs((tail - final) / change) <= _BAND))
    low, high = crossing(after_t, part, 0.1), crossing(after_t, part, 0.9)
    peak = float(np.max(part))
    return Metrics(
        channel,
        change=final - start,
        delay_s=crossing(after_t, part, threshold) if threshold < 0.5 else None,
        rise_s=high - low if low is not None and high is not None and high > low else None,
        overshoot=max(peak - reached, 0.0) if settled else None,
        settling_s=_settling(after_t, part, reached) if settled else None,
        steady_error=(final - start - wanted) if settled and wanted is not None else None,
    )


def _wanted(segment: Segment, reference: str | None) -> float | None:
    """The change of the reference at the step; None where there is no reference in the channel's unit."""
    if reference is None or reference not in segment.u:
        return None
    return next((v for k, v in segment.cell.items() if k in ("amplitude_rad", "rate_rad_s")), None)


def crossing(t: FloatArray, part: FloatArray, level: float) -> float | None:
    """First of the times t (n,) at which part (n,) has risen to a level, linear between samples; None where it never does."""
    above = np.flatnonzero(part >= level)
    if above.size == 0:
        return None
    i = int(above[0])
    if i == 0:
        return float(t[0])
    share = (level - part[i - 1]) / (part[i] - part[i - 1])
    return float(t[i - 1] + share * (t[i] - t[i - 1]))


def _settling(t: FloatArray, part: FloatArray, reached: float) -> float | None:
    outside = np.flatnonzero(np.abs(part - reached) > _BAND)
    if outside.size == 0:
        return 0.0
    last = int(outside[-1])
    return float(t[last + 1]) if last + 1 < t.size else None
