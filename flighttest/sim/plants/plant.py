"""What a plant is: the moving vehicle with its own inner loops, between the autopilot's commands and what instruments see.

World NWU, body FLU, SI and radians. A plant integrates as finely as it needs inside `advance`; the autopilot calls it with
intervals in which the command does not change, so edges are never rounded to a step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, Required, TypedDict

from flighttest.frames import G_M_S2
from flighttest.sim.plants.battery import Battery

Hidden = Mapping[str, Mapping[str, float]]


class IdentifiedVehicle(TypedDict, total=False):
    """A model to fly: its terms, the value of every parameter, constants of `physics.Model`, fields of `Battery` and `SensorNoise`; frame:
    of a vehicle flown motor by motor (`plant_frame.FramePlant`)."""

    terms: Required[list[str]]
    values: Required[dict[str, float]]
    constants: Required[ModelConstants]
    battery: BatteryFields
    noise: dict[str, float]
    frame: dict[str, float]


class ModelConstants(TypedDict, total=False):
    """Fields of `physics.Model`."""

    nominal_voltage_v: float
    g_m_s2: float
    channel_delays: bool
    attitude_loops: bool
    rotor_height_m: float


class BatteryFields(TypedDict, total=False):
    """Fields of `Battery`."""

    cells: int
    resistance_ohm: float


"""Concealed physics: catalogue id to its values, by key; keys left out take the plant's default magnitude."""


@dataclass(slots=True)
class Command:
    """What the autopilot asks of its inner loops: roll, pitch rad; yaw_rate rad/s; throttle 0..1; spinning: motors turn."""

    roll: float = 0.0
    pitch: float = 0.0
    yaw_rate: float = 0.0
    throttle: float = 0.0
    spinning: bool = False


@dataclass(slots=True)
class Motion:
    """What perfect instruments of this vehicle would report (so a biased accelerometer reports its bias).

    p: position m, height above the ground is pz; v: velocity m/s; roll, pitch, yaw rad; p, q, r: body rates rad/s; f: specific
    force m/s^2; shaped_*: the attitude target after the vehicle's own shaping; boost: what the throttle is multiplied by
    on its way to the motors; voltage V and current A at the battery's sensor.
    """

    px: float = 0.0
    py: float = 0.0
    pz: float = 0.0
    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    p: float = 0.0
    q: float = 0.0
    r: float = 0.0
    fx: float = 0.0
    fy: float = 0.0
    fz: float = G_M_S2
    shaped_roll: float = 0.0
    shaped_pitch: float = 0.0
    shaped_yaw_rate: float = 0.0
    voltage: float = 0.0
    current: float = 0.0
    on_ground: bool = True
    impact_m_s: float = 0.0


@dataclass(frozen=True)
class Delays:
    """Seconds from a target's arrival to its effect, by channel."""

    attitude_s: float = 0.0
    yaw_rate_s: float = 0.0
    thrust_s: float = 0.0


class Plant(Protocol):
    """A vehicle in motion. tick_s: the autopilot's loop time with this plant; hover_throttle: at a full battery's voltage."""

    motion: Motion
    battery: Battery
    tick_s: float
    delays: Delays
    hover_throttle: float

    def advance(self, dt_s: float, command: Command) -> None:
        """Move on by dt_s, s, under a constant command."""

    def replace_battery(self, voltage_v: float | None = None) -> None:
        """A full battery, or one that rests at the given voltage, V."""
