"""Flights where two things go wrong at once, and what is sent after each."""

import errno
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flighttest.errors import RecordingError
from flighttest.flight import FlightOutcome, LegOutcome
from flighttest.flight.execution.response import Learnt
from flighttest.flight.recorder import LineFile
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.port import MavlinkPort
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, parser
from flighttest.plan import AttitudeTarget, Plan
from flighttest.recording.store import read_manifest
from tests.flight.faulty import LIMITS, FaultyLink, fly, make_leg, make_plan, options

_IN_PAIRS = 3


def on_mark(link: FaultyLink, word: str) -> list[float]:
    """Times of the marks that end in a word, filled while flying."""
    times: list[float] = []

    def hook(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(word):  # type: ignore[attr-defined]
            times.append(t_s)

    link.hook = hook
    return times


def on_arming(link: FaultyLink, then: Callable[[list[float]], None] = lambda _times: None) -> list[float]:
    """Times at which we asked it to arm, filled while flying; then: called with them after each."""
    times: list[float] = []

    def hook(message: object, t_s: float) -> None:
        kind, command = message.get_type(), dialect.MAV_CMD_COMPONENT_ARM_DISARM  # type: ignore[attr-defined]
        if kind == "COMMAND_LONG" and message.command == command and message.param1:  # type: ignore[attr-defined]
            times.append(t_s)
            then(times)

    link.hook = hook
    return times


def test_what_else_is_aboard_is_not_the_autopilot(run_dir: Path) -> None:
    """A gimbal's heartbeat has mode 0 and disarmed, its clock another time, its answers concern others."""
    link = FaultyLink(options())

    def aboard(message: object, t_s: float) -> None:
        if message.get_type() in ("STATUSTEXT", "HEARTBEAT"):  # type: ignore[attr-defined]
            link.say(
                154,
                dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_GIMBAL, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 3, 3),
                dialect.MAVLink_attitude_message(17, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0),
                dialect.MAVLink_command_ack_message(dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_RESULT_DENIED),
            )

    link.hook = aboard
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED


@pytest.mark.parametrize("by", ["guided", "attitude"])
def test_a_pilot_who_changes_the_mode_while_it_will_not_arm_has_taken_over(by: str, run_dir: Path) -> None:
    link = FaultyLink(replace(options(), ready_s=12.0))

    def switch(times: list[float]) -> None:
        if len(times) == _IN_PAIRS:
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.STABILIZE))

    refused = on_arming(link, switch)
    result = fly(make_plan(by=by), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert not link.sim.vehicle.armed
    assert len(refused) == _IN_PAIRS


def test_ctrl_c_while_it_will_not_arm_arms_nothing(run_dir: Path) -> None:
    link = FaultyLink(replace(options(), ready_s=12.0))
    tried = on_arming(link)
    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=lambda: int(len(tried) >= _IN_PAIRS))
    assert result.outcome is FlightOutcome.OPERATOR_STOP
    assert len(tried) == _IN_PAIRS
    assert not link.sim.vehicle.armed
    assert not result.parameters_left


def test_a_climb_by_throttle_ends_where_the_vehicle_is_not_heard(run_dir: Path) -> None:
    """The uplink works, the downlink does not: the climb's throttle must not go on."""
    link = FaultyLink(options(parameters={"SIM_GPS1_ENABLE": 0.0}))
    off: list[float] = []
    heights: list[float] = []

    def hook(message: object, t_s: float) -> None:
        if message.get_type() == "SET_ATTITUDE_TARGET":  # type: ignore[attr-defined]
            heights.append(float(link.sim.vehicle.motion.pz))
            if heights[-1] > 1.0 and not off:
                off.append(t_s)

    link.hook = hook
    link.mute = lambda t: bool(off) and t < off[0] + 12.0
    result = fly(make_plan(by="attitude"), "sim", run_dir, transport=link)
    assert max(heights) < 8.0
    assert result.outcome is not FlightOutcome.COMPLETED
    assert link.sim.vehicle.mode == CopterMode.LAND


def test_landing_is_asked_for_until_the_vehicle_hears_it(run_dir: Path) -> None:
    link = FaultyLink(options())
    ended = on_mark(link, " end")
    link.deaf = lambda t: bool(ended) and ended[0] <= t < ended[0] + 20.0
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert not link.sim.vehicle.armed


def test_a_pilot_who_takes_over_the_landing_is_left_alone(run_dir: Path) -> None:
    link = FaultyLink(options())
    asked: list[float] = []

    def hook(message: object, t_s: float) -> None:
        if (
            message.get_type() == "COMMAND_LONG"
            and message.command == dialect.MAV_CMD_DO_SET_MODE
            and message.param2 == CopterMode.LAND
        ):  # type: ignore[attr-defined]
            asked.append(t_s)
        if asked and not switched and t_s > asked[0] + 2.0:
            switched.append(t_s)
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LOITER))

    switched: list[float] = []
    link.hook = hook
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert [leg.outcome for leg in result.legs] == [LegOutcome.FLOWN]
    assert result.outcome is FlightOutcome.LEFT_TO_PILOT
    assert max(t for t, _ in link.sent) <= switched[0] + 0.15
    assert link.sim.vehicle.mode == CopterMode.LOITER


def test_a_level_step_is_judged_like_any_other(run_dir: Path) -> None:
    """Between the stopping throttles a step looks like a release target, but holds for seconds, here on the way through the ceiling."""

    def climb(t_s: float) -> AttitudeTarget:
        return AttitudeTarget(t_s, 0.0, 0.0, 0.0, 0.18 if t_s < 0.3 else 0.25)

    heights: list[float] = []
    link = FaultyLink(options())
    link.hook = lambda _message, _t_s: heights.append(float(link.sim.vehicle.motion.pz))
    leg = make_leg("climb", climb, 4.0, "throttle_pair")
    result = fly(make_plan(leg), "sim", run_dir, transport=link)
    assert result.legs[0].outcome is LegOutcome.REFUSED
    assert max(heights) < LIMITS.height_m[1] + 0.3


def test_a_link_lost_in_a_level_step_ends_it(run_dir: Path) -> None:
    link = FaultyLink(options())
    began = on_mark(link, " step")
    link.down = lambda t: bool(began) and began[0] + 0.1 < t < began[0] + 2.1
    level = make_leg("up", lambda t: AttitudeTarget(t, 0.0, 0.0, 0.0, 0.17), 1.5, "throttle_pair")
    result = fly(make_plan(level), "sim", run_dir, transport=link)
    assert [r.outcome for r in result.legs] == [LegOutcome.LINK_LOST, LegOutcome.FLOWN]


def test_a_pilot_who_takes_over_while_it_is_planned_again_keeps_the_vehicle(run_dir: Path) -> None:
    link = FaultyLink(options())
    switched: list[float] = []

    class Slow:
        def due(self, _learnt: Learnt) -> bool:
            return not switched

        def plan(self, _learnt: Learnt) -> Plan:
            """Nothing is read while it is planned; the pilot switches meanwhile."""
            switched.append(link.sim.time_s)
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LOITER))
            return make_plan()

    result = fly(make_plan(), "sim", run_dir, transport=link, replanner=Slow())
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert link.sim.vehicle.mode == CopterMode.LOITER
    assert not [t for t, kind in link.sent if kind == "COMMAND_LONG" and t >= switched[0]]


def test_a_disk_that_fills_up_in_a_step_lands_the_vehicle(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    link = FaultyLink(options())
    began = on_mark(link, " step")
    opened: list[object] = []

    def flush(lines: LineFile) -> None:
        """On a disk that is full from the step on."""
        if began and lines.waiting:
            opened.append(lines)
            raise OSError(errno.ENOSPC, "No space left on device")
        written(lines)

    written = LineFile.flush
    monkeypatch.setattr(LineFile, "flush", flush)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert opened
    assert result.outcome is FlightOutcome.RECORD_LOST
    assert not link.sim.vehicle.armed
    assert link.sim.vehicle.store["GUID_TIMEOUT"] == 3.0
    assert any("No space left" in note for note in result.notes)


def test_a_full_disk_is_reported_before_the_flight(run_dir: Path) -> None:
    run_dir.mkdir()
    (run_dir / "raw.tlog").symlink_to("/dev/full")
    link = FaultyLink(options())
    with pytest.raises(RecordingError, match="No space left"):
        fly(make_plan(), "sim", run_dir, transport=link)
    assert not link.sim.vehicle.armed


def test_a_device_in_place_of_the_record_is_not_read_to_its_end(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """/dev/full never ends: what waits in memory is decoded, and nothing is read from the device."""
    run_dir.mkdir()
    (run_dir / "raw.tlog").symlink_to("/dev/full")
    link = FaultyLink(options())
    monkeypatch.setattr(LineFile, "flush", lambda _lines: None)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert not link.sim.vehicle.armed


def test_heights_are_above_the_place_where_it_armed(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ArduPilot takes home anew when it arms: the estimate may have drifted by metres since the first fix."""
    link = FaultyLink(options())
    stated = ArduPilot.home_m

    def drifted(vehicle: ArduPilot) -> np.ndarray | None:
        home = stated(vehicle)
        assert home is not None
        return home if link.sim.vehicle.armed else home + np.array([0.0, 0.0, 1.2])

    monkeypatch.setattr(ArduPilot, "home_m", drifted)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert read_manifest(run_dir)["zone_origin_local_m"][2] == pytest.approx(0.0, abs=0.2)


def test_a_host_that_was_held_up_in_a_step_flies_it_again(run_dir: Path) -> None:
    """A suspended laptop: the vehicle has long ended the step by itself, and must not be put into the middle of it."""
    held: list[float] = []
    link = FaultyLink(options())

    def pause(t_s: float) -> AttitudeTarget:
        if t_s > 0.5 and not held:
            held.append(link.sim.time_s)
            link.sim.send(
                bytes(dialect.MAVLink_system_time_message(0, int(1e3 * (held[0] + 2.0))).pack(parser(245, 191)))
            )
        return AttitudeTarget(t_s, 0.2 if 0.3 < t_s < 0.8 else 0.0, 0.0, 0.0, 0.17)

    result = fly(make_plan(make_leg("a", pause)), "sim", run_dir, transport=link)
    assert [leg.outcome for leg in result.legs] == [LegOutcome.LINK_LOST, LegOutcome.FLOWN]


def test_a_step_whose_targets_left_too_late_is_flown_again_and_says_so(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = iter([0.0] * 20 + [0.6])
    monkeypatch.setattr(MavlinkPort, "late_s", property(lambda _port: next(late, 0.0)))
    result = fly(make_plan(make_leg("a")), "sim", run_dir, transport=FaultyLink(options()))
    assert [leg.outcome for leg in result.legs] == [LegOutcome.LINK_LOST, LegOutcome.FLOWN]
    assert result.legs[0].why[0] == "a target left too late: the ground was held up"
