"""Covariance that stays valid when residuals are correlated within a response: cluster-robust, with small-sample corrections.

CR2 of Bell and McCaffrey (2002): each cluster's score is blown up by what its own leverage took from its residual; degrees of
freedom per parameter by Satterthwaite's approximation under the working model. White-noise intervals claim a third of the
true error for alpha when each response carries its own disturbance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.likelihood_weights import Normal
from flighttest.estimation.problem import Problem
from flighttest.estimation.solver import Solution
from flighttest.estimation.uncertainty.colored_residuals import ColoredResiduals, colored_residuals
from flighttest.estimation.uncertainty.discrepancy import discrepancy_covariance
from flighttest.estimation.uncertainty.distributions import quantile

FloatArray = NDArray[np.float64]

STAMP_S = 1e-3  # resolution of time stamps in MAVLink messages
MIN_DOF = 2.5  # below this a cluster sum is not reliable; the model-based covariance, inflated, takes its place


@dataclass(frozen=True)
class Covariance:
    """matrix: (p, p) cluster-robust, what differs between cells, as two fits of like flights differ; model: (p, p) as if the noise model
    were right; dof: (p,) Student-t degrees of freedom of `matrix`; discrepancy: (p, p) what an error of the equations adds that all cells
    of a kind of maneuver share (`estimation.uncertainty.discrepancy`), None: nothing. Intervals hold both (`of`)."""

    names: tuple[str, ...]
    matrix: FloatArray
    model: FloatArray
    dof: FloatArray
    discrepancy: FloatArray | None = None

    @property
    def whole(self) -> FloatArray:
        """(p, p) with the discrepancy."""
        return self.matrix if self.discrepancy is None else self.matrix + self.discrepancy

    @property
    def std(self) -> dict[str, float]:
        """Standard errors by name, the discrepancy included."""
        return dict(zip(self.names, np.sqrt(np.diag(self.whole)).tolist(), strict=True))

    def of(self, weights: FloatArray) -> tuple[float, float]:
        """Standard deviation and degrees of freedom of a linear combination, (p,), the discrepancy included (Welch and Satterthwaite: its
        limit is not estimated from few)."""
        scatter, variance = float(weights @ self.matrix @ weights), float(weights @ self.whole @ weights)
        used = np.abs(weights) > 0
        dof = float(self.dof[used].min()) if used.any() else 1.0
        return float(np.sqrt(max(variance, 0.0))), dof * (variance / scatter) ** 2 if scatter > 0.0 else dof


def interval_factor(dof: float, level: float = 0.95) -> float:
    """Two-sided Student-t quantile."""
    return quantile(0.5 + level / 2, max(dof, 1.0))


def cluster_covariance(
    normal: Normal, active: tuple[str, ...], colored: Callable[[], ColoredResiduals] | None = None
) -> Covariance:
    """Covariance of the `active` names (the others held).

    colored: what the correlation of residuals in time makes of the same names' variances, asked for and in the place of the scatter
    between clusters where too few of them determine a parameter. None: there the larger of that scatter and of the noise model.
    """
    pick = np.array([normal.names.index(n) for n in active], dtype=np.intp)
    if not pick.size:
        empty = np.zeros((0, 0))
        return Covariance((), empty, empty, np.zeros(0))
    hessian = normal.hessian[:, pick[:, None], pick]
    score = normal.score[:, pick]
    informative = np.abs(hessian).sum(axis=(1, 2)) > 0
    hessian, score = hessian[informative], score[informative]
    total = hessian.sum(axis=0)
    scale = 1.0 / np.sqrt(np.diag(total))
    hessian, score = hessian * np.outer(scale, scale), score * scale
    # H = L L': in these coordinates a cluster's leverage M_s is symmetric and the M_s sum to one. Nearly flat directions are cut.
    values, vectors = np.linalg.eigh(hessian.sum(axis=0))
    root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    leverage = root.T @ hessian @ root
    u = score @ root
    lam, basis = np.linalg.eigh(leverage)
    blow = (basis * (1.0 / np.sqrt(np.clip(1.0 - lam, 0.02, None)))[:, None, :]) @ basis.swapaxes(1, 2)
    adjusted = np.einsum("sij,sj->si", blow, u) @ root.T * scale
    robust = adjusted.T @ adjusted
    model = (root @ root.T) * np.outer(scale, scale)
    dof = np.array([_dof(leverage, blow, root[i]) for i in range(pick.size)])
    few = dof < MIN_DOF
    if few.any():
        white, between = np.sqrt(np.diag(model)), np.sqrt(np.diag(robust))
        in_time = colored() if colored is not None else None
        otherwise = np.maximum(white, between) if in_time is None else white * np.sqrt(in_time.inflation)
        ratio = np.where(few, otherwise, between) / white
        robust = model * np.outer(ratio, ratio)
        dof = np.where(few, 10.0 if in_time is None else in_time.dof, dof)
    return Covariance(active, robust, model, dof)


def _dof(leverage: FloatArray, blow: FloatArray, direction: FloatArray) -> float:
    """Satterthwaite degrees of freedom of one parameter's variance estimate."""
    q = np.einsum("sij,j->si", blow, direction)
    mq = np.einsum("sij,sj->si", leverage, q)
    omega = np.diag(np.einsum("si,si->s", q, mq)) - mq @ mq.T
    squares = float((omega**2).sum())
    return float(np.trace(omega)) ** 2 / squares if squares > 0 else 1.0


def covariance_of(problem: Problem, solution: Solution) -> Covariance:
    """As of `scatter_of`, with the discrepancy, which takes a pass over all samples."""
    found = scatter_of(problem, solution)
    return replace(found, discrepancy=discrepancy_covariance(problem, solution, found.names))


def scatter_of(problem: Problem, solution: Solution) -> Covariance:
    """Cluster-robust covariance of the free parameters that have an effect and are not at a bound; clusters are cells, since an equation
    that is nearly right errs alike in all repeats of one (Cameron & Miller 2015: cluster as widely as errors may be correlated)."""
    active = tuple(n for n in solution.free if n not in solution.insensitive and n not in solution.at_bound)
    weighing, at = solution.weighed(problem)
    covariance = cluster_covariance(
        solution.normal.by(problem.cells), active, lambda: colored_residuals(weighing, at, solution.normal, active)
    )
    return with_clock_error(covariance, clock_std_s(problem))


def clock_std_s(problem: Problem) -> float:
    """Standard error that the clocks put on every delay alike, s: references stamped on the ground, responses on the vehicle.

    The clock's own error bound as a uniform distribution, where it is not known the millisecond to which MAVLink rounds the vehicle's time.
    Zero where the vehicle stamped both, or where both step through time together. In a table edges are known to a row: on the average they
    may be as they stand there, or half a row earlier.
    """
    found = 0.0
    for segment in problem.segments:
        if segment.context.reference_clock == "ground":
            known_s = segment.context.clock_error_s
            found = max(found, (STAMP_S if known_s is None else known_s) / np.sqrt(3.0))
        found = max(found, segment.context.edge_error_s / np.sqrt(3.0))
    return float(found)


def with_clock_error(covariance: Covariance, std_s: float) -> Covariance:
    """The covariance with a common error of all delays added."""
    delays = np.array([n == "T_d" or n.startswith("T_d_") for n in covariance.names], dtype=float)
    if std_s <= 0.0 or not delays.any():
        return covariance
    extra = std_s**2 * np.outer(delays, delays)
    return replace(covariance, matrix=covariance.matrix + extra, model=covariance.model + extra)


def widened(covariance: Covariance, extra: Mapping[str, float]) -> Covariance:
    """The covariance with further errors of some parameters, by name as standard deviations; correlations are kept."""
    std = np.sqrt(np.diag(covariance.matrix))
    more = np.array([extra.get(n, 0.0) for n in covariance.names])
    ratio = np.hypot(std, more) / np.where(std > 0.0, std, 1.0)
    ratio[std <= 0.0] = 1.0
    return replace(covariance, matrix=covariance.matrix * np.outer(ratio, ratio))


def std_of(covariance: Covariance, name: str) -> float:
    """Standard error of one parameter."""
    i = covariance.names.index(name)
    return float(np.sqrt(covariance.matrix[i, i]))
