"""What the autopilot adds between the reference and the motors: this is no physics of the vehicle."""

from __future__ import annotations

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, State, Term, Values


def _boost(s: Signals, p: Values, _x: Values) -> Contribution:
    # The throttle here is that of a delay ago, and so is the lean angle that went with it.
    ago = s.base.get("T_d_thrust", s.base.get("T_d", 0.0))
    actual = ca.cos(s.roll - ago * s.roll_rate) * ca.cos(s.pitch - ago * s.pitch_rate)
    target = ca.cos(s.target_roll) * ca.cos(s.target_pitch)
    cosine = ca.fmax(target + p["boost_actual"] * (actual - target), 0.1)
    return Contribution({"throttle": s.throttle * (1 + p["boost"] * (1 / cosine - 1))})


angle_boost = Term(
    id="angle_boost",
    title="Angle boost",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        Param("boost", "b", "1", 1.0, -1.0, 3.0, 0.2, "1: throttle is divided by the cosine of the tilt; 0: it is not",
              "ArduPilot ATC_ANGLE_BOOST: 1", one_sided=True),
        Param("boost_actual", "s_b", "1", 1.0, 0.0, 1.0, 0.2, "whose tilt: 1 the vehicle's lean angle, 0 the attitude target's",
              "ArduPilot: 1", "shape", None, (1.0, 0.0)),
    ),
    build=_boost,
    equation="T <- T (1 + b (1 / c - 1)), c = (1 - s_b) cos(target tilt) + s_b cos(tilt)",
    plain="the autopilot raises the throttle when it tilts, to hold the vertical part of the thrust; this is no physics of the vehicle",
    source="ArduPilot AC_AttitudeControl_Multi::get_throttle_boosted; its angle is that of the vehicle, not of the target, by "
    "AC_AttitudeControl::thrust_vector_rotation_angles",
    doubt="before the thrust's delay, with the tilt of the same time; where no shaped target is recorded, the reference is used",
    hides_in=("K", "d_z"),
    told_apart_by="tilt steps at rest and at speed",
    reveals="roll_pitch",
    needs=("throttle",),
)  # fmt: skip


def _softly(x: Expr, limit: Expr) -> Expr:
    """x limited to +-limit: within 1 % of x below 0.55 limit."""
    return x / (1 + (x / limit) ** 6) ** (1 / 6)


def _rate_limit(s: Signals, p: Values, _x: Values) -> Contribution:
    b, limit = s.base, p["rate_max"]

    def lost(reference: Expr, angle: Expr, omega: Expr, zeta: Expr) -> Expr:
        wanted = omega / (2 * zeta) * (reference - angle)
        return 2 * zeta * omega * (_softly(wanted, limit) - wanted)

    roll = lost(s.roll_ref, s.roll, b["omega_phi"], b["zeta_phi"])
    pitch = lost(s.pitch_ref, s.pitch, b["omega_theta"], b["zeta_theta"])
    return Contribution(ca.vertcat(roll, pitch, 0))


rate_limit = Term(
    id="rate_limit",
    title="Attitude rate limit",
    family="autopilot",
    port=Port.ANGULAR,
    params=(
        Param(
            "rate_max", "ω_max", "rad/s", 4.0, 0.1, 20.0, 1.0, "greatest roll and pitch rate the autopilot asks for",
            "ATC_RATE_R_MAX, ATC_RATE_P_MAX; 60 to 360 deg/s", "shape", None, (0.5, 1.5, 3.0, 5.0, 8.0), limits="tilt_rate",
        ),
    ),
    build=_rate_limit,
    equation="phi_dd = 2 zeta w (sat(w / (2 zeta) (phi_r - phi), rate_max) - phi_d)",
    plain="the autopilot limits how fast it turns: large steps take longer than small ones",
    source="ArduPilot ATC_RATE_R_MAX; paper, section 4 (limitations)",
    doubt="cascade of an angle and a rate loop is assumed; the corner is soft",
    hides_in=("omega_phi", "omega_theta", "zeta_phi", "zeta_theta"),
    told_apart_by="two amplitudes",
    reveals="roll_pitch",
    needs=("roll_ref_rad", "roll_rad"),
)  # fmt: skip


def _bank(s: Signals) -> tuple[Expr, Expr, Expr]:
    """sin(roll), cos(roll) and cos(pitch) of the measured attitude, away from standing on the nose."""
    cos_pitch = ca.sqrt(ca.fmax(1 - s.rotation[2, 0] ** 2, 0.01))
    sin_roll = s.rotation[2, 1] / cos_pitch
    return sin_roll, ca.sqrt(ca.fmax(1 - sin_roll**2, 0.01)), cos_pitch


def _turn_axes(s: Signals, p: Values, _x: Values) -> Contribution:
    sin_roll, cos_roll, cos_pitch = _bank(s)
    turn = (s.rates[1] * sin_roll + s.rates[2] * cos_roll) / cos_pitch
    # The rate that goes with the target is turned by the whole target attitude, heading included; a turn about the vertical needs the row.
    added = turn * (s.rotation[:2, 2] - s.rotation[2, :2].T)
    return Contribution(
        {
            "roll_ref": s.roll_ref + p["turn_axes_s"] * (added[0] - s.rotation[2, 0] / cos_pitch * sin_roll * added[1]),
            "pitch_ref": s.pitch_ref + p["turn_axes_s"] * cos_roll * added[1],
        }
    )


turn_axes = Term(
    id="turn_axes",
    title="Turning moves roll and pitch",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        Param(
            "turn_axes_s", "t_x", "s", 0.15, -0.6, 0.6, 0.03, "time for which the added rate acts on the shaped target",
            "ATC_INPUT_TC, 0.15 s by default", one_sided=True,
        ),
    ),
    build=_turn_axes,
    equation="(phi_r, theta_r) <- (phi_r, theta_r) + t_x E(phi, theta) psi_dot (R e_z - R^T e_z), E: body to Euler rates",
    plain="the autopilot takes the yaw rate that comes with an attitude target in axes turned by the whole target, so that a turn while "
    "tilted moves roll and pitch, by the heading; this is no physics of the vehicle",
    source="ArduPilot AC_AttitudeControl::input_quaternion: ang_vel_target = attitude_desired_quat * ang_vel_body_rads",
    doubt="the turn is the measured one and the attitude, too, where the autopilot takes the target's",
    hides_in=(),
    told_apart_by="turns while tilted, on several headings",
    reveals="free_flight",
    needs=("roll_ref_rad", "roll_rad", "yaw_rad", "r_rad_s"),
)  # fmt: skip


def _heading_hold(s: Signals, p: Values, x: Values) -> Contribution:
    behind = x["heading_behind_rad"]
    pull = s.base["sigma_r"] * p["heading_gain"] * behind
    return Contribution(ca.vertcat(0, 0, pull), {"heading_behind_rad": s.yaw_rate_ref - s.yaw_rate})


heading_hold = Term(
    id="heading_hold",
    title="Heading is held",
    family="autopilot",
    port=Port.ANGULAR,
    params=(
        Param(
            "heading_gain", "k_psi", "1/s", 4.5, -10.0, 20.0, 1.0, "yaw rate asked for per heading behind the integrated command",
            "ATC_ANG_YAW_P: 4.5", one_sided=True,
        ),
    ),
    build=_heading_hold,
    equation="r_dot <- r_dot + sigma_r k_psi e, e_dot = r_r - r",
    plain="the autopilot integrates the commanded yaw rate into a heading and catches up with it, so that the yaw rate overshoots after "
    "it lagged; this is no physics of the vehicle",
    source="ArduPilot AC_AttitudeControl::attitude_controller_run_quat, update_ang_vel_target_from_att_error",
    doubt="linear, where the autopilot takes a square root of large errors; yaw rate shaping holds the heading of its own target",
    hides_in=("sigma_r", "T_d"),
    told_apart_by="shape after the step",
    reveals="yaw_rate",
    needs=("yaw_rate_ref_rad_s", "r_rad_s"),
    states=(State("heading_behind_rad", "rad", "heading behind the integrated command", free=True, spread=0.05),),
)  # fmt: skip


def _heading_rate(s: Signals, p: Values, _x: Values) -> Contribution:
    # Body yaw rate of the heading rate that was asked for: cos(roll) cos(pitch) r_r - sin(roll) pitch_dot.
    sin_roll, cos_roll, _ = _bank(s)
    pitch_dot = cos_roll * s.rates[1] - sin_roll * s.rates[2]
    body_rate = s.rotation[2, 2] * s.yaw_rate_ref - sin_roll * pitch_dot
    return Contribution({"yaw_rate_ref": s.yaw_rate_ref + p["heading_rate_share"] * (body_rate - s.yaw_rate_ref)})


heading_rate_reference = Term(
    id="heading_rate_reference",
    title="Yaw command is a heading rate",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        Param(
            "heading_rate_share", "h", "1", 1.0, -1.0, 2.5, 0.3, "share of the turn from heading rate to body yaw rate",
            "1 where the autopilot takes the command as an Euler rate", one_sided=True,
        ),
    ),
    build=_heading_rate,
    equation="r_r <- r_r + h (cos(phi) cos(theta) r_r - sin(phi) theta_dot - r_r)",
    plain="the autopilot turns the heading at the commanded rate, so that in a banked turn the body yaws at another one; this is no "
    "physics of the vehicle",
    source="ArduPilot AC_AttitudeControl::input_euler_angle_roll_pitch_euler_rate_yaw, euler_rate_to_ang_vel",
    doubt="the pitch rate is the measured one, not the target's; seen only where the vehicle is banked while it pitches or turns",
    hides_in=("sigma_r",),
    told_apart_by="yaw rate while banked",
    reveals="banked_turn",
    needs=("yaw_rate_ref_rad_s", "r_rad_s", "roll_rad"),
)  # fmt: skip


def _coupling(s: Signals, p: Values, _x: Values) -> Contribution:
    return Contribution(
        {
            "roll_ref": s.roll_ref + p["pitch_to_roll"] * s.pitch_ref,
            "pitch_ref": s.pitch_ref + p["roll_to_pitch"] * s.roll_ref,
        }
    )


def _coupling_param(name: str, what: str) -> Param:
    return Param(
        name, name, "1", 0.05, -1.0, 1.0, 0.03, what, "IMU turned by a few degrees: 0 to 0.1; by 45 degrees: 1"
    )


roll_pitch_coupling = Term(
    id="roll_pitch_coupling",
    title="Roll and pitch answer each other",
    family="autopilot",
    port=Port.REFERENCE,
    params=(
        _coupling_param("pitch_to_roll", "share of the pitch reference that appears in roll"),
        _coupling_param("roll_to_pitch", "share of the roll reference that appears in pitch"),
    ),
    build=_coupling,
    equation="roll_ref <- roll_ref + c_pr pitch_ref;  pitch_ref <- pitch_ref + c_rp roll_ref",
    plain="a roll command also moves pitch, or the other way round: the autopilot is rotated in the frame, or the mixer is not exact",
    source="rotation of the autopilot about the vertical: c_pr = -c_rp",
    doubt="static coupling only",
    hides_in=(),
    told_apart_by="single-axis steps",
    reveals="roll_pitch",
    needs=("roll_ref_rad", "roll_rad"),
)
