"""What the operator is shown before a vehicle arms, and what an answer does."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from flighttest.errors import PreflightError
from flighttest.flight import FlightOutcome
from flighttest.mavlink import CopterMode
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options


def test_the_checklist_names_what_the_operator_answers_for(run_dir: Path) -> None:
    shown: list[str] = []

    def answer(text: str) -> bool:
        shown.append(text)
        return False

    link = FaultyLink(options())
    with pytest.raises(PreflightError, match="did not confirm"):
        fly(make_plan(), "sim", run_dir, transport=link, confirm=answer, waive=("fence",))
    assert not link.sim.vehicle.armed
    assert not [kind for _, kind in link.sent if kind == "SET_ATTITUDE_TARGET"]
    [text] = shown
    for words in (
        "vehicle",
        "1 steps",
        "zone",
        "V, lands at 21.0 V",
        "fence",
        "pilot",
        "waived   fence",
        "Ctrl-C lands, twice before LAND",
    ):
        assert words in text, words
    assert max(map(len, text.splitlines())) <= 80


def test_ctrl_c_at_the_question_arms_nothing(run_dir: Path) -> None:
    link = FaultyLink(options())
    pressed: list[bool] = []

    def answer(_text: str) -> bool:
        pressed.append(True)
        time.sleep(0.5)
        return True

    with pytest.raises(PreflightError, match="did not confirm"):
        fly(make_plan(), "sim", run_dir, transport=link, confirm=answer, stop_requested=lambda: len(pressed))
    assert not link.sim.vehicle.armed


@pytest.mark.parametrize(("before_s", "named"), [(2.0, True), (3.6, False)])
def test_a_message_just_before_a_change_of_mode_is_its_reason(run_dir: Path, before_s: float, named: bool) -> None:
    """The fence and the failsafes state it with the change; an older message is about something else."""
    link = FaultyLink(options())
    said: list[float] = []

    def warn_and_switch(message: object, now: float) -> None:
        if not said and message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            said.append(now)
            link.sim.vehicle.say("Radio Failsafe", 4)
        if said and now >= said[0] + before_s:
            link.sim.vehicle.set_mode(CopterMode.LOITER)

    link.hook = warn_and_switch
    result = fly(make_plan(make_leg("a"), make_leg("b"), make_leg("c")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert any("Radio Failsafe" in note for note in result.notes) is named


@pytest.mark.parametrize(("text", "severity"), [("Radio Failsafe", 4), ("Max Alt fence breached", 5)])
def test_what_the_vehicle_warns_of_and_an_abort_are_reported_at_once(run_dir: Path, text: str, severity: int) -> None:
    """A lost transmitter is a STATUSTEXT, as a breach of the fence is, of severity 5: neither is on any stream."""
    link = FaultyLink(options())
    reported: list[tuple[float, str]] = []
    warned: list[float] = []

    def warn(message: object, now: float) -> None:
        if not warned and message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            warned.append(now)
            link.sim.vehicle.say(text, severity)

    link.hook = warn
    result = fly(
        make_plan(),
        "sim",
        run_dir,
        transport=link,
        confirm=lambda _text: True,
        on_progress=lambda p: reported.append((p.t_s, p.alarm)) if p.alarm else None,
    )
    assert result.outcome is FlightOutcome.COMPLETED
    t_s, alarm = reported[0]
    assert text in alarm
    assert t_s - warned[0] < 0.2
