"""Parameters and findings in tables and words, whichever way they were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flighttest.diagnose.model import Finding, Rival, TermVerdict, brief
from flighttest.diagnose.records import CandidateRow, EvidenceRow, HeldOutRow, ParameterRow
from flighttest.identify.fit import Fit
from flighttest.physics.core import Term


def parameter_table(found: Fit) -> dict[str, ParameterRow]:
    """Name to value, std, unit and 95 % interval of every estimated parameter, as in model.yaml; scatter: std, as comparisons of two fits
    take it; at_bound where an estimate lies on its bound: with its whole range for an interval where it has none."""
    table: dict[str, ParameterRow] = {}
    for name, e in found.estimates.items():
        if e.std is None or e.interval_95 is None or name not in found.model.param:
            continue
        table[name] = {
            "value": e.value, "std": e.std, "unit": e.unit, "interval_95": list(e.interval_95),
            "scatter": e.std if e.scatter is None else e.scatter,
        }  # fmt: skip
    for name in found.solution.at_bound:
        if name in table:
            table[name]["at_bound"] = True
            continue
        p, value = found.model.param[name], found.solution.values[name]
        spread = (p.upper - p.lower) / float(np.sqrt(12.0))  # all that is known of it is its range
        table[name] = {
            "value": value, "std": spread, "unit": p.unit, "interval_95": [p.lower, p.upper], "scatter": spread, "at_bound": True,
        }  # fmt: skip
    return table


def finding_of(
    term: Term,
    evidence: EvidenceRow,
    parameters: Mapping[str, ParameterRow],
    heldout: Mapping[str, HeldOutRow],
    sentence: str,
    rivals: Sequence[Rival] = (),
) -> Finding:
    """What is reported of a named term: CONFUSABLE where a rival explains the recordings as well."""
    confusable = any(r.verdict is TermVerdict.CONFUSABLE for r in rivals)
    return Finding(
        term=term.id, title=term.title, family=term.family,
        verdict=TermVerdict.CONFUSABLE if confusable else TermVerdict.SUPPORTED, equation=term.equation, plain=term.plain,
        parameters=parameters, heldout=heldout, evidence=evidence, rivals=tuple(rivals), sentence=with_owner(term, sentence),
        source=term.source, doubt=term.doubt,
    )  # fmt: skip


def evidence_row(
    nats: float,
    probability: float,
    floors: float,
    where: tuple[str, str],
    heldout_gain: float,
    p_value: float,
    forces: tuple[float | None, float | None] = (None, None),
) -> EvidenceRow:
    """Evidence for a term. where: channel (short) and kind of maneuver; forces: its RMS in specific force, and what is left of that beside
    the nuisance parameters."""
    return {
        "delta_bic": -2.0 * nats, "log_evidence": nats, "probability": probability, "floors": floors,
        "where": {"channel": where[0], "kind": where[1]}, "heldout_gain": heldout_gain, "p_value": p_value,
        "rms_force_m_s2": forces[0], "rms_force_left_m_s2": forces[1],
    }  # fmt: skip


def candidate_row(
    term: str, nats: float, probability: float, floors: float | None, why: str, *, named: bool = False
) -> CandidateRow:
    """A candidate that was looked at."""
    verdict = TermVerdict.SUPPORTED if named else TermVerdict.NOT_NEEDED
    return {
        "term": term, "verdict": verdict, "delta_bic": 0.0 - 2.0 * nats, "probability": probability, "floors": floors, "why": why,
    }  # fmt: skip


def share_gained(row: HeldOutRow | None) -> float:
    """Of the held-out mean square above the floor, the share that is gone; 0 where nothing is above it."""
    if row is None or not row["rmse_before"] > row["floor"]:
        return 0.0
    return float((row["rmse_before"] ** 2 - row["rmse_after"] ** 2) / (row["rmse_before"] ** 2 - row["floor"] ** 2))


def with_owner(term: Term, sentence: str) -> str:
    """A sentence about a term, which begins with whose the term is where it is no physics of the vehicle."""
    if term.family not in ("autopilot", "sensor", "link"):
        return sentence
    title = term.title if term.title[1:2].isupper() else term.title[:1].lower() + term.title[1:]
    return f"This is your {term.family} ({title}): {sentence}"


def numbers_in_words(rows: Mapping[str, ParameterRow], held: Sequence[str]) -> str:
    """Parameters of a term with their intervals, and which of its coefficients are held at their null values."""
    words = ", ".join(parameter_in_words(n, row) for n, row in rows.items())
    return words + (f"; {', '.join(held)} held at 0, since its estimate was another effect" if held else "")


def parameter_in_words(name: str, row: ParameterRow) -> str:
    """Name, value and 95 % interval, with the unit: half the interval, or both its ends where a bound of the parameter cuts it."""
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    value, (low, high) = float(row["value"]), row["interval_95"]
    if row.get("at_bound"):
        return f"{name} {value:.3g}{unit}, its bound"
    if not np.isclose(high - value, value - low, rtol=0.01):
        return f"{name} {value:.3g}{unit}, 95 % interval {low:.3g} to {high:.3g}"
    return f"{name} {value:.3g} ± {brief(0.5 * (high - low))}{unit}"
