"""A plan flown as predicted must pass the gate from end to end: what the plan allows, the gate must not abort."""

from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.flight.gate import GateLimits, stop_throttles, stopping_heights, zone_clearance_m
from flighttest.plan.rehearse import sampled_targets


@pytest.mark.parametrize(
    "name",
    [
        "thrust",
        "roll_pitch",
        "ground_effect",
        "throttle_levels",
        "tilt_throttle",
        "speed_dash",
        "lateral_stop",
        "reversals",
    ],
)
def test_the_gate_lets_the_plan_pass(planned, predictor, name):
    plan = planned(name)
    legs = [leg for leg in plan.legs if leg.profile]
    t = np.arange(0.0, max(leg.duration_s for leg in legs), 0.02)
    volts = np.array([leg.voltage_v or 23.0 for leg in legs])
    hover = predictor.hover_throttle(volts)
    table = np.stack([sampled_targets(leg.profile.pieces, h, t) for leg, h in zip(legs, hover, strict=True)])
    flown = predictor.fly(
        np.array([plan.vehicle.zone.to_world(leg.start_m) for leg in legs]),
        np.array([leg.heading_rad for leg in legs]),
        volts,
        lambda now: table[:, min(round(now.t_s / 0.02), t.size - 1)],
        float(t[-1]),
        0.02,
    )
    low = max(plan.limits.height_m[0], plan.vehicle.zone.z_m[0])
    high = min(plan.limits.height_m[1], plan.vehicle.zone.z_m[1])
    for j, leg in enumerate(legs):
        gate = GateLimits(plan.limits, plan.vehicle.zone, float(hover[j]), stop_throttles(plan.limits, float(hover[j])))
        for k in range(int(leg.duration_s / 0.02)):
            bottom, top = stopping_heights(table[j, k, 3], flown.p_m[j, k, 2], flown.v_m_s[j, k, 2], gate)
            assert low <= bottom, leg.id
            assert top <= high, leg.id
            state = SimpleNamespace(
                position_m=flown.p_m[j, k],
                velocity_m_s=flown.v_m_s[j, k],
                attitude_rad=flown.rpy_rad[j, k],
                position_age_s=0.02,
            )
            assert zone_clearance_m(state, gate) > 0.0, leg.id
