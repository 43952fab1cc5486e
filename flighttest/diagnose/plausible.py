"""What an estimate must be like to be what its term's name says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.chance import standard_errors
from flighttest.diagnose.rows import Rows
from flighttest.estimation.responses import zero_order_hold as held
from flighttest.physics.core import Param, Term
from flighttest.physics.model import Model
from flighttest.segments import Segment

LEAST_SIZE = 4.0  # standard errors
LEAST_SHARE = 0.2  # of the usual size
WEAK_BIC = -50.0  # above it, a fall of the criterion alone is not believed


def is_amplitude(term: str, name: str, model: Model) -> bool:
    """Whether a parameter is one of a term's amplitudes."""
    return model.term_of(name) == term and model.param[name].kind == "amplitude"


def wrong_side(param: Param, value: float) -> bool:
    """On the side of off that physics does not allow."""
    return param.one_sided and param.off is not None and (value - param.off) * (param.nominal - param.off) < 0


def impossible(
    term: str, model: Model, names: Sequence[str], values: Mapping[str, float], std: NDArray[np.float64]
) -> str:
    """Why the estimates of a term cannot be what its name says; '' when they can. names, std: of what was estimated."""
    own = [n for n in names if is_amplitude(term, n, model)]
    if own and not any(model.param[n].alone for n in own):
        return f"{', '.join(own)} alone, without the rest of its term, is not this effect: it imitates another"
    single = len(own) == 1
    for name, error in zip(names, std, strict=True):
        p = model.param[name]
        if model.term_of(name) != term:
            continue
        value = values[name]
        # Where the usual value is the bound, as of a pure pole, to be there is to be usual.
        at_bound = (value <= p.lower or value >= p.upper) and value != p.nominal
        if at_bound and (p.kind == "amplitude" or len(p.screen) > 1):
            return f"{name} runs to its bound, {value:.3g} {p.unit}: it stands in for something else"
        if p.off is None or not wrong_side(p, value):
            continue
        # Of several amplitudes one may be near off and on the wrong side by chance; a term that has but one claims that side.
        allowed = error if single else 3 * error + 0.1 * abs(p.nominal - p.off)
        if abs(value - p.off) > allowed:
            return f"{name} comes out as {value:.3g} {p.unit}, which physics does not allow: it stands in for something else"
    return ""


def never_reached(term: Term, values: Mapping[str, float], segments: Sequence[Segment]) -> str:
    """Why a limit cannot be one, since nothing in the flights went beyond it; '' when something did.

    Limits are soft in the model, and below one the soft corner copies any other bend.
    """
    for p in term.params:
        if not p.limits:
            continue
        most = max((_most(p.limits, values, segment) for segment in segments), default=0.0)
        if most < values[p.name]:
            return f"{p.name} is {values[p.name]:.3g} {p.unit}, and no more than {most:.3g} was flown: it stands in for something else"
    return ""


def _most(what: str, values: Mapping[str, float], segment: Segment) -> float:
    """Most of a limited signal in one response: of throttle, or of the rate (rad/s) that angle loops ask for with these parameters."""
    if what == "throttle":
        return float(np.max(held(segment.u.get("throttle"), segment.t_s)))
    asked = [0.0]
    for axis, greek in (("roll", "phi"), ("pitch", "theta")):
        angle = segment.y.get(f"{axis}_rad")
        if angle is not None and f"omega_{greek}" in values:
            error = np.nanmax(np.abs(held(segment.u.get(f"{axis}_ref_rad"), segment.t_s) - angle), initial=0.0)
            asked.append(values[f"omega_{greek}"] / (2.0 * values[f"zeta_{greek}"]) * float(error))
    return max(asked)


def does_not_stand_out(
    term: Term, model: Model, names: Sequence[str], values: Mapping[str, float], rows: Rows, bic: float
) -> str:
    """Why a term's size is too small to be believed; '' when it stands out from its error (clustered by response, at the shapes found).

    Asked where the criterion falls but little, and of terms whose start states are free in every response: a pendulum of no weight that
    may begin anywhere fits a slow wander of the velocity, so that its size has to be a size at all. bic: change of the criterion.
    """
    free = any(s.free for s in term.states)
    own = [n for n in names if is_amplitude(term.id, n, model)]
    if not own or not (free or bic > WEAK_BIC):
        return ""
    asked = tuple(n for n in names if n in own or model.term_of(n) != term.id)
    std = dict(zip(asked, standard_errors(rows, asked), strict=True))
    for name in own:
        p = model.param[name]
        size, usual = (abs(x - float(p.off or 0.0)) for x in (values[name], p.nominal))
        if size >= max(LEAST_SIZE * float(std[name]), LEAST_SHARE * usual if free else 0.0):
            return ""
    least = f" and {LEAST_SHARE:.0%} of usual, since its start states are free" if free else ""
    return f"its size does not stand out: {LEAST_SIZE:g} standard errors are asked for{least}"
