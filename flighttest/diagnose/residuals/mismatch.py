"""How a model misses each kind of step, from its residuals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.residuals.lack_of_fit import binned
from flighttest.diagnose.step_error import StepError
from flighttest.estimation.linearisation import Linearisation
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]


def step_errors(rows: Linearisation, segments: Sequence[Segment]) -> list[StepError]:
    """Of every channel and kind of step that was commanded; none of free flight. segments: of these rows."""
    cells: dict[tuple[str, tuple[tuple[str, float], ...]], list[int]] = {}
    for i, s in enumerate(segments):
        if s.kind != "free":
            cells.setdefault(s.cell_key, []).append(i)
    found = []
    for key, members in cells.items():
        for c, name in enumerate(rows.channels):
            here = (rows.channel == c) & (rows.sample >= 0)
            each = [(i, np.flatnonzero(here & (rows.segment == i))) for i in members]
            known = [(segments[i], rows.sample[at], rows.unprofiled_residual[at]) for i, at in each if at.size]
            if known:
                means, first = binned(known)
                mean, variance = _moments(means)
                found.append(StepError(name, key[0], dict(key[1]), len(known), first, mean, variance))
    return found


def _moments(means: FloatArray) -> tuple[FloatArray, float]:
    """Mean (bins,) of responses (m, bins), and the variance of one about it, mean over bins with two or more; NaN where there are none."""
    seen = np.isfinite(means)
    count = seen.sum(axis=0)
    mean = np.where(count > 0, np.where(seen, means, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    several = count >= 2
    if not several.any():
        return mean, math.nan
    apart = np.where(seen, (means - mean) ** 2, 0.0).sum(axis=0)[several] / (count[several] - 1)
    return mean, float(np.mean(apart))
