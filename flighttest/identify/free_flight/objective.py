"""The objective of an estimate from free flight: prediction errors of the equations, whose noise is estimated with their parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import FitError
from flighttest.estimation.drift import LEVEL
from flighttest.estimation.equation_error import (
    PredictedStates,
    Stream,
    beside_random_effects,
    block_rows,
    heterogeneity,
    lack_of_fit,
    log_scale,
    misfit_of,
    noises,
    step,
    whiten,
    without_levels,
)
from flighttest.estimation.gauss_newton import Minimum, Space
from flighttest.identify.free_flight.chunks import InitialValues
from flighttest.identify.free_flight.equations import Equations
from flighttest.identify.free_flight.estimated import FreeFlight, inflation_of
from flighttest.identify.free_flight.priors import prior_of
from flighttest.physics.model import Model

FloatArray = NDArray[np.float64]

# Relative change of the innovations' standard deviation, by which log likelihoods move a nat in 100 samples.
SETTLED = 0.01
LEANS = 0.7  # of its prior's standard deviation: a parameter with a larger error was not determined by the flight


@dataclass(frozen=True)
class Unknowns:
    """What is estimated of a model: its part, the names that are free (None: all that act), those with a value for each flight, and priors,
    name or `name@flight` to (mean, standard deviation)."""

    model: Model
    part: str
    free: Sequence[str] | None
    per_flight: tuple[str, ...]
    priors: Mapping[str, tuple[float, float]]

    def prior(self, column: str) -> tuple[float, float]:
        """Mean and standard deviation, of a name or `name@flight`."""
        name = column.split("@")[0]
        return self.priors.get(column) or self.priors.get(name) or prior_of(self.model.param[name])


@dataclass(frozen=True)
class EvaluatedEquations:
    """Parameters theta (q,) and the equations there, about initial values of what nothing measured; finite: whether every stretch has
    finite residuals and Jacobian at its full length."""

    theta: FloatArray
    streams: Sequence[Stream]
    finite: bool
    initial: InitialValues


class _Errors(NamedTuple):
    """covariance, between (q, q), spread (q,), inflation and blocks, as of `FreeFlight`; determined (q,): by the data or a prior."""

    covariance: FloatArray
    between: FloatArray
    spread: FloatArray
    inflation: float
    blocks: int
    determined: NDArray[np.bool_]


class EquationObjective:
    """The objective of an estimate (`estimation.gauss_newton`): squares of the innovations and of the priors' departures, these times the
    inflation that log likelihoods are divided by. The noise of each channel is estimated anew at every step; initial states that nothing
    measured follow their predictions."""

    def __init__(
        self,
        equations: Equations,
        asked: Unknowns,
        values: Mapping[str, float],
        initial: InitialValues | None = None,
        inflation: float = 1.0,
    ) -> None:
        self.equations, self.asked, self.inflation = equations, asked, inflation
        self.names = [n for n in equations.params if asked.free is None or n in asked.free]
        self.base = dict(values)
        own = [n for n in asked.per_flight if n in self.names]
        self.base |= {f"{n}@{f}": values.get(f"{n}@{f}", values[n]) for f in equations.flights for n in own}
        self.initial = {**equations.at_rest, **(initial or {})}
        self.first, self.columns = self._at(self.base, self.initial)
        if not self.first:
            raise FitError("no stretch of free flight without gaps is long enough", "see `flighttest segment`")
        params = [asked.model.param[c.split("@")[0]] for c in self.columns]
        self.space = Space(*(np.array([getattr(p, k) for p in params]) for k in ("lower", "upper", "scale")))
        self.mean, self.asked_std = (np.array([asked.prior(c)[k] for c in self.columns]) for k in (0, 1))
        self.std = self.asked_std / math.sqrt(inflation)
        self.rows = block_rows(sum(float(np.ptp(s.t_s)) for s in equations.flown), equations.period_s)
        self.noise, self.log_determinant = noises(self.first, self.levels), 0.0
        self._learned: tuple[object, object] = self.first, self.noise  # residuals, and the noise of them
        self._known: tuple[object, object] = None, None  # residuals, and a noise, of which this is the misfit
        self._misfit = 0.0, 0.0

    @property
    def levels(self) -> dict[str, float]:
        """Channel to the standard deviation of its level, over the root of what log likelihoods are divided by."""
        return {s.channel: LEVEL[s.channel] / math.sqrt(self.inflation) for s in self.first if s.channel in LEVEL}

    @property
    def assumes(self) -> bool:
        """Whether anything is, which depends on the inflation."""
        return bool(self.levels) or bool(np.isfinite(self.asked_std).any())

    def start(self) -> EvaluatedEquations:
        """At the start values, inside the bounds."""
        given = np.array([self.base[c] for c in self.columns])
        inside = self.space.inside(given)
        if np.array_equal(inside, given):
            return EvaluatedEquations(given, self.first, finite=True, initial=self.initial)
        return self.point(inside, self.initial)

    def point(self, theta: FloatArray, initial: InitialValues) -> EvaluatedEquations:
        """The equations at parameters (q,), with their Jacobian."""
        streams, _ = self._at(self.values(theta), initial)
        # A residual that is not finite is no stretch: it must not pay to lose one.
        lengths = ([s.residual.size for s in some] for some in (streams, self.first))
        return EvaluatedEquations(theta, streams, len({*map(tuple, lengths)}) == 1, initial)

    def values(self, theta: FloatArray) -> dict[str, float]:
        """Every value by name."""
        return self.base | dict(zip(self.columns, theta.tolist(), strict=True))

    def _at(self, values: Mapping[str, float], initial: InitialValues) -> tuple[list[Stream], tuple[str, ...]]:
        with np.errstate(all="ignore"):
            return self.equations.streams(values, self.names, self.asked.per_flight, initial)

    def learn(self, at: EvaluatedEquations, _iteration: int) -> bool:
        """The noise of the residuals."""
        before = self.noise
        known = self._learned[0] is at.streams and self._learned[1] is self.noise
        if not known or any(s.initial for s in at.streams):
            self.noise = noises(beside_random_effects(at.streams, self.noise), self.levels)
            self._learned = at.streams, self.noise
        self.log_determinant = self._misfit_of(at)[1]
        return all(abs(self.noise[c].std / before[c].std - 1.0) < SETTLED for c in self.noise)

    def _misfit_of(self, at: EvaluatedEquations) -> tuple[float, float]:
        """As `misfit_of`, once for a point and a noise: `learn` and `cost` ask one after the other."""
        if self._known[0] is not at.streams or self._known[1] is not self.noise:
            self._known, self._misfit = (at.streams, self.noise), misfit_of(at.streams, self.noise)
        return self._misfit

    def cost(self, at: EvaluatedEquations) -> float:
        """Whitened sum of squares with the priors'; infinite where the model is not finite."""
        if not at.finite:
            return np.inf
        with np.errstate(over="ignore"):  # a step too far may diverge: its cost is infinite
            total, _ = self._misfit_of(at)
        return total + float(np.sum(((at.theta - self.mean) / self.std) ** 2))

    def log_likelihood(self, cost: float) -> float:
        """Of a cost, with the noise as learned last."""
        return -log_scale(self.first, self.noise) - 0.5 * (cost + self.log_determinant)

    def normal_equations(self, at: EvaluatedEquations) -> tuple[FloatArray, FloatArray, PredictedStates]:
        """Of innovations and priors, beside the initial states."""
        rows = whiten(at.streams, self.noise, self.rows)
        hessian, score = rows.information()
        return hessian + np.diag(self.std**-2.0), score + (self.mean - at.theta) / self.std**2, rows.states

    def stepped(
        self,
        at: EvaluatedEquations,
        target: FloatArray,
        nuisance: PredictedStates,
        share: float,
        *,
        differentiated: bool,
    ) -> EvaluatedEquations:
        """At other parameters, with initial states as predicted there; the equations come with their Jacobian in any case."""
        del differentiated
        step = share * nuisance.steps[..., 0] - nuisance.steps[..., 1:] @ (target - at.theta)
        initial = {n: x.copy() for n, x in at.initial.items()}
        for x, own in zip(initial.values(), step.T, strict=False):  # of none where no stretch is long enough
            x[nuisance.numbers] += own
        return self.point(target, initial)

    def refreshed(self, at: EvaluatedEquations) -> EvaluatedEquations:
        """The point itself, which has its Jacobian."""
        return at

    def nuisance_settled(self, _before: EvaluatedEquations, _after: EvaluatedEquations) -> bool:
        """They are predicted at every point."""
        return True

    def found(self, minimum: Minimum[EvaluatedEquations]) -> FreeFlight:
        """The answer at a minimum, with errors that hold what flights differ by."""
        at = minimum.point
        self.learn(at, minimum.iterations)
        known = self.errors(at)
        error = np.sqrt(np.diag(known.covariance))
        leans = np.isfinite(self.asked_std) & (error > LEANS * self.asked_std)
        leaning = frozenset(c for c, one in zip(self.columns, leans | ~known.determined, strict=True) if one)
        channels = dict.fromkeys(s.channel for s in at.streams)
        left = beside_random_effects(at.streams, without_levels(self.noise))
        every = {c: np.concatenate([s.residual for s in left if s.channel == c]) for c in channels}
        return FreeFlight(
            self.asked.model, self.columns, self.values(at.theta), known.covariance, known.between, self.noise,
            {c: float(np.sqrt(np.mean(r**2))) for c, r in every.items()},
            float(sum(s.t_s[-1] - s.t_s[0] for s in self.equations.flown)), self.equations.flights, minimum.iterations,
            minimum.status.good, self.log_likelihood(self.cost(at)), self.asked.part,
            self.equations.period_s, leaning,
            {c: float(v) for c, v in zip(self.columns, known.spread, strict=True) if v > 0.0},
            known.inflation, known.blocks, at.initial,
        )  # fmt: skip

    def errors(self, at: EvaluatedEquations) -> _Errors:
        """Of the parameters at a point, with what flights differ by."""
        rows = whiten(at.streams, self.noise, self.rows)
        made = step(rows, self.mean - at.theta, self.std, self.inflation)
        own = np.array(["@" in c for c in self.columns])
        spread, extra = heterogeneity(rows, own, self.std)
        lacks = lack_of_fit(beside_random_effects(at.streams, self.noise), self.noise)
        if self.asked.part == "translation":  # velocity and throttle drive all of it
            wrong = sum((lacks[c].ratio - 1.0) * ((x := rows.columns[rows.channel == c]).T @ x) for c in lacks)
        else:  # a moment of the air is driven by a velocity that is no state of the loops
            wrong = sum(lack.excess for lack in lacks.values())
        known = np.where(np.isfinite(made.covariance), made.covariance, 0.0)  # what is unknown stays so
        lacking = known @ wrong @ known
        robust = made.robust + lacking
        drift = np.diag([self.asked.model.param[c.split("@")[0]].drift ** 2 for c in self.columns])
        blocks = int(rows.block.max(initial=-1)) + 1
        determined = np.isfinite(np.diag(made.covariance))
        inflation = inflation_of(made.covariance, made.by_blocks + lacking)
        return _Errors(robust + extra + drift, extra, spread, inflation, blocks, determined)
