"""One clock for the messages of a dataflash log: stamps of several kinds, wraps, restarts and damage."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flighttest.logs.ardupilot.dataflash import Dataflash, MessageTable
from flighttest.logs.timing import BACK_S, OUTLIER_S, outliers

FloatArray = NDArray[np.float64]
Stamped = tuple[MessageTable, FloatArray]  # messages of one type and their times (n,), s

_STAMPS = (("TimeUS", 1e-6, 2.0**32 * 1e-6), ("TimeMS", 1e-3, 2.0**32 * 1e-3), ("T", 1e-3, 2.0**32 * 1e-3))
_WRAP_GAP_S = 120.0


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
        back = np.flatnonzero(np.diff(t) < -BACK_S)
        wraps = [i for i in back if -BACK_S < t[i + 1] + self._wrap_s - t[i] < _WRAP_GAP_S]
        self._wraps = at[np.asarray(wraps, dtype=np.int64) + 1] if wraps else self._wraps
        if wraps:
            self.losses.append(f"the clock wrapped {len(wraps)} times (after {self._wrap_s:.0f} s each); put right")
            t = t + self._wrap_s * np.searchsorted(self._wraps, at, side="right")
        restarts = [i for i in np.flatnonzero(np.diff(t) < -BACK_S) if _stays_back(t, int(i))]
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

    def of(self, name: str, table: MessageTable) -> Stamped:
        """The messages of a table that belong to the run, and their times (n,), s. Types without a stamp get the time of the
        message before them."""
        stamps, _ = self._raw[name]
        keep = (table.at >= self._span[0]) & (table.at < self._span[1])
        nearby = self._t[np.clip(np.searchsorted(self._at, table.at, side="right") - 1, 0, self._t.size - 1)]
        t = nearby if stamps is None else stamps + self._wrap_s * np.searchsorted(self._wraps, table.at, side="right")
        damaged = keep & (np.abs(t - nearby) > OUTLIER_S)
        if damaged.any():
            self.losses.append(
                f"{name}: {int(np.count_nonzero(damaged))} messages with a damaged time stamp were dropped"
            )
            keep &= ~damaged
        return (table, t) if keep.all() else (table.where(keep), t[keep])


def _stamps(table: MessageTable) -> tuple[FloatArray | None, float]:
    # Before Copter 3.3 a GPS message's TimeMS is the GPS week's, and T the vehicle's.
    for name, scale, wrap_s in _STAMPS if "T" not in table else _STAMPS[::-1]:
        if name in table and table.raw[name].dtype.kind in "iu":
            return table.get(name) * scale, wrap_s
    return None, 0.0


def _stays_back(t: FloatArray, i: int) -> bool:
    """Whether the step back after sample i is a restart and not one late message."""
    return bool(np.median(t[i + 1 : i + 6]) < t[i] - BACK_S)
