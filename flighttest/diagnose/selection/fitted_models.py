"""Models of one block that were fitted, kept by their terms: each once for comparisons, again where a closer one or the answer needs it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from flighttest.diagnose.selection.admissible import EstimatedModel, not_allowed_beside_others
from flighttest.diagnose.selection.candidates import Candidate, null_value
from flighttest.diagnose.selection.comparison import Fitted, standard_errors
from flighttest.diagnose.selection.subsets import Scored
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import Optimum
from flighttest.physics.core import Term
from flighttest.physics.model import Model

ASTRAY = 3.0  # factor off its shape-based start: lags and gains of real fits stay within it, bent ones came out at five


@dataclass
class FittedModels:
    """pool: candidate terms; inactive: terms held at their null values until they are needed; origin: base parameters by the shape of the
    responses; base: the model without candidates, where it was fitted; insensitive: parameters that the data say nothing of."""

    estimator: Estimator
    pool: tuple[Term, ...]
    inactive: frozenset[str] = frozenset()
    origin: Mapping[str, float] = field(default_factory=dict)
    base: Fitted | None = None
    insensitive: frozenset[str] = frozenset()
    _fits: dict[frozenset[str], Fitted] = field(default_factory=dict)
    _rough: dict[frozenset[str], float] = field(default_factory=dict)  # log likelihood these were compared with
    _refitted: set[frozenset[str]] = field(default_factory=set)  # of these, from where scores pointed

    @property
    def terms(self) -> dict[str, Term]:
        """Candidate terms by id."""
        return {t.id: t for t in self.pool}

    def members(self, fitted: Fitted) -> frozenset[str]:
        """Terms of the pool that a fitted model holds."""
        return self._active(fitted.model, fitted.inactive)

    def _active(self, model: Model, inactive: frozenset[str]) -> frozenset[str]:
        return frozenset(t.id for t in self.pool if t.id in model.terms and t.id not in inactive)

    def fit_base(self, model: Model, start: Optimum) -> Fitted:
        """The model that every other one is compared with."""
        self.insensitive = self.estimator.insensitive(model, start)
        self.base = self.fit(model, start, self.inactive)
        return self.base

    def fit(
        self,
        model: Model,
        start: Optimum,
        inactive: frozenset[str],
        compared_with: Optimum | None = None,
        reported: bool = False,
    ) -> Fitted:
        """A model fitted from a start, with the terms at a bound that means absence held there (`inactive`). compared_with:
        optimum of a larger model that it is only compared with, in whose noise it is linearised; reported: as of `Estimator.fit`."""
        names = self._free(model, inactive)
        best = None if compared_with is None else compared_with.log_likelihood
        noise = None if compared_with is None else compared_with.noise
        fit = partial(self.estimator.fit, compared_with=best, reported=reported)
        at = fit(model, self._finite_start(model, start), names)
        if stuck := self._not_estimates(model, at, names):
            # What drove them there is not their effect: the rest of the term is judged without them.
            names = tuple(n for n in names if n not in stuck)
            start = self._finite_start(model, self.estimator.moved(model, at, stuck))
            at = fit(model, start, names)
        members = self._active(model, inactive)
        rough, known = -np.inf if best is None else best, self._fits.get(members)
        if known is not None and known.names == names and known.at.log_likelihood >= at.log_likelihood:
            at, rough = known.at, min(rough, self._rough[members])
        if known is None or known.at is not at or known.noise != noise:
            rows = self.estimator.linearise(model, at if noise is None else replace(at, noise=noise), names)
            known = Fitted(model, names, at, rows, inactive, noise)
        self._fits[members], self._rough[members] = known, rough
        return known

    def _finite_start(self, model: Model, start: Optimum) -> Optimum:
        """A start from which the simulation is finite: what a model holds without one of its terms may diverge where it was stable with it.
        Then the base's optimum, with every coefficient of a term at its null value, where the model is the base."""
        if np.isfinite(start.objective) or self.base is None:
            return start
        null = {p.name: null_value(p) for t in self.pool if t.id in model.terms for p in t.amplitudes}
        return self.estimator.moved(model, self.base.at, null).without_correlation

    def _not_estimates(self, model: Model, at: Optimum, names: tuple[str, ...]) -> dict[str, float]:
        """Coefficients that are not their term's effect where they are: what is this effect only beside its others (an upward wind) at a
        bound, and what physics does not allow (a drag that pushes) beside a coefficient that it does. Name to null value."""
        amplitudes = [p for p in model.params if p.name in names and p.kind == "amplitude"]
        found = [p for p in amplitudes if not p.alone and not p.lower < at.values[p.name] < p.upper]
        segments = self.estimator.segments
        estimates = EstimatedModel(
            names, at.values, lambda: standard_errors(self._linearised(model, at, names), segments), segments
        )
        for term in self.pool:
            found += not_allowed_beside_others([p for p in amplitudes if model.term_of(p.name) == term.id], estimates)
        return {p.name: null_value(p) for p in found}

    def _linearised(self, model: Model, at: Optimum, names: tuple[str, ...]) -> Fitted:
        return Fitted(model, names, at, self.estimator.linearise(model, at, names))

    def _free(self, model: Model, inactive: frozenset[str]) -> tuple[str, ...]:
        """What is estimated of a model."""
        known = self.estimator.problem(model).names
        return tuple(n for n in known if model.term_of(n) not in inactive and n not in self.insensitive)

    def with_candidates(self, among: Fitted, members: list[Candidate], scored: Scored) -> Fitted:
        """Joint fit with candidates, from where their scores point, or from their null values where that is nearer."""
        terms = [c.term for c in members]
        asked = self.members(among) | {t.id for t in terms}
        if asked in self._refitted:
            return self.refined(self._fits[asked])
        self._refitted.add(asked)
        model = among.model.with_terms(*(t for t in terms if t.id not in among.model.terms))
        shape = {n: v for c in members for n, v in c.shape.items()}
        pointed, null, at = dict(shape), dict(shape), 0
        for c in members:
            for p in c.params:
                pointed[p.name] = float(np.clip(null_value(p) + scored.coefficients[at], p.lower, p.upper))
                null[p.name] = null_value(p)
                at += 1
            at += 0 if c.params else 1
        starts = [self.estimator.moved(model, among.at, values) for values in (pointed, null)]
        first = min(starts, key=lambda s: s.objective)
        inactive = among.inactive - {t.id for t in terms}
        if shape and len(shape) < sum(len(t.params) for t in terms):
            # A nonlinear parameter means nothing until its coefficient has grown: the size comes first.
            sizes = [n for n in self._free(model, inactive) if n not in shape]
            first = self.estimator.fit(model, first, sizes, compared_with=among.at.log_likelihood)
        fitted = self.fit(model, first.without_correlation, inactive)
        if not astray(among.names, among.at.values, self.origin):
            return fitted
        # The base bent itself towards what is missing, and small steps from there do not lead back.
        back = {n: v for n, v in self.origin.items() if n in among.names}
        again = self.estimator.start(model, among.at.values | (pointed if first is starts[0] else null) | back)
        other = self.fit(model, again, inactive)
        return max(fitted, other, key=lambda f: f.at.log_likelihood)

    def beside(self, fitted: Fitted, term: str, rest: frozenset[str]) -> Fitted:
        """A model with a term in it, too, from where the refit of that term with `rest` ended."""
        added, alone = self.terms[term], self._fits[rest | {term}]
        model = fitted.model if term in fitted.model.terms else fitted.model.with_terms(added)
        values = {p.name: alone.at.values[p.name] for p in added.params}
        start = self.estimator.moved(model, fitted.at, values).without_correlation
        return self.fit(model, start, fitted.inactive - {term})

    def without(self, term: str, fitted: Fitted) -> Fitted:
        """A model refitted without one of its terms."""
        rest = self.members(fitted) - {term}
        if rest in self._fits:
            # Good enough for one that is better still; not for one that is nearer.
            near = self._rough[rest] > fitted.at.log_likelihood
            return self.refined(self._fits[rest], fitted.at) if near else self._fits[rest]
        model, inactive, null = fitted.model, fitted.inactive, {}
        if term in self.inactive:
            null = {p.name: null_value(p) for p in self.terms[term].amplitudes}
            inactive = inactive | {term}
        else:
            model = model.without_terms(term)
        start = self.estimator.moved(model, fitted.at, null)
        return self.fit(model, start, inactive, compared_with=fitted.at)

    def refined(self, fitted: Fitted, compared_with: Optimum | None = None) -> Fitted:
        """A model that was only compared with a better one, at its own optimum, or near enough for another comparison."""
        if self._rough.get(self.members(fitted), -np.inf) == -np.inf:
            return fitted
        return self.fit(fitted.model, fitted.at, fitted.inactive, compared_with)


def astray(names: Sequence[str], values: Mapping[str, float], origin: Mapping[str, float]) -> bool:
    """Whether a fitted gain or lag of the base is further than a factor of `ASTRAY` from where the shape of the responses puts it.

    Delays are not asked: they share their time with the lag after them, and a few milliseconds may be any factor.
    """
    return any(
        n in names and v > 0.0 and not v / ASTRAY < values[n] < v * ASTRAY
        for n, v in origin.items()
        if not n.startswith("T_d")
    )
