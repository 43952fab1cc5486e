"""Which terms the recording needs: best subsets proposed by marginal likelihood, refitted, and compared by cross-validation.

1. At the optimum of the present model all subsets of up to three candidates are scored (`subsets`); the best is refitted jointly.
2. Every term of the refitted model is compared with the model without it (`comparison`); the one with the least evidence that is not
   needed leaves, until all that are left are.
3. The model is linearised anew at its optimum and the search repeated, until the best subset stays.

A term that left is not proposed again from the model that stayed without it: its refit has been tried. One that left earlier, beside
another that left after it, is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from flighttest.diagnose.residuals.discrepancy import discrepancy_of
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, NoiseFloor, floor_of
from flighttest.diagnose.selection.absence import may_be_nothing
from flighttest.diagnose.selection.candidates import Candidate, candidates_at, null_value
from flighttest.diagnose.selection.comparison import (
    LEAST_FLOORS,
    Evidence,
    Fitted,
    evidence_of,
    inadmissible,
    least_needed_first,
    log_evidence,
    predicts_no_more,
)
from flighttest.diagnose.selection.proposals import PredictedSizes, proposals
from flighttest.diagnose.selection.subsets import LARGEST, Scored, Subsets
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import IntArray, Optimum
from flighttest.physics.core import Term
from flighttest.physics.model import Model

ASTRAY = 3.0  # factor off its shape-based start: lags and gains of real fits stay within it, bent ones came out at five
MOST_ROUNDS = 12  # linearisations: two effects take two or three


def silent(_text: str) -> None:
    """Progress that is not shown."""


@dataclass
class Search:
    """One block of the model. inactive: terms held at their null values until they are needed; origin: base parameters by the shape of the
    responses; rejected: terms that were refitted and left, with what was found of them; scored: subsets, best first; evidence: of the
    terms of the present model."""

    estimator: Estimator
    pool: tuple[Term, ...]
    groups: IntArray
    inactive: frozenset[str] = frozenset()
    origin: Mapping[str, float] = field(default_factory=dict)
    progress: Callable[[str], None] = silent
    base: Fitted | None = None
    now: Fitted | None = None
    floor: NoiseFloor | None = None
    insensitive: frozenset[str] = frozenset()
    candidates: list[Candidate] = field(default_factory=list)
    scored: list[Scored] = field(default_factory=list)
    subsets: Subsets | None = None
    sizes: PredictedSizes | None = None
    lack_of_fit: bool = False
    evidence: dict[str, Evidence] = field(default_factory=dict)
    rejected: dict[str, Evidence] = field(default_factory=dict)
    _fits: dict[frozenset[str], Fitted] = field(default_factory=dict)
    _rough: dict[frozenset[str], float] = field(default_factory=dict)  # log likelihood these were compared with
    _refitted: set[frozenset[str]] = field(default_factory=set)  # of these, from where scores pointed
    _found: dict[tuple[str, frozenset[str]], tuple[Fitted, Evidence]] = field(default_factory=dict)

    @property
    def terms(self) -> dict[str, Term]:
        """Candidate terms by id."""
        return {t.id: t for t in self.pool}

    @property
    def named(self) -> frozenset[str]:
        """Terms of the pool that are in the present model."""
        return self._members(self.now) if self.now is not None else frozenset()

    def held(self, term: str) -> tuple[str, ...]:
        """Coefficients of a named term that are not estimated, since they ran to a bound."""
        assert self.now is not None
        return tuple(p.name for p in self.terms[term].amplitudes if not p.alone and p.name not in self.now.names)

    def run(self, model: Model, start: Optimum) -> None:
        """Fit the base, then search. What is known when it is interrupted is kept."""
        self.insensitive = self.estimator.insensitive(model, start)
        self.base = self.now = self.fit_of(model, start, self.inactive)
        self.floor = floor_of(self.base.rows, self.estimator.segments, RESOLUTION)
        self.progress("base model fitted")
        for _ in range(MOST_ROUNDS):
            if not self._round():
                break
        self._judge_as_reported()
        self.judge_as_a_whole()

    def _round(self) -> bool:
        """One linearisation; whether anything was tried from it that may lead further."""
        before = self.now
        assert before is not None
        self.linearise()
        for scored in self._proposals():
            assert self.subsets is not None
            proposed = self.subsets.terms(scored)
            if proposed & set(self.rejected):
                continue
            names = " and ".join(sorted(proposed))
            self.progress(f"refitting with {names}")
            try:
                fitted = self.refitted(before, [self.candidates[j] for j in scored.members], scored)
                if not fitted.finite:
                    continue
                kept, evidence, left = self._pruned(fitted, proposed)
            except np.linalg.LinAlgError as trouble:  # of a trial, which ends the trial and not the search
                self.progress(f"{names} cannot be computed: {trouble}")
                continue
            replaced = self._replaced(before, kept, evidence) if self._better(kept, before) else {}
            if replaced or not self._better(kept, before):
                # What was not needed beside a newcomer that left, too, was not asked of by itself.
                members = self._members(before)
                alone = {t: e for t, e in left.items() if e.inadmissible or self._members(e.without) <= members}
                self.rejected |= {t: e for t, e in alone.items() if t in proposed} | replaced
                continue
            self.now, self.evidence, self.candidates = kept, evidence, []  # columns are of the model before
            # What was not needed beside another model may be needed beside this one; what is inadmissible stays out.
            beside = {
                t: e for t, e in left.items() if e.inadmissible or self._members(e.without) == self._members(kept)
            }
            self.rejected = {t: e for t, e in self.rejected.items() if e.inadmissible} | beside
            return True
        return False

    def _judge_as_reported(self) -> None:
        """Ask again of every named term whether it is needed, at the optimum that is reported: the search stops a fifth of a standard error
        short of it."""
        while self.evidence:
            assert self.now is not None
            self.progress(f"fitting {' and '.join(sorted(self.evidence))} to the end")
            fitted = self.fit_of(self.now.model, self.now.at, self.now.inactive, reported=True)
            self.now, self.evidence, left = self._pruned(fitted, frozenset(self.evidence))
            self.rejected |= left
            if not left:
                return
            self.linearise()

    def judge_as_a_whole(self) -> None:
        """Withdraw what was named where the model with all of it does not predict more than the base: terms that are each needed beside the
        others may explain disturbances and not the flight."""
        if not self.evidence or self.base is None or self.now is None or self.floor is None:
            return
        if not (why := predicts_no_more(self.base, self.now, self.groups, self.floor)):
            return
        self.rejected |= {t: replace(e, withdrawn=why) for t, e in self.evidence.items()}
        self.now, self.evidence = self.base, {}
        self.progress(f"{' and '.join(sorted(self.rejected))}: {why}")
        self.linearise()

    def _replaced(self, before: Fitted, kept: Fitted, evidence: Mapping[str, Evidence]) -> dict[str, Evidence]:
        """Newcomers that are not needed beside a term that explained more of the same and was refused for its estimates only: what is there
        is then more like that one, and neither is its name. (Where an ESC sticks, half of the angle boost arrives; it was refused for
        that with 93 nats, and a translational lift of 12 nats named.)"""
        found: dict[str, Evidence] = {}
        members, now = self._members(before), self._members(kept)
        for refused in (e for e in self.rejected.values() if e.inadmissible and self._members(e.without) == members):
            less = {t for t in now - members - set(found) if evidence[t].nats < refused.nats}
            if refused.term in now or not less:
                continue
            both = self._beside(kept, refused)
            for name in (t for t in sorted(less) if self._evidence(t, both).why_not):
                why = f"beside {refused.term}, which explains more but cannot be it ({refused.inadmissible}), it is not needed"
                self.progress(f"{name}: {why}")
                found[name] = replace(evidence[name], withdrawn=why)
        return found

    def _beside(self, kept: Fitted, refused: Evidence) -> Fitted:
        """A model with a refused term in it, too, from where the refit of that term ended."""
        term, alone = self.terms[refused.term], self._fits[self._members(refused.without) | {refused.term}]
        model = kept.model if term.id in kept.model.terms else kept.model.with_terms(term)
        values = {p.name: alone.at.values[p.name] for p in term.params}
        return self.fit_of(
            model, self.estimator.moved(model, kept.at, values).without_correlation, kept.inactive - {term.id}
        )

    def _better(self, kept: Fitted, before: Fitted) -> bool:
        """Whether a model holds more than one before, or predicts better with other terms."""
        new, old = self._members(kept), self._members(before)
        if new <= old:
            return False
        if new > old:
            return True
        assert self.floor is not None
        floor = floor_of(kept.rows, self.estimator.segments, RESOLUTION)
        return sum(log_evidence(kept, before, self.estimator, self.groups, floor).values()) > 0.0

    def _proposals(self) -> list[Scored]:
        """Subsets to refit, best first; nonlinear terms whatever their score as long as nothing is named and repeats measure the lack."""
        if self.sizes is None:
            return []
        measured = not self.named and bool(self.floor and self.floor.from_repeats)
        return proposals(self.scored, self.sizes, self.lack_of_fit, measured)

    def linearise(self) -> None:
        """Columns of every candidate outside the present model, and the subsets of them, best first."""
        assert self.now is not None
        self.progress("screening the catalogue")
        now, inside = self.now, self.named
        outside = [t for t in self.pool if t.id not in inside]
        self.candidates = candidates_at(self.estimator, now.model, now.at, now.rows, outside)
        if not self.candidates:
            self.scored, self.subsets, self.sizes = [], None, None
            return
        floor = floor_of(now.rows, self.estimator.segments, RESOLUTION)
        known = discrepancy_of(now.rows, now.residual(), self.estimator.segments, floor)
        self.lack_of_fit = bool(known.share.any())
        self.subsets = Subsets.at(now.rows, now.names, self.candidates, known, floor)
        self.scored = self.subsets.ranked(LARGEST)
        self.sizes = PredictedSizes(now.rows, now.names, self.candidates, self.estimator.segments, self.floor or floor)

    def _pruned(
        self, fitted: Fitted, proposed: frozenset[str]
    ) -> tuple[Fitted, dict[str, Evidence], dict[str, Evidence]]:
        """A model without the terms that are not needed, and the evidence of those that are and of those that left."""
        left: dict[str, Evidence] = {}
        while True:
            members = self._members(fitted)
            worst = self._not_needed(members & proposed, fitted)
            if worst is None or (worst.inadmissible and worst.floors >= LEAST_FLOORS):
                # An estimate outside its prior may be the fault of another term, or of the newcomer: these leave first.
                old = self._not_needed(members - proposed, fitted)
                worst = min((e for e in (worst, old) if e), key=lambda e: bool(e.inadmissible), default=None)
            if worst is None:
                return fitted, {t: self._evidence(t, fitted) for t in sorted(members)}, left
            if worst.inadmissible and worst.floors >= LEAST_FLOORS:
                worst = self._leaves_instead(worst, members, fitted)
            left[worst.term] = worst
            self.progress(f"{worst.term} is not needed: {worst.why_not}")
            fitted = self.refined(worst.without)

    def _leaves_instead(self, refused: Evidence, members: frozenset[str], fitted: Fitted) -> Evidence:
        """The term that leaves where the estimates of one are inadmissible: the least of those that explain less and without which they are
        admissible, else that one. (Beside a third pole of 185 nats the feedforward of a reference shaping of 92,000 ran to its bound.)"""
        rest = (self._evidence(t, fitted) for t in sorted(members - {refused.term}))
        term, asked = self.terms[refused.term], (self.estimator.segments, len(self.pool))
        for less in sorted((e for e in rest if e.nats < refused.nats), key=lambda e: e.nats):
            without = self.refined(less.without)
            if without.finite and not inadmissible(term, without, *asked):
                why = f"{term.id}, which explains more, cannot be beside it ({refused.inadmissible})"
                return replace(less, without=without, withdrawn=why)
        return refused

    def _not_needed(self, terms: frozenset[str], fitted: Fitted) -> Evidence | None:
        """The first of these terms that is not needed, None where all are. The least needed is asked first: each question is a refit."""
        known = [self.terms[t] for t in sorted(terms)]
        order = least_needed_first(known, fitted, self.estimator.segments, len(self.pool))
        return next((e for t in order if (e := self._evidence(t.id, fitted)).why_not), None)

    def _evidence(self, term: str, fitted: Fitted) -> Evidence:
        """Of a term of a fitted model; kept."""
        assert self.floor is not None
        without, key = self.without(term, fitted), (term, self._members(fitted))
        of, known = self._found.get(key, (None, None))
        if known is not None and of is fitted and known.without is without:
            return known
        tried = self.terms[term]
        evidence = evidence_of(tried, fitted, without, self.estimator, self.groups, self.floor, len(self.pool))
        if not evidence.why_not:
            evidence = replace(evidence, nothing=may_be_nothing(tried, fitted, without, self.estimator, self.groups))
        self._found[key] = fitted, evidence
        return evidence

    def _members(self, fitted: Fitted) -> frozenset[str]:
        return self._active(fitted.model, fitted.inactive)

    def _active(self, model: Model, inactive: frozenset[str]) -> frozenset[str]:
        return frozenset(t.id for t in self.pool if t.id in model.terms and t.id not in inactive)

    def fit_of(
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
        """Coefficients that are their term's effect only beside its others (an upward wind) and ran to a bound: name to null value."""
        return {
            p.name: null_value(p)
            for p in model.params
            if p.name in names and p.kind == "amplitude" and not p.alone
            if not p.lower < at.values[p.name] < p.upper
        }

    def _free(self, model: Model, inactive: frozenset[str]) -> tuple[str, ...]:
        """What is estimated of a model."""
        known = self.estimator.problem(model).names
        return tuple(n for n in known if model.term_of(n) not in inactive and n not in self.insensitive)

    def refitted(self, among: Fitted, members: list[Candidate], scored: Scored) -> Fitted:
        """Joint fit with candidates, from where their scores point, or from their null values where that is nearer; kept."""
        terms = [c.term for c in members]
        asked = self._members(among) | {t.id for t in terms}
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
        fitted = self.fit_of(model, first.without_correlation, inactive)
        if not astray(among.names, among.at.values, self.origin):
            return fitted
        # The base bent itself towards what is missing, and small steps from there do not lead back.
        back = {n: v for n, v in self.origin.items() if n in among.names}
        again = self.estimator.start(model, among.at.values | (pointed if first is starts[0] else null) | back)
        other = self.fit_of(model, again, inactive)
        return max(fitted, other, key=lambda f: f.at.log_likelihood)

    def without(self, term: str, fitted: Fitted) -> Fitted:
        """A model refitted without one of its terms; kept."""
        rest = self._members(fitted) - {term}
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
        return self.fit_of(model, start, inactive, compared_with=fitted.at)

    def refined(self, fitted: Fitted, compared_with: Optimum | None = None) -> Fitted:
        """A model that was only compared with a better one, at its own optimum, or near enough for another comparison."""
        if self._rough.get(self._members(fitted), -np.inf) == -np.inf:
            return fitted
        return self.fit_of(fitted.model, fitted.at, fitted.inactive, compared_with)


def astray(names: Sequence[str], values: Mapping[str, float], origin: Mapping[str, float]) -> bool:
    """Whether a fitted gain or lag of the base is further than a factor of `ASTRAY` from where the shape of the responses puts it.

    Delays are not asked: they share their time with the lag after them, and a few milliseconds may be any factor.
    """
    return any(
        n in names and v > 0.0 and not v / ASTRAY < values[n] < v * ASTRAY
        for n, v in origin.items()
        if not n.startswith("T_d")
    )
