"""Whether the estimates of a term can be what its name means: inside their bounds, of the sign that physics allows, reached in flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.diagnose.selection.candidates import null_value, usual_size
from flighttest.estimation.responses import zero_order_hold
from flighttest.estimation.uncertainty.distributions import NORMAL_95
from flighttest.physics.core import Param, Term
from flighttest.segments import Segment


@dataclass(frozen=True)
class EstimatedModel:
    """A model's parameters. names: those that were estimated; values: of all; errors: gives their standard errors, asked for only where
    they decide; segments: that they were estimated from."""

    names: Sequence[str]
    values: Mapping[str, float]
    errors: Callable[[], Mapping[str, float]]
    segments: Sequence[Segment]

    def half_interval(self, p: Param) -> float:
        """Half an estimate's 95 % interval."""
        return NORMAL_95 * self.errors()[p.name]


def outside_prior(term: Term, found: EstimatedModel, least: float, *, repeated: bool = False) -> str:
    """Why the estimates of a term are outside its prior: at a bound (where steps were repeated, not at its `natural_bound`; else
    also within their error of a lower one: a time constant that is not distinguished from none has not been seen), on the side
    of the null value that physics does not allow, a limit that nothing in the flights surely reached. Empty where they are inside.

    least: standard errors from nothing, at which a coefficient is there by itself.
    """
    own = [p for p in term.params if p.name in found.names]
    coefficients = [p for p in own if p.kind == "amplitude"]
    if any(not p.alone for p in coefficients):
        # Some coefficients (an upward wind) are this effect only beside the others of their term, which must then be there by themselves.
        errors = found.errors()
        if not any(
            p.alone and abs(found.values[p.name] - null_value(p)) > least * errors[p.name] for p in coefficients
        ):
            return f"{', '.join(p.name for p in coefficients if not p.alone)} alone, without the rest of the term, is another effect"
    for p in own:
        value = found.values[p.name]
        bound = "lower" if value <= p.lower else "upper" if value >= p.upper else ""
        # Where the bound is a usual value, as of a pure pole or of a share that is all or nothing, to be there is usual.
        at_bound = bound not in ("", p.natural_bound if repeated else "") and value not in (p.nominal, *p.screen)
        # A coefficient whose place shapes may take runs to its bound though data hardly prefer it there.
        if at_bound and (len(p.screen) > 1 or (p.kind == "amplitude" and _known(p, found))):
            return f"{p.name} is at its bound, {value:.3g}{unit_suffix(p)}"
        if p.natural_bound == "lower" and not repeated and value - p.lower <= (error := found.half_interval(p)):
            return f"{p.name} is {value:.3g} +- {error:.2g}{unit_suffix(p)}, which may be its bound, {p.lower:.3g}{unit_suffix(p)}"
        # One of several may be there by chance.
        if _wrong(p, value) and (len(coefficients) == 1 or surely_not_allowed(p, found)):
            return f"{p.name} is {value:.3g}{unit_suffix(p)}, which physics does not allow"
        if p.limits:
            most = max((_most(p.limits, found.values, s) for s in found.segments), default=0.0)
            if most < value:
                return f"{p.name} is {value:.3g}{unit_suffix(p)}, and no more than {most:.3g} was flown"
            # A limit that may be what was flown at most may be none.
            if most < value + (error := found.half_interval(p)):
                return f"{p.name} is {value:.3g} +- {error:.2g}{unit_suffix(p)}, and no more than {most:.3g} was flown"
        if p.limits == "throttle" and value < (half := _median_throttle(found.segments)):
            return f"{p.name} is {value:.3g}{unit_suffix(p)}, and half of the flight is above {half:.3g}: no height is held beyond a limit"
    return ""


def unit_suffix(p: Param) -> str:
    """The unit behind a value, nothing where it has none."""
    return "" if p.unit == "1" else f" {p.unit}"


def _known(p: Param, found: EstimatedModel) -> bool:
    """Whether data separate an estimate from the coefficient's usual value."""
    return abs(found.values[p.name] - p.nominal) > found.half_interval(p)


def surely_not_allowed(p: Param, found: EstimatedModel) -> bool:
    """Whether the 95 % interval of a coefficient is on the side of its null value that physics does not allow."""
    value = found.values[p.name]
    return _wrong(p, value) and abs(value - null_value(p)) > found.half_interval(p)


def not_allowed_beside_others(own: Sequence[Param], found: EstimatedModel) -> list[Param]:
    """Coefficients of a term (`surely_not_allowed`) beside one that physics does allow: what drove them there is not their effect, and
    the term is judged by the rest. None where all are."""
    wrong = [p for p in own if surely_not_allowed(p, found)]
    return wrong if len(wrong) < len(own) else []


def _wrong(p: Param, value: float) -> bool:
    return p.one_sided and p.off is not None and (value - null_value(p)) * usual_size(p) < 0.0


def _most(what: str, values: Mapping[str, float], segment: Segment) -> float:
    """Most of a limited signal in one response: of throttle, or of the rate (rad/s) that angle loops ask for with these parameters."""
    if what == "throttle":
        return float(np.max(zero_order_hold(segment.u.get("throttle"), segment.t_s)))
    asked = [0.0]
    for axis, greek in (("roll", "phi"), ("pitch", "theta")):
        angle = segment.y.get(f"{axis}_rad")
        if angle is not None and f"omega_{greek}" in values:
            error = np.nanmax(
                np.abs(zero_order_hold(segment.u.get(f"{axis}_ref_rad"), segment.t_s) - angle), initial=0.0
            )
            asked.append(values[f"omega_{greek}"] / (2.0 * values[f"zeta_{greek}"]) * float(error))
    return max(asked)


def _median_throttle(segments: Sequence[Segment]) -> float:
    """Of all samples."""
    flown = [zero_order_hold(s.u["throttle"], s.t_s) for s in segments if "throttle" in s.u]
    return float(np.median(np.concatenate(flown))) if flown else 0.0
