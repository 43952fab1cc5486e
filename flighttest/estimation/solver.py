"""The estimate of a `Problem`: `gauss_newton.minimise` with each response's nuisance parameters eliminated, so that cost is linear in the
responses.

Minimised is the penalised least squares of output error: residuals over the channel's noise, initial states about their
measurement, and one constant disturbance per response as a random effect whose variance is estimated. Noise and random-effect
variances are updated beside the parameters. Outlying responses are weighted down (never dropped) and reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import FitError
from flighttest.estimation.gauss_newton import MAX_ITERATIONS, FitStatus, Space, Tolerances, minimise
from flighttest.estimation.likelihood_weights import LikelihoodWeights, Normal, State
from flighttest.estimation.problem import Noise, PartEvaluation, Problem, prior_std

FloatArray = NDArray[np.float64]
Backs = list[tuple[FloatArray, FloatArray]]

CORRELATIONS = 4  # times that it is learned in a fit; the mean with what was known before lets it settle
LOCAL_TOLERANCE = (
    0.05  # step of the nuisance parameters at the end, in prior standard deviations, where only they are estimated
)


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

    def weighed(self, problem: Problem) -> tuple[LikelihoodWeights, State]:
        """How the problem's residuals are weighed at this optimum, single samples far out less, and where it stands."""
        weighing = LikelihoodWeights(problem, self.noise, self.response_weight, robust=True)
        return weighing, State(np.zeros(0), list(self.local), list(self.evaluations))


@dataclass
class _PenalisedCost:
    """The objective of a `Problem` by the `names`; base: every value, for those that are not estimated. weighing changes on the way;
    correlations_left: how often the correlation of velocities is still learned, each time that the variances have settled."""

    problem: Problem
    names: tuple[str, ...]
    base: Mapping[str, float]
    weighing: LikelihoodWeights
    robust_from: int | None  # iteration from which responses are weighted down
    estimate_noise: bool
    correlations_left: int

    def values(self, theta: FloatArray) -> dict[str, float]:
        """Every value by name."""
        return {**self.base, **dict(zip(self.names, theta.tolist(), strict=True))}

    def begun(self, theta: FloatArray, local: list[FloatArray]) -> State:
        """Evaluated with its Jacobian."""
        return State(theta, local, self.problem.evaluate(self.values(theta), local, self.names))

    def learn(self, at: State, iteration: int) -> bool:
        """Noise, variances of the nuisance parameters and weights of responses, from the residuals."""
        previous = self.weighing.noise
        if self.estimate_noise:
            self.weighing = self.weighing.with_noise_of(at, self.names)
        if self.correlations_left and _settled(previous, self.weighing.noise):
            known, self.correlations_left = self.weighing, self.correlations_left - 1
            self.weighing = known.with_correlation_of(at)
            if self.weighing is not known:
                return False
            self.correlations_left = 0
        if self.robust_from is not None and iteration >= self.robust_from:
            self.weighing = self.weighing.by_response(at.made)
        return _settled(previous, self.weighing.noise) or not self.estimate_noise

    def cost(self, at: State) -> float:
        """`LikelihoodWeights.cost`."""
        return self.weighing.cost(at)

    def log_likelihood(self, cost: float) -> float:
        """`log_likelihood` in the noise as learned last."""
        return log_likelihood(self.problem, self.weighing.noise, cost)

    def normal_equations(self, at: State) -> tuple[FloatArray, FloatArray, Backs]:
        """Summed over the responses."""
        normal, backs = self.weighing.normal_equations(at, self.names)
        return normal.hessian.sum(axis=0), normal.score.sum(axis=0), backs

    def stepped(self, at: State, target: FloatArray, nuisance: Backs, share: float, *, differentiated: bool) -> State:
        """With the nuisance parameters a share of the way to where the quadratic model has them for these parameters."""
        moved = target - at.theta
        local = [
            x + share * back_g - np.einsum("mlp,p->ml", back_h, moved)
            for x, (back_g, back_h) in zip(at.local, nuisance, strict=True)
        ]
        names = self.names if differentiated else None
        return State(target, local, self.problem.evaluate(self.values(target), local, names))

    def refreshed(self, at: State) -> State:
        """Evaluated anew."""
        return self.begun(at.theta, at.local)

    def nuisance_settled(self, before: State, after: State) -> bool:
        """Against their prior standard deviations."""
        return all(
            bool(np.all(np.abs(b - a) < LOCAL_TOLERANCE * prior_std(part, self.weighing.noise)))
            for part, a, b in zip(self.problem.parts, before.local, after.local, strict=True)
        )


@dataclass(frozen=True)
class Start:
    """Where an estimate begins. values: parameters by name, the problem's own where they are not given; noise, nuisance: a previous
    estimate's noise, whose correlation is kept where it has one, and its nuisance parameters, name to (n_segments,)."""

    values: Mapping[str, float] = field(default_factory=dict)
    noise: Noise | None = None
    nuisance: Mapping[str, FloatArray] = field(default_factory=dict)


def solve(
    problem: Problem,
    start: Mapping[str, float] | Start | None = None,
    *,
    free: Sequence[str] | None = None,
    robust: bool = True,
    estimate_noise: bool = True,
    max_iterations: int = MAX_ITERATIONS,
    tolerances: Tolerances | None = None,
) -> Solution:
    """Minimise from `start` (default: the problem's values).

    free: names to estimate, default problem.names; with none, only initial states and disturbances are estimated, which is how
    a fit is judged on segments it has not seen. estimate_noise: False keeps the noise of the start.
    max_iterations: with 0 what is known at the start is given back.
    """
    begin = start if isinstance(start, Start) else Start(start or {})
    names = tuple(problem.names if free is None else free)
    params = [problem.model.param[n] for n in names]
    space = Space(*(np.array([getattr(p, k) for p in params]) for k in ("lower", "upper", "scale")))
    warm = begin.noise is not None
    objective = _PenalisedCost(
        problem,
        names,
        problem.full_values(begin.values),
        LikelihoodWeights.even(problem, begin.noise, robust=robust),
        robust_from=None if not robust else 1 if warm else 3,
        estimate_noise=estimate_noise,
        correlations_left=0 if not estimate_noise or (begin.noise and begin.noise.correlation) else CORRELATIONS,
    )
    theta = space.inside(np.array([objective.base[n] for n in names]))
    found = minimise(
        objective,
        objective.begun(theta, problem.placed(begin.nuisance)),
        space,
        tolerances=tolerances,
        least_iterations=2 if warm or not robust else 4,
        max_iterations=max_iterations,
    )
    now, weighing = found.point, objective.weighing
    return Solution(
        status=found.status,
        values=problem.full_values(objective.values(now.theta)),
        free=names,
        insensitive=tuple(n for n, one in zip(names, found.insensitive, strict=True) if one),
        at_bound=tuple(n for n, one in zip(names, found.at_bound, strict=True) if one),
        local=tuple(now.local),
        noise=weighing.noise,
        response_weight=weighing.response,
        evaluations=tuple(now.made),
        normal=weighing.normal_equations(now, names)[0] if now.finite else _no_information(problem, names),
        cost=weighing.cost(now) if now.finite else float("inf"),
        iterations=found.iterations,
    )


def log_likelihood(problem: Problem, noise: Noise, cost: float) -> float:
    """Log density of the samples and the disturbances, but for a constant, at a whitened sum of squares `cost`."""
    scale = 0.0
    for part in problem.parts:
        count = part.mask.sum(axis=(0, 1))
        scale += sum(n * np.log(noise.channel[c]) for n, c in zip(count, part.outputs, strict=True))
        scale += len(part.responses) * sum(np.log(noise.disturbance[d]) for d in part.block.disturbances)
    return float(-scale - 0.5 * cost)


def finite_or_error(solution: Solution) -> Solution:
    """The solution itself. FitError where nothing could be computed from its start."""
    if solution.status is FitStatus.DIVERGED:
        raise FitError(
            "the model's responses to these segments are not finite",
            "see `flighttest segment` for what was used, and look for absurd values in the references and measurements",
        )
    return solution


def _no_information(problem: Problem, names: tuple[str, ...]) -> Normal:
    n, p = len(problem.segments), len(names)
    return Normal(names, np.zeros((n, p, p)), np.zeros((n, p)))


def _settled(before: Noise, after: Noise) -> bool:
    return all(abs(after.channel[c] / before.channel[c] - 1.0) < 0.03 for c in after.channel)
