"""Position, velocity and height control of the modes that fly by themselves: measured state in, attitude and throttle out.

Cascades as ArduCopter's position controller has them (position P with a speed limit, velocity PI, acceleration to tilt and throttle),
plain enough to be read in one go. NWU, SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from flighttest.frames import G_M_S2
from flighttest.sim.plants.plant import Command

_POS_P, _VEL_P, _VEL_I = 1.0, 1.6, 0.5
_HEIGHT_P, _CLIMB_P, _CLIMB_I = 1.0, 3.5, 1.5
_YAW_P = 4.5
_YAW_RATE_MAX = math.radians(90.0)
_ACCEL_MAX = 4.0
_TILT_MAX = math.radians(30.0)


@dataclass(slots=True)
class Measured:
    """What the controllers see: position m, velocity m/s, heading rad, at time t_s."""

    t_s: float
    px: float
    py: float
    pz: float
    vx: float
    vy: float
    vz: float
    yaw: float


@dataclass(slots=True)
class Setpoint:
    """What is wanted. position/velocity (north, west) m, m/s: None where not controlled; height m or climb m/s; yaw rad or yaw_rate."""

    position: tuple[float, float] | None = None
    velocity: tuple[float, float] | None = None
    height: float | None = None
    climb: float = 0.0
    yaw: float | None = None
    yaw_rate: float = 0.0
    speed_max: float = 5.0
    climb_max: float = 2.5
    descent_max: float = 1.5


def heading_rate(yaw_wanted: float, yaw: float) -> float:
    """Yaw rate, rad/s, that turns to a heading."""
    error = math.remainder(yaw_wanted - yaw, math.tau)
    return min(max(_YAW_P * error, -_YAW_RATE_MAX), _YAW_RATE_MAX)


@dataclass(slots=True)
class PositionControl:
    """Controllers with their integrals. hover: throttle that carries the weight as far as known, learnt in hover."""

    hover: float
    _integral: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def reset(self) -> None:
        """Forget the integrals of the horizontal axes; what holds the weight stays."""
        self._integral[0] = self._integral[1] = 0.0

    def update(self, dt_s: float, wanted: Setpoint, seen: Measured, out: Command) -> None:
        """Set attitude, yaw rate and throttle of `out`."""
        self._tilt(dt_s, wanted, seen, out)
        self.vertical(dt_s, wanted, seen, out)
        out.yaw_rate = wanted.yaw_rate if wanted.yaw is None else heading_rate(wanted.yaw, seen.yaw)

    def level(self, dt_s: float, wanted: Setpoint, seen: Measured, out: Command) -> None:
        """Height or climb rate only: level, heading held."""
        out.roll = out.pitch = 0.0
        self.vertical(dt_s, wanted, seen, out)
        out.yaw_rate = wanted.yaw_rate if wanted.yaw is None else heading_rate(wanted.yaw, seen.yaw)

    def _tilt(self, dt_s: float, wanted: Setpoint, seen: Measured, out: Command) -> None:
        vx, vy = wanted.velocity or (0.0, 0.0)
        if wanted.position is not None:
            ex, ey = wanted.position[0] - seen.px, wanted.position[1] - seen.py
            distance = math.hypot(ex, ey)
            # a square-root approach: as fast as half the acceleration limit can stop
            speed = min(_POS_P * distance, math.sqrt(_ACCEL_MAX * distance), wanted.speed_max)
            if distance > 1e-6:
                vx, vy = vx + ex / distance * speed, vy + ey / distance * speed
        i = self._integral
        dvx, dvy = vx - seen.vx, vy - seen.vy
        ax, ay = _VEL_P * dvx + i[0], _VEL_P * dvy + i[1]
        size = math.hypot(ax, ay)
        if size > _ACCEL_MAX:
            ax, ay = ax * _ACCEL_MAX / size, ay * _ACCEL_MAX / size
        else:
            i[0] += _VEL_I * dvx * dt_s
            i[1] += _VEL_I * dvy * dt_s
        c, s = math.cos(seen.yaw), math.sin(seen.yaw)
        forward, left = c * ax + s * ay, c * ay - s * ax
        out.pitch = min(max(math.atan2(forward, G_M_S2), -_TILT_MAX), _TILT_MAX)
        out.roll = -min(max(math.atan2(left, G_M_S2), -_TILT_MAX), _TILT_MAX)

    def vertical(self, dt_s: float, wanted: Setpoint, seen: Measured, out: Command) -> None:
        """Height or climb rate by the throttle, whatever the attitude that `out` asks for."""
        climb = wanted.climb
        if wanted.height is not None:
            error = wanted.height - seen.pz
            speed = min(_HEIGHT_P * abs(error), math.sqrt(2.0 * abs(error)))
            climb += math.copysign(speed, error)
        climb = min(max(climb, -wanted.descent_max), wanted.climb_max)
        error = climb - seen.vz
        accel = min(max(_CLIMB_P * error, -5.0), 8.0)
        if abs(error) < 2.0:
            self._integral[2] = min(max(self._integral[2] + _CLIMB_I * error * dt_s, -6.0), 6.0)
        if abs(error) < 0.5 and abs(climb) < 0.5:
            # hover learning as MOT_HOVER_LEARN: the integral moves into the hover throttle, over ten seconds
            move = self._integral[2] * min(dt_s / 10.0, 1.0)
            self._integral[2] -= move
            self.hover *= 1.0 + move / G_M_S2
        carry = self.hover * (1.0 + (accel + self._integral[2]) / G_M_S2)
        out.throttle = min(max(carry / max(math.cos(out.roll) * math.cos(out.pitch), 0.5), 0.0), 1.0)
