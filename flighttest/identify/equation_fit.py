"""A fit by output error whose translation is that of an equation error estimate: its values, standard errors and covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flighttest.estimation.linearisation import FloatArray
from flighttest.estimation.solver import solve
from flighttest.estimation.uncertainty.covariance import Covariance, interval_factor
from flighttest.identify.diagnostics.identifiability import Estimated, judge
from flighttest.identify.fit import Estimate, Fit
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.selection import problem_of


def with_equation_error(made: Fit, found: FreeFlight) -> Fit:
    """A fit whose translation was held at an estimate by equation error, with that estimate's standard errors and covariance."""
    names = [n for n in found.names if n in made.estimates and made.estimates[n].source == "frozen"]
    estimates = dict(made.estimates)
    dof = float(max(found.blocks - len(found.names), 1))
    std = found.std
    reveals = {p.name: t.reveals for t in made.model.built_terms for p in t.params}
    for n in names:
        e, p, half = estimates[n], made.model.param[n], interval_factor(dof) * std[n]
        known_std = std[n] if np.isfinite(std[n]) and n not in found.priors else None
        at_bound = not p.lower < e.value < p.upper
        known = judge(
            p, Estimated(e.value, known_std, n in found.priors, at_bound), made.voltage_spread_v, reveals.get(n, "")
        )
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


def _joined(loops: Covariance, names: Sequence[str], matrix: FloatArray, dof: float) -> Covariance:
    """Covariance of the attitude loops and of the translation, which share no parameter."""
    k, q = len(loops.names), len(names)

    def both(a: FloatArray, b: FloatArray) -> FloatArray:
        whole = np.zeros((k + q, k + q))
        whole[:k, :k], whole[k:, k:] = a, b
        return whole

    more = None if loops.discrepancy is None else both(loops.discrepancy, np.zeros((q, q)))
    return Covariance(
        (*loops.names, *names), both(loops.matrix, matrix), both(loops.model, matrix), np.append(loops.dof, np.full(q, dof)), more,
    )  # fmt: skip
