"""Colored residuals: how much farther estimates scatter than the noise model says, since residuals are correlated in time (Morelli & Klein
1997, Accuracy of aerodynamic model parameters estimated from flight test data; Klein & Morelli 2006, Aircraft System Identification):

    cov = H^-1 [sum_ik J_ik' R_k J_ik] H^-1

with J_ik the whitened Jacobian of output k of response i, its own unknowns profiled out, H the information and R_k the correlation
matrix of output k. R_k is that of the residuals within all responses together, divided by the samples that count as one already in the
weights. With A_ik = J_ik H^-1, a sample's influence on the estimates, the variance of parameter p is a sum over lags:

    V_p = sum_k sum_l rho_k(l) sum_it A_ikp(t) A_ikp(t + l).

The factor of the whole spectrum at frequency zero, (1 + rho) / (1 - rho), is the limit of an influence that never changes; that of a step
changes within the residual's correlation time, and a constant is taken up by each response's disturbance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.autocorrelation import autocorrelation, lagged_products
from flighttest.estimation.likelihood_weights import LikelihoodWeights, Normal, State
from flighttest.estimation.linearisation import inverse_of_gram

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ColoredResiduals:
    """What autocorrelation makes of the variances of estimates. inflation: (p,) of the variance by the noise model, one or more; dof: (p,)
    degrees of freedom of the variance, of independent samples (Satterthwaite)."""

    inflation: FloatArray
    dof: FloatArray


def colored_residuals(
    weighing: LikelihoodWeights, at: State, normal: Normal, active: Sequence[str]
) -> ColoredResiduals:
    """Of the estimates of `active` names at an optimum of them, or at given parameters; normal: by them and others, weighed alike."""
    pick = [normal.names.index(n) for n in active]
    total = normal.hessian.sum(axis=0)[np.ix_(pick, pick)]
    inverse = inverse_of_gram(total)
    variance, squares = np.zeros(len(pick)), np.zeros(len(pick))
    for part, (residual, jacobian) in zip(weighing.problem.parts, weighing.profiled(at, active), strict=True):
        for k, name in enumerate(part.outputs):
            mask = part.mask[..., k]
            rho = autocorrelation(residual[..., k], mask)
            influence = np.where(mask[..., None], jacobian[:, :, k], 0.0) @ inverse
            products = np.stack([lagged_products(influence[..., p]) for p in range(len(pick))])
            twice = np.where(np.arange(rho.size) > 0, 2.0, 1.0) * rho
            found = np.maximum(products @ twice, 0.0) / weighing.noise.correlation.get(name, 1.0)
            variance += found
            squares += found**2 * float(twice @ rho) / max(float(mask.sum()), 1.0)
    white = np.diag(inverse)
    inflation = np.maximum(variance / np.where(white > 0.0, white, 1.0), 1.0)
    dof = np.where(squares > 0.0, variance**2 / np.where(squares > 0.0, squares, 1.0), 1.0)
    return ColoredResiduals(inflation, np.maximum(dof, 1.0))
