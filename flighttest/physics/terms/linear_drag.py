"""Rotor drag: the paper's R D R' v."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, Term


def _build(s: Signals, p: Mapping[str, Expr], _states: Mapping[str, Expr]) -> Contribution:
    d: Expr = ca.vertcat(p["d_x"], p["d_y"], p["d_z"])
    return Contribution(-d * s.v_air_body)


def _drag(axis: str, name: str, nominal: float) -> Param:
    return Param(
        f"d_{axis}",
        f"d_{axis}",
        "1/s",
        nominal,
        -0.5,
        5.0,
        0.2,
        f"drag coefficient along the body's {name} axis",
        "paper, Table 2",
        one_sided=True,
    )


linear_drag = Term(
    id="linear_drag",
    title="Linear rotor drag",
    family="aerodynamics",
    port=Port.FORCE,
    params=(_drag("x", "forward", 0.39), _drag("y", "left", 0.39), _drag("z", "up", 0.51)),
    build=_build,
    equation="f = -diag(d_x, d_y, d_z) v_air_body",
    plain="air drags on the vehicle in proportion to its speed through the air",
    source="paper, section 2; Faessler et al., RA-L 2018",
    doubt="grows faster than linearly at high speed; really scales with thrust",
    hides_in=("K",),
    told_apart_by="speed at steady tilt",
    reveals="roll_pitch",
    needs=("v_x_m_s",),
)
