"""Which terms the recording needs: best subsets proposed by marginal likelihood, refitted, and compared by cross-validation.

1. At the optimum of the present model all subsets of up to three candidates are scored (`subsets`); the best is refitted jointly.
2. Every term of the refitted model is compared with the model without it (`comparison`); the one with the least evidence that is not
   needed leaves, until all that are left are.
3. The model is linearised anew at its optimum and the search repeated, until the best subset stays.

A term that may be no more than what instruments drift by (`Param.drift`) has no name, and stays in the model beside the others: left out,
it is in what they are judged by. (Without a bias of 0.13, 0.11 and 0.16 m/s^2 there was an attitude offset in its place, beside which the
real firmware's own lag of the rotors lost its name.)

A term that left is not proposed again from the model that stayed without it: its refit has been tried. One that left earlier, beside
another that left after it, is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from flighttest.diagnose.model import EXPLAINED_SHARE
from flighttest.diagnose.residuals.discrepancy import discrepancy_of
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, NoiseFloor, floor_of
from flighttest.diagnose.selection.absence import may_be_nothing
from flighttest.diagnose.selection.candidates import Candidate, candidates_at
from flighttest.diagnose.selection.comparison import (
    LEAST_FLOORS,
    Evidence,
    Fitted,
    evidence_of,
    inadmissible,
    least_needed_first,
    log_evidence,
)
from flighttest.diagnose.selection.fitted_models import FittedModels
from flighttest.diagnose.selection.held_out import share_left
from flighttest.diagnose.selection.proposals import PredictedSizes, proposals
from flighttest.diagnose.selection.subsets import LARGEST, Scored, Subsets
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import IntArray, Optimum
from flighttest.physics.core import Term
from flighttest.physics.model import Model

MOST_ROUNDS = 12  # linearisations: two effects take two or three


def silent(_text: str) -> None:
    """Progress that is not shown."""


@dataclass
class Search:
    """One block of the model. models: what was fitted of it; groups: which responses are held out together; rejected: terms that were
    refitted and left, with what was found of them; scored: subsets, best first; evidence: of the terms of the present model."""

    models: FittedModels
    groups: IntArray
    progress: Callable[[str], None] = silent
    now: Fitted | None = None
    floor: NoiseFloor | None = None
    candidates: list[Candidate] = field(default_factory=list)
    scored: list[Scored] = field(default_factory=list)
    subsets: Subsets | None = None
    sizes: PredictedSizes | None = None
    lack_of_fit: bool = False
    evidence: dict[str, Evidence] = field(default_factory=dict)
    rejected: dict[str, Evidence] = field(default_factory=dict)
    _found: dict[tuple[str, frozenset[str]], tuple[Fitted, Evidence]] = field(default_factory=dict)

    @property
    def estimator(self) -> Estimator:
        """Of this block."""
        return self.models.estimator

    @property
    def pool(self) -> tuple[Term, ...]:
        """Candidate terms."""
        return self.models.pool

    @property
    def terms(self) -> dict[str, Term]:
        """Candidate terms by id."""
        return self.models.terms

    @property
    def base(self) -> Fitted | None:
        """The model before anything was named; None until it is fitted."""
        return self.models.base

    @property
    def members(self) -> frozenset[str]:
        """Terms of the pool that are in the present model, with a name or without."""
        return self.models.members(self.now) if self.now is not None else frozenset()

    @property
    def named(self) -> frozenset[str]:
        """Those that have one."""
        return frozenset(self.evidence)

    def held(self, term: str) -> tuple[str, ...]:
        """Coefficients of a term that are held at their null values, since they were not its effect."""
        assert self.now is not None
        known = {*self.now.names, *self.models.insensitive}
        return tuple(p.name for p in self.terms[term].amplitudes if p.name not in known)

    def run(self, model: Model, start: Optimum) -> None:
        """Fit the base, then search. What is known when it is interrupted is kept."""
        self.now = self.models.fit_base(model, start)
        self.floor = floor_of(self.now.rows, self.estimator.segments, RESOLUTION)
        self.progress("base model fitted")
        for _ in range(MOST_ROUNDS):
            if not self._round():
                break
        self._judge_beside_nameless()
        self._judge_as_reported()

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
                fitted = self.models.with_candidates(before, [self.candidates[j] for j in scored.members], scored)
                if not fitted.finite:
                    continue
                kept, evidence, left = self._pruned(fitted, proposed)
            except np.linalg.LinAlgError as trouble:  # of a trial, which ends the trial and not the search
                self.progress(f"{names} cannot be computed: {trouble}")
                continue
            members, better = self.models.members(before), self._better(kept, before)
            outdone = self._outdone(kept, evidence, self.models.members(kept) - members) if better else {}
            if outdone or not better:
                # What was not needed beside a newcomer that left, too, was not asked of by itself.
                alone = {t: e for t, e in left.items() if e.inadmissible or self.models.members(e.without) <= members}
                self.rejected |= {t: e for t, e in alone.items() if t in proposed} | outdone
                continue
            self.now, self.evidence, self.candidates = kept, evidence, []  # columns are of the model before
            # What was not needed beside another model may be needed beside this one; what is inadmissible stays out.
            beside = {
                t: e
                for t, e in left.items()
                if e.inadmissible or self.models.members(e.without) == self.models.members(kept)
            }
            nameless = {t: e for t, e in left.items() if t in self.members}
            self.rejected = {t: e for t, e in self.rejected.items() if e.inadmissible} | beside | nameless
            return True
        return False

    def _judge_beside_nameless(self) -> None:
        """Withdraw what was named before a term without a name was found to explain more of it."""
        for name in sorted(self.evidence, key=lambda t: self.evidence[t].nats):
            assert self.now is not None
            if outdone := self._outdone(self.now, self.evidence, frozenset({name})):
                fitted = self.models.refined(self.evidence[name].without)
                self.now, self.evidence, left = self._pruned(fitted, self.models.members(fitted))
                self.rejected |= left | outdone
                self.linearise()
                return self._judge_beside_nameless()

    def _judge_as_reported(self) -> None:
        """Ask again of every named term whether it is needed, at the optimum that is reported: the search stops a fifth of a standard error
        short of it."""
        while self.evidence:
            assert self.now is not None
            self.progress(f"fitting {' and '.join(sorted(self.evidence))} to the end")
            fitted = self.models.fit(self.now.model, self.now.at, self.now.inactive, reported=True)
            self.now, self.evidence, left = self._pruned(fitted, frozenset(self.evidence))
            self.rejected |= left
            if left.keys() <= self.members:
                return
            self.linearise()

    def _may_be_drift(self, refused: Evidence) -> bool:
        """Whether a term is refused since it may be no more than what instruments drift by."""
        return bool(refused.nothing) and any(p.drift for p in self.terms[refused.term].params)

    def _outdone(self, kept: Fitted, evidence: Mapping[str, Evidence], among: frozenset[str]) -> dict[str, Evidence]:
        """Terms, of some of a model's, that are not needed beside one that explains more of the same and that has no name for its estimates
        or its size: what is there is then more like that one, and neither is its name. (Where an ESC sticks, half of the angle boost
        arrives; it was refused for that with 93 nats, and a translational lift of 12 nats named.)"""
        found: dict[str, Evidence] = {}
        members = self.models.members(kept)
        rest = members - among
        for refused in [e for e in self.rejected.values() if e.nameless and self.models.members(e.without) == rest]:
            less = {t for t in (among & set(evidence)) - set(found) if evidence[t].nats < refused.nats}
            if refused.term in members or not less:
                continue
            both = self.models.beside(kept, refused.term, rest)
            for name in (t for t in sorted(less) if self._evidence(t, both).why_not):
                why = f"beside {refused.term}, which explains more but cannot be it ({refused.nameless}), it is not needed"
                self.progress(f"{name}: {why}")
                found[name] = replace(evidence[name], withdrawn=why)
        return found

    def _better(self, kept: Fitted, before: Fitted) -> bool:
        """Whether a model holds more than one before, or predicts better with other terms."""
        new, old = self.models.members(kept), self.models.members(before)
        if new <= old:
            return False
        if new > old:
            return True
        assert self.floor is not None
        floor = floor_of(kept.rows, self.estimator.segments, RESOLUTION)
        return sum(log_evidence(kept, before, self.estimator, self.groups, floor).values()) > 0.0

    def _proposals(self) -> list[Scored]:
        """Subsets to refit, best first."""
        return [] if self.sizes is None else proposals(self.scored, self.sizes, self._whatever_its_score)

    def _whatever_its_score(self, candidate: Candidate) -> bool:
        """Whether a candidate is refitted although its score is low: a score is a derivative at the null value, and shows little where the
        effect is large and what is estimated moved far for it.

        While a lack of fit remains: a term without a linear coefficient. One with states of its own that are free at the start of a
        response changes nothing at its null value: as long as nothing is named, or more stays than of a mismatch that counts as explained
        (a load of 0.3 of the mass, swinging as each window began, had log odds of -4 and 29,000 nats). Every other nonlinear term as long
        as nothing is named (a load of 0.29 of the mass had no score, and 151,000 nats).
        """
        if not self.lack_of_fit:
            return False
        if not candidate.names:
            return True
        assert self.base is not None
        assert self.now is not None
        assert self.floor is not None
        if any(state.free for state in candidate.term.states):
            return not self.named or share_left(self.base.rows, self.now.rows, self.floor) > EXPLAINED_SHARE
        return bool(candidate.term.shapes) and not self.named

    def linearise(self) -> None:
        """Columns of every candidate outside the present model, and the subsets of them, best first."""
        assert self.now is not None
        self.progress("screening the catalogue")
        now, inside = self.now, self.members
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
        """A model without the terms that are not needed, and the evidence of those that are and of the others."""
        left: dict[str, Evidence] = {}
        while True:
            members = self.models.members(fitted)
            worst = self._not_needed(members & proposed, fitted)
            if worst is None or (worst.inadmissible and worst.floors >= LEAST_FLOORS):
                # An estimate outside its prior may be the fault of another term, or of the newcomer: these leave first.
                old = self._not_needed(members - proposed, fitted)
                worst = min((e for e in (worst, old) if e), key=lambda e: bool(e.inadmissible), default=None)
            if worst is None:
                every = {t: self._evidence(t, fitted) for t in sorted(members)}
                nameless = {t: e for t, e in every.items() if e.why_not}
                return fitted, {t: e for t, e in every.items() if t not in nameless}, left | nameless
            if worst.nothing or (worst.inadmissible and worst.floors >= LEAST_FLOORS):
                worst = self._leaves_instead(worst, members, fitted)
            left[worst.term] = worst
            self.progress(f"{worst.term} is not needed: {worst.why_not}")
            fitted = self.models.refined(worst.without)

    def _leaves_instead(self, refused: Evidence, members: frozenset[str], fitted: Fitted) -> Evidence:
        """The term that leaves where the estimates of one are inadmissible, or may be nothing: the least of those that explain less and
        without which they are admissible and something, else that one. (Beside a third pole of 185 nats the feedforward of a reference
        shaping of 92,000 ran to its bound; beside a rate limit of 330 nats the three of a shaping of 380 had
        intervals wider than their values.)"""
        rest = (self._evidence(t, fitted) for t in sorted(members - {refused.term}))
        for less in sorted((e for e in rest if e.nats < refused.nats), key=lambda e: e.nats):
            without = self.models.refined(less.without)
            if without.finite and not self._still_against(refused, without):
                reason = refused.inadmissible or refused.nothing
                why = f"{refused.term}, which explains more, cannot be beside it ({reason})"
                return replace(less, without=without, withdrawn=why)
        return refused

    def _still_against(self, refused: Evidence, without: Fitted) -> str:
        """Why a term that was refused is refused in a smaller model, too; empty where it is not."""
        if refused.inadmissible:
            return inadmissible(self.terms[refused.term], without, self.estimator.segments, len(self.pool))
        return self._evidence(refused.term, without).why_not

    def _not_needed(self, terms: frozenset[str], fitted: Fitted) -> Evidence | None:
        """The first of these terms that is not needed, None where all are. The least needed is asked first: each question is a refit."""
        known = [self.terms[t] for t in sorted(terms)]
        order = least_needed_first(known, fitted, self.estimator.segments, len(self.pool))
        evidence = (self._evidence(t.id, fitted) for t in order)
        return next((e for e in evidence if e.why_not and not self._may_be_drift(e)), None)

    def _evidence(self, term: str, fitted: Fitted) -> Evidence:
        """Of a term of a fitted model; kept."""
        assert self.floor is not None
        without, key = self.models.without(term, fitted), (term, self.models.members(fitted))
        of, known = self._found.get(key, (None, None))
        if known is not None and of is fitted and known.without is without:
            return known
        tried = self.terms[term]
        evidence = evidence_of(tried, fitted, without, self.estimator, self.groups, self.floor, len(self.pool))
        if not evidence.why_not:
            nothing = may_be_nothing(tried, fitted, without, self.estimator, len(self.pool))
            evidence = replace(evidence, nothing=nothing)
        self._found[key] = fitted, evidence
        return evidence
