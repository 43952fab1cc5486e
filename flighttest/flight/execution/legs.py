"""Flying one leg: entry into GUIDED_NOGPS, the profile target by target with its marks, and what a refusal leads to."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

from flighttest.flight.execution import supervisor
from flighttest.flight.execution.control import UNSURE_S, FlightControl
from flighttest.flight.execution.machine import Event
from flighttest.flight.execution.reset import HoldLoop, LegStart
from flighttest.flight.execution.response import ThrottleTrace
from flighttest.flight.gate import LINK, Refusal, refusal_sentences
from flighttest.flight.outcome import LegOutcome, LegResult
from flighttest.flight.recorder import mark_id
from flighttest.link import parameters as params
from flighttest.link.ardupilot import UNSHAPED_LAG_S, SentHeading
from flighttest.plan import AttitudeTarget, Leg
from flighttest.plan.outer_loop import along

LOOK_S = 0.2  # while the vehicle rests: an operator who stops, or a pilot who arms, is answered within it
_PHASES = 4  # of the target period: 5 ms at 50 Hz, the tick of the built-in vehicle


@dataclass(frozen=True)
class AutopilotSettings:
    """The autopilot's settings that flying needs. yaw_accel_max_rad_s2: ATC_ACC_Y_MAX, 0 is unlimited; yaw_lag_s: of the heading sent."""

    angle_boost: bool = False
    yaw_accel_max_rad_s2: float = 0.0
    yaw_lag_s: float = 0.0

    @classmethod
    def of(cls, parameters: dict[str, float]) -> AutopilotSettings:
        """By the vehicle's parameters."""
        # None: the target is not shaped, or nothing is known of it; a heading that trails is never ahead of the target.
        accel_deg = (
            params.by_either_name(parameters, "ATC_ACC_Y_MAX") if parameters.get("ATC_RATE_FF_ENAB", 1.0) else None
        )
        return cls(
            angle_boost=parameters.get("ATC_ANGLE_BOOST", 1.0) != 0.0,
            yaw_accel_max_rad_s2=math.radians(accel_deg or 0.0),
            yaw_lag_s=UNSHAPED_LAG_S if accel_deg is None else 0.0,
        )


def rest(control: FlightControl, leg: Leg) -> LegResult:
    """Record a leg on the ground with motors off; nothing but its marks is sent. FlightEnded once the pilot arms."""
    begin(control, leg)
    start = control.session.now_s()
    for phase in leg.phases:
        _mark(control, leg, phase.name)
        while (now := control.session.now_s()) < start + phase.end_s:
            control.until(min(now + LOOK_S, start + phase.end_s))
            if control.vehicle.armed:
                control.on(Event.ARMED)
            if control.stop_asked:
                return finish(control, leg, LegOutcome.STOPPED, (control.stop_reason,))
    return finish(control, leg, LegOutcome.FLOWN)


def begin(control: FlightControl, leg: Leg) -> None:
    """Note that a leg begins, with all that distinguishes it from others."""
    control.recorder.event(
        "leg",
        leg.id,
        control.session.now_s(),
        {
            "leg": leg.id,
            "mark": mark_id(leg.id),
            "maneuver": leg.maneuver,
            "kind": leg.kind,
            "cell": dict(leg.cell),
            "repeat": leg.repeat,
            "heading_rad": leg.heading_rad,
            "t_step_s": leg.t_step_s,
            "duration_s": leg.duration_s,
            "hover_throttle": control.hover_throttle,
        },
    )


def finish(
    control: FlightControl, leg: Leg, outcome: LegOutcome, why: tuple[str, ...] = (), refused: tuple[Refusal, ...] = ()
) -> LegResult:
    """Mark a leg's end and note how it ended."""
    word = {LegOutcome.FLOWN: "end", LegOutcome.LINK_LOST: "link_lost"}.get(outcome, "abort")
    control.vehicle.mark(mark_id(leg.id), word)
    control.recorder.event(
        "phase", "end", control.session.now_s(), {"leg": leg.id, "outcome": outcome.name, "why": list(why)}
    )
    return LegResult(leg.id, outcome, why, refused)


def _mark(control: FlightControl, leg: Leg, phase: str, at_s: float | None = None) -> None:
    control.vehicle.mark(mark_id(leg.id), "_".join(phase.split()), at_s)
    record = next((p.record for p in leg.phases if p.name == phase), False)
    control.recorder.event(
        "phase", phase, control.session.now_s() if at_s is None else at_s, {"leg": leg.id, "record": record}
    )


def fly_leg(
    control: FlightControl, leg: Leg, airframe: AutopilotSettings, trace: ThrottleTrace | None = None
) -> LegResult:
    """Fly one leg from a settled hover in GUIDED_NOGPS. Never falls silent: ends in a release, or in the abort mode.

    trace: takes in what is sent and what the vehicle does.
    """
    control.on(Event.SETTLED)
    control.until(control.session.now_s() + off_grid(leg) * control.period_s)
    begin(control, leg)
    steering = _Profile(control, leg, airframe) if leg.profile is not None else _Path(control, leg, airframe)
    port, ahead_s = control.session.port, control.ahead_s
    port.forget_late()
    start = sent_s = control.session.now_s()
    phase_now = ""
    tick = 0
    while True:
        t_s = max(control.session.now_s() - start, tick * control.period_s)  # of the target that leaves next
        if start + t_s - sent_s + port.late_s > control.gate.held_up_max_s:
            return _refused(control, leg, (Refusal.HELD_UP,))
        if t_s >= leg.duration_s - 1e-6:
            break
        target, yaw, with_rate = steering.at(t_s)
        at_s = start + t_s if ahead_s else None
        refused = control.steer(target, yaw, with_rate, step=True, at_s=at_s)
        sent_s = start + t_s if ahead_s else control.session.now_s()
        if trace is not None:
            state = control.state
            trace.seen(state.t_s - min(state.position_age_s, 1.0), state.climb_m_s, state.height_m)
            if not refused:
                trace.sent(sent_s, target)
        if refused:
            return _refused(control, leg, refused)
        phase = next((p.name for p in reversed(leg.phases) if t_s >= p.start_s - 1e-6), "")
        if phase != phase_now:
            phase_now = phase
            _mark(control, leg, phase, at_s)
            control.show(phase=phase)
        if control.stop_asked:
            reached = supervisor.abort(control, (control.stop_reason,))
            return finish(
                control, leg, LegOutcome.STOPPED, (control.stop_reason, f"the vehicle went to {reached.name}")
            )
        # On a grid from the leg's start; a host that was held up drops ticks instead of sending them late in a burst.
        tick = max(tick + 1, math.floor((control.session.now_s() - start) / control.period_s + 1e-6) + 1)
        control.until(start + tick * control.period_s - ahead_s)
    control.until(start + leg.duration_s)
    control.release()
    ended_s = control.session.now_s()
    while control.state.uplink_silence_s > UNSURE_S * control.pace and not control.session.answered_since(ended_s):
        # Whether the step's last targets arrived is not known yet; GUID_TIMEOUT ends what did. Level targets do not hold the height: it is
        # waited for the answer to what was asked after the end, not for a link that is quick again.
        if control.state.uplink_silence_s > control.gate.uplink_silence_max_s:
            return _refused(control, leg, (Refusal.UPLINK,))
        control.cycle()
        control.release()
    return finish(control, leg, LegOutcome.FLOWN)


def off_grid(leg: Leg) -> float:
    """Share of the target period by which a leg begins late: a quarter of it 0 to 3 times, by the leg's name.

    Where targets and telemetry keep one grid (a simulator in lock-step), every response would be sampled at the same moments after its
    step: what the equations get wrong between two samples would be alike in all repeats of a flight, and otherwise in the next flight.
    """
    return hashlib.sha256(leg.id.encode()).digest()[0] % _PHASES / _PHASES


def _refused(control: FlightControl, leg: Leg, refused: tuple[Refusal, ...]) -> LegResult:
    why = refusal_sentences(refused)
    reached = supervisor.abort(control, why, leg.id)
    lost = bool(LINK & set(refused))
    if lost:
        control.recorder.event("link_lost", leg.id, control.session.now_s(), {"leg": leg.id})
    outcome = LegOutcome.LINK_LOST if lost else LegOutcome.REFUSED
    result = finish(control, leg, outcome, (*why, f"the vehicle went to {reached.name}"), refused)
    supervisor.come_to_rest(control)
    return result


class _Profile:
    """Targets of a profile, with the heading for the quaternion."""

    def __init__(self, control: FlightControl, leg: Leg, airframe: AutopilotSettings) -> None:
        assert leg.profile is not None
        self._profile = leg.profile
        # Always from the present heading: a quaternion of "no rotation" points North.
        self._yaw0 = control.state.attitude_rad[2] if control.state.attitude_rad else leg.heading_rad
        self._heading = SentHeading(self._yaw0, airframe.yaw_accel_max_rad_s2, airframe.yaw_lag_s)
        self._turning = False
        self._last_s = 0.0

    def at(self, t_s: float) -> tuple[AttitudeTarget, float, bool]:
        """Target, heading for the quaternion, and whether body rates go along, at t_s from the leg's start."""
        target = self._profile(t_s)
        self._turning = self._turning or target.yaw_rate_rad_s != 0.0
        if not self._turning:
            self._last_s = t_s
            return target, self._yaw0, False
        yaw = self._heading.next(target.yaw_rate_rad_s, t_s - self._last_s)
        self._last_s = t_s
        return target, yaw, True


class _Path:
    """Targets that follow waypoints by the outer loop."""

    def __init__(self, control: FlightControl, leg: Leg, airframe: AutopilotSettings) -> None:
        self._control = control
        self._leg = leg
        self._loop = HoldLoop(control, airframe.angle_boost)

    def at(self, t_s: float) -> tuple[AttitudeTarget, float, bool]:
        """Target and heading at t_s from the leg's start."""
        zone = self._control.gate.zone
        place, pace = along(self._leg.waypoints, t_s)
        world = tuple(float(x) for x in zone.to_world(place))
        speed = tuple(float(x) for x in zone.to_world(pace))
        goal = LegStart((world[0], world[1], world[2]), self._leg.heading_rad, 0.0)
        target, yaw = self._loop.target(goal, (speed[0], speed[1], speed[2]))
        return target, yaw, False
