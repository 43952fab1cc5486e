"""The table of states: complete, without a dead end, and truthful about who has the vehicle."""

from itertools import product

import pytest

from flighttest.flight.execution import climb, control, scheduler, supervisor
from flighttest.flight.execution.machine import (
    ENDS,
    EXTERNAL,
    IMPOSSIBLE,
    OURS,
    TABLE,
    Event,
    FlightState,
    Machine,
    table_as_markdown,
)
from flighttest.flight.outcome import FlightEnded, FlightOutcome
from flighttest.link.session import UNANSWERED_S
from tests.flight.faulty import GATE, GOOD

LIVE = [s for s in FlightState if not s.is_end]
HELD_TO = """
state     event         follows        outcome
GROUND    ARM           ARMING
GROUND    ARMED         WITH_PILOT     ARMED_BY_PILOT
GROUND    FOREIGN_MODE  GROUND
GROUND    DISARMED      GROUND
GROUND    DROPPED       GROUND
GROUND    REBOOTED      GROUND
GROUND    DOWNLINK_GONE NOT_ARMED      LINK_LOST
GROUND    UPLINK_GONE   GROUND
GROUND    OVER          NOT_ARMED
ARMING    ARMED         CLIMBING
ARMING    FOREIGN_MODE  NOT_ARMED      TAKE_OVER
ARMING    REBOOTED      NOT_ARMED      REBOOTED
ARMING    DOWNLINK_GONE UNKNOWN        LINK_LOST
ARMING    UPLINK_GONE   TO_AUTOPILOT   UPLINK_LOST
ARMING    OVER          NOT_ARMED
CLIMBING  RETURN        RETURNING
CLIMBING  ASK           ASKING
CLIMBING  FOREIGN_MODE  WITH_PILOT     TAKE_OVER
CLIMBING  DISARMED      DISARMED       DISARMED
CLIMBING  DROPPED       DISARMED       DISARMED
CLIMBING  REBOOTED      UNKNOWN        REBOOTED
CLIMBING  DOWNLINK_GONE UNKNOWN        LINK_LOST
CLIMBING  OVER          TO_AUTOPILOT
RETURNING RETURN        RETURNING
RETURNING SETTLED       FLYING
RETURNING ASK           ASKING
RETURNING HAND_OVER     OFFERED
RETURNING FOREIGN_MODE  WITH_PILOT     TAKE_OVER
RETURNING DISARMED      DISARMED       DISARMED
RETURNING DROPPED       DISARMED       DISARMED
RETURNING REBOOTED      UNKNOWN        REBOOTED
RETURNING DOWNLINK_GONE UNKNOWN        LINK_LOST
RETURNING UPLINK_GONE   TO_AUTOPILOT   UPLINK_LOST
RETURNING OVER          TO_AUTOPILOT
FLYING    RETURN        RETURNING
FLYING    ASK           ASKING
FLYING    FOREIGN_MODE  WITH_PILOT     TAKE_OVER
FLYING    DISARMED      DISARMED       DISARMED
FLYING    DROPPED       DISARMED       DISARMED
FLYING    REBOOTED      UNKNOWN        REBOOTED
FLYING    DOWNLINK_GONE UNKNOWN        LINK_LOST
FLYING    OVER          TO_AUTOPILOT
ASKING    ASK           ASKING
ASKING    HOLDS         HOLDING
ASKING    LANDS         LANDING
ASKING    FOREIGN_MODE  WITH_PILOT     TAKE_OVER
ASKING    DISARMED      DISARMED       DISARMED
ASKING    DROPPED       DISARMED       DISARMED
ASKING    REBOOTED      UNKNOWN        REBOOTED
ASKING    DOWNLINK_GONE UNKNOWN        LINK_LOST
ASKING    UPLINK_GONE   TO_AUTOPILOT   UPLINK_LOST
ASKING    GIVEN_UP      TO_AUTOPILOT   OPERATOR_ABORT
ASKING    OVER          TO_AUTOPILOT
HOLDING   RETURN        RETURNING
HOLDING   ASK           ASKING
HOLDING   FOREIGN_MODE  WITH_PILOT     TAKE_OVER
HOLDING   DISARMED      DISARMED       DISARMED
HOLDING   DROPPED       DISARMED       DISARMED
HOLDING   REBOOTED      UNKNOWN        REBOOTED
HOLDING   DOWNLINK_GONE UNKNOWN        LINK_LOST
HOLDING   OVER          IN_ABORT_MODE
LANDING   RETURN        RETURNING
LANDING   ASK           ASKING
LANDING   FOREIGN_MODE  WITH_PILOT     LEFT_TO_PILOT
LANDING   DISARMED      LANDED
LANDING   DROPPED       DISARMED       DISARMED
LANDING   REBOOTED      UNKNOWN        REBOOTED
LANDING   DOWNLINK_GONE LANDING_UNSEEN LINK_LOST
LANDING   UPLINK_GONE   LANDING
LANDING   NOT_DOWN      STILL_ARMED    NOT_LANDED
LANDING   OVER          LANDING_UNSEEN
OFFERED   RETURN        OFFERED
OFFERED   HAND_OVER     OFFERED
OFFERED   FOREIGN_MODE  HANDED
OFFERED   ASK           ASKING
OFFERED   DISARMED      DISARMED       DISARMED
OFFERED   DROPPED       DISARMED       DISARMED
OFFERED   REBOOTED      UNKNOWN        REBOOTED
OFFERED   DOWNLINK_GONE UNKNOWN        LINK_LOST
OFFERED   UPLINK_GONE   OFFERED
OFFERED   OVER          TO_AUTOPILOT
HANDED    RETURN        HANDED
HANDED    HAND_OVER     HANDED
HANDED    HANDED_BACK   RETURNING
HANDED    FOREIGN_MODE  HANDED
HANDED    DISARMED      HANDED
HANDED    DROPPED       HANDED
HANDED    REBOOTED      WITH_PILOT     REBOOTED
HANDED    DOWNLINK_GONE WITH_PILOT     LINK_LOST
HANDED    UPLINK_GONE   HANDED
HANDED    OVER          WITH_PILOT
"""
"""Written out: what the table is held to, row by row. Nothing else is foreseen in a state that is no end."""


def test_the_table_is_the_one_written_out() -> None:
    made = {
        (s.name, e.name, n.state.name, n.outcome.name if n.outcome else "") for (s, e), n in TABLE.items() if s in LIVE
    }
    rows = [line.split() for line in HELD_TO.strip().splitlines()[1:]]
    assert made == {(s, e, n, *(outcome or [""])) for s, e, n, *outcome in rows}


@pytest.mark.parametrize(("state", "event"), list(product(LIVE, EXTERNAL)))
def test_what_others_do_is_foreseen_in_every_state(state: FlightState, event: Event) -> None:
    assert ((state, event) in TABLE) is not ((state, event) in IMPOSSIBLE)


def test_what_is_called_impossible_is_so_by_its_limits() -> None:
    longest_climb_s = climb.TAKE_OFF_WITHIN_S + scheduler.CLIMBS_WITHIN_S
    assert longest_climb_s + UNANSWERED_S < control.UPLINK_GIVE_UP_S, (
        "the take-off itself waits for an answer for so long"
    )
    assert GATE.uplink_silence_max_s < control.UPLINK_GIVE_UP_S
    held_s = supervisor.NEXT_MODE_AFTER_S * len(supervisor.abort_modes(GOOD)) + supervisor.REST_PATIENCE_S
    assert GATE.uplink_silence_max_s + held_s < control.UPLINK_GIVE_UP_S


@pytest.mark.parametrize(("state", "event"), list(TABLE))
def test_every_transition(state: FlightState, event: Event) -> None:
    following = TABLE[state, event]
    machine = Machine(state)
    if following.outcome is None or following.state is state:
        assert machine.on(event) is following.state
    else:
        with pytest.raises(FlightEnded) as ended:
            machine.on(event)
        assert ended.value.outcome is following.outcome
    assert machine.state is following.state
    assert following.outcome is None or following.state.is_end, "an outcome is an end"
    if event is Event.OVER:
        assert following.state.is_end


@pytest.mark.parametrize("state", [s for s in FlightState if s not in (FlightState.GROUND,)])
def test_every_state_is_reached_from_the_ground(state: FlightState) -> None:
    known, new = set(), {FlightState.GROUND}
    while new:
        known |= new
        new = {TABLE[s, e].state for s, e in TABLE if s in known} - known
    assert state in known


def test_a_landing_is_only_claimed_where_land_and_then_disarmed_were_seen() -> None:
    ways = [(s, e) for (s, e), n in TABLE.items() if n.state is FlightState.LANDED and s is not FlightState.LANDED]
    assert ways == [(FlightState.LANDING, Event.DISARMED)]


def test_the_pilot_wins_in_every_state_that_is_ours() -> None:
    for state in OURS - {FlightState.OFFERED}:
        unflown = state is FlightState.ARMING  # as long as it is not armed
        assert TABLE[state, Event.FOREIGN_MODE].state is (FlightState.NOT_ARMED if unflown else FlightState.WITH_PILOT)
        assert TABLE[state, Event.FOREIGN_MODE].outcome is not None
    assert TABLE[FlightState.OFFERED, Event.FOREIGN_MODE].state is FlightState.HANDED, "as was asked of the pilot"


def test_only_a_mode_of_the_pilots_makes_the_vehicle_the_pilots() -> None:
    ways = {e for (s, e), n in TABLE.items() if n.state is FlightState.HANDED and s is not FlightState.HANDED}
    ends = {(s, e) for (s, e), n in TABLE.items() if n.state is FlightState.WITH_PILOT and s in LIVE}
    assert ways == {Event.FOREIGN_MODE}
    by_arming = (FlightState.GROUND, Event.ARMED)
    assert all(s is FlightState.HANDED or e is Event.FOREIGN_MODE or (s, e) == by_arming for s, e in ends)


def test_an_end_is_an_end_and_only_some_are_safe() -> None:
    changed = {(s, e): TABLE[s, e].state for s in ENDS for e in Event if TABLE[s, e].state is not s}
    assert changed == {
        (FlightState.WITH_PILOT, Event.OVERRULED): FlightState.TO_AUTOPILOT,
        (FlightState.NOT_ARMED, Event.ARMED): FlightState.WITH_PILOT,
    }
    assert {s for s in ENDS if s.is_safe} == {FlightState.NOT_ARMED, FlightState.LANDED, FlightState.WITH_PILOT}


def test_what_is_not_foreseen_is_a_defect_of_ours() -> None:
    with pytest.raises(KeyError):
        Machine(FlightState.GROUND).on(Event.SETTLED)


def test_no_outcome_claims_a_landing() -> None:
    assert not [o.name for o in FlightOutcome if "landed" in o.value]


def test_the_table_of_the_docs_has_every_state_and_event() -> None:
    text = table_as_markdown()
    assert all(state.name in text for state in FlightState)
    assert all(event.name in text for event in Event)
