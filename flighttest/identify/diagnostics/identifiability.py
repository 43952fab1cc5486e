"""Identifiability: which parameters this data determines, which not (collinear sensitivities, bounds), and the maneuver that would."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.estimation.responses import never_changing, zero_order_hold
from flighttest.estimation.solver import Solution
from flighttest.estimation.uncertainty.covariance import Covariance, interval_factor, std_of
from flighttest.estimation.uncertainty.distributions import NORMAL_95
from flighttest.identify.diagnostics.heterogeneity import Heterogeneity
from flighttest.identify.diagnostics.local_optima import LocalOptimum
from flighttest.physics.blocks import VELOCITY
from flighttest.physics.core import Param
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

ALPHA_STD = 0.3
ALPHA_SHARE = 0.2
ALPHA_HOPELESS = 1.0  # with a standard error beyond this it is not determined: alpha is held, so that K is still found
HOPELESS_SHARE = 0.5  # of the value: a standard error beyond this leaves no digit
THROTTLE_STEP = 0.005  # of full throttle: less is no step
VOLTAGE_STD = 0.004  # of ln U, below which alpha is held from the beginning (0.1 V on 22 V)
WEAK_SHARE = 0.25
WEAK_DELAY_S = 0.01
CORRELATED = 0.98
FEWEST_RESPONSES = 3
FAR_SHARE = 0.05  # of K, by an assumed alpha
EXPLAINS_NOTHING = 0.05  # R2
MISSED_SHARE = 0.2  # of variance, neither explained nor noise: what is left is half as large as what the vehicle did

_FLY = {
    "omega_phi": "roll_pitch", "zeta_phi": "roll_pitch", "omega_theta": "roll_pitch", "zeta_theta": "roll_pitch",
    "sigma_r": "yaw_rate", "sigma_t": "thrust", "K": "thrust", "alpha": "thrust", "d_x": "roll_pitch", "d_y": "roll_pitch",
    "d_z": "thrust", "T_d_attitude": "roll_pitch", "T_d_yaw_rate": "yaw_rate", "T_d_thrust": "thrust", "T_d": "thrust",
}  # fmt: skip
_WHY_INSENSITIVE = {
    "alpha": "the battery voltage was not recorded or hardly varied; it was held, and K is the gain at the voltage flown",
    "d_z": "the vehicle did not move along its vertical axis while velocity was recorded",
    "d_x": "the vehicle did not move along its forward axis while velocity was recorded",
    "d_y": "the vehicle did not move along its left axis while velocity was recorded",
}


@dataclass(frozen=True)
class Known:
    """identifiable; why not, one sentence, empty where it is; fly: the maneuver script that would make it known."""

    identifiable: bool
    why: str = ""
    fly: str = ""


@dataclass(frozen=True)
class ParameterDiagnostics:
    """Evidence against a parameter beside its standard error.

    spread: how it differs between sizes of steps, where it does; bound: a parameter at its bound that it is collinear with; partner: the
    same with one that differs too much between sizes of steps; responses: how many hold information on it; explained: the lowest R2 of
    the channels it is read from; missed: of a lag or delay, the largest share of their variance that is neither explained nor noise;
    other_optimum: its value at another optimum with no significantly larger objective; closed_loop_bias: the part of its standard error
    that is for controls that reacted to disturbances.
    """

    spread: Heterogeneity | None = None
    bound: str | None = None
    partner: str | None = None
    responses: int = FEWEST_RESPONSES
    explained: float = 1.0
    missed: float = 0.0
    other_optimum: LocalOptimum | None = None
    closed_loop_bias: float = 0.0


def maneuver_for(param: Param, reveals: str) -> str:
    """The shipped script that excites a parameter."""
    return _FLY.get(param.name, reveals or "thrust")


@dataclass(frozen=True)
class Estimated:
    """One parameter as the solver left it. std: None where none was estimated; dof: degrees of freedom of its interval; partner: the
    parameter it is most correlated with."""

    value: float
    std: float | None
    dof: float = math.inf
    insensitive: bool = False
    at_bound: bool = False
    partner: tuple[str, float] | None = None


def judge(
    param: Param,
    found: Estimated,
    voltage_spread_v: float | None,
    reveals: str,
    diagnostics: ParameterDiagnostics | None = None,
) -> Known:
    """Verdict on one parameter. reveals: the maneuver that excites it, where its term names one."""
    diagnostics = diagnostics or ParameterDiagnostics()
    fly = maneuver_for(param, reveals)
    if why := _not_determined(param, found, diagnostics):
        return Known(False, why, fly)
    assert found.std is not None
    # More than half of the variance.
    steered = "; mostly because what flew the vehicle answered disturbances, as a pilot or a position loop does"
    steered = steered if diagnostics.closed_loop_bias > np.sqrt(0.5) * found.std else ""
    # Of the normal distribution with the same interval, which few degrees of freedom widen.
    normal_std = found.std * interval_factor(found.dof) / NORMAL_95
    if wide := _too_wide(param, found.value, normal_std, voltage_spread_v):
        partner = found.partner if param.name != "alpha" else None
        with_whom = (
            f"; it is nearly collinear with {partner[0]} here" if partner and abs(partner[1]) > CORRELATED else ""
        )
        return Known(False, f"its 95 % interval is that of a standard error of {wide}{with_whom}{steered}", fly)
    return Known(True)


def _not_determined(param: Param, found: Estimated, diagnostics: ParameterDiagnostics) -> str:
    """Why an estimate, whatever its standard error, is not this parameter's value; empty where it is."""
    value = found.value
    if found.insensitive:
        return _WHY_INSENSITIVE.get(param.name, f"nothing in this data depends on {param.name}")
    if found.at_bound:
        return f"the estimate is at its bound {value:g}{'' if param.unit == '1' else f' {param.unit}'}"
    if found.std is None:
        return "no error could be estimated for it"
    if diagnostics.explained < EXPLAINS_NOTHING:
        return "the model describes these responses no better than their mean does"
    if diagnostics.missed > MISSED_SHARE:
        missed = f"{100 * diagnostics.missed:.0f} % of how the vehicle moved is neither explained nor noise"
        return f"{missed}; `flighttest diagnose` looks for what is behind it"
    if few := too_few_responses(diagnostics.responses):
        return few
    if diagnostics.bound is not None:
        return f"{diagnostics.bound} is at its bound, and the two cannot be distinguished here"
    if diagnostics.other_optimum is not None:
        return diagnostics.other_optimum.sentence(param.unit)
    if diagnostics.spread is not None and diagnostics.spread.width > allowance(param, value):
        return f"{diagnostics.spread.sentence(param.unit)}; `flighttest diagnose` looks for what is behind it"
    if diagnostics.partner is not None:
        return f"{diagnostics.partner} differs between sizes of steps, and the two cannot be distinguished here"
    return ""


def too_few_responses(responses: int) -> str:
    """Why so many responses with information on a parameter do not make it known; empty where they are enough."""
    if responses >= FEWEST_RESPONSES:
        return ""
    few = "one response holds information" if responses == 1 else f"{responses} responses hold information"
    return f"only {few} on it: without repeats its error is not known"


def _too_wide(param: Param, value: float, std: float, voltage_spread_v: float | None) -> str:
    """A standard error that is too large for the parameter to be called known, in words; empty where it is not."""
    if param.name == "alpha":
        # Near zero (a battery-compensated autopilot) a share of the value means nothing: a tight absolute bound takes its place.
        share = std / abs(value) if value else float("inf")
        if std < ALPHA_STD and (share < ALPHA_SHARE or std < 0.05):
            return ""
        spread = (
            "" if voltage_spread_v is None else f"; at equal throttle the voltage spread over {voltage_spread_v:.1f} V"
        )
        return f"{std:.2f} (needed: below {ALPHA_STD} and 20 %){spread}"
    if std < allowance(param, value):
        return ""
    if param.unit == "s" and param.name.startswith("T_d"):
        return f"{1e3 * std:.0f} ms (needed: below {1e3 * WEAK_DELAY_S:.0f} ms)"
    return f"{std:{'.2g' if std < 100 else '.0f'}}{'' if param.unit == '1' else f' {param.unit}'} on a value of {value:.3g}"


def correlated_parameters(covariance: Covariance, above: float) -> tuple[tuple[str, str, float], ...]:
    """Pairs of parameters whose estimates are correlated by `above` or more in absolute value, with the correlation; largest first."""
    matrix, names = covariance.matrix, covariance.names
    std = np.sqrt(np.diag(matrix))
    strong = []
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            c = float(matrix[i, j] / (std[i] * std[j])) if std[i] > 0 and std[j] > 0 else 0.0
            if abs(c) >= above:
                strong.append((names[i], names[j], c))
    return tuple(sorted(strong, key=lambda s: -abs(s[2])))


def allowance(param: Param, value: float) -> float:
    """How wide a parameter may be and still be called known."""
    if param.name == "alpha":
        return ALPHA_STD
    if param.unit == "s" and param.name.startswith("T_d"):
        return WEAK_DELAY_S
    return max(WEAK_SHARE * abs(value), 0.0 if param.lower > 0 else 0.25 * param.scale)


def voltage_varies(segments: Sequence[Segment], nominal_voltage_v: float) -> bool:
    """Whether voltage was recorded and varies enough for alpha to be worth estimating."""
    means = [float(np.nanmean(u)) for s in segments if np.isfinite(u := s.y.get("voltage_v", np.full(1, np.nan))).any()]
    inside = [float(np.nanstd(s.y["voltage_v"])) for s in segments if np.isfinite(s.y.get("voltage_v", np.nan)).any()]
    if not means or min(means) <= 0:
        return False
    spread = float(np.hypot(np.std(means), np.mean(inside)))
    return spread / nominal_voltage_v > VOLTAGE_STD


def drag_without_velocity(segments: Sequence[Segment]) -> tuple[str, ...]:
    """Drag coefficients along axes whose velocity was not recorded; forward and left take both horizontal velocities."""
    recorded = {n for s in segments for n in VELOCITY if np.isfinite(s.y.get(n, np.nan)).any()}
    north, west, up = (n in recorded for n in VELOCITY)
    return (*(() if north and west else ("d_x", "d_y")), *(() if up else ("d_z",)))


def assumed_share(segments: Sequence[Segment], model: Model) -> float:
    """Share of K by which it is unsure where alpha is assumed: K holds at the nominal voltage, which may not be the one flown."""
    if "alpha" not in model.param:
        return 0.0
    return abs(math.log(flown_voltage(segments, model) / model.nominal_voltage_v)) * model.param["alpha"].scale


def flown_voltage(segments: Sequence[Segment], model: Model) -> float:
    """Middle of the battery voltage over the segments, V; the nominal one where none was recorded."""
    means = [float(np.nanmean(u)) for s in segments if np.isfinite(u := s.y.get("voltage_v", np.full(1, np.nan))).any()]
    means = [m for m in means if m > 0]
    return math.exp(float(np.mean(np.log(means)))) if means else model.nominal_voltage_v


def voltage_notes(segments: Sequence[Segment], model: Model, still: bool) -> list[str]:
    """What is uncertain because alpha was assumed. still: whether the voltage was recorded with one and the same value."""
    notes = [f"{never_changing(['voltage_v'])}: alpha cannot be determined from it"] if still else []
    if assumed_share(segments, model) > FAR_SHARE:
        notes.append(
            f"K is carried to {model.nominal_voltage_v:g} V by an assumed alpha from the {flown_voltage(segments, model):.1f} V flown: "
            "a vehicle.yaml with the battery's nominal voltage (--vehicle) states it where it is known"
        )
    return notes


def throttle_varies(segments: Sequence[Segment]) -> bool:
    """Whether any segment moves its throttle: without that, nothing determines the thrust lag or its delay."""
    return any(
        "throttle" in s.u and float(np.ptp(zero_order_hold(s.u["throttle"], s.t_s))) > THROTTLE_STEP for s in segments
    )


def voltage_spread_at_equal_throttle(segments: Sequence[Segment]) -> float | None:
    """Spread (5 to 95 %) of battery voltage about its mean at equal throttle, V; None without voltage or throttle."""
    throttle: list[float] = []
    voltage: list[float] = []
    for s in segments:
        u = s.y.get("voltage_v")
        if u is None or "throttle" not in s.u or not np.isfinite(u).any():
            continue
        level = np.round(zero_order_hold(s.u["throttle"], s.t_s), 2)
        for value in np.unique(level):
            some = (level == value) & np.isfinite(u)
            if some.sum() >= 3:
                throttle.append(float(value))
                voltage.append(float(np.mean(u[some])))
    if not throttle:
        return None
    levels, u_all = np.array(throttle), np.array(voltage)
    off = [u_all[levels == v] - u_all[levels == v].mean() for v in np.unique(levels) if (levels == v).sum() > 1]
    if not off:
        return 0.0
    low, high = np.percentile(np.concatenate(off), [5, 95])
    return float(high - low)


def hopeless(solution: Solution, covariance: Covariance) -> tuple[str, ...]:
    """Parameters to hold at their start, so that the others are still found.

    alpha where it cannot be distinguished from K: K is then the gain at the voltage flown. Where the solver did not end well, whatever it
    has no more than a hint of: such directions are flat, and it wanders along them.
    """
    names = covariance.names
    lost = {"alpha"} if "alpha" in names and std_of(covariance, "alpha") >= ALPHA_HOPELESS else set()
    if not solution.status.good:
        lost |= {n for n in names if std_of(covariance, n) > HOPELESS_SHARE * abs(solution.values[n])}
    return tuple(n for n in names if n in lost)
