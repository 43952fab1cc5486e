"""Parameters of a flight: what somebody else changes meanwhile ends it or is reported, and what a killed program left is put back."""

from __future__ import annotations

import gc
import os
import re
from pathlib import Path

import pytest

from flighttest.errors import LinkError, PreflightError
from flighttest.flight import FlightOutcome, FlightResult
from flighttest.flight.preparation.changes import SETS, LeftParameter, ParameterChanges, still_left
from flighttest.flight.preparation.preflight import THRUST_AS_THRUST, figure
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.mavlink import CopterMode
from flighttest.pipeline.store.resuming import left_behind
from flighttest.recording.store import MANIFEST_NAME, read_events, write_manifest
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options

GUID_OPTIONS_LEFT = {"GUID_OPTIONS": LeftParameter(0.0, float(THRUST_AS_THRUST))}


def fly_while(run_dir: Path, name: str, value: float, **settings: object) -> tuple[FaultyLink, FlightResult]:
    """A flight of two steps in whose first one somebody sets a parameter."""
    link = FaultyLink(options())
    seen: list[float] = []

    def hook(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and message.text.endswith(" step") and not seen:  # type: ignore[attr-defined]
            seen.append(t_s)
            link.set_parameter(name, value)

    link.hook = hook
    plan = make_plan(make_leg("roll+0.30"), make_leg("roll+0.31"))
    result = fly(plan, "sim", run_dir, transport=link, **settings)
    assert seen
    return link, result


def test_a_flight_whose_throttle_would_mean_something_else_lands(run_dir: Path) -> None:
    link, result = fly_while(run_dir, "GUID_OPTIONS", 0.0)
    assert result.outcome is FlightOutcome.SET_UP_ANEW
    assert [leg.leg for leg in result.legs] == ["test/roll+0.30/r1"]
    assert any(note.startswith("GUID_OPTIONS was changed from 8 to 0 during the flight") for note in result.notes)
    aborted = next(m for m in read_events(run_dir)[0] if m.kind == "abort")
    assert "GUID_OPTIONS was changed" in aborted.label
    assert link.sim.vehicle.mode == CopterMode.LAND
    assert not link.sim.vehicle.armed


@pytest.mark.parametrize(("name", "chosen", "given"), [("GUID_TIMEOUT", 1.0, 0.2), ("LOG_BITMASK", 980990.0, 983039.0)])
def test_what_a_pilot_chose_during_the_flight_is_not_set_back(
    name: str, chosen: float, given: float, run_dir: Path
) -> None:
    """The value of before the flight was written over the pilot's, without a word; the alarm did not name the parameter."""
    alarms: list[str] = []
    link, result = fly_while(run_dir, name, chosen, on_progress=lambda p: alarms.append(p.alarm))
    changed = f"{name} was changed from {figure(given)} to {figure(chosen)}"
    assert any(changed in note for note in result.notes)
    assert link.sim.vehicle.store[name] == chosen
    assert any(note.startswith(f"{name} is {figure(chosen)}, set by somebody else") for note in result.notes)
    assert result.parameters_left == {}
    assert link.sim.vehicle.store["GUID_OPTIONS"] == 0.0, "what was not changed by others is restored"
    landing = [text for text in alarms if text.startswith("landing: ")]
    assert (f"{name} was changed" in "".join(landing)) == (name == "GUID_TIMEOUT")


def test_another_parameter_is_reported_and_the_flight_goes_on(run_dir: Path) -> None:
    _, result = fly_while(run_dir, "ATC_ANG_RLL_P", 7.0)
    assert result.outcome is FlightOutcome.COMPLETED
    assert sum("ATC_ANG_RLL_P was changed from" in note for note in result.notes) == 1
    assert sum("was changed" in note for note in result.notes) == 1, (
        "what the flight itself sets and restores is no external change"
    )


def test_what_has_the_value_that_is_wanted_is_neither_set_nor_restored() -> None:
    """Seen: "FENCE_TYPE set from 7 to 7; it is restored after the flight"."""
    said: list[str] = []
    changes = ParameterChanges(Session(MavlinkPort(FaultyLink(options()))), {"FENCE_TYPE": 7.0}, {})
    changes.apply({"FENCE_TYPE": 7.0}, said.append, lambda _pending: None, lambda: False)
    assert (said, changes.pending) == ([], {})


def killed_before_it_restores(run_dir: Path) -> float:
    """A run whose program dies with the first parameter set: its manifest as it was then. GUID_OPTIONS as it was before it."""
    link = FaultyLink(options(parameters={"GUID_OPTIONS": 0.0}))
    kept: list[bytes] = []

    def hook(message: object, _t_s: float) -> None:
        if message.get_type() == "PARAM_SET" and message.param_id == "GUID_OPTIONS" and not kept:  # type: ignore[attr-defined]
            kept.append((run_dir / MANIFEST_NAME).read_bytes())

    link.hook = hook
    fly(make_plan(), "sim", run_dir, transport=link)
    assert link.sim.vehicle.store["GUID_OPTIONS"] == 0.0
    (run_dir / MANIFEST_NAME).write_bytes(kept[0])
    return 0.0


@pytest.mark.slow
def test_what_a_killed_program_left_is_restored_by_the_next_flight(tmp_path: Path) -> None:
    should = killed_before_it_restores(tmp_path / "2026-01-01-a")
    behind = left_behind(tmp_path, "paper")
    assert behind["GUID_OPTIONS"] == LeftParameter(should, float(THRUST_AS_THRUST))
    assert left_behind(tmp_path, "another") == {}
    link = FaultyLink(options(parameters={"GUID_OPTIONS": float(THRUST_AS_THRUST)}))
    said: list[str] = []
    run_dir = tmp_path / "2026-01-02-b"
    result = fly(make_plan(), "sim", run_dir, transport=link, left_behind=behind, on_stage=said.append)
    assert result.outcome is FlightOutcome.COMPLETED
    assert link.sim.vehicle.store["GUID_OPTIONS"] == should
    assert any("an earlier flight left GUID_OPTIONS at 8 instead of 0: it is restored" in line for line in said)
    assert left_behind(tmp_path, "paper") == {}


def test_what_was_left_is_only_reported_where_setting_was_not_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flighttest.flight.preparation.preflight.is_simulator", lambda _parameters: False)
    link = FaultyLink(options(parameters={"GUID_OPTIONS": float(THRUST_AS_THRUST)}))
    waived = ("rc", "FS_THR_ENABLE", "FLTMODE_CH", "RC_OPTIONS", "fence", "LOG_BITMASK", "GUID_TIMEOUT", "rates")
    run_dir = tmp_path / "run"
    result = fly(make_plan(), "sim", run_dir, transport=link, left_behind=GUID_OPTIONS_LEFT, waive=waived)
    assert result.outcome is FlightOutcome.COMPLETED
    assert link.sim.vehicle.store["GUID_OPTIONS"] == THRUST_AS_THRUST
    assert result.parameters_left == {"GUID_OPTIONS": 0.0}
    assert any("set it back by hand, or fly with --set-params" in note for note in result.notes)
    assert left_behind(tmp_path, "paper") == GUID_OPTIONS_LEFT, "the next flight is reported again"


def test_nothing_is_set_on_a_vehicle_that_somebody_has_armed(run_dir: Path) -> None:
    """A pilot flew at 40 m, and a flight that was refused because of that had set FENCE_ALT_MAX to 15 m first: the vehicle left LOITER."""
    link = FaultyLink(options(parameters={"GUID_OPTIONS": 0.0, "GUID_TIMEOUT": 3.0, "LOG_BITMASK": 0.0}))
    link.sim.vehicle.armed = True
    with pytest.raises(PreflightError, match="armed"):
        fly(make_plan(), "sim", run_dir, transport=link, left_behind={"FS_OPTIONS": LeftParameter(4.0, 0.0)})
    assert "PARAM_SET" not in [kind for _, kind in link.sent]


def test_no_further_parameter_is_set_once_the_vehicle_is_armed() -> None:
    link = FaultyLink(options())
    changes = ParameterChanges(Session(MavlinkPort(link)), {"FENCE_TYPE": 7.0}, {})
    with pytest.raises(PreflightError, match="armed meanwhile"):
        changes.apply({"FENCE_TYPE": 3.0}, lambda _text: None, lambda _pending: None, lambda: True)
    assert not link.sent


def test_what_was_put_back_meanwhile_is_not_reported(run_dir: Path) -> None:
    link = FaultyLink(options())
    usual = link.sim.vehicle.store["GUID_OPTIONS"]
    result = fly(
        make_plan(),
        "sim",
        run_dir,
        transport=link,
        left_behind={"GUID_OPTIONS": LeftParameter(usual, 0.0), "FENCE_GONE": LeftParameter(1.0, 0.0)},
    )
    assert not any("an earlier flight left" in note for note in result.notes)


def test_what_was_left_outlives_a_flight_that_never_reached_the_vehicle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flighttest.link.session.CONNECT_S", 0.05)
    link = FaultyLink(options(), down=lambda _t: True)
    with pytest.raises(LinkError):
        fly(make_plan(), "sim", tmp_path / "run", transport=link, left_behind=GUID_OPTIONS_LEFT)
    assert left_behind(tmp_path, "paper") == GUID_OPTIONS_LEFT


def planted(run_dir: Path, **blocks: object) -> None:
    run_dir.mkdir()
    write_manifest(run_dir, {"name": "planted", "vehicle": {"name": "paper"}, "outcome": "killed", **blocks})


WANTED = {"ARMING_CHECK": 0.0, "FS_THR_ENABLE": 0.0, "ATC_RAT_RLL_P": 0.5, "GUID_TIMEOUT": 5.0}
GIVEN = {"ARMING_CHECK": 1.0, "FS_THR_ENABLE": 1.0, "ATC_RAT_RLL_P": 0.135, "GUID_TIMEOUT": 3.0}


@pytest.mark.parametrize(
    "blocks",
    [
        {"parameters_changed": WANTED},
        {"parameters_left": WANTED, "parameters_set": {"run": "elsewhere", "given": GIVEN}},
        {"parameters_left": WANTED, "parameters_set": {"run": "2026-01-01-a", "given": {**GIVEN, "GUID_TIMEOUT": 1.0}}},
    ],
    ids=["no record", "of another run", "of other values"],
)
def test_a_planted_manifest_changes_nothing_on_the_vehicle(tmp_path: Path, blocks: dict[str, object]) -> None:
    planted(tmp_path / "2026-01-01-a", **blocks)
    behind = left_behind(tmp_path, "paper")
    link = FaultyLink(options())
    store = link.sim.vehicle.store
    before = {name: store[name] for name in store}
    result = fly(make_plan(), "sim", tmp_path / "2026-01-02-b", transport=link, left_behind=behind)
    assert result.outcome is FlightOutcome.COMPLETED
    assert {name: store[name] for name in WANTED if name in store} == {n: before[n] for n in WANTED if n in before}


def test_a_record_is_taken_for_what_a_flight_sets_on_the_autopilot_it_was_set_on() -> None:
    known = {"GUID_OPTIONS": 8.0, "ARMING_CHECK": 1.0, "FENCE_RADIUS": 30.0, "FS_OPTIONS": 0.0}
    behind = {
        "GUID_OPTIONS": LeftParameter(0.0, 8.0, "a1"),
        "ARMING_CHECK": LeftParameter(0.0, 1.0, "a1"),
        "FENCE_RADIUS": LeftParameter(300.0, 40.0, "a1"),
        "FS_OPTIONS": LeftParameter(float("nan"), 0.0, "a1"),
    }
    left, doubted = still_left(behind, known, "a1")
    assert left == {"GUID_OPTIONS": LeftParameter(0.0, 8.0, "a1")}
    assert len(doubted) == 3
    assert any("ARMING_CHECK should be 0, but no flight sets that by itself: it is left alone" in d for d in doubted)
    assert any("FENCE_RADIUS should be 300, but it was set to 40 and is 30 now" in d for d in doubted)
    left, doubted = still_left(behind, known, "b2")
    assert left == {}
    assert any("it was set on another autopilot" in d for d in doubted)


def test_no_check_sets_what_is_not_restored() -> None:
    source = (Path(__file__).parents[2] / "flighttest/flight/preparation/preflight.py").read_text()
    named = set(re.findall(r'"((?:GUID|FLTMODE|FS|FENCE|LOG)_[A-Z_]+)": ', source))
    assert named
    assert named <= SETS


def test_a_real_vehicle_is_flown_before_other_programs(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "getpriority", lambda *_: 0)
    monkeypatch.setattr(os, "setpriority", lambda _which, _who, value: asked.append(value))
    scheduled: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda _who, policy, _parameters: scheduled.append(policy))
    fly(make_plan(), "sim", run_dir.with_name("simulator"), transport=FaultyLink(options()))
    assert asked == [], "a simulator waits"
    monkeypatch.setattr("flighttest.flight.preparation.preflight.is_simulator", lambda _parameters: False)
    with pytest.raises(PreflightError):
        fly(make_plan(), "sim", run_dir, transport=FaultyLink(options()))
    assert asked == [-15, 0]
    assert scheduled == [os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.SCHED_OTHER]
    assert gc.get_freeze_count() == 0
