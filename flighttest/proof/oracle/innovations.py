"""The attitude loops of flights that a pilot or a controller steered, from their innovations.

Who steers answers what gusts do, so references follow disturbances, and a fit of what the loops leave takes an answer for its cause: on
flights in a wind tunnel it ends at natural frequencies of 6 to 8 rad/s and no delay, where the innovations have 10.5 rad/s and 58 ms. A
regression of each output on its own past and that of the references (ARX), long enough, is consistent there (Ljung, System
Identification, 2nd ed., section 13.4). Its autoregressive part whitens the noise, and the loops are fitted to outputs filtered by it
(the asymptotic method: Zhu, Multivariable System Identification for Process Control, 2001).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from flighttest.proof.oracle.blocks import (
    PARTS,
    STEP_S,
    OracleBlock,
    OracleResponses,
    RollPitchLoops,
    YawLoop,
    feeds,
    profiled,
    recorded_in,
)
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

# Of outputs and references that the regression has: the loops of multirotors have answered by then. With half or twice as much the tests
# of this module pass.
PAST_S = 0.5
LEAST_LAGS = 4
LEAST_ROWS = 5  # for every coefficient of the regression
FREE = 1e3  # standard deviation of a window's own disturbance: the trim of any
STARTS = {
    "roll_pitch": tuple((w, 0.7, w, 0.7, late) for w, late in ((12.0, 0.08), (20.0, 0.02), (7.0, 0.08))),
    "yaw": ((6.0, 0.08), (12.0, 0.02), (3.0, 0.08)),
}  # of fits, of which the best counts


def steered_loops(segments: Sequence[Segment]) -> dict[str, FloatArray]:
    """Block (`roll_pitch`, `yaw`) to its theta, of windows that were steered. Left out is a block that has too little, or whose loops are
    not of its form: the fit ends at a bound, other than no delay."""
    usable = [s for s in segments if s.usable and s.steered]
    found = {}
    for block in (RollPitchLoops(), YawLoop()):
        theta = _fitted(
            block, [s for s in usable if feeds(s, block) and all(recorded_in(s, c) for c in block.channels)]
        )
        if theta is not None:
            found[block.name] = theta
    return found


def _fitted(block: OracleBlock, segments: Sequence[Segment]) -> FloatArray | None:
    if not segments:
        return None
    data = OracleResponses(segments)
    every = _apart(block, segments)
    lags = max(round(PAST_S / (every * STEP_S)), LEAST_LAGS)
    filters, std = [], []
    for channel in block.channels:
        known = _whitening(block, data, channel, every, lags)
        if known is None:
            return None
        filters.append(known[0])
        std.append(known[1])
    weights = data.mask[:, ::every, None] / np.array(std)
    weights[:, :lags] = 0.0  # these samples only start the filter

    def white(values: FloatArray) -> FloatArray:
        thinned = values[:, ::every]
        return np.stack([lfilter(a, [1.0], thinned[:, :, k], axis=1) for k, a in enumerate(filters)], axis=2)

    def misfit(theta: FloatArray) -> FloatArray:
        residual, free, disturbed = (white(part) for part in block.of(data, theta))
        return profiled(residual, free, disturbed, weights, FREE)[0].ravel()

    tried = [
        least_squares(
            misfit, start, x_scale=0.1 * np.array(start), bounds=block.bounds, ftol=1e-7, xtol=1e-7, max_nfev=40
        )
        for start in STARTS[block.name]
    ]
    best = min(tried, key=lambda one: float(one.cost))
    return None if best.active_mask[:-1].any() else np.asarray(best.x)


def _apart(block: OracleBlock, segments: Sequence[Segment]) -> int:
    """Steps of the grid between the samples of the channel that was recorded least often: what is interpolated between is no noise."""
    spacing = [float(np.median(np.diff(s.t_s[np.isfinite(s.y[c])]))) for s in segments for c in block.channels]
    return max(round(float(np.median(spacing)) / STEP_S), 1)


def _whitening(
    block: OracleBlock, data: OracleResponses, channel: str, every: int, lags: int
) -> tuple[FloatArray, float] | None:
    """A(q) (lags + 1,), the first 1, and the standard deviation of A y - B u - constant, by least squares over all windows."""
    asked = []
    for name in block.inputs:
        held = data.held(name, 0.0, name.replace("_ref_", "_shaped_"))
        asked.append(np.concatenate([held, held[:, -1:]], axis=1)[:, :: PARTS * every])
    measured = data.y(channel)[:, ::every]
    rows, goals = [], []
    for k, last in enumerate(data.mask[:, ::every].sum(axis=1)):
        past = [measured[k, lags - d : last - d] for d in range(1, lags + 1)]
        past += [u[k, lags - d : last - d] for u in asked for d in range(lags + 1)]
        if last > lags:
            rows.append(np.stack([*past, np.ones(last - lags)], axis=1))
            goals.append(measured[k, lags:last])
    if not rows or sum(map(len, goals)) < LEAST_ROWS * rows[0].shape[1]:
        return None
    columns, goal = np.concatenate(rows), np.concatenate(goals)
    coefficients = np.linalg.lstsq(columns, goal, rcond=None)[0]
    return np.concatenate([[1.0], -coefficients[:lags]]), float(np.std(goal - columns @ coefficients))
