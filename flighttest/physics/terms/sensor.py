"""What sensors report instead of the truth."""

from __future__ import annotations

import math

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, State, Term, Values

OFFSET_STD_RAD = math.radians(1.5)  # 95 % of vehicles within 3 degrees of level


def _offset(s: Signals, p: Values, _x: Values) -> Contribution:
    roll, pitch = p["offset_roll"], p["offset_pitch"]
    axis = ca.vertcat(ca.cos(roll) * ca.sin(pitch), -ca.sin(roll), ca.cos(roll) * ca.cos(pitch) - 1)
    return Contribution(s.a_t_total * axis)


def _offset_param(axis: str) -> Param:
    return Param(
        f"offset_{axis}", f"δ_{axis}", "rad", 0.02, -0.17, 0.17, 0.01, f"{axis} of the thrust axis in the frame of the reported attitude",
        "level calibration, centre of mass: 0 to 3 deg; ArduPilot limits its trim to 10 deg", drift=0.002, spread=OFFSET_STD_RAD,
    )  # fmt: skip


attitude_offset = Term(
    id="attitude_offset",
    title="Thrust axis and reported attitude differ",
    family="sensor",
    port=Port.FORCE,
    params=(_offset_param("roll"), _offset_param("pitch")),
    build=_offset,
    equation="f = a_t (R(offset_roll, offset_pitch) e_z - e_z)",
    plain="the attitude that the autopilot reports as level is not exactly perpendicular to the rotors' thrust",
    source="ArduPilot AHRS_TRIM_X, AHRS_TRIM_Y; centre of mass beside the middle of the rotors",
    doubt="small angles; the accelerometer is taken to sit in the frame of the reported attitude",
    hides_in=("a_d",),
    told_apart_by="headings and throttles",
    reveals="headings",
    needs=("throttle", "v_x_m_s"),  # without a velocity the force of a wind is the same
)


def _bias(s: Signals, p: Values, _x: Values) -> Contribution:
    return Contribution({"f": s.measured["f"] + ca.vertcat(p["bias_x"], p["bias_y"], p["bias_z"])})


def _bias_param(axis: str, name: str) -> Param:
    return Param(
        f"bias_{axis}", f"b_{axis}", "m/s^2", 0.2, -4.0, 4.0, 0.1, f"accelerometer bias along the body's {name} axis",
        "consumer accelerometers over temperature: 0 to 0.5", drift=0.05,
    )  # fmt: skip


accelerometer_bias = Term(
    id="accelerometer_bias",
    title="Accelerometer bias",
    family="sensor",
    port=Port.MEASUREMENT,
    params=(_bias_param("x", "forward"), _bias_param("y", "left"), _bias_param("z", "up")),
    build=_bias,
    equation="f_measured = f + (b_x, b_y, b_z)",
    plain="the accelerometer has a constant error in its own axes",
    source="sensor data sheets; paper, section 4 (limitations)",
    doubt="constant: changes with temperature are not in it; the autopilot's filter removes part of it from velocity",
    hides_in=("a_d", "K"),
    told_apart_by="headings, attitudes",
    reveals="headings",
    needs=("f_x_m_s2", "v_x_m_s"),
)


def _lever(s: Signals, p: Values, _x: Values) -> Contribution:
    arm = ca.vertcat(p["arm_x"], p["arm_y"], p["arm_z"])
    extra = ca.cross(s.angular_acceleration, arm) + ca.cross(s.rates, ca.cross(s.rates, arm))
    return Contribution({"f": s.measured["f"] + extra})


def _arm_param(axis: str, name: str) -> Param:
    return Param(
        f"arm_{axis}", f"r_{axis}", "m", 0.05, -1.0, 1.0, 0.02, f"IMU {name} of the centre of mass",
        "autopilots are mounted within 0.1 m",
    )  # fmt: skip


imu_lever_arm = Term(
    id="imu_lever_arm",
    title="IMU away from the centre of mass",
    family="sensor",
    port=Port.MEASUREMENT,
    params=(_arm_param("x", "ahead"), _arm_param("y", "left"), _arm_param("z", "above")),
    build=_lever,
    equation="f_measured = f + w_dot x r + w x (w x r)",
    plain="the accelerometer is not at the centre of mass and measures the acceleration of every rotation, too",
    source="rigid body kinematics; ArduPilot INS_POS_x",
    doubt="angular acceleration is differentiated from the gyro, which blurs fast steps",
    hides_in=(),
    told_apart_by="roll and yaw steps",
    reveals="roll_pitch",
    needs=("f_x_m_s2", "p_rad_s"),
)


_LATE = ("late_north_m_s2", "late_west_m_s2", "late_up_m_s2")
_LATE_RATE = ("late_north_m_s3", "late_west_m_s3", "late_up_m_s3")
_LEAST_LAG_S = 0.012  # no latency, no lag: but no endless rate either


def _latency(s: Signals, p: Values, x: Values) -> Contribution:
    """v(t - tau) is v - tau times the mean acceleration of the last tau, by Pade's second approximant of a delay.

    For tau of 0.1 s and more its phase is right to 2 % up to 2 / tau rad/s, where the first is 20 % off; below, the least lag smooths too.
    """
    tau = p["velocity_latency"]
    late: Expr = ca.vertcat(*(x[name] for name in _LATE))
    late_rate: Expr = ca.vertcat(*(x[name] for name in _LATE_RATE))
    lag = ca.sqrt(tau**2 / 12 + _LEAST_LAG_S**2)
    jerk = (s.v_dot_world - late - ca.sqrt(3.0) * lag * late_rate) / lag**2
    rates = dict(zip(_LATE, ca.vertsplit(late_rate), strict=True)) | dict(
        zip(_LATE_RATE, ca.vertsplit(jerk), strict=True)
    )
    return Contribution({"v": s.measured["v"] - tau * late}, rates)


velocity_latency = Term(
    id="velocity_latency",
    title="Velocity estimate is late",
    family="sensor",
    port=Port.MEASUREMENT,
    params=(
        Param("velocity_latency", "τ_v", "s", 0.1, -0.2, 0.6, 0.05, "how late the reported velocity is",
              "satellite receivers and their filters: 0.05 to 0.25 s", one_sided=True),
    ),
    build=_latency,
    equation="v_measured = v - tau_v a,  tau_v^2 / 12 a_ddot + tau_v / 2 a_dot + a = v_dot",
    plain="the velocity estimate lags behind the motion, as a satellite receiver's does",
    source="ArduPilot GPS_DELAY_MS; Pade approximant of a delay",
    doubt="really a pure delay: the approximation is good up to 2 / tau_v rad/s; below 0.1 s it smooths as well",
    hides_in=("d_x", "d_y", "d_z"),
    told_apart_by="fast reversals",
    reveals="lateral_stop",
    needs=("v_z_m_s",),
    states=(
        *(State(name, "m/s^2", "mean acceleration while the velocity was on its way", free=True, spread=1.0) for name in _LATE),
        *(State(name, "m/s^3", "its derivative") for name in _LATE_RATE),
    ),
)  # fmt: skip
