"""Bringing the vehicle back between steps: by the autopilot's own position loop, by our outer loop, or by the pilot.

Each returns whether the vehicle is at the start and settled, and the hover throttle measured while it hovered there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from flighttest import frames
from flighttest.flight.execution.control import FlightControl
from flighttest.flight.execution.machine import Event, FlightState
from flighttest.flight.execution.supervisor import UNSEEN_S, enter, enter_nogps
from flighttest.flight.gate import LINK, Refusal, lost_control, readiness
from flighttest.flight.state import VehicleState
from flighttest.mavlink import CopterMode
from flighttest.plan import AttitudeTarget
from flighttest.plan.outer_loop import Moving, OuterLoop

NEAR_M = 0.6
SLOW_M_S = 0.35
FACING_RAD = 0.12
LEVEL_RAD = 0.15
LEANING_RAD = 0.35  # into the wind, where position and velocity show that it holds still all the same
_TIMEOUT_BASE_S = 25.0
_SLOWEST_M_S = 0.7
_ASK_AGAIN_S = 0.1
_SOON_S = 5.0  # after the link has come back
_SHORTEST_S = 0.3  # over which a change of the climb rate gives an acceleration
_YAW_SLEW_RAD_S = 0.8


@dataclass(frozen=True)
class LegStart:
    """Where a leg begins: position about the zone's origin (NWU, m), heading (NWU, rad), and how long to be still, s."""

    position_m: tuple[float, float, float]
    yaw_rad: float
    settle_s: float


class Arrival(Enum):
    """How a reset ended. The value is the sentence shown to the reader."""

    SETTLED = "settled"
    REFUSED = "the gate refused a target"
    STOPPED = "stopped"
    NO_GUIDED = "the vehicle did not enter GUIDED"
    NO_NOGPS = "the vehicle did not enter GUIDED_NOGPS"
    NOT_SETTLED = "the vehicle did not settle at the start"
    NOT_HANDED_OVER = "the pilot did not hand over"


@dataclass(frozen=True)
class Arrived:
    """The end of a reset. hover_throttle: as measured while it was still; refused: the gate's reasons where it ended the way there."""

    how: Arrival
    hover_throttle: float | None = None
    refused: tuple[Refusal, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether the vehicle is still at the start."""
        return self.how is Arrival.SETTLED


class Settling:
    """Counts how long the vehicle has been where it should be; the mean throttle over that time is its hover throttle."""

    def __init__(self, start: LegStart, near_m: float = NEAR_M) -> None:
        self._start = start
        self._near_m = near_m
        self._since_s: float | None = None
        self._throttles: list[float] = []
        self._climbs: list[tuple[float, float]] = []

    def done(self, state: VehicleState, throttle: float | None) -> bool:
        """Take in the state now; True when it has been still for long enough."""
        if not self.here(state):
            self._since_s = None
            self._throttles.clear()
            self._climbs.clear()
            return False
        if self._since_s is None:
            self._since_s = state.t_s
        if throttle is not None and throttle > 0.0:
            self._throttles.append(throttle)
            if state.climb_m_s is not None:
                self._climbs.append((state.t_s, state.climb_m_s))
        return state.t_s - self._since_s >= self._start.settle_s

    def here(self, state: VehicleState) -> bool:
        """Near, slow and facing right; what is not known is not asked."""
        goal = self._start
        if state.attitude_rad is None or state.silence_s > 0.5:
            return False
        turn = abs(float(frames.wrap_angle(state.attitude_rad[2] - goal.yaw_rad)))
        tilt = state.tilt_rad or 0.0
        if turn > FACING_RAD:
            return False
        if state.position_ok and state.position_m is not None and state.velocity_m_s is not None:
            near = math.dist(state.position_m, goal.position_m) <= self._near_m
            return near and tilt <= LEANING_RAD and math.hypot(*state.velocity_m_s) <= SLOW_M_S
        if tilt > LEVEL_RAD:
            return False
        height_off = abs(state.height_m - goal.position_m[2]) if state.height_m is not None else 0.0
        return height_off <= 2 * self._near_m and abs(state.climb_m_s or 0.0) <= SLOW_M_S

    @property
    def hover_throttle(self) -> float | None:
        """Mean throttle while settled, None when it is not known; without what still braked or raised the vehicle meanwhile: a climb that
        changes by 0.3 m/s in a second takes 3 % of gravity.
        """
        if not self._throttles:
            return None
        pushed = 0.0
        if len(self._climbs) > 1:
            (began_s, before), (ended_s, after) = self._climbs[0], self._climbs[-1]
            pushed = (after - before) / (frames.G_M_S2 * max(ended_s - began_s, _SHORTEST_S))
        return float(np.mean(self._throttles)) / (1.0 + pushed)


def _commanded_throttle(control: FlightControl) -> float | None:
    """What the autopilot's own controller commands now: ATTITUDE_TARGET.thrust is before the tilt boost, which is what we send, too."""
    heard = control.session.latest.get("ATTITUDE_TARGET")
    if heard is None or control.session.now_s() - heard.t_s > 0.5:
        return None
    return float(heard.message.thrust)


def _timeout_s(state: VehicleState, start: LegStart) -> float:
    distance = math.dist(state.position_m, start.position_m) if state.position_m is not None else 10.0
    return _TIMEOUT_BASE_S + start.settle_s + distance / _SLOWEST_M_S


def hold_place(control: FlightControl, start: LegStart) -> None:
    """Ask GUIDED once for a leg's start."""
    control.vehicle.go_to(np.asarray(start.position_m) + control.reader.origin_m, start.yaw_rad)


def guided(control: FlightControl, start: LegStart) -> Arrived:
    """By GUIDED's own position control."""

    def hold() -> None:
        # The mode keeps its last target, and a step's may have been the last: level until GUIDED has the vehicle.
        if control.state.mode == CopterMode.GUIDED_NOGPS:
            control.release()

    if not enter(control, CopterMode.GUIDED, meanwhile=hold):
        return Arrived(Arrival.NO_GUIDED)
    settling = Settling(start)
    deadline = control.session.now_s() + _timeout_s(control.state, start)
    next_ask = -math.inf
    while control.session.now_s() < deadline:
        if control.stop_asked:
            return Arrived(Arrival.STOPPED)
        if control.state.mode == CopterMode.GUIDED_NOGPS and not enter(control, CopterMode.GUIDED, meanwhile=hold):
            return Arrived(Arrival.NO_GUIDED)  # an earlier request that was carried out late
        lost = lost_control(control.state, control.gate)
        if lost:
            return Arrived(Arrival.REFUSED, refused=lost)
        now = control.session.now_s()
        if now >= next_ask and control.state.mode_age_s < UNSEEN_S:
            # Streamed: without a new one within GUID_TIMEOUT (0.2 s here) ArduPilot stops turning to the heading (flown).
            hold_place(control, start)
            next_ask = now + _ASK_AGAIN_S
        state = control.cycle()
        if state.mode_age_s > UNSEEN_S:
            # The autopilot holds the place by itself; a pilot who takes it meanwhile would not be seen.
            deadline = max(deadline, state.t_s + _SOON_S)
        if LINK & set(readiness(state, control.gate)):
            settling = Settling(start)  # what is too old for a step does not show its start
        elif settling.done(state, _commanded_throttle(control)):
            return Arrived(Arrival.SETTLED, settling.hover_throttle)
    return Arrived(Arrival.NOT_SETTLED)


def reset_by_attitude(control: FlightControl, start: LegStart, angle_boost: bool) -> Arrived:
    """By an outer loop of ours over attitude targets; without horizontal position only height and heading are brought back."""
    if control.state.mode != CopterMode.GUIDED_NOGPS and not enter_nogps(control):
        return Arrived(Arrival.NO_NOGPS)
    loop = HoldLoop(control, angle_boost)
    settling = Settling(start, near_m=1.0)
    deadline = control.session.now_s() + _timeout_s(control.state, start)
    while control.session.now_s() < deadline:
        if control.stop_asked:
            return Arrived(Arrival.STOPPED)
        target, yaw = loop.target(start)
        # Without a position the targets are level: they would be release targets, and pass, also over a link or a battery that is gone.
        refused = readiness(control.state, control.gate) or control.steer(target, yaw)
        if refused:
            return Arrived(Arrival.REFUSED, refused=refused)
        state = control.cycle()
        if settling.done(state, target.throttle * math.cos(target.roll_rad) * math.cos(target.pitch_rad)):
            return Arrived(Arrival.SETTLED, settling.hover_throttle)
    return Arrived(Arrival.NOT_SETTLED)


def by_pilot(control: FlightControl, timeout_s: float = 300.0) -> Arrived:
    """The pilot flies to the start and switches to GUIDED_NOGPS when ready; until then nothing is sent that moves the vehicle.

    The pilot sees it in the live view. Never re-enters the mode by itself. As long as HEARTBEAT shows no mode of the pilot's, the vehicle
    stays the program's to land.
    """
    control.on(Event.HAND_OVER)
    control.alarm("the pilot flies to the start")
    control.show(doing="waiting for the pilot: fly to the start, then switch to GUIDED_NOGPS")
    deadline = control.session.now_s() + timeout_s
    first: int | None = (
        None  # number of the HEARTBEAT that showed the mode; one alone may be damaged, or another vehicle's
    )
    while control.session.now_s() < deadline:
        if control.stop_asked:
            return Arrived(Arrival.STOPPED)
        state = control.cycle()
        beats = control.session.counts.get("HEARTBEAT", 0)
        handed = control.machine.state is FlightState.HANDED
        if not (handed and state.mode == CopterMode.GUIDED_NOGPS and state.armed):
            first = None
        elif first is None:
            first = beats
        elif beats > first:
            control.on(Event.HANDED_BACK)
            return Arrived(Arrival.SETTLED)
    return Arrived(Arrival.NOT_HANDED_OVER)


class HoldLoop:
    """The outer loop with what it must remember: the heading it turns through and the throttle that holds height."""

    def __init__(self, control: FlightControl, angle_boost: bool) -> None:
        self._control = control
        self._boost = angle_boost
        self._loop = OuterLoop(tilt_max_rad=min(0.35, control.gate.limits.tilt_target_max_rad))
        self._yaw = control.state.attitude_rad[2] if control.state.attitude_rad else 0.0
        self._hover = control.hover_throttle

    def target(
        self, goal: LegStart, goal_v_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> tuple[AttitudeTarget, float]:
        """The next target towards a goal, and the heading for its quaternion."""
        control, state = self._control, self._control.state
        dt = control.period_s
        turn = float(frames.wrap_angle(goal.yaw_rad - self._yaw))
        self._yaw = float(frames.wrap_angle(self._yaw + min(max(turn, -_YAW_SLEW_RAD_S * dt), _YAW_SLEW_RAD_S * dt)))
        yaw_now = state.attitude_rad[2] if state.attitude_rad else self._yaw
        height = state.height_m if state.height_m is not None else goal.position_m[2]
        climb = state.climb_m_s or 0.0
        known = state.position_m is not None and state.velocity_m_s is not None and state.position_age_s < 0.5
        p = (*state.position_m[:2], height) if known and state.position_m else (*goal.position_m[:2], height)
        v = (*state.velocity_m_s[:2], climb) if known and state.velocity_m_s else (0.0, 0.0, climb)
        wanted_climb = min(max(goal_v_m_s[2] + goal.position_m[2] - height, -1.0), 1.0)
        # Slow integral on the hover throttle: a battery that sags, or a wrong vehicle.yaml, must not leave a lasting height error.
        self._hover *= 1.0 + 0.15 * dt * (wanted_climb - climb)
        self._hover = min(max(self._hover, 0.5 * control.hover_throttle), 1.6 * control.hover_throttle)
        there = Moving(goal.position_m, goal_v_m_s, goal.yaw_rad)
        row = self._loop.steer(Moving(p, v, yaw_now), there, self._hover, self._boost)[0]
        roll, pitch = (float(row[0]), float(row[1])) if known else (0.0, 0.0)
        low, high = control.gate.limits.throttle
        # The loop is ours and may saturate; the gate judges what it asks for, and would drop a target beyond the script's range.
        throttle = min(max(float(row[3]), low), high)
        return AttitudeTarget(0.0, roll, pitch, 0.0, throttle), self._yaw
