"""`Vehicle`: what a person declares about a vehicle and the place it flies in; and the default vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flighttest.recording.manifest import Components


@dataclass(frozen=True)
class Zone:
    """The box that must not be left, m, in its own frame: x along `heading_rad` (NWU yaw), y to the left, z up from the ground.

    origin: None for the home position (as it is at arming; with a polygon, as it was when that was uploaded), else (latitude, longitude)
    in degrees. fence: 'circle' where a fence of the autopilot about home is enough, 'polygon' where one along the zone is brought onto
    the vehicle for each flight.
    """

    heading_rad: float = 0.0
    x_m: tuple[float, float] = (-15.0, 15.0)
    y_m: tuple[float, float] = (-7.5, 7.5)
    z_m: tuple[float, float] = (1.0, 10.0)
    margin_m: float = 1.5
    origin: tuple[float, float] | None = None
    fence: str = "circle"

    def to_world(self, point: ArrayLike) -> NDArray[np.float64]:
        """Zone coordinates to NWU about the zone's origin: (..., 3) m."""
        p = np.asarray(point, dtype=float)
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return np.stack([c * p[..., 0] - s * p[..., 1], s * p[..., 0] + c * p[..., 1], p[..., 2]], axis=-1)

    def outside_m(self, place: ArrayLike) -> float:
        """How far a place (zone coordinates, (3,) m) lies outside of the walls over ground, m; 0 inside."""
        x, y, _ = np.asarray(place, dtype=float)
        (x0, x1), (y0, y1) = self.x_m, self.y_m
        return math.hypot(max(x0 - x, x - x1, 0.0), max(y0 - y, y - y1, 0.0))

    def from_world(self, point: ArrayLike) -> NDArray[np.float64]:
        """NWU about the zone's origin to zone coordinates: (..., 3) m."""
        p = np.asarray(point, dtype=float)
        return np.stack([*self.over_ground(p[..., 0], p[..., 1]), p[..., 2]], axis=-1)

    def over_ground(self, north_m: Any, west_m: Any) -> tuple[Any, Any]:
        """Zone coordinates x and y, m, of a place north and west of the zone's origin, m; numbers or arrays."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return c * north_m + s * west_m, -s * north_m + c * west_m


@dataclass(frozen=True)
class Vehicle:
    """A vehicle as declared in vehicle.yaml. `components` maps battery, propellers, motors, payload, ... to their fields.

    signing_key: path of the file with the key that MAVLink frames are signed with.
    flies: whether all is declared that a flight needs; otherwise zone, firmware and hover throttle are placeholders. weather: 'still' where
    it is only flown in still air, indoors, else 'unknown'."""

    name: str
    connect: str | None
    firmware: str
    nominal_voltage_v: float
    hover_throttle: float
    zone: Zone = field(default_factory=Zone)
    mass_kg: float | None = None
    rotor_height_m: float = 0.2
    components: Components = field(default_factory=dict)
    path: str = ""
    signing_key: str | None = None
    flies: bool = True
    weather: str = "unknown"


# Paper Table 2 at nominal voltage: 9.81 / 54.55 = 0.18. Zone of 30 x 15 x 10 m: paper section 3. Firmware: paper footnote 1.
DEFAULT_VEHICLE = Vehicle(
    name="paper",
    connect="sim",
    firmware="ardupilot",
    nominal_voltage_v=22.2,
    hover_throttle=0.18,
    zone=Zone(),
    mass_kg=2.9,
    components={
        "battery": {"id": "sim", "model": "6S 10 Ah"},
        "propellers": {"id": "sim"},
        "motors": {"id": "sim"},
        "payload": {"id": "none"},
    },
)
