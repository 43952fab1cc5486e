"""What hangs below the vehicle."""

from __future__ import annotations

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, State, Term, Values


def _payload(s: Signals, p: Values, x: Values) -> Contribution:
    """A point mass on a massless cable; n, from the vehicle to the load, turns as both of its ends are pulled.

    n is a point of a sphere, seen from its top: the coordinates a are about the shares of the cable that point north and west while it
    hangs, 2 where it is level, and without end only where the load is above the vehicle. What swings it is the specific force of the
    vehicle, pull included: as measured, where the equations of motion are at measured velocities, else the model's.
    """
    ratio, length = p["payload_ratio"], p["cable_m"]
    f = s.rotation @ s.force
    a: Expr = ca.vertcat(x["swing_north"], x["swing_west"])
    a_dot: Expr = ca.vertcat(x["swing_north_rate_1_s"], x["swing_west_rate_1_s"])
    share = 1 / (1 + ca.sumsqr(a) / 4)
    slope = ca.dot(a, a_dot) / 2
    share_dot = -(share**2) * slope
    n: Expr = ca.vertcat(share * a, 1 - 2 * share)
    n_dot: Expr = ca.vertcat(share * a_dot + share_dot * a, -2 * share_dot)
    drag: Expr = -2 * p["swing_damping"] * ca.sqrt(s.g * length) * n_dot
    # Tension that keeps the length, per mass of the load; a cable does not push.
    tension = ca.fmax((length * ca.sumsqr(n_dot) + ca.dot(n, drag - f)) / (1 + ratio), 0)
    pivot: Expr = f + ratio * tension * n if s.measured_force is None else s.measured_force
    pulled = ca.fmax(
        length * ca.sumsqr(n_dot) + ca.dot(n, drag - pivot), 0
    )  # the tension, where the pivot is the model's
    # What of the acceleration of n is left beside that of coordinates that keep their rates, back in coordinates.
    share_ddot = -2 * share * share_dot * slope - share**2 * ca.sumsqr(a_dot) / 2
    kept: Expr = ca.vertcat(2 * share_dot * a_dot + share_ddot * a, -2 * share_ddot)
    left: Expr = (drag - pivot - pulled * n) / length - kept
    a_ddot = left[:2] / share + a * (left[2] - ca.dot(a, left[:2]) / 2)
    return Contribution(
        s.rotation.T @ (ratio * tension * n),
        {
            "swing_north": a_dot[0],
            "swing_west": a_dot[1],
            "swing_north_rate_1_s": a_ddot[0],
            "swing_west_rate_1_s": a_ddot[1],
        },
    )


slung_payload = Term(
    id="slung_payload",
    title="Slung payload",
    family="payload",
    port=Port.FORCE,
    params=(
        Param(
            "payload_ratio", "μ", "1", 0.1, -0.3, 1.5, 0.05, "mass of the payload over mass of the vehicle",
            "payloads that a multirotor lifts: 0 to 0.5", one_sided=True),
        Param(
            "cable_m", "l", "m", 1.0, 0.1, 15.0, 0.3, "length of the cable, to the payload's centre",
            "usual cables: 0.3 to 5 m", "shape", None, (0.4, 0.8, 1.6, 3.2),
        ),
        Param(
            "swing_damping", "ζ_s", "1", 0.03, 0.0, 0.5, 0.02, "damping ratio of the swing", "air and cable: 0.01 to 0.1",
            "shape", None, (0.03,),
        ),
    ),
    build=_payload,
    equation="f_world = mu t n,  t = (l |n_dot|^2 + n (d - f)) / (1 + mu),  l n_ddot = d - f - (1 + mu) t n,  d = -2 zeta sqrt(g l) n_dot",
    plain="a load swings on a cable below the vehicle and pulls it back and forth after every lateral motion",
    source="pendulum below an accelerated pivot; Palunko, Fierro, Cruz, ICRA 2012",
    doubt="massless cable that a slack moment leaves at its length, no downwash on the load; its "
    "weight is in K's thrust-to-mass ratio unless an earlier model states another value",
    hides_in=("a_d", "d_x", "d_y", "K"),
    told_apart_by="ringing after lateral steps",
    reveals="lateral_stop",
    needs=("v_x_m_s",),
    # A load still swings from the flight to the start when a step begins.
    states=(
        State("swing_north", "1", "swing towards north: twice the tangent of half its angle", free=True, spread=0.15, settles=True),
        State("swing_west", "1", "the same towards west", free=True, spread=0.15, settles=True),
        State("swing_north_rate_1_s", "1/s", "its rate towards north", free=True, spread=0.7, settles=True),
        State("swing_west_rate_1_s", "1/s", "its rate towards west", free=True, spread=0.7, settles=True),
    ),
)  # fmt: skip
