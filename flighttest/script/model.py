"""`Script`: a maneuver script as frozen data. Independent of time, vehicles and physics; SI and radians throughout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypedDict

from flighttest.documents import PlainData

ResetBy = Literal["guided", "attitude", "pilot"]
ThrottleUnit = Literal["absolute", "hover"]


@dataclass(frozen=True)
class Limits:
    """What no target and no measurement may exceed.

    tilt_target_max_rad bounds commanded tilt, tilt_abort_rad measured tilt (a 0.5 rad step peaks at 36 deg, its
    counter-step at 41 deg, so the two differ). throttle and height_m are (low, high); voltage is a 2 s mean (0 in a
    script that leaves it out; a plan then takes its share of the vehicle's nominal voltage). floor_m: a floor of the
    script's own, m above the ground, in place of the zone's lower bound (for steps near the ground).
    """

    tilt_target_max_rad: float
    tilt_abort_rad: float
    throttle: tuple[float, float]
    height_m: tuple[float, float]
    speed_max_m_s: float
    voltage_min_v: float
    yaw_rate_max_rad_s: float = 3.5
    floor_m: float | None = None


@dataclass(frozen=True)
class Reset:
    """How the vehicle is brought back between steps: to_m in the zone's frame, headings (NWU yaw, relative to the zone's
    x axis, rad) rotate over the repeats."""

    to_m: tuple[float, float, float]
    heading_rad: tuple[float, ...]
    by: ResetBy
    settle_s: float


@dataclass(frozen=True)
class Repeat:
    """How often each cell is flown and in which order; over_voltage_v is the (high, low) span the repeats are spread over."""

    each: int = 1
    over_voltage_v: tuple[float, float] | None = None
    order: Literal["interleaved", "sequential"] = "interleaved"


@dataclass(frozen=True)
class Maneuver:
    """One entry of `steps`: a profile name (throttle_pair, attitude_step, ...) and its checked settings, SI."""

    profile: str
    settings: Mapping[str, Any]
    line: int = 0


@dataclass(frozen=True)
class Script:
    """A checked maneuver script. `sha256` is of the text, `text` the text itself: both go into every recording."""

    name: str
    doc: str
    identifies: tuple[str, ...]
    mode: str
    rate_hz: float
    throttle_unit: ThrottleUnit
    limits: Limits
    reset: Reset
    steps: tuple[Maneuver, ...]
    repeat: Repeat
    text: str = field(repr=False)
    sha256: str = ""
    path: str = ""


class ResetData(TypedDict, total=False):
    """The block `reset` of a script as it is written."""

    to: list[float]
    heading_deg: list[float]
    by: str
    settle_s: float


class ScriptData(TypedDict, total=False):
    """A maneuver script as it is written (format maneuver/1), before it is checked. steps: each a profile's name to its settings."""

    format: str
    name: str
    doc: str
    identifies: list[str]
    mode: str
    rate_hz: float
    throttle_unit: str
    limits: dict[str, PlainData]
    reset: ResetData
    steps: list[dict[str, PlainData]]
    repeat: dict[str, PlainData]


@dataclass(frozen=True)
class AttitudeTarget:
    """One attitude target, NWU/FLU: attitude references rad, yaw rate rad/s (left positive), throttle 0..1, t_s from the leg's start."""

    t_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rate_rad_s: float
    throttle: float
