"""The scheduler: rest, arm, take off, then leg after leg (reset, settle, enter, fly), then land. A state machine on the vehicle's clock."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

from flighttest.errors import LinkError
from flighttest.flight.execution import climb, landing, reset, supervisor
from flighttest.flight.execution import legs as flying
from flighttest.flight.execution.control import FlightControl
from flighttest.flight.execution.leg_order import LegOrder
from flighttest.flight.execution.legs import AutopilotSettings
from flighttest.flight.execution.machine import Event, FlightState
from flighttest.flight.execution.reset import Arrival
from flighttest.flight.execution.response import Learnt, Replanner, ThrottleTrace, ThrustSeen, hover_off, learnt
from flighttest.flight.gate import LINK, LOST_CONTROL, Refusal, lost_control, refusal_sentences
from flighttest.flight.outcome import FlightEnded, FlightOutcome, LegOutcome, LegResult
from flighttest.link.session import LinkSilent
from flighttest.mavlink import CopterMode
from flighttest.plan import Leg, Plan

REFUSED_IN_A_ROW_MAX = 4
UNSETTLED_IN_A_ROW_MAX = 2  # each of them tried twice
RETRIES = 1  # of a leg that the link interrupted or that did not settle
_RESET_GUESS_S = 10.0
CLIMBS_M, CLIMBS_WITHIN_S = 0.3, 4.0  # the built-in vehicle is lower 2 s after the first of two requests
_VOLTAGE_WAIT_S = 1.0
_CATCH_UP_S = 0.3  # of planning: some HEARTBEATs
PLANS_MAX = 8  # a vehicle that no plan holds for long is flown as it is, with the gate as judge
HOVER_WARNING = 0.10


@dataclass
class Scheduler:
    """Flies a plan. results: one per leg tried, in order. skip: ids of legs that are already there. on_armed: called before the
    take-off."""

    control: FlightControl
    plan: Plan
    airframe: AutopilotSettings
    skip: Collection[str] = ()
    replanner: Replanner | None = None
    on_armed: Callable[[], None] = lambda: None
    results: list[LegResult] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _reset_s: float = _RESET_GUESS_S
    _seen: list[ThrustSeen] = field(default_factory=list)
    _hover: tuple[float, float] | None = None
    _plans: int = 0
    _doubted_hover: bool = False

    def fly(self) -> FlightOutcome:
        """The whole flight, down to the ground. FlightEnded where it ended by something else than the plan or the operator."""
        todo = [leg for leg in self.plan.legs if leg.id not in self.skip]
        on_ground = [leg for leg in todo if leg.motors_off]
        in_air = [leg for leg in todo if not leg.motors_off]
        for leg in on_ground:
            self._show(leg, todo, "resting with motors off")
            self.results.append(flying.rest(self.control, leg))
            if self.control.stop_asked:
                return self._stopped()
        if not in_air:
            return FlightOutcome.COMPLETED
        if self.control.stop_asked:
            return self._stopped()
        outcome = self.take_off() or self._legs(in_air)
        if not self.control.owned:
            return FlightOutcome.LEFT_TO_PILOT if outcome is FlightOutcome.COMPLETED else outcome
        if outcome is not FlightOutcome.OPERATOR_ABORT:
            self._say_why_it_lands(outcome)
            try:
                landing.land(self.control)
            except FlightEnded:
                if outcome is FlightOutcome.COMPLETED:
                    raise
                # The outcome is what ended the flight first, not how the landing ended.
        return outcome

    def _say_why_it_lands(self, outcome: FlightOutcome) -> None:
        """An alarm where it was neither planned nor asked for by the operator."""
        if outcome not in (FlightOutcome.COMPLETED, FlightOutcome.OPERATOR_STOP):
            last = self.notes[-1:] if outcome is FlightOutcome.CLIMB_ENDED else []
            if outcome is FlightOutcome.SET_UP_ANEW:
                last = self.control.external_changes.vital[:1]
            self.control.alarm("; ".join([f"landing: {outcome.value}", *last]))

    # -- up and down ---------------------------------------------------------------------------------------------------------

    def take_off(self) -> FlightOutcome | None:
        """Arm and climb to the reset height, or as far as the operator lets it; where the flight ends here, with what."""
        control, vehicle = self.control, self.control.vehicle
        height = self.plan.reset.to_m[2]
        by_position = self.plan.reset.by != "attitude"
        control.show(
            legs=len(self.plan.legs), doing="arming", next="take-off", time_left_s=self._time_left(self.plan.legs)
        )
        if vehicle.armed:  # since the preflight: while the operator was asked, or a step rested with motors off
            control.on(Event.ARMED)
        # Before arming: that may take a minute, and a pilot who changes the mode meanwhile means it not to fly.
        control.on(Event.ARM)
        vehicle.set_mode(CopterMode.GUIDED if by_position else CopterMode.GUIDED_NOGPS)
        if not vehicle.arm(stopped=lambda: control.stop_asked) or control.stop_asked:
            self._disarm()
            return self._stopped()
        control.on(Event.ARMED)
        control.recorder.event("note", "armed", control.session.now_s())
        self.on_armed()
        control.show(doing="taking off", next=self.plan.legs[0].id)
        if not by_position:
            return self._climbed(climb.by_throttle(control, height))
        answer = vehicle.take_off(height)
        # A repeated request is refused in the air.
        climbs = answer.tries > 1 and climb.reaches(control, CLIMBS_M, CLIMBS_WITHIN_S)
        if answer.result is None and not climbs:
            self.notes.append("the vehicle did not answer the request to take off")
            return FlightOutcome.CLIMB_ENDED
        if not answer.accepted and not climbs:
            raise LinkError(
                f"take-off was refused ({answer.sentence})", "remove the reason that the vehicle gave, then fly again"
            )
        return self._climbed(climb.by_position(control, height))

    def disarm_when_heard(self) -> None:
        """The link was lost while arming: it may be armed by now. FlightEnded where it does not come back, or is not seen to disarm."""
        control = self.control
        control.after()
        while control.machine.state is FlightState.ARMING:
            if max(control.state.mode_age_s, control.state.uplink_silence_s) <= supervisor.UNSEEN_S:
                with contextlib.suppress(LinkSilent):  # lost again
                    self._disarm()
            control.cycle()
        if control.owned:
            landing.land(control)

    def land_after(self, error: LinkError) -> FlightOutcome:
        """Land a vehicle that may be in the air, after a command that was refused or not answered; with what the flight ends."""
        control, silent = self.control, isinstance(error, LinkSilent)
        if control.machine.state is FlightState.ARMING and (silent or control.vehicle.armed):
            self.disarm_when_heard()
            return FlightOutcome.LINK_LOST if silent else FlightOutcome.VEHICLE_REFUSED
        if control.machine.state in (FlightState.GROUND, FlightState.ARMING):
            control.on(Event.OVER)
            return FlightOutcome.VEHICLE_REFUSED
        if not control.owned:
            return FlightOutcome.LEFT_TO_PILOT
        self._note(f"landing after: {error.message}")
        control.alarm(f"landing after: {error.message}")
        landing.land(control)
        return FlightOutcome.LINK_LOST if silent else FlightOutcome.VEHICLE_REFUSED

    def _disarm(self) -> None:
        """Disarm a vehicle that has not taken off. It is still ours, to be landed, where it is armed and does not confirm."""
        confirmed = self.control.vehicle.disarm().accepted or not self.control.vehicle.armed
        self.control.on(Event.OVER if confirmed else Event.ARMED)

    def _climbed(self, why_not: str) -> FlightOutcome | None:
        """None where the climb reached its height or the operator ended it; else the flight ends. why_not: as of `climb`."""
        if not why_not:
            return None
        self.notes.append(why_not)
        return FlightOutcome.CLIMB_ENDED

    # -- legs ----------------------------------------------------------------------------------------------------------------

    def _legs(self, legs: list[Leg]) -> FlightOutcome:
        order = LegOrder(legs, self.plan.legs)
        while (leg := order.next()) is not None:
            if order.refused_too_often(leg):
                self.results.append(LegResult(order.drop(), LegOutcome.LEFT_OUT))
                continue
            plan = self.plan
            tried = self._try(leg, order.remaining)
            if isinstance(tried, FlightOutcome):
                return tried
            if self.plan is not plan:
                order.plan_again(self.plan.legs)
            if tried is None:
                continue
            order.drop()
            ended = self._asked_to_end() or self._ended_by(leg, tried, order)
            if ended is not None:
                return ended
        self.results += [LegResult(i, LegOutcome.UNFIT, self._why_unfit(i)) for i in order.unfit]
        flown = any(r.outcome is LegOutcome.FLOWN for r in self.results)
        return FlightOutcome.COMPLETED if flown else FlightOutcome.NOTHING_FLOWN

    def _try(self, leg: Leg, remaining: list[Leg]) -> LegResult | FlightOutcome | None:
        """A leg, again where the link interrupted it or it did not settle. What ends the flight, or None where it was planned again."""
        result: LegResult | None = None
        for attempt in range(1 + RETRIES):
            if self._battery_low():
                return FlightOutcome.BATTERY
            result = self._one(leg, remaining, "again: " if attempt else "")
            if result is None:
                return None
            self.results.append(result)
            if result.outcome not in (LegOutcome.LINK_LOST, LegOutcome.NOT_SETTLED):
                break
        return result

    def _ended_by(self, leg: Leg, result: LegResult, order: LegOrder) -> FlightOutcome | None:
        """With what the flight ends by how a leg ended; None where it goes on."""
        order.count(leg, result)
        if order.unsettled_in_a_row >= UNSETTLED_IN_A_ROW_MAX:
            return FlightOutcome.NOT_SETTLED
        if result.outcome is not LegOutcome.REFUSED:
            return None
        if Refusal.BATTERY in result.refused:
            return FlightOutcome.BATTERY
        ending = LOST_CONTROL | {Refusal.EKF}
        if ending & set(result.refused) or order.refused_in_a_row >= REFUSED_IN_A_ROW_MAX:
            return FlightOutcome.ABORTED_BY_GATE
        order.try_again(leg, result, at_once=self._plan_is_due())
        return None

    def _asked_to_end(self) -> FlightOutcome | None:
        if self.control.stop_now:
            supervisor.release(self.control, "the operator asked to stop at once")
            return FlightOutcome.OPERATOR_ABORT
        return self._stopped() if self.control.stop_asked else None

    def _stopped(self) -> FlightOutcome:
        if self.control.recorder.failure:
            return FlightOutcome.RECORD_LOST
        return FlightOutcome.SET_UP_ANEW if self.control.external_changes.vital else FlightOutcome.OPERATOR_STOP

    def _why_unfit(self, leg_id: str) -> tuple[str, ...]:
        return tuple(what for leg, what, _ in self.plan.refusals if leg == leg_id)

    def _one(self, leg: Leg, remaining: list[Leg], prefix: str) -> LegResult | None:
        """One leg from wherever the vehicle is; None where it was planned again at the start, and the leg is another now."""
        control = self.control
        self._show(leg, remaining, f"{prefix}going to the start")
        control.on(Event.RETURN)
        began = control.session.now_s()
        arrived = self._reset(leg)
        if arrived.how is Arrival.REFUSED:
            return self._refused_on_the_way(leg, arrived.refused)
        if not arrived.settled:
            why = (control.stop_reason if arrived.how is Arrival.STOPPED else arrived.how.value,)
            control.recorder.event("note", f"{leg.id}: {why[0]}", control.session.now_s())
            if control.state.mode == CopterMode.GUIDED_NOGPS and control.owned:
                supervisor.abort(control, why)
            return LegResult(
                leg.id, LegOutcome.STOPPED if arrived.how is Arrival.STOPPED else LegOutcome.NOT_SETTLED, why
            )
        self._use_hover(arrived.hover_throttle)
        self._reset_s += 0.3 * (control.session.now_s() - began - self._reset_s)
        if self._plan_is_due():
            self._plan_again()
            return None
        if not supervisor.enter_nogps(control, lambda: reset.hold_place(control, self._start_of(leg))):
            return LegResult(leg.id, LegOutcome.NOT_SETTLED, (Arrival.NO_NOGPS.value,))
        self._show(leg, remaining, "flying")
        trace = ThrottleTrace(control.hover_throttle, self.airframe.angle_boost)
        flown = leg.flown_with(control.hover_throttle, self.airframe.angle_boost)
        result = flying.fly_leg(control, flown, self.airframe, trace)
        seen = trace.thrust()
        if seen is not None:
            self._seen.append(seen)
        return result

    def _refused_on_the_way(self, leg: Leg, refused: tuple[Refusal, ...]) -> LegResult:
        why = refusal_sentences(refused)
        if LOST_CONTROL & set(refused):
            # Landed at once: no abort mode brings it back, and BRAKE and GUIDED would lift what lies on the ground.
            supervisor.report(self.control, why, "", (CopterMode.LAND,))
            return LegResult(leg.id, LegOutcome.REFUSED, why, refused)
        supervisor.abort(self.control, why)
        outcome = LegOutcome.LINK_LOST if LINK & set(refused) else LegOutcome.REFUSED
        return LegResult(leg.id, outcome, why, refused)

    # -- planning again ------------------------------------------------------------------------------------------------------

    def _learnt(self) -> Learnt | None:
        return learnt(*self._hover, self._seen) if self._hover is not None else None

    def _plan_is_due(self) -> bool:
        """Whether the vehicle differs from what the plan rests on. Only where the autopilot holds the position while planning."""
        found = self._learnt()
        if self.replanner is None or found is None or self.plan.reset.by != "guided" or self._plans >= PLANS_MAX:
            return False
        return self.replanner.due(found)

    def _plan_again(self) -> None:
        found = self._learnt()
        assert self.replanner is not None
        assert found is not None
        control = self.control
        self._plans += 1
        control.show(doing="planning again for the thrust that was seen")
        self.plan = self.replanner.plan(found)
        # What came in meanwhile is read before anything is asked for: the pilot may have taken the vehicle.
        control.until(control.session.now_s() + _CATCH_UP_S)
        control.gate = replace(control.gate, reaction_s=self.plan.reaction_s)
        control.recorder.save_plan(self.plan)
        self._note(f"planned again for what was seen: {found.words}")

    def _reset(self, leg: Leg) -> reset.Arrived:
        if (
            self.control.stop_asked
        ):  # in the climb, or while it was planned again: no mode is asked for but the one that ends the flight
            return reset.Arrived(Arrival.STOPPED)
        lost = lost_control(self.control.state, self.control.gate) if self.plan.reset.by != "pilot" else ()
        if lost:
            return reset.Arrived(Arrival.REFUSED, refused=lost)
        start = self._start_of(leg)
        if self.plan.reset.by == "guided":
            return reset.guided(self.control, start)
        if self.plan.reset.by == "attitude":
            return reset.reset_by_attitude(self.control, start, self.airframe.angle_boost)
        return reset.by_pilot(self.control)

    def _start_of(self, leg: Leg) -> reset.LegStart:
        world = self.control.gate.zone.to_world(leg.start_m)
        place = (float(world[0]), float(world[1]), float(world[2]))
        return reset.LegStart(place, leg.heading_rad, self.plan.reset.settle_s)

    def _use_hover(self, measured: float | None) -> None:
        stated = self.plan.vehicle.hover_throttle
        if measured is None:
            return
        if not 0.4 * stated <= measured <= 2.5 * stated:
            self._note(
                f"measured hover throttle {measured:.3f} is implausible beside the stated {stated:.3f}; not used"
            )
            return
        nominal = self.plan.vehicle.nominal_voltage_v
        voltage = self.control.state.voltage_v
        differs = abs(measured / stated - 1.0) > HOVER_WARNING and voltage and abs(voltage / nominal - 1.0) < 0.03
        if differs and not self._doubted_hover:
            self._doubted_hover = True
            self._note(hover_off(measured, stated, self.plan.vehicle.path))
        self.control.use_hover(measured)
        if voltage:
            self._hover = (measured, voltage)

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)
            self.control.recorder.event("note", text, self.control.session.now_s())

    def _battery_low(self) -> bool:
        limit = self.plan.limits.voltage_min_v
        while limit > 0 and self.control.state.silence_s > _VOLTAGE_WAIT_S:
            self.control.cycle()
        if limit > 0 and self.control.state.voltage_v is None:
            self.control.until(self.control.session.now_s() + _VOLTAGE_WAIT_S)  # the link may only just be back
        voltage = self.control.state.voltage_v
        return limit > 0 and (voltage is None or voltage < limit)

    # -- words ---------------------------------------------------------------------------------------------------------------

    def _time_left(self, remaining: Collection[Leg]) -> float:
        return sum(leg.duration_s for leg in remaining) + len(remaining) * self._reset_s

    def _show(self, leg: Leg, remaining: list[Leg], doing: str) -> None:
        following = remaining[1] if len(remaining) > 1 else None
        number = next((i for i, other in enumerate(self.plan.legs) if other.id == leg.id), 0)
        self.control.show(
            leg=number + 1,
            legs=len(self.plan.legs),
            doing=f"{doing}: {leg_words(leg)}" if doing else leg_words(leg),
            phase="",
            next=leg_words(following) if following is not None else "land",
            time_left_s=self._time_left(remaining),
        )


def leg_words(leg: Leg) -> str:
    """A leg in an operator's words: its id and where it points."""
    return f"{leg.id}, heading {-math.degrees(leg.heading_rad) % 360.0:.0f} deg"
