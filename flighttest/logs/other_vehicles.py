"""Logs of vehicles that are no multirotors: an autopilot says what it drives, and no model of this program describes that."""

from __future__ import annotations

import re
from collections.abc import Mapping, Set
from pathlib import Path

from flighttest.errors import RecordingError
from flighttest.mavlink.dialect import dialect, vehicle_kind

NO_MULTIROTORS = frozenset({
    dialect.MAV_TYPE_FIXED_WING, dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT, dialect.MAV_TYPE_SUBMARINE,
    dialect.MAV_TYPE_AIRSHIP,
})  # fmt: skip
_WING, _SUBMARINE, _AIRSHIP = map(
    vehicle_kind, (dialect.MAV_TYPE_FIXED_WING, dialect.MAV_TYPE_SUBMARINE, dialect.MAV_TYPE_AIRSHIP)
)
_BY_FIRMWARE = {
    "Plane": _WING,
    "Rover": "a rover or boat",
    "Sub": _SUBMARINE,
    "Blimp": _AIRSHIP,
}  # ArduPilot's, by name
FIRMWARE = re.compile(rf"(Copter|{'|'.join(_BY_FIRMWARE)})\b.*V\d")  # a version string of any of ArduPilot's
_OTHER = re.compile(rf"(?:Ardu|APM:)?({'|'.join(_BY_FIRMWARE)})\b")
_BY_PX4 = {2: _WING, 3: "a rover", 4: _AIRSHIP}  # VehicleStatus.msg, vehicle_type


def refuse_by_firmware(path: Path, firmware: str, parameters: Mapping[str, float]) -> None:
    """RecordingError where ArduPilot's version string is of another vehicle's firmware. A quadplane (Q_ENABLE) hovers as a multirotor."""
    named = _OTHER.match(firmware)
    if named and not parameters.get("Q_ENABLE"):
        _refuse(path, _BY_FIRMWARE[named[1]], firmware)


def refuse_by_type(path: Path, mav_type: int, parameters: Mapping[str, float]) -> None:
    """The same by the type in HEARTBEAT, in which ArduPilot's quadplanes are fixed-wing aircraft."""
    if mav_type in NO_MULTIROTORS and not parameters.get("Q_ENABLE"):
        _refuse(path, vehicle_kind(mav_type), f"type {mav_type} in its HEARTBEAT")


def refuse_by_px4(path: Path, types: Set[int], vtol: bool) -> None:
    """The same by all that vehicle_status.vehicle_type was, 0 before that is determined; vtol: whether is_vtol was ever set."""
    known = types - {0}
    if known and known <= _BY_PX4.keys() and not vtol:
        _refuse(path, _BY_PX4[min(known)], f"vehicle_status.vehicle_type {min(known)}")


def _refuse(path: Path, kind: str, said_by: str) -> None:
    raise RecordingError(
        f"{path}: the log of {kind} ({said_by}), and the model is that of a multirotor", "give the log of a multirotor"
    )
