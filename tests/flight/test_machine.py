"""The table of states: complete, without a dead end, and truthful about who has the vehicle."""

from itertools import product

import pytest

from flighttest.flight.execution.machine import (
    ENDS,
    EXTERNAL,
    OURS,
    TABLE,
    Event,
    FlightState,
    Machine,
    drawing,
    table_as_markdown,
)
from flighttest.flight.outcome import FlightEnded, FlightOutcome

LIVE = [s for s in FlightState if not s.is_end]


@pytest.mark.parametrize(("state", "event"), list(product(LIVE, EXTERNAL)))
def test_what_others_do_is_foreseen_in_every_state(state: FlightState, event: Event) -> None:
    assert (state, event) in TABLE


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
    for state in OURS:
        nobodys = state is FlightState.ARMING  # as long as it is not armed
        assert TABLE[state, Event.FOREIGN_MODE].state is (FlightState.NOT_ARMED if nobodys else FlightState.WITH_PILOT)
        assert TABLE[state, Event.FOREIGN_MODE].outcome is not None


def test_an_end_is_an_end_and_only_some_are_safe() -> None:
    assert all(TABLE[s, e].state is s for s in ENDS for e in Event)
    assert {s for s in ENDS if s.is_safe} == {FlightState.NOT_ARMED, FlightState.LANDED, FlightState.WITH_PILOT}


def test_what_is_not_foreseen_is_a_defect_of_ours() -> None:
    with pytest.raises(KeyError):
        Machine(FlightState.GROUND).on(Event.SETTLED)


def test_no_outcome_claims_a_landing() -> None:
    assert not [o.name for o in FlightOutcome if "landed" in o.value]


def test_the_drawing_has_every_state_and_change() -> None:
    text = drawing() + table_as_markdown()
    assert all(state.name in text for state in FlightState)
    assert all(event.name in text for event in Event)
