"""Columns of every candidate term for the score test (Rao): sensitivities to its linear coefficients at their null values, at the optimum
of the present model, its nonlinear parameters on their declared grids. The tests of all subsets are in `subsets`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from flighttest.estimation.drift import DISTURBANCE_DRIFT
from flighttest.estimation.estimator import Estimator, finite, part_of
from flighttest.estimation.linearisation import FloatArray, Linearisation, Optimum
from flighttest.physics.compose import block_of
from flighttest.physics.core import Param, Term
from flighttest.physics.model import Model

_FORCES, _VELOCITIES = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"), ("v_x_m_s", "v_y_m_s", "v_z_m_s")
OF_INSTRUMENTS = ("sensor", "link")  # families of terms that are no forces
DIFFERENCE_STD = 0.4  # of the multiple of a finite difference, about 1: grid values are up to half an octave off


@dataclass(frozen=True)
class Candidate:
    """A term with its nonlinear parameters fixed at `shape`.

    names: its linear coefficients, columns (n, q) whitened and profiled; unprofiled: makes them (n, q) in the channels' units. A term
    without linear coefficients has one column and no name: the whole change it makes at `shape` (finite difference), whose multiple is
    about 1.
    """

    term: Term
    shape: Mapping[str, float]
    names: tuple[str, ...]
    columns: FloatArray
    unprofiled: Callable[[], FloatArray]

    @cached_property
    def params(self) -> tuple[Param, ...]:
        """The linear coefficients, in the order of `names`."""
        known = {p.name: p for p in self.term.params}
        return tuple(known[n] for n in self.names)

    @property
    def prior_mean(self) -> FloatArray:
        """(q,) of the coefficients, from their null values."""
        return np.zeros(len(self.names)) if self.names else np.ones(1)

    @property
    def prior_std(self) -> FloatArray:
        """(q,)."""
        if not self.names:
            return np.array([DIFFERENCE_STD])
        return np.array([p.prior_std for p in self.params])

    @property
    def side(self) -> FloatArray:
        """(q,) +1 or -1 where physics allows one side of the null value only, else 0."""
        if not self.names:
            return np.zeros(1)
        return np.array([np.sign(usual_size(p)) if p.one_sided else 0.0 for p in self.params])


def null_value(p: Param) -> float:
    """The value of a linear coefficient at which its term vanishes."""
    return float(p.off or 0.0)


def usual_size(p: Param) -> float:
    """Nominal value of a linear coefficient, from its null value."""
    return float(p.nominal) - null_value(p)


def acts_in(term: Term, model: Model, part: str) -> bool:
    """Whether a term acts in a part of a model (`estimation.estimator.BLOCKS`)."""
    if (block_of(term) == "translation") != (part == "translation"):
        return False
    tried = model if term.id in model.terms else model.with_terms(term)
    known = {name for block in tried.blocks if part_of(block.name) == part for name in block.params}
    return any(p.name in known for p in term.params)


def redundant(term: Term, strata: Collection[str]) -> frozenset[str]:
    """Strata that contain no information on a term. strata: what is recorded, and the disturbances.

    Velocities where their specific force is recorded: p(f, v) = p(f) p(v | f), and given specific force and attitude kinematics alone make
    the velocity, whatever the force; what a force explains of it beyond that is the velocity estimator's own error. All count for terms of
    instruments. Disturbances where a term's own states are free at the start of every response: these take up what a disturbance would,
    without any prediction (a load of 0.0085 of the mass was named on a log of ArduPilot's own simulator by smaller disturbances alone,
    with a channel predicted worse).
    """
    free = DISTURBANCE_DRIFT.keys() & {*strata} if any(s.free for s in term.states) else frozenset()
    if term.family in OF_INSTRUMENTS:
        return frozenset(free)
    sides = (_FORCES[:2], _VELOCITIES[:2]), (_FORCES[2:], _VELOCITIES[2:])
    return frozenset(v for forces, velocities in sides if {*forces} <= {*strata} for v in velocities) | free


def grid(term: Term) -> list[dict[str, float]]:
    """Declared values of each nonlinear parameter, the others at nominal."""
    nominal = {p.name: p.nominal for p in term.shapes}
    found: list[dict[str, float]] = []
    for p in term.shapes:
        for value in p.screen if len(p.screen) > 1 or len(term.shapes) == 1 else ():
            setting = {**nominal, p.name: value}
            if setting not in found:
                found.append(setting)
    return found or [nominal]


def candidates_at(
    estimator: Estimator, model: Model, at: Optimum, rows: Linearisation, terms: Sequence[Term]
) -> list[Candidate]:
    """Every setting of every term outside the model. rows: of the model itself. What is not finite is left out."""
    found = list(_by_derivatives(estimator, model, at, rows, [t for t in terms if t.amplitudes]))
    others = [(t, setting) for t in terms if not t.amplitudes for setting in grid(t)]
    changes = estimator.differences(model, at, ((model.with_terms(t), setting) for t, setting in others))
    for (t, setting), raw in zip(others, changes, strict=False):  # nothing is evaluated where there are none
        if finite(raw):
            found.append(Candidate(t, setting, (), rows.profiled(raw), partial(rows.unprofiled, raw)))
    return found


def _by_derivatives(
    estimator: Estimator, model: Model, at: Optimum, rows: Linearisation, terms: Sequence[Term]
) -> Iterator[Candidate]:
    """Of terms with linear coefficients: one Jacobian serves a setting of all, since at their null values they do not change each other."""
    if not terms:
        return
    everything = model.with_terms(*(t for t in terms if t.id not in model.terms))
    known = set(estimator.problem(everything).names)
    null = {p.name: null_value(p) for t in terms for p in t.amplitudes}
    own = {t.id: tuple(p.name for p in t.amplitudes if p.name in known) for t in terms}
    grids: dict[str, list[dict[str, float]]] = {t.id: grid(t) if t.shapes else [{}] for t in terms}
    for k in range(max(len(g) for g in grids.values())):
        asked = [t for t in terms if k < len(grids[t.id])]
        shape = {n: v for g in grids.values() for n, v in g[k % len(g)].items()}
        wanted = [n for t in asked for n in own[t.id]]
        raw = estimator.derivatives(everything, at, wanted, null | shape)
        for t in asked:
            part = [one[..., [wanted.index(n) for n in own[t.id]]] for one in raw]
            if own[t.id] and finite(part):
                yield Candidate(t, grids[t.id][k], own[t.id], rows.profiled(part), partial(rows.unprofiled, part))
