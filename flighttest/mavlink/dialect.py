"""The MAVLink dialect of this package: version 2, ArduPilot's. The only module that imports pymavlink's messages."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

__all__ = [
    "COMPONENT_AUTOPILOT",
    "MULTICOPTERS",
    "Message",
    "dialect",
    "firmware_version",
    "is_armed",
    "is_vehicle",
    "is_warning",
    "parser",
    "vehicle_kind",
]

Message = Any
"""One decoded MAVLink message, as pymavlink makes them: fields are attributes, `get_type()` names it."""

COMPONENT_AUTOPILOT = 1
# What sends HEARTBEATs and does not fly; some of them name an autopilot all the same.
_NO_VEHICLE = frozenset({
    dialect.MAV_TYPE_GCS, dialect.MAV_TYPE_ANTENNA_TRACKER, dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_TYPE_GIMBAL,
    dialect.MAV_TYPE_ADSB, dialect.MAV_TYPE_CAMERA, dialect.MAV_TYPE_CHARGING_STATION, dialect.MAV_TYPE_FLARM,
})  # fmt: skip

MULTICOPTERS = frozenset({
    dialect.MAV_TYPE_QUADROTOR, dialect.MAV_TYPE_HEXAROTOR, dialect.MAV_TYPE_OCTOROTOR, dialect.MAV_TYPE_TRICOPTER,
    dialect.MAV_TYPE_COAXIAL, dialect.MAV_TYPE_DODECAROTOR, dialect.MAV_TYPE_DECAROTOR,
})  # fmt: skip
_KINDS = {
    dialect.MAV_TYPE_FIXED_WING: "a fixed-wing aircraft", dialect.MAV_TYPE_HELICOPTER: "a helicopter",
    dialect.MAV_TYPE_GROUND_ROVER: "a rover", dialect.MAV_TYPE_SURFACE_BOAT: "a boat", dialect.MAV_TYPE_SUBMARINE: "a submarine",
    dialect.MAV_TYPE_AIRSHIP: "an airship", dialect.MAV_TYPE_FREE_BALLOON: "a balloon", dialect.MAV_TYPE_ROCKET: "a rocket",
    **dict.fromkeys(range(dialect.MAV_TYPE_VTOL_DUOROTOR, dialect.MAV_TYPE_VTOL_RESERVED5 + 1), "a VTOL aircraft"),
}  # fmt: skip


def parser(system: int, component: int) -> Any:
    """A fresh encoder and decoder for one end of a link: it never raises on bad bytes, they come out as BAD_DATA."""
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    mav.robust_parsing = True
    return mav


def is_vehicle(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT comes from an autopilot, not from a ground station, an antenna tracker, a gimbal or a companion computer."""
    return bool(heartbeat.autopilot != dialect.MAV_AUTOPILOT_INVALID and heartbeat.type not in _NO_VEHICLE)


def vehicle_kind(mav_type: int) -> str:
    """What a HEARTBEAT's type is, where that is a vehicle but no multirotor; else ''."""
    return _KINDS.get(mav_type, "")


def is_warning(statustext: Message) -> bool:
    """Whether a STATUSTEXT is a warning, or about a fence or failsafe: a breach of the fence is a notice in ArduCopter."""
    about = statustext.text.lower()
    return statustext.severity <= dialect.MAV_SEVERITY_WARNING or "fence" in about or "failsafe" in about


def is_armed(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT shows that the motors are armed."""
    return bool(heartbeat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)


def firmware_version(version: Message) -> str:
    """AUTOPILOT_VERSION as text, such as `4.7.0-dev (97009754)`."""
    number = int(version.flight_sw_version)
    kinds = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}
    text = f"{number >> 24 & 255}.{number >> 16 & 255}.{number >> 8 & 255}{kinds.get(number & 255, '')}"
    raw = bytes(int(b) & 255 for b in version.flight_custom_version).rstrip(b"\0")
    commit = raw.decode("ascii") if raw and all(48 <= b < 123 for b in raw) else raw.hex()
    return f"{text} ({commit})" if commit else text


def board_id(version: Message) -> str:
    """The board's own number of an AUTOPILOT_VERSION in hexadecimal (its newer field, else the older), '' where it states none."""
    newer = bytes(int(b) & 255 for b in getattr(version, "uid2", ()))
    return newer.hex() if any(newer) else f"{int(version.uid):x}" if version.uid else ""
