"""What an estimate from free flight shows of one part of the model, and what of it a fit by output error takes as it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.equation_error import Autoregression
from flighttest.estimation.uncertainty.covariance import interval_factor
from flighttest.identify.free_flight.chunks import InitialValues
from flighttest.physics.model import Model

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class HeldEstimate:
    """Parameters that a fit by output error takes as they are. values: by name; covariance (q, q) in the order of `names`; dof: degrees of
    freedom of its intervals; assumed: names whose error is mostly a prior's, or that nothing determines."""

    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: FloatArray
    dof: float
    assumed: frozenset[str] = frozenset()


@dataclass(frozen=True)
class FreeFlight:
    """What free flight shows of one part of the model: its translation, or its attitude loops.

    values: parameters by name, those of one flight as `name@flight`; std: standard errors of the estimated ones, robust over 1 to 5 s;
    covariance (q, q) in the order of `names`; between (q, q): what of it flights differ by; noise: spectrum of what is left, per channel;
    rms: per channel of the residual, SI units; seconds: of flight used; priors: names whose error is mostly the prior's, or that nothing
    determines; spread: by name of a shared parameter, the standard deviation by which flights differ in it beyond their errors; inflation:
    median ratio of the variances by blocks to those of the information alone, at least 1, by which differences of log likelihoods are to be
    divided (Burnham and Anderson 2002, section 2.5); blocks: of the robust covariance; part: of the model (`estimation.estimator.BLOCKS`);
    period_s: between the samples of the residual; initial: values of the states that nothing measured, in units of their prior standard
    deviation, that the equations are linear about.
    """

    model: Model
    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: FloatArray
    between: FloatArray
    noise: Mapping[str, Autoregression]
    rms: Mapping[str, float]
    seconds: float
    flights: tuple[str, ...]
    iterations: int
    converged: bool
    log_likelihood: float
    part: str
    period_s: float
    priors: frozenset[str] = frozenset()
    spread: Mapping[str, float] = field(default_factory=dict)
    inflation: float = 1.0
    blocks: int = 0
    initial: InitialValues = field(default_factory=dict)

    @property
    def held(self) -> HeldEstimate:
        """The estimate as a fit by output error takes it, with the degrees of freedom of the blocks of its covariance."""
        dof = float(max(self.blocks - len(self.names), 1))
        return HeldEstimate(self.names, self.values, self.covariance, dof, self.priors)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the estimated parameters, one with a value for each flight once."""
        return tuple(dict.fromkeys(n.split("@")[0] for n in self.names))

    @property
    def per_flight(self) -> tuple[str, ...]:
        """Those of them with a value for each flight."""
        return tuple(n for n in self.estimated if n not in self.names)

    def factor(self, level: float = 0.95) -> float:
        """Half an interval in standard errors (Student's t)."""
        return interval_factor(self.held.dof, level)

    def penalty(self, parameters: int) -> float:
        """Quasi-log-likelihood that so many parameters have to gain: half the logarithm of the number of blocks each (Schwarz 1978)."""
        return 0.5 * parameters * math.log(max(self.blocks, 2))

    @property
    def std(self) -> dict[str, float]:
        """Standard error of each estimated parameter."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def mixture(found: Sequence[FreeFlight]) -> FreeFlight:
    """The best of several local optima of one model, with the covariance of their mixture about it: weights by the quasi-likelihood, log
    likelihood over the inflation of its variance (McLachlan and Peel 2000, section 2.2)."""
    reached = [one for one in found if np.isfinite(one.log_likelihood)]
    if not reached:
        return found[0]
    best = max(reached, key=lambda one: one.log_likelihood)
    weights = np.exp([(one.log_likelihood - best.log_likelihood) / best.inflation for one in reached])
    apart = np.array([[one.values[n] - best.values[n] for n in best.names] for one in reached])
    between = (apart * (weights / weights.sum())[:, None]).T @ apart
    return replace(best, covariance=best.covariance + between)


def inflation_of(model: FloatArray, by_blocks: FloatArray) -> float:
    """Of covariances (q, q) by the information alone and by blocks: `FreeFlight.inflation`."""
    known = np.isfinite(np.diag(by_blocks)) & np.isfinite(np.diag(model)) & (np.diag(model) > 0.0)
    ratio = np.diag(by_blocks)[known] / np.diag(model)[known]
    return max(float(np.median(ratio)), 1.0) if ratio.size else 1.0
