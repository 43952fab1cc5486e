"""A second opinion on the covariance: cluster bootstrap, which resamples whole responses with replacement.

Each draw is one Gauss-Newton step from the solution on the resampled responses: exact for a linear problem, and near enough to a refit
this close to the minimum, at a thousandth of its cost.
"""

from __future__ import annotations

import numpy as np

from flighttest.estimation.likelihood_weights import Normal
from flighttest.estimation.uncertainty.covariance import FloatArray

DRAWS = 400


def bootstrap_std(normal: Normal, active: tuple[str, ...], draws: int = DRAWS, seed: int = 0) -> dict[str, float]:
    """Standard errors by resampling responses, by name of the `active` parameters. Fewer than four responses show nothing: empty."""
    pick = np.array([normal.names.index(n) for n in active], dtype=np.intp)
    hessian, score = normal.hessian[:, pick[:, None], pick], normal.score[:, pick]
    determined = np.abs(hessian).sum(axis=(1, 2)) > 0
    hessian, score = hessian[determined], score[determined]
    if len(score) < 4 or not pick.size:
        return {}
    total = hessian.sum(axis=0)
    scale = 1.0 / np.sqrt(np.diag(total))
    hessian, score = hessian * np.outer(scale, scale), score * scale
    counts = np.random.default_rng(seed).multinomial(len(score), np.full(len(score), 1.0 / len(score)), size=draws)
    steps = [_step(np.tensordot(c, hessian, 1), c @ score) for c in counts.astype(float)]
    spread = np.std(np.array(steps), axis=0) * scale
    return {n: float(s) for n, s in zip(active, spread, strict=True)}


def _step(hessian: FloatArray, score: FloatArray) -> FloatArray:
    """A draw may miss every response of a parameter: its direction is then left where it is."""
    return np.asarray(np.linalg.lstsq(hessian, score, rcond=1e-10)[0])
