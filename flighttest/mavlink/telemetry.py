"""What each telemetry message measures: the one table from MAVLink fields to channels, with degE7, centimetres and signs.

A `Rule` names a message, the fields it needs, where its time stamp is, and how n messages become channels. Rules of one group
stand in order of preference: a recording takes the first that was received well, the live state takes whatever came last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from flighttest import frames
from flighttest.mavlink.targets import attitude_columns

FloatArray = NDArray[np.float64]
Raw = Mapping[str, FloatArray]
ChannelColumns = dict[str, FloatArray]

STANDARD_GRAVITY = 9.80665  # m/s^2 in one g, as ArduPilot's milli-g are made
EARTH_RADIUS_M = 6378137.0  # WGS84 equatorial, as in ArduPilot (LOCATION_SCALING_FACTOR)
_FACING_DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270
_UNKNOWN_CELL_MV = 65535
LEAST_BATTERY_V = 1.0  # an autopilot without a battery monitor reports zero
NO_BATTERY = "the battery voltage reads zero throughout: no battery monitor was set up"


@dataclass(frozen=True)
class Rule:
    """How one kind of message becomes channels of one group.

    stamp: the field with the vehicle's time (`time_boot_ms`, `time_usec`), or None where only the receive time is known.
    fields become arrays (n,) or (n, k) in `raw`; `convert` returns channel name to (n,) SI values in NWU/FLU. keep: which
    samples belong to this group at all. note: a sentence for the reader where the channel is derived, else empty. elementwise: `convert`
    takes the plain numbers of a single message as well, and gives such.
    """

    group: str
    message: str
    stamp: Literal["time_boot_ms", "time_usec"] | None
    fields: tuple[str, ...]
    convert: Callable[[Raw], ChannelColumns]
    keep: Callable[[Raw], NDArray[np.bool_]] | None = None
    note: str = ""
    elementwise: bool = False


def _double(values: Any) -> Any:
    return values if isinstance(values, float) else np.asarray(values, dtype=float)


def _vector(raw: Raw, names: tuple[str, str, str]) -> tuple[Any, Any, Any]:
    """Three fields as the components of a vector in NWU/FLU, numbers or arrays."""
    return frames.flip_components(*(_double(raw[n]) for n in names))


def _attitude(raw: Raw) -> ChannelColumns:
    roll, pitch, yaw = _vector(raw, _RPY)
    return {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw}


def _attitude_quaternion(raw: Raw) -> ChannelColumns:
    roll, pitch, yaw = attitude_columns(np.stack([raw[f"q{i}"] for i in (1, 2, 3, 4)], axis=-1))
    return {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw}


def _rates(raw: Raw) -> ChannelColumns:
    p, q, r = _vector(raw, _BODY_RATES)
    return {"p_rad_s": p, "q_rad_s": q, "r_rad_s": r}


def _specific_force(scale: float) -> Callable[[Raw], ChannelColumns]:
    def convert(raw: Raw) -> ChannelColumns:
        x, y, z = _vector(raw, _XYZ)
        return {"f_x_m_s2": x * scale, "f_y_m_s2": y * scale, "f_z_m_s2": z * scale}

    return convert


def _velocity(scale: float) -> Callable[[Raw], ChannelColumns]:
    def convert(raw: Raw) -> ChannelColumns:
        x, y, z = _vector(raw, _V)
        return {"v_x_m_s": x * scale, "v_y_m_s": y * scale, "v_z_m_s": z * scale}

    return convert


def _local_position(raw: Raw) -> ChannelColumns:
    x, y, z = _vector(raw, ("x", "y", "z"))
    return {"p_x_m": x, "p_y_m": y, "p_z_m": z}


def _global_position(raw: Raw) -> ChannelColumns:
    """Relative to the first fix: good for a flight of some hundred metres."""
    north, west = offset_m(raw["lat"][0] * 1e-7, raw["lon"][0] * 1e-7, raw["lat"] * 1e-7, raw["lon"] * 1e-7)
    return {"p_x_m": north, "p_y_m": west, "p_z_m": raw["relative_alt"] * 1e-3}


def offset_m(lat0_deg: float, lon0_deg: float, lat_deg: Any, lon_deg: Any) -> tuple[Any, Any]:
    """North and west offset, m, of a position from an origin, both in degrees; flat earth, as ArduPilot does it."""
    metres_per_deg = math.radians(1.0) * EARTH_RADIUS_M
    north = (np.asarray(lat_deg) - lat0_deg) * metres_per_deg
    east = (np.asarray(lon_deg) - lon0_deg) * metres_per_deg * math.cos(math.radians(lat0_deg))
    return north, -east


def place_deg(lat0_deg: float, lon0_deg: float, north_m: float, west_m: float) -> tuple[float, float]:
    """The reverse of `offset_m`: latitude and longitude, degrees."""
    metres_per_deg = math.radians(1.0) * EARTH_RADIUS_M
    east = -west_m / (metres_per_deg * math.cos(math.radians(lat0_deg)))
    return lat0_deg + north_m / metres_per_deg, lon0_deg + east


def _shaped(raw: Raw) -> ChannelColumns:
    roll, pitch, _ = attitude_columns(raw["q"])
    rates = frames.flip_vector(np.stack([raw["body_yaw_rate"]] * 3, axis=-1))
    return {"roll_shaped_rad": roll, "pitch_shaped_rad": pitch, "yaw_rate_shaped_rad_s": rates[..., 2]}


def _navigation(raw: Raw) -> ChannelColumns:
    """ArduCopter puts the attitude controller's target there, degrees."""
    euler = frames.flip_euler(np.radians(np.stack([raw["nav_roll"], raw["nav_pitch"], 0.0 * raw["nav_roll"]], axis=-1)))
    return {"roll_shaped_rad": euler[..., 0], "pitch_shaped_rad": euler[..., 1]}


def _battery(raw: Raw) -> ChannelColumns:
    """A pack of more than ten cells goes on in voltages_ext, where what is not there is zero."""
    cells = np.concatenate([raw["voltages"], raw["voltages_ext"]], axis=-1).astype(float)
    current = raw["current_battery"]
    return {
        "voltage_v": np.where(cells != _UNKNOWN_CELL_MV, cells, 0.0).sum(axis=-1) * 1e-3,
        "current_a": np.where(current < 0, np.nan, current * 1e-2),
    }


def _system_status(raw: Raw) -> ChannelColumns:
    voltage, current = raw["voltage_battery"], raw["current_battery"]
    return {"voltage_v": voltage * 1e-3, "current_a": np.where(current < 0, np.nan, current * 1e-2)}


def motor_columns(outputs_us: FloatArray) -> ChannelColumns:
    """Commands 0..1 of four motors from the pulses of their outputs, us (n, 4), by the range of 1000 to 2000 that motors have by default;
    not a number where an output is off."""
    command = np.where(outputs_us > 0.0, np.clip((outputs_us - 1000.0) / 1000.0, 0.0, 1.0), np.nan)
    return {f"motor_{k + 1}": command[:, k] for k in range(4)}


def _first_outputs(raw: Raw) -> NDArray[np.bool_]:
    return np.asarray((raw["port"] == 0) & (np.stack([raw[n] for n in _SERVOS], axis=-1) > 0).all(axis=-1))


def _has_fix(raw: Raw) -> NDArray[np.bool_]:
    """Without a satellite fix GLOBAL_POSITION_INT is sent all the same, with zeros that mean nothing."""
    return np.asarray((raw["lat"] != 0) | (raw["lon"] != 0))


def _first_battery(raw: Raw) -> NDArray[np.bool_]:
    return np.asarray((raw["id"] == 0) & (_battery(raw)["voltage_v"] > LEAST_BATTERY_V))


def _monitored(raw: Raw) -> NDArray[np.bool_]:
    voltage = raw["voltage_battery"]
    return np.asarray((voltage != _UNKNOWN_CELL_MV) & (voltage * 1e-3 > LEAST_BATTERY_V))


def _looking_down(raw: Raw) -> NDArray[np.bool_]:
    inside = (raw["current_distance"] > raw["min_distance"]) & (raw["current_distance"] < raw["max_distance"])
    return np.asarray((raw["orientation"] == _FACING_DOWN) & inside)


_XYZ = ("xacc", "yacc", "zacc")
_V = ("vx", "vy", "vz")
_RPY = ("roll", "pitch", "yaw")
_BODY_RATES = ("rollspeed", "pitchspeed", "yawspeed")
_Q = ("q1", "q2", "q3", "q4")
_SERVOS = ("servo1_raw", "servo2_raw", "servo3_raw", "servo4_raw")

RULES: tuple[Rule, ...] = (
    Rule("attitude", "ATTITUDE", "time_boot_ms", _RPY, _attitude, elementwise=True),
    Rule("attitude", "ATTITUDE_QUATERNION", "time_boot_ms", _Q, _attitude_quaternion),
    Rule("rates", "ATTITUDE", "time_boot_ms", _BODY_RATES, _rates),
    Rule("rates", "ATTITUDE_QUATERNION", "time_boot_ms", _BODY_RATES, _rates),
    Rule("specific_force", "HIGHRES_IMU", "time_usec", _XYZ, _specific_force(1.0)),
    Rule("specific_force", "SCALED_IMU", "time_boot_ms", _XYZ, _specific_force(1e-3 * STANDARD_GRAVITY)),
    Rule("specific_force", "RAW_IMU", "time_usec", _XYZ, _specific_force(1e-3 * STANDARD_GRAVITY)),
    Rule("velocity", "LOCAL_POSITION_NED", "time_boot_ms", _V, _velocity(1.0), elementwise=True),
    Rule("velocity", "GLOBAL_POSITION_INT", "time_boot_ms", (*_V, "lat", "lon"), _velocity(1e-2), keep=_has_fix),
    Rule(
        "velocity",
        "VFR_HUD",
        None,
        ("climb",),
        lambda raw: {"v_z_m_s": raw["climb"]},
        note="climb rate of VFR_HUD: no horizontal velocity was recorded",
    ),
    Rule("position", "LOCAL_POSITION_NED", "time_boot_ms", ("x", "y", "z"), _local_position, elementwise=True),
    Rule(
        "position",
        "GLOBAL_POSITION_INT",
        "time_boot_ms",
        ("lat", "lon", "relative_alt"),
        _global_position,
        keep=_has_fix,
        note="position relative to the first fix, from GLOBAL_POSITION_INT",
    ),
    Rule(
        "height",
        "RANGEFINDER",
        None,
        ("distance",),
        lambda raw: {"height_m": raw["distance"]},
        keep=lambda raw: np.asarray(raw["distance"] > 0),  # old firmware reports zero where there is none
    ),
    Rule(
        "height",
        "DISTANCE_SENSOR",
        "time_boot_ms",
        ("current_distance", "min_distance", "max_distance", "orientation"),
        lambda raw: {"height_m": raw["current_distance"] * 1e-2},
        keep=_looking_down,
    ),
    Rule(
        "height",
        "LOCAL_POSITION_NED",
        "time_boot_ms",
        ("z",),
        lambda raw: {"height_m": -raw["z"]},
        note="height above the local origin (LOCAL_POSITION_NED), taken as level ground",
    ),
    Rule(
        "height",
        "GLOBAL_POSITION_INT",
        "time_boot_ms",
        ("relative_alt", "lat", "lon"),
        lambda raw: {"height_m": raw["relative_alt"] * 1e-3},
        keep=_has_fix,
        note="height above home (GLOBAL_POSITION_INT), taken as level ground",
    ),
    Rule(
        "battery",
        "BATTERY_STATUS",
        None,
        ("id", "voltages", "voltages_ext", "current_battery"),
        _battery,
        keep=_first_battery,
    ),
    Rule("battery", "SYS_STATUS", None, ("voltage_battery", "current_battery"), _system_status, keep=_monitored),
    Rule(
        "motors",
        "SERVO_OUTPUT_RAW",
        None,  # time_usec begins anew after 71 minutes
        ("port", *_SERVOS),
        lambda raw: motor_columns(np.stack([raw[n] for n in _SERVOS], axis=-1)),
        keep=_first_outputs,
    ),
    Rule("shaped", "ATTITUDE_TARGET", "time_boot_ms", ("q", "body_yaw_rate"), _shaped),
    Rule(
        "shaped",
        "NAV_CONTROLLER_OUTPUT",
        None,
        ("nav_roll", "nav_pitch"),
        _navigation,
        note="the autopilot's target in NAV_CONTROLLER_OUTPUT",
    ),
)

STAMP_SCALE: dict[str, float] = {"time_boot_ms": 1e-3, "time_usec": 1e-6}


_BY_GROUP: dict[str, tuple[Rule, ...]] = {
    group: tuple(rule for rule in RULES if rule.group == group) for group in dict.fromkeys(r.group for r in RULES)
}


def rules_of(group: str) -> tuple[Rule, ...]:
    """The rules of one group, best first."""
    return _BY_GROUP.get(group, ())


def columns_of(rule: Rule, message: Any) -> dict[str, float] | None:
    """Channels of one message under a rule, for the live state; None where the message does not belong to the group."""
    if rule.elementwise:
        plain: Any = {name: float(getattr(message, name)) for name in rule.fields}
        found: Any = rule.convert(plain)
        return cast("dict[str, float]", found)
    raw = {name: np.asarray([getattr(message, name)], dtype=float) for name in rule.fields}
    if rule.keep is not None and not bool(rule.keep(raw)[0]):
        return None
    return {name: float(values[0]) for name, values in rule.convert(raw).items()}
