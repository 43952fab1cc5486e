"""Which physics joins the model: forward and backward steps, every step a joint refit, judged on groups not used.

A step forward takes the candidate with the best information criterion among those whose score is beyond chance for the whole catalogue
(sign flips, 1 %; where much is wrong and no score is, what a refit changes is tested instead), refits it jointly with everything, and
keeps it when all of these hold:
- the information criterion with the effective sample size falls by 10 or more (odds of 150 to 1);
- somewhere (a channel in a kind of maneuver) the effect has at least half the power of the noise floor (0.7 of its amplitude);
- over all places where it shows so, it takes away at least 5 % of the held-out excess over the floor;
- its parameters stay inside what is physically possible (a negative mass of a payload is another effect's disguise), and where
  the criterion falls but little, or start states are free, its size stands out from its error: freedom is no evidence.
After each step, terms that no longer meet this are taken out again, and each is tried against every rival in its place. What is asked
of them once nothing more joins is in `remainders`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.bench import Bench
from flighttest.diagnose.chance import consistency, effective_size, parts_of, plain, standard_errors
from flighttest.diagnose.fitted import LEAST_BIC, LEAST_FLOORS, Fitted, Judged, judge, preferred
from flighttest.diagnose.judge import places, size_in_floors
from flighttest.diagnose.noise import Floor, floor_of
from flighttest.diagnose.plausible import is_amplitude, wrong_side
from flighttest.diagnose.rows import RESOLUTION, State
from flighttest.diagnose.screen import (
    FALSE_ALARM_RATE,
    Ground,
    Score,
    Variant,
    amplitude_variants,
    best_per_term,
    score,
    shape_variants,
    with_chance,
)
from flighttest.physics.core import Term
from flighttest.physics.model import Model

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

TRIES = 4  # candidates refitted per step before the step is given up
MOST_TERMS = 12
PASSES = 4  # screenings of the whole catalogue, each at the optimum that the last one led to
TRIAL_ITERATIONS = 5  # enough to rank candidates; what is accepted is fitted to the end
ASTRAY = 3.0  # a base parameter by this factor off its start is fitted from there, too
SAME = 0.7  # a rival is tried in a term's place when its linear score is at least this share of the term's


def silent(_text: str) -> None:
    """Progress that nobody watches."""


@dataclass
class Search:
    """One block of the model (roll and pitch, yaw rate, or translation) on one bench.

    look_ahead: asked where what was refused improves more than what is kept (`pairs.look_ahead`). pinned: amplitudes of accepted terms held
    at off since they did not earn their place beside the others of their term, and the standard error they had. origin: where the base
    parameters began.
    """

    bench: Bench
    pool: tuple[Term, ...]
    groups: IntArray
    dormant: frozenset[str] = frozenset()
    progress: Callable[[str], None] = silent
    look_ahead: Callable[[Search, list[tuple[Judged, Fitted]]], bool] | None = None
    base: Fitted | None = None
    now: Fitted | None = None
    floor: Floor | None = None
    judged: dict[str, Judged] = field(default_factory=dict)
    scores: list[Score] = field(default_factory=list)
    refused: dict[str, Judged] = field(default_factory=dict)
    ground: Ground | None = None
    blind: frozenset[str] = frozenset()
    pinned: dict[str, float] = field(default_factory=dict)
    origin: dict[str, float] = field(default_factory=dict)
    _variants: list[Variant] = field(default_factory=list)
    _left_out: dict[str, tuple[Fitted, Fitted]] = field(default_factory=dict)

    def run(self, model: Model, start: State, near: State | None = None) -> None:
        """Fit the base, then search. near: where the base fit begins, if not at `start`. What is done is kept on interruption."""
        self.blind = self.bench.blind(model, start)
        self.origin = {n: start.values[n] for n in self.bench.problem(model).names}
        self.base = self.now = self._fit(model, near or start, self.dormant, iterations=20)
        self.floor = floor_of(self.base.rows, self.bench.segments, RESOLUTION)
        self.progress("base model fitted")
        self.go_on()

    def go_on(self) -> None:
        """Search from the present model until nothing more joins it."""
        assert self.now is not None
        joined, passes = True, 0
        while joined and passes < PASSES and len(self.judged) < MOST_TERMS:
            passes += 1
            # Columns are taken once and go along while terms join; a new optimum is screened anew before nothing more is said to miss.
            self.linearise()
            joined = False
            while len(self.judged) < MOST_TERMS and self._forward():
                joined = True
                self._backward()
                self._score()
            if joined:
                self.now = self._fit(self.now.model, self.now.state, self.now.dormant)
                self._swap()
                self._pin()

    # Steps.

    def linearise(self) -> None:
        """Columns of every candidate at the present optimum, and their scores."""
        assert self.now is not None
        pool = [t for t in self.pool if t.id not in self.now.model.terms or t.id in self.now.dormant]
        self.progress("screening the catalogue")
        at = self.bench, self.now.model, self.now.state, pool, self.now.rows
        self._variants = amplitude_variants(*at) + shape_variants(*at)
        self._score()

    def variants(self, of: Fitted | None = None) -> list[Variant]:
        """Every candidate outside a model (the present one), placed on its rows."""
        fitted = of or self.now
        assert fitted is not None
        inside = set(fitted.model.terms) - fitted.dormant
        return [v.on(fitted.rows) for v in self._variants if v.term.id not in inside]

    def _score(self) -> None:
        """Scores of everything not in the model, at the present optimum."""
        assert self.now is not None
        self.ground = Ground.at(self.now.rows, self.now.names)
        self.scores = with_chance(self.ground, [s for v in self.variants() if (s := score(self.ground, v)) is not None])

    def _forward(self) -> bool:
        assert self.now is not None
        assert self.floor is not None
        ranked = [s for s in best_per_term(self.scores) if s.variant.term.id not in self.refused]
        # A secant says little about a change that the base must answer by moving far: where there are few candidates, all are refitted.
        ranked.sort(
            key=lambda s: (bool(s.variant.names), s.bic) if self.bench.block != "translation" else (False, s.bic)
        )
        tries = 0
        best: tuple[Judged, Fitted] | None = None
        kept: list[tuple[Judged, Fitted]] = []
        refused: list[tuple[Judged, Fitted]] = []
        wrong = not self.judged and self._worst() > 1 + LEAST_FLOORS**2
        # Two effects at once can hide each other from every score at a base that is bent between them: then refits are asked.
        unsure = wrong and not any(s.beyond_chance and s.bic <= -LEAST_BIC for s in ranked)
        for s in ranked:
            blunt = wrong and self.bench.block != "translation" and not s.variant.names
            if not blunt:
                if tries >= TRIES or (best is not None and s.bic > 0.5 * best[0].bic):
                    break
                if not (s.beyond_chance or unsure) or s.bic > -LEAST_BIC:
                    continue
                change = s.variant.open_columns @ s.estimate
                linear, _ = size_in_floors(self.now.rows, change, self.bench.segments, self.floor)
                if linear < 0.5 * LEAST_FLOORS:
                    continue
            tries += 1
            self.progress(f"refitting with {s.variant.term.id}")
            fitted = self.refitted_with(s)
            judged = self.judge(s.variant.term.id, self.now, fitted, s.p_value)
            if blunt or unsure:
                # The secant's score means little; what the refit changed is tested in its place, one of as many as there are candidates.
                parts = parts_of(self.now.rows, judged.own)
                added = len(fitted.names) - len(self.now.names)
                chance = consistency(parts, max(added, 1)) * len(ranked)
                judged = replace(judged, p_value=min(chance, 1.0))
                if chance > FALSE_ALARM_RATE and not plain(parts, judged.bic) and not judged.reason:
                    judged = replace(judged, reason="what it improves is no more consistent over responses than chance")
            if not judged.kept:
                self.refused[s.variant.term.id] = judged
                refused.append((judged, fitted))
                continue
            kept.append((judged, fitted))
            best = min(kept, key=lambda k: k[0].bic)
        better = [r for r in refused if best is None or r[0].bic < best[0].bic / SAME]
        if better and self.look_ahead is not None and self.look_ahead(self, better):
            return True
        if best is None:
            return False
        close = [k for k in kept if k[0].bic < SAME * best[0].bic]
        if len(close) > 1:
            best = self._best_at_the_end(close)
        self.take(best[1], best[0])
        return True

    def _best_at_the_end(self, close: list[tuple[Judged, Fitted]]) -> tuple[Judged, Fitted]:
        """Of candidates that a trial fit cannot tell apart, the one that is best when all are fitted to the end."""
        assert self.now is not None
        ended = []
        for judged, fitted in close:
            final = self._fit(fitted.model, fitted.state, fitted.dormant)
            again = self.judge(judged.term, self.now, final, judged.p_value)
            ended.append((again, final) if again.kept else (judged, fitted))
        best = ended[0]
        for other in ended[1:]:
            best = other if preferred(other[1], best[1]) else best
        return best

    def take(self, fitted: Fitted, *judged: Judged) -> None:
        """Go on with a model that terms have joined."""
        self.now = fitted
        self.judged |= {j.term: j for j in judged}
        self.refused.clear()
        self.floor = self._tighter(floor_of(fitted.rows, self.bench.segments, RESOLUTION))
        self.progress(f"{' and '.join(j.term for j in judged)} joined the model")

    def held_columns(self) -> tuple[list[Variant], list[Score], Ground | None]:
        """What the last screening found, to come back to."""
        return self._variants, self.scores, self.ground

    def hold_columns(self, found: tuple[list[Variant], list[Score], Ground | None]) -> None:
        """Come back to an earlier screening."""
        self._variants, self.scores, self.ground = found

    def _backward(self) -> None:
        """Take out what the newcomers made superfluous."""
        assert self.now is not None
        if len(self.judged) < 2:
            return
        for term in list(self.judged)[:-1]:
            without = self.without(term)
            judged = self.judge(term, without, self.now, self.judged[term].p_value)
            if judged.kept:
                self.judged[term] = judged
            else:
                self.now = without
                del self.judged[term]
                self.refused[term] = judged
                self.progress(f"{term} leaves the model")

    def _swap(self) -> None:
        """Every accepted term once more: it stays, leaves, or a rival that points the same way replaces it."""
        assert self.now is not None
        for term in list(self.judged):
            without = self.without(term)
            judged = self.judge(term, without, self.now, self.judged[term].p_value)
            if not judged.kept:
                self.now = without
                del self.judged[term]
                self.refused[term] = judged
                self.progress(f"{term} leaves the model")
                continue
            self.judged[term] = judged
            ground = Ground.at(without.rows, without.names)
            rivals = best_per_term(
                [s for v in self.variants(without) if v.term.id != term and (s := score(ground, v)) is not None]
            )
            rival = next(iter(rivals), None)
            if rival is None or rival.bic > SAME * judged.bic:
                continue
            self.progress(f"trying {rival.variant.term.id} in place of {term}")
            fitted = self.refitted_with(rival, without)
            other = self.judge(rival.variant.term.id, without, fitted, FALSE_ALARM_RATE)
            if other.kept and other.bic < judged.bic - LEAST_BIC:
                self.now = fitted
                del self.judged[term]
                self.judged[other.term] = other
                self.progress(f"{other.term} replaces {term}")

    def _pin(self) -> None:
        """Hold at off what a term of several amplitudes does not need (an upward wind beside a wind from the side): each has to earn
        its place by the information criterion, or what is collinear with the base would be printed as physics."""
        assert self.now is not None
        for term in self.judged:
            while len(own := [n for n in self.now.names if is_amplitude(term, n, self.now.model)]) > 1:
                std = dict(zip(self.now.names, standard_errors(self.now.rows, self.now.names), strict=True))
                off = {n: float(self.now.model.param[n].off or 0.0) for n in own}
                t = {n: abs(self.now.state.values[n] - off[n]) / max(float(std[n]), 1e-300) for n in own}
                wrong = [n for n in own if wrong_side(self.now.model.param[n], self.now.state.values[n])]
                least = min(wrong or own, key=lambda n: t[n])
                if not wrong and t[least] ** 2 > np.log(effective_size(self.now.rows)):
                    break
                self.pinned[least] = float(std[least])
                held = self.bench.moved(self.now.model, self.now.state, {least: off[least]})
                self.now = self._fit(self.now.model, held, self.now.dormant)
                self.progress(f"{least} is held at {off[least]:g}: {term} fits as well without it")

    def _worst(self) -> float:
        """Largest mean square of a place over its floor's."""
        assert self.now is not None
        assert self.floor is not None
        rows = self.now.rows
        return max(
            (
                float(np.mean(rows.open_residual[at] ** 2)) / self.floor.of(c) ** 2
                for (c, _), at in places(rows, self.bench.segments).items()
            ),
            default=0.0,
        )

    # Fits.

    def _fit(self, model: Model, state: State, dormant: frozenset[str], iterations: int = 8) -> Fitted:
        names = self._free(model, dormant)
        fitted = self.bench.fit(model, state, names, iterations=iterations)
        return Fitted(model, names, fitted, self.bench.rows(model, fitted, names), dormant)

    def _free(self, model: Model, dormant: frozenset[str]) -> tuple[str, ...]:
        """What is estimated of a model."""
        return tuple(
            n
            for n in self.bench.problem(model).names
            if model.term_of(n) not in dormant and n not in self.blind and n not in self.pinned
        )

    def refitted_with(self, s: Score, among: Fitted | None = None) -> Fitted:
        """Joint refit with a candidate, from where the screening points."""
        among = among or self.now
        assert among is not None
        term = s.variant.term
        for p in term.amplitudes:
            self.pinned.pop(p.name, None)
        self.pinned |= s.left_off
        model = among.model.with_terms(term)
        values = dict(s.variant.shapes)
        for name, value in zip(s.variant.names, s.estimate, strict=False):
            p = model.param[name]
            off = float(p.off or 0.0)
            values[name] = float(np.clip(off + value, p.lower, p.upper))
        warm = self.bench.moved(model, among.state, values)
        cold = self.bench.moved(
            model, among.state, {**dict(s.variant.shapes), **{p.name: float(p.off or 0.0) for p in term.amplitudes}}
        )
        first = warm if warm.objective < cold.objective else cold
        if term.amplitudes and term.shapes:
            # A shape means nothing until its amplitude has grown: let the size come first.
            names = self._free(model, among.dormant - {term.id})
            held = tuple(n for n in names if n not in s.variant.shapes)
            first = self.bench.fit(model, first, held, iterations=TRIAL_ITERATIONS)
        fitted = self._fit(model, first, among.dormant - {term.id}, TRIAL_ITERATIONS)
        if self._astray(among):
            # The base bent itself to stand in for what is missing, and small steps from there do not lead back.
            back = self.bench.moved(model, first, {n: v for n, v in self.origin.items() if n in among.names})
            again = self._fit(model, back, among.dormant - {term.id}, TRIAL_ITERATIONS)
            fitted = again if preferred(again, fitted) else fitted
        while self._hold_at_bound(term.id, fitted):
            at_off = {p.name: float(p.off or 0.0) for p in term.amplitudes if p.name in self.pinned}
            start = self.bench.moved(model, fitted.state, at_off)
            fitted = self._fit(model, start, among.dormant - {term.id}, TRIAL_ITERATIONS)
        return fitted

    def _astray(self, fitted: Fitted) -> bool:
        """Whether a base parameter has run far from where the responses' shapes put it."""
        return any(
            n in fitted.names and v > 0 and not v / ASTRAY < fitted.state.values[n] < v * ASTRAY
            for n, v in self.origin.items()
        )

    def _hold_at_bound(self, term: str, fitted: Fitted) -> bool:
        """Pin one of several amplitudes that ran to its bound: the data cannot tell it from the base (wind from below from thrust)."""
        own = [n for n in fitted.names if is_amplitude(term, n, fitted.model)]
        param = fitted.model.param
        out = [n for n in own if not param[n].lower < fitted.state.values[n] < param[n].upper]
        if len(own) < 2 or not out:
            return False
        # All that is known of it then is its range: the standard deviation of an even spread over it.
        self.pinned[out[0]] = float(param[out[0]].upper - param[out[0]].lower) / float(np.sqrt(12.0))
        return True

    def without(self, term: str) -> Fitted:
        """The present model refitted without one of its terms."""
        assert self.now is not None
        kept = self._left_out.get(term)
        if kept is None or kept[0] is not self.now:
            kept = self.now, self.refitted_without(term, self.now)
            self._left_out[term] = kept
        return kept[1]

    def refitted_without(self, term: str, fitted: Fitted) -> Fitted:
        """A model refitted without one of its terms."""
        if term in self.dormant:
            off = {p.name: float(p.off or 0.0) for t in self.pool if t.id == term for p in t.amplitudes}
            asleep = self.bench.moved(fitted.model, fitted.state, off)
            return self._fit(fitted.model, asleep, fitted.dormant | {term})
        model = fitted.model.without_terms(term)
        return self._fit(model, self.bench.moved(model, fitted.state), fitted.dormant)

    def _tighter(self, floor: Floor) -> Floor:
        """The lower of two floors: what a better model leaves is nearer to what nobody can explain."""
        assert self.floor is not None
        old = self.floor
        std = {c: min(floor.std[c], old.std.get(c, np.inf)) for c in floor.std}
        return replace(floor, std=std)

    def judge(self, term: str, before: Fitted, after: Fitted, p_value: float) -> Judged:
        """What `after` gains over `before` by one term."""
        assert self.floor is not None
        return judge(term, before, after, p_value, self.floor, self.groups, self.bench.segments)
