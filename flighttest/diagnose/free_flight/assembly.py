"""Diagnosis of free flight: translation by equation error (`equation_search`), attitude loops by output error on part of the windows.

Flights are compared in the frame of their own air: in a steady horizontal wind w the motion is that of velocity v - w in still air, so
that one model without wind is fitted, drawn and written for flights in several winds. The final model's translation keeps the values
and errors of the equation error estimate; output error evaluates it over the windows and fits the attitude loops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from flighttest.diagnose.block import SEED, Asked, BlockAnswer, answer, listed, merged
from flighttest.diagnose.conclusion import (
    UNMOVED,
    compensated_voltage,
    moved_parameters,
    predicted_worse,
    sentence_of,
    verdict_of,
)
from flighttest.diagnose.findings import finding, parameter_in_words, parameter_table
from flighttest.diagnose.free_flight.equation_search import EquationSearch, NamedByEquations, find_terms
from flighttest.diagnose.free_flight.prediction import groups_left_out, held_out_table, sampling_rate, share_gained
from flighttest.diagnose.free_flight.tables import (
    free_flight_floor,
    pairs_of_flights,
    table_of,
    what_separates,
)
from flighttest.diagnose.mass import mass_test
from flighttest.diagnose.model import Diagnosis, Finding, Located, Rival, TermVerdict, Untestable, short
from flighttest.diagnose.records import CandidateRow, FloorRow, HeldOutRow, ParameterRow
from flighttest.diagnose.residuals.locate import locate, regime_curves, residual_map
from flighttest.diagnose.residuals.overlays import overlays
from flighttest.diagnose.selection.candidates import usual_size
from flighttest.diagnose.selection.comparison import probability_of
from flighttest.diagnose.selection.detectability import POWER, UNSEEN, missing_channels, why_unseen
from flighttest.diagnose.selection.held_out import excess, held_out_groups
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import Linearisation
from flighttest.estimation.uncertainty.distributions import normal_quantile
from flighttest.identify.equation_fit import with_equation_error
from flighttest.identify.fit import Fit, fit, has_attitude_references
from flighttest.identify.free_flight import FreeFlight, stretches
from flighttest.identify.selection import able
from flighttest.identify.winds import CHANCE, WIND_TERM, in_still_air, wind_rows
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

SHORTEST_S = 30.0  # of stretches: below, 30 blocks of a second do not carry a sandwich over a dozen parameters
ATTITUDE_WINDOWS = 40  # that the attitude loops are searched on: 100 s of windows
FROM_EQUATIONS = "what is left beside every variable recorded: gusts and noise of the free flight itself"
NO_COLUMN = "the accelerometer shows forces without the velocity, whose latency is then in the drag alone"


def is_free_flight(segments: Sequence[Segment]) -> bool:
    """Whether every usable segment is a window of free flight, and stretches of `SHORTEST_S` or more can be estimated from."""
    usable = [s for s in segments if s.usable]
    if not usable or any(s.kind != "free" for s in usable):
        return False
    return sum(float(np.ptp(s.t_s)) for s in stretches(usable)) >= SHORTEST_S


def diagnose_free_flight(
    segments: Sequence[Segment],
    model: Model,
    *,
    previous: Mapping[str, tuple[float, float | None]] | None = None,
    weather: Mapping[str, str] | None = None,
    only: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """The diagnosis of recordings that are free flight alone (`is_free_flight`).

    model: the base; previous: its parameters, name to (value, std), where it was fitted before; weather: flight to 'still'; only: ids
    of the candidates. FitError where there is nothing to estimate from.
    """
    usable = tuple(s for s in segments if s.usable and s.t_s.size >= 8)
    flown = stretches(usable)
    loops = has_attitude_references(usable)
    model = replace(model, attitude_loops=loops)
    pool = tuple(
        t
        for t in catalogue().values()
        if t.id not in model.terms and (only is None or t.id in only) and block_of(t) != "delay"
    )
    translation = tuple(t for t in pool if block_of(t) == "translation")
    start = {k: v[0] for k, v in (previous or {}).items()}
    alone = replace(model, attitude_loops=False)
    found = find_terms(flown, alone, translation, weather=weather, start=start, progress=progress)
    air = in_still_air(usable, found.winds)
    answers, asked = _attitude(air, model, pool, found, previous or {}, progress) if found.complete else ([], None)
    return _Assembly(usable, model, pool, found, answers, asked, progress).made(previous or {})


def values_of(found: FreeFlight, model: Model) -> dict[str, float]:
    """Estimated values by name under a model without the winds of single flights; what was held as well."""
    return {n: v for n, v in found.values.items() if n in model.names and "@" not in n and not n.startswith("w_")}


def _spread_out(segments: Sequence[Segment], most: int) -> tuple[Segment, ...]:
    """At most so many segments, evenly over all flights and times."""
    if len(segments) <= most:
        return tuple(segments)
    return tuple(segments[i] for i in np.linspace(0, len(segments) - 1, most).round().astype(int))


def _attitude(
    segments: tuple[Segment, ...],
    model: Model,
    pool: tuple[Term, ...],
    found: EquationSearch,
    previous: Mapping[str, tuple[float, float | None]],
    progress: Callable[[str], None],
) -> tuple[list[BlockAnswer], Asked | None]:
    """The search of the attitude loops, as in any diagnosis, on `ATTITUDE_WINDOWS` windows."""
    if not model.attitude_loops:
        return [], None
    some = _spread_out(segments, ATTITUDE_WINDOWS)
    progress("fitting the attitude loops")
    base = fit(some, model, select="all", frozen=_held(found.base, model), robust=False)
    groups, _ = held_out_groups(some)
    asked = Asked(some, model, pool, base, groups, previous, progress)
    answers = []
    for block in ("roll_pitch", "yaw"):
        try:
            answers.append(answer(block, asked))
        except KeyboardInterrupt:
            answers.append(BlockAnswer(complete=False))
            break
    return answers, asked


def _held(found: FreeFlight, model: Model) -> dict[str, float]:
    inside = {
        n: float(np.clip(v, model.param[n].lower, model.param[n].upper)) for n, v in values_of(found, model).items()
    }
    return {n: v for n, v in inside.items() if n not in ("T_d", "T_d_attitude", "T_d_yaw_rate")}


class _Assembly:
    """One diagnosis of what the equations and the attitude loops show."""

    def __init__(
        self,
        segments: tuple[Segment, ...],
        model: Model,
        pool: tuple[Term, ...],
        found: EquationSearch,
        answers: list[BlockAnswer],
        asked: Asked | None,
        progress: Callable[[str], None],
    ) -> None:
        self.segments, self.model, self.pool, self.found, self.progress = segments, model, pool, found, progress
        self.answers, self.asked = answers, asked
        self.searches = [a.search for a in answers if a.search is not None]
        self.complete = found.complete and all(a.complete for a in answers)
        own = [t for t in found.final.model.terms if t not in model.terms and t != WIND_TERM]
        self.loops = [t for s in self.searches for t in s.evidence]
        self.final = model.with_terms(*own, *self.loops)
        self.air = in_still_air(segments, found.winds)

    def made(self, previous: Mapping[str, tuple[float, float | None]]) -> Diagnosis:
        """Everything that terminal, JSON and report show."""
        found = self.found
        self.progress(f"fitting {' + '.join(self.final.terms)}")
        fitted = self._fit()
        # Without the rows that only residuals' maps need, a diagnosis of an hour would not be one of seconds.
        before_rows, after_rows = (
            self._rows(self.segments, found.base, self.model),
            self._rows(self.air, found.final, self.final),
        )
        floor = free_flight_floor(after_rows, self.air)
        places = locate(before_rows, self.segments, floor, SEED)
        left = [p for p in locate(after_rows, self.air, floor, SEED) if p.regime]
        share = self._share_left(excess(before_rows, floor), excess(after_rows, floor), places, left)
        located = [*places, *listed(self.answers, "located")]
        staying = [*left, *listed(self.answers, "staying")]
        held = held_out_table(found.flown, found.base, found.final) if found.named else {}
        whole = {**held, **merged(a.heldout for a in self.answers)}
        before, after = table_of(found.base, self.model), parameter_table(fitted)
        findings = self._findings(held, after)
        unseen, levels = self._unseen()
        verdict = verdict_of(bool(findings), share, bool(located), bool(staying))
        accepted = (*found.named, *self.loops)
        tried = {*found.offered, *(t.id for a in self.answers if a.complete and a.search for t in a.search.pool)}
        hidden = {u.term: u.why for u in unseen}
        units = {p.name: p.unit for t in self.pool for p in t.params}
        return Diagnosis(
            verdict=verdict,
            sentence=sentence_of(verdict, findings, share, located, self.complete)
            + predicted_worse(whole)
            + moved_parameters(previous, after),
            located=tuple(located),
            findings=tuple(findings),
            not_needed=tuple(sorted(tried - set(accepted) - set(hidden) - set(found.beside_wind))),
            untestable=tuple(unseen),
            unexplained={"excess_share": float(min(share, 1.0)) if located else 0.0},
            smallest_detectable={k: v for k, (v, _) in levels.items() if np.isfinite(v) and hidden.get(k) != UNSEEN},
            smallest_units={k: name if units.get(name, "1") == "1" else f"{units[name]} ({name})" for k, (_, name) in levels.items()},
            model=self.final,
            values={k: v for k, v in fitted.values.items() if k in self.final.names},
            fit=fitted,
            accepted=accepted,
            before=before,
            after=after,
            heldout=whole,
            noise_floor={
                **{short(c): FloorRow({"value": v, "from": FROM_EQUATIONS}) for c, v in floor.std.items()},
                **merged(a.floors for a in self.answers),
            },
            baselines={},
            residual_map=(
                *residual_map(before_rows, after_rows, self.segments, floor), *listed(self.answers, "cells"),
            ),
            regimes=(
                *regime_curves(places, before_rows, after_rows, self.segments), *listed(self.answers, "curves"),
            ),
            overlays=(*overlays(before_rows, after_rows, self.segments), *listed(self.answers, "overlaid")),
            candidates=tuple(self._candidates(hidden)),
            cost={"added_parameters": len(after) - len(before), "held_out_groups": groups_left_out(found.final)[1]},
            mass=mass_test(previous, {n: (row["value"], row["scatter"]) for n, row in after.items()}),
            notes=(*listed(self.answers, "notes"), *self._notes(), *compensated_voltage(after)),
            complete=self.complete,
            runs=tuple(dict.fromkeys(s.run for s in self.segments)),
            winds=tuple(wind_rows(found.winds, found.declared)),
        )  # fmt: skip

    def _share_left(
        self, first: Mapping[str, float], last: Mapping[str, float], places: Sequence[Located], left: Sequence[Located]
    ) -> float:
        """Of mean squares above the floor, before (first) and after (last): of the channels of places, and of the loops. Where none is
        above it, as the floor of free flight is what is left: all, where a variable still orders a residual, else nothing."""
        above = {p.channel for p in places}
        shares = [min(last[n] / e, 1.0) for n, e in first.items() if short(n) in above and e > 0]
        shares += listed(self.answers, "shares")
        return float(np.mean(shares)) if shares else float(bool(left))

    def _findings(
        self, held: Mapping[str, Mapping[str, HeldOutRow]], after: Mapping[str, ParameterRow]
    ) -> list[Finding]:
        """Of the equations, then of the attitude loops."""
        found = [self._finding(n, held, after) for n in self.found.named.values()]
        if self.asked is None:
            return found
        return found + [finding(s, t, after, self.asked.groups, SEED) for s in self.searches for t in s.evidence]

    def _fit(self) -> Fit:
        """The final model: attitude loops by output error, the translation as the equations have it."""
        held = _held(self.found.final, self.final)
        shapes: dict[str, float] = {}
        start: dict[str, float] = {}
        for s in self.searches:
            assert s.now is not None
            start |= {n: v for n, v in s.now.at.values.items() if n in self.final.names and n not in held}
            shapes |= {n: start[n] for t in s.named for n in s.held(t) if n in start}
        made = fit(self.air, self.final, select="all", frozen={**held, **shapes}, start=start, robust=False)
        return with_equation_error(made, self.found.final)

    def _rows(self, segments: Sequence[Segment], found: FreeFlight, model: Model) -> Linearisation:
        """Residuals of the windows at the estimate, their own noise and disturbances found."""
        model = replace(model, attitude_loops=False)
        estimator = Estimator(tuple(segments), "translation", able)
        known = {n: v for n, v in found.values.items() if n in model.names}
        at = estimator.fit(model, estimator.start(model, known), [])
        return estimator.linearise(model, at, [])

    def _finding(
        self, named: NamedByEquations, held: Mapping[str, Mapping[str, HeldOutRow]], table: Mapping[str, ParameterRow]
    ) -> Finding:
        term = catalogue()[named.term]
        if named.term == WIND_TERM:
            rows = table_of(self.found.final, None)
            parameters = {n: rows[n] for n in rows if n.startswith("w_")}
        else:
            parameters = {n: v for n, v in table.items() if self.final.term_of(n) == named.term}
        scale = {c: named.size[c] / self.found.final.rms[c] for c in named.size if self.found.final.rms.get(c)}
        channel = max(scale, key=lambda c: scale[c]) if scale else "a_z_m_s2"
        words = ", ".join(parameter_in_words(n, v) for n, v in parameters.items())
        if named.term == WIND_TERM and len(self.found.winds) > 1:
            words = f"up to {max(w.speed for w in self.found.winds):.2g} m/s; each flight has its own"
        sentence = f"{term.plain} ({words}); {named.size.get(channel, 0.0):.2g} m/s^2 RMS of {short(channel)} beside the rest of the model"
        rivals = tuple(Rival(r, TermVerdict.CONFUSABLE, 1.0, what_separates(r, named.term)) for r in named.rivals)
        if rivals:
            sentence += f"; {', '.join(r.term for r in rivals)} would explain it as well: {rivals[0].separated_by}"
        return Finding(
            term=named.term,
            title=term.title,
            family=term.family,
            verdict=TermVerdict.CONFUSABLE if rivals else TermVerdict.SUPPORTED,
            equation=term.equation,
            plain=term.plain,
            parameters=parameters,
            heldout={c: rows["all"] for c, rows in held.items()},
            evidence={
                "delta_bic": -2.0 * named.nats,
                "log_evidence": named.nats,
                "probability": probability_of(named.nats, len(self.found.offered)) / (1 + len(rivals)),
                "floors": float(scale.get(channel, 0.0)),
                "where": {"channel": short(channel), "kind": "free"},
                "heldout_gain": share_gained(held.get(short(channel), {}).get("all")),
                "p_value": named.p_value,
                "rms_force_m_s2": float(np.sqrt(sum(v**2 for v in named.size.values()))),
                "rms_force_left_m_s2": None,
            },
            rivals=rivals,
            sentence=sentence,
            source=term.source,
            doubt=term.doubt,
        )

    def _unseen(self) -> tuple[list[Untestable], dict[str, tuple[float, str]]]:
        """What could not be seen and why; of the rest the smallest coefficient that would have been named."""
        found = self.found
        unseen: list[Untestable] = listed(self.answers, "unseen")
        levels: dict[str, tuple[float, str]] = merged(a.levels for a in self.answers)
        for term, name, size in self._smallest():
            levels[term.id] = size, name
            if why := why_unseen(term, size, name):
                unseen.append(Untestable(term.id, why, term.reveals))
        asked = {t.id for a in self.answers if a.search for t in a.search.pool}
        words = {*found.named, *self.loops, *asked, *(u.term for u in unseen), *(s.term for s in found.screened)}
        # Where every flight was declared still, nothing is asked of the wind.
        words |= {*found.refused, *found.final.model.terms, WIND_TERM}
        unseen += [self._not_tried(t) for t in self.pool if t.id not in words]
        return unseen, levels

    def _smallest(self) -> Iterator[tuple[Term, str, float]]:
        """(term, coefficient, its smallest size that would have been named) of every term screened."""
        least = -normal_quantile(0.5 * CHANCE / max(len(self.found.offered), 1)) + POWER
        known = {t.id: t for t in self.pool}
        for s in self.found.screened:
            usual = {p.name: abs(usual_size(p)) for p in known[s.term].amplitudes if usual_size(p)}
            sizes = {n: least * e for n, e in s.std.items() if n in usual}
            if sizes:
                name = min(sizes, key=lambda n: sizes[n] / usual[n])
                yield known[s.term], name, sizes[name]

    def _not_tried(self, term: Term) -> Untestable:
        if missing := missing_channels(term, self.segments):
            return Untestable(term.id, f"not recorded: {', '.join(missing)}", term.reveals, False)
        in_equations = block_of(term) == "translation" and term.id not in self.found.offered
        return Untestable(term.id, NO_COLUMN if in_equations else UNMOVED, term.reveals)

    def _candidates(self, hidden: Mapping[str, str]) -> list[CandidateRow]:
        rows: list[CandidateRow] = []
        for n in self.found.named.values():
            size = max(n.size.values(), default=0.0)
            rows.append(CandidateRow(
                term=n.term, verdict=TermVerdict.SUPPORTED, delta_bic=-2.0 * n.nats, floors=None,
                probability=probability_of(n.nats, len(self.found.offered)) / (1 + len(n.rivals)),
                why=f"{size:.2g} m/s^2 RMS, p {n.p_value:.1g}",
            ))  # fmt: skip
        for term, (nats, why) in self.found.refused.items():
            if term not in self.found.named:
                rows.append(CandidateRow(
                    term=term, verdict=TermVerdict.NOT_NEEDED, delta_bic=-2.0 * nats, probability=0.0, floors=None, why=why,
                ))  # fmt: skip
        done = {r["term"] for r in rows}
        for s in self.found.screened:
            if s.term not in done:
                verdict = TermVerdict.UNTESTABLE if s.term in hidden else TermVerdict.NOT_NEEDED
                why = hidden.get(s.term, f"score test: p {s.p_value:.2g}")
                rows.append(CandidateRow(
                    term=s.term, verdict=verdict, delta_bic=0.0, probability=0.0, floors=None, why=why,
                ))  # fmt: skip
        return [*rows, *(c for a in self.answers for c in a.candidates)]

    def _notes(self) -> list[str]:
        found, notes = self.found, []
        if self.asked is not None and len(self.asked.segments) < len(self.segments):
            notes.append(
                f"attitude loops were searched on {len(self.asked.segments)} of {len(self.segments)} windows, spread over all flights"
            )
        if found.beside_wind:
            notes.append(
                f"{' and '.join(found.beside_wind)} {'is' if len(found.beside_wind) == 1 else 'are'} estimated beside the wind, which "
                "tilts the vehicle as they do, and no finding"
            )
        if found.winds and len(found.final.flights) > 1:
            notes.append(
                "the model is one in still air: the wind of each flight is in the table of winds, not in the model"
            )
        for c, noise in found.final.noise.items():
            period = 1.0 / sampling_rate(found.flown)
            density = np.sqrt(noise.spectrum(np.array([0.1, 1.0, 0.4 / period]), period))
            notes.append(
                f"noise of {short(c)} in these flights: {density[0]:.2g}, {density[1]:.2g} and {density[2]:.2g} m/s^2 per root Hz at 0.1, "
                f"1 and {0.4 / period:.0f} Hz"
            )
        notes += pairs_of_flights(found)
        return notes
