"""One diagnosis of what the parts of the model answered: the final model, its fit, the verdict, what was not seen, the next flight."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.answer import Asked, PartAnswer, error_left, listed, merged
from flighttest.diagnose.conclusion import (
    UNMOVED,
    UNTRIED,
    carried_otherwise,
    compensated_voltage,
    different_delays,
    moved_parameters,
    predicted_worse,
    rotor_height_taken,
    sentence_of,
    unlike_flights,
    unrecorded_battery,
    verdict_of,
)
from flighttest.diagnose.findings import parameter_table
from flighttest.diagnose.mass import mass_test
from flighttest.diagnose.model import Diagnosis, Finding, TermVerdict, Untestable, Verdict
from flighttest.diagnose.next_flight import Flyable, Question, propose
from flighttest.diagnose.output_error import OutputErrorAnswer
from flighttest.diagnose.output_error.residual_regression import describe
from flighttest.diagnose.records import CandidateRow, Description, NextReason
from flighttest.diagnose.selection.detectability import UNSEEN, missing_channels
from flighttest.diagnose.selection.search import Search
from flighttest.estimation.solver import Start
from flighttest.identify.diagnostics.identifiability import flown_voltage
from flighttest.identify.fit import Fit
from flighttest.identify.free_flight.equation_fit import fit_of_estimates
from flighttest.identify.free_flight.winds import FlightWind, in_still_air, still_air, wind_rows
from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.script.model import ScriptData

MOST_ASKED = 2  # questions of each block that a next flight is sought for: each is a rehearsal of several maneuvers
SHAPE_ALONE = "times its usual size"


def assembled(asked: Asked, answers: Sequence[PartAnswer], flyable: Flyable) -> Diagnosis:
    """One diagnosis of the parts' answers."""
    model, pool = asked.model, asked.pool
    searches = [a.search for a in answers if isinstance(a, OutputErrorAnswer)]
    complete = all(a.complete for a in answers)
    nats = merged(a.accepted for a in answers)
    accepted = tuple(sorted(nats, key=lambda t: nats[t], reverse=True))
    joined = {t for a in answers for t in a.terms}
    final = model.with_terms(
        *(t for t in accepted if t in joined), *(t for a in answers for t in a.terms if t not in nats)
    )
    winds = next((a.winds for a in answers if a.winds), ())
    asked.support.progress(f"fitting {' + '.join(final.terms)}")
    final_fit = _final_fit(asked, answers, searches, final, winds)
    before = merged([parameter_table(asked.base) if asked.base else {}, *(a.before for a in answers)])
    after = parameter_table(final_fit)
    findings = sorted((f for a in answers for f in a.findings(asked, after)), key=lambda f: accepted.index(f.term))
    located, levels = listed(answers, "located"), merged(a.levels for a in answers)
    tried = {t for a in answers for t in a.tried}
    unseen = _not_testable(asked, answers, tried, complete)
    hidden = {u.term: u.why for u in unseen}
    units = {p.name: p.unit for t in catalogue().values() for p in t.params}
    staying = {c for a in answers for c in a.staying}
    share, error = error_left(answers)
    unexplained = any(a.unexplained for a in answers)
    otherwise = carried_otherwise(after)
    so_far = verdict_of(
        named=bool(findings), located=bool(located or otherwise), unexplained=unexplained or bool(otherwise)
    )
    said = sentence_of(so_far, findings, (share, error), located, complete)
    if otherwise:
        said = f"{said} {otherwise}" if findings or located else otherwise
    cut_short = () if complete else ("interrupted: candidates not tried are not in this answer",)
    nameless = searches and so_far in (Verdict.UNKNOWN_PHYSICS, Verdict.PARTLY)
    formulas = _described(asked, searches, staying) if nameless else []
    asked.support.progress("choosing the next flight")
    catalogued = {t.id: t for t in pool}

    def fits(script: ScriptData) -> tuple[ScriptData, float] | None:
        return flyable(script, final, final_fit.values)

    proposal = _next(searches, findings, unseen, catalogued, fits) if complete else None
    return Diagnosis(
        verdict=so_far if complete else Verdict.PARTLY,  # what was not searched for is neither missing nor explained
        sentence=said
        + predicted_worse(merged(a.heldout for a in answers))
        + moved_parameters(asked.previous, after)
        + unlike_flights(_pushes(final_fit) if searches else {}),
        located=tuple(located),
        findings=tuple(findings),
        not_needed=tuple(sorted(tried - {*accepted, *joined, *hidden})),
        untestable=tuple(unseen),
        unexplained={"excess_share": float(min(share, 1.0)) if located or findings else 0.0, "of": error},
        smallest_detectable={k: v for k, (v, _) in levels.items() if np.isfinite(v) and hidden.get(k) != UNSEEN},
        smallest_units={k: _in_units(name, units[name]) if name else SHAPE_ALONE for k, (_, name) in levels.items()},
        model=final,
        values={k: v for k, v in final_fit.values.items() if k in final.names},
        fit=final_fit,
        held=tuple(a.held for a in answers if a.held),
        accepted=accepted,
        before=before,
        after=after,
        heldout=merged(a.heldout for a in answers),
        noise_floor=merged(a.floors for a in answers),
        baselines=merged(a.baselines for a in answers),
        residual_map=tuple(listed(answers, "cells")),
        errors=tuple(listed(answers, "errors")),
        left=tuple(listed(answers, "left")),
        regimes=tuple(listed(answers, "curves")),
        overlays=tuple(listed(answers, "overlaid")),
        candidates=_candidate_rows(answers, hidden),
        cost={"added_parameters": len(after) - len(before), "held_out_groups": asked.group_name},
        unknown=tuple(formulas),
        mass=mass_test(
            asked.previous,
            {n: (row["value"], row["scatter"]) for n, row in after.items()},
            _as_flown(asked, final_fit),
        ),
        next_flight="next.yaml" if proposal else None,
        next_script=proposal[1] if proposal else None,
        next_reason=proposal[0] if proposal else {},
        notes=(
            *listed(answers, "notes"),
            *cut_short,
            *different_delays(after),
            *compensated_voltage(after),
            *rotor_height_taken(located, accepted, model.rotor_height_m),
            *unrecorded_battery(located, any(np.isfinite(s.y.get("voltage_v", np.nan)).any() for s in asked.segments)),
        ),
        complete=complete,
        runs=tuple(dict.fromkeys(s.run for s in asked.segments)),
        winds=tuple(wind_rows(winds, still_air(asked.weather)[0])),
    )


def _as_flown(asked: Asked, found: Fit) -> float:
    """What the ratio of two K, both at the nominal voltage, is multiplied by to be that of thrust as it was flown: an alpha that is not
    known carries them elsewhere."""
    before, after = asked.previous.get("alpha"), found.values.get("alpha")
    if before is None or after is None:
        return 1.0
    return float((flown_voltage(asked.segments, found.model) / found.model.nominal_voltage_v) ** (after - before[0]))


def _pushes(found: Fit) -> dict[str, NDArray[np.float64]]:
    """Flight to the constant vertical disturbances of its windows of free flight, m/s^2."""
    runs: dict[str, list[float]] = {}
    every = found.start.nuisance.get("a_d_z_m_s2", np.empty(0))
    for segment, push in zip(found.problem.segments, every, strict=False):
        if segment.kind == "free" and np.isfinite(push):
            runs.setdefault(segment.run, []).append(float(push))
    return {run: np.array(values) for run, values in runs.items()}


def _not_testable(
    asked: Asked, answers: Sequence[PartAnswer], determined: Collection[str], complete: bool
) -> list[Untestable]:
    """Candidates on which these flights contain no information, with the reason. determined: ids of those that were tried or named."""
    found: list[Untestable] = listed(answers, "unseen")
    known = {u.term for u in found}
    for term in asked.pool:
        missing = missing_channels(term, asked.segments)
        if missing and term.id not in known:
            found.append(Untestable(term.id, f"not recorded: {', '.join(missing)}", term.reveals, False))
    known = {u.term for u in found} | set(determined)
    why = UNMOVED if complete else UNTRIED
    return found + [Untestable(t.id, why, t.reveals) for t in asked.pool if t.id not in known]


def _described(asked: Asked, searches: Sequence[Search], staying: set[str]) -> list[Description]:
    """What has no name, by sparse regression. staying: channels whose mismatch stays."""
    asked.support.progress("describing the rest by residual regression")
    channels = _with_forces(staying)
    return [one for search in searches for one in describe(search, asked.segments, asked.groups, channels)]


def _candidate_rows(answers: Sequence[PartAnswer], hidden: Mapping[str, str]) -> tuple[CandidateRow, ...]:
    """Rows of every candidate; what these flights could not have shown (hidden: id to reason) was not ruled out by them."""
    return tuple(
        CandidateRow({**c, "verdict": TermVerdict.UNTESTABLE, "why": hidden[c["term"]]}) if c["term"] in hidden else c
        for a in answers
        for c in a.candidates
    )


def _final_fit(
    asked: Asked, answers: Sequence[PartAnswer], searches: Sequence[Search], final: Model, winds: Sequence[FlightWind]
) -> Fit:
    """The final model, fitted to every response; model.yaml, the report and the findings print its values and intervals. What prediction
    errors showed is held there, and what is no effect of its term; they are in the frame of the air."""
    estimates = [a.held for a in answers if a.held]
    if final == asked.model and asked.base and not estimates:
        return asked.base
    null = merged(a.null for a in answers)
    begun = None
    if asked.base:
        start = {n: v for n, v in asked.base.values.items() if n in final.names} | null
        noise, nuisance = asked.base.noise, dict(asked.base.start.nuisance)
        for search in searches:
            assert search.now is not None
            values = search.now.at.values  # of every parameter: those of other blocks are the base's
            start |= {n: values[n] for n in search.now.names}
            noise |= search.now.at.noise
            nuisance |= search.now.at.nuisance
        # What the base does not determine is held where the fit begins and called assumed; a search moves it along flat directions.
        start |= {n: e.value for n, e in asked.base.estimates.items() if e.source == "assumed" and n in start}
        begun = Start(start, noise, nuisance)
    segments = in_still_air(asked.recorded, winds) if estimates else asked.recorded
    return fit_of_estimates(segments, final, estimates, start=begun, frozen=null)


def _in_units(name: str, unit: str) -> str:
    return name if unit == "1" else f"{unit} ({name})"


def _next(
    searches: Sequence[Search],
    findings: Sequence[Finding],
    unseen: Sequence[Untestable],
    terms: Mapping[str, Term],
    fits: Callable[[ScriptData], tuple[ScriptData, float] | None],
) -> tuple[NextReason, ScriptData] | None:
    """The flight that separates rivals; where there are none, one that shows what could not be seen. A flight inside the zone for a
    later question comes before one for the first that needs a larger zone."""
    estimated = {k: v for s in searches if s.now for k, v in s.now.at.values.items()}
    hidden = [u for u in unseen if u.recorded]
    asked: list[tuple[Search, list[Question]]] = []
    for search in searches:
        assert search.now is not None
        found = []
        for f in (f for f in findings if f.term in search.evidence):
            for r in (r for r in f.rivals if r.verdict == TermVerdict.CONFUSABLE):
                size = {n: search.now.at.values[n] for n in f.parameters}
                found.append(Question(terms[f.term], terms[r.term], size))
        asked.append((search, found[:MOST_ASKED]))
    for search in searches:
        here = {t.id for t in search.pool}
        looked_for = [terms[u.term] for u in hidden if u.term in here]
        found = [Question(t, None, {p.name: p.nominal for p in t.params}) for t in looked_for]
        asked.append((search, found[:MOST_ASKED]))
    for inside in (True, False):
        for search, questions in asked:
            assert search.now is not None
            values = {**search.now.model.start(), **estimated}
            if questions and (made := propose(search, questions, values, fits, inside=inside)):
                return made
    return None


def _with_forces(channels: set[str]) -> set[str]:
    """A velocity that goes astray was pushed: its force is to be described."""
    return channels | {f"{force}_{c[2:]}" for c in channels if c.startswith("v_") for force in ("f", "a")}
