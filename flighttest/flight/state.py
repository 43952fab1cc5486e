"""`VehicleState`: what is known of the vehicle at one moment, with the age of each piece; and how it is read from a session."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import names
from flighttest.link.session import Session
from flighttest.mavlink import columns_of
from flighttest.mavlink.dialect import Message, book, is_armed
from flighttest.mavlink.telemetry import Rule, rules_of

FloatArray = NDArray[np.float64]

VOLTAGE_MEAN_S = 2.0
_FRESH_S = 1.0  # a preferred message older than this gives way to the next one of its group


@dataclass(frozen=True)
class VehicleState:
    """World NWU about the zone's origin (home), SI. None: never heard. Ages in vehicle seconds, inf where never heard.

    voltage_v: mean of the last 2 s. height_m: above home. throttle_stick: 0..1 of the pilot's stick, None without RC.
    position_ok: the EKF says that horizontal position is usable. ekf_ok: attitude and vertical estimates are.
    """

    t_s: float
    mode: int = -1
    armed: bool = False
    mode_age_s: float = math.inf
    attitude_rad: tuple[float, float, float] | None = None
    attitude_age_s: float = math.inf
    velocity_m_s: tuple[float, float, float] | None = None
    position_m: tuple[float, float, float] | None = None
    position_age_s: float = math.inf
    height_m: float | None = None
    climb_m_s: float | None = None
    voltage_v: float | None = None
    ekf_ok: bool = True
    position_ok: bool = False
    throttle_stick: float | None = None
    silence_s: float = 0.0

    @property
    def tilt_rad(self) -> float | None:
        """Angle between the thrust axis and the vertical."""
        if self.attitude_rad is None:
            return None
        return math.acos(min(1.0, math.cos(self.attitude_rad[0]) * math.cos(self.attitude_rad[1])))

    @property
    def speed_m_s(self) -> float | None:
        """Speed over ground, three-dimensional."""
        return None if self.velocity_m_s is None else math.hypot(*self.velocity_m_s)


class StateReader:
    """Reads a `VehicleState` from a session. origin_m: the zone's origin in the vehicle's local frame (NWU),
    its height that of home; set when it is known."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.origin_m = np.zeros(3)
        self._voltages: deque[tuple[float, float]] = deque()
        session.listen(self._listen)

    def _listen(self, message: Message, t_s: float) -> None:
        if message.get_type() not in ("BATTERY_STATUS", "SYS_STATUS"):
            return
        rule = next(r for r in rules_of("battery") if r.message == message.get_type())
        values = columns_of(rule, message)
        if values and math.isfinite(values["voltage_v"]):
            self._voltages.append((t_s, values["voltage_v"]))
            while self._voltages and t_s - self._voltages[0][0] > VOLTAGE_MEAN_S:
                self._voltages.popleft()

    def _group(self, group: str) -> tuple[dict[str, float], float]:
        """The freshest values of a group by order of preference, and their age, s."""
        now = self._session.now_s()
        best: tuple[Rule, float] | None = None
        for rule in rules_of(group):
            heard = self._session.latest.get(rule.message)
            if heard is None:
                continue
            age = now - heard.t_s
            if age <= _FRESH_S:
                best = (rule, age)
                break
            if best is None or age < best[1]:
                best = (rule, age)
        if best is None:
            return {}, math.inf
        values = columns_of(best[0], self._session.latest[best[0].message].message)
        return (values, best[1]) if values is not None else ({}, math.inf)

    def read(self) -> VehicleState:
        """The state now."""
        session = self._session
        now = session.now_s()
        beat = session.latest.get("HEARTBEAT")
        attitude, attitude_age = self._group("attitude")
        local = session.latest.get("LOCAL_POSITION_NED")
        position = velocity = None
        position_age = math.inf
        if local is not None:
            p, _ = self._group_of(local.message, "position")
            v, _ = self._group_of(local.message, "velocity")
            position = tuple(float(x) for x in np.array([p[n] for n in names("position")]) - self.origin_m)
            velocity = tuple(v[n] for n in names("velocity"))
            position_age = now - local.t_s
        height, climb = self._vertical(now, position, velocity, position_age)
        voltages = [v for _, v in self._voltages]
        ekf = session.latest.get("EKF_STATUS_REPORT")
        flags = int(ekf.message.flags) if ekf else 0
        return VehicleState(
            t_s=now,
            mode=int(beat.message.custom_mode) if beat else -1,
            armed=beat is not None and is_armed(beat.message),
            mode_age_s=now - beat.t_s if beat else math.inf,
            attitude_rad=(attitude["roll_rad"], attitude["pitch_rad"], attitude["yaw_rad"]) if attitude else None,
            attitude_age_s=attitude_age,
            velocity_m_s=velocity,  # type: ignore[arg-type]  # three names, three values
            position_m=position,  # type: ignore[arg-type]
            position_age_s=position_age,
            height_m=height,
            climb_m_s=climb,
            voltage_v=float(np.mean(voltages)) if voltages else None,
            ekf_ok=ekf is None or bool(flags & book.EKF_ATTITUDE),
            position_ok=bool(flags & (book.EKF_POS_HORIZ_ABS | book.EKF_POS_HORIZ_REL)) and local is not None,
            throttle_stick=self._throttle_stick(),
            silence_s=session.silence_s,
        )

    @staticmethod
    def _group_of(message: Message, group: str) -> tuple[dict[str, float], Rule]:
        rule = next(r for r in rules_of(group) if r.message == message.get_type())
        return columns_of(rule, message) or {}, rule

    def _vertical(
        self, now: float, position: tuple[float, ...] | None, velocity: tuple[float, ...] | None, age: float
    ) -> tuple[float | None, float | None]:
        """Height above home and climb rate: from the local position, else from VFR_HUD, as it is without a satellite fix."""
        if position is not None and velocity is not None and age < _FRESH_S:
            return position[2], velocity[2]
        whole = self._session.latest.get("GLOBAL_POSITION_INT")
        hud = self._session.latest.get("VFR_HUD")
        height = None
        if whole is not None and now - whole.t_s < _FRESH_S:
            height = whole.message.relative_alt * 1e-3
        climb = float(hud.message.climb) if hud is not None and now - hud.t_s < _FRESH_S else None
        return height, climb

    def _throttle_stick(self) -> float | None:
        rc = self._session.latest.get("RC_CHANNELS")
        if rc is None or rc.message.chancount < 3 or not 800 <= rc.message.chan3_raw <= 2200:
            return None
        return float(min(max((rc.message.chan3_raw - 1000) / 1000.0, 0.0), 1.0))
