"""What each mode that flies by itself asks for: a `Setpoint` for the controllers, renewed fifty times a second."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flighttest.sim.autopilot import modes
from flighttest.sim.autopilot.control import Measured, Setpoint
from flighttest.sim.autopilot.parameters import ParameterStore

_POSITION_TARGET_TIMEOUT_S = 3.0
_FAST_DESCENT_ABOVE_M = 10.0
_RTL_ARRIVED_M = 2.0


@dataclass(slots=True)
class GuidedGoal:
    """A position or velocity target of GUIDED: north, west m or m/s, height m; None where it is not asked for."""

    position: tuple[float, float] | None = None
    velocity: tuple[float, float] | None = None
    height: float | None = None
    climb: float = 0.0
    yaw: float | None = None
    yaw_rate: float | None = None
    stamp_s: float = 0.0


class Navigator:
    """Goals of the modes. `enter` when a mode begins, `setpoint` while it flies."""

    def __init__(self, store: ParameterStore) -> None:
        self._store = store
        self.goal = GuidedGoal()
        self.hold = Setpoint()
        self.take_off_m: float | None = None
        self._returning = True

    def enter(self, mode: int, seen: Measured) -> None:
        """Begin a mode where the vehicle is."""
        stop = math.hypot(seen.vx, seen.vy) / 4.0  # the way it takes to stop at half the acceleration limit
        place = (seen.px + seen.vx * stop * 0.5, seen.py + seen.vy * stop * 0.5)
        self.hold = Setpoint(position=place, height=max(seen.pz, 0.0), yaw=seen.yaw)
        self.goal = GuidedGoal(position=place, height=max(seen.pz, 0.0), yaw=seen.yaw, stamp_s=seen.t_s)
        self.take_off_m = None
        self._returning = True
        if mode == modes.BRAKE:
            self.hold = Setpoint(velocity=(0.0, 0.0), height=max(seen.pz, 0.0), yaw=seen.yaw)

    def setpoint(self, mode: int, seen: Measured, stick_climb: float, has_position: bool) -> Setpoint:
        """What the mode asks for now. stick_climb: m/s that the pilot's throttle stick asks for."""
        if mode == modes.GUIDED:
            return self._guided(seen)
        if mode == modes.LAND:
            return self._land(seen, has_position)
        if mode == modes.RTL:
            return self._return(seen)
        if mode == modes.BRAKE:
            return self._brake(seen)
        hold = self.hold
        if stick_climb:
            hold.height, hold.climb = None, stick_climb
        elif hold.height is None:
            hold.height, hold.climb = seen.pz, 0.0
        if mode == modes.ALT_HOLD:
            return Setpoint(height=hold.height, climb=hold.climb, yaw=hold.yaw)
        return hold

    def _guided(self, seen: Measured) -> Setpoint:
        g, s = self.goal, self._store
        limits = (s["WP_SPD"], s["WP_SPD_UP"], s["WP_SPD_DN"])
        if self.take_off_m is not None:
            if seen.pz > self.take_off_m - 0.3:
                g.height = self.take_off_m
                self.take_off_m = None
            else:
                return Setpoint(g.position, None, self.take_off_m, 0.0, g.yaw, 0.0, *limits)
        if g.velocity is not None and seen.t_s - g.stamp_s > _POSITION_TARGET_TIMEOUT_S:
            g.velocity, g.climb, g.yaw_rate = (0.0, 0.0), 0.0, None
        wanted = Setpoint(g.position, g.velocity, g.height, g.climb, g.yaw, g.yaw_rate or 0.0, *limits)
        if g.yaw_rate is not None:
            wanted.yaw = None
        return wanted

    def _land(self, seen: Measured, has_position: bool) -> Setpoint:
        fast = seen.pz > _FAST_DESCENT_ABOVE_M
        climb = -self._store["WP_SPD_DN"] if fast else -self._store["LAND_SPD_MS"]
        place = self.hold.position if has_position else None
        return Setpoint(position=place, climb=climb, yaw=self.hold.yaw)

    def _return(self, seen: Measured) -> Setpoint:
        away = math.hypot(seen.px, seen.py)
        if self._returning and away > _RTL_ARRIVED_M:
            height = max(self._store["RTL_ALT_M"], seen.pz)
            climbing = seen.pz < height - 1.0
            place = self.hold.position if climbing else (0.0, 0.0)
            return Setpoint(position=place, height=height, yaw=self.hold.yaw)
        self._returning = False
        fast = seen.pz > _FAST_DESCENT_ABOVE_M
        climb = -self._store["WP_SPD_DN"] if fast else -self._store["LAND_SPD_MS"]
        return Setpoint(position=(0.0, 0.0), climb=climb, yaw=self.hold.yaw)

    def _brake(self, seen: Measured) -> Setpoint:
        if self.hold.position is None and math.hypot(seen.vx, seen.vy) < 0.3:
            self.hold.position, self.hold.velocity = (seen.px, seen.py), None
        return self.hold
