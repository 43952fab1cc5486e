"""Moments of the air on the vehicle, as stability derivatives: angular acceleration per velocity through the air.

A rotor in a crossflow of speed V flaps, or loads its hub, in proportion to its thrust and to its advance ratio, V over the speed of its
tips. With fixed blades thrust is as the square of that speed, so that the moment is as V times the root of the thrust.
"""

from __future__ import annotations

import casadi as ca

from flighttest.physics.core import Contribution, Param, Port, Signals, State, Term, Values

LEAST_THRUST = 0.01  # of hover: the root has no slope at none
# Standard deviation of the prior. A rotor's moment is thrust times radius times advance ratio; over the inertia m k^2 a derivative is of
# the order of g R / (k^2 Omega R), with R and Omega R the radius and the tip speed of the rotors, k the radius of gyration of the vehicle:
# 0.9 rad/(s m) for 1.5 kg (0.12 m, 70 m/s, 0.14 m), 11 for a Crazyflie of 34 g (0.023 m, 48 m/s, 0.021 m). With the 1.5 rad/(s m) of three
# nominal sizes, two of four sets of flights of a Crazyflie that have the moment by name had none.
SPREAD = 6.0
_UPRIGHT = "blade flapping, and drag off the centre of mass: 0.2 to 2 for 1 to 2 kg, 2 to 10 for 34 g"
_SKEWED = "none by symmetry in still air; in wind 0.5 to 2"


def _derivative(name: str, symbol: str, doc: str, source: str) -> Param:
    return Param(name, symbol, "rad/(s m)", 0.5, -60.0, 60.0, 0.5, doc, source, spread=SPREAD)


def _moments(s: Signals, p: Values, x: Values) -> Contribution:
    root = ca.sqrt(ca.fmax(s.relative_thrust, LEAST_THRUST))
    away = root * (s.rotation.T @ s.v_world) - s.v_trimmed - ca.vertcat(*x.values())
    u, v, w = ca.vertsplit(away)
    moments = ca.vertcat(p["l_v"] * v + p["l_w"] * w, -p["m_u"] * u + p["m_w"] * w, 0)
    return Contribution(moments, dict(zip(x, ca.vertsplit(p["moment_trim_1_s"] * away), strict=True)))


def _trimmed(axis: str, way: str) -> State:
    return State(f"{axis}_trimmed_m_s", "m/s", f"speed {way} beyond the flight's mean at which the moments are trimmed")


airflow_moment = Term(
    id="airflow_moment",
    title="Moments of the air",
    family="aerodynamics",
    port=Port.ANGULAR,
    params=(
        _derivative("m_u", "M_u", "pitch acceleration, nose up, per forward speed", _UPRIGHT),
        _derivative("l_v", "L_v", "roll acceleration, left side up, per speed to the left", _UPRIGHT),
        _derivative("m_w", "M_w", "pitch acceleration, nose down, per climb speed", _SKEWED),
        _derivative("l_w", "L_w", "roll acceleration, left side up, per climb speed", _SKEWED),
        Param(
            "moment_trim_1_s", "k_m", "1/s", 1.0, 0.0, 2.0, 0.5, "rate at which the autopilot's integrators trim a moment; 0: none do",
            "I over P of the rate loop: ArduPilot 1, PX4 1.33; what is gone faster is the loop itself", "shape", None, (0.0, 1.0),
        ),
    ),
    build=_moments,
    equation="(phi_dd, theta_dd) += (L_v v + L_w w, M_w w - M_u u), (u, v, w) = V - V_t, V_t_dot = k_m (V - V_t), "
    "V: velocity through the air in body axes times the root of thrust over hover thrust",
    plain="speed through the air tilts the vehicle: the rotors flap back, drag acts off the centre of mass, front and rear rotors meet "
    "another air",
    source="Bramwell, Done and Balmford, Bramwell's Helicopter Dynamics, chapter 5 (M_u, L_v, M_w); Hoffmann et al., Quadrotor helicopter "
    "flight dynamics and control, AIAA GNC 2007 (flapping by the advance ratio)",
    doubt="thrust over hover thrust is throttle over the flight's median throttle; when a response begins, the mean of its flight is taken "
    "to be trimmed; derivatives by climb are those of the wind flown in",
    hides_in=("omega_phi", "omega_theta", "zeta_phi", "zeta_theta"),
    told_apart_by="speed after the tilt has ended; climb and descent in wind",
    reveals="speed_dash",
    needs=("v_x_m_s", "roll_ref_rad", "roll_rad"),
    states=(_trimmed("forward", "ahead"), _trimmed("left", "to the left"), _trimmed("up", "upwards")),
)  # fmt: skip
