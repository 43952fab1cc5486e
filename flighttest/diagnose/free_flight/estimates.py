"""Estimates of the models that a search of free flight compares: each made once, several side by side; and Wald tests of their terms."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flighttest.diagnose.answer import SearchSupport
from flighttest.diagnose.free_flight.equation_screen import settings
from flighttest.diagnose.selection.admissible import (
    EstimatedModel,
    not_allowed_beside_others,
    outside_prior,
    unit_suffix,
)
from flighttest.diagnose.selection.candidates import null_value
from flighttest.diagnose.selection.comparison import log_odds_asked
from flighttest.errors import FitError
from flighttest.estimation.equation_error import Stream, beside_random_effects, without_levels
from flighttest.estimation.linearisation import FloatArray
from flighttest.estimation.uncertainty.distributions import fisher_beyond
from flighttest.identify.free_flight import FreeFlight, estimate
from flighttest.identify.free_flight.equations import Equations
from flighttest.identify.free_flight.estimate import covariance_at, estimate_beside
from flighttest.identify.free_flight.priors import determined
from flighttest.identify.free_flight.winds import WIND, WIND_TERM
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

# p-value of a null value at the edge of the intervals that are printed, of 95 %. Inside them a term is not named, and no longer named when
# further terms join.
EDGE_OF_INTERVAL = 0.05


@dataclass(frozen=True)
class ModelEstimates:
    """Of the models that a search compares on some flights, each made once. priors: of `identify.free_flight.estimate`; pool: terms that
    are looked for."""

    flown: Sequence[Segment]
    part: str
    priors: Mapping[str, tuple[float, float]]
    pool: tuple[Term, ...]
    support: SearchSupport
    _known: dict[tuple[Model, Any], FreeFlight] = field(default_factory=dict)

    def estimate(self, model: Model, *starts: Mapping[str, float], smaller: FreeFlight | None = None) -> FreeFlight:
        """From one or several starts, once: what looks like a wind is compared with it and then asked for by itself. Coefficients that
        are not their term's effect (`not_allowed_beside_others`) are held at their null values, and the rest estimated again. smaller: as
        of `estimate_beside`."""
        key = self._key(model, starts)
        if key not in self._known:
            free = determined(self.flown, model)
            found = self._estimate(model, starts, free, smaller)
            if held := self._not_estimates(found):
                start = {**found.values, **held}
                found = self._estimate(model, [start], [n for n in free if n not in held], smaller)
            self._known[key] = found
        return self._known[key]

    def _estimate(
        self, model: Model, starts: Sequence[Mapping[str, float]], free: Sequence[str], smaller: FreeFlight | None
    ) -> FreeFlight:
        given = self._given(model, free)
        if smaller is None:
            return estimate(self.flown, model, part=self.part, start=starts, **given)
        return estimate_beside(smaller, self.flown, model, starts, **given)

    def estimate_side_by_side(
        self, tried: Sequence[tuple[Model, Sequence[Mapping[str, float]]]], smaller: FreeFlight | None = None
    ) -> None:
        """Estimate several models side by side, each from its starts, so that `estimate` has them. One that cannot be is left to it."""

        def work(some: Sequence[tuple[Model, Sequence[Mapping[str, float]]]]) -> list[FreeFlight | None]:
            found: list[FreeFlight | None] = []
            for model, starts in some:
                try:
                    found.append(self.estimate(model, *starts, smaller=smaller))
                except FitError:
                    found.append(None)
            return found

        new = {key: one for one in tried if (key := self._key(*one)) not in self._known}
        made = self.support.side_by_side(work, [*new.values()], [len(starts) for _, starts in new.values()])
        self._known.update((key, found) for key, found in zip(new, made, strict=True) if found is not None)

    @staticmethod
    def _key(model: Model, starts: Sequence[Mapping[str, float]]) -> tuple[Model, Any]:
        return model, tuple(tuple(start.items()) for start in starts)

    def _not_estimates(self, found: FreeFlight) -> dict[str, float]:
        """Name to null value."""
        estimates = self._estimated(found)
        terms = ([p for p in t.amplitudes if p.name in found.names] for t in self.pool if t.id in found.model.terms)
        return {p.name: null_value(p) for own in terms for p in not_allowed_beside_others(own, estimates)}

    def outside_prior(self, found: FreeFlight, term: Term, candidates: int) -> str:
        """Why the estimates of a term are outside its prior, as of `admissible.outside_prior`; candidates: terms of the search."""
        return outside_prior(term, self._estimated(found), math.sqrt(2.0 * log_odds_asked(candidates)))

    def _estimated(self, found: FreeFlight) -> EstimatedModel:
        return EstimatedModel(found.names, found.values, lambda: found.std, self.flown)

    def presence(self, found: FreeFlight, term: Term) -> float:
        """p-value of a term's linear coefficients against their null values, by the robust covariance of a test (`covariance_at`), times
        the number of settings that its nonlinear parameters were chosen from (Bonferroni: they mean nothing where the term is not, Davies
        1977).

        Whether a term is there in these flights is asked as of a single one, by what blocks of flight differ by. What flights differ in
        beyond that makes its value uncertain and not its presence: three tunnel flights with a moment of 1.8, 2.5 and 2.7 rad/(s m), each
        with p below 1e-11, had p 0.02 together, by two degrees of freedom.
        """
        null = {p.name: null_value(p) for p in term.amplitudes}
        covariance = covariance_at(self.flown, found, null, **self._given(found.model, found.estimated))
        return min(1.0, len(settings(term, self.flown)) * wald(found, term, covariance))

    def _given(self, model: Model, free: Sequence[str]) -> dict[str, Any]:
        own = WIND if WIND_TERM in model.terms else ()
        return {"free": free, "per_flight": own, "priors": self.priors}

    def streams(self, found: FreeFlight) -> list[Stream]:
        """Residuals and Jacobian of every stretch, of an estimate: with what instruments are off by."""
        with np.errstate(all="ignore"):
            equations = Equations(found.model, self.flown, self.part)
            streams, _ = equations.streams(found.values, found.estimated, found.per_flight, found.initial)
        return beside_random_effects(streams, without_levels(found.noise))


def coefficients_of(found: FreeFlight, term: Term) -> list[int]:
    """Positions of a term's linear coefficients, of its nonlinear parameters where it has none, in an estimate."""
    own = {p.name for p in (term.amplitudes or term.params)}
    return [i for i, n in enumerate(found.names) if n.split("@")[0] in own]


def wald(found: FreeFlight, term: Term, covariance: FloatArray) -> float:
    """p-value of a term's linear coefficients against their null values, with a covariance (q, q) in the order of the estimate's names; 1
    where it has none, or where that is infinite."""
    at = coefficients_of(found, term) if term.amplitudes else []
    own = covariance[np.ix_(at, at)]
    if not at or not np.isfinite(own).all():
        return 1.0
    null = {p.name: null_value(p) for p in term.amplitudes}
    off = np.array([found.values[found.names[i]] - null[found.names[i].split("@")[0]] for i in at])
    dof = float(max(found.blocks - len(found.names), 2))
    return fisher_beyond(float(off @ np.linalg.pinv(own) @ off) / len(at), len(at), dof)


def null_inside_interval(found: FreeFlight, term: Term) -> str:
    """That the null values of a term's linear coefficients are inside the printed intervals, all together, in words; empty where not.

    `covariance_at` says whether the term is present, this whether its value is known at all: third poles with a share of 1.0 +- 2.2 and
    +- 6.2 and a vortex ring of 0.30 +- 0.31 were surely present in three flights of a tunnel that have neither. What flights differ by
    makes a value uncertain and not its presence.
    """
    if not term.amplitudes or (p_value := wald(found, term, found.covariance - found.between)) <= EDGE_OF_INTERVAL:
        return ""
    half = found.factor()
    words = (
        f"{p.name} is {found.values[p.name]:.2g} +- {half * found.std[p.name]:.1g}{unit_suffix(p)}"
        for p in term.amplitudes
        if p.name in found.names
    )
    return f"{', '.join(words)}, which may be nothing (p {p_value:.2g}, asked {EDGE_OF_INTERVAL:g})"
