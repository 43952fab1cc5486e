"""Tables with times of their own as one table: rows at the union of all times, empty where a table has no sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.logs.tables.sheet import TIME

FloatArray = NDArray[np.float64]


def joined(tables: Sequence[tuple[FloatArray, Mapping[str, FloatArray]]]) -> dict[str, FloatArray]:
    """Columns of all tables, each (t_s (n,), name to (n,)), under `t_s`; times that are not finite are left out."""
    every = np.unique(np.concatenate([t[np.isfinite(t)] for t, _ in tables]))
    raw: dict[str, FloatArray] = {TIME: every}
    for t, columns in tables:
        known = np.isfinite(t)
        at = np.searchsorted(every, t[known])
        for name, values in columns.items():
            column = np.full(every.size, np.nan)
            column[at] = values[known]
            raw[name] = column
    return raw
