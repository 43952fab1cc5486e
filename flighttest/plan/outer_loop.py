"""The outer loop (position loop) over attitude targets that flies free flight, and brings a vehicle back where the autopilot holds no
position.

Position error to velocity, velocity error to acceleration, acceleration to tilt and throttle. Gains are slow against the paper's
attitude loops (25 rad/s) and delay (0.1 s), so that it stays stable on any airframe this package can fly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flighttest.frames import G_M_S2

FloatArray = NDArray[np.float64]


class Moving(NamedTuple):
    """Where vehicles are and how they move: position, velocity (n, 3) in the world, NWU, and yaw (n,)."""

    p_m: ArrayLike
    v_m_s: ArrayLike
    yaw_rad: ArrayLike


@dataclass(frozen=True)
class OuterLoop:
    """Gains 1/s and bounds. tilt_max_rad bounds roll and pitch each; speed_max_m_s the velocity asked for."""

    position_gain: float = 1.0
    velocity_gain: float = 2.2
    tilt_max_rad: float = 0.35
    speed_max_m_s: float = 4.0
    climb_max_m_s: float = 2.0
    yaw_gain: float = 1.0
    yaw_rate_max_rad_s: float = 0.8

    def steer(self, now: Moving, goal: Moving, hover_throttle: ArrayLike, angle_boost: bool = False) -> FloatArray:
        """Targets (n, 4) - roll, pitch, yaw rate, throttle - that bring n vehicles to their goals.

        One vehicle may be given without the leading axis; the result then is (1, 4).
        """
        p, v = np.atleast_2d(np.asarray(now.p_m, float)), np.atleast_2d(np.asarray(now.v_m_s, float))
        to, to_v = np.atleast_2d(np.asarray(goal.p_m, float)), np.atleast_2d(np.asarray(goal.v_m_s, float))
        wanted = to_v + self.position_gain * (to - p)
        flat = np.linalg.norm(wanted[:, :2], axis=1, keepdims=True)
        wanted = np.column_stack(
            [
                wanted[:, :2] * np.minimum(1.0, self.speed_max_m_s / np.maximum(flat, 1e-9)),
                np.clip(wanted[:, 2], -self.climb_max_m_s, self.climb_max_m_s),
            ]
        )
        a = self.velocity_gain * (wanted - v)
        yaw = np.broadcast_to(np.asarray(now.yaw_rad, float), p.shape[:1])
        c, s = np.cos(yaw), np.sin(yaw)
        forward, left = c * a[:, 0] + s * a[:, 1], -s * a[:, 0] + c * a[:, 1]
        # Nose down (positive pitch) accelerates forward, left side up (positive roll) accelerates to the right.
        lift = G_M_S2 + np.clip(a[:, 2], -0.4 * G_M_S2, 0.4 * G_M_S2)
        pitch = np.clip(np.arctan2(forward, lift), -self.tilt_max_rad, self.tilt_max_rad)
        roll = np.clip(np.arctan2(-left, lift), -self.tilt_max_rad, self.tilt_max_rad)
        throttle = np.asarray(hover_throttle, float) * lift / G_M_S2
        if not angle_boost:
            throttle = throttle / (np.cos(roll) * np.cos(pitch))
        turn = (np.asarray(goal.yaw_rad, float) - yaw + math.pi) % (2.0 * math.pi) - math.pi
        yaw_rate = np.clip(self.yaw_gain * turn, -self.yaw_rate_max_rad_s, self.yaw_rate_max_rad_s)
        return np.stack(np.broadcast_arrays(roll, pitch, yaw_rate, throttle), axis=-1)


def along(waypoints: tuple[tuple[float, float, float, float], ...], t_s: float) -> tuple[FloatArray, FloatArray]:
    """Where a timed path (t_s, x, y, z) is at t_s, and how fast it moves: two (3,) vectors in the path's own frame."""
    place, speed = all_along(waypoints, np.array([t_s]))
    return place[0], speed[0]


def all_along(
    waypoints: tuple[tuple[float, float, float, float], ...], t_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The same at many times (m,): two (m, 3)."""
    path = np.asarray(waypoints, dtype=float)
    times = path[:, 0]
    place = np.stack([np.interp(t_s, times, path[:, k]) for k in (1, 2, 3)], axis=1)
    index = np.searchsorted(times, t_s, side="right") - 1
    moving = (index >= 0) & (index < len(times) - 1)
    speed = np.zeros_like(place)
    if len(times) > 1:
        each = np.diff(path[:, 1:], axis=0) / np.diff(times)[:, None]
        speed[moving] = each[index[moving]]
    return place, speed
