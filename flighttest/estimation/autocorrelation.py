"""Autocorrelation of residuals, and how many samples of a velocity estimate count as one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flighttest.estimation.drift import DRIFT, WANDER_S
from flighttest.estimation.problem import Part, PartEvaluation

FloatArray = NDArray[np.float64]

UNCORRELATED = 0.05  # sums of autocorrelations end below it (Sokal's window, by value)


def lagged_products(values: FloatArray) -> FloatArray:
    """(n,) sums of x(t) x(t + lag) over rows (m, n) and times, by lag in samples."""
    length = values.shape[1]
    spectrum = np.abs(np.fft.rfft(values, 2 * length, axis=1)) ** 2
    return np.asarray(np.fft.irfft(spectrum.sum(axis=0), 2 * length)[:length])


def autocorrelation(values: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """(n,) of (m, n) values within rows, where mask is, by lag in samples: one at lag 0; of uncorrelated ones where there is nothing."""
    pairs = np.round(lagged_products(mask.astype(float)))
    product = np.where(pairs > 0, lagged_products(np.where(mask, values, 0.0)) / np.maximum(pairs, 1.0), 0.0)
    if not product[0] > 0.0:
        return np.asarray(np.eye(1, mask.shape[1])[0])
    return np.asarray(np.clip(product / product[0], -1.0, 1.0))


def correlations(part: Part, made: PartEvaluation) -> dict[str, float]:
    """Velocity whose specific force was recorded to the integrated autocorrelation time of its residual within responses, in samples:
    1 + 2 sum rho(lag), up to the first lag below `UNCORRELATED`, `limited`. Given the force, kinematics make the velocity: what is left of
    it is the state estimator's own error, which wanders. A mean and a trend of each response are left out: its own initial state and
    disturbance take these up, and where they counted as noise, nothing would determine those."""
    found = {}
    wander = wander_of(part)
    for k, name in enumerate(part.outputs):
        if not (name.startswith("v_") and f"f_{name[2]}_m_s2" in part.outputs):
            continue
        mask, residual = part.mask[..., k], made.residual[..., k]
        pairs = np.round(lagged_products(mask.astype(float)))
        product = lagged_products(_without_trend(residual, mask)) / np.maximum(pairs, 1.0)
        below = product < UNCORRELATED * product[0]
        last = int(np.argmax(below)) if below.any() else below.size
        if last < 2 or not product[0] > 0.0:
            found[name] = 1.0
            continue
        tau = 1.0 + 2.0 * float(product[1:last].sum() / product[0])
        found[name] = float(limited(tau, np.mean(residual[mask] ** 2), wander[k]))
    return found


def wander_of(part: Part) -> FloatArray:
    """(n_outputs,) variance times samples that count as one, of what a state estimator can wander by: `DRIFT` for `WANDER_S`."""
    return np.array([DRIFT.get(c, 0.0) ** 2 for c in part.outputs]) * WANDER_S / part.interval_s


def limited(tau: ArrayLike, variance: ArrayLike, wander: ArrayLike) -> FloatArray:
    """An autocorrelation time in samples as far as an estimator wanders (`wander_of`), where the residual has this variance, above 0: what
    is more than that is the model's error, whose samples count alike. Broadcast against each other."""
    return np.maximum(np.minimum(tau, np.divide(wander, variance)), 1.0)


def _without_trend(values: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """(m, n) without mean and trend of each row over where mask is, 0 elsewhere."""
    at = np.where(mask, np.arange(mask.shape[1], dtype=float), 0.0)
    count = np.maximum(mask.sum(axis=1, keepdims=True), 1)
    x = np.where(mask, values - np.where(mask, values, 0.0).sum(axis=1, keepdims=True) / count, 0.0)
    t = np.where(mask, at - at.sum(axis=1, keepdims=True) / count, 0.0)
    slope = (x * t).sum(axis=1, keepdims=True) / np.maximum((t * t).sum(axis=1, keepdims=True), 1e-300)
    return np.asarray(x - slope * t)
