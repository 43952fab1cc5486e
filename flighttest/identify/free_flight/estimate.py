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
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import FitError
from flighttest.estimation.gauss_newton import Tolerances, minimise
from flighttest.identify.dead_time import thrust_gain
from flighttest.identify.free_flight.equations import Equations
from flighttest.identify.free_flight.estimated import FreeFlight, mixture
from flighttest.identify.free_flight.objective import EquationObjective, EvaluatedEquations, Unknowns
from flighttest.identify.free_flight.priors import DRAG
from flighttest.identify.free_flight.stretches import most_moved
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

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
    asked = Unknowns(model, part, free, tuple(per_flight), dict(priors or {}))
    given = start if isinstance(start, Sequence) else [start or {}]
    first, *others = [{**start_of(flown, model), **one} for one in given]
    searched = set(STARTS[part][0]) & set(model.names if free is None else free)
    starts = [first if searched & set(given[0]) else _with_lag(flown, asked, first), *others]
    if per_flight and not any("@" in n for n in given[0]):
        usual = {p.name: p.nominal for p in model.params if p.name in DRAG}
        starts += [starts[0] | usual, _with_lag(flown, asked, first | usual)]
    return mixture(_optima(Equations(model, flown, part), asked, starts))


def estimate_beside(
    smaller: FreeFlight,
    flown: Sequence[Segment],
    model: Model,
    starts: Sequence[Mapping[str, float]],
    *,
    free: Sequence[str] | None = None,
    per_flight: Sequence[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> FreeFlight:
    """As `estimate`, of a model with more terms than that of `smaller`, an estimate from the same flights. What does not predict better by
    more than its parameters cost (`FreeFlight.penalty`) is given up on the way."""
    asked = Unknowns(model, smaller.part, free, tuple(per_flight), dict(priors or {}))
    whole = [{**start_of(flown, model), **one} for one in starts]
    equations = Equations(model, flown, smaller.part)
    more = [n for n in equations.params if n not in smaller.estimated and (free is None or n in free)]
    least = smaller.log_likelihood + smaller.inflation * smaller.penalty(len(more))
    return mixture(_optima(equations, asked, whole, _Reached(least, smaller.inflation)))


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
    objective = EquationObjective(
        Equations(found.model, flown, found.part),
        Unknowns(found.model, found.part, free, tuple(per_flight), dict(priors or {})),
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
    known = objective.errors(EvaluatedEquations(theta, streams, finite=True, initial=found.initial))
    return known.covariance - known.between


def _with_lag(flown: Sequence[Segment], asked: Unknowns, values: Mapping[str, float]) -> dict[str, float]:
    """Start values with the best of several local optima of lag and delay, each followed for a while on a part of the flight."""
    equations = Equations(asked.model, most_moved(flown, INPUTS[asked.part], START_S, PIECES), asked.part)
    held = () if asked.free is None else set(values) - set(asked.free)
    starts = [{n: v for n, v in one.items() if n not in held} for one in STARTS[asked.part]]
    tried: list[tuple[float, Mapping[str, float]]] = []
    for start in starts:
        objective = EquationObjective(equations, asked, {**values, **{n: v for n, v in start.items() if n in values}})
        at = minimise(objective, objective.start(), objective.space, max_iterations=FIRST_ITERATIONS).point
        objective.learn(at, FIRST_ITERATIONS)
        tried.append((objective.log_likelihood(objective.cost(at)), objective.values(at.theta)))
    _, best = max(tried, key=lambda one: one[0])
    return {**values, **{n: best[n] for n in (*starts[0], "K") if n in best}}


class _Reached(NamedTuple):
    """What an optimum is compared with: a log likelihood, and the inflation that it was found with."""

    log_likelihood: float
    inflation: float


def _optima(
    equations: Equations, asked: Unknowns, starts: Sequence[Mapping[str, float]], reached: _Reached | None = None
) -> list[FreeFlight]:
    """What each start leads to, compared with the best before it."""
    found = []
    for start in starts:
        one = _minimised(equations, asked, start, reached)
        if reached is None or one.log_likelihood > reached.log_likelihood:
            reached = _Reached(one.log_likelihood, one.inflation)
        found.append(one)
    return found


def _minimised(
    equations: Equations, asked: Unknowns, values: Mapping[str, float], reached: _Reached | None
) -> FreeFlight:
    """An optimum, found twice where what is assumed depends on the inflation. Given up on the way where it leads to less than what was
    reached before (`Tolerances.compared_with`)."""
    objective = EquationObjective(equations, asked, values, inflation=reached.inflation if reached else 1.0)
    limits = Tolerances(compared_with=reached.log_likelihood if reached else None)
    first = minimise(objective, objective.start(), objective.space, tolerances=limits)
    found = objective.found(first)
    ahead = found.log_likelihood - (reached.log_likelihood if reached else -math.inf)
    if not (limits.share * ahead > limits.decrease and (reached or objective.assumes)):
        return found
    objective = EquationObjective(equations, asked, found.values, found.initial, found.inflation)
    second = minimise(objective, objective.start(), objective.space, least_iterations=1)
    return objective.found(replace(second, iterations=first.iterations + second.iterations))
