"""A mode that we asked for and the vehicle enters late, or is seen in late, is ours; any other is the pilot's."""

from __future__ import annotations

from pathlib import Path

import pytest

from flighttest.flight import FlightOutcome, LegOutcome
from flighttest.link.requests import ModeRequests
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options

GUIDED, NOGPS, LOITER = CopterMode.GUIDED, CopterMode.GUIDED_NOGPS, CopterMode.LOITER


def first_request(link: FaultyLink, mode: CopterMode, count: int = 1) -> list[float]:
    """When a mode was asked for the count-th time and later, filled while flying; a repeat within 1 s is the same request."""
    times: list[float] = []
    last = [-10.0]
    seen = [0]

    def look(message: object, t_s: float) -> None:
        if message.get_type() != "COMMAND_LONG" or message.command != dialect.MAV_CMD_DO_SET_MODE:  # type: ignore[attr-defined]
            return
        if message.param2 == mode:  # type: ignore[attr-defined]
            seen[0] += t_s - last[0] > 1.0
            last[0] = t_s
            if seen[0] >= count:
                times.append(t_s)

    link.hook = look
    return times


@pytest.mark.parametrize(
    ("mode", "count", "lost_s"), [(NOGPS, 1, 3.2), (NOGPS, 1, 4.5), (GUIDED, 3, 5.5), (GUIDED, 3, 6.5)]
)
def test_a_mode_of_ours_that_is_seen_late_is_not_taken_for_a_pilots(
    mode: CopterMode, count: int, lost_s: float, run_dir: Path
) -> None:
    """The uplink works and the downlink does not, from the request until after it was given up."""
    link = FaultyLink(options())
    asked = first_request(link, mode, count)
    link.mute = lambda t: bool(asked) and asked[0] <= t < asked[0] + lost_s
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link)
    assert asked
    assert result.outcome is FlightOutcome.COMPLETED
    assert {leg.leg for leg in result.legs if leg.outcome is LegOutcome.FLOWN} == {"test/a/r1", "test/b/r1"}
    assert not link.sim.vehicle.armed
    assert not result.parameters_left


def test_a_pilots_mode_after_a_late_one_of_ours_is_the_pilots(run_dir: Path) -> None:
    link = FaultyLink(options())
    asked = first_request(link, NOGPS)
    switched: list[float] = []

    def mute(t_s: float) -> bool:
        if asked and not switched and t_s > asked[0] + 2.0:
            switched.append(t_s)
            link.set_parameter("SIM_PILOT_MODE", float(LOITER))
        return bool(asked) and asked[0] <= t_s < asked[0] + 3.2

    link.mute = mute
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert link.sim.vehicle.mode == LOITER


def test_a_request_stays_open_until_a_round_trip_closes_it() -> None:
    requests = ModeRequests()
    requests.sent(NOGPS, 10.0)
    requests.answered(10.1, 10.2)  # asked too soon after: the request may come after it
    assert requests.shows(GUIDED, 10.6) is False
    assert requests.open == {NOGPS}
    requests.sent(GUIDED, 11.0)
    requests.answered(10.6, 11.1)
    assert requests.shows(NOGPS, 11.2) is True, "as soon as it is seen"
    assert requests.open == {NOGPS, GUIDED}
    requests.shows(NOGPS, 11.5)
    assert requests.open == {GUIDED}, "the answer to a later question is no answer to a later request"
    requests.answered(11.5, 11.6)
    assert requests.shows(GUIDED, 12.0) is True
    assert requests.open == set()
    assert requests.shows(GUIDED, 12.1) is False


@pytest.mark.parametrize("mode", [CopterMode.BRAKE, CopterMode.LAND])
def test_a_pilot_who_chooses_the_mode_that_an_abort_would_ask_for_keeps_it(mode: CopterMode, run_dir: Path) -> None:
    """The first HEARTBEAT with it ends the step, and so begins an abort into BRAKE; the second is the pilot's all the same."""
    link = FaultyLink(options())
    steps: list[float] = []

    def look(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            steps.append(t_s)
            link.set_parameter("SIM_PILOT_MODE", float(mode))

    link.hook = look
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert len(steps) == 1, "nothing is flown after it"
    assert link.sim.vehicle.mode == mode


def test_a_vehicle_that_leaves_land_for_a_mode_of_ours_is_landed(run_dir: Path) -> None:
    """BRAKE, asked for before LAND, is shown after it (sent twice by the link): LAND is asked for again."""
    link = FaultyLink(options())
    seen: list[float] = []
    steps: list[float] = []

    def look(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            steps.append(t_s)
        mode = message.param2 if message.get_type() == "COMMAND_LONG" else None  # type: ignore[attr-defined]
        if mode == CopterMode.BRAKE and not seen:
            seen.append(t_s)

    def mute(t_s: float) -> bool:
        if len(seen) == 1 and t_s > seen[0] + 0.15:
            assert link.sim.vehicle.mode == CopterMode.LAND
            seen.append(t_s)
            link.sim.vehicle.set_mode(int(CopterMode.BRAKE))
        return False

    link.hook, link.mute = look, mute
    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=lambda: len(steps))
    assert len(seen) == 2
    assert (result.outcome.name, result.left.name) == ("OPERATOR_STOP", "LANDED")
    assert not link.sim.vehicle.armed
