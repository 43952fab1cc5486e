"""Channels of different rates on one time base, without moving any sample in time (but what the log stamped late:
`compatibility`).

The time base is that of the accelerometer (else attitude) as stamped, thinned by centred averages to about 50 Hz. Fast channels are
averaged the same way and read off linearly; slow ones (EKF, battery) linearly. Specific force that `compatibility` moved by a part of its
period is read off between its samples by piecewise cubics: it has passed a low-pass filter. Rates need not have, and jump; they stay on
samples of their own. Attitude or rates logged much slower than the time base keep their own sample times and are NaN elsewhere: a 10 Hz
attitude read off in between would be a polygon, not a response.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from flighttest.channels import HELD_GROUPS, names
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.recording import Recording, Series
from flighttest.segments.airborne import flights
from flighttest.segments.compatibility import Compatibility, compatibility, corrected

FloatArray = NDArray[np.float64]

RATE_MAX_HZ = 62.0
_WINDOW_S = 0.0101  # average no longer than this: longer would smear the first milliseconds of a response
_GAP_PERIODS = 3.0
_ABOUT_S = 1.0
_FEW_GAPS = 4
_OWN_TIMES_BELOW = 0.6
_FAST = ("attitude", "rates", "specific_force")


@dataclass(frozen=True)
class Aligned:
    """Series ready to be cut: t_s (n,) the time base; per group its averaged Series and its rate; own: groups that keep their
    own times; compatibility: what was corrected by kinematics, None: not known."""

    t_s: FloatArray
    groups: dict[str, Series]
    rates_hz: dict[str, float]
    own: frozenset[str]
    compatibility: Compatibility | None = None


def prepare_motion(recording: Recording) -> Aligned | None:
    """Average and choose the time base; None where the recording has no motion at all."""
    moving = [
        g
        for g in ("specific_force", "attitude", "rates", "acceleration", "velocity", "position")
        if g in recording.series
    ]
    moving = [g for g in moving if len(recording.series[g]) > 2]
    if not moving:
        return None
    fastest = max(recording.series[g].rate_hz for g in moving[:2])
    base_group = next(g for g in moving if recording.series[g].rate_hz >= _OWN_TIMES_BELOW * min(fastest, RATE_MAX_HZ))
    base = recording.series[base_group]
    groups: dict[str, Series] = {}
    own: set[str] = set()
    for group, series in recording.series.items():
        if len(series) < 2 or (group in HELD_GROUPS and group != "shaped"):
            continue
        if (
            group == "shaped"
        ):  # a target jumps: it holds until the next, and is neither averaged nor read off between samples
            groups[group] = series
            continue
        series = _unwrapped(series)
        groups[group] = _averaged(series)
        if group in _FAST and series.rate_hz < _OWN_TIMES_BELOW * min(base.rate_hz, RATE_MAX_HZ):
            own.add(group)
    t_s = groups[base_group].t_s
    found = compatibility(groups, flights(recording), recording.provenance.filters.get("specific_force"))
    if found is not None:
        groups = corrected(groups, found)
    if base.rate_hz > RATE_MAX_HZ:
        thin = int(np.ceil(base.rate_hz / RATE_MAX_HZ))
        t_s = _thinned(t_s, thin, groups.get("velocity"))
    return Aligned(t_s, groups, {g: s.rate_hz for g, s in groups.items()}, frozenset(own), found)


def _thinned(t_s: FloatArray, every: int, velocity: Series | None) -> FloatArray:
    """One time in so many, on velocity samples where that can be: a chord between two of those cuts the corner of a step."""
    begin = every // 2
    if velocity is not None and len(velocity) > 1:
        off = [float(np.median(_distance(velocity.t_s, t_s[k::every]))) for k in range(every)]
        begin = min(range(every), key=lambda k: (round(off[k], 4), abs(k - begin)))
    return t_s[begin::every]


def _distance(wanted: FloatArray, t_s: FloatArray) -> FloatArray:
    """From each wanted time to the nearest of t_s, s."""
    if t_s.size < 2:
        return np.abs(wanted - t_s[0]) if t_s.size else np.full(wanted.shape, np.inf)
    right = np.clip(np.searchsorted(t_s, wanted), 1, t_s.size - 1)
    return np.minimum(np.abs(wanted - t_s[right - 1]), np.abs(t_s[right] - wanted))


def sample(aligned: Aligned, start_s: float, end_s: float) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Sample times (n,) in [start_s, end_s] and every channel at them; world acceleration is added where it follows from f."""
    t = aligned.t_s[np.searchsorted(aligned.t_s, start_s) : np.searchsorted(aligned.t_s, end_s, side="right")]
    for group in aligned.own:
        times = aligned.groups[group].t_s
        t = np.union1d(t, times[np.searchsorted(times, start_s) : np.searchsorted(times, end_s, side="right")])
    y: dict[str, FloatArray] = {}
    for group, series in aligned.groups.items():
        if group in HELD_GROUPS:
            y.update(_held(series, aligned.rates_hz[group], t))
        else:
            moved = group == "specific_force" and aligned.compatibility is not None
            y.update(_at_own(series, t) if group in aligned.own else _read(series, aligned.rates_hz[group], t, moved))
    if "a_x_m_s2" not in y and {*names("specific_force"), "roll_rad", "pitch_rad", "yaw_rad"} <= set(y):
        y.update(_world_acceleration(aligned, t, y))
    return t, y


def _unwrapped(series: Series) -> Series:
    """Yaw without its jumps of a full turn, so that it can be averaged and read off."""
    if "yaw_rad" not in series.columns:
        return series
    yaw = series.columns["yaw_rad"].copy()
    finite = np.isfinite(yaw)
    yaw[finite] = np.unwrap(yaw[finite])
    return Series(series.t_s, {**series.columns, "yaw_rad": yaw})


def _averaged(series: Series) -> Series:
    """Centred running averages over at most _WINDOW_S; times are averaged alike, so that nothing is delayed."""
    width = int(series.rate_hz * _WINDOW_S + 1e-6)
    if width < 2 or len(series) < width:
        return series
    kernel = np.full(width, 1.0 / width)
    steady = np.convolve(series.t_s - series.t_s[0], kernel, "valid") + series.t_s[0]
    # A window across a gap would mix what lies on both sides of it.
    inside = series.t_s[width - 1 :] - series.t_s[: len(series) - width + 1] < 2.0 * width / series.rate_hz
    # What no window holds came one by one, where the stream was slower, and stays as it is.
    single = np.convolve(inside, np.ones(width)) < 0.5
    t_s = np.concatenate([steady[inside], series.t_s[single]])
    order = np.argsort(t_s, kind="stable")
    averaged = {n: np.convolve(v, kernel, "valid")[inside] for n, v in series.columns.items()}
    return Series(t_s[order], {n: np.concatenate([averaged[n], v[single]])[order] for n, v in series.columns.items()})


def _period(series: Series, rate_hz: float, t: FloatArray) -> float:
    """The usual time between samples, s: of the whole series, or about `t` where it is longer there.

    A ground station may ask for a stream at full rate while the vehicle stands, and at a tenth of it in the air.
    """
    here = slice(*np.searchsorted(series.t_s, [t[0] - _ABOUT_S, t[-1] + _ABOUT_S])) if t.size else slice(0)
    gaps = np.diff(series.t_s[here])
    return max(1.0 / rate_hz, float(np.median(gaps)) if gaps.size >= _FEW_GAPS else 0.0)


def _read(series: Series, rate_hz: float, t: FloatArray, cubic: bool = False) -> dict[str, FloatArray]:
    """Values read off linearly, or by cubics that do not overshoot; NaN outside the series and inside gaps of more than three sample
    periods."""
    out: dict[str, FloatArray] = {}
    if t.size == 0:
        return dict.fromkeys(series.columns, t)
    period = _period(series, rate_hz, t)
    reach = _GAP_PERIODS * period
    near = slice(
        max(int(np.searchsorted(series.t_s, t[0] - reach)) - 1, 0), int(np.searchsorted(series.t_s, t[-1] + reach)) + 1
    )
    for name, column in series.columns.items():
        times, values = series.t_s[near], column[near]
        finite = np.isfinite(values)
        if not finite.all():
            times, values = times[finite], values[finite]
        if times.size < 2:
            out[name] = np.full(t.size, np.nan)
            continue
        right = np.clip(np.searchsorted(times, t), 1, times.size - 1)
        inside = np.clip(t, times[0], times[-1])
        found = PchipInterpolator(times, values)(inside) if cubic and times.size > 3 else np.interp(t, times, values)
        bad = (times[right] - times[right - 1] > reach) & (t != times[right]) & (t != times[right - 1])
        # A slow channel may begin or end up to half a period beside the window.
        bad |= (t < times[0] - 0.5 * period) | (t > times[-1] + 0.5 * period)
        found[bad] = np.nan
        out[name] = found
    return out


def _held(series: Series, rate_hz: float, t: FloatArray) -> dict[str, FloatArray]:
    """The last value at each time; NaN before the first and where it is older than `_read` would read across."""
    at = np.searchsorted(series.t_s, t, side="right") - 1
    fresh = (at >= 0) & (t - series.t_s[np.maximum(at, 0)] <= _GAP_PERIODS * _period(series, rate_hz, t))
    return {name: np.where(fresh, column[np.maximum(at, 0)], np.nan) for name, column in series.columns.items()}


def _at_own(series: Series, t: FloatArray) -> dict[str, FloatArray]:
    """Values at the series' own sample times, NaN elsewhere."""
    index = np.searchsorted(series.t_s, t)
    inside = index < len(series)
    hit = np.zeros(t.size, dtype=bool)
    hit[inside] = series.t_s[index[inside]] == t[inside]
    out = {}
    for name, column in series.columns.items():
        values = np.full(t.size, np.nan)
        values[hit] = column[index[hit]]
        out[name] = values
    return out


def _world_acceleration(aligned: Aligned, t: FloatArray, y: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """a = R f - g e_z, with attitude read off linearly where it is slower than the accelerometer."""
    attitude = _read(aligned.groups["attitude"], aligned.rates_hz["attitude"], t) if "attitude" in aligned.own else y
    rotation = rotation_from_euler(np.stack([attitude[n] for n in names("attitude")], axis=-1))
    f = np.stack([y[n] for n in names("specific_force")], axis=-1)
    a = np.einsum("nij,nj->ni", rotation, f) - [0.0, 0.0, G_M_S2]
    return {name: a[:, i] for i, name in enumerate(names("acceleration"))}
