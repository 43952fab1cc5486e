"""How an estimate and its interval come about as responses are added in the order in which they were flown.

At the solution the first k responses move the parameters by one Gauss-Newton step, (sum H_i)^-1 sum g_i, H_i and g_i being each response's
normal equations with its nuisance parameters eliminated (Ljung 1999, section 11.2: recursive least squares). It is no refit: where the
estimates of few responses lie far from the final ones, the model's curvature is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.identify.fit import Estimate, Fit

FloatArray = NDArray[np.float64]

RESOLVED = 0.999  # diagonal of the resolution matrix, from which on the responses so far determine a parameter
SMALLEST_EIGENVALUE = 1e-9  # of normal equations scaled to a unit diagonal: smaller ones are no information
WIDEST = 30.0  # times the final standard error: beyond it a linear step does not hold


@dataclass(frozen=True)
class Accumulation:
    """One parameter. count: (k,) responses used so far; value, half_width: (k,) estimate and half its 95 % interval, in `unit`.

    Points at which the responses so far do not determine the parameter are left out; the last point is the fit's own.
    """

    name: str
    unit: str
    count: NDArray[np.intp]
    value: FloatArray
    half_width: FloatArray


def accumulations(found: Fit) -> tuple[Accumulation, ...]:
    """Of every estimated parameter of a fit that has an interval; empty where responses were not weighed one by one."""
    normal, segments = found.solution.normal, found.problem.segments
    names = tuple(n for n in found.covariance.names if n in normal.names)
    if normal.hessian.shape[0] != len(segments) or not names:
        return ()
    runs = list(dict.fromkeys(s.run for s in segments))
    order = sorted(
        range(len(segments)),
        key=lambda i: (runs.index(segments[i].run), float(np.min(segments[i].t_s, initial=np.inf))),
    )
    order = [i for i in order if np.abs(normal.hessian[i]).sum() > 0.0]
    pick = np.array([normal.names.index(n) for n in names])
    shift, std = steps(normal.hessian[order][:, pick[:, None], pick], normal.score[order][:, pick])
    shown = (_of(found.estimates.get(n), i, shift, std) for i, n in enumerate(names))
    return tuple(a for a in shown if a is not None)


def steps(hessian: FloatArray, score: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shift from the final estimate and standard error for unit noise, (n, p) both, after each of n responses; NaN where not determined.

    hessian: (n, p, p), score: (n, p), in the order in which the responses are added.
    """
    shift, std = np.full(score.shape, np.nan), np.full(score.shape, np.nan)
    sums, scores = np.cumsum(hessian, axis=0), np.cumsum(score, axis=0)
    for k, (total, g) in enumerate(zip(sums, scores, strict=True)):
        scale = np.sqrt(np.maximum(np.diag(total), 0.0))
        on = np.flatnonzero(scale > 0.0)
        if not on.size:
            continue
        s = scale[on]
        eigenvalue, vector = np.linalg.eigh(total[np.ix_(on, on)] / np.outer(s, s))
        kept = eigenvalue > SMALLEST_EIGENVALUE
        basis = vector[:, kept]
        inverse = (basis / eigenvalue[kept]) @ basis.T
        determined = (basis**2).sum(axis=1) > RESOLVED
        shift[k, on[determined]] = (inverse @ (g[on] / s) / s)[determined]
        std[k, on[determined]] = (np.sqrt(np.diag(inverse)) / s)[determined]
    return shift, std


def _of(estimate: Estimate | None, i: int, shift: FloatArray, std: FloatArray) -> Accumulation | None:
    if estimate is None or estimate.interval_95 is None or not estimate.std or not np.isfinite(std[-1, i]):
        return None
    ratio = std[:, i] / std[-1, i]
    half = 0.5 * (estimate.interval_95[1] - estimate.interval_95[0]) * ratio
    value = estimate.value + shift[:, i] - shift[-1, i]
    # A response that contains no information on the parameter adds no point.
    news = np.concatenate([[True], ~np.isclose(ratio[1:], ratio[:-1], rtol=1e-9, equal_nan=True)])
    news[-1] = True
    at = np.flatnonzero(np.isfinite(value) & (ratio < WIDEST) & news)
    return Accumulation(estimate.name, estimate.unit, at + 1, value[at], half[at]) if at.size > 1 else None
