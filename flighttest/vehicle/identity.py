"""Which vehicle something is of: by its declared name, else by what an autopilot cannot share with another one."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TypedDict, cast

from flighttest.recording.manifest import VehicleData

# Results of an accelerometer calibration (ArduPilot, PX4): no two boards have the same. Others, as a compass' offsets, change in flight.
CALIBRATION = ("INS_ACC*OFFS_?", "INS_ACC*SCAL_?", "CAL_ACC*_?OFF", "CAL_ACC*_?SCALE")
SYSTEM_IDS = ("MAV_SYSID", "SYSID_THISMAV", "MAV_SYS_ID")
LEAST_CALIBRATION = 3  # numbers: of one sensor
ROUND_DIGITS = 3  # decimals of a number that somebody typed, or of a default


class IdentityData(TypedDict, total=False):
    """An `Identity` as model.yaml and the lineage of a vehicle carry it; what is not known is left out."""

    name: str | None
    autopilot: str
    sysid: int
    calibration: dict[str, float]


@dataclass(frozen=True)
class Identity:
    """name: as declared in vehicle.yaml, '' where it was not; autopilot: the board's own number, '' where it is not known; sysid: MAVLink
    system id, None where it is not known; calibration: of the accelerometers, by parameter."""

    name: str = ""
    autopilot: str = ""
    sysid: int | None = None
    calibration: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Default name of a vehicle, made of its autopilot's identity; '' where that does not distinguish it from others."""
        if self.name or self.autopilot:
            return self.name or f"autopilot {re.sub('(00)+$', '', self.autopilot)}"
        if len(self.calibration) < LEAST_CALIBRATION:
            return ""
        text = "\n".join([f"{self.sysid}", *(f"{n}={v:.6g}" for n, v in sorted(self.calibration.items()))])
        return f"autopilot calibrated {hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def same_board(self, other: Identity) -> bool | None:
        """Whether both are one autopilot: by its number, else by calibration and system id. None where it cannot be determined."""
        if self.autopilot and other.autopilot:
            return self.autopilot == other.autopilot
        shared = set(self.calibration) & set(other.calibration)
        if len(shared) < LEAST_CALIBRATION:
            return None
        alike = all(abs(self.calibration[n] - other.calibration[n]) < 1e-6 for n in shared)
        return alike and (self.sysid == other.sysid or None in (self.sysid, other.sysid))

    def as_data(self) -> IdentityData:
        """For model.yaml."""
        board = {"autopilot": self.autopilot or None, "sysid": self.sysid, "calibration": dict(self.calibration)}
        known = {"name": self.name or None, **{k: v for k, v in board.items() if v not in (None, {})}}
        return cast(IdentityData, known)


def from_data(data: Mapping[str, object]) -> Identity:
    """What `as_data` gave, as it was read back; what is not of its kind is left out."""
    sysid, calibration = data.get("sysid"), data.get("calibration")
    numbers = calibration.items() if isinstance(calibration, Mapping) else ()
    measured = {str(n): float(v) for n, v in numbers if isinstance(v, int | float)}
    named = str(data.get("name") or ""), str(data.get("autopilot") or "")
    return Identity(*named, sysid if isinstance(sysid, int) else None, measured)


def identity(vehicle: VehicleData, parameters: Mapping[str, float], autopilot: str = "") -> Identity:
    """Of what a recording or a manifest carries: the block `vehicle`, all parameters, and the autopilot's own number."""
    numbers = {str(n): float(v) for n, v in parameters.items() if isinstance(v, int | float)}
    sysid = next((int(numbers[n]) for n in SYSTEM_IDS if n in numbers), None)
    measured = {
        n: v
        for n, v in numbers.items()
        if any(fnmatchcase(n, p) for p in CALIBRATION) and abs(v - round(v, ROUND_DIGITS)) > 1e-6
    }
    return Identity(str(vehicle.get("name") or ""), autopilot, sysid, measured)
