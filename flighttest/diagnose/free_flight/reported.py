"""What a search of free flight is reported as: findings, candidates, parameters, smallest sizes, notes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from flighttest.channels import CHANNELS
from flighttest.diagnose.findings import candidate_row, evidence_row, finding_of, numbers_in_words, share_gained
from flighttest.diagnose.free_flight.equation_search import OFFSET_TERM, EquationSearch, NamedByEquations
from flighttest.diagnose.model import Finding, Rival, TermVerdict, short
from flighttest.diagnose.records import CandidateRow, HeldOutRow, ParameterRow
from flighttest.diagnose.selection.candidates import usual_size
from flighttest.diagnose.selection.comparison import level_of, probability_of
from flighttest.diagnose.selection.detectability import POWER
from flighttest.estimation.uncertainty.distributions import normal_quantile
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.free_flight.winds import CHANCE, WIND_TERM
from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Term
from flighttest.physics.model import Model


def findings_of(
    search: EquationSearch, held: Mapping[str, Mapping[str, HeldOutRow]], table: Mapping[str, ParameterRow]
) -> list[Finding]:
    """Of every named term. held: as of `held_out_table`; table: parameters of the final model."""
    return [_finding(search, named, held, table) for named in search.named.values()]


def _finding(
    search: EquationSearch,
    named: NamedByEquations,
    held: Mapping[str, Mapping[str, HeldOutRow]],
    table: Mapping[str, ParameterRow],
) -> Finding:
    term, final = catalogue()[named.term], search.final
    if named.term == WIND_TERM:
        rows = table_of(final, None)
        parameters = {n: rows[n] for n in rows if n.startswith("w_")}
    else:
        parameters = {n: v for n, v in table.items() if final.model.term_of(n) == named.term}
    scale = {c: named.size[c] / final.rms[c] for c in named.size if final.rms.get(c)}
    channel = max(scale, key=lambda c: scale[c])
    words = numbers_in_words(parameters, tuple(held_at_null(search, term)))
    if named.term == WIND_TERM and len(search.winds) > 1:
        words = f"up to {max(w.speed for w in search.winds):.2g} m/s; each flight has its own"
    size = f"{named.size[channel]:.2g} {CHANNELS[channel].unit} RMS of {short(channel)}"
    sentence = f"{term.plain} ({words}); {size} beside the rest of the model"
    rivals = tuple(
        Rival(r, TermVerdict.CONFUSABLE, 1.0, what_separates(r, named.term)) for r in search.rivals_of(named.term)
    )
    if rivals:
        sentence += f"; {', '.join(r.term for r in rivals)} would explain it as well: {rivals[0].separated_by}"
    forces = [v for c, v in named.size.items() if c.startswith(("f_", "a_"))]
    probability = probability_of(named.nats, len(search.offered)) / (1 + len(rivals))
    gain = share_gained(held.get(short(channel), {}).get("all"))
    force = float(np.sqrt(sum(v**2 for v in forces))) if forces else None
    where = short(channel), "free"
    row = evidence_row(named.nats, probability, float(scale[channel]), where, gain, named.p_value, (force, None))
    return finding_of(term, row, parameters, {c: rows["all"] for c, rows in held.items()}, sentence, rivals)


def held_at_null(search: EquationSearch, term: Term) -> dict[str, float]:
    """Coefficients of a named term that are held at their null values, since physics does not allow what they were."""
    found = search.final
    return {p.name: found.values[p.name] for p in term.amplitudes if p.one_sided and p.name not in found.estimated}


def smallest_of(search: EquationSearch, pool: Sequence[Term]) -> Iterator[tuple[Term, str, float]]:
    """(term, coefficient, its smallest size that would have been named) of every term screened, by the standard error of its estimate where
    it was estimated anew.

    Of moments of the air, whose trim is estimated with them, that was 1.2 rad/(s m) where the score test had 0.2: hidden ones of 2.5 were
    called not needed.
    """
    least = -normal_quantile(0.5 * level_of(len(search.offered))) + POWER
    known = {t.id: t for t in pool}
    for s in search.screened:
        usual = {p.name: abs(usual_size(p)) for p in known[s.term].amplitudes if usual_size(p)}
        sizes = {n: least * e for n, e in {**s.std, **search.errors.get(s.term, {})}.items() if n in usual}
        if sizes:
            name = min(sizes, key=lambda n: sizes[n] / usual[n])
            yield known[s.term], name, sizes[name]


def candidates_of(search: EquationSearch) -> list[CandidateRow]:
    """Every candidate's evidence."""
    rows: list[CandidateRow] = []
    for n in search.named.values():
        channel, size = max(n.size.items(), key=lambda kv: kv[1])
        probability = probability_of(n.nats, len(search.offered)) / (1 + len(search.rivals_of(n.term)))
        why = f"{size:.2g} {CHANNELS[channel].unit} RMS, p {n.p_value:.1g}"
        rows.append(candidate_row(n.term, n.nats, probability, None, why, named=True))
    for term, (nats, why) in search.refused.items():
        if term not in search.named:
            rows.append(candidate_row(term, nats, probability_of(nats, len(search.offered)), None, why))
    done = {r["term"] for r in rows}
    for s in search.screened:
        if s.term not in done:
            rows.append(candidate_row(s.term, 0.0, 0.0, None, f"score test: p {s.p_value:.2g}"))
    return rows


def notes_of_search(search: EquationSearch) -> list[str]:
    """The noise found, and, of the translation, what winds and further flights would show."""
    notes = [f"{name} is in the model and no finding: {search.refused[name][1]}" for name in search.small]
    if search.beside_wind:
        notes.append(
            f"{' and '.join(search.beside_wind)} {'is' if len(search.beside_wind) == 1 else 'are'} estimated beside the wind, which "
            "tilts the vehicle as they do, and no finding"
        )
    if search.winds and len(search.final.flights) > 1:
        notes.append(
            "the model is one in still air: the wind of each flight is in the table of winds, not in the model"
        )
    for c, noise in search.final.noise.items():
        period = search.final.period_s
        density = np.sqrt(noise.spectrum(np.array([0.1, 1.0, 0.4 / period]), period))
        notes.append(
            f"noise of {short(c)} in these flights: {density[0]:.2g}, {density[1]:.2g} and {density[2]:.2g} {CHANNELS[c].unit} per root Hz "
            f"at 0.1, 1 and {0.4 / period:.0f} Hz"
        )
    return notes + (pairs_of_flights(search) if search.final.part == "translation" else [])


def pairs_of_flights(found: EquationSearch) -> list[str]:
    """Pairs of flights that would part what these could not."""
    said = []
    if found.winds and not found.turned and not found.declared:
        said.append(
            "a wind and an attitude offset tilt the vehicle alike at one heading: a second flight at another heading, or one in still air "
            "(--weather FLIGHT=still), diagnosed together with this one separates them"
        )
    offered = {*found.offered} - {*found.named}
    if "ground_effect" in offered and not any(s.term == "ground_effect" and s.p_value < CHANCE for s in found.screened):
        said.append(
            "ground effect shows between a low and a high flight: hover below one rotor diameter and above three, diagnosed together"
        )
    if len(found.final.flights) == 1:
        said.append(
            "a payload shows as K of a loaded over K of an unloaded flight of the same battery: diagnose the one with the other's --model"
        )
    return said


def table_of(found: FreeFlight, model: Model | None) -> dict[str, ParameterRow]:
    """Estimated parameters as rows; `model` None: those of single flights, too."""
    rows: dict[str, ParameterRow] = {}
    factor = found.factor()
    for n, std in found.std.items():
        if model is not None and n not in model.names:
            continue
        value, p = found.values[n], found.model.param[n.split("@")[0]]
        if np.isfinite(std):
            rows[n] = {
                "value": value, "std": std, "unit": p.unit, "interval_95": [value - factor * std, value + factor * std],
                "scatter": std,
            }  # fmt: skip
    return rows


def what_separates(rival: str, term: str) -> str:
    """The flight that separates two terms."""
    if {rival, term} == {WIND_TERM, OFFSET_TERM}:
        return "fly a second heading, or declare a flight in still air"
    return f"fly {catalogue()[rival].reveals}"
