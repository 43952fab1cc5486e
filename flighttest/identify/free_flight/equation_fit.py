"""The estimates of free flight as a `Fit`: their values, standard errors and covariance; output error evaluates them over the windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flighttest.errors import FitError
from flighttest.estimation.estimator import BLOCKS
from flighttest.estimation.linearisation import FloatArray
from flighttest.estimation.solver import solve
from flighttest.estimation.uncertainty.covariance import Covariance, interval_factor
from flighttest.identify.diagnostics.identifiability import Estimated, judge
from flighttest.identify.fit import Estimate, Fit, fit
from flighttest.identify.free_flight.estimate import FreeFlight, determined, estimate
from flighttest.identify.free_flight.stretches import stretches
from flighttest.identify.selection import problem_of
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

LEAST_S = 30.0  # of stretches: below, 30 blocks of a second do not carry a sandwich over a dozen parameters


def is_free_flight(segments: Sequence[Segment]) -> bool:
    """Whether every usable segment is a window of free flight, and stretches of `LEAST_S` or more can be estimated from.

    Steps by hand among them show more by output error: of nine effects added to logs with a tenth of steps the innovations named none, of
    eight output error had named seven.
    """
    usable = [s for s in segments if s.usable]
    if not usable or any(s.kind != "free" for s in usable):
        return False
    return sum(float(np.ptp(s.t_s)) for s in stretches(usable)) >= LEAST_S


def fit_free_flight(segments: Sequence[Segment], model: Model) -> Fit:
    """Translation and attitude loops of a free flight (`is_free_flight`). FitError where the translation cannot be estimated."""
    windows = tuple(s for s in segments if s.usable and s.t_s.size >= 8)
    flown = stretches(windows)
    names = determined(flown, model)
    found = [estimate(flown, replace(model, attitude_loops=False), free=names)]
    for part in (b for b in BLOCKS if b != "translation" and model.attitude_loops):
        try:
            found.append(estimate(flown, model, part=part, free=names))
        except FitError:  # no reference of it moves
            continue
    return fit_of_estimates(windows, model, found)


def fit_of_estimates(windows: Sequence[Segment], model: Model, found: Sequence[FreeFlight]) -> Fit:
    """A fit that holds what was estimated, with its standard errors and covariance."""
    known = {n: e.values[n] for e in found for n in e.names if n in model.param}
    held = {n: float(np.clip(v, model.param[n].lower, model.param[n].upper)) for n, v in known.items()}
    made = fit(windows, model, select="all", frozen=held, robust=False)
    for one in found:
        made = _with_errors(made, one)
    return made


def _with_errors(made: Fit, found: FreeFlight) -> Fit:
    """A fit that was held at an estimate, with that estimate's standard errors and covariance."""
    names = [n for n in found.names if n in made.estimates and made.estimates[n].source == "frozen"]
    estimates = dict(made.estimates)
    dof = float(max(found.blocks - len(found.names), 1))
    std = found.std
    reveals = {p.name: t.reveals for t in made.model.built_terms for p in t.params}
    for n in names:
        e, p, half = estimates[n], made.model.param[n], interval_factor(dof) * std[n]
        # The coefficients of a term are there by what they do together, however wide the error of one.
        assumed = n in found.priors and (p.kind != "amplitude" or p.off is None)
        known_std = std[n] if np.isfinite(std[n]) and not assumed else None
        at_bound = not p.lower < e.value < p.upper
        known = judge(p, Estimated(e.value, known_std, assumed, at_bound), made.voltage_spread_v, reveals.get(n, ""))
        interval = None if known_std is None else (max(e.value - half, p.lower), min(e.value + half, p.upper))
        estimates[n] = Estimate(
            n, e.symbol, e.unit, e.value, known_std, interval, "fit" if known_std is not None else "assumed", known.identifiable,
            known.why, known.fly, known_std,
        )  # fmt: skip
    kept = [n for n in names if estimates[n].std is not None]
    at = [found.names.index(n) for n in kept]
    # The information about held parameters is in the linearisation at this point, which later comparisons read.
    fixed = [n for n in made.model.names if n not in (*kept, *made.covariance.names)]
    problem = problem_of(made.problem.segments, made.model, select="all", values=made.values, fixed=fixed)
    begin = made.start
    solution = solve(problem, begin, robust=False, estimate_noise=False, max_iterations=0)
    made = replace(made, problem=problem, solution=replace(solution, status=made.status))
    return replace(
        made, estimates=estimates, covariance=_joined(made.covariance, kept, found.covariance[np.ix_(at, at)], dof)
    )


def _joined(first: Covariance, names: Sequence[str], matrix: FloatArray, dof: float) -> Covariance:
    """Covariance of parts of the model, which share no parameter."""
    k, q = len(first.names), len(names)

    def both(a: FloatArray, b: FloatArray) -> FloatArray:
        whole = np.zeros((k + q, k + q))
        whole[:k, :k], whole[k:, k:] = a, b
        return whole

    more = None if first.discrepancy is None else both(first.discrepancy, np.zeros((q, q)))
    return Covariance(
        (*first.names, *names), both(first.matrix, matrix), both(first.model, matrix), np.append(first.dof, np.full(q, dof)), more,
    )  # fmt: skip
