"""Time in logs: series put in order, clocks that wrapped or restarted put right, and every repair said."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flighttest.logs.ardupilot.dataflash import Dataflash, Table
from flighttest.recording import Series

FloatArray = NDArray[np.float64]

_STAMPS = (("TimeUS", 1e-6, 2.0**32 * 1e-6), ("TimeMS", 1e-3, 2.0**32 * 1e-3), ("T", 1e-3, 2.0**32 * 1e-3))
_BACK_S = 0.5  # messages of one log are written nearly in order: a longer step back is a wrap or a restart
_OUTLIER_S = 2.0  # one or two stamps this far from their neighbours on both sides are damaged
_WRAP_GAP_S = 120.0
_STEP_S = 2.0  # a ground computer's clock that is set right moves by more, usually by much more
_ABOUT_STEP = 500  # messages on each side: more than a stalled link holds back


def ordered(t_s: FloatArray, columns: Mapping[str, FloatArray], what: str, losses: list[str]) -> Series:
    """A Series sorted by time; of samples with one time stamp the last is kept, and where that is more than 1 % it is said."""
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
    for i in np.flatnonzero((np.abs(jumps) > _STEP_S) & (np.diff(vehicle_s) > -_BACK_S)):
        before, after = late[max(i + 1 - _ABOUT_STEP, 0) : i + 1], late[i + 1 : i + 1 + _ABOUT_STEP]
        step = float(np.min(after) - np.min(before))  # by the least delayed message of each side
        if abs(step - jumps[i]) < 0.5 * abs(jumps[i]):
            steps[i + 1] = step
    return steps


class Times:
    """The time of every message of a dataflash log, s, on one clock: wraps added, damaged stamps NaN, one boot only."""

    def __init__(self, log: Dataflash) -> None:
        self.losses: list[str] = []
        self._raw = {name: _stamps(table) for name, table in log.tables.items()}
        stamped = [(log.tables[name].at, t, wrap) for name, (t, wrap) in self._raw.items() if t is not None]
        self.known = bool(stamped)
        self._wraps: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._wrap_s = 0.0
        self._span = (0, np.iinfo(np.int64).max)
        self._at = np.zeros(1, dtype=np.int64)
        self._t = np.zeros(1)
        if self.known:
            self._survey(stamped)

    def _survey(self, stamped: list[tuple[NDArray[np.int64], FloatArray, float]]) -> None:
        at = np.concatenate([a for a, _, _ in stamped])
        t = np.concatenate([x for _, x, _ in stamped])
        order = np.argsort(at, kind="stable")
        at, t = at[order], t[order]
        good = ~outliers(t)
        at, t = at[good], t[good]
        self._wrap_s = stamped[0][2]
        back = np.flatnonzero(np.diff(t) < -_BACK_S)
        wraps = [i for i in back if -_BACK_S < t[i + 1] + self._wrap_s - t[i] < _WRAP_GAP_S]
        self._wraps = at[np.asarray(wraps, dtype=np.int64) + 1] if wraps else self._wraps
        if wraps:
            self.losses.append(f"the clock wrapped {len(wraps)} times (after {self._wrap_s:.0f} s each); put right")
            t = t + self._wrap_s * np.searchsorted(self._wraps, at, side="right")
        restarts = [i for i in np.flatnonzero(np.diff(t) < -_BACK_S) if _stays_back(t, int(i))]
        if restarts:
            edges = np.concatenate([[0], np.asarray(restarts, dtype=np.int64) + 1, [t.size]])
            spans_s = [float(t[b - 1] - t[a]) for a, b in pairwise(edges)]
            best = int(np.argmax(spans_s))
            a, b = int(edges[best]), int(edges[best + 1])
            begin = 0 if a == 0 else int(at[a])
            self._span = (begin, int(at[b]) if b < t.size else int(np.iinfo(np.int64).max))
            spans = ", ".join(f"{s:.1f} s" for s in spans_s)
            self.losses.append(
                f"the clock restarted {len(restarts)} times (runs of {spans}); only run {best + 1}, the longest, was read"
            )
            at, t = at[a:b], t[a:b]
        self._at, self._t = at, np.maximum.accumulate(t) if t.size else t

    def of(self, name: str, table: Table) -> tuple[Table, FloatArray]:
        """The messages of a table that belong to the run, and their times (n,), s. Types without a stamp get the time of the
        message before them."""
        stamps, _ = self._raw[name]
        keep = (table.at >= self._span[0]) & (table.at < self._span[1])
        nearby = self._t[np.clip(np.searchsorted(self._at, table.at, side="right") - 1, 0, self._t.size - 1)]
        t = nearby if stamps is None else stamps + self._wrap_s * np.searchsorted(self._wraps, table.at, side="right")
        damaged = keep & (np.abs(t - nearby) > _OUTLIER_S)
        if damaged.any():
            self.losses.append(
                f"{name}: {int(np.count_nonzero(damaged))} messages with a damaged time stamp were dropped"
            )
            keep &= ~damaged
        return (table, t) if keep.all() else (table.where(keep), t[keep])


def _stamps(table: Table) -> tuple[FloatArray | None, float]:
    # Before Copter 3.3 a GPS message's TimeMS is the GPS week's, and T the vehicle's.
    for name, scale, wrap_s in _STAMPS if "T" not in table else _STAMPS[::-1]:
        if name in table and table.raw[name].dtype.kind in "iu":
            return table.get(name) * scale, wrap_s
    return None, 0.0


def outliers(t: FloatArray) -> NDArray[np.bool_]:
    """Single stamps (or two together) far from the median of their five neighbours."""
    if t.size < 5:
        return np.zeros(t.size, dtype=bool)
    if bool(np.all(np.abs(np.diff(t)) < _OUTLIER_S)):
        return np.zeros(t.size, dtype=bool)
    padded = np.pad(t, 2, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=-1)
    return np.asarray(np.abs(t - middle) > _OUTLIER_S)


def _stays_back(t: FloatArray, i: int) -> bool:
    """Whether the step back after sample i is a restart and not one late message."""
    return bool(np.median(t[i + 1 : i + 6]) < t[i] - _BACK_S)


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
