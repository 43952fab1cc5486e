"""Whole flights on the built-in vehicle in this process: as planned, with the pilot taking over, with the link lost, refused, stopped."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flighttest.errors import LinkError, PreflightError
from flighttest.flight import FlightOutcome, FlightProgress, FlightState, LegOutcome, legs_flown
from flighttest.flight.execution.legs import AutopilotSettings
from flighttest.link.ardupilot import UNSHAPED_LAG_S, ArduPilot
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect
from flighttest.pipeline.diagnosis.next_flight import flown_vehicle
from flighttest.plan import AttitudeTarget
from flighttest.recording.store import open_run, read_manifest
from flighttest.vehicle.model import DEFAULT_VEHICLE, Zone
from tests.flight.faulty import LIMITS, FaultyLink, fly, make_leg, make_plan, options


def step_time(link: FaultyLink) -> list[float]:
    """Times of the first marks named `step`, filled while flying."""
    times: list[float] = []

    def hook(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            times.append(t_s)

    link.hook = hook
    return times


def test_a_flight_as_planned(run_dir: Path) -> None:
    link = FaultyLink(options())
    seen: list[FlightProgress] = []
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link, on_progress=seen.append)
    assert result.outcome is FlightOutcome.COMPLETED
    assert [r.outcome for r in result.legs] == [LegOutcome.FLOWN, LegOutcome.FLOWN]
    assert legs_flown(run_dir) == {"test/a/r1", "test/b/r1"}

    recording = open_run(run_dir)
    assert recording.has("roll_rad", "p_rad_s", "roll_ref_rad", "throttle", "f_z_m_s2", "v_x_m_s", "voltage_v", "mode")
    t_s, reference = recording.channel("roll_ref_rad")
    marks = [m for m in recording.markers if m.kind == "phase" and m.label == "step"]
    assert len(marks) == 2
    edges = t_s[1:][np.diff(reference) > 0.2]
    for mark in marks:
        assert np.min(np.abs(edges - mark.t_s)) < 0.025
    # 0.1 s after the edge and later the vehicle follows to the commanded side: signs agree end to end.
    t_roll, roll = recording.channel("roll_rad")
    window = (t_roll > marks[0].t_s + 0.25) & (t_roll < marks[0].t_s + 0.5)
    assert np.mean(roll[window]) == pytest.approx(0.3, abs=0.08)
    leg = next(m for m in recording.markers if m.kind == "leg")
    assert leg.data["cell"] == {"amplitude_rad": 0.3}
    assert leg.data["kind"] == "roll_step"

    manifest = read_manifest(run_dir)
    assert manifest["outcome"] == FlightOutcome.COMPLETED.value
    assert manifest["parameters"]["GUID_OPTIONS"] == 8.0
    assert link.sim.vehicle.store["GUID_OPTIONS"] == 0.0, "what was set must be restored"
    known = flown_vehicle([recording])
    assert known is not None
    assert known.zone == DEFAULT_VEHICLE.zone, "a diagnosis asks what fits it"
    assert {p.leg for p in seen} >= {1, 2}
    assert any(p.zone_margin_m > 5 for p in seen)


def test_the_pilot_takes_over_and_not_one_frame_follows(run_dir: Path) -> None:
    link = FaultyLink(options())
    began = step_time(link)

    def pilot(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            began.append(t_s)
            link.set_parameter("SIM_PILOT_MODE", 5.0)  # LOITER

    link.hook = pilot
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.TAKE_OVER
    switched = began[0]
    last_sent = max(t for t, _ in link.sent)
    # HEARTBEAT comes ten times a second; the cycle that receives it sends nothing more.
    assert switched <= last_sent <= switched + 0.15
    assert result.parameters_left["GUID_OPTIONS"] == 0.0
    assert any("not restored" in note for note in result.notes)
    recording = open_run(run_dir)
    assert [m.label for m in recording.markers if m.kind == "take_over"] == ["LOITER"]
    assert link.sim.vehicle.mode == 5


def test_a_lost_link_ends_the_leg_not_the_flight(run_dir: Path) -> None:
    link = FaultyLink(options())
    began = step_time(link)
    link.down = lambda t: bool(began) and began[0] + 0.1 < t < began[0] + 2.1
    result = fly(make_plan(make_leg("a"), make_leg("b")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED
    assert [r.outcome for r in result.legs] == [LegOutcome.LINK_LOST, LegOutcome.FLOWN, LegOutcome.FLOWN]
    recording = open_run(run_dir)
    assert any(m.kind == "link_lost" for m in recording.markers)
    # Never silent while the vehicle may hold the step's throttle: level targets went on all the time.
    targets = [t for t, kind in link.sent if kind == "SET_ATTITUDE_TARGET" and began[0] < t < began[0] + 2.0]
    assert np.max(np.diff(targets)) < 0.05


def test_a_link_that_stays_away_is_an_outcome(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flighttest.flight.execution.control.GIVE_UP_AFTER_S", 5.0)
    link = FaultyLink(options())
    began = step_time(link)
    link.down = lambda t: bool(began) and t > began[0] + 0.1
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.LINK_LOST
    assert result.parameters_left


def test_a_refused_target_is_dropped_and_level_targets_follow_in_the_same_cycle(run_dir: Path) -> None:
    link = FaultyLink(options())
    tilts: list[tuple[float, float]] = []

    def look(message: object, t_s: float) -> None:
        if message.get_type() == "SET_ATTITUDE_TARGET":  # type: ignore[attr-defined]
            q = message.q  # type: ignore[attr-defined]
            tilts.append((t_s, 2.0 * np.hypot(q[1], q[2])))

    link.hook = look
    bad = make_leg("bad", lambda t: AttitudeTarget(t, 0.7 if t > 0.5 else 0.0, 0.0, 0.0, 0.17))
    result = fly(make_plan(bad, make_leg("good")), "sim", run_dir, transport=link)
    assert [r.outcome for r in result.legs] == [LegOutcome.REFUSED, LegOutcome.FLOWN]
    assert "the target tilts more than the script allows" in result.legs[0].why
    assert result.outcome is FlightOutcome.COMPLETED
    assert max(tilt for _, tilt in tilts) < 0.32, "the refused target must not have left, not even clamped"
    gaps = np.diff([t for t, _ in tilts])
    assert np.sort(gaps)[-3:].max() > 0.5  # between the legs the autopilot holds position by itself
    abort = next(m for m in open_run(run_dir).markers if m.kind == "abort")
    assert abort.data["modes"][0] == "BRAKE"
    assert min(abs(t - abort.t_s) for t, _ in tilts) < 1e-3


def test_a_pilot_who_lands_during_an_abort_has_taken_over(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LAND is the last of the abort's modes, but it was not requested yet; the request for BRAKE is lost on the way."""
    link = FaultyLink(options())
    asked: list[float] = []

    def lost(vehicle: ArduPilot, mode: CopterMode) -> None:
        if mode is CopterMode.BRAKE:
            asked.append(vehicle.session.now_s())
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LAND))
        else:
            ask(vehicle, mode)

    ask = ArduPilot.ask_mode
    monkeypatch.setattr(ArduPilot, "ask_mode", lost)
    bad = make_leg("bad", lambda t: AttitudeTarget(t, 0.7 if t > 0.5 else 0.0, 0.0, 0.0, 0.17))
    result = fly(make_plan(bad, make_leg("good")), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert max(t for t, _ in link.sent) <= asked[0] + 0.15


def test_a_step_refused_twice_is_left_out(run_dir: Path) -> None:
    def bad(name: str) -> object:
        return make_leg(name, lambda t: AttitudeTarget(t, 0.7, 0.0, 0.0, 0.17))

    result = fly(make_plan(bad("a"), bad("b"), bad("c")), "sim", run_dir, transport=FaultyLink(options()))  # type: ignore[arg-type]
    assert [r.outcome for r in result.legs] == [LegOutcome.REFUSED, LegOutcome.REFUSED, LegOutcome.LEFT_OUT]


def test_ctrl_c_once_lands(run_dir: Path) -> None:
    link = FaultyLink(options())
    began = step_time(link)
    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=lambda: int(bool(began)))
    assert result.outcome is FlightOutcome.OPERATOR_STOP
    assert not link.sim.vehicle.armed
    assert result.legs[0].outcome is LegOutcome.STOPPED
    assert not result.parameters_left


@pytest.mark.parametrize(
    ("presses", "by", "outcome"),
    [
        (1, "guided", FlightOutcome.OPERATOR_STOP),
        (1, "attitude", FlightOutcome.OPERATOR_STOP),
        (2, "guided", FlightOutcome.OPERATOR_ABORT),
    ],
)
def test_ctrl_c_in_the_climb_does_not_wait_for_its_end(
    presses: int, by: str, outcome: FlightOutcome, run_dir: Path
) -> None:
    link = FaultyLink(options())
    heights: list[float] = []
    modes: list[int] = []

    def pressed() -> int:
        height = float(link.sim.vehicle.motion.pz)
        heights.append(height)
        return presses if max(heights) > 1.0 else 0

    def look(message: object, _t_s: float) -> None:
        if message.get_type() == "COMMAND_LONG" and message.command == dialect.MAV_CMD_DO_SET_MODE and pressed():  # type: ignore[attr-defined]
            modes.append(int(message.param2))  # type: ignore[attr-defined]

    link.hook = look
    plan = make_plan()
    result = fly(
        replace(plan, reset=replace(plan.reset, by=by)), "sim", run_dir, transport=link, stop_requested=pressed
    )
    assert result.outcome is outcome
    assert max(heights) < 3.0
    assert link.sim.vehicle.armed is (outcome is FlightOutcome.OPERATOR_ABORT)
    assert not {CopterMode.GUIDED, CopterMode.GUIDED_NOGPS} & set(modes), "nothing is begun after a stop"
    assert {leg.why for leg in result.legs} == {("the operator asked to stop",)}


@pytest.mark.parametrize(("presses", "outcome"), [(1, FlightOutcome.OPERATOR_STOP), (2, FlightOutcome.OPERATOR_ABORT)])
def test_a_vehicle_that_the_pilot_has_is_the_pilots_to_land(
    presses: int, outcome: FlightOutcome, run_dir: Path
) -> None:
    """Ctrl-C while the pilot flies by agreement: the steps that were not flown are missing, the vehicle stays with the pilot."""
    link = FaultyLink(options())
    waiting: list[float] = []

    def pilot(progress: FlightProgress) -> None:
        if "waiting for the pilot" in progress.doing:
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LOITER))
            waiting.append(progress.t_s)

    result = fly(
        make_plan(by="pilot"),
        "sim",
        run_dir,
        transport=link,
        on_progress=pilot,
        stop_requested=lambda: presses * int(len(waiting) > 3),
    )
    assert result.outcome is outcome
    assert result.left is FlightState.WITH_PILOT
    assert link.sim.vehicle.mode == CopterMode.LOITER
    assert link.sim.vehicle.armed


@pytest.mark.parametrize(
    ("presses", "outcome", "left"),
    [
        (1, FlightOutcome.OPERATOR_STOP, FlightState.LANDED),
        (2, FlightOutcome.OPERATOR_ABORT, FlightState.IN_ABORT_MODE),
    ],
)
def test_a_vehicle_that_no_pilot_took_is_not_called_the_pilots(
    presses: int, outcome: FlightOutcome, left: FlightState, run_dir: Path
) -> None:
    """Asked to fly, the pilot has chosen no mode of theirs: the vehicle hovers in GUIDED, and is the program's to see to."""
    waiting: list[float] = []

    def watch(progress: FlightProgress) -> None:
        if "waiting for the pilot" in progress.doing:
            waiting.append(progress.t_s)

    link = FaultyLink(options())
    result = fly(
        make_plan(by="pilot"),
        "sim",
        run_dir,
        transport=link,
        on_progress=watch,
        stop_requested=lambda: presses * int(len(waiting) > 3),
    )
    assert (result.outcome, result.left) == (outcome, left)
    assert not result.as_planned
    assert link.sim.vehicle.armed is (left is FlightState.IN_ABORT_MODE)


def test_a_defect_of_ours_in_a_step_lets_the_vehicle_go(run_dir: Path) -> None:
    def broken(t_s: float) -> AttitudeTarget:
        return AttitudeTarget(t_s, 0.3 / (t_s < 0.7), 0.0, 0.0, 0.17)

    link = FaultyLink(options())
    with pytest.raises(ZeroDivisionError):
        fly(make_plan(make_leg("a", broken)), "sim", run_dir, transport=link)
    assert link.sim.vehicle.mode == CopterMode.BRAKE


def test_ctrl_c_before_the_take_off_arms_nothing(run_dir: Path) -> None:
    link = FaultyLink(options())
    armed: list[bool] = []

    def pressed() -> int:
        armed.append(bool(link.sim.vehicle.armed))
        return 1

    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=pressed)
    assert result.outcome is FlightOutcome.OPERATOR_STOP
    assert not any(armed)


def test_ctrl_c_twice_leaves_the_vehicle_in_its_abort_mode(run_dir: Path) -> None:
    link = FaultyLink(options())
    began = step_time(link)
    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=lambda: 2 if began else 0)
    assert result.outcome is FlightOutcome.OPERATOR_ABORT
    assert link.sim.vehicle.armed
    assert link.sim.vehicle.mode == 17


def test_an_empty_battery_ends_the_flight_before_the_next_leg(run_dir: Path) -> None:
    link = FaultyLink(options(voltage_v=23.0))
    plan = make_plan(make_leg("a"), limits=replace(LIMITS, voltage_min_v=22.9))
    result = fly(plan, "sim", run_dir, transport=link, waive=["battery"])
    assert result.outcome is FlightOutcome.BATTERY
    assert not link.sim.vehicle.armed


@pytest.mark.slow
def test_a_pack_that_is_not_full_is_worth_a_word(run_dir: Path, tmp_path: Path) -> None:
    spread = replace(make_leg("a"), voltage_v=24.5)
    result = fly(make_plan(spread), "sim", run_dir, transport=FaultyLink(options(voltage_v=23.2)))
    assert any("the battery begins at 23.2 V, the script's repeats at 24.5 V" in note for note in result.notes)
    full = fly(make_plan(spread), "sim", tmp_path / "full", transport=FaultyLink(options()))
    assert not any("battery begins" in note for note in full.notes)


@pytest.mark.slow
def test_what_was_flown_is_not_flown_again(run_dir: Path, tmp_path: Path) -> None:
    fly(make_plan(make_leg("a")), "sim", run_dir, transport=FaultyLink(options()))
    result = fly(
        make_plan(make_leg("a"), make_leg("b")),
        "sim",
        tmp_path / "again",
        transport=FaultyLink(options()),
        resume=run_dir,
        skip=legs_flown(run_dir),
    )
    assert [r.leg for r in result.legs] == ["test/b/r1"]


def test_without_a_position_our_own_loop_brings_it_up_and_holds_height(run_dir: Path) -> None:
    link = FaultyLink(options(parameters={"SIM_GPS1_ENABLE": 0.0}))
    result = fly(make_plan(by="attitude"), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.COMPLETED, result
    assert [r.outcome for r in result.legs] == [LegOutcome.FLOWN]


def test_the_pilot_brings_it_back_and_says_when(run_dir: Path) -> None:
    link = FaultyLink(options())
    plan = make_plan(make_leg("a"), by="pilot")
    waiting: list[float] = []

    def pilot(progress: FlightProgress) -> None:
        if "waiting for the pilot" in progress.doing:
            waiting.append(progress.t_s)
            if len(waiting) == 8:
                link.set_parameter("SIM_PILOT_MODE", 20.0)

    result = fly(plan, "sim", run_dir, transport=link, on_progress=pilot)
    assert result.outcome is FlightOutcome.COMPLETED
    assert [r.outcome for r in result.legs] == [LegOutcome.FLOWN]
    quiet = [t for t, kind in link.sent if kind == "SET_ATTITUDE_TARGET" and waiting[0] <= t <= waiting[7]]
    assert quiet == [], "nothing is sent while the pilot flies"


def test_preflight_says_everything_at_once(run_dir: Path) -> None:
    link = FaultyLink(options(voltage_v=23.0))
    plan = make_plan(limits=replace(LIMITS, voltage_min_v=24.0))
    with pytest.raises(PreflightError) as refused:
        fly(plan, "sim", run_dir, transport=link)
    assert any("the battery has" in what for what, _ in refused.value.refusals)
    assert all(remedy for _, remedy in refused.value.refusals)
    assert not link.sim.vehicle.armed
    assert link.sim.vehicle.store["GUID_TIMEOUT"] == 3.0, (
        "what was set must be restored when the flight is refused, too"
    )


@pytest.mark.slow
def test_a_vehicle_that_takes_off_outside_of_the_zone_is_refused(run_dir: Path) -> None:
    """It flew 125 m to a zone beside home, and 500 m would have been accepted where a coordinate was mistyped."""
    zone = Zone(x_m=(20.0, 50.0), y_m=(-7.5, 7.5), z_m=(1.0, 10.0))
    plan = make_plan(replace(make_leg(), start_m=(35.0, 0.0, 5.0)))
    plan = replace(plan, vehicle=replace(plan.vehicle, zone=zone))
    with pytest.raises(PreflightError, match="20 m outside of the flight zone"):
        fly(plan, "sim", run_dir, transport=FaultyLink(options()))
    waived = fly(plan, "sim", run_dir.with_name("again"), transport=FaultyLink(options()), waive=("zone",))
    assert waived.outcome is FlightOutcome.COMPLETED
    assert any(note.startswith("waived zone: ") for note in waived.notes)


def test_no_vehicle_there(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Silence:
        def send(self, data: bytes) -> None: ...
        def receive(self, timeout_s: float) -> bytes:
            return b""

        def close(self) -> None: ...

    monkeypatch.setattr("flighttest.link.session.CONNECT_S", 0.3)
    with pytest.raises(LinkError, match="no HEARTBEAT"):
        fly(make_plan(), "udpin:127.0.0.1:1", run_dir, transport=Silence())
    assert read_manifest(run_dir)["outcome"].startswith("no HEARTBEAT")


@pytest.mark.parametrize(
    ("parameters", "accel_rad_s2", "lag_s"),
    [
        ({"ATC_ACC_Y_MAX": 270.0}, 4.712, 0.0),
        ({"ATC_ACCEL_Y_MAX": 27000.0, "ATC_RATE_FF_ENAB": 1.0}, 4.712, 0.0),
        ({"ATC_ACC_Y_MAX": 0.0}, 0.0, 0.0),
        ({"ATC_ACC_Y_MAX": 270.0, "ATC_RATE_FF_ENAB": 0.0}, 0.0, UNSHAPED_LAG_S),
        ({}, 0.0, UNSHAPED_LAG_S),
    ],
)
def test_the_heading_sent_is_of_the_target_s_shaping_and_trails_where_none_is_known(
    parameters: dict[str, float], accel_rad_s2: float, lag_s: float
) -> None:
    found = AutopilotSettings.of(parameters)
    assert found.yaw_accel_max_rad_s2 == pytest.approx(accel_rad_s2, abs=1e-3)
    assert found.yaw_lag_s == lag_s
