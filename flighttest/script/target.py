"""The attitude target: what is asked of the vehicle at one moment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AttitudeTarget:
    """One target, NWU/FLU: attitude references rad, yaw rate rad/s (left positive), throttle 0..1, t_s from the leg's start."""

    t_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rate_rad_s: float
    throttle: float
