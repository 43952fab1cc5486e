"""A term that joined the model, as a finding: parameters with intervals, what it gains on what it has not seen, rivals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.chance import standard_errors, standard_errors_of_equations
from flighttest.diagnose.fitted import Fitted
from flighttest.diagnose.judge import compare, held_out
from flighttest.diagnose.model import Finding, Rival, TermVerdict, brief, flown, short
from flighttest.diagnose.search import Search

IntArray = NDArray[np.intp]


def parameter_table(fitted: Fitted) -> dict[str, dict[str, Any]]:
    """Name to value, std and 95 % interval (scatter of responses, and what parts of the recording disagree on), unit, and scatter: the
    standard error of the first alone, which is what two fits of one model differ by."""
    param, values, names = fitted.model.param, fitted.state.values, fitted.names
    scatter = dict(zip(names, standard_errors(fitted.rows, names), strict=True))
    inside = tuple(n for n in names if param[n].lower < values[n] < param[n].upper)
    # Beside a parameter that its bound holds the others are known as if it were.
    std = scatter | dict(zip(inside, standard_errors_of_equations(fitted.rows, inside), strict=True))
    found = {}
    for name in names:
        p, value = param[name], values[name]
        error = min(float(std[name]), (p.upper - p.lower) / float(np.sqrt(12.0)))  # an even spread over its range
        interval = [max(value - 1.96 * error, p.lower), min(value + 1.96 * error, p.upper)]
        found[name] = {
            "value": value,
            "std": error,
            "unit": p.unit,
            "interval_95": interval,
            "scatter": float(scatter[name]),
        } | ({} if name in inside else {"at_bound": True})
    return found


def finding(search: Search, term_id: str, rivals: tuple[Rival, ...], groups: IntArray, seed: int) -> Finding:
    """One accepted term against the same model without it."""
    assert search.now is not None
    assert search.floor is not None
    term = next(t for t in search.pool if t.id == term_id)
    judged = search.judged[term_id]
    without = search.without(term_id)
    before, after = held_out(without.rows, without.names, groups), held_out(search.now.rows, search.now.names, groups)
    heldout = {
        short(name): {**asdict(h), "gain_95": list(h.gain_95)}
        for name, h in compare(without.rows, before, search.now.rows, after, groups, search.floor, seed).items()
    }
    table = parameter_table(search.now)
    parameters = {n: v for n, v in table.items() if search.now.model.term_of(n) == term_id}
    own = {p.name for p in term.amplitudes}
    held = {n: v for n, v in search.pinned.items() if n in own}
    for name, std in held.items():
        value, unit = search.now.state.values[name], search.now.model.param[name].unit
        parameters[name] = {
            "value": value, "std": std, "unit": unit, "interval_95": [value - 1.96 * std, value + 1.96 * std], "held": True,
        }  # fmt: skip
    confusable = [r.term for r in rivals if r.verdict == TermVerdict.CONFUSABLE]
    force = _rms_force(search, judged.effect)
    numbers = ", ".join(_told(n, v) for n, v in parameters.items())
    sentence = f"{term.plain} ({numbers}); {brief(judged.floors)} noise floors in {short(judged.place[0])} of {flown(judged.place[1])}"
    if term.family in ("autopilot", "sensor", "link"):
        title = term.title if term.title[:2].isupper() else term.title[:1].lower() + term.title[1:]
        sentence = f"This is your {term.family} ({title}): {sentence}"
    if confusable:
        sentence += (
            f"; {', '.join(confusable)} would explain it as well, fly {rivals[0].separated_by} to tell them apart"
        )
    return Finding(
        term=term_id,
        title=term.title,
        family=term.family,
        verdict=TermVerdict.CONFUSABLE if confusable else TermVerdict.SUPPORTED,
        equation=term.equation,
        plain=term.plain,
        parameters=parameters,
        heldout=heldout,
        evidence={
            "delta_bic": judged.bic,
            "floors": judged.floors,
            "where": {"channel": short(judged.place[0]), "kind": judged.place[1]},
            "heldout_gain": judged.gain,
            "p_value": judged.p_value,
            "rms_force_m_s2": force,
            "rms_force_left_m_s2": _rms_force(search, judged.own),
        },
        rivals=rivals,
        sentence=sentence,
        source=term.source,
        doubt=term.doubt,
    )


def _told(name: str, v: Mapping[str, Any]) -> str:
    """A parameter in words."""
    unit = "" if v["unit"] == "1" else f" {v['unit']}"
    if v.get("at_bound"):
        return f"{name} {v['value']:.3g}{unit}, its bound"
    held = " (held: the recording does not ask for more)" if v.get("held") else ""
    return f"{name} {v['value']:.3g} ± {brief(1.96 * v['std'])}{unit}{held}"


def _rms_force(search: Search, effect: Any) -> float | None:
    """RMS over all samples of an effect on specific force (3 axes), m/s^2; None without that channel."""
    assert search.now is not None
    rows = search.now.rows
    total, any_force = 0.0, False
    for c, name in enumerate(rows.channels):
        if name.startswith(("f_", "a_")):
            at = np.flatnonzero(rows.channel == c)
            total += float(np.mean(effect[at] ** 2)) if at.size else 0.0
            any_force = True
    return float(np.sqrt(total)) if any_force else None
