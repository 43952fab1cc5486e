"""Free flight by prediction errors: the translation at the measured attitude and velocity (equation error), the attitude loops as their
references alone make them (`loops`); an hour of flight in seconds.

    flown = stretches(segments)                      # windows of free flight joined
    found = estimate(flown, Model())                 # K, alpha, drag, lag and delay with errors
    found = estimate(flown, Model(), part="roll_pitch")     # natural frequencies, dampings and delay of roll and pitch
    found = estimate(flown, Model() + "steady_wind", per_flight=("w_north", "w_west"))   # one wind per flight, drag shared

Of the translation, where an accelerometer was recorded, its three axes are the equations; else the increments of velocity, world axes,
against the mean of the modelled acceleration at both ends. Both are compared over whole stretches, without integration of the velocity, so
that a gust is noise of its own moment and of no later one; what a load swung by at their start is a random effect
(`estimation.equation_error.initial_states`). The noise is autoregressive and estimated
(`estimation.equation_error`), which keeps estimates consistent where a pilot or a position loop answers gusts, as long as the model is
driven by the past alone: by commands, which act after a delay, and by the velocity predicted from the samples before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from flighttest.estimation.gauss_newton import Minimum, Space, Tolerances, minimise
from flighttest.identify.dead_time import thrust_gain
from flighttest.identify.free_flight.chunks import InitialValues
from flighttest.identify.free_flight.equations import Equations
from flighttest.identify.free_flight.estimated import FreeFlight, inflation_of, mixture
from flighttest.identify.free_flight.priors import DRAG, prior_of
from flighttest.identify.free_flight.stretches import most_moved
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

# Relative change of the innovations' standard deviation, by which log likelihoods move a nat in 100 samples.
SETTLED = 0.01
DELAYS_S = (0.02, 0.08, 0.2)
# Lags and delays that local optima are looked for from, by part of the model.
STARTS: Mapping[str, tuple[dict[str, float], ...]] = {
    "translation": tuple({"sigma_t": s, "T_d_thrust": d, "T_d": d} for s in (15.0, 6.0) for d in DELAYS_S),
    "roll_pitch": tuple(
        {"omega_phi": w, "omega_theta": w, "T_d_attitude": d, "T_d": d} for w in (20.0, 7.0) for d in DELAYS_S
    ),
    "yaw": tuple({"sigma_r": s, "T_d_yaw_rate": d, "T_d": d} for s in (15.0, 4.0) for d in DELAYS_S),
}
INPUTS = {
    "translation": ("throttle",), "roll_pitch": ("roll_ref_rad", "pitch_ref_rad"), "yaw": ("yaw_rate_ref_rad_s",),
}  # fmt: skip
START_S, PIECES = 60.0, 4  # of flight that local optima are looked for in
FIRST_ITERATIONS = 6
LEANS = 0.7  # of its prior's standard deviation: a parameter with a larger error was not determined by the flight


def start_of(flown: Sequence[Segment], model: Model) -> dict[str, float]:
    """Start values: K from the ratio of force to throttle, drag nominal, lag and delay of usual motors, else as of a model."""
    values = model.start()
    gain = thrust_gain(flown, model.nominal_voltage_v)
    if gain is not None and "K" in model.param:
        values["K"] = float(np.clip(gain, model.param["K"].lower * 1.01, model.param["K"].upper * 0.99))
    return values | {n: v for n, v in STARTS["translation"][0].items() if n in values}


def estimate(
    flown: Sequence[Segment],
    model: Model,
    *,
    part: str = "translation",
    start: Mapping[str, float] | Sequence[Mapping[str, float]] | None = None,
    free: Sequence[str] | None = None,
    per_flight: Sequence[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> FreeFlight:
    """Gauss-Newton on the whitened equations, noise and parameters in turn.

    flown: of `stretches`; part: of the model, one of `estimation.estimator.BLOCKS`; start: parameters by name, those of one flight as
    `name@flight` (default: from the flight itself), or several such, of which each may lead to another local optimum; free: names that are
    estimated (default: all that act); per_flight: names with a value per flight; priors: name, or `name@flight`, to (mean, standard
    deviation). FitError where there is nothing to estimate from.

    Where flights have winds of their own, and `start` has none, much drag in little wind is a local optimum beside little drag in much
    wind: both are sought. Of several optima the covariance is that of their mixture (`mixture`).
    """
    if not flown:
        raise FitError(
            "no free flight with attitude, velocity and throttle of 4 s or more",
            "see `flighttest segment` for what was recorded",
        )
    asked = _Asked(model, part, free, tuple(per_flight), dict(priors or {}))
    given = start if isinstance(start, Sequence) else [start or {}]
    first, *others = [{**start_of(flown, model), **one} for one in given]
    searched = set(STARTS[part][0]) & set(model.names if free is None else free)
    starts = [first if searched & set(given[0]) else _with_lag(flown, asked, first), *others]
    if per_flight and not any("@" in n for n in given[0]):
        usual = {p.name: p.nominal for p in model.params if p.name in DRAG}
        starts += [starts[0] | usual, _with_lag(flown, asked, first | usual)]
    return mixture(_optima(Equations(model, flown, part), asked, starts))


def covariance_at(
    flown: Sequence[Segment],
    found: FreeFlight,
    null: Mapping[str, float],
    *,
    free: Sequence[str] | None = None,
    per_flight: Sequence[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> FloatArray:
    """Covariance (q, q) of an estimate in the order of `names`, without what flights differ by, for a test of whether coefficients are at
    `null` (name to value): with the innovations and the noise of the estimate, and the derivatives where the coefficients are there.

    A Wald test depends on how a product is written (Gregory and Veall 1985). A moment of the air acts as M / omega^2: M of 11.6 +- 3.4
    beside an omega of 17.2 +- 2.4 rad/s was not significant at the estimate, where log likelihood had grown by 135. With the derivatives
    of where M is nothing the test is the same in M and in M / omega^2. free, per_flight, priors: as `estimate` was given.
    Infinite where the equations are not finite there.
    """
    objective = _PredictionErrors(
        Equations(found.model, flown, found.part),
        _Asked(found.model, found.part, free, tuple(per_flight), dict(priors or {})),
        found.values,
        found.initial,
        found.inflation,
    )
    objective.noise = dict(found.noise)
    at_null = np.array([null.get(c.split("@")[0], found.values[c]) for c in objective.columns])
    nothing = objective.point(at_null, found.initial)
    if not nothing.finite:
        return np.full(found.covariance.shape, np.inf)
    streams = [replace(s, columns=n.columns) for s, n in zip(objective.first, nothing.streams, strict=True)]
    theta = np.array([found.values[c] for c in objective.columns])
    known = objective.errors(_Point(theta, streams, finite=True, initial=found.initial))
    return known.covariance - known.between


def _with_lag(flown: Sequence[Segment], asked: _Asked, values: Mapping[str, float]) -> dict[str, float]:
    """Start values with the best of several local optima of lag and delay, each followed for a while on a part of the flight."""
    equations = Equations(asked.model, most_moved(flown, INPUTS[asked.part], START_S, PIECES), asked.part)
    held = () if asked.free is None else set(values) - set(asked.free)
    starts = [{n: v for n, v in one.items() if n not in held} for one in STARTS[asked.part]]
    tried: list[tuple[float, Mapping[str, float]]] = []
    for start in starts:
        objective = _PredictionErrors(equations, asked, {**values, **{n: v for n, v in start.items() if n in values}})
        at = minimise(objective, objective.start(), objective.space, max_iterations=FIRST_ITERATIONS).point
        objective.learn(at, FIRST_ITERATIONS)
        tried.append((objective.log_likelihood(objective.cost(at)), objective.values(at.theta)))
    _, best = max(tried, key=lambda one: one[0])
    return {**values, **{n: best[n] for n in (*starts[0], "K") if n in best}}


def _optima(equations: Equations, asked: _Asked, starts: Sequence[Mapping[str, float]]) -> list[FreeFlight]:
    """What each start leads to. One that leads to less than the best before it is given up on the way (`Tolerances.compared_with`)."""
    best = _minimised(equations, asked, starts[0])
    found = [best]
    for start in starts[1:]:
        limits = Tolerances(compared_with=best.log_likelihood)
        one = _minimised(equations, asked, start, limits, best.inflation)
        if limits.share * (one.log_likelihood - best.log_likelihood) > limits.decrease:
            one = best = _minimised(equations, asked, one.values)
        found.append(one)
    return found


def _minimised(
    equations: Equations,
    asked: _Asked,
    values: Mapping[str, float],
    tolerances: Tolerances | None = None,
    inflation: float = 0.0,
) -> FreeFlight:
    """inflation: of `FreeFlight`; 0 where it is that of a first estimate, from which a second starts."""
    objective = _PredictionErrors(equations, asked, values, inflation=max(inflation, 1.0))
    found = objective.found(minimise(objective, objective.start(), objective.space, tolerances=tolerances))
    if inflation or not objective.assumes:
        return found
    objective = _PredictionErrors(equations, asked, found.values, found.initial, found.inflation)
    again = minimise(objective, objective.start(), objective.space, tolerances=tolerances, least_iterations=1)
    return objective.found(replace(again, iterations=found.iterations + again.iterations))


@dataclass(frozen=True)
class _Asked:
    model: Model
    part: str
    free: Sequence[str] | None
    per_flight: tuple[str, ...]
    priors: Mapping[str, tuple[float, float]]

    def prior(self, column: str) -> tuple[float, float]:
        name = column.split("@")[0]
        return self.priors.get(column) or self.priors.get(name) or prior_of(self.model.param[name])


@dataclass(frozen=True)
class _Point:
    """Parameters theta (q,) and the equations there, about initial values of what nothing measured; finite: whether every stretch has
    finite residuals and Jacobian at its full length."""

    theta: FloatArray
    streams: Sequence[Stream]
    finite: bool
    initial: InitialValues


class _Errors(NamedTuple):
    """covariance, between (q, q), spread (q,), inflation and blocks, as of `FreeFlight`."""

    covariance: FloatArray
    between: FloatArray
    spread: FloatArray
    inflation: float
    blocks: int


class _PredictionErrors:
    """The objective of an estimate (`estimation.gauss_newton`): squares of the innovations and of the priors' departures, these times the
    inflation that log likelihoods are divided by. The noise of each channel is estimated anew at every step; initial states that nothing
    measured follow their predictions."""

    def __init__(
        self,
        equations: Equations,
        asked: _Asked,
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

    def start(self) -> _Point:
        """At the start values, inside the bounds."""
        given = np.array([self.base[c] for c in self.columns])
        inside = self.space.inside(given)
        if np.array_equal(inside, given):
            return _Point(given, self.first, finite=True, initial=self.initial)
        return self.point(inside, self.initial)

    def point(self, theta: FloatArray, initial: InitialValues) -> _Point:
        """The equations at parameters (q,), with their Jacobian."""
        streams, _ = self._at(self.values(theta), initial)
        # A residual that is not finite is no stretch: it must not pay to lose one.
        lengths = ([s.residual.size for s in some] for some in (streams, self.first))
        return _Point(theta, streams, len({*map(tuple, lengths)}) == 1, initial)

    def values(self, theta: FloatArray) -> dict[str, float]:
        """Every value by name."""
        return self.base | dict(zip(self.columns, theta.tolist(), strict=True))

    def _at(self, values: Mapping[str, float], initial: InitialValues) -> tuple[list[Stream], tuple[str, ...]]:
        with np.errstate(all="ignore"):
            return self.equations.streams(values, self.names, self.asked.per_flight, initial)

    def learn(self, at: _Point, _iteration: int) -> bool:
        """The noise of the residuals."""
        before = self.noise
        known = self._learned[0] is at.streams and self._learned[1] is self.noise
        if not known or any(s.initial for s in at.streams):
            self.noise = noises(beside_random_effects(at.streams, self.noise), self.levels)
            self._learned = at.streams, self.noise
        self.log_determinant = self._misfit_of(at)[1]
        return all(abs(self.noise[c].std / before[c].std - 1.0) < SETTLED for c in self.noise)

    def _misfit_of(self, at: _Point) -> tuple[float, float]:
        """As `misfit_of`, once for a point and a noise: `learn` and `cost` ask one after the other."""
        if self._known[0] is not at.streams or self._known[1] is not self.noise:
            self._known, self._misfit = (at.streams, self.noise), misfit_of(at.streams, self.noise)
        return self._misfit

    def cost(self, at: _Point) -> float:
        """Whitened sum of squares with the priors'; infinite where the model is not finite."""
        if not at.finite:
            return np.inf
        with np.errstate(over="ignore"):  # a step too far may diverge: its cost is infinite
            total, _ = self._misfit_of(at)
        return total + float(np.sum(((at.theta - self.mean) / self.std) ** 2))

    def log_likelihood(self, cost: float) -> float:
        """Of a cost, with the noise as learned last."""
        return -log_scale(self.first, self.noise) - 0.5 * (cost + self.log_determinant)

    def normal_equations(self, at: _Point) -> tuple[FloatArray, FloatArray, PredictedStates]:
        """Of innovations and priors, beside the initial states."""
        rows = whiten(at.streams, self.noise, self.rows)
        hessian, score = rows.information()
        return hessian + np.diag(self.std**-2.0), score + (self.mean - at.theta) / self.std**2, rows.states

    def stepped(
        self, at: _Point, target: FloatArray, nuisance: PredictedStates, share: float, *, differentiated: bool
    ) -> _Point:
        """At other parameters, with initial states as predicted there; the equations come with their Jacobian in any case."""
        del differentiated
        step = share * nuisance.steps[..., 0] - nuisance.steps[..., 1:] @ (target - at.theta)
        initial = {n: x.copy() for n, x in at.initial.items()}
        for x, own in zip(initial.values(), step.T, strict=False):  # of none where no stretch is long enough
            x[nuisance.numbers] += own
        return self.point(target, initial)

    def refreshed(self, at: _Point) -> _Point:
        """The point itself, which has its Jacobian."""
        return at

    def nuisance_settled(self, _before: _Point, _after: _Point) -> bool:
        """They are predicted at every point."""
        return True

    def found(self, minimum: Minimum[_Point]) -> FreeFlight:
        """The answer at a minimum, with errors that hold what flights differ by."""
        at = minimum.point
        self.learn(at, minimum.iterations)
        known = self.errors(at)
        error = np.sqrt(np.diag(known.covariance))
        leaning = frozenset(
            c for c, e, s in zip(self.columns, error, self.asked_std, strict=True) if np.isfinite(s) and e > LEANS * s
        )
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

    def errors(self, at: _Point) -> _Errors:
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
        known = np.where(np.isfinite(made.covariance), made.covariance, 0.0)  # what is unknown stays so in the sandwich
        robust = made.robust + known @ wrong @ known
        drift = np.diag([self.asked.model.param[c.split("@")[0]].drift ** 2 for c in self.columns])
        blocks = int(rows.block.max(initial=-1)) + 1
        return _Errors(robust + extra + drift, extra, spread, inflation_of(made.covariance, robust), blocks)
