"""The one table of measured quantities: name, unit, frame and meaning of every column this package reads or writes.

Frames: `world` is North-West-Up, `body` is Forward-Left-Up (see `frames`). The name ends in the unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Frame = Literal["world", "body", "none"]


@dataclass(frozen=True)
class Channel:
    """One measured quantity. `group` names the Parquet file (one time base) it is stored in."""

    name: str
    unit: str
    frame: Frame
    group: str
    doc: str


_TABLE = (
    Channel("roll_rad", "rad", "world", "attitude", "roll Euler angle (ZYX)"),
    Channel("pitch_rad", "rad", "world", "attitude", "pitch Euler angle (ZYX), nose down positive"),
    Channel("yaw_rad", "rad", "world", "attitude", "yaw Euler angle (ZYX), counter-clockwise from north"),
    Channel("p_rad_s", "rad/s", "body", "rates", "roll rate"),
    Channel("q_rad_s", "rad/s", "body", "rates", "pitch rate"),
    Channel("r_rad_s", "rad/s", "body", "rates", "yaw rate, positive to the left"),
    Channel("roll_ref_rad", "rad", "world", "reference", "commanded roll, held until the next sample"),
    Channel("pitch_ref_rad", "rad", "world", "reference", "commanded pitch, held until the next sample"),
    Channel("yaw_rate_ref_rad_s", "rad/s", "body", "reference", "commanded yaw rate, held until the next sample"),
    Channel("throttle", "1", "none", "reference", "commanded throttle 0..1, held until the next sample"),
    Channel("roll_shaped_rad", "rad", "world", "shaped", "roll target after the autopilot's own shaping"),
    Channel("pitch_shaped_rad", "rad", "world", "shaped", "pitch target after the autopilot's own shaping"),
    Channel("yaw_rate_shaped_rad_s", "rad/s", "body", "shaped", "yaw rate target after the autopilot's own shaping"),
    Channel("throttle_out", "1", "none", "output", "throttle after boost and filters, as the autopilot reports it"),
    Channel("f_x_m_s2", "m/s^2", "body", "specific_force", "accelerometer, forward"),
    Channel("f_y_m_s2", "m/s^2", "body", "specific_force", "accelerometer, left"),
    Channel("f_z_m_s2", "m/s^2", "body", "specific_force", "accelerometer, up; +9.81 at rest"),
    Channel("a_x_m_s2", "m/s^2", "world", "acceleration", "acceleration, north"),
    Channel("a_y_m_s2", "m/s^2", "world", "acceleration", "acceleration, west"),
    Channel("a_z_m_s2", "m/s^2", "world", "acceleration", "acceleration, up; 0 at rest"),
    Channel("v_x_m_s", "m/s", "world", "velocity", "ground velocity, north"),
    Channel("v_y_m_s", "m/s", "world", "velocity", "ground velocity, west"),
    Channel("v_z_m_s", "m/s", "world", "velocity", "ground velocity, up"),
    Channel("p_x_m", "m", "world", "position", "position north of the origin"),
    Channel("p_y_m", "m", "world", "position", "position west of the origin"),
    Channel("p_z_m", "m", "world", "position", "height above the origin"),
    Channel("height_m", "m", "none", "height", "height above the ground below"),
    Channel("voltage_v", "V", "none", "battery", "battery voltage under load"),
    Channel("current_a", "A", "none", "battery", "battery current"),
    *(
        Channel(f"motor_{k}", "1", "none", "motors", f"command of motor {k} 0..1, numbered as the autopilot does")
        for k in range(1, 5)
    ),
    Channel("mode", "1", "none", "state", "autopilot mode number (custom_mode)"),
    Channel("armed", "1", "none", "state", "1 when armed"),
)

CHANNELS: dict[str, Channel] = {c.name: c for c in _TABLE}
GROUPS: tuple[str, ...] = tuple(dict.fromkeys(c.group for c in _TABLE))
# What people read for the channels a model is judged on.
WORDS: dict[str, str] = {
    "roll_rad": "roll",
    "pitch_rad": "pitch",
    "r_rad_s": "yaw rate",
    "f_x_m_s2": "specific force forward",
    "f_y_m_s2": "specific force left",
    "f_z_m_s2": "specific force up",
    "v_x_m_s": "velocity north",
    "v_y_m_s": "velocity west",
    "v_z_m_s": "velocity up",
    "a_x_m_s2": "acceleration north",
    "a_y_m_s2": "acceleration west",
    "a_z_m_s2": "acceleration up",
}
# What holds its value until the next sample; everything else may be interpolated.
HELD_GROUPS: frozenset[str] = frozenset({"reference", "shaped", "state"})
# Of what an attitude loop is to follow, by its output.
REFERENCE_OF: dict[str, str] = {
    "roll_rad": "roll_ref_rad", "pitch_rad": "pitch_ref_rad", "r_rad_s": "yaw_rate_ref_rad_s",
}  # fmt: skip
INPUTS: tuple[str, ...] = ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle")


def names(group: str) -> tuple[str, ...]:
    """Channel names of one group, in table order."""
    return tuple(c.name for c in _TABLE if c.group == group)
