"""What the autopilot does on its own to be safe: arming checks, crash check, battery. Pure functions of what is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flighttest.sim.autopilot import modes
from flighttest.sim.autopilot.parameters import ParameterStore

READY_S = 23.5  # flown on a real SITL: arming is refused for 20 to 25 s after boot
ORIGIN_S = 20.0  # flown: origin and home are set by the first good fix
GPS_S = 41.0  # flown: LOCAL_POSITION_NED starts 41 s after boot
MODE_SWITCH_S = 3.0  # the RC mode switch is read for the first time: an earlier mode is undone
LIFT_S = 2.0  # flown: motors lift about 2 s after arming


@dataclass(frozen=True)
class Boot:
    """When things work, s after boot."""

    ready_s: float = READY_S
    gps_s: float = GPS_S
    mode_switch_s: float = MODE_SWITCH_S


def arming_refusal(
    t_s: float, boot: Boot, mode: int, store: ParameterStore, voltage_v: float, *, has_position: bool
) -> str | None:
    """Why the motors may not be armed, in the firmware's words, or None when they may."""
    if mode in modes.NO_ARMING:
        return f"Arm: {modes.NAMES[mode]} mode not armable"
    if not store["ARMING_CHECK"]:
        return None
    if t_s < boot.mode_switch_s:
        return "Arm: Initialising"
    if t_s < boot.ready_s - 10.0:
        return "Arm: Accels inconsistent"
    if t_s < boot.ready_s:
        return "Arm: Gyros inconsistent"
    if mode in modes.NEEDS_POSITION and not has_position:
        return "Arm: Need Position Estimate"
    low = store["BATT_LOW_VOLT"]
    if low > 0.0 and voltage_v < low:
        return "Arm: Battery 1 low voltage failsafe"
    return None


class CrashCheck:
    """Two seconds of attitude error above 30 deg, leaning, slow and without acceleration: this vehicle lies on its side."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def update(self, t_s: float, error_rad: float, lean_rad: float, speed_m_s: float, accel_m_s2: float) -> bool:
        """Whether to disarm now. accel: of the vehicle over the ground, m/s^2."""
        suspicious = error_rad > math.radians(30) and lean_rad > math.radians(15) and speed_m_s < 10 and accel_m_s2 < 3
        if not suspicious:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = t_s
        return suspicious and self._since_s is not None and t_s - self._since_s >= 2.0
