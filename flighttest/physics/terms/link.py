"""What happens between the companion computer and the autopilot."""

from __future__ import annotations

from collections.abc import Mapping

from flighttest.physics.core import Contribution, Expr, Param, Port, Signals, Term


def _delay(_s: Signals, p: Mapping[str, Expr], _x: Mapping[str, Expr]) -> Contribution:
    return Contribution({"attitude": p["delay_attitude"], "yaw_rate": p["delay_yaw_rate"]})


def _param(channel: str, what: str) -> Param:
    return Param(
        f"delay_{channel}", f"ΔT_{channel}", "s", 0.02, -0.4, 0.4, 0.01, f"delay of the {what} reference beyond the throttle's",
        "different paths through the autopilot: 0 to 0.05",
    )  # fmt: skip


channel_delay = Term(
    id="channel_delay",
    title="Delays differ between channels",
    family="link",
    port=Port.DELAY,
    params=(_param("attitude", "attitude"), _param("yaw_rate", "yaw rate")),
    build=_delay,
    equation="T_d(attitude) = T_d + dT_att, T_d(yaw rate) = T_d + dT_r, T_d(throttle) = T_d",
    plain="attitude, yaw rate and throttle commands have different delays",
    source="paths through the autopilot: shaping, filters, motor output",
    doubt="shaping and filters inside the loops look like delay; a model that gives each channel its own delay already contains it",
    hides_in=("T_d", "omega_phi", "sigma_r", "sigma_t"),
    told_apart_by="all steps",
    reveals="roll_pitch",
    needs=("roll_ref_rad", "yaw_rate_ref_rad_s"),
)
