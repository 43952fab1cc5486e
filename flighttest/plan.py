"""`Plan`: a script compiled to a pure function of time. Does no I/O, is not random, does not depend on telemetry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from flighttest.script.model import Limits, Reset, Script
from flighttest.vehicle.model import Vehicle


@dataclass(frozen=True)
class AttitudeTarget:
    """One target, NWU/FLU: attitude references rad, yaw rate rad/s (left positive), throttle 0..1, t_s from the leg's start."""

    t_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rate_rad_s: float
    throttle: float


@dataclass(frozen=True)
class Phase:
    """A named part of a leg. record: True for what is cut into the segment (from t_1 on), False for entry, stop and coast."""

    name: str
    start_s: float
    end_s: float
    record: bool


@dataclass(frozen=True)
class Leg:
    """One response to be flown: from a start pose, a profile of targets, and the phases it passes through.

    start_m: zone frame; heading_rad: NWU yaw in the world; t_step_s: when the step that is cut happens, from the leg's start.
    `profile` is a pure function of time since the leg's start. waypoints: for free_flight, zone frame; then profile is None.
    """

    id: str
    maneuver: str
    kind: str
    cell: Mapping[str, float]
    repeat: int
    start_m: tuple[float, float, float]
    heading_rad: float
    duration_s: float
    t_step_s: float
    phases: tuple[Phase, ...]
    profile: Callable[[float], AttitudeTarget] | None
    waypoints: tuple[tuple[float, float, float, float], ...] = ()
    voltage_v: float | None = None


@dataclass(frozen=True)
class Plan:
    """Everything a scheduler needs: legs in flying order, limits, reset, rate. refusals: (leg id, sentence, remedy)."""

    script: Script
    vehicle: Vehicle
    legs: tuple[Leg, ...]
    limits: Limits
    reset: Reset
    rate_hz: float
    refusals: tuple[tuple[str, str, str], ...] = ()
    notes: tuple[str, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Flying time of all legs, without resets, s."""
        return sum(leg.duration_s for leg in self.legs)
