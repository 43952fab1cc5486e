"""Steps that a vehicle and its twin both flew, as flown: no model is in the comparison.

With x_i the recorded responses of one step, m in number, and y the mean of the twin's n: RMS of x_i - y, against what the repeats of the
recording by themselves would give, s sqrt(1 + 1/n) with s^2 the variance between the repeats. Each response counts from its own state
before the step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

# Channels that a step drives; others answer to the estimator and to gusts.
DRIVEN: Mapping[str, tuple[str, ...]] = {
    "roll_step": ("roll_rad",), "pitch_step": ("pitch_rad",), "yaw_rate_step": ("r_rad_s",), "throttle_step": ("f_z_m_s2",),
}  # fmt: skip
GRID_S = 0.02
_FEWEST = 5  # samples of a response


def flown_errors(real: Sequence[Segment], twin: Sequence[Segment]) -> dict[str, dict[str, float]]:
    """By channel, SI: rmse of the twin's mean response, floor (what repeats would give), ratio of the two, and steps, the number of cells
    compared. Cells that the recording did not repeat have no floor and do not count."""
    sides = [_cells(real), _cells(twin)]
    sums: dict[str, list[tuple[float, float]]] = {}
    for key in sides[0].keys() & sides[1].keys():
        mine, theirs = sides[0][key], sides[1][key]
        if len(mine) < 2:
            continue
        for channel in DRIVEN[mine[0].kind]:
            if not all(channel in s.y for s in (*mine, *theirs)):
                continue
            grid = np.arange(0.0, min(float(s.t_s[-1]) - s.t_step_s for s in (*mine, *theirs)), GRID_S)
            if grid.size < _FEWEST:
                continue
            x, y = (np.array([_since_the_step(s, channel, grid) for s in some]) for some in (mine, theirs))
            spread = float(np.mean(np.var(x, axis=0, ddof=1))) * (1.0 + 1.0 / len(theirs))
            sums.setdefault(channel, []).append((float(np.mean((x - y.mean(axis=0)) ** 2)), spread))
    found = {}
    for channel, rows in sums.items():
        rmse, floor = (math.sqrt(sum(r[i] for r in rows) / len(rows)) for i in (0, 1))
        if floor > 0.0:
            found[channel] = {"rmse": rmse, "floor": floor, "ratio": rmse / floor, "steps": len(rows)}
    return dict(sorted(found.items()))


def _cells(segments: Sequence[Segment]) -> dict[object, list[Segment]]:
    cells: dict[object, list[Segment]] = {}
    for s in segments:
        if s.usable and s.kind in DRIVEN:
            cells.setdefault(s.cell_key, []).append(s)
    return cells


def _since_the_step(segment: Segment, channel: str, grid: FloatArray) -> FloatArray:
    """The response on the grid, less its mean before the step."""
    t, y = segment.t_s - segment.t_step_s, segment.y[channel]
    good = np.isfinite(y)
    t, y = t[good], y[good]
    if t.size < _FEWEST:
        return np.full(grid.size, np.nan)
    before = y[t <= 0.0]
    return np.asarray(np.interp(grid, t, y) - (before.mean() if before.size else y[0]))
