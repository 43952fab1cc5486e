"""Declared change: the fingerprint a model carries against the vehicle's of today."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fnmatch import fnmatch
from typing import Any

from flighttest.validity.model import ALL_SCRIPTS, SCRIPTS, SUBSETS, DeclaredChange
from flighttest.vehicle.fingerprint import FingerprintData

EVERYTHING = tuple(SUBSETS)
# What a component acts on, and why that is all; anything not named here touches everything.
_COMPONENTS: dict[str, tuple[tuple[str, ...], str]] = {
    "battery": (
        ("thrust",),
        "a battery changes what a throttle gives at a voltage, and not what the attitude loops do with it",
    ),
    "propellers": (
        ("thrust", "drag", "attitude"),
        "propellers carry thrust and rotor drag, and the attitude loops act through them",
    ),
    "motors": (("thrust", "attitude"), "motors carry thrust and its lag, and the attitude loops act through them"),
    "esc": (("thrust", "attitude"), "speed controllers carry the thrust lag, and the attitude loops act through them"),
    "payload": (EVERYTHING, "a payload changes mass, inertia and drag"),
}
# Parameter patterns, first match wins (the list of what shapes the response: ArduPilot's source, PX4's parameter reference).
_PARAMETERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("ATC_ANGLE_BOOST", ("thrust", "drag")),
    ("ATC_THR_MIX_*", ("thrust",)),
    ("ATC_ANG_YAW_*", ("yaw",)),
    ("ATC_RAT_YAW_*", ("yaw",)),
    ("ATC_ACC*_Y_MAX", ("yaw",)),
    ("ATC_RATE_Y_MAX", ("yaw",)),
    ("ATC_SLEW_YAW", ("yaw",)),
    ("ATC_ANG_*", ("attitude",)),
    ("ATC_RAT_RLL_*", ("attitude",)),
    ("ATC_RAT_PIT_*", ("attitude",)),
    ("ATC_ACC*_[RP]_MAX", ("attitude",)),
    ("ATC_RATE_[RP]_MAX", ("attitude",)),
    ("ATC_*", ("attitude", "yaw")),
    ("INS_GYRO_FILTER", ("attitude", "yaw")),
    ("INS_HNT*", ("attitude", "yaw")),
    ("SCHED_LOOP_RATE", ("attitude", "yaw")),
    ("MOT_THST_EXPO", ("thrust", "attitude", "yaw")),
    ("MOT_YAW_HEADROOM", ("yaw",)),
    ("MOT_*", ("thrust",)),
    ("INS_ACCEL_FILTER", ("thrust", "drag")),
    ("PILOT_THR_FILT", ("thrust",)),
    ("BATT*", ("thrust",)),
    ("THR_MDL_FAC", ("thrust", "attitude", "yaw")),
    ("MC_BAT_SCALE_EN", ("thrust",)),
    ("MC_YAW*", ("yaw",)),
    ("MC_*", ("attitude",)),
    ("IMU_GYRO*", ("attitude", "yaw")),
    ("IMU_ACCEL*", ("thrust", "drag")),
)
# Copter 4.7 renamed these; a renamed parameter is a change of firmware, which is reported once by itself.
_RENAMED = {
    "ANGLE_MAX": "ATC_ANGLE_MAX",
    "ATC_ACCEL_R_MAX": "ATC_ACC_R_MAX",
    "ATC_ACCEL_P_MAX": "ATC_ACC_P_MAX",
    "ATC_ACCEL_Y_MAX": "ATC_ACC_Y_MAX",
}
_ALIASES = {**_RENAMED, **{new: old for old, new in _RENAMED.items()}}
FEW, PARTLY = 5, 0.2  # number and share of the parameters that a firmware's next version does not take away
_UNTELLING_FIELDS = frozenset({"installed", "note", "notes", "comment", "url"})


def declared_changes(
    before: FingerprintData, after: FingerprintData
) -> tuple[tuple[DeclaredChange, ...], tuple[str, ...]]:
    """Changes between two fingerprints (as in model.yaml), and what could not be compared, one sentence each.

    Only what both sides hold is compared: something one side never declared is unknown, not changed.
    """
    changes: list[DeclaredChange] = []
    unknown: list[str] = []
    changes += _components(before.get("components") or {}, after.get("components") or {}, unknown)
    changes += _firmware(before, after, unknown)
    for kind, words, old, new in (
        ("voltage", "nominal voltage", before.get("nominal_voltage_v"), after.get("nominal_voltage_v")),
        ("frame", "frame", before.get("frame"), after.get("frame")),
    ):
        if old is not None and new is not None and not same_value(old, new):
            changes.append(_everything(kind, words, old, new))
    changes += _mass(before.get("mass_kg"), after.get("mass_kg"))
    changes += _parameters(before.get("shaping_parameters") or {}, after.get("shaping_parameters") or {}, unknown)
    return tuple(changes), tuple(unknown)


def same_parts(before: FingerprintData, after: FingerprintData) -> bool:
    """Whether every component is declared on both sides and the same, or, where none is declared, the parameters are."""
    parts, today = before.get("components") or {}, after.get("components") or {}
    if parts or today:
        return set(parts) == set(today) and not _components(parts, today, [])
    known, now = before.get("shaping_parameters") or {}, after.get("shaping_parameters") or {}
    return bool(known and now) and not _parameters(known, now, [])


def touched(parameter: str) -> tuple[str, ...]:
    """Subsets a vehicle parameter acts on."""
    return next((subsets for pattern, subsets in _PARAMETERS if fnmatch(parameter, pattern)), EVERYTHING)


def same_value(a: Any, b: Any) -> bool:
    """Equal as declared; numbers to the single precision a vehicle keeps them in."""
    if (
        isinstance(a, int | float)
        and isinstance(b, int | float)
        and not isinstance(a, bool)
        and not isinstance(b, bool)
    ):
        return math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)
    return bool(str(a).strip() == str(b).strip())


def _components(before: Mapping[str, Any], after: Mapping[str, Any], unknown: list[str]) -> list[DeclaredChange]:
    if not before:
        unknown.append("the model does not hold which components it was flown with")
        return []
    if not after:
        unknown.append("the vehicle's components are not declared; list them in vehicle.yaml")
        return []
    found = []
    for name in sorted({*before, *after}):
        if name not in before or name not in after:
            where = "the model's vehicle" if name not in before else "today's vehicle file"
            unknown.append(f"{name} is not declared in {where}")
            continue
        old, new = dict(before[name] or {}), dict(after[name] or {})
        differing = [
            k for k in sorted({*old, *new}) if k not in _UNTELLING_FIELDS and not same_value(old.get(k), new.get(k))
        ]
        if not differing:
            continue
        subsets, because = _COMPONENTS.get(name, (EVERYTHING, "nothing is known about what this component touches"))
        found.append(
            DeclaredChange(
                "component",
                name,
                _describe(old),
                _describe(new),
                subsets,
                ALL_SCRIPTS,
                scripts_for(subsets),
                because,
                str(new.get("installed", "")),
                bool(new.get("installed")),
            )
        )
    return found


def _firmware(before: FingerprintData, after: FingerprintData, unknown: list[str]) -> list[DeclaredChange]:
    old, new = before.get("firmware"), after.get("firmware")
    if not old or not new:
        unknown.append("the firmware of " + ("the model's flight" if not old else "today's vehicle") + " is not known")
        return []
    if _same_firmware(str(old), str(new)):
        return []
    return [_everything("firmware", "firmware", old, new)]


_VERSION = re.compile(r"v?(\d+\.\d+(?:\.\d+)?(?:-?[a-z]+\d*)?)", re.IGNORECASE)
_HASH = re.compile(r"\(?\b([0-9a-f]{7,40})\b\)?", re.IGNORECASE)


def _same_firmware(old: str, new: str) -> bool:
    """Version and hash as far as both have them: a vehicle file has only the family, a log adds the vehicle's type."""
    a, b = old.lower().strip(), new.lower().strip()
    if a == b or {a, b} & {"ardupilot", "px4"}:
        return True
    version, hash_of = (_VERSION.search(a), _VERSION.search(b)), (_HASH.search(a), _HASH.search(b))
    if not (version[0] and version[1]):
        return False
    if version[0][1] != version[1][1]:
        return False
    return not (hash_of[0] and hash_of[1]) or hash_of[0][1] == hash_of[1][1]


def _parameters(before: Mapping[str, Any], after: Mapping[str, Any], unknown: list[str]) -> list[DeclaredChange]:
    if not before or not after:
        if before:
            unknown.append("the vehicle's parameters are not known; connect it, or give a run of today")
        else:
            unknown.append("the model does not carry the parameters it was flown with")
        return []
    found = []
    partly = _partly(before, after, unknown)
    for name in sorted({*before, *after}):
        if name in before and name in after:
            if same_value(before[name], after[name]):
                continue
            old, new = before[name], after[name]
        else:
            here, there = (before, after) if name in before else (after, before)
            if partly or _ALIASES.get(name) in there:
                continue
            old, new = (here[name], "absent") if here is before else ("absent", here[name])
        subsets = touched(name)
        because = (
            f"{name} acts on {', '.join(subsets)} alone" if subsets != EVERYTHING else f"{name} may act on everything"
        )
        found.append(
            DeclaredChange(
                "parameter", name, _plain(old), _plain(new), subsets, ALL_SCRIPTS, scripts_for(subsets), because
            )
        )
    return found


def _partly(before: Mapping[str, Any], after: Mapping[str, Any], unknown: list[str]) -> bool:
    """Whether one side has its parameters in part only (a log that began late, another program's list): what it lacks is unknown then."""
    for here, there, whose in ((before, after, "today's vehicle"), (after, before, "the model's flight")):
        missing = [n for n in here if n not in there and _ALIASES.get(n) not in there]
        if len(missing) > max(FEW, PARTLY * len(here)):
            unknown.append(f"{len(missing)} of {len(here)} parameters that shape the response are not known of {whose}")
            return True
    return False


def _mass(old: Any, new: Any) -> list[DeclaredChange]:
    """Another mass as declared: what goes with force over mass, and what a payload does to the inertia."""
    if not isinstance(old, int | float) or not isinstance(new, int | float) or same_value(old, new):
        return []
    because = (
        f"K and the drag go with 1/mass: expect them at {old / new:.3f} of what they were; a payload also adds inertia"
    )
    return [DeclaredChange("mass", "mass", f"{old:g} kg", f"{new:g} kg", EVERYTHING, ALL_SCRIPTS, ALL_SCRIPTS, because)]


def _everything(kind: str, name: str, old: Any, new: Any) -> DeclaredChange:
    because = f"a change of {name} may touch everything"
    return DeclaredChange(kind, name, _plain(old), _plain(new), EVERYTHING, ALL_SCRIPTS, ALL_SCRIPTS, because)


def scripts_for(subsets: tuple[str, ...]) -> tuple[str, ...]:
    """Shipped scripts that identify these subsets, in flying order."""
    wanted = {s for subset in subsets for s in SCRIPTS[subset]}
    return tuple(s for s in ALL_SCRIPTS if s in wanted)


def _describe(component: Mapping[str, Any]) -> str:
    telling = {k: v for k, v in component.items() if k not in _UNTELLING_FIELDS}
    return ", ".join(_plain(v) if k in ("id", "model") else f"{k} {_plain(v)}" for k, v in telling.items()) or "none"


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
