"""`Plan`: a script compiled to a pure function of time. Does no I/O, is not random, does not depend on telemetry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flighttest.script.model import AttitudeTarget, Limits, Reset, Script
from flighttest.script.profiles import Timeline
from flighttest.vehicle.model import Vehicle

FloatArray = NDArray[np.float64]

__all__ = ["AttitudeTarget", "CellPlan", "Leg", "Phase", "Plan", "Policy", "PredictedMotion", "Predictor", "Snapshot"]


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
    `profile` is a pure function of time since the leg's start. waypoints (free_flight): (t_s, x, y, z) in the zone's frame, to be
    followed along straight lines at constant pace by `plan.outer_loop.steer`; then profile is None. motors_off: the leg is
    recorded on the ground, disarmed, and nothing is sent. voltage_v: where the battery is expected to be, None when not stated.
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
    motors_off: bool = False

    def flown_with(self, hover_throttle: float, angle_boost: bool) -> Leg:
        """The same leg for the throttle that holds height now (measured while hovering before it) and this autopilot.

        angle_boost: the autopilot divides throttle by the cosine of the tilt by itself (ArduPilot's ATC_ANGLE_BOOST 1). Only
        level flight follows; throttle steps stay as in the script.
        """
        if not isinstance(self.profile, Timeline):
            return self
        return replace(self, profile=replace(self.profile, hover_throttle=hover_throttle, angle_boost=angle_boost))


@dataclass(frozen=True)
class CellPlan:
    """What was found for one distinct step: durations, start, stop, and the space it needs. `check` prints these.

    held_s: (name, length) of the pieces before and during the record, which begins with piece `recorded_from`; stops: (name, length,
    throttle or tilt); useful_s: record left after the delay of a step; low_m, high_m: corners of the predicted envelope about the
    start, vehicle's heading along x; lost_low_m, lost_high_m: the same with the link lost at the worst moment; speed_m_s: fastest.
    """

    label: str
    kind: str
    legs: int
    held_s: tuple[tuple[str, float], ...]
    recorded_from: int
    stops: tuple[tuple[str, float, float], ...]
    useful_s: float
    start_m: tuple[float, float, float]
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    lost_low_m: tuple[float, float, float]
    lost_high_m: tuple[float, float, float]
    speed_m_s: float
    shortened: bool = False


@dataclass(frozen=True)
class Plan:
    """Everything a scheduler needs: legs in flying order, limits, reset, rate. refusals: (leg id, sentence, remedy).

    vehicle: its zone carries the script's own floor where it has one. reset: its place is inside zone, margin and the script's heights.
    A leg that was refused is not among the legs. reaction_s: how long the prior takes to answer a stop; the gate looks as far ahead.
    fenced: kinds of steps that with the link lost only a fence along the zone would keep inside.
    """

    script: Script
    vehicle: Vehicle
    legs: tuple[Leg, ...]
    limits: Limits
    reset: Reset
    rate_hz: float
    refusals: tuple[tuple[str, str, str], ...] = ()
    notes: tuple[str, ...] = ()
    cells: tuple[CellPlan, ...] = ()
    reaction_s: float = 0.25
    fenced: int = 0

    @property
    def duration_s(self) -> float:
        """Flying time of all legs, without resets, s."""
        return sum(leg.duration_s for leg in self.legs)


@dataclass(frozen=True)
class Snapshot:
    """Predicted state of n vehicles at one moment: p_m, v_m_s, rpy_rad are (n, 3), world NWU."""

    t_s: float
    p_m: FloatArray
    v_m_s: FloatArray
    rpy_rad: FloatArray


Policy = Callable[[Snapshot], FloatArray]
"""Targets (n, 4) - roll rad, pitch rad, yaw rate rad/s, throttle - sent at this moment and held until the next."""


@dataclass(frozen=True)
class PredictedMotion:
    """Predicted flight of n vehicles: t_s (m,), p_m, v_m_s, rpy_rad (n, m, 3), world NWU."""

    t_s: FloatArray
    p_m: FloatArray
    v_m_s: FloatArray
    rpy_rad: FloatArray


class Predictor(Protocol):
    """A prior model of the vehicle, flown many times at once. Passed in: this package holds no equations of motion.

    delay_s: from sending a target to the first effect; attitude_lag_s, thrust_lag_s: mean age of the effect beyond that.
    """

    @property
    def delay_s(self) -> float: ...  # noqa: D102

    @property
    def attitude_lag_s(self) -> float: ...  # noqa: D102

    @property
    def thrust_lag_s(self) -> float: ...  # noqa: D102

    def hover_throttle(self, voltage_v: FloatArray) -> FloatArray:
        """Throttle (n,) that holds height at these voltages (n,)."""
        ...

    def fly(
        self,
        start_m: FloatArray,
        yaw_rad: FloatArray,
        voltage_v: FloatArray,
        policy: Policy,
        duration_s: float,
        dt_s: float,
    ) -> PredictedMotion:
        """Fly n vehicles from rest at start_m (n, 3), yaw_rad (n,), voltage_v (n,), hovering until now, for duration_s."""
        ...


@dataclass(frozen=True)
class Trail:
    """A flight that can be taken up again at any of its moments. motion: as flown, what ended earlier filled up with its last state;
    states (m, n_states, n) and asked (m - 1, 4, n): the predictor's own, and the targets it was sent; clock_s: (n,) when it began."""

    motion: PredictedMotion
    states: FloatArray
    asked: FloatArray
    voltage_v: FloatArray
    clock_s: FloatArray


@runtime_checkable
class BranchingPredictor(Predictor, Protocol):
    """A predictor that flies vehicles for different times, and takes flights up again: what begins alike is flown once.

    steps: (n,) of dt_s, falling; the policy is asked for the vehicles that still fly, always the first ones.
    """

    def fly_each(
        self,
        start_m: FloatArray,
        yaw_rad: FloatArray,
        voltage_v: FloatArray,
        policy: Policy,
        steps: NDArray[np.intp],
        dt_s: float,
    ) -> Trail:
        """As `fly`, each vehicle for its own number of steps."""
        ...

    def branch(
        self,
        trail: Trail,
        of: NDArray[np.intp],
        at: NDArray[np.intp],
        policy: Policy,
        steps: NDArray[np.intp],
        dt_s: float,
    ) -> Trail:
        """Fly on n vehicles, the k-th from what vehicle of[k] of an earlier flight was at step at[k]; targets under way arrive."""
        ...
