"""The gate at and around every boundary, and the two laws: a release target always passes; nothing else passes an unfit vehicle."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flighttest.flight.gate import (
    Refusal,
    refusals,
    releases,
    stop_throttles,
    stopping_heights,
    zone_clearance_m,
)
from flighttest.plan import AttitudeTarget
from tests.flight.faulty import GATE, GOOD, LIMITS, TILTED

JUST = 1e-4

BOUNDARIES = [
    ("roll_rad", 0.61, Refusal.TARGET_TILT),
    ("roll_rad", -0.61, Refusal.TARGET_TILT),
    ("pitch_rad", 0.61, Refusal.TARGET_TILT),
    ("pitch_rad", -0.61, Refusal.TARGET_TILT),
    ("throttle", 0.6, Refusal.TARGET_THROTTLE),
    ("yaw_rate_rad_s", 3.5, Refusal.TARGET_YAW_RATE),
    ("yaw_rate_rad_s", -3.5, Refusal.TARGET_YAW_RATE),
]


def far_from_height(target: AttitudeTarget) -> bool:
    return Refusal.HEIGHT in refusals(target, GOOD, GATE)


@pytest.mark.parametrize(("part", "limit", "refusal"), BOUNDARIES)
def test_a_target_on_a_limit_passes_and_just_beyond_is_refused(part: str, limit: float, refusal: Refusal) -> None:
    base = AttitudeTarget(0.0, 0.1, 0.0, 0.0, 0.18)
    if part == "pitch_rad":
        base = AttitudeTarget(0.0, 0.0, 0.1, 0.0, 0.18)
    other = {"roll_rad": 0.0, "pitch_rad": 0.0} if part in ("roll_rad", "pitch_rad") else {}
    on = replace(base, **{**other, part: limit})
    beyond = replace(on, **{part: limit + math.copysign(JUST, limit)})
    assert refusal not in refusals(on, GOOD, GATE)
    assert refusal in refusals(beyond, GOOD, GATE)


def test_tilt_is_of_the_thrust_axis_not_of_each_angle() -> None:
    both = AttitudeTarget(0.0, 0.5, 0.5, 0.0, 0.18)
    assert Refusal.TARGET_TILT in refusals(both, GOOD, GATE)


def test_negative_throttle_is_refused() -> None:
    assert Refusal.TARGET_THROTTLE in refusals(replace(TILTED, throttle=-0.01), GOOD, GATE)


def test_a_good_target_passes() -> None:
    assert refusals(TILTED, GOOD, GATE) == ()


STATES = [
    ({"mode": 4}, Refusal.MODE),
    ({"armed": False}, Refusal.DISARMED),
    ({"silence_s": 0.5 + JUST}, Refusal.LINK),
    ({"silence_s": math.nan}, Refusal.LINK),
    ({"mode_age_s": 2.5 + JUST}, Refusal.LINK),
    ({"uplink_silence_s": 1.5 + JUST}, Refusal.UPLINK),
    ({"attitude_rad": None}, Refusal.TELEMETRY_OLD),
    ({"attitude_age_s": 0.3 + JUST}, Refusal.TELEMETRY_OLD),
    ({"position_m": None}, Refusal.POSITION_OLD),
    ({"position_age_s": 0.5 + JUST}, Refusal.POSITION_OLD),
    ({"ekf_ok": False}, Refusal.EKF),
    ({"position_ok": False}, Refusal.EKF),
    ({"attitude_rad": (0.87 + JUST, 0.0, 0.0)}, Refusal.MEASURED_TILT),
    ({"voltage_v": 21.0 - JUST}, Refusal.BATTERY),
    ({"voltage_v": None}, Refusal.VOLTAGE_UNKNOWN),
    ({"velocity_m_s": (0.0, 0.0, 8.0 + JUST)}, Refusal.SPEED),
    ({"position_m": (15.0 + JUST, 0.0, 5.0)}, Refusal.ZONE),
    ({"position_m": (-15.0 - JUST, 0.0, 5.0)}, Refusal.ZONE),
    ({"position_m": (0.0, 7.5 + JUST, 5.0)}, Refusal.ZONE),
    ({"position_m": (0.0, -7.5 - JUST, 5.0)}, Refusal.ZONE),
    ({"height_m": 10.0 + JUST}, Refusal.HEIGHT),
    ({"height_m": 2.0 - JUST}, Refusal.HEIGHT),
]


@pytest.mark.parametrize(("change", "refusal"), STATES)
def test_each_unfit_state_is_refused_with_its_own_reason(change: dict[str, object], refusal: Refusal) -> None:
    assert refusal in refusals(TILTED, replace(GOOD, **change), GATE)


FIT = [
    {"silence_s": 0.5},
    {"mode_age_s": 2.5},
    {"uplink_silence_s": 1.5},
    {"attitude_age_s": 0.3},
    {"position_age_s": 0.5},
    {"attitude_rad": (0.87, 0.0, 0.0)},
    {"voltage_v": 21.0},
    {"position_m": (15.0, 7.5, 5.0)},
    {"height_m": 10.0},
    {"height_m": 2.0},
]


@pytest.mark.parametrize("change", FIT)
def test_a_state_on_its_limit_passes(change: dict[str, object]) -> None:
    assert refusals(TILTED, replace(GOOD, **change), GATE) == ()


def test_a_stop_that_ends_beyond_the_wall_is_refused_before_the_wall_is_reached() -> None:
    moving = replace(GOOD, position_m=(10.0, 0.0, 5.0), velocity_m_s=(6.0, 0.0, 0.0))
    assert refusals(TILTED, moving, GATE) == (Refusal.ZONE,)
    assert refusals(TILTED, replace(moving, velocity_m_s=(-6.0, 0.0, 0.0)), GATE) == ()
    reach = 6.0 * (GATE.reaction_s + moving.position_age_s) + 36.0 / (2 * GATE.brake_m_s2)
    assert zone_clearance_m(moving, GATE) == pytest.approx(5.0 - reach)
    assert zone_clearance_m(replace(moving, attitude_rad=(0.0, 0.4, 0.0)), GATE) < 5.0 - reach - 1.0, (
        "it leans that way"
    )
    assert zone_clearance_m(replace(moving, attitude_rad=(0.0, -0.4, 0.0)), GATE) > 5.0 - reach + 1.0
    assert zone_clearance_m(replace(moving, attitude_rad=None), GATE) == pytest.approx(5.0 - reach)


def test_the_zone_turns_with_its_heading() -> None:
    turned = replace(GATE, zone=replace(GATE.zone, heading_rad=math.pi / 2))
    north = replace(GOOD, position_m=(10.0, 0.0, 5.0))
    assert refusals(TILTED, north, GATE) == ()
    assert Refusal.ZONE in refusals(TILTED, north, turned)


def test_a_climb_is_refused_where_it_can_no_longer_be_stopped() -> None:
    up = replace(TILTED, throttle=0.4)
    low = replace(GOOD, height_m=4.0, position_m=(0.0, 0.0, 4.0), climb_m_s=2.0, velocity_m_s=(0.0, 0.0, 2.0))
    high = replace(low, height_m=8.5, position_m=(0.0, 0.0, 8.5))
    assert refusals(up, low, GATE) == ()
    assert refusals(up, high, GATE) == (Refusal.HEIGHT,)
    assert Refusal.HEIGHT in refusals(replace(TILTED, throttle=0.05), replace(GOOD, height_m=3.0, climb_m_s=-3.0), GATE)


def test_stopping_heights_by_hand() -> None:
    # Hover throttle, climbing at 2 m/s: 0.25 s on, then 0.7 g (stop throttle 0.3 of hover) against it.
    low, high = stopping_heights(0.18, 5.0, 2.0, GATE)
    assert low == 5.0
    assert high == pytest.approx(5.0 + 0.5 + 4.0 / (2 * 0.7 * 9.81))
    # Sinking, it is stopped by the other throttle: 1.8 of hover.
    assert GATE.stop_throttle == pytest.approx((0.3 * 0.18, 1.8 * 0.18))
    low, high = stopping_heights(0.18, 5.0, -2.0, GATE)
    assert low == pytest.approx(5.0 - 0.5 - 4.0 / (2 * 0.8 * 9.81))
    assert high == 5.0


def test_a_position_of_unknown_age_is_taken_as_it_is() -> None:
    moving = replace(GOOD, velocity_m_s=(1.0, 0.0, 0.0))
    known, unknown = (replace(moving, position_age_s=age) for age in (0.0, math.inf))
    assert zone_clearance_m(unknown, GATE) == zone_clearance_m(known, GATE)


def test_without_position_zone_and_speed_are_not_judged_but_height_and_tilt_are() -> None:
    blind = replace(GATE, needs_position=False)
    state = replace(GOOD, position_m=None, velocity_m_s=None, position_ok=False, position_age_s=math.inf)
    assert refusals(TILTED, state, blind) == ()
    assert refusals(TILTED, replace(state, height_m=11.0), blind) == (Refusal.HEIGHT,)
    assert refusals(TILTED, replace(state, attitude_rad=(0.9, 0.0, 0.0)), blind) == (Refusal.MEASURED_TILT,)


@pytest.mark.parametrize("part", ["roll_rad", "pitch_rad", "yaw_rate_rad_s", "throttle"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_number_no_target(part: str, value: float) -> None:
    assert refusals(replace(TILTED, **{part: value}), GOOD, GATE) == (Refusal.NOT_A_NUMBER,)


angles = st.floats(-1.0, 1.0)


@given(
    throttle=st.floats(0.0, 1.0),
    mode=st.integers(-1, 30),
    silence=st.floats(0.0, 100.0),
    height=st.floats(-10.0, 100.0),
    tilt=angles,
)
def test_a_release_target_passes_whatever_the_vehicle_does(
    throttle: float, mode: int, silence: float, height: float, tilt: float
) -> None:
    low, high = GATE.stop_throttle
    level = AttitudeTarget(0.0, 0.0, 0.0, 0.0, low + (high - low) * throttle)
    wild = replace(
        GOOD,
        mode=mode,
        silence_s=silence,
        height_m=height,
        attitude_rad=(tilt, 0.0, 0.0),
        position_m=None,
        voltage_v=None,
    )
    assert refusals(level, wild, GATE) == ()


@pytest.mark.parametrize(
    ("change", "passes"),
    [
        ({"throttle": GATE.stop_throttle[0]}, True),
        ({"throttle": GATE.stop_throttle[0] - JUST}, False),
        ({"throttle": GATE.stop_throttle[1]}, True),
        ({"throttle": GATE.stop_throttle[1] + JUST}, False),
        ({"yaw_rate_rad_s": JUST}, False),
        ({"roll_rad": JUST}, False),
        ({"pitch_rad": -JUST}, False),
    ],
)
def test_a_release_target_is_level_without_a_yaw_rate_between_the_stopping_throttles(
    change: dict[str, float], passes: bool
) -> None:
    target = AttitudeTarget(
        0.0, **{"roll_rad": 0.0, "pitch_rad": 0.0, "yaw_rate_rad_s": 0.0, "throttle": 0.18, **change}
    )
    assert (refusals(target, replace(GOOD, armed=False), GATE) == ()) is passes


@pytest.mark.parametrize(("height_m", "inside"), [(3.0, True), (3.0 - JUST, False), (8.0, True), (8.0 + JUST, False)])
def test_the_zones_floor_and_ceiling_count_where_they_are_narrower(height_m: float, inside: bool) -> None:
    narrow = replace(GATE, zone=replace(GATE.zone, z_m=(3.0, 8.0)))
    assert (refusals(TILTED, replace(GOOD, height_m=height_m), narrow) == ()) is inside


@given(roll=angles, pitch=angles, rate=st.floats(-5.0, 5.0), throttle=st.floats(-0.2, 1.2))
def test_only_a_release_target_passes_an_unfit_vehicle(roll: float, pitch: float, rate: float, throttle: float) -> None:
    target = AttitudeTarget(0.0, roll, pitch, rate, throttle)
    unfit = replace(GOOD, mode=0, silence_s=10.0)
    assert (refusals(target, unfit, GATE) == ()) == releases(target, GATE)


@given(roll=angles, pitch=angles, rate=st.floats(-5.0, 5.0), throttle=st.floats(-0.2, 1.2))
def test_what_passes_a_resting_vehicle_is_inside_the_limits(
    roll: float, pitch: float, rate: float, throttle: float
) -> None:
    target = AttitudeTarget(0.0, roll, pitch, rate, throttle)
    if refusals(target, GOOD, GATE) == ():
        assert math.cos(roll) * math.cos(pitch) >= math.cos(LIMITS.tilt_target_max_rad) - 1e-5
        assert -1e-5 <= throttle <= 0.6 + 1e-5
        assert abs(rate) <= 3.5 + 1e-5


def test_a_step_that_looks_like_a_release_target_is_judged_in_full() -> None:
    level = AttitudeTarget(0.0, 0.0, 0.0, 0.0, 0.3)
    assert releases(level, GATE)
    assert refusals(level, GOOD, GATE, step=True) == ()
    assert refusals(level, replace(GOOD, silence_s=1.0), GATE, step=True) == (Refusal.LINK,)
    assert refusals(level, replace(GOOD, height_m=10.5), GATE, step=True) == (Refusal.HEIGHT,)


def test_a_step_whose_climb_is_not_known_is_refused() -> None:
    unknown = replace(GOOD, climb_m_s=None)
    assert refusals(TILTED, unknown, GATE, step=True) == (Refusal.HEIGHT,)
    assert refusals(TILTED, unknown, GATE) == ()
    assert refusals(TILTED, replace(GOOD, climb_m_s=math.nan), GATE, step=True) == (Refusal.HEIGHT,)


def test_a_step_is_judged_by_the_zone_wherever_the_vehicle_has_a_position() -> None:
    blind = replace(GATE, needs_position=False)
    outside = replace(GOOD, position_m=(20.0, 0.0, 5.0))
    assert refusals(TILTED, outside, blind, step=True) == (), "the zone's place is not known"
    assert refusals(TILTED, outside, replace(blind, zone_placed=True), step=True) == (Refusal.ZONE,)


def test_only_a_steps_target_is_judged_by_a_position_that_the_plan_does_not_need() -> None:
    """What brings the vehicle back from outside must pass, and what has no velocity is judged by the rest."""
    placed = replace(GATE, needs_position=False, zone_placed=True)
    outside = replace(GOOD, position_m=(20.0, 0.0, 5.0))
    assert refusals(TILTED, outside, placed) == ()
    assert refusals(TILTED, replace(outside, velocity_m_s=None), placed, step=True) == ()


@pytest.mark.parametrize("change", [{"position_ok": False}, {"position_age_s": 0.5 + JUST}])
def test_a_step_that_needs_no_position_is_not_judged_by_one_that_is_lost(change: dict[str, object]) -> None:
    placed = replace(GATE, needs_position=False, zone_placed=True)
    outside = replace(GOOD, position_m=(20.0, 0.0, 5.0))
    assert refusals(TILTED, outside, placed, step=True) == (Refusal.ZONE,)
    assert refusals(TILTED, replace(outside, **change), placed, step=True) == ()


def test_without_a_limit_of_voltage_none_needs_to_be_known() -> None:
    unlimited = replace(GATE, limits=replace(LIMITS, voltage_min_v=0.0))
    assert refusals(TILTED, replace(GOOD, voltage_v=None), unlimited) == ()


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({"position_m": (math.nan, 0.0, 5.0)}, Refusal.ZONE),
        ({"velocity_m_s": (math.nan, 0.0, 0.0)}, Refusal.SPEED),
        ({"height_m": math.nan}, Refusal.HEIGHT),
        ({"attitude_rad": (math.nan, 0.0, 0.0)}, Refusal.MEASURED_TILT),
        ({"height_m": None}, Refusal.POSITION_OLD),
    ],
)
def test_what_the_estimate_has_lost_is_refused(change: dict[str, object], refusal: Refusal) -> None:
    assert refusal in refusals(TILTED, replace(GOOD, **change), GATE)


def test_stop_throttles_stay_inside_the_script_and_leave_attitude_authority() -> None:
    assert stop_throttles(LIMITS, 0.18) == pytest.approx((0.054, 0.324))
    narrow = replace(LIMITS, throttle=(0.15, 0.2))
    assert stop_throttles(narrow, 0.18) == pytest.approx((0.15, 0.2))
    # A vehicle that hovers outside the script's range must still be able to hover when it is released.
    low, high = stop_throttles(replace(LIMITS, throttle=(0.0, 0.1)), 0.18)
    assert low <= 0.18 <= high
