"""What becomes of a reference before loops of second order follow it: this is no physics of the vehicle."""

from __future__ import annotations

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, State, Term, Values

# How fast a shaped target's rate catches up with the wanted one where its acceleration allows, s: the autopilot does it in one cycle,
# the integration steps of a fit are longer.
_CATCH_UP_S = 0.015


def _axes(s: Signals) -> tuple[tuple[str, str, Expr, Expr, Expr], ...]:
    """Name, index of its parameters, reference, angle and rate of roll and of pitch."""
    return (
        ("roll", "phi", s.roll_ref, s.roll, s.roll_rate),
        ("pitch", "theta", s.pitch_ref, s.pitch, s.pitch_rate),
    )


def _within(x: Expr, limit: Expr) -> Expr:
    """x limited to +-limit."""
    return ca.fmin(ca.fmax(x, -limit), limit)


def _square_root(error: Expr, p: Expr, acceleration: Expr) -> tuple[Expr, Expr]:
    """ArduPilot's sqrt_controller: proportional near zero, constant deceleration beyond `acceleration / p^2`; and its slope."""
    linear = acceleration / p**2
    size = ca.fabs(error)
    far = ca.sqrt(2 * acceleration * ca.fmax(size - linear / 2, linear / 2))
    return ca.if_else(size > linear, ca.sign(error) * far, p * error), ca.if_else(size > linear, acceleration / far, p)


def _shaping(s: Signals, p: Values, x: Values) -> Contribution:
    acceleration, tc = p["shaping_accel"], p["shaping_tc"]
    rates: dict[str, Expr] = {}
    targets: dict[str, Expr] = {}
    for axis, greek, reference, angle, rate in _axes(s):
        target = angle + x[f"{axis}_target_ahead_rad"]
        target_rate = x[f"{axis}_target_rate_rad_s"]
        wanted, slope = _square_root(reference - target, 1 / tc, acceleration)
        rates[f"{axis}_target_ahead_rad"] = target_rate - rate
        # The wanted rate falls on the way to the target; without its slope the target would brake late and run past.
        asked = (wanted - target_rate) / _CATCH_UP_S - slope * target_rate
        rates[f"{axis}_target_rate_rad_s"] = _within(asked, acceleration)
        # What the rate loop is given beforehand: the second order then follows the target's angle and rate.
        ahead = 2 * s.base[f"zeta_{greek}"] / s.base[f"omega_{greek}"] * target_rate
        targets |= {f"target_{axis}": target, f"{axis}_ref": target + p["shaping_ff"] * ahead}
    return Contribution(targets, rates)


reference_shaping = Term(
    id="reference_shaping",
    title="Reference shaping",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        Param(
            "shaping_accel", "a_s", "rad/s^2", 19.2, 0.5, 400.0, 5.0, "greatest angular acceleration of the shaped target",
            "ATC_ACC_R_MAX, 1100 deg/s^2 by default", "shape", None, (5.0, 10.0, 19.2, 40.0),
        ),
        Param(
            "shaping_tc", "t_c", "s", 0.15, 0.02, 0.6, 0.03, "time constant of the shaping near the target",
            "ATC_INPUT_TC, 0.15 s by default", "shape", None, (0.08, 0.15, 0.3), natural_bound="lower",
        ),
        Param(
            "shaping_ff", "k_ff", "1", 1.0, -0.2, 1.5, 0.2, "share of the target's rate that the rate loop is given beforehand",
            "ATC_RATE_FF_ENAB: 1", "shape", None, (0.0, 1.0),
        ),
    ),
    build=_shaping,
    equation="target rate -> sqrt_controller(phi_r - target, 1 / t_c, a_s), |target acceleration| <= a_s; "
    "phi_r <- target + k_ff (2 zeta / w) target rate",
    plain="the autopilot smooths the reference before it follows it: responses to large and to small steps differ in shape; this is "
    "no physics of the vehicle",
    source="ArduPilot AC_AttitudeControl::input_shaping_angle, sqrt_controller",
    doubt="the rate catches up over 15 ms instead of one cycle; the target starts where the vehicle is",
    hides_in=("omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "T_d"),
    told_apart_by="two amplitudes",
    reveals="roll_pitch",
    needs=("roll_ref_rad", "roll_rad"),
    states=(
        State("roll_target_ahead_rad", "rad", "shaped roll target ahead of roll"),
        State("roll_target_rate_rad_s", "rad/s", "rate of the shaped roll target"),
        State("pitch_target_ahead_rad", "rad", "shaped pitch target ahead of pitch"),
        State("pitch_target_rate_rad_s", "rad/s", "rate of the shaped pitch target"),
    ),
)  # fmt: skip


def _yaw_shaping(s: Signals, p: Values, x: Values) -> Contribution:
    ahead, gap, error = x["yaw_rate_target_ahead_rad_s"], x["yaw_target_ahead_rad"], x["yaw_rate_error_rad_s"]
    target = s.yaw_rate + ahead
    target_dot = _within((s.yaw_rate_ref - target) / _CATCH_UP_S, p["shaping_yaw_accel"])
    asked = ahead + p["shaping_yaw_hold"] * gap
    return Contribution(
        {"yaw_rate_ref": s.yaw_rate + error},  # yaw_rate_dot = sigma_r error
        {
            "yaw_rate_target_ahead_rad_s": target_dot - s.base["sigma_r"] * error,
            "yaw_target_ahead_rad": ahead,
            "yaw_rate_error_rad_s": (asked - error) / p["shaping_yaw_lag"],
        },
    )


yaw_rate_shaping = Term(
    id="yaw_rate_shaping",
    title="Yaw rate shaping",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        Param(
            "shaping_yaw_accel", "a_r", "rad/s^2", 4.7, 0.2, 200.0, 2.0, "greatest acceleration of the yaw rate target",
            "ATC_ACC_Y_MAX, 270 deg/s^2 by default", "shape", None, (2.0, 4.7, 10.0, 20.0),
        ),
        Param(
            "shaping_yaw_hold", "k_r", "1/s", 4.5, -1.0, 12.0, 1.0, "yaw rate asked for per heading behind that of the target",
            "ATC_ANG_YAW_P, 4.5 by default; 0: no heading is held", "shape", None, (0.0, 4.5),
        ),
        Param(
            "shaping_yaw_lag", "τ_r", "s", 0.02, 0.012, 0.2, 0.01, "time constant of filters and motors in the rate loop",
            "ATC_RAT_YAW_FLTE and INS_GYRO_FILTER at 20 Hz: 0.008 each", "shape", None, (0.02,),
        ),
    ),
    build=_yaw_shaping,
    equation="|d/dt r_t| <= a_r; e_dot = r_t - r; tau_r x_dot = r_t + k_r e - r - x; r_dot = sigma_r x",
    plain="the autopilot ramps the yaw rate instead of stepping it, and catches up with the heading of the ramp; this is no physics of the "
    "vehicle",
    source="ArduPilot AC_AttitudeControl::input_quaternion, input_shaping_angle, update_ang_vel_target_from_att_error",
    doubt="the heading sent with the command is taken as that of the ramp, as `flighttest run` sends it: one behind it slows the target "
    "down, one ahead makes it faster; a large heading error is linear here, where the autopilot takes a square root; the target starts "
    "where the vehicle is",
    hides_in=("sigma_r", "T_d"),
    told_apart_by="two amplitudes",
    reveals="yaw_rate",
    needs=("yaw_rate_ref_rad_s", "r_rad_s"),
    states=(
        State("yaw_rate_target_ahead_rad_s", "rad/s", "shaped yaw rate target ahead of the yaw rate"),
        State("yaw_target_ahead_rad", "rad", "heading of the shaped target ahead of the heading"),
        State("yaw_rate_error_rad_s", "rad/s", "what the rate loop answers"),
    ),
)  # fmt: skip


def _feedforward(s: Signals, p: Values, x: Values) -> Contribution:
    rates: dict[str, Expr] = {}
    references: dict[str, Expr] = {}
    for axis, _, reference, angle, rate in _axes(s):
        smoothed = angle + x[f"{axis}_reference_ahead_rad"]
        slope = (reference - smoothed) / _CATCH_UP_S
        rates[f"{axis}_reference_ahead_rad"] = slope - rate
        # Both are late by the smoothing, which the delay makes up for.
        references[f"{axis}_ref"] = smoothed + p["feedforward_s"] * slope
    return Contribution(references, rates)


rate_feedforward = Term(
    id="rate_feedforward",
    title="Rate feedforward",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        Param(
            "feedforward_s", "t_f", "s", 0.1, 0.0, 0.6, 0.02, "by how long the rate loop is given the reference's own rate ahead",
            "2 zeta / omega where the whole rate is given (ArduPilot ATC_RATE_FF_ENAB: 1)", "shape", None, (0.05, 0.1, 0.2),
            natural_bound="lower",
        ),
    ),
    build=_feedforward,
    equation="phi_dd = w^2 (phi_r + t_f phi_r_d - phi) - 2 zeta w phi_d, theta alike",
    plain="the autopilot gives its rate loop the rate of the attitude target beforehand, so that the vehicle follows a target that moves "
    "with little lag; this is no physics of the vehicle",
    source="ArduPilot AC_AttitudeControl::attitude_controller_run_quat: ang_vel_body += ang_vel_body_feedforward",
    doubt="the reference is smoothed over 15 ms, and a recorded one is half a sample late: where less delay is left to make up for it, the "
    "time is longer by as much; a reference that jumps has no rate that a vehicle could follow",
    hides_in=("omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "T_d"),
    told_apart_by="references that move all the time, as a pilot's do",
    reveals="free_flight",
    needs=("roll_ref_rad", "roll_rad"),
    states=(
        State("roll_reference_ahead_rad", "rad", "roll reference, smoothed, ahead of roll"),
        State("pitch_reference_ahead_rad", "rad", "pitch reference, smoothed, ahead of pitch"),
    ),
)  # fmt: skip


def _extra_pole(s: Signals, p: Values, x: Values) -> Contribution:
    tau, share = p["attitude_pole_tau"], p["attitude_pole_share"]
    rates: dict[str, Expr] = {}
    targets: dict[str, Expr] = {}
    for axis, _, reference, angle, rate in _axes(s):
        filtered = angle + x[f"{axis}_filtered_ahead_rad"]
        rates[f"{axis}_filtered_ahead_rad"] = (reference - filtered) / tau - rate
        targets[f"{axis}_ref"] = reference + share * (filtered - reference)
    return Contribution(targets, rates)


attitude_extra_pole = Term(
    id="attitude_extra_pole",
    title="A third pole in the attitude loop",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        Param(
            "attitude_pole_share", "b", "1", 1.0, -0.1, 1.0, 0.2, "1: a pure pole; between 0 and 1: a pole and a zero; 0: none",
            "filters and motors inside the attitude loop: 1; below 0 it would be a rate feedforward", one_sided=True,
        ),
        Param(
            "attitude_pole_tau", "τ_3", "s", 0.04, 0.012, 0.5, 0.02, "time constant of the pole",
            "rate loop filters and motors: 0.02 to 0.1", "shape", None, (0.03, 0.07, 0.15),
        ),
    ),
    build=_extra_pole,
    equation="reference <- (1 - b) reference + b x, x_dot = (reference - x) / tau_3",
    plain="the attitude loop is of more than second order: filters and motors add a pole or a zero",
    source="ArduPilot rate PID filters, INS_GYRO_FILTER, motor lag",
    doubt="close to a longer attitude delay (cosine 0.90 after the base refit); tau_3 is a pole of the closed loop: a pure lag within the "
    "loop has the time constant 1 / (2 zeta omega + 1 / tau_3)",
    hides_in=("T_d", "zeta_phi", "zeta_theta"),
    told_apart_by="shape",
    reveals="roll_pitch",
    needs=("roll_ref_rad", "roll_rad"),
    states=(
        State("roll_filtered_ahead_rad", "rad", "filtered roll reference ahead of roll"),
        State("pitch_filtered_ahead_rad", "rad", "filtered pitch reference ahead of pitch"),
    ),
)  # fmt: skip
