"""Two models side by side: z-scores per parameter, which differ, in one table."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from flighttest.estimation.uncertainty.distributions import normal_beyond
from flighttest.identify.models.model_file import ModelFile, StoredParameter

LEVEL = (
    0.05  # chance that any parameter of two equal vehicles is called different (Holm's correction over the parameters)
)


@dataclass(frozen=True)
class ParameterDifference:
    """One parameter in two models. z, p_value: of the difference; None where either has no standard error."""

    name: str
    unit: str
    first: float | None
    second: float | None
    difference: float | None
    std: float | None
    z: float | None
    p_value: float | None
    differs: bool
    sentence: str


def compare(first: ModelFile, second: ModelFile) -> tuple[ParameterDifference, ...]:
    """Every parameter of either model; those that differ first, then by z. K of the second at the nominal voltage of the first."""
    rows = []
    second = replace(second, parameters={**second.parameters, **_gain_at(first.model.nominal_voltage_v, second)})
    names = list(dict.fromkeys([*first.parameters, *second.parameters]))
    for name in names:
        a, b = first.parameters.get(name), second.parameters.get(name)
        if a is None or b is None:
            known = a or b
            where = "second" if a is None else "first"
            unit = known.unit if known else ""
            value_a, value_b = (a.value if a else None), (b.value if b else None)
            rows.append(
                ParameterDifference(
                    name, unit, value_a, value_b, None, None, None, None, False, f"only the {where} model has {name}"
                )
            )
            continue
        difference = b.value - a.value
        if a.scatter is None or b.scatter is None or not (a.identifiable and b.identifiable):
            why = "not known in both"
            rows.append(ParameterDifference(name, a.unit, a.value, b.value, difference, None, None, None, False, why))
            continue
        std = math.hypot(a.scatter, b.scatter)
        z = difference / std if std > 0 else math.copysign(math.inf, difference) if difference else 0.0
        p = normal_beyond(z)
        rows.append(ParameterDifference(name, a.unit, a.value, b.value, difference, std, z, p, False, ""))
    tested = sorted((r for r in rows if r.p_value is not None), key=lambda r: r.p_value or 0.0)
    decided: dict[str, bool] = {}
    still = True
    for k, row in enumerate(tested):
        still = still and (row.p_value or 0.0) <= LEVEL / (len(tested) - k)
        decided[row.name] = still
    final = [_decide(r, decided.get(r.name)) for r in rows]
    return tuple(sorted(final, key=lambda r: (not r.differs, -(abs(r.z) if r.z is not None else -1.0))))


def _gain_at(nominal_v: float, model: ModelFile) -> dict[str, StoredParameter]:
    """K of a model at another nominal voltage, K (U / U_n)^alpha, with the uncertainty of alpha in its error; empty where it needs no
    change."""
    gain, exponent = model.parameters.get("K"), model.parameters.get("alpha")
    far = math.log(nominal_v / model.model.nominal_voltage_v)
    if gain is None or exponent is None or not far:
        return {}
    factor = math.exp(far * exponent.value)
    scatter = None
    if gain.scatter is not None and exponent.scatter is not None:
        scatter = factor * math.hypot(gain.scatter, gain.value * far * exponent.scatter)
    return {"K": replace(gain, value=gain.value * factor, scatter=scatter)}


def _decide(row: ParameterDifference, differs: bool | None) -> ParameterDifference:
    if differs is None or row.z is None:
        return row
    relative = f" ({100 * row.difference / row.first:+.1f} %)" if row.first and row.difference is not None else ""
    word = "differs" if differs else "does not differ beyond its error"
    sentence = f"{row.name} {word}{relative}, z = {row.z:+.1f}"
    return ParameterDifference(
        row.name, row.unit, row.first, row.second, row.difference, row.std, row.z, row.p_value, differs, sentence
    )
