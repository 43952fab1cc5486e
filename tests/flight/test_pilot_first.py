"""A pilot who takes the vehicle just when something is asked of it: over a slow link, before the take-off, and while a link fails."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from flighttest.errors import LinkError
from flighttest.flight import FlightOutcome, FlightState
from flighttest.flight.execution.supervisor import ModeRequest
from flighttest.link.ardupilot import ArduPilot
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, parser
from flighttest.sim import SimOptions
from tests.faults.cells import Cell, changes_of_state, fly_cell
from tests.faults.changes import PROVOKED, Piloted
from tests.faults.proxy import Fault, When
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options

LATENCY_S = 0.3


def over_a_slow_link(when: When, after_s: float, folder: Path) -> Cell:
    """The pilot chooses LOITER so long after the first request of that kind left, over a link that takes 0.3 s each way."""
    return fly_cell(Fault("pilot", 60.0, latency_s=LATENCY_S, pilot_after_s=after_s), when, folder)


@pytest.mark.parametrize("after_s", [0.4, 0.7])  # in two phases of the 0.2 s
@pytest.mark.parametrize("when", [When.ENTERING, When.RETURNING, When.ABORTING, When.LANDING])
def test_no_repeated_request_overrules_a_pilot(when: When, after_s: float, run_dir: Path) -> None:
    """Repeats every 0.2 s were under way when the pilot's mode was seen, arrived after it, and the flight went on."""
    cell = over_a_slow_link(when, after_s, run_dir)
    assert cell.ok, (cell.ended, cell.wrong)
    # In an abort LAND is asked for as soon as BRAKE is shown, before this switch can be seen: that one request is under way then.
    allowed = {"WITH_PILOT", "TO_AUTOPILOT"} if when is When.ABORTING else {"WITH_PILOT"}
    assert cell.ended.split(", ")[1] in allowed, cell.ended


@pytest.mark.parametrize("when", [When.ENTERING, When.RETURNING, When.ABORTING, When.LANDING])
def test_a_request_that_was_under_way_is_said_where_it_overrules_a_pilot(when: When, run_dir: Path) -> None:
    """The pilot switches 0.2 s before the one request arrives: the vehicle is not said to be the pilot's."""
    cell = over_a_slow_link(when, 0.1, run_dir)
    assert cell.ok, (cell.ended, cell.wrong)
    assert cell.ended.endswith("TO_AUTOPILOT"), cell.ended
    assert (FlightState.WITH_PILOT.name, "OVERRULED") in {(s.name, e.name) for s, e in cell.changes}


def test_a_vehicle_that_arms_after_a_take_over_is_not_called_unarmed(run_dir: Path) -> None:
    """The pilot switches as the request to arm leaves; it arrives 0.3 s later."""
    cell = over_a_slow_link(When.ARMING, 0.0, run_dir)
    assert cell.ok, (cell.ended, cell.wrong)
    assert cell.ended == "TAKE_OVER, WITH_PILOT"


def by_others(link: FaultyLink, command: int, *parameters: float) -> None:
    """A command of the pilot's own ground station."""
    values = (*parameters, *([0.0] * (7 - len(parameters))))
    message = dialect.MAVLink_command_long_message(1, 1, command, 0, *values)
    link.sim.send(bytes(message.pack(parser(255, 190))))


def test_a_pilot_who_arms_while_the_operator_is_asked_keeps_the_vehicle(run_dir: Path) -> None:
    """GUIDED was asked for of a vehicle that a pilot had taken off with since the preflight."""
    link, asked = FaultyLink(options()), []

    def confirm(_text: str) -> bool:
        asked.append(len(link.sent))
        by_others(link, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        time.sleep(0.5)  # some HEARTBEATs
        return True

    result = fly(make_plan(), "sim", run_dir, transport=link, confirm=confirm)
    assert result.outcome is FlightOutcome.ARMED_BY_PILOT
    assert result.left is FlightState.WITH_PILOT
    assert not result.as_planned
    assert link.sim.vehicle.armed
    assert link.sim.vehicle.mode not in (CopterMode.GUIDED, CopterMode.GUIDED_NOGPS)
    assert "COMMAND_LONG" not in {kind for _, kind in link.sent[asked[0] :]}, "nothing is commanded"


def test_a_vehicle_that_does_not_confirm_to_be_disarmed_is_not_called_so(run_dir: Path) -> None:
    """The operator stops while it arms, and what is sent from then on is lost: the motors may run."""
    link, armed_s = FaultyLink(options()), []

    def stops() -> int:
        if link.sim.vehicle.armed and not armed_s:
            armed_s.append(link.sim.time_s)
        return int(bool(armed_s))

    link.deaf = lambda _t: bool(armed_s)
    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=stops)
    assert armed_s
    assert result.left is not FlightState.NOT_ARMED, result.sentence


def test_a_mode_that_is_refused_to_an_armed_vehicle_ends_in_an_outcome(
    monkeypatch: pytest.MonkeyPatch, run_dir: Path
) -> None:
    """The pilot arms while GUIDED is asked for and refused: an event that the table of states had no row for."""
    link = FaultyLink(options())

    def refused(vehicle: ArduPilot, mode: CopterMode) -> None:
        by_others(link, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        vehicle.session.advance(vehicle.session.now_s() + 1.0)
        raise LinkError(f"the vehicle did not enter {mode.name}", "")

    monkeypatch.setattr(ArduPilot, "set_mode", refused)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.VEHICLE_REFUSED, result.sentence
    assert result.left is FlightState.NOT_ARMED
    assert not link.sim.vehicle.armed


def test_one_frame_hands_no_vehicle_back(run_dir: Path) -> None:
    """The pilot flies by agreement, and one false HEARTBEAT shows GUIDED_NOGPS: the mode was asked for, and entered."""
    options = SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0)
    false = Fault("one false hand-back, then Ctrl-C", 1.0, false_mode=CopterMode.GUIDED_NOGPS, presses=1)
    proxy = Piloted(options, false, FlightState.HANDED, 2.0)
    pressed_s = 4.0

    def stops() -> int:
        return int(proxy.began_s is not None and proxy.now_s > proxy.began_s + pressed_s)

    with changes_of_state(proxy):
        result = fly(
            make_plan(by="pilot"), "proxy", run_dir, transport=proxy, clock=proxy.clock(), stop_requested=stops
        )
    assert result.outcome is FlightOutcome.OPERATOR_STOP, result.sentence
    assert result.left is FlightState.WITH_PILOT
    assert proxy.sim.vehicle.mode == CopterMode.LOITER


def test_every_change_that_a_pilot_makes_has_a_flight() -> None:
    flown = {(p.state.name, p.event.name) for p in PROVOKED}
    assert {("GROUND", "ARMED"), ("NOT_ARMED", "ARMED"), ("WITH_PILOT", "OVERRULED")} <= flown


@pytest.mark.parametrize(("waited_s", "due"), [(1.9, False), (2.0, True)])
def test_a_request_of_which_nothing_is_heard_is_repeated_after_two_seconds(waited_s: float, due: bool) -> None:
    """Sooner, the repeat could still be under way with the first on a link that is slow and not broken."""
    now = [10.0]
    session = SimpleNamespace(now_s=lambda: now[0], answered_since=lambda _t_s: False)
    state = SimpleNamespace(mode_age_s=0.0, silence_s=0.0, t_s=10.0)
    control = SimpleNamespace(state=state, session=session, vehicle=SimpleNamespace(ask_mode=lambda _mode: True))
    request = ModeRequest(control)  # type: ignore[arg-type]
    request.ask_where_due(CopterMode.LAND)
    now[0] = state.t_s = 10.0 + waited_s
    assert request.due is due


@pytest.mark.parametrize("stopped", [True, False])
def test_a_flight_that_lacks_steps_lacks_them_when_a_pilot_lands(stopped: bool, run_dir: Path) -> None:
    """Ctrl-C after the first step, and the pilot took over while it landed: it was called complete, with exit code 0."""
    link = FaultyLink(options())
    ended: list[float] = []
    landing: list[float] = []

    def look(message: object, t_s: float) -> None:
        kind = message.get_type()  # type: ignore[attr-defined]
        if kind == "STATUSTEXT" and message.text.endswith(" end"):  # type: ignore[attr-defined]
            ended.append(t_s)
        if kind == "COMMAND_LONG" and message.param2 == CopterMode.LAND:  # type: ignore[attr-defined]
            landing.append(t_s)

    def pilot(t_s: float) -> bool:
        if landing and t_s > landing[0] + 1.0:
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LOITER))
        return False

    link.hook, link.deaf = look, pilot
    plan = make_plan(make_leg("a"), make_leg("b"))
    result = fly(plan, "sim", run_dir, transport=link, stop_requested=lambda: int(stopped and bool(ended)))
    assert result.left is FlightState.WITH_PILOT
    assert result.outcome is (FlightOutcome.OPERATOR_STOP if stopped else FlightOutcome.LEFT_TO_PILOT)
    assert result.as_planned is not stopped


def test_a_mode_of_others_is_not_called_the_pilots(run_dir: Path) -> None:
    """LAND by another station, a failsafe or the fence: a pilot may not be flying it, and Ctrl-C lands nothing any more."""
    link = FaultyLink(options())
    alarms: list[str] = []

    def station(message: object, _t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            link.sim.vehicle.set_mode(int(CopterMode.LAND))

    link.hook = station
    fly(make_plan(), "sim", run_dir, transport=link, on_progress=lambda p: alarms.append(p.alarm))
    [text] = {a for a in alarms if "nothing is sent" in a}
    assert text.startswith("in LAND (by the pilot, a failsafe, the fence or a station)")
    assert text.endswith("PILOT, take over with the mode switch")


def test_a_warning_that_repeats_is_one_alarm_while_it_is_shown(run_dir: Path) -> None:
    """A vehicle that does not arm says why with each of sixty tries: sixty lines, each with the terminal's bell."""
    link = FaultyLink(options())
    alarms: dict[int, str] = {}

    def warn(message: object, _t_s: float) -> None:
        if message.get_type() == "SET_ATTITUDE_TARGET":  # type: ignore[attr-defined]
            for text in (b"Arm: Battery failsafe", b"Arm: Hardware safety switch"):
                link.say(1, dialect.MAVLink_statustext_message(dialect.MAV_SEVERITY_CRITICAL, text))

    link.hook = warn
    fly(make_plan(), "sim", run_dir, transport=link, on_progress=lambda p: alarms.setdefault(p.alarms, p.alarm))
    assert sorted(text for text in alarms.values() if "Arm" in text) == [
        "message of the vehicle: Arm: Battery failsafe",
        "message of the vehicle: Arm: Hardware safety switch",
    ]
