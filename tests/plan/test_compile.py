import math
from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import ScriptError
from flighttest.plan import compile_plan
from flighttest.plan.rehearse import sampled_targets
from flighttest.script.load import load_script, parse_script
from flighttest.script.shipped import resolve, shipped_names
from flighttest.vehicle.model import DEFAULT_VEHICLE, Zone


@pytest.mark.parametrize("name", shipped_names())
def test_every_shipped_script_fits_the_papers_zone(planned, name):
    plan = planned(name)
    assert plan.refusals == ()
    assert plan.legs
    assert all(len(leg.id) <= 42 for leg in plan.legs)  # a mark is a prefix and the id in 50 characters
    assert len({leg.id for leg in plan.legs}) == len(plan.legs)


def test_the_campaign_has_the_papers_responses(planned):
    assert len(planned("thrust").legs) == 72
    assert len({tuple(leg.cell.items()) for leg in planned("thrust").legs}) == 18
    assert len(planned("roll_pitch").legs) == 36
    assert len(planned("yaw_rate").legs) == 8
    assert {leg.kind for leg in planned("roll_pitch").legs} == {"roll_step", "pitch_step"}


def test_thrust_legs_keep_a_useful_record_and_their_heights(planned, predictor):
    for cell in planned("thrust").cells:
        assert cell.useful_s >= 0.3 - 1e-9
        assert cell.start_m[2] + cell.low_m[2] >= 2.5 - 1e-3
        assert cell.start_m[2] + cell.high_m[2] <= 8.5 + 1e-3
        assert cell.start_m[2] + cell.lost_low_m[2] >= 1.0 - 1e-3
        assert cell.start_m[2] + cell.lost_high_m[2] <= 10.0 + 1e-3
        assert cell.speed_m_s <= 8.0


def test_stop_phases_leave_the_vehicle_standing(planned, predictor):
    legs = [leg for leg in planned("thrust").legs if leg.repeat == 2]
    t = np.arange(0.0, 6.0, 0.02)
    tables = np.stack([sampled_targets(leg.profile.pieces, leg.profile.hover_throttle, t) for leg in legs])
    flown = predictor.fly(
        np.zeros((len(legs), 3)),
        np.zeros(len(legs)),
        np.array([leg.voltage_v for leg in legs]),
        lambda now: tables[:, min(round(now.t_s / 0.02), t.size - 1)],
        5.0,
        0.02,
    )
    # Whatever speed the step gave (up to 6 m/s) is gone when the leg ends.
    for j, leg in enumerate(legs):
        assert abs(flown.v_m_s[j, round(leg.duration_s / 0.02), 2]) < 0.7, leg.id


def test_order_is_interleaved_and_battery_not_collinear_with_the_step(planned):
    legs = planned("thrust").legs
    assert [leg.repeat for leg in legs] == sorted(leg.repeat for leg in legs)
    voltage = np.array([leg.voltage_v for leg in legs])
    assert voltage[0] == pytest.approx(24.5)
    assert voltage[-1] == pytest.approx(21.5)
    for key in ("throttle_0", "throttle_1"):
        assert abs(np.corrcoef(voltage, [leg.cell[key] for leg in legs])[0, 1]) < 0.2
    spread = defaultdict(list)
    for leg in legs:
        spread[tuple(leg.cell.values())].append(leg.voltage_v)
    assert min(max(v) - min(v) for v in spread.values()) > 1.5


def test_headings_rotate_over_the_repeats(planned):
    by_cell = defaultdict(set)
    for leg in planned("headings").legs:
        if not leg.motors_off:
            by_cell[leg.id.split("/")[1]].add(round(math.degrees(leg.heading_rad)))
    assert all(len(headings) == 4 for headings in by_cell.values())
    counts = Counter(round(math.degrees(leg.heading_rad)) for leg in planned("thrust").legs)
    assert len(counts) == 4
    assert max(counts.values()) - min(counts.values()) <= 2


def test_a_long_step_turns_to_the_long_axis(plan_of):
    for axis, along in (("roll", (90, 270)), ("pitch", (0, 180))):
        plan = plan_of(
            f"attitude_step: {{axis: {axis}, amplitude_rad: 0.5, sign: positive}}", repeat="repeat: {each: 4}"
        )
        assert not plan.refusals
        assert {round(math.degrees(leg.heading_rad)) % 360 for leg in plan.legs} <= set(along)


def test_a_plan_is_a_pure_function(predictor, planned):
    again = compile_plan(load_script(resolve("thrust")), DEFAULT_VEHICLE, predictor)
    assert [leg.id for leg in again.legs] == [leg.id for leg in planned("thrust").legs]
    a, b = again.legs[5], planned("thrust").legs[5]
    assert [a.profile(t) for t in (0.0, 0.3, 0.7, 1.1, 9.0)] == [b.profile(t) for t in (0.0, 0.3, 0.7, 1.1, 9.0)]


def test_the_step_starts_when_the_leg_says(planned):
    leg = planned("thrust").legs[0]
    before, after = leg.profile(leg.t_step_s - 0.01), leg.profile(leg.t_step_s)
    assert before.throttle == pytest.approx(leg.cell["throttle_0"])
    assert after.throttle == pytest.approx(leg.cell["throttle_1"])
    assert next(phase for phase in leg.phases if phase.record).start_s == pytest.approx(leg.t_step_s)
    assert leg.phases[-1].end_s == pytest.approx(leg.duration_s)


def test_level_flight_follows_the_measured_hover_throttle_and_the_boost(planned):
    leg = next(leg for leg in planned("roll_pitch").legs if leg.cell["amplitude_rad"] == 0.5)
    t = leg.t_step_s + 0.1
    assert leg.flown_with(0.2, False).profile(t).throttle == pytest.approx(0.2 / math.cos(0.5))
    assert leg.flown_with(0.2, True).profile(t).throttle == pytest.approx(0.2)
    thrust = planned("thrust").legs[0]
    assert thrust.flown_with(0.3, True).profile(thrust.t_step_s).throttle == thrust.cell["throttle_1"]


def test_throttle_in_units_of_hover(plan_of):
    vehicle = replace(DEFAULT_VEHICLE, hover_throttle=0.4)
    plan = plan_of("throttle_pair: {throttle_0: 0.5, throttle_1: 1.5}", vehicle, head="throttle_unit: hover")
    assert plan.cells[0].label == "0.50-1.50"
    assert plan.legs == () or plan.legs[0].cell == pytest.approx({"throttle_0": 0.2, "throttle_1": 0.6})


def test_a_step_that_leaves_the_zone_is_refused_with_a_duration_that_fits(plan_of):
    plan = plan_of("attitude_step: {axis: pitch, amplitude_rad: 0.5, sign: positive, hold_s: 3.0}")
    assert plan.legs == ()
    # It is too fast as well: both are said.
    assert any("9.1 m/s" in sentence for _, sentence, _ in plan.refusals)
    leg, sentence, remedy = plan.refusals[-1]
    assert leg == "t/pitch+0.50/r1"
    assert "leaves the zone by" in sentence
    assert " m " in sentence
    assert " s" in sentence
    fits = float(remedy.split()[0])
    assert 0.3 <= fits < 3.0
    shorter = plan_of(f"attitude_step: {{axis: pitch, amplitude_rad: 0.5, sign: positive, hold_s: {fits}}}")
    assert not shorter.refusals


def test_a_height_that_does_not_fit_is_refused_with_one_that_does(plan_of):
    plan = plan_of("throttle_pair: {throttle_0: 0.18, throttle_1: 0.25, hold_0_s: 0.3, record_1_s: 0.6, height_m: 8}")
    assert "above the ceiling" in plan.refusals[0][1]
    height = float(plan.refusals[0][2].split()[1])
    again = plan_of(
        f"throttle_pair: {{throttle_0: 0.18, throttle_1: 0.25, hold_0_s: 0.3, record_1_s: 0.6, height_m: {height}}}"
    )
    assert not again.refusals


def test_a_lost_link_alone_is_reason_enough(plan_of):
    # The height holds the step itself, but not what follows when it is not stopped.
    low = replace(DEFAULT_VEHICLE, zone=Zone(z_m=(1.0, 6.5), margin_m=1.0))
    plan = plan_of("throttle_pair: {throttle_0: 0.15, throttle_1: 0.35, hold_0_s: 0.3, record_1_s: 0.42}", low)
    assert plan.refusals
    assert "with the link lost at the worst moment" in plan.refusals[0][1]


def test_a_record_of_nothing_is_refused(plan_of):
    plan = plan_of("throttle_pair: {throttle_0: 0.15, throttle_1: 0.25, hold_0_s: 0.3, record_1_s: 0.35}")
    assert "after the delay" in plan.refusals[0][1]


def test_a_throttle_limit_below_hover_is_refused(plan_of):
    plan = plan_of("attitude_step: {axis: pitch, amplitude_rad: 0.2}", head="limits: {throttle: [0, 0.17]}")
    assert "asks for throttle 0.2" in plan.refusals[0][1]  # what an empty battery needs to hover


def test_what_only_a_fence_contains_is_said(plan_of):
    narrow = replace(DEFAULT_VEHICLE, zone=Zone(x_m=(-4.0, 4.0), y_m=(-4.0, 4.0)))
    step = "attitude_step: {axis: roll, amplitude_rad: 0.3, sign: positive}"
    assert any("fence has to stop" in note for note in plan_of(step, narrow).notes)
    assert not any("fence" in note for note in plan_of(step).notes)


def test_speed_limit_is_kept(plan_of):
    head = "limits: {speed_max_m_s: 2}"
    plan = plan_of("attitude_step: {axis: pitch, amplitude_rad: 0.5, sign: positive}", head=head)
    assert "speed_max_m_s" in plan.refusals[0][1]


def test_waypoints_outside_are_refused(plan_of):
    plan = plan_of("free_flight: {waypoints: [[0, 0, 4], [20, 0, 4]], speed_m_s: 3}")
    assert "leaves the zone" in plan.refusals[0][1]
    assert "waypoints" in plan.refusals[0][2]


def test_a_floor_of_its_own(planned):
    plan = planned("ground_effect")
    assert plan.vehicle.zone.z_m[0] == pytest.approx(0.4)
    assert min(leg.start_m[2] for leg in plan.legs) < 0.8
    step = next(c for c in plan.cells if c.label == "1.00-1.20@0.7m")
    assert step.start_m[2] == pytest.approx(0.7, abs=0.1)


def test_rest_comes_before_take_off(planned):
    legs = planned("hover_rest").legs
    off = [leg.motors_off for leg in legs]
    assert off == sorted(off, reverse=True)
    assert legs[0].profile is None


def test_lowest_voltage_from_the_vehicle(planned, predictor):
    assert planned("thrust").limits.voltage_min_v == 21.0
    four_cells = replace(DEFAULT_VEHICLE, nominal_voltage_v=14.8)
    plan = compile_plan(load_script(resolve("yaw_rate")), four_cells, predictor)
    assert plan.limits.voltage_min_v == pytest.approx(0.945 * 14.8)


def test_bad_scripts_never_reach_the_planner():
    with pytest.raises(ScriptError):
        load_script(resolve("no_such_maneuver"))


def test_headings_and_places_are_in_the_zones_frame(plan_of):
    turned = replace(DEFAULT_VEHICLE, zone=replace(DEFAULT_VEHICLE.zone, heading_rad=-math.radians(40.0)))
    step = "attitude_step: {axis: pitch, amplitude_rad: 0.5, sign: positive}"
    head = "reset: {heading_deg: [0, 180]}"
    (straight,), (leg,) = plan_of(step, head=head).legs, plan_of(step, turned, head=head).legs
    assert leg.start_m == straight.start_m
    assert leg.heading_rad == pytest.approx(straight.heading_rad - math.radians(40.0))


ONE_TIGHT_STEP = """
format: maneuver/1
name: tight
doc: a step for which this ceiling and floor leave a narrow range of holds
mode: GUIDED_NOGPS
rate_hz: 50
throttle_unit: hover
limits: {tilt_target_max_deg: 35, tilt_abort_deg: 50, throttle: [0.0, 0.9], height_m: [2, 10], speed_max_m_s: 8}
reset: {to: [0, 0, 5], heading_deg: [0], by: guided, settle_s: 2}
steps:
  - throttle_pair: {throttle_0: 0.83, throttle_1: 2.22, hold_0_s: {up_to: 0.6}, record_1_s: {up_to: 1.5}}
repeat: {each: 1, order: interleaved}
"""


def test_a_hold_between_the_first_tries_is_found_where_none_of_them_fits(predictor):
    vehicle = replace(DEFAULT_VEHICLE, zone=Zone(x_m=(-30, 30), y_m=(-30, 30), z_m=(1, 30), margin_m=2.0))
    plan = compile_plan(parse_script(ONE_TIGHT_STEP), vehicle, predictor)
    assert plan.refusals == ()
    assert plan.cells[0].start_m[2] + plan.cells[0].low_m[2] >= 3.0 - 1e-3
    assert plan.cells[0].start_m[2] + plan.cells[0].high_m[2] <= 10.0 + 1e-3
