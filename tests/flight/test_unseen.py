"""While the vehicle's mode cannot be seen a pilot may have taken it: no mode is asked for, nothing is flown on, and the flight ends."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from flighttest.flight import FlightOutcome, FlightState, LegOutcome
from flighttest.flight.execution import supervisor
from flighttest.flight.preparation.preflight import Check
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect
from flighttest.sim import SimOptions
from tests.faults.proxy import Fault, Proxy, When
from tests.flight.faulty import GOOD, FaultyLink, fly, make_leg, make_plan, options


def marked(link: FaultyLink, word: str, *, then: object = None) -> list[float]:
    """When a leg's phase is first marked."""
    times: list[float] = []

    def look(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(word) and not times:  # type: ignore[attr-defined]
            times.append(t_s)
            if callable(then):
                then()

    link.hook = look
    return times


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flighttest.flight.execution.control.GIVE_UP_AFTER_S", 8.0)


def asked(link: FaultyLink) -> list[tuple[float, int]]:
    """Modes that are asked for from now on, with the vehicle's time."""
    found: list[tuple[float, int]] = []
    before = link.hook

    def look(message: object, t_s: float) -> None:
        if before is not None:
            before(message, t_s)
        if message.get_type() == "COMMAND_LONG" and message.command == dialect.MAV_CMD_DO_SET_MODE:  # type: ignore[attr-defined]
            found.append((t_s, int(message.param2)))  # type: ignore[attr-defined]

    link.hook = look
    return found


@pytest.mark.usefixtures("soon")
@pytest.mark.parametrize(("lost", "after_s"), [("everything", 3.0), ("everything", 1.0), ("heartbeats", 3.0)])
def test_a_pilot_who_is_not_seen_keeps_the_vehicle(run_dir: Path, lost: str, after_s: float) -> None:
    link = FaultyLink(options())
    began = marked(link, " step")
    modes = asked(link)
    switched: list[float] = []

    def unheard(t_s: float) -> bool:
        gone = bool(began) and t_s > began[0] + 0.1
        if gone and not switched and t_s > began[0] + after_s:
            switched.append(t_s)
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LOITER))
        return gone

    if lost == "everything":
        link.mute = unheard
    else:
        link.silenced = lambda kind, t_s: kind in ("HEARTBEAT", "RC_CHANNELS") and unheard(t_s)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.LINK_LOST
    assert link.sim.vehicle.mode == CopterMode.LOITER
    assert [t for t, _ in modes if t > switched[0]] == []
    if lost == "everything":
        assert int(CopterMode.BRAKE) in [mode for t, mode in modes if t > began[0]], "asked for while it was seen"


@pytest.mark.usefixtures("soon")
def test_a_lost_downlink_between_two_steps_ends_the_flight(run_dir: Path) -> None:
    link = FaultyLink(options())
    ended = marked(link, " end")
    link.mute = lambda t: bool(ended) and t > ended[0] + 1.5
    away = replace(make_leg("b"), start_m=(5.0, 0.0, 5.0))
    result = fly(make_plan(make_leg("a"), away), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.LINK_LOST
    last = max(t for t, kind in link.sent if kind.startswith("SET_"))
    assert last < ended[0] + 1.5 + 1.6, "a pilot's take-over would not be seen now"


@pytest.mark.slow
def test_a_vehicle_that_refuses_guided_is_held_level_and_landed(run_dir: Path) -> None:
    link = FaultyLink(options())
    ended = marked(link, " end", then=lambda: link.set_parameter("SIM_GPS1_ENABLE", 0.0))
    legs = [make_leg(name) for name in "abcd"]
    result = fly(make_plan(*legs), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.NOT_SETTLED
    assert [r.outcome for r in result.legs] == [LegOutcome.FLOWN, *[LegOutcome.NOT_SETTLED] * 4]
    assert not link.sim.vehicle.armed
    targets = [t for t, kind in link.sent if kind == "SET_ATTITUDE_TARGET" and ended[0] < t < ended[0] + 4.0]
    assert max(b - a for a, b in pairwise(targets)) < 0.1


def test_a_vehicle_that_is_left_in_the_air_keeps_its_fence(run_dir: Path) -> None:
    link = FaultyLink(options())
    fence = {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 4.0}
    refused = Check("fence", "no fence", "set one", fence)
    began = marked(link, " step")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flighttest.flight.preparation.preflight.checks", lambda _situation: [refused])
        result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=lambda: 2 if began else 0)
    assert result.outcome is FlightOutcome.OPERATOR_ABORT
    assert link.sim.vehicle.armed
    assert set(result.parameters_left) == set(fence)
    assert any("Set it by hand" in note for note in result.notes)


def test_an_estimator_that_reports_no_more_is_not_used(run_dir: Path) -> None:
    link = FaultyLink(options())
    began = marked(link, " step")
    link.silenced = lambda kind, t_s: kind == "EKF_STATUS_REPORT" and bool(began) and t_s > began[0]
    result = fly(make_plan(*(make_leg(name) for name in "abc")), "sim", run_dir, transport=link)
    assert result.outcome is not FlightOutcome.COMPLETED
    assert not link.sim.vehicle.armed


@pytest.mark.parametrize(
    ("position", "stick", "modes"),
    [
        (True, 0.5, ["BRAKE", "LOITER", "LAND"]),
        (True, 0.41, ["BRAKE", "LOITER", "LAND"]),
        (True, 0.39, ["BRAKE", "LAND"]),
        (True, 0.61, ["BRAKE", "LAND"]),
        (True, None, ["BRAKE", "LAND"]),
        (False, 0.59, ["ALT_HOLD", "LAND"]),
        (False, 0.0, ["LAND"]),
        (False, None, ["LAND"]),
    ],
)
def test_a_mode_that_reads_the_throttle_stick_is_only_asked_for_with_the_stick_at_mid(
    position: bool, stick: float | None, modes: list[str]
) -> None:
    state = replace(GOOD, position_ok=position, throttle_stick=stick)
    assert [mode.name for mode in supervisor.abort_modes(state)] == modes


class StandsStill(Proxy):
    """The program stands still for 65 s between reading all that has come and looking at the link, in the first step."""

    def receive(self, timeout_s: float) -> bytes:
        if timeout_s == 0.0 and self._once("still", self.reached(When.FLYING)):
            self._pass(65.0)
            return b""
        return super().receive(timeout_s)


@pytest.mark.slow
def test_a_program_that_stood_still_after_it_had_read_reads_first(run_dir: Path) -> None:
    """A laptop that was suspended there: 30 s without a HEARTBEAT, and hundreds of them waiting to be read."""
    proxy = StandsStill(SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0), Fault("nothing"), When.FLYING)
    result = fly(make_plan(make_leg("a"), make_leg("b")), "proxy", run_dir, transport=proxy, clock=proxy.clock())
    assert result.left is FlightState.LANDED, result.sentence
