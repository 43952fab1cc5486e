"""`Fingerprint`: what a model is bound to - components, firmware, frame, nominal voltage, and the parameters that shape the response."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, TypedDict, cast

from flighttest.recording.manifest import Components
from flighttest.vehicle.model import Vehicle

# ArduCopter, old and new names (source of 4.3 to 4.7). Attitude first, then thrust, then both.
ARDUPILOT_PATTERNS: tuple[str, ...] = (
    "ATC_*",
    "ANGLE_MAX",
    "INS_GYRO_FILTER",
    "INS_HNT*",
    "INS_NOTCH_*",
    "SCHED_LOOP_RATE",
    "MOT_*",
    "INS_ACCEL_FILTER",
    "PILOT_THR_FILT",
    "BATT*_MONITOR",
    "BATT*_VOLT_MULT",
    "BATT*_AMP_PERVLT",
    "BATT*_AMP_OFFSET",
    "BATT*_VLT_OFFSET",
    "GUID_OPTIONS",
    "FRAME_CLASS",
    "FRAME_TYPE",
)
# PX4 (parameter reference 1.13 to 1.16): rate and attitude loops, thrust curve, battery scaling, filters, frame and mixing.
PX4_PATTERNS: tuple[str, ...] = (
    "MC_*",
    "THR_MDL_FAC",
    "IMU_GYRO_CUTOFF",
    "IMU_DGYRO_CUTOFF",
    "IMU_GYRO_NF*",
    "IMU_GYRO_DNF_*",
    "IMU_GYRO_RATEMAX",
    "IMU_ACCEL_CUTOFF",
    "BAT*_V_DIV",
    "BAT*_A_PER_V",
    "SYS_AUTOSTART",
    "CA_*",
    "MOT_SLEW_MAX",
    "PWM_*_MIN*",
    "PWM_*_MAX*",
)
# These match a pattern above and yet do not touch the response: the autopilot adapts the hover throttle in every flight and
# uses it in modes that hold height only; the others steer what happens before take-off, or a tuning aid.
HARMLESS: frozenset[str] = frozenset(
    {"MOT_THST_HOVER", "MOT_HOVER_LEARN", "MOT_SAFE_DISARM", "MOT_SAFE_TIME", "MC_AT_EN", "MC_AT_APPLY", "MC_AT_START"}
)


class FingerprintData(TypedDict, total=False):
    """A `Fingerprint` as model.yaml and the manifest carry it; what is not known is left out."""

    components: Components
    firmware: str
    frame: str
    nominal_voltage_v: float
    mass_kg: float
    parameters_sha256: str
    shaping_parameters: dict[str, float]


@dataclass(frozen=True)
class Fingerprint:
    """What must not change while a model is in use.

    components: part to its declared fields; mass_kg: as declared, None where it is not; firmware: full version string where known,
    else the family; frame: FRAME_CLASS/TYPE or SYS_AUTOSTART as text, '' when not known; shaping_parameters: those of the vehicle that
    shape the response, under the names it reports; parameters_sha256: of them, in the single precision a vehicle keeps them in.
    """

    components: Components = field(default_factory=dict)
    firmware: str = ""
    frame: str = ""
    nominal_voltage_v: float | None = None
    mass_kg: float | None = None
    shaping_parameters: Mapping[str, float] = field(default_factory=dict)
    parameters_sha256: str = ""

    def as_data(self) -> FingerprintData:
        """As model.yaml and the manifest carry it; what is not known is left out."""
        found: dict[str, Any] = {
            "components": {name: dict(fields) for name, fields in self.components.items()},
            "firmware": self.firmware,
            "frame": self.frame,
            "nominal_voltage_v": self.nominal_voltage_v,
            "mass_kg": self.mass_kg,
            "parameters_sha256": self.parameters_sha256,
            "shaping_parameters": dict(self.shaping_parameters),
        }
        return cast(FingerprintData, {key: value for key, value in found.items() if value not in (None, "", {})})


def shaping_parameters(parameters: Mapping[str, float]) -> dict[str, float]:
    """Those of a vehicle's parameters whose change makes a model stale, sorted by name."""
    patterns = ARDUPILOT_PATTERNS + PX4_PATTERNS
    return {
        name: float(value)
        for name, value in sorted(parameters.items())
        if name not in HARMLESS and any(fnmatchcase(name, pattern) for pattern in patterns)
    }


def fingerprint(
    vehicle: Vehicle | None, firmware: str = "", parameters: Mapping[str, float] | None = None
) -> Fingerprint:
    """The fingerprint of a vehicle as declared (None: nothing is) and as it reports itself (version text, all its parameters)."""
    shaping = shaping_parameters(parameters or {})
    return Fingerprint(
        components=vehicle.components if vehicle is not None else {},
        firmware=firmware or (vehicle.firmware if vehicle is not None else ""),
        frame=_frame(parameters or {}),
        nominal_voltage_v=vehicle.nominal_voltage_v if vehicle is not None else None,
        mass_kg=vehicle.mass_kg if vehicle is not None else None,
        shaping_parameters=shaping,
        parameters_sha256=_digest(shaping) if shaping else "",
    )


def _frame(parameters: Mapping[str, float]) -> str:
    if "FRAME_CLASS" in parameters:
        return f"class {parameters['FRAME_CLASS']:g} type {parameters.get('FRAME_TYPE', 0.0):g}"
    return f"airframe {parameters['SYS_AUTOSTART']:g}" if "SYS_AUTOSTART" in parameters else ""


def _digest(parameters: Mapping[str, float]) -> str:
    # Seven digits are what single precision holds: the same value read from a log and over the link gives the same digest.
    text = "\n".join(f"{name}={value:.7g}" for name, value in sorted(parameters.items()))
    return hashlib.sha256(text.encode()).hexdigest()
