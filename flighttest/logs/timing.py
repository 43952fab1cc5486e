"""Time in logs: series put in order, clocks that wrapped or restarted put right, and every repair noted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flighttest.recording import Series

FloatArray = NDArray[np.float64]

BACK_S = 0.5  # messages of one log are written nearly in order: a longer step back is a wrap or a restart
OUTLIER_S = 2.0  # one or two stamps this far from their neighbours on both sides are damaged
_STEP_S = 2.0  # a ground computer's clock that is set right moves by more, usually by much more
_ABOUT_STEP = 500  # messages on each side: more than a stalled link holds back


def ordered(t_s: FloatArray, columns: Mapping[str, FloatArray], what: str, losses: list[str]) -> Series:
    """A Series sorted by time; of samples with one time stamp the last is kept, and where that is more than 1 % it is noted."""
    finite = np.isfinite(t_s)
    if not finite.all():
        losses.append(f"{what}: {int(np.count_nonzero(~finite))} samples have no time and were dropped")
        t_s, columns = t_s[finite], {name: values[finite] for name, values in columns.items()}
    rising = np.diff(t_s) > 0
    if rising.all():
        return Series(t_s, columns)
    order = np.argsort(t_s, kind="stable")
    t = t_s[order]
    last = np.concatenate([np.diff(t) > 0, [True]])
    doubled = int(t.size - np.count_nonzero(last))
    if doubled > 0.01 * t.size:
        losses.append(f"{what}: {doubled} of {t.size} samples repeat a time stamp; the last of each was kept")
    return Series(t[last], {name: np.asarray(values)[order][last] for name, values in columns.items()})


def held_union(parts: list[tuple[FloatArray, dict[str, FloatArray]]], merge_s: float = 1e-3) -> Series:
    """Held channels of several time bases on one: every change keeps its time (times closer than merge_s become the later)."""
    every = np.unique(np.concatenate([t for t, _ in parts]))
    keep = np.concatenate([np.diff(every) > merge_s, [True]])
    base = every[keep]
    columns: dict[str, FloatArray] = {}
    for t, values in parts:
        index = np.searchsorted(t, base, side="right") - 1
        for name, column in values.items():
            columns[name] = np.where(index >= 0, column[np.maximum(index, 0)], np.nan)
    return Series(base, columns)


def clock_steps(ground_s: FloatArray, vehicle_s: FloatArray) -> FloatArray:
    """By how much the ground's clock was set forward (or back) right before each message, s, mostly zero: (n,).

    ground_s, vehicle_s: (n,) when messages came and what they are stamped, in the order received. A link that stalls delivers late, but
    catches up; a vehicle that reboots sets its own clock back. Neither is a step of the ground's clock.
    """
    steps = np.zeros(ground_s.size)
    late = ground_s - vehicle_s
    jumps = np.diff(late)
    for i in np.flatnonzero((np.abs(jumps) > _STEP_S) & (np.diff(vehicle_s) > -BACK_S)):
        before, after = late[max(i + 1 - _ABOUT_STEP, 0) : i + 1], late[i + 1 : i + 1 + _ABOUT_STEP]
        step = float(np.min(after) - np.min(before))  # by the least delayed message of each side
        if abs(step - jumps[i]) < 0.5 * abs(jumps[i]):
            steps[i + 1] = step
    return steps


def outliers(t: FloatArray) -> NDArray[np.bool_]:
    """Single stamps (or two together) far from the median of their five neighbours."""
    if t.size < 5:
        return np.zeros(t.size, dtype=bool)
    if bool(np.all(np.abs(np.diff(t)) < OUTLIER_S)):
        return np.zeros(t.size, dtype=bool)
    padded = np.pad(t, 2, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=-1)
    return np.asarray(np.abs(t - middle) > OUTLIER_S)


def difference(t_s: FloatArray, values: FloatArray) -> FloatArray:
    """Derivative by time at every finite sample, from its finite neighbours; NaN where neighbours are missing. t_s, values: (n,), in any
    order."""
    out = np.full(values.size, np.nan)
    order = np.argsort(t_s, kind="stable")
    good = order[np.isfinite(values[order]) & np.isfinite(t_s[order])]
    if good.size >= 3:
        t, x = t_s[good], values[good]
        keep = np.concatenate([[True], np.diff(t) > 0])
        good, t, x = good[keep], t[keep], x[keep]
        if good.size >= 3:
            slope = np.gradient(x, t)
            usual = float(np.median(np.diff(t)))
            far = np.diff(t) > 3.5 * usual
            slope[1:][far] = np.nan
            slope[:-1][far] = np.nan
            out[good] = slope
    return out
