from dataclasses import replace

import pytest

from flighttest.frames import G_M_S2
from flighttest.plan import check, compile_plan
from flighttest.plan.check import battery_need
from flighttest.script.load import parse_script
from flighttest.script.shipped import shipped_names
from flighttest.vehicle.model import DEFAULT_VEHICLE, Zone


def test_a_spot_check_takes_under_two_minutes_in_the_air(planned):
    result = check(planned("spot_check"))
    assert result.ok
    assert result.duration_s < 120.0


@pytest.mark.parametrize("name", shipped_names())
def test_the_timeline_is_in_order_and_whole(planned, name):
    plan = planned(name)
    result = check(plan)
    starts = [row.start_s for row in result.timeline]
    assert starts == sorted(starts)
    assert len(result.timeline) == len(plan.legs)
    assert result.flying_s == pytest.approx(sum(leg.duration_s for leg in plan.legs))
    assert result.duration_s > result.flying_s
    assert {row.cell.label for row in result.envelope} == {cell.label for cell in plan.cells}


HOVER_ERROR = (
    0.005  # of the hover throttle: 0.3 % were measured (0.18 m lost in 3.5 s of hovering on the built-in vehicle)
)


@pytest.mark.parametrize("name", shipped_names())
def test_a_hover_stays_above_the_floor_with_a_throttle_that_is_a_little_low(planned, name):
    plan = planned(name)
    floor = max(plan.limits.height_m[0], plan.vehicle.zone.z_m[0])
    hovers = [leg for leg in plan.legs if [phase.name for phase in leg.phases] == ["hover"]]
    for leg in hovers:
        sunk = 0.5 * HOVER_ERROR * G_M_S2 * leg.duration_s**2
        assert leg.start_m[2] - sunk > floor, leg.id


def test_a_path_is_where_its_waypoints_are(predictor):
    """Its height was counted twice: 10 m for a path at 5 m, and 41 m of way from the start for one of 16 m."""
    flown = "free_flight: {waypoints: [[-8, 0, 5], [8, 0, 5]], speed_m_s: 2}"
    script = parse_script(f"format: maneuver/1\nname: path\nsteps:\n  - {flown}\n")
    vehicle = replace(DEFAULT_VEHICLE, zone=Zone(x_m=(-30, 30), y_m=(-30, 30), z_m=(1, 12)))
    (row,) = check(compile_plan(script, vehicle, predictor)).envelope
    assert row.height_m == pytest.approx((5.0, 5.0), abs=0.3)
    assert row.far_m == pytest.approx(16.0, abs=1.0)
    assert row.lost_height_m[1] < 12.0
    script = parse_script(f"format: maneuver/1\nname: path\nsteps:\n  - {flown.replace('2}', '9}')}\n")
    (refused,) = compile_plan(script, vehicle, predictor).refusals
    assert "its pace of 9 m/s is above speed_max_m_s 8" in refused[1]


def test_a_home_outside_of_the_zone_is_reported(predictor):
    script = parse_script("format: maneuver/1\nname: rest\nreset: {to: [30, 0, 5]}\nsteps:\n  - rest\n")
    for x_m, noted in (((20.0, 50.0), True), ((-20.0, 50.0), False)):
        vehicle = replace(DEFAULT_VEHICLE, zone=Zone(x_m=x_m))
        assert any("is 20 m outside" in note for note in compile_plan(script, vehicle, predictor).notes) is noted


@pytest.mark.parametrize(("top_m", "asked_m", "climbs_m"), [(4.0, 5, 3.5), (15.0, 25, 10), (15.0, 1, 2), (15.0, 5, 5)])
def test_the_take_off_stays_inside_the_zone_and_the_scripts_heights(predictor, top_m, asked_m, climbs_m):
    """A take-off to 5 m in a zone of 4 m was flown, and `check` said that all steps stay in the zone, which was true of the steps."""
    vehicle = replace(DEFAULT_VEHICLE, zone=replace(DEFAULT_VEHICLE.zone, z_m=(0.5, top_m), margin_m=0.5))
    head = f"reset: {{to: [0, 0, {asked_m}]}}\n"
    step = "steps:\n  - attitude_step: {axis: roll, amplitude_rad: [0.1], sign: both, hold_s: 0.5}\n"
    plan = compile_plan(parse_script(f"format: maneuver/1\nname: t\n{head}{step}"), vehicle, predictor)
    assert plan.reset.to_m == (0.0, 0.0, climbs_m)
    assert any(f"takes off to {climbs_m:g} m" in note for note in check(plan).notes) is (asked_m != climbs_m)


def test_yaw_says_left_and_right(planned):
    directions = {row.leg.split("/")[1]: row.direction for row in check(planned("yaw_rate")).timeline}
    assert directions["yaw+1.00"] == "left"
    assert directions["yaw-2.00"] == "right"


def test_the_envelope_with_the_link_lost_holds_the_planned_one(planned):
    for row in check(planned("thrust")).envelope:
        assert row.lost_height_m[1] >= row.height_m[1] - 0.3
        assert row.lost_height_m[0] <= row.height_m[0] + 0.3


@pytest.mark.parametrize(
    ("fields", "capacity"),
    [
        ({"model": "6S 10 Ah"}, 222.0),
        ({"model": "4S 5200mAh 30C"}, 115.4),
        ({"specifications.capacity_mah": 8000}, 177.6),
        ({"capacity_ah": 16}, 355.2),
        ({"id": "B07"}, None),
    ],
)
def test_battery_capacity_in_the_words_people_use(fields, capacity):
    need = battery_need(replace(DEFAULT_VEHICLE, components={"battery": fields}), 600.0)
    assert need.capacity_wh == (None if capacity is None else pytest.approx(capacity, abs=0.1))


def test_packs_follow_from_energy():
    need = battery_need(DEFAULT_VEHICLE, 3600.0)
    assert need.energy_wh == pytest.approx(170.0 * 2.9)
    assert need.packs == 3
    assert battery_need(replace(DEFAULT_VEHICLE, mass_kg=None), 600.0).energy_wh is None
