"""The paper's body: attitude loops, thrust with its lag, gravity (Eq. 4 without drag). `[body, linear_drag]` is the paper's model.

Equations are plain functions of CasADi expressions; `physics.model` calls them between the ports. Angles rad, world NWU, body FLU.
"""

from __future__ import annotations

import casadi as ca

from flighttest.physics.core import Expr, Param, Signals

_TABLE_2 = "paper, Table 2"

ATTITUDE_PARAMS = (
    Param("omega_phi", "ω_n,φ", "rad/s", 25.43, 1.0, 120.0, 5.0, "roll natural frequency", _TABLE_2, "base", None),
    Param("omega_theta", "ω_n,θ", "rad/s", 23.40, 1.0, 120.0, 5.0, "pitch natural frequency", _TABLE_2, "base", None),
    Param("zeta_phi", "ζ_φ", "1", 0.44, 0.02, 3.0, 0.2, "roll damping ratio", _TABLE_2, "base", None),
    Param("zeta_theta", "ζ_θ", "1", 0.39, 0.02, 3.0, 0.2, "pitch damping ratio", _TABLE_2, "base", None),
    Param("sigma_r", "σ_r", "1/s", 21.54, 0.3, 150.0, 5.0, "yaw rate decay constant", _TABLE_2, "base", None),
)
THRUST_PARAMS = (
    Param("sigma_t", "σ_t", "1/s", 20.36, 0.5, 150.0, 5.0, "thrust decay constant", _TABLE_2, "base", None),
    Param("K", "K", "m/s^2", 54.55, 1.0, 2000.0, 10.0, "thrust gain at nominal voltage", _TABLE_2, "base", None),
    Param("alpha", "α", "1", 1.71, -10.0, 10.0, 0.5, "battery voltage exponent", _TABLE_2, "base", None),
)
DELAY = Param("T_d", "T_d", "s", 0.1, 0.0, 0.6, 0.01, "communication delay", _TABLE_2, "base", None)
# Each channel's own delay (beyond the paper): T_d is their mean.
CHANNEL_DELAYS = (
    Param(
        "T_d_attitude",
        "T_d,att",
        "s",
        0.1,
        0.0,
        0.6,
        0.01,
        "delay of roll and pitch references",
        _TABLE_2,
        "base",
        None,
    ),
    Param("T_d_yaw_rate", "T_d,r", "s", 0.1, 0.0, 0.6, 0.01, "delay of the yaw rate reference", _TABLE_2, "base", None),
    Param("T_d_thrust", "T_d,T", "s", 0.1, 0.0, 0.6, 0.01, "delay of the throttle", _TABLE_2, "base", None),
)
# Delay channel to the parameter that holds it when channels have their own.
DELAY_PARAM = {"attitude": "T_d_attitude", "yaw_rate": "T_d_yaw_rate", "thrust": "T_d_thrust"}


def rotation(roll: Expr, pitch: Expr, yaw: Expr) -> Expr:
    """R_psi R_theta R_phi (Eq. 2), (3, 3), body to world."""
    cr, sr, cp, sp, cy, sy = ca.cos(roll), ca.sin(roll), ca.cos(pitch), ca.sin(pitch), ca.cos(yaw), ca.sin(yaw)
    return ca.vertcat(
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        ca.horzcat(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )


def euler_rates(roll: Expr, pitch: Expr, rates: Expr) -> tuple[Expr, Expr]:
    """Rates of roll and pitch, rad/s, from body rates p, q, r, rad/s; numbers or expressions."""
    p, q, r = (rates[k] for k in range(3))
    return p + ca.tan(pitch) * (ca.sin(roll) * q + ca.cos(roll) * r), ca.cos(roll) * q - ca.sin(roll) * r


def yaw_kinematics(s: Signals) -> Expr:
    """psi_dot, rad/s (Eq. 3 with q eliminated)."""
    return (s.yaw_rate / ca.cos(s.roll) + ca.tan(s.roll) * s.pitch_rate) / ca.cos(s.pitch)


def body_rates(s: Signals, yaw_dot: Expr) -> Expr:
    """p, q, r (3,), rad/s, of Euler rates."""
    p = s.roll_rate - ca.sin(s.pitch) * yaw_dot
    q = ca.cos(s.roll) * s.pitch_rate + ca.sin(s.roll) * ca.cos(s.pitch) * yaw_dot
    return ca.vertcat(p, q, s.yaw_rate)


def roll_acceleration(s: Signals) -> Expr:
    """phi_dd, rad/s^2."""
    b = s.base
    return b["omega_phi"] ** 2 * (s.roll_ref - s.roll) - 2 * b["zeta_phi"] * b["omega_phi"] * s.roll_rate


def pitch_acceleration(s: Signals) -> Expr:
    """theta_dd, rad/s^2."""
    b = s.base
    return b["omega_theta"] ** 2 * (s.pitch_ref - s.pitch) - 2 * b["zeta_theta"] * b["omega_theta"] * s.pitch_rate


def yaw_acceleration(s: Signals) -> Expr:
    """r_dot, rad/s^2."""
    return s.base["sigma_r"] * (s.yaw_rate_ref - s.yaw_rate)


def thrust_command(s: Signals) -> Expr:
    """K (U/U_n)^alpha T, m/s^2."""
    return s.base["K"] * ca.exp(s.base["alpha"] * ca.log(s.voltage / s.nominal_voltage)) * s.throttle


def thrust_rate(s: Signals) -> Expr:
    """a_t_dot, m/s^3."""
    return s.base["sigma_t"] * (s.command - s.a_t)
