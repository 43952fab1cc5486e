"""Propulsion beyond a linear gain with one lag: throttle curve, motors, propellers, speed controllers, battery (voltage sag)."""

from __future__ import annotations

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, State, Term, Values

# Below this throttle the gain is taken as at it: a factor on the command cannot be defined at zero.
_SMALL_THROTTLE = 0.004
# Thrust at which square roots are rounded off, m/s^2.
_SMALL_THRUST = 0.01


def _throttle(s: Signals) -> Expr:
    return ca.fmax(s.throttle, _SMALL_THROTTLE)


def _root(a: Expr) -> Expr:
    """sqrt(a) for a > 0, smooth and above zero everywhere."""
    return ca.sqrt(0.5 * (a + ca.sqrt(a**2 + _SMALL_THRUST**2)) + _SMALL_THRUST)


LOAD_POWER = 1.5  # current over thrust: it follows the power of the rotors (momentum theory)
LEAST_VOLTAGE = 0.05  # of the logged one, that acts where a trial value of the sag is more than there is


def _curve(s: Signals, p: Values, _x: Values) -> Contribution:
    return Contribution(1 + p["curvature"] * (s.throttle * s.base["K"] / s.g - 1))


throttle_curve = Term(
    id="throttle_curve",
    title="Curved throttle",
    family="propulsion",
    port=Port.MOTOR_GAIN,
    params=(
        Param(
            "curvature", "c", "1", 0.5, -0.4, 1.5, 0.1, "0: thrust proportional to throttle; 1: to its square, same at hover",
            "thrust stands: exponent 1.0 (linearised) to 1.9 (raw); MOT_THST_EXPO 0.65",
        ),
    ),
    build=_curve,
    equation="gain = 1 + c (T K / g - 1)",
    plain="static thrust is not proportional to throttle: doubling the throttle does not double the thrust",
    source="ArduPilot MOT_THST_EXPO; thrust stand data of aerostack2/thrust_map_estimation",
    doubt="one curvature for the whole range; the static part of a sagging battery looks the same",
    hides_in=("K", "alpha"),
    told_apart_by="many throttle levels",
    reveals="thrust",
    needs=("throttle",),
)  # fmt: skip


def _offset(s: Signals, p: Values, _x: Values) -> Contribution:
    t = _throttle(s)
    return Contribution(ca.fmax(1 - p["T_min"] / t, 0))


throttle_offset = Term(
    id="throttle_offset",
    title="Throttle offset",
    family="propulsion",
    port=Port.MOTOR_GAIN,
    params=(
        Param(
            "T_min", "T_min", "1", 0.02, -0.15, 0.15, 0.01, "throttle at which thrust begins; below zero the motors push at zero throttle",
            "MOT_SPIN_MIN, dead bands of speed controllers: -0.05 to 0.05",
        ),
    ),
    build=_offset,
    equation="T <- max(T - T_min, 0)",
    plain="thrust does not begin at zero throttle: the speed controllers have a dead band, or the motors idle above zero",
    source="ArduPilot MOT_SPIN_MIN; dead band of speed controllers",
    doubt="mixers that keep attitude authority at low throttle have the same effect",
    hides_in=("K",),
    told_apart_by="low throttles",
    reveals="thrust",
    needs=("throttle",),
)  # fmt: skip


def _saturation(s: Signals, p: Values, _x: Values) -> Contribution:
    ratio = _throttle(s) / p["T_max"]
    return Contribution((1 + ratio**16) ** (-1 / 16))


motor_saturation = Term(
    id="motor_saturation",
    title="Motor saturation",
    family="propulsion",
    port=Port.MOTOR_GAIN,
    params=(
        Param(
            "T_max", "T_max", "1", 0.8, 0.02, 1.2, 0.05, "throttle above which there is no more thrust",
            "MOT_SPIN_MAX, current limits", "shape", None, (0.25, 0.35, 0.5, 0.7, 0.9), limits="throttle",
        ),
    ),
    build=_saturation,
    equation="T <- min(T, T_max), smooth",
    plain="above some throttle the motors give no more thrust",
    source="ArduPilot MOT_SPIN_MAX; current limits of speed controllers",
    doubt="the real corner is sharp where a limit causes it, soft where the battery does",
    hides_in=("K", "alpha"),
    told_apart_by="high throttle",
    reveals="thrust",
    needs=("throttle",),
)  # fmt: skip


def _asymmetry(s: Signals, p: Values, _x: Values) -> Contribution:
    direction = ca.tanh((s.command - s.a_t) / 0.3)
    return Contribution(s.a_t_dot * ca.exp(0.5 * p["ln_sigma_ratio"] * direction))


thrust_asymmetry = Term(
    id="thrust_asymmetry",
    title="Spin-up and spin-down differ",
    family="propulsion",
    port=Port.THRUST_LAG,
    params=(
        Param(
            "ln_sigma_ratio", "ln(σ_up/σ_down)", "1", 0.4, -2.5, 2.5, 0.2, "logarithm of the ratio of the two decay constants",
            "speed controllers without active braking: 0.2 to 0.8",
        ),
    ),
    build=_asymmetry,
    equation="a_t_dot <- a_t_dot exp(+-ln(sigma_up/sigma_down) / 2), + when thrust rises",
    plain="motors speed up faster than they slow down, since the current drives them and only the air brakes them",
    source="Faessler, Falanga, Scaramuzza, RA-L 2017; speed controllers without damped light",
    doubt="one ratio for all step sizes",
    hides_in=("sigma_t",),
    told_apart_by="steps both ways",
    reveals="thrust",
    needs=("throttle",),
)  # fmt: skip


def _rotor_lag(s: Signals, p: Values, _x: Values) -> Contribution:
    now, wanted = _root(s.a_t), _root(s.command)
    return Contribution(s.a_t_dot * (1 + p["rotor_lag"] * (2 * now / (wanted + now) - 1)))


rotor_speed_lag = Term(
    id="rotor_speed_lag",
    title="Lag acts on rotor speed",
    family="propulsion",
    port=Port.THRUST_LAG,
    params=(
        Param(
            "rotor_lag", "b", "1", 1.0, -1.0, 2.0, 0.2, "0: the lag acts on thrust (paper); 1: on rotor speed, whose square is thrust",
            "first-order motor with thrust proportional to squared speed: 1", one_sided=True),
    ),
    build=_rotor_lag,
    equation="a_t_dot <- a_t_dot (1 - b + b 2 sqrt(a_t) / (sqrt(a_t) + sqrt(a_cmd)))",
    plain="the motors' speed lags and thrust is its square: large steps up start slowly, large steps down end slowly",
    source="d/dt of a_t = c w^2 with w_dot = sigma (w_cmd - w)",
    doubt="speed controllers with their own speed loop are faster for small steps",
    hides_in=("sigma_t", "thrust_asymmetry"),
    told_apart_by="steps of several sizes both ways",
    reveals="thrust",
    needs=("throttle",),
)  # fmt: skip


def _extra_lag(s: Signals, p: Values, x: Values) -> Contribution:
    behind = x["a_t_behind_m_s2"]
    return Contribution(ca.vertcat(0, 0, -behind), {"a_t_behind_m_s2": s.a_t_dot - behind / p["thrust_extra_tau"]})


thrust_extra_lag = Term(
    id="thrust_extra_lag",
    title="A second lag in thrust",
    family="propulsion",
    port=Port.FORCE,
    params=(
        Param(
            "thrust_extra_tau", "τ_2", "s", 0.02, 0.008, 0.4, 0.01, "time constant of the second pole",
            "speed controller filters, throttle filters (PILOT_THR_FILT): 0.005 to 0.05", "shape", None, (0.01, 0.02, 0.05),
        ),
    ),
    build=_extra_lag,
    equation="a_t,acting = a_t - z, z_dot = a_t_dot - z / tau_2",
    plain="a filter in the speed controller or the autopilot delays thrust further, beyond the motors' own lag",
    source="PILOT_THR_FILT; input filters of speed controllers",
    doubt="close to a longer thrust delay (cosine 0.90 after the base refit)",
    hides_in=("T_d", "sigma_t"),
    told_apart_by="shape of the first 100 ms",
    reveals="thrust",
    needs=("throttle",),
    states=(State("a_t_behind_m_s2", "m/s^2", "how much the acting thrust is behind the motors' thrust"),),
)  # fmt: skip


def _fade(s: Signals, p: Values, _x: Values) -> Contribution:
    return Contribution(1 - p["fade_depth"] * (1 - ca.exp(-s.time_s / p["fade_tau"])))


thrust_fade = Term(
    id="thrust_fade",
    title="Thrust fades with time",
    family="propulsion",
    port=Port.MOTOR_GAIN,
    params=(
        Param(
            "fade_depth", "s_f", "1", 0.05, -0.4, 0.6, 0.03, "share of the gain lost in the end",
            "motor heat: 0.02 to 0.1", one_sided=True),
        Param(
            "fade_tau", "τ_f", "s", 150.0, 15.0, 2000.0, 50.0, "time constant since take-off",
            "thermal time constants of motors: 60 to 300 s", "shape", None, (40.0, 120.0, 400.0), natural_bound="upper",
        ),
    ),
    build=_fade,
    equation="gain = 1 - s_f (1 - exp(-t / tau_f)), t since take-off",
    plain="thrust falls with time in the air at the same voltage, as motors and magnets grow hot",
    source="temperature dependence of winding resistance and magnets",
    doubt="happens together with the battery's discharge: distinguish them by two packs, or by the pack's order reversed",
    hides_in=("alpha", "K"),
    told_apart_by="same step early and late at one voltage: two packs, or the pack's order reversed",
    reveals="thrust",
    needs=("throttle", "voltage_v", "time_since_takeoff_s"),
)  # fmt: skip


def _sag(s: Signals, p: Values, x: Values) -> Contribution:
    fresh = x["load_fresh"]
    gain = s.base["K"]
    # The derivative of the load, (a_t / K)^LOAD_POWER.
    slope = LOAD_POWER * ca.fmax(s.a_t / gain, 1e-4) ** (LOAD_POWER - 1)
    # Until the logged voltage has come through the motors' lag, where the body's equation has it.
    lasts = p["sag_tau"] + 1 / s.base["sigma_t"]
    share = ca.fmax(1 - p["sag_v"] * fresh / s.voltage, LEAST_VOLTAGE)
    return Contribution(share ** s.base["alpha"], {"load_fresh": slope * s.a_t_dot / gain - fresh / lasts})


voltage_sag = Term(
    id="voltage_sag",
    title="Voltage that acts differs from the voltage logged",
    family="propulsion",
    port=Port.AERO_GAIN,
    params=(
        Param(
            "sag_v", "ΔU", "V", 2.0, -12.0, 25.0, 1.0, "voltage lost at full throttle before the log shows it",
            "internal resistance of a 6S pack: 1 to 4 V at full current", one_sided=True),
        Param(
            "sag_tau", "τ_U", "s", 0.6, 0.05, 8.0, 0.2, "time the logged voltage takes to follow",
            "filters of battery monitors, battery polarisation: 0.2 to 5 s", "shape", None, (0.25, 0.6, 1.5), natural_bound="lower",
        ),
    ),
    build=_sag,
    equation="a_t <- a_t (1 - dU x / U_logged)^alpha, x_dot = d/dt (a_t / K)^(3/2) - x / (tau_U + 1/sigma_t)",
    plain="the voltage at the motors drops with the load before the logged voltage shows it",
    source="equivalent circuit of a battery behind a filtered monitor; motors draw the current while they still accelerate, so that the "
    "drop is there as soon as the thrust is, and not a motor lag behind it",
    doubt="its static part is the same as a curved throttle (cosine 0.999); only its dynamics is in this term. Where motors are slower "
    "than 80 1/s and follow their circuit (torque by current), their time constant and the sag's are not separated by it",
    hides_in=("alpha", "sigma_t"),
    told_apart_by="long steps",
    reveals="thrust",
    needs=("throttle", "voltage_v"),
    states=(State("load_fresh", "1", "load the logged voltage has not seen yet, as a share of full throttle"),),
)  # fmt: skip
