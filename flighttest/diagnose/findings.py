"""Parameters and findings in tables and words, whichever way they were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flighttest.diagnose.model import brief
from flighttest.diagnose.records import ParameterRow
from flighttest.identify.fit import Fit
from flighttest.physics.core import Term


def parameter_table(found: Fit) -> dict[str, ParameterRow]:
    """Name to value, std, unit and 95 % interval of every estimated parameter, as in model.yaml; scatter: std, as comparisons of two fits
    take it; at_bound where an estimate lies on its bound."""
    table: dict[str, ParameterRow] = {}
    for name, e in found.estimates.items():
        if e.std is None or e.interval_95 is None or name not in found.model.param:
            continue
        table[name] = {
            "value": e.value, "std": e.std, "unit": e.unit, "interval_95": list(e.interval_95),
            "scatter": e.std if e.scatter is None else e.scatter,
        }  # fmt: skip
    for name in found.solution.at_bound:
        p, value = found.model.param[name], found.solution.values[name]
        spread = (p.upper - p.lower) / float(np.sqrt(12.0))  # all that is known of it is its range
        table[name] = {
            "value": value, "std": spread, "unit": p.unit, "interval_95": [p.lower, p.upper], "scatter": spread, "at_bound": True,
        }  # fmt: skip
    return table


def with_owner(term: Term, sentence: str) -> str:
    """A sentence about a term, which begins with whose the term is where it is no physics of the vehicle."""
    if term.family not in ("autopilot", "sensor", "link"):
        return sentence
    title = term.title if term.title[:2].isupper() else term.title[:1].lower() + term.title[1:]
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
