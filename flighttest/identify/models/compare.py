"""Two models side by side: z-scores per parameter, which differ, in one table."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from flighttest.estimation.uncertainty.distributions import holm, normal_beyond
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
    difference: float | None = None
    std: float | None = None
    z: float | None = None
    p_value: float | None = None
    differs: bool = False
    sentence: str = ""


def compare(first: ModelFile, second: ModelFile) -> tuple[ParameterDifference, ...]:
    """Every parameter of either model; those that differ first, then by z. K of the second at the nominal voltage of the first."""
    second = replace(second, parameters={**second.parameters, **_gain_at(first.model.nominal_voltage_v, second)})
    names = dict.fromkeys([*first.parameters, *second.parameters])
    rows = [_compared(n, first.parameters.get(n), second.parameters.get(n)) for n in names]
    tested = {i: r.p_value for i, r in enumerate(rows) if r.p_value is not None}
    for i, differs in zip(tested, holm([*tested.values()], LEVEL), strict=True):
        rows[i] = _decided(rows[i], differs)
    return tuple(sorted(rows, key=lambda r: (not r.differs, -(abs(r.z) if r.z is not None else -1.0))))


def _compared(name: str, a: StoredParameter | None, b: StoredParameter | None) -> ParameterDifference:
    """A row that is not decided yet."""
    if a is None and b is not None:
        return ParameterDifference(name, b.unit, None, b.value, sentence=f"only the second model has {name}")
    assert a is not None
    if b is None:
        return ParameterDifference(name, a.unit, a.value, None, sentence=f"only the first model has {name}")
    row = ParameterDifference(name, a.unit, a.value, b.value, b.value - a.value)
    if a.scatter is None or b.scatter is None or not (a.identifiable and b.identifiable):
        return replace(row, sentence="not known in both")
    difference, std = b.value - a.value, math.hypot(a.scatter, b.scatter)
    z = difference / std if std > 0 else math.copysign(math.inf, difference) if difference else 0.0
    return replace(row, std=std, z=z, p_value=normal_beyond(z))


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


def _decided(row: ParameterDifference, differs: bool) -> ParameterDifference:
    relative = f" ({100 * row.difference / row.first:+.1f} %)" if row.first and row.difference is not None else ""
    word = "differs" if differs else "does not differ beyond its error"
    return replace(row, differs=differs, sentence=f"{row.name} {word}{relative}, z = {row.z:+.1f}")
