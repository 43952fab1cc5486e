"""A transmitter that is lost in flight is said at once, by what the autopilot reports of its receiver."""

from __future__ import annotations

from pathlib import Path

import pytest

from flighttest.flight import FlightOutcome, FlightState
from flighttest.flight.execution.machine import Event
from flighttest.flight.transmitter import BACK, LOST, ModeSwitch, Transmitter
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import Message, dialect, parser
from flighttest.plan import AttitudeTarget
from flighttest.recording.store import open_run
from tests.faults.cells import fly_cell
from tests.faults.proxy import Fault, When
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options

RECEIVER = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
WITHIN_S = 0.7  # SYS_STATUS comes twice a second


def status(present: int, health: int) -> Message:
    return dialect.MAVLink_sys_status_message(present, present, health, *([0] * 10))


def channels(count: int) -> Message:
    return dialect.MAVLink_rc_channels_message(0, count, *([0] * 18), 0)


WELL, ILL, MUTE = status(RECEIVER, RECEIVER), status(RECEIVER, 0), status(0, 0)


@pytest.mark.parametrize(
    ("messages", "said"),
    [
        ([WELL, channels(16), ILL, ILL, WELL], ["", "", LOST, "", BACK]),
        ([WELL, channels(16), channels(0), WELL, channels(16)], ["", "", LOST, "", BACK]),
        ([MUTE, channels(16), MUTE, channels(0)], ["", "", "", LOST]),
        ([ILL, channels(0), ILL], ["", "", ""]),  # there never was one
        ([WELL, channels(16), channels(0), ILL, channels(16), WELL], ["", "", LOST, "", "", BACK]),
    ],
)
def test_a_loss_and_a_return_are_said_once(messages: list[Message], said: list[str]) -> None:
    transmitter = Transmitter()
    assert [transmitter.look(message) for message in messages] == said


def test_in_flight_it_is_said_at_once_and_recorded(run_dir: Path) -> None:
    link = FaultyLink(options())
    reported: list[tuple[float, str]] = []
    lost: list[float] = []

    def lose(message: object, now: float) -> None:
        if message.get_type() != "STATUSTEXT" or not message.text.endswith(" step"):  # type: ignore[attr-defined]
            return
        if not lost:
            lost.append(now)
        link.set_parameter("SIM_RC_FAIL", 1.0 if len(lost) == 1 else 0.0)
        lost.append(now)

    link.hook = lose
    result = fly(
        make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link,
        on_progress=lambda p: reported.append((p.t_s, p.alarm)) if p.alarm else None,
    )  # fmt: skip
    assert result.outcome is FlightOutcome.COMPLETED
    t_s = next(t for t, text in reported if text == LOST)
    assert t_s - lost[0] < WITHIN_S
    assert [m.label for m in open_run(run_dir).markers if m.label in (LOST, BACK)] == [LOST, BACK]


def switch(pulse_us: int, count: int = 16) -> Message:
    """The mode switch on channel 5 at a pulse length."""
    return dialect.MAVLink_rc_channels_message(0, count, *([1500] * 4), pulse_us, *([1500] * 13), 254)


@pytest.mark.parametrize(
    ("seen", "moved"),
    [
        ([(0.0, 1000), (0.2, 1300), (0.4, 1300)], 0.4),
        ([(0.0, 1000), (0.2, 1300), (0.3, 1300), (0.5, 1300)], 0.5),  # ArduPilot debounces it for 0.2 s
        ([(0.0, 1000), (0.2, 1300), (0.4, 1000), (0.6, 1300), (0.7, 1300)], None),  # it bounces
        ([(0.0, 1000), (0.2, 1100), (0.4, 1230)], None),  # within the first position
        ([(0.0, 1230), (0.2, 1231), (0.4, 1231)], 0.4),
        ([(0.0, 1360), (0.2, 1361), (0.4, 1361)], 0.4),
        ([(0.0, 1490), (0.2, 1491), (0.4, 1491)], 0.4),
        ([(0.0, 1361), (0.2, 1490), (0.4, 1490)], None),
        ([(0.0, 1620), (0.2, 1621), (0.4, 1621)], 0.4),
        ([(0.0, 1749), (0.2, 1750), (0.4, 1750)], 0.4),
        ([(0.0, 1000), (0.2, 0), (0.4, 0), (0.6, 65535), (0.8, 65535)], None),
        ([(0.0, 1300), (0.2, 800), (0.4, 800), (0.6, 2200), (0.8, 2200)], None),
        ([(0.0, 1300), (0.2, 801), (0.4, 801)], 0.4),
        ([(0.0, 1300), (0.2, 2199), (0.4, 2199)], 0.4),
        ([(0.0, 0), (0.2, 1300), (0.4, 1300)], None),  # the first position seen is the one to start from
    ],
)
def test_a_mode_switch_has_moved_once_it_stays(seen: list[tuple[float, int]], moved: float | None) -> None:
    follows = ModeSwitch()
    assert next((t for t, pulse in seen if follows.moved(switch(pulse), t)), None) == moved


def test_a_channel_that_is_none_or_not_received_moves_no_switch() -> None:
    for follows, count in ((ModeSwitch(0), 16), (ModeSwitch(5), 4)):
        assert not any(follows.moved(switch(pulse, count), 0.2 * k) for k, pulse in enumerate([1000, 1300, 1300, 1300]))


@pytest.mark.parametrize("lost", [False, True])
def test_a_pilot_who_chooses_the_mode_that_is_held_already_has_taken_over(lost: bool, run_dir: Path) -> None:
    """BRAKE by the switch while the vehicle brakes for this program: HEARTBEAT shows no change, and the next step was flown."""
    link = FaultyLink(options())
    asked: list[float] = []
    modes: list[int] = []

    def look(message: object, now: float) -> None:
        if message.get_type() != "COMMAND_LONG" or message.command != dialect.MAV_CMD_DO_SET_MODE:  # type: ignore[attr-defined]
            return
        if asked:
            modes.append(int(message.param2))  # type: ignore[attr-defined]
        if message.param2 == CopterMode.BRAKE and not asked:  # type: ignore[attr-defined]
            asked.append(now)
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.BRAKE))
            if lost:  # what a receiver puts out by itself is no move of the switch
                off = (dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, dialect.MAVLINK_MSG_ID_SYS_STATUS, -1.0, *([0] * 5))
                link.sim.send(bytes(dialect.MAVLink_command_long_message(1, 1, *off).pack(parser(255, 190))))
                link.say(1, status(RECEIVER, 0))

    link.hook = look
    steep = make_leg("steep", lambda t: AttitudeTarget(t, 0.3 if t < 1.2 else 0.8, 0.0, 0.0, 0.18))
    alarms: list[str] = []
    result = fly(
        make_plan(steep, make_leg("b")), "sim", run_dir, transport=link, on_progress=lambda p: alarms.append(p.alarm)
    )
    assert asked
    assert not any("move the mode switch again" in text for text in alarms), "the mode is the pilot's own"
    assert any("in BRAKE (the pilot moved the mode switch)" in text for text in alarms) is not lost
    if lost:
        assert result.left is FlightState.LANDED
    else:
        assert result.outcome is FlightOutcome.TAKE_OVER
        assert modes == []
        assert link.sim.vehicle.mode == CopterMode.BRAKE


@pytest.mark.parametrize("latency_s", [0.3, 0.5])
def test_a_request_that_arrives_after_the_switch_was_moved_is_said(latency_s: float, run_dir: Path) -> None:
    """The pilot switches to GUIDED, in which the vehicle is, as the request for GUIDED_NOGPS leaves: the vehicle follows the request, which
    arrives last. It was said to be the pilot's, in GUIDED_NOGPS, which no pilot had chosen."""
    fault = Fault("pilot", 60.0, latency_s=latency_s, pilot_mode=CopterMode.GUIDED, pilot_after_s=0.0)
    cell = fly_cell(fault, When.ENTERING, run_dir)
    assert cell.ended == "TAKE_OVER, TO_AUTOPILOT"
    assert (FlightState.WITH_PILOT, Event.OVERRULED) in cell.changes
    late = "the vehicle is in GUIDED_NOGPS by a request that was under way at the take-over: move the mode switch again"
    assert late in [m.label for m in open_run(run_dir).markers]


@pytest.mark.parametrize(("old_beats", "left"), [(6, "WITH_PILOT"), (7, "TO_AUTOPILOT")])
def test_one_heartbeat_of_before_the_switch_was_moved_is_no_request_that_overruled_it(
    old_beats: int, left: str, run_dir: Path
) -> None:
    """An autopilot may report its mode of before once more after the switch is seen to have moved, here after the fifth HEARTBEAT."""
    fault = Fault("pilot", 60.0, pilot_after_s=0.0, old_beats=old_beats)
    assert fly_cell(fault, When.FLYING, run_dir).ended == f"TAKE_OVER, {left}"


@pytest.mark.parametrize("lost", [False, True])
def test_no_alarm_asks_for_a_switch_that_is_not_received(lost: bool, run_dir: Path) -> None:
    """ "The mode switch has no effect" was followed by "PILOT, take over with the mode switch"."""
    link = FaultyLink(options())
    began: list[float] = []

    def look(message: object, now: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step") and not began:  # type: ignore[attr-defined]
            began.append(now)
            if lost:
                off = (dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, dialect.MAVLINK_MSG_ID_SYS_STATUS, -1.0, *([0] * 5))
                link.sim.send(bytes(dialect.MAVLink_command_long_message(1, 1, *off).pack(parser(255, 190))))
                link.say(1, status(RECEIVER, 0))
            link.sim.vehicle.set_mode(int(CopterMode.RTL))  # by its failsafe

    link.hook = look
    alarms: list[str] = []
    fly(make_plan(), "sim", run_dir, transport=link, on_progress=lambda p: alarms.append(p.alarm))
    [text] = {a for a in alarms if "nothing is sent any more" in a}
    assert ("take over with the mode switch" in text) is not lost
    assert ("transmitter is not received" in text) is lost
