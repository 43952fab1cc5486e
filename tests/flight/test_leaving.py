"""Nothing is set on a vehicle at a flight's end unless it is seen on the ground; what is left is said, and stays on record."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from flighttest.errors import LinkError
from flighttest.flight import FlightOutcome, FlightState
from flighttest.flight.leaving import left_words, may_restore
from flighttest.flight.preparation.changes import LeftParameter
from flighttest.flight.preparation.fence import FenceSet
from flighttest.link.onboard.fence import polygon
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, parser
from flighttest.pipeline.store.resuming import fence_behind, left_behind
from flighttest.recording.store import MANIFEST_NAME, open_run, read_manifest
from tests.flight.faulty import GATE, GOOD, FaultyLink, fly, make_plan, options

HOME = (-35.3632621, 149.1652374)
PLACE = (
    r"disarmed in flight, and (?P<down>.*): last (?P<height>\S+) m above home, (?P<away>\S+) m from the zone's origin "
    r"towards \d+ deg, at latitude (?P<lat>\S+), longitude (?P<lon>\S+)"
)
SET = {"GUID_OPTIONS": 0.0, "GUID_TIMEOUT": 3.0}


def at_step(link: FaultyLink) -> list[float]:
    """When the first step is marked, and the parameters that are set from then on."""
    began: list[float] = []

    def look(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step") and not began:  # type: ignore[attr-defined]
            began.append(t_s)
        if began and message.get_type() == "PARAM_SET":  # type: ignore[attr-defined]
            began.append(t_s)

    link.hook = look
    return began


def stop_motors(link: FaultyLink) -> None:
    """Another station disarms the vehicle by force."""
    by_force = (dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0.0, 21196, *([0] * 5))
    link.sim.send(bytes(dialect.MAVLink_command_long_message(1, 1, *by_force).pack(parser(255, 190))))


def test_a_pilot_who_flies_unseen_is_not_sent_a_parameter(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The downlink is lost, the pilot takes over, and 30 s later a parameter was sent to the vehicle and listed as not restored."""
    monkeypatch.setattr("flighttest.flight.execution.control.GIVE_UP_AFTER_S", 8.0)
    link = FaultyLink(options(parameters=SET))
    began = at_step(link)
    link.mute = lambda t: bool(began) and t > began[0] + 0.1

    def pilot(t_s: float) -> bool:
        if began and t_s > began[0] + 3.0:
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LOITER))
        return False

    link.deaf = pilot
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.LINK_LOST
    assert len(began) == 1, "no parameter is set"
    assert set(SET) <= set(result.parameters_left)
    assert link.sim.vehicle.store["GUID_OPTIONS"] == 8.0


def stopped_in_the_air(link: FaultyLink) -> tuple[list[float], list[float]]:
    """Have another station stop the motors during a step; the times of `at_step`, and when they stopped."""
    began = at_step(link)
    done: list[float] = []

    def killed(t_s: float) -> bool:
        if began and not done and t_s > began[0] + 0.2:
            done.append(t_s)
            stop_motors(link)
        return False

    link.deaf = killed
    return began, done


def test_a_vehicle_that_falls_is_not_sent_a_parameter(run_dir: Path) -> None:
    """Stopped in the air by another station: PARAM_SETs left while it fell."""
    link = FaultyLink(options(parameters=SET))
    began, done = stopped_in_the_air(link)
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.DISARMED
    t_s, height = open_run(run_dir).channel("height_m")
    assert height[t_s < done[0]][-1] > 3.0
    down_s = float(t_s[(t_s > done[0]) & (height < 0.5)][0])
    assert t_s[-1] > down_s, "the fall is recorded: the record ended 4 m above the ground"
    assert all(t > down_s for t in began[1:]), "no parameter is set while it falls"
    assert result.parameters_left == {}
    assert result.sentence.endswith("the vehicle is disarmed: where it was last seen is noted")
    seen = [re.fullmatch(PLACE, note) for note in result.notes]
    place = next(match for match in seen if match)
    assert place["down"] == "seen to come down"
    assert abs(float(place["height"])) < 0.5
    assert float(place["away"]) < 3.0
    assert (float(place["lat"]), float(place["lon"])) == pytest.approx(HOME, abs=5e-5)


def test_a_fall_that_nothing_shows_ends_the_wait_for_it(run_dir: Path) -> None:
    link = FaultyLink(options(parameters=SET))
    began, done = stopped_in_the_air(link)
    link.silenced = lambda kind, _t: bool(done) and kind in {"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "VFR_HUD"}
    result = fly(make_plan(), "sim", run_dir, transport=link)
    assert result.outcome is FlightOutcome.DISARMED
    assert 5.0 < link.sim.time_s - done[0] < 8.0
    assert len(began) == 1, "no parameter is set where it is not seen to be down"
    assert any(note.startswith("disarmed in flight, and not seen to come down: ") for note in result.notes)


def test_a_vehicle_that_is_left_in_the_air_is_not_sent_a_parameter(run_dir: Path) -> None:
    link = FaultyLink(options(parameters=SET))
    began = at_step(link)
    result = fly(make_plan(), "sim", run_dir, transport=link, stop_requested=lambda: 2 if began else 0)
    assert result.left is FlightState.IN_ABORT_MODE
    assert len(began) == 1, "no parameter is set"
    assert set(SET) <= set(result.parameters_left)
    assert set(SET) <= set(read_manifest(run_dir)["parameters_left"])
    assert open_run(run_dir).has("roll_rad")


def test_after_a_take_over_it_is_said_what_stays_set(run_dir: Path) -> None:
    """Restoring was announced and not tried, and each parameter was said to be restored after the flight."""
    link = FaultyLink(options(parameters=SET))
    began = at_step(link)
    stages: list[str] = []

    def pilot(t_s: float) -> bool:
        if began and t_s > began[0] + 0.2:
            link.set_parameter("SIM_PILOT_MODE", float(CopterMode.LOITER))
        return False

    link.deaf = pilot
    result = fly(make_plan(), "sim", run_dir, transport=link, on_stage=stages.append)
    assert result.outcome is FlightOutcome.TAKE_OVER
    assert "restoring parameters" not in stages
    assert not any("restored after" in note for note in result.notes)
    assert any(note.startswith("not restored: ") and "GUID_OPTIONS 0; GUID_TIMEOUT 3" in note for note in result.notes)


def test_what_was_sent_and_the_fence_that_is_still_on_are_said() -> None:
    words = left_words({"GUID_OPTIONS": 0.0, "FENCE_ENABLE": 0.0}, {"GUID_OPTIONS"})
    assert words.startswith(
        "not restored: GUID_OPTIONS 0, which was sent but not confirmed; FENCE_ENABLE 0. Set it by hand"
    )
    assert words.endswith("the fence of this flight (height, radius) is still on")
    assert "fence" not in left_words({"GUID_OPTIONS": 0.0}, ())


@pytest.mark.parametrize(
    ("age_s", "armed", "muted", "state", "height_m", "may"),
    [
        (0.1, False, False, FlightState.LANDED, 0.0, True),
        (1.6, False, False, FlightState.LANDED, 0.0, False),
        (0.1, True, False, FlightState.GROUND, 0.0, False),
        (0.1, False, True, FlightState.NOT_ARMED, 0.0, False),
        (0.1, False, False, FlightState.DISARMED, 0.1, True),
        (0.1, False, False, FlightState.DISARMED, 4.0, False),
        (0.1, False, False, FlightState.UNKNOWN, 0.1, False),
    ],
)
def test_a_vehicle_is_set_where_it_is_heard_disarmed_and_down(
    age_s: float, armed: bool, muted: bool, state: FlightState, height_m: float, may: bool
) -> None:
    session = SimpleNamespace(
        latest={"HEARTBEAT": SimpleNamespace(t_s=10.0 - age_s)},
        now_s=lambda: 10.0,
        clock=SimpleNamespace(pace=1.0),
        port=SimpleNamespace(muted=muted),
    )
    seen = replace(GOOD, height_m=height_m)
    control = SimpleNamespace(machine=SimpleNamespace(state=state), state=seen, gate=GATE)
    assert may_restore(SimpleNamespace(session=session, armed=armed), control) is may  # type: ignore[arg-type]


@pytest.mark.parametrize("ends", ["unheard", "killed"])
def test_what_was_left_outlives_a_run_that_ends_early(
    ends: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that heard no HEARTBEAT, or was killed while it read the parameters, had no record of a fence or of parameters."""
    monkeypatch.setattr("flighttest.link.session.CONNECT_S", 0.05)
    parameters = {"GUID_OPTIONS": LeftParameter(0.0, 8.0, "board")}
    fence = FenceSet((), polygon([(10, 10), (10, 20), (20, 20)]), "board")
    run_dir = tmp_path / "2026-01-01-a"
    kept: list[bytes] = []
    link = FaultyLink(options(), down=lambda _t: ends == "unheard")
    link.hook = lambda _message, _t: kept.append((run_dir / MANIFEST_NAME).read_bytes())
    with pytest.raises(LinkError) if ends == "unheard" else contextlib.nullcontext():
        fly(make_plan(), "sim", run_dir, transport=link, left_behind=parameters, fence_behind=fence)
    if ends == "killed":
        (run_dir / MANIFEST_NAME).write_bytes(kept[0])
    assert left_behind(tmp_path, "paper") == parameters
    assert fence_behind(tmp_path, "paper") == fence
