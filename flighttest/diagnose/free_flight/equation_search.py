"""Which terms of the catalogue a part of free flight needs, by its prediction errors: forward selection with backward elimination, one
wind per flight.

Each step screens every term (`equation_screen`), estimates the most significant ones anew beside all other parameters, further ones where
none of them is taken, and takes the one with the largest quasi-likelihood: log likelihood of the innovations divided by the variance
inflation that the robust covariance shows (QAIC: Burnham and Anderson 2002, section 2.5), less half the logarithm of the number of blocks
per parameter (Schwarz 1978). A term is named when its coefficients are significant by the robust covariance as well, at a level divided
by the number of terms (Bonferroni), its estimates are admissible, of what was not used the errors that surely change do not grow in their
geometric mean (the noise of each model is estimated with it, and a worse model of redder noise can be the likelier one), and its effect
is large enough (`effect_size`). A smaller one has no name; of an instrument it is estimated beside the others: left out, it is in the
noise, in which a load of 6.5 noise floors was not seen beside an accelerometer's lever arm of 0.049 m/s^2. Wind is looked for first,
against what looks like it at one heading (`identify.winds`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flighttest.diagnose.answer import SearchSupport
from flighttest.diagnose.free_flight.effect_size import EffectSize
from flighttest.diagnose.free_flight.equation_screen import Screened, has_unknown_initial_state, screen, settings
from flighttest.diagnose.free_flight.estimates import (
    EDGE_OF_INTERVAL,
    ModelEstimates,
    coefficients_of,
    null_inside_interval,
)
from flighttest.diagnose.free_flight.prediction import against_larger, held_out_table
from flighttest.diagnose.selection.aliases import CHANCE_NATS
from flighttest.diagnose.selection.candidates import OF_INSTRUMENTS, acts_in
from flighttest.diagnose.selection.comparison import PROBABILITY, level_of, log_odds_asked, probability_of
from flighttest.diagnose.selection.detectability import missing_channels
from flighttest.errors import FitError
from flighttest.estimation.uncertainty.distributions import chi2_beyond
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.free_flight.estimate import start_of
from flighttest.identify.free_flight.translation import LATENCY
from flighttest.identify.free_flight.winds import (
    BESIDE_WIND,
    WIND_TERM,
    FlightWind,
    WindVerdict,
    any_wind,
    headings_of,
    still_air,
    turned,
    winds_of,
)
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

PART_IN_WORDS = {"translation": "translation", "roll_pitch": "roll and pitch loops", "yaw": "yaw rate loop"}
TRIED = 4  # of the most significant terms are estimated anew in each step
MOST_NAMED = 5
OFFSET_TERM = "attitude_offset"
NOT_NEEDED = "not needed beside the terms that joined later"
NOT_BESIDE = "no wind is seen beside what looks like one at a single heading"


@dataclass(frozen=True)
class NamedByEquations:
    """A term that free flight needs. nats: of quasi-likelihood that it gains; size: channel to the root mean square of its effect beside
    the rest of the model, in the channel's unit; rivals: terms that explained it as well when it was named."""

    term: str
    nats: float
    p_value: float
    size: Mapping[str, float]
    rivals: tuple[str, ...] = ()


@dataclass
class EquationSearch:
    """What was found. base, final: estimates without and with what is named; offered: terms that were looked at; refused: those estimated
    anew and not named, with the reason; errors: standard errors of the coefficients of each term estimated beside the present model; small:
    of those refused, the ones that are in the model, of instruments, with too small an effect; left: those that joined and left, which do
    not return; screened: the last score tests; winds: of each flight, empty where none is in the model; turned: whether headings differ
    enough to part a wind from an attitude offset; complete: False where an interrupt ended the search."""

    flown: Sequence[Segment]
    base: FreeFlight
    final: FreeFlight
    named: dict[str, NamedByEquations] = field(default_factory=dict)
    refused: dict[str, tuple[float, str]] = field(default_factory=dict)
    errors: dict[str, dict[str, float]] = field(default_factory=dict)
    small: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    screened: tuple[Screened, ...] = ()
    offered: tuple[str, ...] = ()
    winds: tuple[FlightWind, ...] = ()
    declared: frozenset[str] = frozenset()
    turned: bool = True
    complete: bool = True

    def seen(self) -> tuple[FlightWind, ...]:
        """The wind of every flight in the final model. That a single flight has one was decided by comparing models; its interval, which
        also holds what looks like a wind, may hold none."""
        winds = tuple(winds_of(self.final, headings_of(self.flown), self.declared))
        return winds if len(winds) > 1 else tuple(replace(w, verdict=WindVerdict.WIND) for w in winds)

    def rivals_of(self, term: str) -> tuple[str, ...]:
        """Terms that explain what a named one does as well, but for those that were named beside it."""
        return tuple(r for r in self.named[term].rivals if r not in self.named)

    @property
    def beside_wind(self) -> tuple[str, ...]:
        """Terms that are in the model only because a wind is."""
        known = (*self.named, *self.small, *self.base.model.terms)
        return tuple(t for t in BESIDE_WIND if t in self.final.model.terms and t not in known)


def find_terms(
    flown: Sequence[Segment],
    model: Model,
    pool: Sequence[Term],
    *,
    part: str = "translation",
    weather: Mapping[str, str] | None = None,
    start: Mapping[str, float] | None = None,
    support: SearchSupport | None = None,
) -> EquationSearch:
    """Search the terms of `pool` on stretches of free flight (`identify.free_flight.stretches`).

    part: of the model (`estimation.estimator.BLOCKS`); weather: flight to 'still', a prior for its wind. FitError where no stretch can be
    estimated from.
    """
    declared, priors = still_air(weather)
    known = {t.id: t for t in pool if acts_in(t, model, part) and not missing_channels(t, tuple(flown))}
    if any(np.isfinite(s.y.get("f_x_m_s2", np.nan)).any() for s in flown):
        known.pop(LATENCY, None)  # an accelerometer shows forces without the velocity
    pooled = tuple(t for t in known.values() if t.id not in model.terms)
    asked = ModelEstimates(flown, part, priors, pooled, support or SearchSupport())
    asked.support.progress(f"estimating the base model of the {PART_IN_WORDS[part]}")
    base = asked.estimate(model, {k: v for k, v in (start or {}).items() if k in model.names})
    found = EquationSearch(flown, base, base, offered=tuple(known), declared=declared)
    found.turned = part != "translation" or turned(flown)
    try:
        _wind_first(found, asked, known)
        while len(found.named) < MOST_NAMED and _step(found, asked, known):
            _drop_what_left(found, asked, len(known))
        _ask_small_ones_again(found, asked, known)
    except KeyboardInterrupt:
        found.complete = False
    if WIND_TERM in found.final.model.terms:
        if list(found.named) != [WIND_TERM]:  # other optima of the wind, with the terms that joined since
            found.final = asked.estimate(found.final.model, _shared(found.final.values))
        found.winds = found.seen()
    return found


def significance(richer: FreeFlight, poorer: FreeFlight, term: Term, asked: ModelEstimates) -> float:
    """p-value of a term: of its linear coefficients (`ModelEstimates.presence`); where it has none, of the quasi-likelihood ratio times its
    settings."""
    if term.amplitudes:
        return asked.presence(richer, term)
    ratio = 2.0 * max(richer.log_likelihood - poorer.log_likelihood, 0.0) / richer.inflation
    return min(1.0, len(settings(term, asked.flown)) * chi2_beyond(ratio, len(term.params)))


def _score(found: FreeFlight, richest: FreeFlight) -> float:
    """Quasi-log-likelihood less the penalty of the parameters, with the variance inflation of the richest model compared."""
    return found.log_likelihood / richest.inflation - richest.penalty(len(found.names))


def _nats(richer: FreeFlight, poorer: FreeFlight) -> float:
    """What `richer` gains in it."""
    return _score(richer, richer) - _score(poorer, richer)


def _wind_first(found: EquationSearch, asked: ModelEstimates, known: Mapping[str, Term]) -> None:
    """Wind of every flight against what looks like it at one heading: models with a wind compared with models that have none.

    Beside each other neither is significant, since either takes the other's place; their models are told apart by what a wind does
    beyond a tilt, with more drag the faster the vehicle flies against it. The winds themselves are those of the model with all of them.
    """
    base = found.base
    if WIND_TERM not in known:
        return
    beside = [t for t in BESIDE_WIND if t in known]
    asked.estimate_side_by_side(
        [(base.model.with_terms(*some), [base.values]) for some in ((WIND_TERM, *beside), (WIND_TERM,))]
    )
    tried = asked.estimate(base.model.with_terms(WIND_TERM, *beside), base.values)
    alone = asked.estimate(base.model.with_terms(WIND_TERM), base.values)
    windy = max(tried, alone, key=lambda one: _score(one, tried))
    drag = [n for n in ("d_x", "d_y", "k_x", "k_y", "c_h") if n in windy.std and windy.values[n] > 2.0 * windy.std[n]]
    if not drag:
        return
    rest = [base.model.with_terms(*some) for some in _each_and_all(beside)]
    asked.estimate_side_by_side([(model, [base.values]) for model in rest])
    without = [base, *(asked.estimate(model, base.values) for model in rest)]
    calm = max(without, key=lambda one: _score(one, tried))
    nats = _score(windy, tried) - _score(calm, tried)
    if probability_of(nats, len(known)) < PROBABILITY:
        return
    if not any_wind(winds_of(tried, headings_of(asked.flown), found.declared)):
        found.refused[WIND_TERM] = nats, "no flight has a wind that its interval distinguishes from none"
        return
    gained = max(windy.log_likelihood - calm.log_likelihood, 0.0) / tried.inflation
    p_value = chi2_beyond(2.0 * gained, len(coefficients_of(tried, known[WIND_TERM])))
    streams = asked.streams(tried)
    found.final = tried
    found.named[WIND_TERM] = NamedByEquations(
        WIND_TERM, nats, p_value, EffectSize.of(asked.streams(calm), streams).sizes
    )
    for one in beside:
        p = asked.presence(tried, known[one])
        if p >= level_of(len(known)):
            continue
        smaller = asked.estimate(tried.model.without_terms(one), _shared(tried.values))
        nats, effect = _nats(tried, smaller), EffectSize.of(asked.streams(smaller), streams)
        if not effect.too_small() and not _against(_Trial(known[one], smaller, tried, nats, p), asked, len(known)):
            found.named[one] = NamedByEquations(one, nats, p, effect.sizes)


def _shared(values: Mapping[str, float]) -> dict[str, float]:
    """Without those of one flight."""
    return {n: v for n, v in values.items() if "@" not in n}


def _each_and_all(terms: Sequence[str]) -> list[tuple[str, ...]]:
    """Each term by itself, then all together where they are several."""
    return [*((t,) for t in terms), *([tuple(terms)] if len(terms) > 1 else [])]


def _step(found: EquationSearch, asked: ModelEstimates, known: Mapping[str, Term]) -> bool:
    """Screen, estimate the most significant terms anew, take the best; False where none is to be taken."""
    now = found.final
    pool = [t for t in known.values() if t.id not in (*now.model.terms, *found.left)]
    asked.support.progress(f"{PART_IN_WORDS[asked.part]}: screening the catalogue")
    found.screened = screen(asked.flown, now, pool, asked.support.side_by_side)
    # Noise holds what is missing until it is in the model, and a score test of few blocks says little then: what likelihood alone would
    # name is estimated, too. (An accelerometer 0.05 m off the centre, with 294 nats, had p 0.0008 in 75 s where 0.0004 is asked.) The
    # noise of an attitude lasts as long as what air does to it.
    level, inflation = level_of(len(known)), now.inflation if asked.part == "translation" else 1.0
    significant = [s for s in found.screened if s.p_value < level or s.nats > inflation * log_odds_asked(len(known))]
    picks = significant[:TRIED]
    while picks:
        if _taken(picks, found, asked, known):
            return True
        # None that is significant is left out for want of an estimate.
        picks = [s for s in significant if s.term not in found.refused][:TRIED]
    # A swing that lasts is in the noise of a model without it, where a score test does not see it.
    untried = (s for s in found.screened if s.term not in found.refused)
    return _taken([s for s in untried if has_unknown_initial_state(known[s.term])], found, asked, known)


def _taken(picks: Sequence[Screened], found: EquationSearch, asked: ModelEstimates, known: Mapping[str, Term]) -> bool:
    """Estimate terms anew and take the best; False where none is to be taken."""
    now = found.final
    estimated: list[tuple[Screened, FreeFlight]] = []
    # Each is estimated from the present estimate and at another of its settings (without a trim by integrators), there from usual loops:
    # without a moment of the air six flights of a Crazyflie had loops of 63 rad/s, damped 0.02, from where none was found.
    body = {n: v for n, v in start_of(asked.flown, now.model).items() if now.model.param[n].kind == "base"}
    usual = {} if asked.part == "translation" else body
    tries: list[tuple[Model, list[dict[str, float]]]] = []
    for s in picks:
        another = (one for one in settings(known[s.term], asked.flown) if one != s.shape)
        first, second = s.shape, {**usual, **next(another, s.shape)}
        starts = [first, second] if second != first else [first]
        tries.append((now.model.with_terms(s.term), [{**now.values, **start} for start in starts]))
    if picks:
        rest = f" and {len(picks) - 1} more" if len(picks) > 1 else ""
        asked.support.progress(f"{PART_IN_WORDS[asked.part]}: estimating with {picks[0].term}{rest}")
    asked.estimate_side_by_side(tries, now)
    for s, (model, from_values) in zip(picks, tries, strict=True):
        try:
            estimated.append((s, asked.estimate(model, *from_values, smaller=now)))
        except FitError as problem:
            found.refused[s.term] = (-np.inf, str(problem))
    # One inflation for all that are compared, that of the likeliest: by its own, a worse model of more noise would gain less.
    likeliest = max((one for _, one in estimated), key=lambda one: one.log_likelihood, default=now)
    tried = [(_score(one, likeliest) - _score(now, likeliest), s, one) for s, one in estimated]
    tried.sort(key=lambda x: -x[0])
    before = asked.streams(now) if tried else []
    for k, (nats, s, one) in enumerate(tried):
        term = known[s.term]
        found.errors[s.term] = {p.name: one.std[p.name] for p in term.amplitudes if p.name in one.std}
        effect, p_value = EffectSize.of(before, asked.streams(one)), significance(one, now, term, asked)
        # Alone it takes up whatever tilts the vehicle: a wind is named beside what looks like it (`_wind_first`), or not at all.
        trial = _Trial(term, now, one, nats, p_value)
        why = NOT_BESIDE if s.term == WIND_TERM else _against(trial, asked, len(known))
        if why:
            if s.term != WIND_TERM or WIND_TERM not in found.refused:  # what `_wind_first` found says more
                found.refused[s.term] = (nats, why)
            continue
        if why := effect.too_small():
            found.refused[s.term] = (nats, why)
            if term.family not in OF_INSTRUMENTS:
                continue
            found.final, found.errors = one, {}
            found.small.append(s.term)
            return True
        rivals = tuple(
            r.term for n, r, _ in tried if r is not s and nats - n < CHANCE_NATS and (n <= nats or r.term == WIND_TERM)
        )
        found.final, found.errors = one, {}
        found.named[s.term] = NamedByEquations(s.term, nats, p_value, effect.sizes, rivals)
        found.refused.pop(s.term, None)
        for n, r, _ in tried[k + 1 :]:
            found.refused.setdefault(r.term, (n, f"{s.term} predicts better by {nats - n:.1f} nats"))
        return True
    return False


@dataclass(frozen=True)
class _Trial:
    """A term that `larger` has and `smaller` has not. nats, p_value: as of `NamedByEquations`."""

    term: Term
    smaller: FreeFlight
    larger: FreeFlight
    nats: float
    p_value: float


def _against(trial: _Trial, asked: ModelEstimates, candidates: int) -> str:
    """Why a term does not join the model; empty where it does."""
    nats, p_value, level = trial.nats, trial.p_value, level_of(candidates)
    if not np.isfinite(nats) or nats <= 0.0:
        return f"it predicts no better than its parameters cost ({nats:.1f} nats)"
    if (probability := probability_of(nats, candidates)) < PROBABILITY:
        return f"evidence of {nats:.1f} nats: the probability that it is needed is {probability:.3g}"
    if p_value >= level:
        return f"its coefficients are not significant (p {p_value:.2g}, asked {level:.2g})"
    found = trial.larger
    if why := null_inside_interval(found, trial.term):
        return why
    if why := asked.outside_prior(found, trial.term, candidates):
        return why
    # A name predicts worse where it does so with means and without: what shows the slope of thrust at hover makes a constant error of a
    # thrust that is not proportional to the throttle, and what tilts the vehicle explains little but means.
    whole = against_larger(held_out_table(asked.flown, trial.smaller, found))
    return whole and against_larger(held_out_table(asked.flown, trial.smaller, found, means=False))


def _ask_small_ones_again(found: EquationSearch, asked: ModelEstimates, known: Mapping[str, Term]) -> None:
    """Of terms that joined without a name, beside those that joined later: name what is large enough by now, and leave out
    what is not needed."""
    for name in list(found.small):
        smaller = asked.estimate(found.final.model.without_terms(name), _shared(found.final.values))
        nats, effect = _nats(found.final, smaller), EffectSize.of(asked.streams(smaller), asked.streams(found.final))
        p_value = significance(found.final, smaller, known[name], asked)
        why = _against(_Trial(known[name], smaller, found.final, nats, p_value), asked, len(known))
        if not why and (small := effect.too_small()):
            found.refused[name] = nats, small
            continue
        found.small.remove(name)
        if why:
            found.final = smaller
            found.refused[name] = nats, f"beside the terms that joined later: {why}"
        else:
            del found.refused[name]
            found.named[name] = NamedByEquations(name, nats, p_value, effect.sizes)


def _drop_what_left(found: EquationSearch, asked: ModelEstimates, candidates: int) -> None:
    """Terms that are no longer significant or admissible beside the newest leave, then the newest itself if it is not without them."""
    stays = [found.final.model.terms[-1]]
    while leaving := _leaving([n for n in found.named if n not in stays], found, asked, candidates):
        (name, *beside), why = leaving
        smaller = found.final.model.without_terms(name, *beside)
        found.final = asked.estimate(smaller, _shared(found.final.values))
        del found.named[name]
        found.left.append(name)
        found.refused[name] = (0.0, why)
        stays = []


def _leaving(
    names: Sequence[str], found: EquationSearch, asked: ModelEstimates, candidates: int
) -> tuple[tuple[str, ...], str] | None:
    """The first of these terms that leaves, before what leaves with it, and why; None where all stay."""
    known = {t.id: t for t in found.final.model.built_terms}
    for name in names:
        if name == WIND_TERM:
            if not any_wind(found.seen()):
                return (name, *found.beside_wind), NOT_NEEDED
        elif name in BESIDE_WIND and WIND_TERM in found.named:
            continue
        elif why := _no_longer_admitted(found.final, known[name], asked, candidates):
            return (name,), why
    return None


def _no_longer_admitted(found: FreeFlight, term: Term, asked: ModelEstimates, candidates: int) -> str:
    """Why a term leaves: with linear coefficients it is significant no longer, or its value no longer known; or its estimates are outside
    their prior beside a newer term. Empty where it stays."""
    if term.amplitudes and (asked.presence(found, term) > EDGE_OF_INTERVAL or null_inside_interval(found, term)):
        return NOT_NEEDED
    outside = asked.outside_prior(found, term, candidates)
    return f"beside the terms that joined later: {outside}" if outside else ""
