"""What hangs below the vehicle."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, State, Term

Values = Mapping[str, Expr]


def _payload(s: Signals, p: Values, x: Values) -> Contribution:
    ratio, length = p["payload_ratio"], p["cable_m"]
    f = s.rotation @ s.force
    swing: Expr = ca.vertcat(x["swing_north_rad"], x["swing_west_rad"])
    rate: Expr = ca.vertcat(x["swing_north_rate_rad_s"], x["swing_west_rate_rad_s"])
    # What the payload feels as gravity: the vertical specific force of vehicle and payload together.
    gravity = f[2] / (1 + ratio)
    pull: Expr = ratio * gravity * ca.vertcat(swing, -1)
    vehicle = f[:2] + pull[:2]
    damping = 2 * p["swing_damping"] * ca.sqrt(s.g / length) * rate
    acceleration: Expr = -(gravity * swing + vehicle) / length - damping
    return Contribution(
        s.rotation.T @ pull,
        {
            "swing_north_rad": rate[0],
            "swing_west_rad": rate[1],
            "swing_north_rate_rad_s": acceleration[0],
            "swing_west_rate_rad_s": acceleration[1],
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
    equation="l s_dd = -(g_eff s + v_dot_xy) - 2 zeta sqrt(g l) s_d;  f_world = mu g_eff (s_north, s_west, -1), g_eff = f_up / (1 + mu)",
    plain="a load swings on a cable below the vehicle and pulls it to and fro after every lateral move",
    source="pendulum below an accelerated pivot; Palunko, Fierro, Cruz, ICRA 2012",
    doubt="small swing angles, taut massless cable; its weight is in K's thrust-to-mass ratio unless a former model says otherwise",
    hides_in=("a_d", "d_x", "d_y", "K"),
    told_apart_by="ringing after lateral steps",
    reveals="lateral_stop",
    needs=("v_x_m_s",),
    # A load still swings from the flight to the start when a step begins.
    states=(
        State("swing_north_rad", "rad", "swing towards north", free=True, spread=0.15),
        State("swing_west_rad", "rad", "swing towards west", free=True, spread=0.15),
        State("swing_north_rate_rad_s", "rad/s", "rate of the swing towards north", free=True, spread=0.4),
        State("swing_west_rate_rad_s", "rad/s", "rate of the swing towards west", free=True, spread=0.4),
    ),
)  # fmt: skip
