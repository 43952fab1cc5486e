"""What hangs below the vehicle."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, State, Term

Values = Mapping[str, Expr]
LEAST_DOWN = 0.2  # of the cable: beyond 78 degrees the two coordinates no longer tell where the load is


def _payload(s: Signals, p: Values, x: Values) -> Contribution:
    """A point mass on a taut massless cable; n, from the vehicle to the load, turns as both of its ends are pulled."""
    ratio, length = p["payload_ratio"], p["cable_m"]
    f = s.rotation @ s.force
    north, west = x["swing_north"], x["swing_west"]
    rate_north, rate_west = x["swing_north_rate_1_s"], x["swing_west_rate_1_s"]
    down = ca.sqrt(ca.fmax(1 - north**2 - west**2, LEAST_DOWN**2))
    n: Expr = ca.vertcat(north, west, -down)
    rate: Expr = ca.vertcat(rate_north, rate_west, (north * rate_north + west * rate_west) / down)
    drag: Expr = -2 * p["swing_damping"] * ca.sqrt(s.g * length) * rate
    # Tension that keeps the length, per mass of the load.
    tension = (length * ca.sumsqr(rate) + ca.dot(n, drag - f)) / (1 + ratio)
    acceleration: Expr = (drag - f - (1 + ratio) * tension * n) / length
    return Contribution(
        s.rotation.T @ (ratio * tension * n),
        {
            "swing_north": rate_north,
            "swing_west": rate_west,
            "swing_north_rate_1_s": acceleration[0],
            "swing_west_rate_1_s": acceleration[1],
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
    plain="a load swings on a cable below the vehicle and pulls it to and fro after every lateral move",
    source="pendulum below an accelerated pivot; Palunko, Fierro, Cruz, ICRA 2012",
    doubt="taut massless cable, swings below 78 degrees, no downwash on the load; its "
    "weight is in K's thrust-to-mass ratio unless a former model says otherwise",
    hides_in=("a_d", "d_x", "d_y", "K"),
    told_apart_by="ringing after lateral steps",
    reveals="lateral_stop",
    needs=("v_x_m_s",),
    # A load still swings from the flight to the start when a step begins.
    states=(
        State("swing_north", "1", "share of the cable that points north", free=True, spread=0.15),
        State("swing_west", "1", "share of the cable that points west", free=True, spread=0.15),
        State("swing_north_rate_1_s", "1/s", "its rate towards north", free=True, spread=0.4),
        State("swing_west_rate_1_s", "1/s", "its rate towards west", free=True, spread=0.4),
    ),
)  # fmt: skip
