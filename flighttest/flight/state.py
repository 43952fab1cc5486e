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
from flighttest.mavlink.dialect import Message, dialect, is_armed
from flighttest.mavlink.telemetry import Rule, rules_of

FloatArray = NDArray[np.float64]

VOLTAGE_MEAN_S = 2.0
VOLTAGE_LOST_S = 10.0  # without a new one: then the battery is not known any more
_EKF_REPORT_S = 5.0  # it reports five times a second
_PRESSURE_SCALE_M, _PRESSURE_EXPONENT = 44330.8, 0.190263  # international standard atmosphere
_POSITION, _VELOCITY = names("position"), names("velocity")
_FRESH_S = 1.0  # a preferred message older than this gives way to the next one of its group
# Messages of which more counts than the latest.
_SUMMED = frozenset({"VFR_HUD", "SCALED_PRESSURE", "BATTERY_STATUS", "SYS_STATUS"})


@dataclass(frozen=True)
class VehicleState:
    """World NWU about the zone's origin (home), SI. None: never heard. Ages in vehicle seconds, inf where never heard.

    voltage_v: mean of the last 2 s. height_m: above home. throttle_stick: 0..1 of the pilot's stick, None without RC.
    silence_s: since anything was heard;
    uplink_silence_s: since anything that we sent is known to have arrived.
    position_ok: horizontal position is usable, by the EKF's flags. ekf_ok: attitude and vertical estimates are. tilt_before_rad,
    height_before_m: by the message before the latest one, None where there was none.
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
    uplink_silence_s: float = 0.0
    tilt_before_rad: float | None = None
    height_before_m: float | None = None

    @property
    def tilt_rad(self) -> float | None:
        """Angle between the thrust axis and the vertical."""
        return None if self.attitude_rad is None else _tilt_rad(self.attitude_rad)

    @property
    def speed_m_s(self) -> float | None:
        """Speed over ground, three-dimensional."""
        return None if self.velocity_m_s is None else math.hypot(*self.velocity_m_s)


def _tilt_rad(attitude_rad: tuple[float, float, float]) -> float:
    return math.acos(min(math.cos(attitude_rad[0]) * math.cos(attitude_rad[1]), 1.0))


class _Before:
    """The value of the message before the latest one."""

    def __init__(self) -> None:
        self._message: Message | None = None
        self._value: float | None = None
        self._before: float | None = None

    def of(self, message: Message | None, value: float | None) -> float | None:
        """Take in the latest message's value; the one before it."""
        if message is not None and message is not self._message:
            self._before, self._message, self._value = self._value, message, value
        return self._before


class StateReader:
    """Reads a `VehicleState` from a session. origin_m: the zone's origin in the vehicle's local frame (NWU),
    its height that of home; set when it is known. throttle_channel: RCMAP_THROTTLE."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.origin_m = np.zeros(3)
        self.throttle_channel = 3
        self._voltages: deque[tuple[float, float]] = deque()
        self._voltage_mean_v: float | None = None  # of these, once it is asked for
        self.height_source = ""
        self._climbed_m = 0.0
        self._climb_heard_s: float | None = None
        self._ground_hpa: float | None = None
        self._tilts, self._heights = _Before(), _Before()
        session.listen(self._listen)

    def _listen(self, message: Message, t_s: float) -> None:
        kind = message.get_type()
        if kind not in _SUMMED:
            return
        if kind == "VFR_HUD":
            self._sum_climb(float(message.climb), t_s)
        elif kind == "SCALED_PRESSURE" and (self._ground_hpa is None or not self._armed()):
            before = self._ground_hpa if self._ground_hpa is not None else float(message.press_abs)
            self._ground_hpa = before + 0.1 * (float(message.press_abs) - before)
        if kind not in ("BATTERY_STATUS", "SYS_STATUS"):
            return
        values = self._values_of(message, "battery")
        if values and math.isfinite(values["voltage_v"]):
            self._voltages.append((t_s, values["voltage_v"]))
            self._voltage_mean_v = None
            while self._voltages and t_s - self._voltages[0][0] > VOLTAGE_MEAN_S:
                self._voltages.popleft()

    def _armed(self) -> bool:
        beat = self._session.latest.get("HEARTBEAT")
        return beat is not None and is_armed(beat.message)

    def _sum_climb(self, climb_m_s: float, t_s: float) -> None:
        """Height by summing the climb rate since arming: drifts, but is all there is without a fix, a rangefinder and pressure."""
        if not self._armed():
            self._climbed_m = 0.0
        elif self._climb_heard_s is not None:
            self._climbed_m += climb_m_s * min(t_s - self._climb_heard_s, _FRESH_S)
        self._climb_heard_s = t_s

    def _group(
        self, group: str, messages: tuple[str, ...] | None = None
    ) -> tuple[dict[str, float], float, Message | None]:
        """The freshest values of a group by order of preference, their age, s, and the message that they are from. messages: which may be
        taken, None for all."""
        now = self._session.now_s()
        best: tuple[Rule, float] | None = None
        for rule in rules_of(group):
            heard = self._session.latest.get(rule.message)
            if heard is None or (messages is not None and rule.message not in messages):
                continue
            age = now - heard.t_s
            if age <= _FRESH_S:
                best = (rule, age)
                break
            if best is None or age < best[1]:
                best = (rule, age)
        if best is None:
            return {}, math.inf, None
        message = self._session.latest[best[0].message].message
        values = columns_of(best[0], message)
        return (values, best[1], message) if values is not None else ({}, math.inf, None)

    def read(self) -> VehicleState:
        """The state now."""
        session = self._session
        now = session.now_s()
        beat = session.latest.get("HEARTBEAT")
        angles, attitude_age, attitude_of = self._group("attitude")
        attitude = (angles["roll_rad"], angles["pitch_rad"], angles["yaw_rad"]) if angles else None
        local = session.latest.get("LOCAL_POSITION_NED")
        position = velocity = None
        position_age = math.inf
        if local is not None:
            p = self._values_of(local.message, "position")
            v = self._values_of(local.message, "velocity")
            position = tuple([p[n] - o for n, o in zip(_POSITION, self.origin_m.tolist(), strict=True)])
            velocity = tuple([v[n] for n in _VELOCITY])
            position_age = now - local.t_s
        height, climb, height_of = self._vertical(now, position, velocity, position_age)
        heard = bool(self._voltages) and now - self._voltages[-1][0] <= VOLTAGE_LOST_S
        ekf = session.latest.get("EKF_STATUS_REPORT")
        # A filter that reports no more has no valid position; neither has one that only assumes to stand still.
        informed = ekf is None or now - ekf.t_s <= _EKF_REPORT_S
        flags = int(ekf.message.flags) if ekf and informed else 0
        placed = (
            flags & (dialect.EKF_POS_HORIZ_ABS | dialect.EKF_POS_HORIZ_REL) and not flags & dialect.EKF_CONST_POS_MODE
        )
        return VehicleState(
            t_s=now,
            mode=int(beat.message.custom_mode) if beat else -1,
            armed=beat is not None and is_armed(beat.message),
            mode_age_s=now - beat.t_s if beat else math.inf,
            attitude_rad=attitude,
            attitude_age_s=attitude_age,
            velocity_m_s=velocity,  # type: ignore[arg-type]  # three names, three values
            position_m=position,  # type: ignore[arg-type]
            position_age_s=position_age,
            height_m=height,
            climb_m_s=climb,
            voltage_v=self._mean_voltage_v() if heard else None,
            ekf_ok=ekf is None or bool(flags & dialect.EKF_ATTITUDE),
            position_ok=bool(placed) and local is not None,
            throttle_stick=self._throttle_stick(),
            silence_s=session.silence_s,
            uplink_silence_s=session.uplink_silence_s,
            tilt_before_rad=self._tilts.of(attitude_of, _tilt_rad(attitude) if attitude else None),
            height_before_m=self._heights.of(height_of, height),
        )

    def _mean_voltage_v(self) -> float:
        if self._voltage_mean_v is None:
            self._voltage_mean_v = float(np.mean([v for _, v in self._voltages]))
        return self._voltage_mean_v

    @staticmethod
    def _values_of(message: Message, group: str) -> dict[str, float]:
        kind = message.get_type()
        rule = next(r for r in rules_of(group) if r.message == kind)
        return columns_of(rule, message) or {}

    def _vertical(
        self, now: float, position: tuple[float, ...] | None, velocity: tuple[float, ...] | None, age: float
    ) -> tuple[float | None, float | None, Message | None]:
        """Height above home, climb rate, and the message of the height, by what there is: local position, else a rangefinder, a fix, air
        pressure, summed climb."""
        if position is not None and velocity is not None and age < _FRESH_S:
            self.height_source = "the position estimate"
            return position[2], velocity[2], self._session.latest["LOCAL_POSITION_NED"].message
        climb = self._fresh("VFR_HUD", now)
        climb_m_s = float(climb.climb) if climb is not None else None
        ground, ground_age, ground_of = self._group("height", ("RANGEFINDER", "DISTANCE_SENSOR"))
        fix = self._fresh("GLOBAL_POSITION_INT", now)
        if ground and ground_age < _FRESH_S:
            self.height_source = "a rangefinder"
            return ground["height_m"], climb_m_s, ground_of
        if fix is not None and (fix.lat or fix.lon):
            self.height_source = "the height above home"
            return fix.relative_alt * 1e-3, climb_m_s, fix
        air = self._fresh("SCALED_PRESSURE", now)
        if air is not None and self._ground_hpa is not None:
            self.height_source = "air pressure"
            height_m = _PRESSURE_SCALE_M * (1.0 - (air.press_abs / self._ground_hpa) ** _PRESSURE_EXPONENT)
            return height_m, climb_m_s, air
        if climb is not None:
            self.height_source = "the climb rate, summed up"
            return self._climbed_m, climb_m_s, climb
        return None, None, None

    def _fresh(self, name: str, now: float) -> Message | None:
        heard = self._session.latest.get(name)
        return heard.message if heard is not None and now - heard.t_s < _FRESH_S else None

    def _throttle_stick(self) -> float | None:
        rc = self._fresh("RC_CHANNELS", self._session.now_s())
        pulse_us = getattr(rc, f"chan{self.throttle_channel}_raw", 0)
        if rc is None or rc.chancount < self.throttle_channel or not 800 <= pulse_us <= 2200:
            return None
        return float(min(max((pulse_us - 1000) / 1000.0, 0.0), 1.0))
