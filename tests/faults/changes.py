"""A flight for each change of state that no cell of the table makes: the fault begins when the flight's state is the row's.

Two HEARTBEATs decide, and the first one ends a step; both come at once where the program was held up for a moment.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from flighttest.flight import FlightState
from flighttest.flight.execution.machine import TABLE, Event
from flighttest.mavlink import CopterMode
from flighttest.plan import AttitudeTarget, Plan
from flighttest.sim import SimOptions
from tests.faults.cells import FOR_GOOD_S, REFUSED, Cell, judge
from tests.faults.proxy import Fault, Proxy, When
from tests.flight.faulty import fly, make_leg, make_plan

S, E = FlightState, Event
_HELD_UP_S = 0.4  # four HEARTBEATs; less than what ends a step by itself
_SUSPENDED_S = 35.0  # a laptop that was closed
_DROPPED = Fault("motors stopped and mode changed, held up", 1.0, kill=True, pilot_after_s=0.05, freeze_s=_HELD_UP_S)
_STOPPED = Fault("motors stopped, held up", 1.0, kill=True, freeze_s=_HELD_UP_S)
_REBOOT = Fault("reboot, no HEARTBEAT for 3 s", 3.0, reboot=True, no_beats=True)
_BROKEN = Fault("transport broken", FOR_GOOD_S, broken=True)
_UNHEARD = Fault("suspended, down for good", FOR_GOOD_S, down=True, freeze_s=_SUSPENDED_S)


def _too_steep(t_s: float) -> AttitudeTarget:
    """A roll that gathers speed, then one that the gate refuses: the abort mode has to bring the vehicle to rest."""
    return AttitudeTarget(t_s, 0.3 if t_s < 1.2 else 0.8, 0.0, 0.0, 0.18)


def _one() -> Plan:
    return make_plan(make_leg())


def _refused() -> Plan:
    return make_plan(make_leg(profile=_too_steep))


def _by_attitude() -> Plan:
    return make_plan(make_leg(), by="attitude")


def _by_pilot() -> Plan:
    return make_plan(make_leg(), by="pilot")


def _refused_by_pilot() -> Plan:
    return make_plan(make_leg("a", profile=_too_steep), make_leg("b"), by="pilot")


def _resting_first() -> Plan:
    return make_plan(replace(make_leg("rest", duration_s=8.0), motors_off=True), make_leg())


def _resting() -> Plan:
    return make_plan(replace(make_leg("rest", duration_s=45.0), motors_off=True))


PLANS = {
    "one step": _one,
    "refused step": _refused,
    "by attitude": _by_attitude,
    "by pilot": _by_pilot,
    "pilot flies": _by_pilot,
    "refused step, pilot flies": _refused_by_pilot,
    "rest": _resting,
    "rest, one step": _resting_first,
}


PILOTS = {"pilot flies": CopterMode.LOITER, "refused step, pilot flies": CopterMode.GUIDED_NOGPS}
"""What the pilot chooses as soon as the vehicle is offered for the first time, by plan."""


@dataclass
class Piloted(Proxy):
    """A proxy with a pilot who takes the vehicle as soon as it is offered for the first time."""

    chosen: CopterMode = CopterMode.LOITER

    def reach(self, when: When | FlightState) -> None:
        """Note that the client has come to that."""
        first = not self.reached(when)
        super().reach(when)
        if when is S.OFFERED and first:
            self._choose(self.chosen)


@dataclass(frozen=True)
class Provoked:
    """A row of the table of states, and the flight in which it happens. after_s: from the state's beginning (or `when`) to the fault's."""

    state: FlightState
    event: Event
    fault: Fault
    plan: str = "one step"
    after_s: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    when: When | None = None

    def fly(self) -> Cell:
        """Fly it; wrong also where the row does not happen, or does not end as the table says."""
        options = SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0, parameters=dict(self.parameters))
        what = (options, self.fault, self.when or self.state, self.after_s)
        proxy = Piloted(*what, chosen=PILOTS[self.plan]) if self.plan in PILOTS else Proxy(*what)
        with tempfile.TemporaryDirectory() as folder:
            cell = judge(
                proxy,
                lambda stops: fly(
                    PLANS[self.plan](),
                    "proxy",
                    Path(folder) / "run",
                    transport=proxy,
                    clock=proxy.clock(),
                    stop_requested=stops,
                ),
                lambda: proxy.sim.vehicle,
            )
        wrong = (
            [] if (self.state, self.event) in cell.changes else [f"{self.state.name} {self.event.name} did not happen"]
        )
        follows = TABLE[self.state, self.event]
        ends = f"{follows.outcome.name}, {follows.state.name}" if follows.outcome is not None else ""
        if not wrong and ends and cell.ended != ends and not cell.ended.startswith(REFUSED):
            wrong.append(f"ended as {cell.ended}, not as {ends}")
        return replace(cell, wrong=(*cell.wrong, *wrong))


def _at(*states: FlightState, after_s: float = 0.0) -> list[tuple[FlightState, str, float]]:
    return [(s, "refused step" if s is S.HOLDING else "one step", after_s) for s in states]


PROVOKED: tuple[Provoked, ...] = (
    *(
        Provoked(s, E.DROPPED, _DROPPED, plan, t)
        for s, plan, t in _at(S.CLIMBING, S.RETURNING, S.FLYING, S.HOLDING, S.LANDING, after_s=0.1)
    ),
    *(
        Provoked(s, E.REBOOTED, _REBOOT, plan, t)
        for s, plan, t in _at(S.ARMING, S.CLIMBING, S.RETURNING, S.HOLDING, S.LANDING)
    ),
    Provoked(S.FLYING, E.REBOOTED, Fault("clock begins anew", FOR_GOOD_S, anew=True), after_s=0.1),
    *(Provoked(s, E.DISARMED, _STOPPED, plan, t) for s, plan, t in _at(S.FLYING, S.HOLDING, after_s=0.1)),
    *(
        Provoked(s, E.FOREIGN_MODE, Fault("pilot, held up", 1.0, pilot_after_s=0.05, freeze_s=_HELD_UP_S), plan, t)
        for s, plan, t in _at(S.FLYING, S.HOLDING, after_s=0.1)
    ),
    *(
        Provoked(s, E.DOWNLINK_GONE, _UNHEARD, plan, t)
        for s, plan, t in _at(S.CLIMBING, S.FLYING, S.HOLDING, S.LANDING, after_s=0.1)
    ),
    Provoked(
        S.GROUND, E.DOWNLINK_GONE, Fault("down for good", FOR_GOOD_S, down=True), "rest", 12.0, when=When.PREFLIGHT
    ),
    Provoked(S.GROUND, E.ARMED, Fault("pilot arms", 1.0, arm=True), "rest, one step", 8.0, when=When.PREFLIGHT),
    Provoked(S.ASKING, E.GIVEN_UP, Fault("Ctrl-C twice, up for good", FOR_GOOD_S, up=True, presses=2)),
    Provoked(S.CLIMBING, E.OVER, _BROKEN, "by attitude", 1.0),
    Provoked(S.RETURNING, E.OVER, _BROKEN, "by attitude", 1.0),
    Provoked(S.FLYING, E.OVER, _BROKEN, "one step", 0.4),
    Provoked(S.ASKING, E.OVER, _BROKEN),
    Provoked(S.LANDING, E.OVER, _BROKEN, "one step", 1.0),
    Provoked(
        S.WITH_PILOT,
        E.OVERRULED,
        Fault("pilot 100 ms after a request, 300 ms latency", 30.0, latency_s=0.3, pilot_after_s=0.1),
        "one step",
        when=When.ENTERING,
    ),
    Provoked(
        S.NOT_ARMED,
        E.ARMED,
        Fault("pilot as arming is asked for, 300 ms latency", 30.0, latency_s=0.3, pilot_after_s=0.0),
        "one step",
        when=When.ARMING,
    ),
    Provoked(S.LANDING, E.NOT_DOWN, Fault("a descent of 1 cm/s", FOR_GOOD_S), parameters={"LAND_SPD_MS": 0.01}),
    Provoked(S.RETURNING, E.HAND_OVER, Fault("pilot", 1.0, pilot_after_s=0.5, back_after_s=3.0), "by pilot"),
    Provoked(S.OFFERED, E.FOREIGN_MODE, Fault("pilot", 1.0, pilot_after_s=0.5, back_after_s=3.0), "by pilot"),
    Provoked(S.OFFERED, E.ASK, Fault("Ctrl-C", 1.0, presses=1), "by pilot", 1.0),
    Provoked(S.OFFERED, E.ASK, Fault("Ctrl-C twice", 1.0, presses=2), "by pilot", 1.0),
    Provoked(S.OFFERED, E.REBOOTED, _REBOOT, "by pilot", 1.0),
    Provoked(S.OFFERED, E.DOWNLINK_GONE, Fault("down for good", FOR_GOOD_S, down=True), "by pilot", 1.0),
    Provoked(S.OFFERED, E.DISARMED, _STOPPED, "by pilot", 1.0),
    Provoked(S.OFFERED, E.DROPPED, _DROPPED, "by pilot", 1.0),
    Provoked(S.OFFERED, E.OVER, _BROKEN, "refused step, pilot flies", 8.0, when=S.HOLDING),
    Provoked(S.HANDED, E.HANDED_BACK, Fault("pilot hands back", 1.0, back_after_s=2.0), "pilot flies"),
    Provoked(S.HANDED, E.OVER, Fault("Ctrl-C", 1.0, presses=1), "pilot flies", 1.0),
    Provoked(S.HANDED, E.OVER, Fault("Ctrl-C twice", 1.0, presses=2), "pilot flies", 1.0),
    Provoked(S.HANDED, E.REBOOTED, Fault("reboot", 1.0, reboot=True), "pilot flies", 1.0),
    Provoked(S.HANDED, E.DOWNLINK_GONE, Fault("down for good", FOR_GOOD_S, down=True), "pilot flies", 1.0),
)
