"""Tied parameters (equality constraints: roll like pitch, d_x like d_y): does the data support the tie?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.estimation.solver import Solution, solve
from flighttest.estimation.uncertainty.covariance import covariance_of
from flighttest.estimation.uncertainty.distributions import beyond
from flighttest.identify.selection import Select, problem_of
from flighttest.physics.model import Model
from flighttest.segments.model import Segment


@dataclass(frozen=True)
class TieTest:
    """Wald test of a tie: p_value under "the two are equal"."""

    name: str
    source: str
    difference: float
    std: float
    p_value: float
    sentence: str


def tie_tests(
    segments: Sequence[Segment],
    model: Model,
    select: Select,
    tied: Solution,
    ties: Mapping[str, str],
    frozen: tuple[str, ...],
    robust: bool,
) -> tuple[TieTest, ...]:
    """Fit once more without the ties and ask whether each pair differs."""
    if not ties:
        return ()
    problem = problem_of(segments, model, select=select, values=tied.values, fixed=frozen)
    free = solve(problem, robust=robust)
    covariance = covariance_of(problem, free)
    tests = []
    for name, source in ties.items():
        if name not in covariance.names or source not in covariance.names:
            continue
        weights = np.array([(n == name) * 1.0 - (n == source) * 1.0 for n in covariance.names])
        std, dof = covariance.of(weights)
        difference = free.values[name] - free.values[source]
        p = beyond(difference / std, dof) if std > 0 else 0.0
        verdict = "the data supports the tie" if p > 0.05 else "the data contradicts the tie"
        sentence = f"{name} - {source} = {difference:.3g} +- {std:.2g}: {verdict} (p = {p:.3f})"
        tests.append(TieTest(name, source, difference, std, p, sentence))
    return tuple(tests)
