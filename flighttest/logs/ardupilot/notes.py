"""What a dataflash log holds beside its channels: parameters, firmware, modes, arming, marks and errors."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flighttest.logs.ardupilot.times import Stamped
from flighttest.logs.other_vehicles import FIRMWARE
from flighttest.mavlink import ClockEstimate, in_force, mode_name
from flighttest.mavlink.marks import Text, markers_from_texts
from flighttest.recording import Marker, Series
from flighttest.recording.manifest import EventData

FloatArray = NDArray[np.float64]

_ARMED, _DISARMED, _TAKE_OFF, _LANDED = 10, 11, 28, 18  # LogEvent in ArduPilot's AP_Logger.h
_VEHICLE, _GROUND = 1, 255
_SENDER = re.compile(r"^(GCS:|SRC=\d+/\d+:)")  # how ArduPilot marks a STATUSTEXT that came over the link


def logged_parameters(tables: Mapping[str, Stamped]) -> dict[str, float]:
    """Parameter name to the value in force while the vehicle flew."""
    parm = tables.get("PARM")
    if parm is None or "Name" not in parm[0] or "Value" not in parm[0]:
        return {}
    arming = state(tables)
    disarmed = arming.t_s[arming.columns["armed"] == 0.0] if arming is not None else np.zeros(0)
    flown = arming.t_s[arming.columns["armed"] > 0.0] if arming is not None else np.zeros(0)
    after = disarmed[disarmed > flown[-1]] if flown.size else np.zeros(0)
    values = zip(parm[1], parm[0].text("Name"), parm[0].get("Value"), strict=True)
    return in_force(
        ((float(t_s), name, float(v)) for t_s, name, v in values), float(after[0]) if after.size else np.inf
    )


def parameter_changes(parm: Stamped | None) -> list[Marker]:
    """A note for every parameter that was logged anew with another value."""
    if parm is None or "Name" not in parm[0] or "Value" not in parm[0]:
        return []
    seen: dict[str, float] = {}
    notes: list[Marker] = []
    for t_s, name, value in zip(parm[1], parm[0].text("Name"), parm[0].get("Value"), strict=True):
        before = seen.get(name)
        if before is not None and before != value and not name.startswith("STAT_"):
            data: EventData = {"parameter": name, "before": before, "after": float(value)}
            notes.append(Marker(float(t_s), "note", f"parameter {name} changed from {before:g} to {value:g}", data))
        seen[name] = float(value)
    return notes


def firmware(tables: Mapping[str, Stamped]) -> str:
    """The firmware's version string, empty where the log does not hold it."""
    if "VER" in tables and "FWS" in tables["VER"][0]:
        return tables["VER"][0].text("FWS")[0]
    if "MSG" in tables and "Message" in tables["MSG"][0]:
        for text in tables["MSG"][0].text("Message"):
            if FIRMWARE.search(text):
                return text
    return ""


# LogErrorSubsystem of ArduPilot (AP_Logger.h). Of flight mode and EKF primary the code is a number of a mode, of an estimator.
_SUBSYSTEMS = {
    1: "main loop", 2: "radio", 3: "compass", 4: "optical flow", 5: "radio failsafe", 6: "battery failsafe", 7: "GPS failsafe",
    8: "ground station failsafe", 9: "fence failsafe", 10: "flight mode refused", 11: "GPS", 12: "crash check", 13: "flip",
    14: "autotune", 15: "parachute", 16: "EKF check", 17: "EKF failsafe", 18: "barometer", 19: "processor", 20: "ADS-B failsafe",
    21: "terrain", 22: "navigation", 23: "terrain failsafe", 24: "EKF primary changed", 25: "thrust loss check", 26: "sensor failsafe",
    27: "leak failsafe", 28: "pilot input", 29: "vibration failsafe", 30: "internal error", 31: "dead reckoning failsafe",
}  # fmt: skip
_NOT_RESOLVED_BY_0 = (10, 24)
_BOARD = re.compile(r"\S+ ([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})")
_UID2_BYTES = 18  # of AUTOPILOT_VERSION, which has the twelve bytes of the board's number first


def board(tables: Mapping[str, Stamped]) -> str:
    """The board's own number as AUTOPILOT_VERSION has it, in hexadecimal, '' where the log does not hold it. The text has each word of four
    bytes reversed (AP_HAL_ChibiOS, Util::get_system_id)."""
    if "MSG" not in tables or "Message" not in tables["MSG"][0]:
        return ""
    found = next((m for text in tables["MSG"][0].text("Message") if (m := _BOARD.fullmatch(text.strip()))), None)
    if found is None:
        return ""
    number = b"".join(bytes.fromhex(word)[::-1] for word in found.groups())
    return number.ljust(_UID2_BYTES, b"\0").hex()


def state(tables: Mapping[str, Stamped]) -> Series | None:
    """Mode and arming, as they changed. A log with "disarmed" and no "armed" was armed when it began."""
    modes = _modes(tables)
    arming: list[tuple[float, float]] = []
    if "EV" in tables and "Id" in tables["EV"][0]:
        table, t_s = tables["EV"]
        arming += [
            (float(t), float(i == _ARMED))
            for t, i in zip(t_s, table.raw["Id"], strict=True)
            if i in (_ARMED, _DISARMED)
        ]
    if "ARM" in tables and "ArmState" in tables["ARM"][0]:
        table, t_s = tables["ARM"]
        arming += [(float(t), float(i > 0)) for t, i in zip(t_s, table.raw["ArmState"], strict=True)]
    if not modes and not arming:
        return None
    arming.sort()
    first = min([t for t, _ in modes[:1]] + [t for t, _ in arming[:1]])
    if not arming or arming[0][1] == 0.0:
        arming.insert(0, (first, 1.0))
    times = np.unique([t for t, _ in modes] + [t for t, _ in arming])
    return Series(times, {"mode": _held(times, modes), "armed": _held(times, arming)})


def _held(times: FloatArray, changes: list[tuple[float, float]]) -> FloatArray:
    values = np.full(times.size, np.nan)
    for t_s, value in changes:
        values[np.searchsorted(times, t_s) :] = value
    return values


def _modes(tables: Mapping[str, Stamped]) -> list[tuple[float, float]]:
    if "MODE" not in tables:
        return []
    table, t_s = tables["MODE"]
    field = next((f for f in ("ModeNum", "Mode") if f in table), None)
    if field is None:
        return []
    return sorted((float(t), float(m)) for t, m in zip(t_s, table.raw[field], strict=True))


def _error(subsystem: int, code: int) -> str:
    """In words, with the numbers of the log."""
    resolved = code == 0 and subsystem not in _NOT_RESOLVED_BY_0
    named = _SUBSYSTEMS.get(subsystem, "unknown subsystem")
    return f"autopilot error{' resolved' if resolved else ''}: {named} ({subsystem}/{code})"


def markers(tables: Mapping[str, Stamped]) -> list[Marker]:
    """Marks and texts (MSG), mode changes, take-off and landing, and the errors the autopilot logged."""
    found: list[Marker] = []
    if "MSG" in tables and "Message" in tables["MSG"][0]:
        texts = []
        for t_s, text in zip(tables["MSG"][1], tables["MSG"][0].text("Message"), strict=True):
            plain = _SENDER.sub("", text)
            system = _GROUND if plain != text or plain.startswith("FT ") else _VEHICLE
            texts.append(Text(float(t_s), system, 6, plain))
        here = ClockEstimate(np.zeros(1), np.zeros(1), 1.0, 0.0, "vehicle")
        found += markers_from_texts(texts, _VEHICLE, here)
    before = None
    for t_s, mode in _modes(tables):
        if mode != before:
            found.append(Marker(t_s, "mode", mode_name(int(mode)), {"mode": int(mode)}))
        before = mode
    if "EV" in tables and "Id" in tables["EV"][0]:
        words = {_TAKE_OFF: "take-off", _LANDED: "landed", _ARMED: "armed", _DISARMED: "disarmed"}
        for t_s, event in zip(tables["EV"][1], tables["EV"][0].raw["Id"], strict=True):
            if int(event) in words:
                found.append(Marker(float(t_s), "note", words[int(event)], {"event": int(event)}))
    if "ERR" in tables and {"Subsys", "ECode"} <= set(tables["ERR"][0].raw):
        table, t_s = tables["ERR"]
        for t, subsystem, code in zip(t_s, table.raw["Subsys"], table.raw["ECode"], strict=True):
            data: EventData = {"subsystem": int(subsystem), "code": int(code)}
            found.append(Marker(float(t), "note", _error(int(subsystem), int(code)), data))
    return sorted(found, key=lambda m: m.t_s)
