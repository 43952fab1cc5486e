"""Levenberg-Marquardt on a `Problem`, each response's own unknowns eliminated, so that cost is linear in the responses.

Minimised is the penalised least squares of output error: residuals over the channel's noise, initial states about their
measurement, and one constant disturbance per response as a random effect whose variance is estimated. Noise and random-effect
variances are updated beside the parameters. Outlying responses are weighted down (never dropped) and reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.problem import Noise, PartEvaluation, Problem, prior_std
from flighttest.estimation.weighing import Normal, State, Weighing

FloatArray = NDArray[np.float64]

MAX_ITERATIONS = 40
STEP_TOLERANCE = 0.05  # root mean square parameter step at the end, in standard errors of white noise
LOCAL_TOLERANCE = 0.05  # the same for the locals, in prior standard deviations, where only they are estimated
CHORD_TOLERANCE = 3.0  # steps smaller than this, in the same unit, keep the Jacobian
COST_TOLERANCE = 1e-6  # or: relative decrease of the cost by the last step
INSENSITIVE = 1e-4
MAX_REJECTIONS = 9
FLAT_STEPS = 4  # steps in a row that do not lower the cost: a kink (an edge passing a sample) or a flat direction


class FitStatus(Enum):
    """How the solver ended. The value is the sentence shown to the reader."""

    CONVERGED = "the estimate converged"
    AT_BOUND = "the estimate converged with a parameter at its bound; see which, and what would make it known"
    NO_DESCENT = "no step lowers the error any further, though it is not small; treat the intervals with care"
    MAX_ITERATIONS = "the solver stopped before it converged; check the segments and the start values"

    @property
    def good(self) -> bool:
        """Whether the estimate is a minimum."""
        return self in (FitStatus.CONVERGED, FitStatus.AT_BOUND)


@dataclass(frozen=True)
class Solution:
    """values: every parameter; free: those estimated; insensitive: free ones without any effect in this data, left at their start;
    at_bound; local: per part (m, n_locals); response_weight: (n_segments,); iterations."""

    status: FitStatus
    values: dict[str, float]
    free: tuple[str, ...]
    insensitive: tuple[str, ...]
    at_bound: tuple[str, ...]
    local: tuple[FloatArray, ...]
    noise: Noise
    response_weight: FloatArray
    evaluations: tuple[PartEvaluation, ...]
    normal: Normal
    cost: float
    iterations: int


@dataclass(frozen=True)
class _Space:
    """The parameters that are estimated, with bounds and scales (p,); base: all values, for those that are not."""

    names: tuple[str, ...]
    base: Mapping[str, float]
    lower: FloatArray
    upper: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, problem: Problem, names: Sequence[str], start: Mapping[str, float]) -> _Space:
        params = [problem.model.param[n] for n in names]
        lower, upper, scale = (np.array([getattr(p, k) for p in params]) for k in ("lower", "upper", "scale"))
        return cls(tuple(names), problem.full_values(start), lower, upper, scale)

    @property
    def start(self) -> FloatArray:
        """(p,), inside the bounds."""
        return np.asarray(np.clip([self.base[n] for n in self.names], self.lower, self.upper), dtype=float)

    def values(self, theta: FloatArray) -> dict[str, float]:
        """Every value by name."""
        return {**self.base, **dict(zip(self.names, theta.tolist(), strict=True))}

    def moved(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """A step taken in the logarithm of parameters that are positive by nature (lags, gains), at most by a factor of two; in bounds."""
        positive = (self.lower > 0) & (theta > 0)
        ratio = np.exp(np.clip(step / np.where(positive, theta, 1.0), -0.7, 0.7))
        return np.clip(np.where(positive, theta * ratio, theta + step), self.lower, self.upper)

    def at_bound(self, theta: FloatArray) -> tuple[str, ...]:
        """Parameters that lie on a bound."""
        return tuple(
            n for n, t, lo, up in zip(self.names, theta, self.lower, self.upper, strict=True) if t <= lo or t >= up
        )


@dataclass(frozen=True)
class _QuadraticModel:
    """The cost's parabola at a state: h (p, p), g (p,), backs to the locals; insensitive (p,): without effect; active: free to move."""

    cost: float
    h: FloatArray
    g: FloatArray
    backs: list[tuple[FloatArray, FloatArray]]
    insensitive: NDArray[np.bool_]
    active: NDArray[np.intp]

    @classmethod
    def at(cls, now: State, weighing: Weighing, space: _Space) -> _QuadraticModel:
        normal, backs = weighing.normal_equations(now, space.names)
        h, g = normal.hessian.sum(axis=0), normal.score.sum(axis=0)
        sensed = np.diag(h) * space.scale**2
        # Information in units of the parameter's own scale: below this its standard error is a hundred scales.
        insensitive = sensed < max(1e-14 * float(sensed.max(initial=0.0)), INSENSITIVE)
        pushed = ((now.theta <= space.lower) & (g < 0)) | ((now.theta >= space.upper) & (g > 0))
        return cls(weighing.cost(now), h, g, backs, insensitive, np.flatnonzero(~insensitive & ~pushed))

    def step(self, damping: float) -> FloatArray:
        """Levenberg's step (p,), the Hessian scaled to a unit diagonal."""
        found = np.zeros(self.g.size)
        if self.active.size:
            sub = self.h[np.ix_(self.active, self.active)]
            root = np.sqrt(np.diag(sub))
            scaled = sub / np.outer(root, root) + damping * np.eye(root.size)
            found[self.active] = np.linalg.lstsq(scaled, self.g[self.active] / root, rcond=1e-13)[0] / root
        return found

    def small(self, step: FloatArray, tolerance: float) -> bool:
        """Whether a step is small against what the data can resolve."""
        sub = self.h[np.ix_(self.active, self.active)]
        return bool(step[self.active] @ sub @ step[self.active] <= tolerance**2 * max(self.active.size, 1))


def solve(
    problem: Problem,
    start: Mapping[str, float] | None = None,
    *,
    free: Sequence[str] | None = None,
    robust: bool = True,
    noise: Noise | None = None,
    local: Sequence[FloatArray] | None = None,
    estimate_noise: bool = True,
    max_iterations: int = MAX_ITERATIONS,
) -> Solution:
    """Minimise from `start` (default: the problem's values).

    free: names to estimate, default problem.names; with none, only initial states and disturbances are estimated, which is how
    a fit is judged on segments it has not seen. noise, local: a previous fit's, to start from (or, with estimate_noise False,
    to keep).
    """
    space = _Space.of(problem, problem.names if free is None else free, start or {})
    warm = noise is not None
    least = 2 if warm or not robust else 4
    weighing = Weighing.even(problem, noise, robust=robust)
    begun = [np.array(x) for x in local] if local is not None else [part.start_local() for part in problem.parts]
    now = State(space.start, begun, problem.evaluate(space.values(space.start), begun, space.names))
    damping, status, iteration, flat = 1e-3, FitStatus.MAX_ITERATIONS, 0, 0
    insensitive = np.zeros(len(space.names), dtype=bool)
    for iteration in range(1, max_iterations + 1):
        previous = weighing.noise
        if estimate_noise:
            weighing = weighing.with_noise_of(now, space.names)
        if robust and (warm or iteration > 2):
            weighing = weighing.by_response(now.made)
        quadratic = _QuadraticModel.at(now, weighing, space)
        insensitive = quadratic.insensitive
        full_step = space.moved(now.theta, quadratic.step(1e-9)) - now.theta
        trial, new_cost, damping = _descend(now, quadratic, weighing, space, damping)
        if trial is None and now.stale:
            now = State(now.theta, now.local, problem.evaluate(space.values(now.theta), now.local, space.names))
            continue
        if trial is None:
            status = FitStatus.CONVERGED if quadratic.small(full_step, 0.2) else FitStatus.NO_DESCENT
            break
        flat = flat + 1 if quadratic.cost - new_cost <= max(COST_TOLERANCE * quadratic.cost, 0.01) else 0
        still = bool(quadratic.active.size) or _locals_settled(problem, now.local, trial.local, weighing.noise)
        now = trial
        settled = _settled(previous, weighing.noise) or not estimate_noise
        near = quadratic.small(full_step, STEP_TOLERANCE) or (flat > 0 and damping <= 1e-2) or flat >= FLAT_STEPS
        if still and near and settled and iteration >= least:
            status = FitStatus.CONVERGED
            break
        damping = damping / 10.0 if damping > 1e-9 else 0.0
    at_bound = space.at_bound(now.theta)
    if status is FitStatus.CONVERGED and at_bound:
        status = FitStatus.AT_BOUND
    return Solution(
        status=status,
        values=problem.full_values(space.values(now.theta)),
        free=space.names,
        insensitive=tuple(n for n, b in zip(space.names, insensitive, strict=True) if b),
        at_bound=at_bound,
        local=tuple(now.local),
        noise=weighing.noise,
        response_weight=weighing.response,
        evaluations=tuple(now.made),
        normal=weighing.normal_equations(now, space.names)[0],
        cost=weighing.cost(now),
        iterations=iteration,
    )


def _descend(
    now: State, quadratic: _QuadraticModel, weighing: Weighing, space: _Space, damping: float
) -> tuple[State | None, float, float]:
    """A state of no higher cost, its cost, and the damping that led there; None where no step found one."""
    problem = weighing.problem
    for _ in range(MAX_REJECTIONS):
        target = space.moved(now.theta, quadratic.step(damping))
        moved = target - now.theta
        local = [
            x + back_g - np.einsum("mlp,p->ml", back_h, moved)
            for x, (back_g, back_h) in zip(now.local, quadratic.backs, strict=True)
        ]
        if quadratic.active.size and quadratic.small(moved, CHORD_TOLERANCE):
            # So near that the Jacobian is known: residuals alone cost a fifth.
            fresh = problem.evaluate(space.values(target), local)
            made = [replace(old, residual=new.residual) for old, new in zip(now.made, fresh, strict=True)]
            trial = State(target, local, made, stale=True)
        else:
            trial = State(target, local, problem.evaluate(space.values(target), local, space.names))
        cost = weighing.cost(trial)
        if np.isfinite(cost) and cost <= quadratic.cost * (1 + 1e-9) + 1e-9:
            return trial, cost, damping
        if now.stale:
            break
        damping = max(damping * 10.0, 1e-3)
    return None, np.inf, damping


def _locals_settled(problem: Problem, before: Sequence[FloatArray], after: Sequence[FloatArray], noise: Noise) -> bool:
    return all(
        bool(np.all(np.abs(b - a) < LOCAL_TOLERANCE * prior_std(part, noise)))
        for part, a, b in zip(problem.parts, before, after, strict=True)
    )


def _settled(before: Noise, after: Noise) -> bool:
    return all(abs(after.channel[c] / before.channel[c] - 1.0) < 0.03 for c in after.channel)
