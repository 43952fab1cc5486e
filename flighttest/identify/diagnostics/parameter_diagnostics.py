"""Reasons against calling a parameter known, gathered for every free parameter of a solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.problem import Problem
from flighttest.estimation.solver import Solution
from flighttest.estimation.uncertainty.covariance import Covariance, cluster_covariance, std_of
from flighttest.identify.diagnostics.heterogeneity import SETS, size_heterogeneity
from flighttest.identify.diagnostics.identifiability import ParameterDiagnostics, allowance
from flighttest.identify.diagnostics.local_optima import LocalOptimum
from flighttest.identify.diagnostics.quality import ChannelQuality
from flighttest.physics.model import Model

FloatArray = NDArray[np.float64]

MEETS = 0.1  # correlation of two parameters that are determined by the same samples
WORTH_A_NOTE = 0.3  # of how wide a parameter may be and still be called known


class StepSizes(TypedDict):
    """The values of a parameter that lie furthest apart, and the steps that they were found in."""

    low: float
    low_in: str
    high: float
    high_in: str


class DescentBlock(TypedDict):
    """What the paper's block coordinate descent gives beside the joint estimate."""

    values: dict[str, float]
    rounds: int
    differs: list[str]
    sentence: str


class FitChecks(TypedDict, total=False):
    """Cross-checks of a fit, as fit_quality of model.yaml has them. step_sizes: parameters that differ between sizes of steps."""

    step_sizes: dict[str, StepSizes]
    alternation: DescentBlock


class Identifiable(Protocol):
    """An estimate: its value, and whether it is known."""

    @property
    def value(self) -> float:
        """In the parameter's unit."""

    @property
    def identifiable(self) -> bool:
        """Whether the recordings make it known."""


def parameter_diagnostics(
    problem: Problem,
    solution: Solution,
    covariance: Covariance,
    quality: Mapping[str, ChannelQuality],
    optima: Mapping[str, LocalOptimum],
    closed_loop_bias: Mapping[str, float],
) -> dict[str, ParameterDiagnostics]:
    """By name of a free parameter."""
    differing = size_heterogeneity(problem, solution, covariance)
    wide = [n for n, s in differing.items() if s.width > allowance(problem.model.param[n], solution.values[n])]
    loops = _lags_with(wide)
    bounds = {**_leaning_on(solution.at_bound, solution), **_pushed_by_bounds(solution, covariance)}
    partners = _leaning_on([n for n in wide if n in loops], solution)
    normal = solution.normal
    determined = dict(zip(normal.names, responses_informing(normal.hessian).tolist(), strict=True))
    explained = _described(problem, solution, {c: q.r2 for c, q in quality.items()})
    # How fast a loop answers is seen in the course of each response: what the model misses of that, it puts into the lag.
    followed = _described(problem, solution, {c: 1.0 - q.missed for c, q in quality.items()})
    lags = _lags_with(solution.free)
    return {
        n: ParameterDiagnostics(
            differing.get(n),
            bounds.get(n),
            partners.get(n) if n in loops else None,
            determined.get(n, 0),
            explained.get(n, 1.0),
            1.0 - followed.get(n, 1.0) if n in lags else 0.0,
            optima.get(n),
            closed_loop_bias.get(n, 0.0),
        )
        for n in solution.free
    }


def step_sizes(diagnostics: Mapping[str, ParameterDiagnostics]) -> FitChecks:
    """For model.yaml's fit_quality: parameters that differ between sizes of steps, by name, whether or not they are known."""
    found: dict[str, StepSizes] = {
        n: {"low": s.low, "low_in": s.low_in, "high": s.high, "high_in": s.high_in}
        for n, d in diagnostics.items()
        if (s := d.spread) is not None
    }
    return {"step_sizes": found} if found else {}


def differing_notes(
    known: Mapping[str, Identifiable], diagnostics: Mapping[str, ParameterDiagnostics], model: Model
) -> list[str]:
    """Sentences on parameters that are known, and yet differ between sizes of steps by a good part of what they may."""
    notes = []
    for name, doubt in diagnostics.items():
        param = model.param[name]
        if doubt.spread is None or not known[name].identifiable:
            continue
        if doubt.spread.width > WORTH_A_NOTE * allowance(param, known[name].value):
            notes.append(f"{name}: {doubt.spread.sentence(param.unit)}; the estimate is a compromise of these")
    return notes


def responses_informing(information: FloatArray, share: float = 1e-3) -> NDArray[np.intp]:
    """How many responses hold at least this share of what is known of each parameter, (p,). information: (n_responses, p, p)."""
    each = np.einsum("sii->si", information)
    return np.asarray((each > share * np.maximum(each.sum(axis=0), 1e-300)).sum(axis=0), dtype=np.intp)


def _described(problem: Problem, solution: Solution, r2: Mapping[str, float], share: float = 0.2) -> dict[str, float]:
    """The lowest R2 of the channels that each parameter is read from: those with this share of what is known of it.

    A climb follows from its free start alone, whatever the thrust: beside it the force counts, where it was measured.
    """
    found: dict[str, float] = {}
    for part, made in zip(problem.parts, solution.evaluations, strict=True):
        std = np.array([solution.noise.channel[c] for c in part.outputs])
        determined = np.einsum("mnci,c->ic", made.jacobian**2, 1.0 / std**2)
        names = made.columns[: len(made.columns) - len(part.locals)]
        for name, by_channel in zip(names, determined[: len(names)], strict=True):
            read = {c for c, t in zip(part.outputs, by_channel, strict=True) if t > share * by_channel.sum() > 0}
            read |= {"f_z_m_s2"} if "v_z_m_s" in read and "f_z_m_s2" in part.outputs else set()
            values = [r2[c] for c in read if np.isfinite(r2.get(c, np.nan))]
            found[name] = min([found.get(name, 1.0), *values])
    return found


def _leaning_on(others: Sequence[str], solution: Solution, correlation: float = 0.5) -> dict[str, str]:
    """Free parameters that share the information of this data on them with one of `others`, by name: which one."""
    names = solution.normal.names
    total = solution.normal.hessian.sum(axis=0)
    root = np.sqrt(np.maximum(np.diag(total), 1e-300))
    shared = np.abs(total / np.outer(root, root))
    found: dict[str, str] = {}
    for other in others:
        column = shared[names.index(other)]
        for name, share in zip(names, column, strict=True):
            if name not in others and share > correlation:
                found.setdefault(name, other)
    return found


def _pushed_by_bounds(solution: Solution, covariance: Covariance) -> dict[str, str]:
    """Parameters that would move, or be known far worse, if those at their bounds were free, by name: the bound they lean on."""
    stuck = tuple(n for n in solution.at_bound if n not in solution.insensitive)
    if not stuck or not covariance.names:
        return {}
    every = (*covariance.names, *stuck)
    pick = np.array([solution.normal.names.index(n) for n in every], dtype=np.intp)
    hessian, score = (
        solution.normal.hessian[:, pick[:, None], pick].sum(axis=0),
        solution.normal.score[:, pick].sum(axis=0),
    )
    root = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    scaled = hessian / np.outer(root, root)
    move = np.linalg.lstsq(scaled, score / root, rcond=1e-9)[0] / root
    known, free = cluster_covariance(solution.normal, covariance.names), cluster_covariance(solution.normal, every)
    found: dict[str, str] = {}
    for k, name in enumerate(covariance.names):
        held, released = std_of(known, name), std_of(free, name)
        shared = np.abs(scaled[k, len(covariance.names) :])
        if shared.max() > MEETS and (abs(float(move[k])) > 2.0 * held or released > 2.0 * held):
            found[name] = stuck[int(np.argmax(shared))]
    return found


def _lags_with(names: Sequence[str]) -> frozenset[str]:
    """Every lag and delay of the loops that any of these belongs to."""
    return frozenset(
        n for loop in SETS if any(m.startswith("T_d") for m in loop) and set(loop) & set(names) for n in loop
    )
