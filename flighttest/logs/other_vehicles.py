"""Logs of vehicles that are no multirotors: an autopilot says what it drives, and no model of this program describes that."""

from __future__ import annotations

import re
from collections.abc import Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import RecordingError
from flighttest.mavlink.dialect import dialect, vehicle_kind
from flighttest.recording import Recording, Series

FloatArray = NDArray[np.float64]

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
# ArduPlane's modes in which a quadplane is carried by its rotors alone. QRTL comes near on the wing.
_ON_ROTORS = (
    dialect.PLANE_MODE_QSTABILIZE, dialect.PLANE_MODE_QHOVER, dialect.PLANE_MODE_QLOITER, dialect.PLANE_MODE_QLAND,
    dialect.PLANE_MODE_QAUTOTUNE, dialect.PLANE_MODE_QACRO,
)  # fmt: skip
_ASKED = ("reference", "shaped", "output")
_BY_PX4 = {2: _WING, 3: "a rover", 4: _AIRSHIP}  # VehicleStatus.msg, vehicle_type


def refuse_by_firmware(path: Path, firmware: str, parameters: Mapping[str, float]) -> bool:
    """RecordingError where ArduPilot's version string is of another vehicle's firmware. True for a quadplane (Q_ENABLE), which hovers as a
    multirotor."""
    named = _OTHER.match(firmware)
    if named and not parameters.get("Q_ENABLE"):
        _refuse(path, _BY_FIRMWARE[named[1]], firmware)
    return named is not None


def refuse_by_type(path: Path, mav_type: int, parameters: Mapping[str, float]) -> bool:
    """The same by the type in HEARTBEAT, in which ArduPilot's quadplanes are fixed-wing aircraft."""
    if mav_type in NO_MULTIROTORS and not parameters.get("Q_ENABLE"):
        _refuse(path, vehicle_kind(mav_type), f"type {mav_type} in its HEARTBEAT")
    return mav_type in NO_MULTIROTORS


def refuse_by_px4(path: Path, types: Set[int], vtol: bool) -> None:
    """The same by all that vehicle_status.vehicle_type was, 0 before that is determined; vtol: whether is_vtol was ever set."""
    known = types - {0}
    if known and known <= _BY_PX4.keys() and not vtol:
        _refuse(path, _BY_PX4[min(known)], f"vehicle_status.vehicle_type {min(known)}")


def quadplane(path: Path, recording: Recording) -> Recording:
    """The log of ArduPilot's quadplane, its modes by ArduPlane's names, without what was asked for outside of the Q modes: there a wing
    carries it. RecordingError where it never was in one."""
    state = recording.series.get("state")
    if state is None or not np.isfinite(state.columns.get("mode", np.full(1, np.nan))).any():
        return recording
    known = np.isfinite(state.columns["mode"])
    t_s, modes = state.t_s[known], state.columns["mode"][known]
    hovers = np.isin(modes, _ON_ROTORS)
    if not hovers.any():
        _refuse(path, f"{_WING} that was never in a Q mode", f"Q_ENABLE 1, mode {_plane_mode(int(modes[0]))}")
    marks = [replace(m, label=_plane_mode(m.data["mode"])) if m.kind == "mode" else m for m in recording.markers]
    said = "a quadplane: what was asked for outside of its Q modes, where its wing carries it, is not used"
    return _on_rotors(replace(recording, markers=tuple(marks)), t_s, hovers, said)


def vtol_of_px4(recording: Recording, t_s: FloatArray, kinds: FloatArray) -> Recording:
    """The log of PX4's VTOL aircraft without what was asked for while its wing carries it. kinds: what vehicle_status.vehicle_type was at
    t_s (n,)."""
    hovers = ~np.isin(kinds, list(_BY_PX4))
    said = "a VTOL aircraft: what was asked for while it flies as an aeroplane is not used"
    return recording if hovers.all() else _on_rotors(recording, t_s, hovers, said)


def _on_rotors(recording: Recording, t_s: FloatArray, hovers: NDArray[np.bool_], said: str) -> Recording:
    """Without what was asked for where the rotors alone do not carry the vehicle. hovers: from t_s (n,) on, s; said: the remark."""
    series = dict(recording.series)
    for group in _ASKED:
        one = series.get(group)
        if one is not None:
            kept = hovers[np.maximum(np.searchsorted(t_s, one.t_s, side="right") - 1, 0)]
            series[group] = Series(one.t_s, {n: np.where(kept, v, np.nan) for n, v in one.columns.items()})
    provenance = replace(recording.provenance, losses=(*recording.provenance.losses, said))
    return replace(recording, series=series, provenance=provenance)


def _plane_mode(number: int) -> str:
    """The name of a mode of ArduPlane."""
    known = dialect.enums["PLANE_MODE"].get(number)
    return str(known.name).removeprefix("PLANE_MODE_") if known is not None else f"mode {number}"


def _refuse(path: Path, kind: str, said_by: str) -> NoReturn:
    raise RecordingError(
        f"{path}: the log of {kind} ({said_by}), and the model is that of a multirotor", "give the log of a multirotor"
    )
