"""What a search by output error is reported as: findings and candidates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flighttest.diagnose.findings import candidate_row, evidence_row, finding_of, numbers_in_words, share_gained
from flighttest.diagnose.model import Finding, Rival, TermVerdict, brief, flown, short
from flighttest.diagnose.records import CandidateRow, ParameterRow
from flighttest.diagnose.selection.aliases import aliases_of
from flighttest.diagnose.selection.candidates import null_value
from flighttest.diagnose.selection.comparison import held_out_errors
from flighttest.diagnose.selection.held_out import gains_held_out
from flighttest.diagnose.selection.proposals import LEAST_PREDICTED
from flighttest.diagnose.selection.search import Search
from flighttest.estimation.linearisation import FloatArray, IntArray
from flighttest.estimation.uncertainty.distributions import chi2_beyond
from flighttest.physics.core import Term


def finding(search: Search, term_id: str, table: Mapping[str, ParameterRow], groups: IntArray, seed: int) -> Finding:
    """One accepted term against the same model without it. table: parameters of the final model (`parameter_table`)."""
    assert search.now is not None
    assert search.floor is not None
    term, evidence = search.terms[term_id], search.evidence[term_id]
    before, after = held_out_errors(evidence.without, search.now, search.estimator, groups)
    heldout = {short(name): row for name, row in gains_held_out(before, after, groups, search.floor, seed).items()}
    parameters = {n: v for n, v in table.items() if search.now.model.term_of(n) == term_id}
    rivals = tuple(
        Rival(
            a.term,
            TermVerdict.CONFUSABLE if a.confusable else TermVerdict.NOT_NEEDED,
            a.cosine,
            search.terms[a.term].reveals,
        )
        for a in aliases_of(search, term_id)
    )
    confusable = [r for r in rivals if r.verdict == TermVerdict.CONFUSABLE]
    numbers = numbers_in_words(parameters, search.held(term_id))
    sentence = (
        f"{term.plain} ({numbers}); {brief(evidence.floors)} noise floors in {short(evidence.place[0])} of {flown(evidence.place[1])}; "
        f"probability {_percent(evidence.probability)}{undetermined_sizes(term, parameters)}"
    )
    if confusable:
        others = ", ".join(r.term for r in confusable)
        sentence += f"; {others} would explain it as well, fly {confusable[0].separated_by} to separate them"
    where = short(evidence.place[0]), evidence.place[1]
    p_value = chi2_beyond(max(2.0 * evidence.nats, 0.0), max(len(parameters), 1))
    forces = _rms_force(search, evidence.effect), _rms_force(search, evidence.profiled)
    probability = evidence.probability / (1 + len(confusable))
    row = evidence_row(
        evidence.nats, probability, evidence.floors, where, share_gained(heldout[where[0]]), p_value, forces
    )
    return finding_of(term, row, parameters, heldout, sentence, rivals)


def undetermined_sizes(term: Term, parameters: Mapping[str, ParameterRow]) -> str:
    """That the interval of every coefficient of a named term contains its absence, in words; empty where one does not. They are
    exchanged with one another, or with the rest of the model: absence of all is excluded by the likelihood ratio."""
    held = [(null_value(p), parameters[p.name]["interval_95"]) for p in term.amplitudes if p.name in parameters]
    if not held or not all(low <= null <= high for null, (low, high) in held):
        return ""
    of = "its coefficient" if len(held) == 1 else "each coefficient"
    return f"; its absence is excluded, although the interval of {of} contains it: sizes are determined together, not one by one"


def _percent(probability: float) -> str:
    return "above 99.9 %" if probability > 0.999 else f"{100 * probability:.1f} %"


def _rms_force(search: Search, effect: FloatArray) -> float | None:
    """RMS over all samples of an effect on specific force (3 axes), m/s^2; None without that channel."""
    assert search.now is not None
    rows = search.now.rows
    forces = [c for c, name in enumerate(rows.channels) if name.startswith(("f_", "a_"))]
    powers = [float(np.mean(effect[at] ** 2)) for c in forces if (at := np.flatnonzero(rows.channel == c)).size]
    return float(np.sqrt(sum(powers))) if forces else None


def candidate_rows(search: Search) -> list[CandidateRow]:
    """Every candidate's evidence, for the table of what was ruled out and why."""
    found: list[CandidateRow] = []
    for e in {**search.rejected, **search.evidence}.values():
        named = e.term in search.evidence
        why = f"{brief(e.floors)} noise floors in {short(e.place[0])} of {flown(e.place[1])}" if named else e.why_not
        found.append(candidate_row(e.term, e.nats, e.probability, e.floors, why, named=named))
    done = {f["term"] for f in found}
    if search.subsets is None or search.sizes is None:
        return found
    alone = [s for s in search.scored if len(s.members) == 1]
    for s, size in zip(alone, search.sizes.least(alone), strict=True):
        (term,) = search.subsets.terms(s)
        if term not in done:
            probability = 1.0 / (1.0 + float(np.exp(min(-s.log_odds, 700.0))))
            why = f"screened: log odds {s.log_odds:.1f} beside the final model"
            if small := s.log_odds > 0.0 and size < LEAST_PREDICTED:
                why += f", but an effect of {size:.2g} noise floors, too small to be distinguished from a clean vehicle"
            found.append(candidate_row(term, s.log_odds, probability, float(size) if small else None, why))
    return found
