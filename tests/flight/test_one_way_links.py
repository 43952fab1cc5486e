"""A link that is lost in one direction, or while landing, ends in a state that is said as it is."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from flighttest.errors import LinkError
from flighttest.flight import FlightProgress, LegOutcome
from flighttest.flight.execution.control import NOT_ANSWERED, NOT_HEARD, TAKE_OVER
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, parser
from flighttest.plan import AttitudeTarget
from flighttest.recording.store import open_run
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options

_TOO_LONG_S = 400.0


class Endless(AssertionError):
    """The flight did not end."""


def marked(link: FaultyLink, word: str) -> list[float]:
    """When a phase was first marked, filled while flying; a flight without an end is ended."""
    times: list[float] = []

    def look(message: object, t_s: float) -> None:
        if t_s > _TOO_LONG_S:
            raise Endless(f"still flying after {t_s:.0f} s")
        if message.get_type() == "STATUSTEXT" and message.text.endswith(word) and not times:  # type: ignore[attr-defined]
            times.append(t_s)

    link.hook = look
    return times


def landing_asked(link: FaultyLink) -> list[float]:
    times: list[float] = []

    def look(message: object, t_s: float) -> None:
        if t_s > _TOO_LONG_S:
            raise Endless(f"still flying after {t_s:.0f} s")
        command = message.get_type() == "COMMAND_LONG" and message.command == dialect.MAV_CMD_DO_SET_MODE  # type: ignore[attr-defined]
        if command and message.param2 == CopterMode.LAND and not times:  # type: ignore[attr-defined]
            times.append(t_s)

    link.hook = look
    return times


def test_what_is_old_is_not_shown_as_where_the_vehicle_is(run_dir: Path) -> None:
    """The distance to the wall was that of a vehicle which had gone on at its last speed for as long as the link was lost."""
    link = FaultyLink(options())
    began = marked(link, " step")
    link.mute = lambda t: bool(began) and began[0] + 0.6 < t < began[0] + 6.0
    seen: list[FlightProgress] = []
    fly(make_plan(), "sim", run_dir, transport=link, on_progress=seen.append)
    late = [p for p in seen if p.silence_s > 1.0]
    assert len(late) > 10
    assert {(p.place_m, math.isfinite(p.zone_margin_m), math.isfinite(p.speed_m_s)) for p in late} == {
        (None, False, False)
    }
    flown = [p for p in seen if p.silence_s < 0.3 and p.height_m > 3.0]
    assert all(p.place_m is not None and p.zone_margin_m > 0.0 for p in flown)


@pytest.mark.parametrize(("both", "words", "within_s"), [(True, NOT_HEARD, 7.0), (False, NOT_ANSWERED, 12.0)])
def test_a_pilot_is_asked_to_take_over_while_the_link_is_lost(
    both: bool, words: str, within_s: float, run_dir: Path
) -> None:
    """Flown on a real ArduCopter: it hovered for 30 s, and the last alarm was that a step had been stopped."""
    link = FaultyLink(options())
    began = marked(link, " step")
    link.deaf = lambda t: bool(began) and t > began[0] + 0.1
    link.mute = lambda t: both and bool(began) and t > began[0] + 0.1
    seen: list[FlightProgress] = []
    fly(make_plan(), "sim", run_dir, transport=link, on_progress=seen.append)
    said = [p.t_s for p in seen if p.alarm == f"{words}: {TAKE_OVER}"]
    assert said[0] - began[0] < within_s
    assert len(said) > 0.9 * len([p for p in seen if p.t_s > said[0]]), "as long as it is lost"


@pytest.mark.parametrize("duration_s", [1.5, 4.0])
def test_a_lost_uplink_ends_the_step_at_once_and_the_flight_in_time(duration_s: float, run_dir: Path) -> None:
    link = FaultyLink(options())
    began = marked(link, " step")
    link.deaf = lambda t: bool(began) and t > began[0] + 0.1
    seen: list[FlightProgress] = []
    result = fly(
        make_plan(make_leg("a", duration_s=duration_s)), "sim", run_dir, transport=link, on_progress=seen.append
    )
    assert [leg.outcome for leg in result.legs if leg.outcome is LegOutcome.FLOWN] == []
    assert result.outcome.name == "UPLINK_LOST"
    assert result.left.name == "TO_AUTOPILOT"
    assert "take it over with the mode switch" in result.sentence
    assert not result.as_planned
    assert link.sim.time_s - began[0] < 75.0
    assert max(p.uplink_silence_s for p in seen) > 10.0
    assert max(p.silence_s for p in seen) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("presses", "outcome"), [(1, "UPLINK_LOST"), (2, "OPERATOR_ABORT")])
def test_ctrl_c_ends_a_flight_whose_uplink_is_lost(presses: int, outcome: str, run_dir: Path) -> None:
    link = FaultyLink(options())
    began = marked(link, " step")
    link.deaf = lambda t: bool(began) and t > began[0] + 0.1
    pressed_s = 10.0

    def stops() -> int:
        return presses if began and link.sim.time_s > began[0] + pressed_s else 0

    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=stops)
    assert result.outcome.name == outcome
    assert result.left.name == "TO_AUTOPILOT", "no abort mode was confirmed"
    assert "abort mode" not in result.sentence
    assert link.sim.time_s - began[0] < pressed_s + (27.0 if presses == 1 else 12.0), (
        "restoring parameters does not wait for a vehicle that does not answer"
    )
    assert result.parameters_left


@pytest.mark.slow
@pytest.mark.parametrize(("after_s", "left"), [(-0.5, "UNKNOWN"), (1.0, "LANDING_UNSEEN")])
def test_a_link_lost_while_landing_claims_no_landing(after_s: float, left: str, run_dir: Path) -> None:
    link = FaultyLink(options())
    ended, asked = marked(link, " end"), []
    if after_s > 0.0:
        asked = landing_asked(link)
        link.down = lambda t: bool(asked) and t > asked[0] + after_s
    else:
        link.down = lambda _t: bool(ended)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert [leg.outcome for leg in result.legs] == [LegOutcome.FLOWN]
    assert result.outcome.name == "LINK_LOST"
    assert result.left.name == left
    assert not result.as_planned
    assert "landed" not in result.sentence


def test_a_link_that_comes_back_shows_that_it_has_landed(run_dir: Path) -> None:
    link = FaultyLink(options())
    asked = landing_asked(link)
    link.down = lambda t: bool(asked) and asked[0] + 1.0 < t < asked[0] + 25.0
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert (result.outcome.name, result.left.name) == ("COMPLETED", "LANDED")
    assert result.as_planned


def test_a_vehicle_that_is_asked_to_stop_before_it_arms_has_not_landed(run_dir: Path) -> None:
    result = fly(make_plan(), "sim", run_dir, transport=FaultyLink(options()), stop_requested=lambda: 1)
    assert (result.outcome.name, result.left.name) == ("OPERATOR_STOP", "NOT_ARMED")
    assert "landed" not in result.sentence


@pytest.mark.parametrize("direction", ["both", "up"])
def test_a_link_that_dies_before_arming_is_said_at_once_and_with_its_cause(direction: str, run_dir: Path) -> None:
    """When the first parameter is to be set."""
    link = FaultyLink(options())
    setting: list[float] = []

    def look(message: object, t_s: float) -> None:
        if message.get_type() == "PARAM_SET" and t_s > 3.0:  # type: ignore[attr-defined]
            setting.append(t_s)

    link.hook = look
    if direction == "both":
        link.down = lambda _t: bool(setting)
    else:
        link.deaf = lambda _t: bool(setting)
    with pytest.raises(LinkError, match="link was lost") as raised:
        fly(make_plan(), "sim", run_dir, transport=link)
    assert "GUID_OPTIONS" not in str(raised.value)
    assert link.sim.time_s < setting[0] + 15.0


def test_a_climb_that_is_ended_by_old_telemetry_is_no_refused_command(run_dir: Path) -> None:
    link = FaultyLink(options(parameters={"SIM_GPS1_ENABLE": 0.0}))
    up: list[float] = []

    def look(message: object, t_s: float) -> None:
        if message.get_type() == "SET_ATTITUDE_TARGET" and link.sim.vehicle.motion.pz > 1.0 and not up:  # type: ignore[attr-defined]
            up.append(t_s)

    link.hook = look
    link.silenced = lambda kind, t: kind == "ATTITUDE" and bool(up) and t < up[0] + 5.0
    result = fly(make_plan(by="attitude"), "sim", run_dir, transport=link)
    assert (result.outcome.name, result.left.name) == ("CLIMB_ENDED", "LANDED")
    assert any("attitude telemetry is missing or too old" in note for note in result.notes)


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["ATTITUDE", "HEARTBEAT", "LOCAL_POSITION_NED", "EKF_STATUS_REPORT"])
def test_a_stream_that_another_station_switches_off_is_asked_for_again(stream: str, run_dir: Path) -> None:
    link = FaultyLink(options())
    began = marked(link, " step")
    other, switched = parser(255, 190), []
    number = getattr(dialect, f"MAVLINK_MSG_ID_{stream}")

    def switch() -> int:
        if began and not switched:
            switched.append(began[0])
            off = dialect.MAVLink_command_long_message(
                1, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, -1.0, 0, 0, 0, 0, 0
            )
            link.sim.send(bytes(off.pack(other)))
        return 0

    legs = [make_leg(name) for name in "abcd"]
    result = fly(make_plan(*legs), "sim", run_dir, transport=link, stop_requested=switch)
    assert switched
    assert (result.outcome.name, result.left.name) == ("COMPLETED", "LANDED")
    assert {leg.leg for leg in result.legs if leg.outcome is LegOutcome.FLOWN} == {leg.id for leg in legs}
    assert any(m.label.startswith("asked again for") and stream in m.label for m in open_run(run_dir).markers)


def test_a_plan_of_which_nothing_was_flown_was_not_flown_to_its_end(run_dir: Path) -> None:
    link = FaultyLink(options())

    def steep(t_s: float) -> AttitudeTarget:
        return AttitudeTarget(t_s, 0.9, 0.0, 0.0, 0.17)

    result = fly(make_plan(make_leg("a", steep)), "sim", run_dir, transport=link)
    assert [leg.outcome for leg in result.legs] == [LegOutcome.REFUSED]
    assert (result.outcome.name, result.left.name) == ("NOTHING_FLOWN", "LANDED")
    assert not result.as_planned


def test_a_take_off_whose_answer_was_lost_is_no_refusal(run_dir: Path) -> None:
    """The request is repeated then, and refused by a vehicle that has begun to climb."""
    asked: list[float] = []

    def hook(message: object, t_s: float) -> None:
        if getattr(message, "command", None) == dialect.MAV_CMD_NAV_TAKEOFF:
            asked.append(t_s)

    link = FaultyLink(options(), hook=hook)
    link.silenced = lambda name, _t: name == "COMMAND_ACK" and len(asked) == 1
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert len(asked) == 2
    assert result.outcome.name == "COMPLETED"
