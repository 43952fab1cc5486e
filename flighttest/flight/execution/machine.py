"""The states of a flight, the events that change them, and the table of transitions: the only place that decides who has the vehicle.

A procedure reports an event to the `Machine`; the table gives the state that follows and, where the flight ends by it, the outcome.
An event that the table does not foresee in a state is a defect of this program. docs/operations.md is drawn from this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import product

from flighttest.flight.outcome import FlightEnded, FlightOutcome


class FlightState(Enum):
    """Where a flight is, or how it left the vehicle. The value is the sentence shown to the reader; {mode} is the last one heard."""

    GROUND = "on the ground, nothing is commanded"
    ARMING = "asked to arm"
    CLIMBING = "climbing to the height of the first step"
    RETURNING = "on the way to the start of a step"
    FLYING = "flying a step"
    ASKING = "asked for a safe mode (the abort mode or LAND) that HEARTBEAT does not show yet"
    HOLDING = "in its abort mode, as HEARTBEAT shows"
    LANDING = "landing, as HEARTBEAT shows"
    OFFERED = "the pilot is asked to fly, and HEARTBEAT shows no mode of the pilot's yet"
    HANDED = "flown by the pilot, by agreement"

    NOT_ARMED = "the vehicle was not armed"
    LANDED = "the vehicle landed and disarmed"
    WITH_PILOT = "the vehicle is the pilot's (or its failsafe's or fence's), in {mode}"
    IN_ABORT_MODE = "the vehicle is in the air in {mode}, as it confirmed: the pilot's to land"
    TO_AUTOPILOT = (
        "the vehicle is in the air in {mode} and left to its autopilot's failsafes: take it over with the mode switch"
    )
    STILL_ARMED = (
        "the vehicle is still armed in {mode}, long after it was asked to land: keep away from it, and disarm it with the transmitter "
        "once it is down"
    )
    LANDING_UNSEEN = "the vehicle was landing when it was last heard: whether it is down is not known"
    DISARMED = "the vehicle is disarmed: where it was last seen is noted"
    UNKNOWN = "what the vehicle does is not known, it was last heard in {mode}: take it over with the mode switch"

    __hash__ = object.__hash__  # looked up at every message; Enum's own calculates it anew from the name

    @property
    def is_end(self) -> bool:
        """Whether nothing follows."""
        return self in ENDS

    @property
    def is_safe(self) -> bool:
        """Whether a vehicle that was left so is on the ground, or with the pilot."""
        return self in (FlightState.NOT_ARMED, FlightState.LANDED, FlightState.WITH_PILOT)


class Event(Enum):
    """What changes a flight's state. The value is the sentence shown to the reader."""

    ARM = "arming begins"
    ARMED = "the vehicle is armed"
    RETURN = "the next step's start is flown to"
    SETTLED = "the vehicle is still at the start"
    ASK = "a safe mode is asked for"
    HOLDS = "HEARTBEAT shows the abort mode"
    LANDS = "HEARTBEAT shows LAND"
    HAND_OVER = "the pilot is to fly to the start"
    HANDED_BACK = "the pilot switched to GUIDED_NOGPS"
    FOREIGN_MODE = "HEARTBEAT shows a mode that was not asked for"
    OVERRULED = "after a take-over HEARTBEAT shows a mode that had been asked for before it was seen"
    DISARMED = "HEARTBEAT shows disarmed after armed"
    DROPPED = "HEARTBEAT shows disarmed after armed, and a mode that was not asked for"
    REBOOTED = "the vehicle's clock began anew"
    DOWNLINK_GONE = "no HEARTBEAT for 30 s"
    UPLINK_GONE = "heard, but no answer for 60 s"
    NOT_DOWN = "still armed 120 s after HEARTBEAT showed LAND"
    GIVEN_UP = "the operator asks for an end, and the vehicle does not answer"
    OVER = "the program ends the flight"


S, E, Out = FlightState, Event, FlightOutcome
ENDS = frozenset(
    {
        S.NOT_ARMED, S.LANDED, S.WITH_PILOT, S.IN_ABORT_MODE, S.TO_AUTOPILOT, S.STILL_ARMED, S.LANDING_UNSEEN, S.DISARMED, S.UNKNOWN,
    }
)  # fmt: skip
OURS = frozenset({S.ARMING, S.CLIMBING, S.RETURNING, S.FLYING, S.ASKING, S.HOLDING, S.LANDING, S.OFFERED})
IN_AIR = OURS - {S.ARMING}
_STEERED = (S.CLIMBING, S.RETURNING, S.FLYING)


@dataclass(frozen=True)
class Next:
    """What follows an event. outcome: where the flight ends by it; None where it goes on, or ends as it should."""

    state: FlightState
    outcome: FlightOutcome | None = None


def _table() -> dict[tuple[FlightState, Event], Next]:
    table = {
        # what the program does
        (S.GROUND, E.ARM): Next(S.ARMING),
        (S.ARMING, E.ARMED): Next(S.CLIMBING),
        (S.GROUND, E.ARMED): Next(S.WITH_PILOT, Out.ARMED_BY_PILOT),
        **{(s, E.RETURN): Next(S.RETURNING) for s in (*_STEERED, S.HOLDING, S.LANDING)},
        (S.RETURNING, E.SETTLED): Next(S.FLYING),
        **{(s, E.ASK): Next(S.ASKING) for s in (*_STEERED, S.ASKING, S.HOLDING, S.LANDING, S.OFFERED)},
        (S.ASKING, E.HOLDS): Next(S.HOLDING),
        (S.ASKING, E.LANDS): Next(S.LANDING),
        (S.RETURNING, E.HAND_OVER): Next(S.OFFERED),
        (S.HANDED, E.HANDED_BACK): Next(S.RETURNING),
        **{(s, e): Next(s) for s in (S.OFFERED, S.HANDED) for e in (E.RETURN, E.HAND_OVER)},
        # what the pilot, the vehicle and the link do, in each state
        (S.GROUND, E.FOREIGN_MODE): Next(S.GROUND),
        (S.HANDED, E.FOREIGN_MODE): Next(S.HANDED),
        (S.ARMING, E.FOREIGN_MODE): Next(S.NOT_ARMED, Out.TAKE_OVER),
        **{(s, E.FOREIGN_MODE): Next(S.WITH_PILOT, Out.TAKE_OVER) for s in IN_AIR - {S.LANDING, S.OFFERED}},
        (S.OFFERED, E.FOREIGN_MODE): Next(S.HANDED),
        (S.LANDING, E.FOREIGN_MODE): Next(S.WITH_PILOT, Out.LEFT_TO_PILOT),
        (S.GROUND, E.DISARMED): Next(S.GROUND),
        (S.HANDED, E.DISARMED): Next(S.HANDED),
        (S.LANDING, E.DISARMED): Next(S.LANDED),
        **{(s, E.DISARMED): Next(S.DISARMED, Out.DISARMED) for s in IN_AIR - {S.LANDING}},
        (S.GROUND, E.DROPPED): Next(S.GROUND),
        (S.HANDED, E.DROPPED): Next(S.HANDED),
        **{(s, E.DROPPED): Next(S.DISARMED, Out.DISARMED) for s in IN_AIR},
        (S.GROUND, E.REBOOTED): Next(S.GROUND),
        (S.HANDED, E.REBOOTED): Next(S.WITH_PILOT, Out.REBOOTED),
        (S.ARMING, E.REBOOTED): Next(S.NOT_ARMED, Out.REBOOTED),
        **{(s, E.REBOOTED): Next(S.UNKNOWN, Out.REBOOTED) for s in IN_AIR},
        (S.GROUND, E.DOWNLINK_GONE): Next(S.NOT_ARMED, Out.LINK_LOST),
        (S.HANDED, E.DOWNLINK_GONE): Next(S.WITH_PILOT, Out.LINK_LOST),
        **{(s, E.DOWNLINK_GONE): Next(S.UNKNOWN, Out.LINK_LOST) for s in OURS - {S.LANDING}},
        (S.LANDING, E.DOWNLINK_GONE): Next(S.LANDING_UNSEEN, Out.LINK_LOST),
        **{(s, E.UPLINK_GONE): Next(s) for s in (S.GROUND, S.OFFERED, S.HANDED, S.LANDING)},  # nothing has to reach the vehicle
        **{(s, E.UPLINK_GONE): Next(S.TO_AUTOPILOT, Out.UPLINK_LOST) for s in (S.ARMING, S.RETURNING, S.ASKING)},
        (S.ASKING, E.GIVEN_UP): Next(S.TO_AUTOPILOT, Out.OPERATOR_ABORT),
        (S.LANDING, E.NOT_DOWN): Next(S.STILL_ARMED, Out.NOT_LANDED),
        # the end of what the program does, wherever it stands
        (S.GROUND, E.OVER): Next(S.NOT_ARMED),
        (S.ARMING, E.OVER): Next(S.NOT_ARMED),
        (S.HANDED, E.OVER): Next(S.WITH_PILOT),
        (S.HOLDING, E.OVER): Next(S.IN_ABORT_MODE),
        (S.LANDING, E.OVER): Next(S.LANDING_UNSEEN),
        **{(s, E.OVER): Next(S.TO_AUTOPILOT) for s in (*_STEERED, S.ASKING, S.OFFERED)},
    }  # fmt: skip
    table |= {
        (s, e): Next(s) for s, e in product(ENDS, Event)
    }  # nothing changes an end, but a request that was under way
    table[S.WITH_PILOT, E.OVERRULED] = Next(S.TO_AUTOPILOT)
    table[S.NOT_ARMED, E.ARMED] = Next(S.WITH_PILOT)
    return {place: table[place] for place in product(FlightState, Event) if place in table}


TABLE = _table()
EXTERNAL = (E.FOREIGN_MODE, E.DISARMED, E.DROPPED, E.REBOOTED, E.DOWNLINK_GONE, E.UPLINK_GONE, E.OVER)
"""Events that others cause, in any state but those of `IMPOSSIBLE`."""
IMPOSSIBLE: dict[tuple[FlightState, Event], str] = {
    (S.ARMING, E.DISARMED): "disarmed follows armed, and armed ends ARMING first",
    (S.ARMING, E.DROPPED): "disarmed follows armed, and armed ends ARMING first",
    (S.CLIMBING, E.UPLINK_GONE): "a climb begins with an answer and ends within 44 s, before 60 s without one",
    (S.FLYING, E.UPLINK_GONE): "a step ends by its gate after seconds without an answer",
    (
        S.HOLDING,
        E.UPLINK_GONE,
    ): "the abort mode is asked for in the first seconds only, LAND after them, and is waited in for 6 s",
}
"""External events that a state cannot see, and why: no row, so that one would be a defect, which ends in the abort mode."""


@dataclass
class Machine:
    """The state of one flight. history: (state, event, next state) of every change."""

    state: FlightState = FlightState.GROUND

    def __post_init__(self) -> None:
        self.history: list[tuple[FlightState, Event, FlightState]] = []

    @property
    def ours(self) -> bool:
        """Whether a change of mode that was not asked for is a pilot's take-over."""
        return self.state in OURS

    def on(self, event: Event, why: str = "") -> FlightState:
        """Take in an event and return the state that follows. FlightEnded where the flight ends by it."""
        before = self.state
        following = TABLE[before, event]
        self.state = following.state
        if self.state is not before:
            self.history.append((before, event, self.state))
            if following.outcome is not None:
                raise FlightEnded(following.outcome, why)
        return self.state


def table_as_markdown() -> str:
    """The table, states down and events across, for the documentation."""
    live = [s for s in FlightState if not s.is_end or any(TABLE[s, e].state is not s for e in Event)]
    rows = []
    for state in live:
        cells = []
        for event in Event:
            following = TABLE.get((state, event))
            if following is None:
                cells.append("")
            elif following.state is state:
                cells.append("" if state.is_end else "stays")
            else:
                ends = f" ({following.outcome.name})" if following.outcome is not None else ""
                cells.append(f"{following.state.name}{ends}")
        rows.append((state, cells))
    lines = ["| state | event | follows |", "|---|---|---|"]
    for state, cells in rows:
        lines += [f"| {state.name} | {e.name} | {cell} |" for e, cell in zip(Event, cells, strict=True) if cell]
    lines += ["", "What cannot happen has no row:", ""]
    lines += [f"- {state.name} {event.name}: {why}." for (state, event), why in IMPOSSIBLE.items()]
    return "\n".join(lines) + "\n"


def words_as_markdown() -> str:
    """What each state and event means."""
    states = [f"| {s.name} | {'end' if s.is_end else 'state'} | {s.value.format(mode='MODE')} |" for s in FlightState]
    events = [f"| {e.name} | event | {e.value} |" for e in Event]
    return "\n".join(["| name | kind | meaning |", "|---|---|---|", *states, *events]) + "\n"
