"""What is said of a flight that lacks steps: why each is missing, the command that flies them, and first of all where the vehicle is."""

from __future__ import annotations

from pathlib import Path

import pytest

from flighttest.flight import FlightOutcome, FlightResult, FlightState, LegOutcome
from flighttest.flight.gate import Refusal, refusal_sentences
from flighttest.flight.outcome import LegResult
from flighttest.pipeline.flights.missing import first_news, resume_command, unflown_steps
from tests.flight.faulty import make_leg, make_plan

PLAN = make_plan(make_leg("a"), make_leg("b"))
BOTH = (Refusal.HEIGHT, Refusal.SPEED)


def ended(
    outcome: FlightOutcome, *legs: LegResult, left: FlightState = FlightState.LANDED, mode: str = ""
) -> FlightResult:
    return FlightResult(outcome, Path("run"), legs, left=left, mode=mode)


def refused(*why: Refusal) -> LegResult:
    return LegResult("test/a/r1", LegOutcome.REFUSED, (*refusal_sentences(why), "the vehicle went to BRAKE"), why)


FLOWN = LegResult("test/b/r1", LegOutcome.FLOWN)


def resume(flight: FlightResult, monkeypatch: pytest.MonkeyPatch) -> str:
    flown = frozenset(leg.leg for leg in flight.legs if leg.outcome is LegOutcome.FLOWN)
    monkeypatch.setattr("flighttest.pipeline.flights.missing.flown_in", lambda _runs: flown)
    return resume_command(PLAN, flight, (), (), " --set-params")


def test_a_step_that_two_reasons_stopped_names_both() -> None:
    """The second was left out, and with it what was to be mended."""
    [sentence] = unflown_steps(ended(FlightOutcome.COMPLETED, refused(*BOTH), FLOWN))
    assert sentence.endswith("; ".join(refusal_sentences(BOTH)))


@pytest.mark.parametrize(
    "flight",
    [
        ended(FlightOutcome.COMPLETED, refused(*BOTH), FLOWN),
        ended(FlightOutcome.NOTHING_FLOWN, refused(*BOTH)),
        ended(FlightOutcome.ABORTED_BY_GATE, refused(*BOTH), FLOWN),
        ended(FlightOutcome.ABORTED_BY_GATE, FLOWN, refused(Refusal.EKF)),
        ended(FlightOutcome.TAKE_OVER, FLOWN, left=FlightState.WITH_PILOT),
    ],
)
def test_what_wind_link_or_pilot_stopped_is_flown_by_the_command_that_is_printed(
    flight: FlightResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flight that the gate had ended printed none: what it lacked was flown again from the start."""
    assert resume(flight, monkeypatch) == "flighttest run --resume run --set-params"


@pytest.mark.parametrize(
    "flight",
    [
        ended(FlightOutcome.COMPLETED, LegResult("test/a/r1", LegOutcome.FLOWN), FLOWN),
        ended(FlightOutcome.COMPLETED, LegResult("test/a/r1", LegOutcome.UNFIT), FLOWN),
        ended(FlightOutcome.NOTHING_FLOWN, LegResult("test/a/r1", LegOutcome.UNFIT)),
        ended(FlightOutcome.ABORTED_BY_GATE, FLOWN, refused(Refusal.MEASURED_TILT)),
        ended(FlightOutcome.ABORTED_BY_GATE, FLOWN, refused(Refusal.HEIGHT, Refusal.ON_GROUND)),
        ended(FlightOutcome.DISARMED, FLOWN, left=FlightState.DISARMED),
    ],
)
def test_no_command_is_printed_where_another_flight_would_end_likewise(
    flight: FlightResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert resume(flight, monkeypatch) == ""


def test_an_answer_begins_with_where_the_vehicle_is() -> None:
    """BRAKE, chosen by the fence: the answer began with its fit, and the vehicle hovered until its battery was empty."""
    braked = ended(FlightOutcome.TAKE_OVER, FLOWN, left=FlightState.WITH_PILOT, mode="BRAKE")
    words = "in BRAKE, which holds it in the air until the mode switch is moved"
    assert first_news([braked]) == f"The vehicle is the pilot's (or its failsafe's or fence's), {words}."
    assert braked.sentence.endswith(words)
    assert "moved" not in ended(FlightOutcome.TAKE_OVER, left=FlightState.WITH_PILOT, mode="LOITER").sentence
    assert first_news([ended(FlightOutcome.LINK_LOST, FLOWN, left=FlightState.UNKNOWN, mode="GUIDED")]).startswith(
        "What"
    )


@pytest.mark.parametrize(
    "flight",
    [
        ended(FlightOutcome.OPERATOR_STOP, FLOWN),
        ended(FlightOutcome.LEFT_TO_PILOT, FLOWN, left=FlightState.WITH_PILOT, mode="LOITER"),
    ],
)
def test_a_vehicle_on_the_ground_or_with_its_pilot_is_no_news(flight: FlightResult) -> None:
    assert first_news([flight]) == ""
