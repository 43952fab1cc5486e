"""Each preflight check on its own: what it refuses, its remedy, what it would set; and that a good vehicle passes."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from flighttest.errors import PreflightError
from flighttest.flight.preparation import preflight
from flighttest.flight.preparation.fence_limits import fence_words
from flighttest.flight.preparation.preflight import checks, is_simulator, refuse
from flighttest.flight.preparation.situation import Check, Situation
from flighttest.link.session import Heard
from flighttest.mavlink.dialect import dialect
from flighttest.plan import CellPlan, Plan
from tests.flight.faulty import GOOD, LIMITS, make_leg, make_plan

PARAMETERS = {
    "GUID_OPTIONS": 8.0,
    "GUID_TIMEOUT": 0.2,
    "FLTMODE_GCSBLOCK": 0.0,
    "FS_OPTIONS": 16.0,
    "FENCE_ENABLE": 1.0,
    "FENCE_TYPE": 7.0,
    "FENCE_ACTION": 4.0,
    "FENCE_ALT_MAX": 15.0,
    "LOG_BITMASK": 980991.0,
}
RATES = {"ATTITUDE": 100.0, "HIGHRES_IMU": 100.0, "LOCAL_POSITION_NED": 50.0, "BATTERY_STATUS": 10.0, "HEARTBEAT": 10.0}


def situation(**changes: Any) -> Situation:
    parameters = PARAMETERS | changes.pop("parameters", {})
    state = replace(GOOD, armed=False, mode=0, **changes.pop("state", {}))
    fields: dict[str, Any] = {
        "plan": make_plan(),
        "rates_hz": RATES | changes.pop("rates", {}),
        "firmware": "4.7.0-dev (97009754)",
        "vehicle_type": 2,
        "simulator": False,
        "rc_live": True,
    }
    return Situation(parameters=parameters, state=state, **(fields | changes))


def found(**changes: Any) -> list[Check]:
    return checks(situation(**changes))


def test_a_good_vehicle_passes() -> None:
    assert found() == []


REFUSED: list[tuple[str, dict[str, Any], dict[str, float] | None]] = [
    ("GUID_OPTIONS", {"parameters": {"GUID_OPTIONS": 1.0}}, {"GUID_OPTIONS": 9.0}),
    ("GUID_TIMEOUT", {"parameters": {"GUID_TIMEOUT": 3.0}}, {"GUID_TIMEOUT": 0.2}),
    ("GUID_TIMEOUT", {"parameters": {"GUID_TIMEOUT": 0.21}}, {"GUID_TIMEOUT": 0.2}),
    ("FLTMODE_GCSBLOCK", {"parameters": {"FLTMODE_GCSBLOCK": 64.0}}, {"FLTMODE_GCSBLOCK": 0.0}),
    ("SYSID_ENFORCE", {"parameters": {"SYSID_ENFORCE": 1.0}}, {}),
    ("SYSID_ENFORCE", {"parameters": {"MAV_OPTIONS": 1.0}}, {}),
    ("FS_OPTIONS", {"parameters": {"FS_OPTIONS": 20.0}}, {"FS_OPTIONS": 16.0}),
    ("LOG_BITMASK", {"parameters": {"LOG_BITMASK": 176126.0}}, None),
    ("LOG_BITMASK", {"parameters": {"LOG_BITMASK": float(980991 & ~1)}}, {"LOG_BITMASK": 980991.0}),
    ("fence", {"parameters": {"FENCE_ENABLE": 0.0}}, None),
    ("fence", {"parameters": {"FENCE_ACTION": 1.0}}, None),
    ("fence", {"parameters": {"FENCE_TYPE": 1.0}}, None),
    ("fence", {"parameters": {"FENCE_TYPE": 2.0}}, None),
    ("fence", {"parameters": {"FENCE_ALT_MAX": 100.0}}, None),
    ("rc", {"rc_live": False}, {}),
    ("FS_THR_ENABLE", {"parameters": {"FS_THR_ENABLE": 0.0}}, {}),
    ("FLTMODE_CH", {"parameters": {"FLTMODE_CH": 0.0}}, {}),
    ("RC_OPTIONS", {"parameters": {"RC_OPTIONS": 1.0}}, {}),
    ("stick", {"parameters": {"RC_OPTIONS": 32.0}, "state": {"throttle_stick": 0.5}}, {}),
    ("stick", {"parameters": {"RC_OPTIONS": 32.0, "RC3_MIN": 1000.0}, "state": {"throttle_stick": 0.1}}, {}),
    ("rates", {"rates": {"HEARTBEAT": 1.0}}, {}),
    ("battery", {"state": {"voltage_v": 21.0}}, {}),
    ("battery", {"state": {"voltage_v": None}}, {}),
    ("position", {"state": {"position_ok": False}}, {}),
    ("attitude", {"state": {"attitude_rad": None}}, {}),
    ("attitude", {"state": {"attitude_rad": (0.4, 0.0, 0.0)}}, {}),
    ("rates", {"rates": {"ATTITUDE": 30.0}}, {}),
    ("rates", {"rates": {"LOCAL_POSITION_NED": 2.0}}, {}),
    ("rates", {"rates": {"HIGHRES_IMU": 0.0}}, {}),
    ("rates", {"rates": {"BATTERY_STATUS": 0.0}}, {}),
    ("firmware", {"firmware": ""}, {}),
    ("firmware", {"firmware": "4.0.7"}, {}),
    ("frame", {"vehicle_type": 1}, {}),
]


@pytest.mark.parametrize(("name", "changes", "wanted"), REFUSED)
def test_each_fault_is_found_alone_with_its_remedy(
    name: str, changes: dict[str, Any], wanted: dict[str, float] | None
) -> None:
    (check,) = found(**changes)
    assert check.name == name
    assert len(check.remedy) > 5
    if wanted is None:
        assert check.set
    else:
        assert check.set == wanted


@pytest.mark.parametrize(
    ("parameters", "stick"),
    [
        ({"RC_OPTIONS": 32.0}, 0.1),
        ({"RC_OPTIONS": 32.0, "RC3_MIN": 1000.0, "RC3_DZ": 120.0}, 0.1),
        ({"RC_OPTIONS": 32.0, "RCMAP_THROTTLE": 2.0, "RC2_MIN": 1500.0}, 0.5),
        ({"RC_OPTIONS": 32.0, "PILOT_THR_BHV": 1.0}, 0.5),
        ({"RC_OPTIONS": 32.0}, None),
        ({"RC_OPTIONS": 0.0}, 0.5),
    ],
)
def test_a_throttle_stick_with_which_the_vehicle_arms_passes(parameters: dict[str, float], stick: float | None) -> None:
    """With its default settings ArduCopter refused to arm for a minute while the stick was at mid, as the documentation asked for."""
    assert found(parameters=parameters, state={"throttle_stick": stick}) == []


def test_a_fence_that_the_pilot_has_drawn_is_completed_and_not_widened() -> None:
    (check,) = found(parameters={"FENCE_ENABLE": 0.0, "FENCE_TYPE": 4.0, "FENCE_ALT_MAX": 12.0, "FENCE_RADIUS": 20.0})
    assert check.set["FENCE_TYPE"] == 7.0
    assert (check.set["FENCE_ALT_MAX"], check.set["FENCE_RADIUS"]) == (12.0, 20.0)


def reaching(*cells: CellPlan) -> Plan:
    return replace(make_plan(), cells=cells)


def cell(label: str, start_m: tuple[float, float, float], far_m: float, up_m: float) -> CellPlan:
    """A step that goes far_m to the vehicle's right and up_m up."""
    low, high = (0.0, -far_m, 0.0), (0.0, 0.0, up_m)
    return CellPlan(label, "roll_step", 3, (), 0, (), 1.0, start_m, low, high, low, high, 3.0)


SMALL, LARGE = cell("roll+0.20", (0.0, 0.0, 5.0), 1.5, 0.0), cell("roll+0.50", (0.0, 0.0, 5.0), 3.9, 0.4)


@pytest.mark.parametrize(
    ("simulator", "fence", "words"),
    [
        (False, {"FENCE_RADIUS": 3.8}, ["FENCE_RADIUS is 3.8 m, and roll+0.50 gets 3.9 m away from home"]),
        (False, {"FENCE_RADIUS": 4.0}, []),
        (False, {"FENCE_ALT_MAX": 5.3}, ["FENCE_ALT_MAX is 5.3 m, and roll+0.50 gets up to 5.4 m high"]),
        (False, {"FENCE_ALT_MAX": 5.5}, []),
        (False, {"FENCE_RADIUS": 2.0, "FENCE_TYPE": 5.0}, []),  # a polygon is drawn, and the circle is off
        (True, {"FENCE_RADIUS": 2.0, "FENCE_TYPE": 1.0}, []),
        (True, {"FENCE_RADIUS": 2.0, "FENCE_ENABLE": 0.0}, []),
        (True, {"FENCE_RADIUS": 2.0}, ["FENCE_RADIUS is 2 m"]),
        (True, {"FENCE_ALT_MAX": 4.0, "FENCE_TYPE": 2.0}, []),
    ],
)
def test_a_fence_inside_of_what_is_flown_is_found_before_the_flight(
    simulator: bool, fence: dict[str, float], words: list[str]
) -> None:
    """On ArduCopter a circle of 2.5 m took the vehicle out of the sixth of 36 steps, and the command to resume flew into it again."""
    seen = found(plan=reaching(SMALL, LARGE), parameters=fence, simulator=simulator)
    assert [c.name for c in seen] == ["fence"] * len(words)
    for check, text in zip(seen, words, strict=True):
        assert check.what.startswith(text)
        assert not check.set, "what the pilot has drawn stays as tight"


def test_a_step_that_begins_away_from_home_is_judged_by_where_it_surely_gets() -> None:
    aside = cell("roll+0.50", (0.0, 3.0, 5.0), 3.9, 0.0)  # towards home or away from it, by its heading
    assert found(plan=reaching(aside), parameters={"FENCE_RADIUS": 3.1}) == []
    assert [c.name for c in found(plan=reaching(aside), parameters={"FENCE_RADIUS": 2.9})] == ["fence"]


def test_a_circle_about_home_is_not_compared_with_a_zone_elsewhere() -> None:
    plan = reaching(LARGE)
    elsewhere = replace(plan.vehicle, zone=replace(plan.vehicle.zone, origin=(50.0, 4.0)))
    assert found(plan=replace(plan, vehicle=elsewhere), parameters={"FENCE_RADIUS": 2.0}) == []


def test_an_armed_vehicle_is_refused() -> None:
    s = situation()
    (check,) = checks(replace(s, state=replace(s.state, armed=True)))
    assert check.name == "armed"


def test_raw_imu_stands_in_for_highres_imu() -> None:
    assert found(rates={"HIGHRES_IMU": 0.0, "RAW_IMU": 100.0}) == []


def test_yaw_rate_steps_need_a_newer_firmware() -> None:
    yaw = make_plan(make_leg(kind="yaw_rate_step"))
    assert found(firmware="4.5.7") == []
    assert [c.name for c in found(firmware="4.5.7", plan=yaw)] == ["firmware"]
    assert found(firmware="4.6.0", plan=yaw) == []


def test_without_a_position_the_attitude_reset_is_offered() -> None:
    (check,) = found(state={"position_ok": False})
    assert "by: attitude" in check.remedy
    assert found(state={"position_ok": False}, plan=make_plan(by="attitude"), rates={"LOCAL_POSITION_NED": 0.0}) == []


def test_a_plan_that_limits_no_voltage_needs_none() -> None:
    assert found(state={"voltage_v": None}, plan=make_plan(limits=replace(LIMITS, voltage_min_v=0.0))) == []


def test_a_plan_without_legs_is_refused() -> None:
    empty = replace(make_plan(), legs=(), refusals=(("a", "it leaves the zone", "start lower"),))
    (check,) = found(plan=empty)
    assert "it leaves the zone" in check.what


def test_a_simulator_is_excused_from_rc_and_fence_only() -> None:
    excused = {"simulator": True, "rc_live": False, "parameters": {"FENCE_ENABLE": 0.0}}
    assert found(**excused) == []
    assert [c.name for c in found(**excused, state={"voltage_v": 20.0})] == ["battery"]
    assert is_simulator({"SIM_SPEEDUP": 1.0})
    assert not is_simulator(PARAMETERS)


def test_only_a_fast_simulator_may_hold_longer() -> None:
    slow = {"parameters": {"GUID_TIMEOUT": 2.0}}
    assert found(simulator=True, pace=10.0, **slow) == []
    assert [c.name for c in found(simulator=False, pace=10.0, **slow)] == ["GUID_TIMEOUT"]
    assert [c.name for c in found(simulator=True, pace=1.0, **slow)] == ["GUID_TIMEOUT"]


def test_waivers_are_by_name_and_noted() -> None:
    faults = [*found(rc_live=False), *found(parameters={"GUID_OPTIONS": 0.0})]
    with pytest.raises(PreflightError) as refused:
        refuse(faults, {"rc"})
    assert len(refused.value.refusals) == 1
    refuse(faults, {"rc", "GUID_OPTIONS"})
    assert preflight.waiver_notes(faults, {"rc"}) == [f"waived rc: {faults[0].what}"]


@pytest.mark.parametrize(
    ("fence", "good"),
    [
        ({"FENCE_TYPE": 3.0, "FENCE_RADIUS": 300.0}, False),  # the firmware's default
        ({"FENCE_TYPE": 3.0, "FENCE_RADIUS": 40.0}, True),
        ({"FENCE_TYPE": 3.0, "FENCE_RADIUS": 41.0}, False),
        ({"FENCE_TYPE": 7.0, "FENCE_RADIUS": 300.0}, True),  # a polygon, which is not read
        ({"FENCE_TYPE": 7.0, "FENCE_RADIUS": 300.0, "FENCE_TOTAL": 0.0}, False),  # none is drawn
        ({"FENCE_TYPE": 5.0, "FENCE_TOTAL": 0.0, "FENCE_RADIUS": 30.0}, False),
        ({"FENCE_TYPE": 5.0, "FENCE_TOTAL": 6.0, "FENCE_RADIUS": 300.0}, True),
    ],
)
def test_a_circle_far_beyond_the_zone_is_no_fence_for_it(fence: dict[str, float], good: bool) -> None:
    refused = found(parameters=fence)
    assert [check.name for check in refused] == ([] if good else ["fence"])
    assert all(check.set["FENCE_RADIUS"] == 30.0 for check in refused)


def test_a_zone_that_asks_for_a_polygon() -> None:
    """By parameters; on a simulator as well. What is drawn on the vehicle is read later (`test_fence`)."""
    plan = make_plan()
    plan = replace(plan, vehicle=replace(plan.vehicle, zone=replace(plan.vehicle.zone, fence="polygon")))
    assert found(plan=plan) == []
    for simulator in (False, True):
        (check,) = found(plan=plan, simulator=simulator, parameters={"FENCE_TYPE": 2.0})
        assert check.name == "fence"
        assert check.set == {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 7.0, "FENCE_ACTION": 4.0, "FENCE_ALT_MAX": 15.0}
    (union,) = found(plan=plan, parameters={"FENCE_OPTIONS": 3.0})
    assert union.remedy == "set FENCE_OPTIONS to 1"
    far = {"FENCE_TYPE": 7.0, "FENCE_RADIUS": 90.0, "FENCE_TOTAL": 0.0}
    assert fence_words(situation(plan=replace(plan, fenced=3), parameters=far)) == ""


def test_a_plan_that_counts_on_a_fence_is_reported_how_far_a_circle_lets_it_go() -> None:
    counting = replace(make_plan(), fenced=3)
    words = fence_words(situation(plan=counting, parameters={"FENCE_TYPE": 3.0, "FENCE_RADIUS": 30.0}))
    assert words.startswith("3 kinds of steps count on a fence along the zone where the link is lost")
    assert "of 30 m lies up to 22 m beyond it" in words
    assert fence_words(situation(plan=make_plan(), parameters={"FENCE_TYPE": 3.0, "FENCE_RADIUS": 30.0})) == ""
    assert fence_words(situation(plan=counting, parameters={"FENCE_TYPE": 5.0, "FENCE_TOTAL": 6.0})) == ""


def test_a_second_vehicle_on_the_link_is_refused() -> None:
    (check,) = found(others=frozenset({2, 7}))
    assert check.name == "vehicles"
    assert "2, 7" in check.what


RECEIVER = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER


@pytest.mark.parametrize(
    ("channels", "present", "health", "live"),
    [
        (None, 0, 0, False),
        (0, RECEIVER, RECEIVER, False),
        (16, RECEIVER, RECEIVER, True),
        (16, RECEIVER, 0, False),  # the transmitter was switched off: the channels stay as they were
        (16, 0, 0, True),
    ],
)
def test_rc_is_live_where_the_autopilot_receives_it_now(
    channels: int | None, present: int, health: int, live: bool
) -> None:
    heard = dialect.MAVLink_rc_channels_message(0, channels or 0, *([0] * 18), 0)
    latest = {} if channels is None else {"RC_CHANNELS": Heard(heard, 1.0)}
    status = dialect.MAVLink_sys_status_message(present, present, health, *([0] * 10))
    vehicle = SimpleNamespace(session=SimpleNamespace(latest=latest), request=lambda *_: status)
    assert preflight.rc_live(vehicle) is live  # type: ignore[arg-type]


def test_a_value_to_be_typed_back_keeps_every_digit() -> None:
    assert preflight.figure(2293759.0) == "2293759"
    assert preflight.figure(0.20000000298023224) == "0.2"
