"""A transmitter that is lost in flight is said at once, by what the autopilot reports of its receiver."""

from __future__ import annotations

from pathlib import Path

import pytest

from flighttest.flight import FlightOutcome
from flighttest.flight.transmitter import BACK, LOST, Transmitter
from flighttest.mavlink.dialect import Message, dialect
from flighttest.recording.store import open_run
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
