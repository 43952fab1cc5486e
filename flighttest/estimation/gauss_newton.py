"""Damped Gauss-Newton (Levenberg 1944, Marquardt 1963) within bounds: the one step loop of every estimate. The damping follows the ratio of
the decrease to what the quadratic model expects (Nielsen; Madsen, Nielsen & Tingleff 2004, Methods for Non-Linear Least Squares Problems).

The loop works on an `Objective`: a sum of squares whose noise may be learned on the way and whose nuisance parameters are profiled out, so
that only the parameters are seen here. Residuals are whitened: steps and tolerances are in standard errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MAX_ITERATIONS = 40
INSENSITIVE = 1e-4
MAX_REJECTIONS = 9
LEAST_DAMPING = 1e-3  # of the Hessian scaled to a unit diagonal, at the start and after a step that was refused


class FitStatus(Enum):
    """How the solver ended. The value is the sentence shown to the reader."""

    CONVERGED = "the estimate converged"
    AT_BOUND = "the estimate converged with a parameter at its bound; see which, and what would make it known"
    NO_DESCENT = "no step lowers the error any further, though it is not small; treat the intervals with care"
    MAX_ITERATIONS = "the solver stopped before it converged; check the segments and the start values"
    DIVERGED = "the simulated responses are not finite at the start values"

    @property
    def good(self) -> bool:
        """Whether the estimate is a minimum."""
        return self in (FitStatus.CONVERGED, FitStatus.AT_BOUND)


@dataclass(frozen=True)
class Tolerances:
    """When the loop ends.

    step: root mean square parameter step, in standard errors; end: the same where no step lowers the cost; cost: relative decrease of the
    cost by the last step, or decrease, absolute; flat: steps in a row that lower it by no more (a kink, where an edge passes a sample, or a
    flat direction). compared_with: log likelihood of the model that this one is compared with: the loop ends where it has gained, and
    expects to gain, less than `share` of what separates the two.
    """

    step: float = 0.05
    end: float = 0.2
    cost: float = 1e-6
    decrease: float = 0.01
    flat: int = 4
    compared_with: float | None = None
    share: float = 0.02


@dataclass(frozen=True)
class Space:
    """Bounds of the parameters, infinite where there are none, and the scale on which each is worth knowing; all (p,)."""

    lower: FloatArray
    upper: FloatArray
    scale: FloatArray

    def inside(self, theta: FloatArray) -> FloatArray:
        """The nearest point within the bounds."""
        return np.asarray(np.clip(theta, self.lower, self.upper), dtype=float)

    def moved(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """A step taken in the logarithm of parameters that are positive by nature (lags, gains), at most by a factor of two; in bounds."""
        positive = (self.lower > 0) & (theta > 0)
        ratio = np.exp(np.clip(step / np.where(positive, theta, 1.0), -0.7, 0.7))
        return self.inside(np.where(positive, theta * ratio, theta + step))

    def at_bound(self, theta: FloatArray) -> BoolArray:
        """(p,): which lie on a bound."""
        return np.asarray((theta <= self.lower) | (theta >= self.upper))


class Point(Protocol):
    """Where the loop stands. theta (p,); finite: whether residuals and Jacobian are numbers that can be squared and summed."""

    @property
    def theta(self) -> FloatArray:
        """Parameters."""

    @property
    def finite(self) -> bool:
        """Whether a step can be computed from here."""


P = TypeVar("P", bound=Point)
N = TypeVar("N")  # what takes a step of the parameters to the nuisance parameters


class Objective(Protocol[P, N]):
    """A sum of squares."""

    def learn(self, at: P, iteration: int) -> bool:
        """Learn noise and weights from the residuals, counted from iteration 1; whether they have settled."""

    def cost(self, at: P) -> float:
        """Penalised sum of squares, whitened."""

    def log_likelihood(self, cost: float) -> float:
        """Of a cost, in the noise as learned last."""

    def normal_equations(self, at: P) -> tuple[FloatArray, FloatArray, N]:
        """Gauss-Newton Hessian (p, p) and minus half the gradient (p,), nuisance parameters profiled out."""

    def stepped(self, at: P, target: FloatArray, nuisance: N, share: float, *, differentiated: bool) -> P:
        """At other parameters; differentiated: with its Jacobian. share: of their own step that nuisance parameters take."""

    def refreshed(self, at: P) -> P:
        """The same point with its Jacobian."""

    def nuisance_settled(self, before: P, after: P) -> bool:
        """Whether the nuisance parameters have stopped moving."""


@dataclass(frozen=True)
class Minimum(Generic[P]):
    """Where the loop ended. insensitive, at_bound: (p,), parameters without effect in the data (left where they were), on a bound."""

    point: P
    status: FitStatus
    insensitive: BoolArray
    at_bound: BoolArray
    iterations: int


@dataclass(frozen=True)
class _QuadraticModel(Generic[N]):
    """The cost to second order at a point: h (p, p), g (p,); insensitive (p,): without effect; active: positions free to move."""

    cost: float
    h: FloatArray
    g: FloatArray
    nuisance: N
    insensitive: BoolArray
    active: NDArray[np.intp]

    @classmethod
    def at(cls, now: P, objective: Objective[P, N], space: Space) -> _QuadraticModel[N]:
        h, g, nuisance = objective.normal_equations(now)
        sensed = np.diag(h) * space.scale**2
        # Information in units of the parameter's own scale: below this its standard error is a hundred scales.
        insensitive = sensed < max(1e-14 * float(sensed.max(initial=0.0)), INSENSITIVE)
        pushed = ((now.theta <= space.lower) & (g < 0)) | ((now.theta >= space.upper) & (g > 0))
        return cls(objective.cost(now), h, g, nuisance, insensitive, np.flatnonzero(~insensitive & ~pushed))

    def step(self, damping: float) -> FloatArray:
        """Levenberg's step (p,), the Hessian scaled to a unit diagonal."""
        found = np.zeros(self.g.size)
        if self.active.size:
            sub = self.h[np.ix_(self.active, self.active)]
            root = np.sqrt(np.diag(sub))
            scaled = sub / np.outer(root, root) + damping * np.eye(root.size)
            found[self.active] = np.linalg.lstsq(scaled, self.g[self.active] / root, rcond=1e-13)[0] / root
        return found

    def expected(self, step: FloatArray) -> float:
        """By how much the full step of Gauss and Newton lowers the cost, to second order."""
        sub = self.h[np.ix_(self.active, self.active)]
        return float(step[self.active] @ sub @ step[self.active])

    def gain_ratio(self, step: FloatArray, lowered: float) -> float:
        """How much a step lowered the cost, over what it lowers the quadratic model by; 1 where it lowers that one by nothing."""
        expected = float(2.0 * self.g @ step - step @ self.h @ step)
        return lowered / expected if expected > 0.0 else 1.0

    def small(self, step: FloatArray, tolerance: float) -> bool:
        """Whether a step is small against what the data can resolve."""
        return self.expected(step) <= tolerance**2 * max(self.active.size, 1)


def minimise(
    objective: Objective[P, N],
    start: P,
    space: Space,
    *,
    tolerances: Tolerances | None = None,
    least_iterations: int = 2,
    max_iterations: int = MAX_ITERATIONS,
) -> Minimum[P]:
    """The minimum reached from `start`, which lies within the bounds."""
    limits = tolerances or Tolerances()
    now, damping, status, iteration, flat = start, LEAST_DAMPING, FitStatus.MAX_ITERATIONS, 0, 0
    if not start.finite:
        nothing = np.ones(start.theta.size, dtype=bool)
        return Minimum(start, FitStatus.DIVERGED, nothing, ~nothing, 0)
    insensitive = _QuadraticModel.at(start, objective, space).insensitive
    for iteration in range(1, max_iterations + 1):
        settled = objective.learn(now, iteration)
        quadratic = _QuadraticModel.at(now, objective, space)
        insensitive = quadratic.insensitive
        full_step = space.moved(now.theta, quadratic.step(1e-9)) - now.theta
        trial, new_cost, damping = _descend(now, quadratic, objective, space, damping)
        if trial is None:
            status = FitStatus.CONVERGED if quadratic.small(full_step, limits.end) else FitStatus.NO_DESCENT
            break
        lowered = quadratic.cost - new_cost
        flat = flat + 1 if lowered <= max(limits.cost * quadratic.cost, limits.decrease) else 0
        still = bool(quadratic.active.size) or objective.nuisance_settled(now, trial)
        ratio = min(max(quadratic.gain_ratio(trial.theta - now.theta, lowered), 0.0), 1.0)
        now = trial
        near = quadratic.small(full_step, limits.step) or (flat > 0 and damping <= 1e-2) or flat >= limits.flat
        if limits.compared_with is not None:
            # Not along a curved ridge, where steps gain little though much is left.
            apart = abs(objective.log_likelihood(new_cost) - limits.compared_with)
            near = near or max(lowered, quadratic.expected(full_step)) <= 2.0 * limits.share * apart
        if still and near and settled and iteration >= least_iterations:
            status = FitStatus.CONVERGED
            break
        damping *= max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
    at_bound = space.at_bound(now.theta)
    if status is FitStatus.CONVERGED and at_bound.any():
        status = FitStatus.AT_BOUND
    return Minimum(now, status, insensitive, at_bound, iteration)


def _descend(
    now: P, quadratic: _QuadraticModel[N], objective: Objective[P, N], space: Space, damping: float
) -> tuple[P | None, float, float]:
    """A point of no higher cost, its cost, and the damping that led there; None where no step found one."""
    for rejected in range(MAX_REJECTIONS):
        target = space.moved(now.theta, quadratic.step(damping))
        # The first step is kept in seven of ten cases or more, its Jacobian with it; of others the residuals come first: less than half.
        first = not rejected
        trial = objective.stepped(now, target, quadratic.nuisance, 1.0 / (1.0 + damping), differentiated=first)
        cost = objective.cost(trial)
        if trial.finite and np.isfinite(cost) and cost <= quadratic.cost * (1 + 1e-9) + 1e-9:
            kept = trial if first else objective.refreshed(trial)
            if kept.finite:
                return kept, cost, damping
        damping = max(damping, LEAST_DAMPING) * 2.0 ** (rejected + 1)
    return None, np.inf, damping
