"""Steps near the ground over a link that takes its time: what a target that is held does, and with which throttle a mode begins."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest

from flighttest.flight import FlightOutcome, LegOutcome
from flighttest.flight.execution import supervisor
from flighttest.flight.execution.control import FlightControl
from flighttest.flight.preparation.preflight import TIMEOUT_S
from flighttest.frames import G_M_S2
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect
from flighttest.plan import AttitudeTarget, Plan
from flighttest.recording.store import open_run, read_events
from flighttest.sim import SimOptions
from tests.faults.proxy import Fault, Proxy, When
from tests.flight.faulty import GATE, GOOD, LIMITS, FaultyLink, fly, make_leg, make_plan, options


@pytest.mark.parametrize("climb_m_s", [-0.6, -0.1, 0.1, 0.33, 0.6])
def test_a_release_that_is_held_until_the_timeout_does_not_reverse_the_climb(climb_m_s: float) -> None:
    """From a climb of 0.33 m/s the release asked for 0.38 of hover: held for 0.18 s that was a fall of 1.4 m/s, and a hit at 1 m/s."""
    control = FlightControl.__new__(FlightControl)
    control.session = mock.Mock(**{"clock.pace": 1.0})
    control.gate, control.hover_throttle = GATE, GATE.hover_throttle
    control.state = replace(GOOD, climb_m_s=climb_m_s, silence_s=0.0, uplink_silence_s=0.0)
    pushed_m_s = G_M_S2 * (control.release_target().throttle / GATE.hover_throttle - 1.0) * TIMEOUT_S
    assert pushed_m_s * climb_m_s < 0.0, "against the climb"
    assert abs(pushed_m_s) <= abs(climb_m_s) + 1e-9


def low_plan() -> Plan:
    """Two steps from 0.7 m: up for 0.3 s, as `two_heights` flies them."""

    def hop(t_s: float) -> AttitudeTarget:
        return AttitudeTarget(t_s, 0.0, 0.0, 0.0, 0.21 if 0.3 <= t_s < 0.6 else 0.13 if t_s < 0.8 else 0.17)

    legs = [replace(make_leg(name, hop, 1.2, "throttle_step"), start_m=(0.0, 0.0, 0.7)) for name in ("a", "b", "c")]
    limits = replace(LIMITS, height_m=(0.3, 10.0))
    plan = make_plan(*legs, limits=limits)
    zone = replace(plan.vehicle.zone, z_m=(0.3, 10.0))
    return replace(plan, vehicle=replace(plan.vehicle, zone=zone), reset=replace(plan.reset, to_m=(0.0, 0.0, 2.0)))


def test_the_mode_begins_with_a_throttle_that_holds_the_height(run_dir: Path) -> None:
    """It keeps that of the last target before, and the first one of the new step needs the way there and back."""
    link = FaultyLink(options())
    before: list[list[str]] = []

    def look(message: object, _t_s: float) -> None:
        if asks_nogps(message):
            before.append([name for _, name in link.sent[-3:-1]])

    link.hook = look
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert before == [["SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED"]] * 2


@pytest.mark.parametrize("lost", [(0, 1), (1, 2)])
def test_one_level_target_of_several_is_enough(lost: tuple[int, ...], run_dir: Path) -> None:
    """A radio with 5 % loss lost the only one: the step began with the throttle of a stop, and the gate ended it twice (-0.7 m/s)."""
    link = FaultyLink(options())
    levels: list[float] = []  # since the way to the start
    began: list[float | None] = []

    def look(message: object, _t_s: float) -> None:
        kind = message.get_type()  # type: ignore[attr-defined]
        if kind == "SET_ATTITUDE_TARGET" and link.sim.vehicle.mode == CopterMode.GUIDED:
            levels.append(message.thrust)  # type: ignore[attr-defined]
        if asks_nogps(message):
            began.append(link.sim.vehicle.angle.last_thrust)
        lose = kind == "SET_ATTITUDE_TARGET" and link.sim.vehicle.mode == CopterMode.GUIDED and len(levels) - 1 in lost
        link.deaf = lambda _t_s: lose

    link.hook = look
    result = fly(make_plan(make_leg("a")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert len(levels) >= 3
    assert began[0] is not None, "the vehicle has none where each of them was lost"
    assert began[0] == pytest.approx(GATE.hover_throttle, rel=0.3)


@pytest.mark.parametrize("answered", [True, False])
def test_level_targets_are_sent_from_the_vehicles_acceptance_on(answered: bool, run_dir: Path) -> None:
    """HEARTBEAT shows the mode later, and without targets GUID_TIMEOUT ends the throttle. Without an acceptance GUIDED holds the place."""
    link = FaultyLink(options())
    asked_s: list[float] = []
    sent_s: list[float] = []

    def look(message: object, t_s: float) -> None:
        if asks_nogps(message):
            asked_s.append(t_s)
        if asked_s and message.get_type() == "SET_ATTITUDE_TARGET":  # type: ignore[attr-defined]
            sent_s.append(t_s)

    hidden = {"HEARTBEAT"} if answered else {"HEARTBEAT", "COMMAND_ACK"}
    link.silenced = lambda kind, t_s: bool(asked_s) and t_s < asked_s[0] + 0.6 and kind in hidden
    link.hook = look
    assert fly(make_plan(make_leg("a")), "sim", run_dir, transport=link).outcome is FlightOutcome.COMPLETED
    early = [t_s for t_s in sent_s if asked_s[0] + 0.1 < t_s < asked_s[0] + 0.5]
    assert len(early) > 15 if answered else early == []


def test_no_target_goes_before_the_request_in_another_mode_than_guided() -> None:
    """In BRAKE, where the way by attitude targets begins after a refusal, they do nothing."""
    control = mock.Mock(**{"state.mode": CopterMode.BRAKE, "session.now_s.return_value": 0.0})
    with mock.patch.object(supervisor, "enter", lambda _c, _m, _t, _w, before: before() or False):
        assert not supervisor.enter_nogps(control)
    control.release.assert_not_called()
    control.cycle.assert_not_called()


MODE, ARM = dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_CMD_COMPONENT_ARM_DISARM
ACCEPTED, DENIED = dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_DENIED


@pytest.mark.parametrize(
    ("answer", "level"),
    [(None, False), ((MODE, ACCEPTED), True), ((MODE, DENIED), False), ((ARM, ACCEPTED), False)],
)
def test_only_an_accepted_mode_is_one(answer: tuple[int, int] | None, level: bool) -> None:
    ack = None if answer is None else mock.Mock(t_s=1.0, message=mock.Mock(command=answer[0], result=answer[1]))
    control = mock.Mock(**{"state.mode": CopterMode.BRAKE, "session.now_s.return_value": 0.0})
    control.session.latest.get.return_value = ack
    with mock.patch.object(supervisor, "enter", lambda _c, _m, _t, meanwhile, _b: meanwhile() or False):
        assert not supervisor.enter_nogps(control)
    assert control.release.called is level


def asks_nogps(message: object) -> bool:
    """Whether a message asks for GUIDED_NOGPS."""
    asked = getattr(message, "command", None) == dialect.MAV_CMD_DO_SET_MODE
    return asked and message.param2 == CopterMode.GUIDED_NOGPS  # type: ignore[attr-defined]


def test_guided_holds_its_place_while_the_request_of_the_mode_is_lost(run_dir: Path) -> None:
    """It held level attitude, and drifted 2.2 m in 2.6 s with 8 m/s of wind (ArduCopter); the step began with 1.5 m/s."""
    link = FaultyLink(options(hide={"steady_wind": {"w_north": 6.0}}))
    lost_s: list[float] = []
    places: list[float] = []

    def look(message: object, t_s: float) -> None:
        if asks_nogps(message) and not lost_s:
            lost_s.append(t_s)
        if lost_s and t_s < lost_s[0] + 2.5:
            places.append(math.hypot(link.sim.vehicle.motion.px, link.sim.vehicle.motion.py))

    link.hook = look
    link.deaf = lambda t_s: bool(lost_s) and t_s < lost_s[0] + 2.5
    result = fly(make_plan(make_leg("a")), "sim", run_dir, transport=link)
    assert [leg.outcome for leg in result.legs][-1] is LegOutcome.FLOWN
    assert max(places) - places[0] < 0.3


def test_low_steps_over_a_link_of_200_ms_do_not_end_on_the_ground(run_dir: Path) -> None:
    """On ArduCopter over such a link the second step of `two_heights` was on the ground."""
    late = Fault("100 ms each way", 300.0, latency_s=0.1)
    proxy = Proxy(SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0), late, When.RETURNING)
    result = fly(low_plan(), "proxy", run_dir, transport=proxy, clock=proxy.clock())
    assert [leg.outcome for leg in result.legs] == [LegOutcome.FLOWN] * 3
    marks = [m.t_s for m in read_events(run_dir)[0] if m.kind == "phase"]
    t_s, height_m = open_run(run_dir).channel("height_m")
    assert height_m[(t_s > marks[0]) & (t_s < marks[-1] + 1.0)].min() > 0.4
