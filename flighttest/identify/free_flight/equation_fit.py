"""Recordings that a pilot or another controller flew: which parts of the model are estimated by prediction errors, and those estimates as a
`Fit`: their values, standard errors and covariance; output error estimates the other parts and evaluates all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from flighttest.errors import FitError
from flighttest.estimation.linearisation import FloatArray
from flighttest.estimation.solver import Start, solve
from flighttest.estimation.uncertainty.covariance import Covariance, interval_factor
from flighttest.identify.diagnostics.identifiability import Estimated, judge
from flighttest.identify.fit import Estimate, Fit, fit, has_attitude_references, mean_delay
from flighttest.identify.free_flight.estimate import estimate
from flighttest.identify.free_flight.estimated import HeldEstimate
from flighttest.identify.free_flight.priors import determined
from flighttest.identify.free_flight.stretches import stretches
from flighttest.identify.selection import problem_of
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

LOOPS = ("roll_pitch", "yaw")


def parts_by_prediction_errors(segments: Sequence[Segment]) -> tuple[str, ...]:
    """Parts of the model (`estimation.estimator.BLOCKS`) that usable segments show by prediction errors, the translation first; the others
    by output error: all of what a pilot or another controller steered, who answers what gusts do, and so moves the commands that output
    error takes for causes.

    However short: of ten flights of 10 s under a position loop in gusts of 0.5 m/s^2 the gain of 50 m/s^2 is off by 1.1 (root mean square),
    by output error by 4.9; of 7.5 s by 1.4 and 1.7, where intervals of output error hold 37 of 58 parameters, and those of prediction
    errors, which are of few blocks and wide, 60 of 60."""
    usable = [s for s in segments if s.usable]
    if not all(s.steered for s in usable):
        return ()
    loops = LOOPS if has_attitude_references(usable) else ()
    return tuple(p for p in ("translation", *loops) if stretches(usable, p))


def fit_by_prediction_errors(
    segments: Sequence[Segment], model: Model, parts: Sequence[str], frozen: Mapping[str, float] | None = None
) -> Fit:
    """A fit whose `parts` are estimated by prediction errors (`parts_by_prediction_errors`). frozen: names held at values. FitError where
    the translation is among the parts and cannot be estimated."""
    windows = tuple(s for s in segments if s.usable)
    held = dict(frozen or {})
    found = []
    for part in parts:
        flown = stretches(windows, part)
        names = [n for n in determined(flown, model) if n not in held]
        of = replace(model, attitude_loops=False) if part == "translation" else model
        try:
            found.append(estimate(flown, of, part=part, start=held, free=names).held)
        except FitError:  # no reference of the loops moves
            if part == "translation":
                raise
    return fit_of_estimates(windows, model, found, frozen=held)


def fit_of_estimates(
    windows: Sequence[Segment],
    model: Model,
    found: Sequence[HeldEstimate],
    *,
    start: Start | None = None,
    frozen: Mapping[str, float] | None = None,
) -> Fit:
    """A fit that holds what was estimated, with its standard errors and covariance; the rest by output error. start: where that begins;
    frozen: further names held at values."""
    known = {n: e.values[n] for e in found for n in e.names if n in model.param}
    held = {n: float(np.clip(v, model.param[n].lower, model.param[n].upper)) for n, v in known.items()}
    made = fit(windows, model, select="all", start=start, frozen={**held, **(frozen or {})}, robust=False)
    for one in found:
        made = _with_errors(made, one)
    if "T_d" in made.estimates and "T_d" not in model.param:
        made = replace(made, estimates={**made.estimates, "T_d": mean_delay(made.estimates, made.covariance)})
    return made


def _with_errors(made: Fit, found: HeldEstimate) -> Fit:
    """A fit that was held at an estimate, with that estimate's standard errors and covariance."""
    names = [n for n in found.names if n in made.estimates and made.estimates[n].source == "frozen"]
    estimates = dict(made.estimates)
    dof, std = found.dof, dict(zip(found.names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    reveals = {p.name: t.reveals for t in made.model.built_terms for p in t.params}
    for n in names:
        e, p, half = estimates[n], made.model.param[n], interval_factor(dof) * std[n]
        # The coefficients of a term are there by what they do together, however wide the error of one.
        assumed = n in found.assumed and (p.kind != "amplitude" or p.off is None or not np.isfinite(std[n]))
        known_std = std[n] if np.isfinite(std[n]) and not assumed else None
        at_bound = not p.lower < e.value < p.upper
        known = judge(
            p, Estimated(e.value, known_std, dof, assumed, at_bound), made.voltage_spread_v, reveals.get(n, "")
        )
        interval = None if known_std is None else (max(e.value - half, p.lower), min(e.value + half, p.upper))
        estimates[n] = Estimate(
            n, e.symbol, e.unit, e.value, known_std, interval, "assumed" if assumed else "fit", known.identifiable,
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
    more = None if first.discrepancy is None else block_diag(first.discrepancy, np.zeros_like(matrix))
    return Covariance(
        (*first.names, *names), block_diag(first.matrix, matrix), block_diag(first.model, matrix),
        np.append(first.dof, np.full(len(names), dof)), more,
    )  # fmt: skip
