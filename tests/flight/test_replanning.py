"""A vehicle unlike its prior: what its thrust is like is seen in flight, and the rest of the script is planned for it."""

from pathlib import Path

import numpy as np
import pytest

from flighttest.flight import FlightOutcome, LegOutcome
from flighttest.flight.execution.leg_order import REFUSED_CELL_MAX
from flighttest.flight.execution.response import Learnt, ThrottleTrace, hover_off
from flighttest.pipeline.planning.checking import predictor_for
from flighttest.pipeline.planning.predictor import ScriptReplanner
from flighttest.plan import AttitudeTarget
from flighttest.plan.compile import compile_plan
from flighttest.recording.store import open_run
from flighttest.script.load import parse_script
from flighttest.vehicle.model import DEFAULT_VEHICLE
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options

SCRIPT = """format: maneuver/1
name: climbs
doc: two soft climbs and two hard ones
identifies: [sigma_t]
mode: GUIDED_NOGPS
rate_hz: 50
limits: {tilt_target_max_deg: 35, tilt_abort_deg: 50, throttle: [0.0, 0.6], height_m: [2, 10], speed_max_m_s: 8}
reset: {to: [0, 0, 5], by: guided, settle_s: 1}
steps:
  - throttle_pair: {throttle_0: [0.10, 0.15], throttle_1: [0.25, 0.40], hold_0_s: {up_to: 0.6}, record_1_s: {up_to: 1.5}}
repeat: {each: 2, order: sequential}
"""


def trace_of(age_s: float, lag_s: float, damping_1_s: float, tilt_rad: float = 0.0, step: float = 0.3) -> ThrottleTrace:
    """Throttle 0.1 for 0.4 s, then a step, on a vehicle that hovers at 0.18, heard at 50 Hz."""
    trace, dt = ThrottleTrace(0.18, angle_boost=True), 0.001
    climb = height = thrust = 0.0
    throttles = {k: 0.1 if k * dt < 0.4 else step for k in range(1200)}
    for k in range(1200):
        asked = throttles.get(k - round((age_s - lag_s) / dt), 0.18)
        thrust += dt / lag_s * (asked / 0.18 - 1.0 - thrust) if lag_s else asked / 0.18 - 1.0 - thrust
        climb += dt * (9.81 * thrust - damping_1_s * climb)
        height += dt * climb
        if k % 20 == 0:
            trace.sent(k * dt, AttitudeTarget(k * dt, tilt_rad, 0.0, 0.0, throttles[k]))
            trace.seen(k * dt, climb, 5.0 + height)
    return trace


@pytest.mark.parametrize(("age", "lag"), [(0.149, 0.049), (0.02, 0.02), (0.25, 0.05)])
def test_the_age_of_thrust_is_seen_through_drag(age: float, lag: float) -> None:
    for damping in (0.0, 0.5):
        assert trace_of(age, lag, damping).age_s() == pytest.approx(age, abs=0.02)


def test_a_tilted_leg_shows_the_age_by_what_acts_upwards() -> None:
    assert trace_of(0.06, 0.05, 0.5, tilt_rad=0.35).age_s() == pytest.approx(0.06, abs=0.02)
    bare, boosted = trace_of(0.06, 0.05, 0.5, tilt_rad=0.35), trace_of(0.06, 0.05, 0.5, tilt_rad=0.35)
    bare.angle_boost = False
    for t_s, _ in boosted._sent:
        bare.sent(t_s, AttitudeTarget(t_s, 0.35, 0.0, 0.0, 0.3))
    assert bare._sent[-1][1] == pytest.approx(0.3 * np.cos(0.35))


def test_what_cannot_tell_an_age_gives_none() -> None:
    assert trace_of(0.1, 0.05, 0.5, tilt_rad=0.5).age_s() is None
    assert ThrottleTrace(0.18).age_s() is None
    even = ThrottleTrace(0.18)
    for k in range(60):
        even.sent(0.02 * k, AttitudeTarget(0.0, 0.0, 0.0, 0.0, 0.185))
        even.seen(0.02 * k, 0.01 * k, 5.0)
    assert even.age_s() is None
    gust = trace_of(0.1, 0.05, 0.5)
    gust._seen = [(t, v + np.sin(9.0 * t), h) for t, v, h in gust._seen]
    assert gust.age_s() is None


def test_a_plan_follows_what_was_learnt() -> None:
    prior = predictor_for(None, DEFAULT_VEHICLE)
    plan = compile_plan(parse_script(SCRIPT), DEFAULT_VEHICLE, prior)
    replanner = ScriptReplanner(plan, prior)
    as_assumed = float(prior.hover_throttle(np.array([24.0]))[0])
    assert not replanner.due(Learnt(1.01 * as_assumed, 24.0, prior.thrust_age_s - 0.01))
    quick = Learnt(0.9 * as_assumed, 24.0, 0.01)
    assert replanner.due(quick)
    new = replanner.plan(quick)
    assert not replanner.due(quick), "the corrected prior is compared with from now on"
    assert {leg.id for leg in new.legs} == {leg.id for leg in plan.legs}
    assert new.reaction_s < plan.reaction_s
    record = {c.label: dict(c.held_s)["step"] for c in plan.cells}
    assert all(dict(c.held_s)["step"] < record[c.label] for c in new.cells), "a quicker, stronger climb is held shorter"


def test_a_quicker_vehicle_than_assumed_is_flown_to_the_end(run_dir: Path) -> None:
    quick = {"T_d": 0.005, "sigma_t": 90.0, "K": 56.0}
    prior = predictor_for(None, DEFAULT_VEHICLE)
    plan = compile_plan(parse_script(SCRIPT), DEFAULT_VEHICLE, prior)
    blind = fly(plan, "sim", run_dir.with_name("blind"), transport=FaultyLink(options(vehicle=quick)))
    assert LegOutcome.REFUSED in [r.outcome for r in blind.legs], "the prior alone does not fit this vehicle"

    link = FaultyLink(options(vehicle=quick))
    result = fly(plan, "sim", run_dir, transport=link, replanner=ScriptReplanner(plan, prior))
    assert result.outcome is FlightOutcome.COMPLETED
    flown = [r.leg for r in result.legs if r.outcome is LegOutcome.FLOWN]
    assert set(flown) == {leg.id for leg in plan.legs}
    assert any("planned again" in note for note in result.notes)
    heights = open_run(run_dir).channel("p_z_m")[1]
    assert np.nanmax(heights) < 10.0


def test_after_an_abort_the_vehicle_stops_before_it_goes_on(run_dir: Path) -> None:
    link = FaultyLink(options())
    speeds: list[tuple[float, float]] = []

    def look(message: object, _t_s: float) -> None:
        if message.get_type() == "COMMAND_LONG" and message.command == 176:  # type: ignore[attr-defined]
            m = link.sim.vehicle.motion
            speeds.append((message.param2, float(np.linalg.norm([m.vx, m.vy, m.vz]))))  # type: ignore[attr-defined]

    link.hook = look
    climb = make_leg("up", lambda t: AttitudeTarget(t, 0.0, 0.0, 0.0, 0.17 if t < 0.3 else 0.4), 2.5, "throttle_step")
    result = fly(make_plan(climb), "sim", run_dir, transport=link)
    assert result.legs[0].outcome is LegOutcome.REFUSED
    brake = [i for i, (mode, speed) in enumerate(speeds) if mode == 17 and speed > 2.0]
    assert brake, "the abort was asked for while it climbed"
    assert next(speed for mode, speed in speeds[brake[0] :] if mode != 17) < 0.5


def test_a_leg_that_the_weather_may_have_spoilt_is_tried_once_more_at_the_end(run_dir: Path) -> None:
    times: list[int] = []

    def once(t_s: float) -> AttitudeTarget:
        if t_s < 0.01:
            times.append(1)
        return AttitudeTarget(t_s, 0.0, 0.0, 0.0, 0.17 if t_s < 0.3 or len(times) > 1 else 0.4)

    result = fly(
        make_plan(make_leg("a", once, 2.5, "throttle_step"), make_leg("b")),
        "sim",
        run_dir,
        transport=FaultyLink(options()),
    )
    assert [(r.leg, r.outcome) for r in result.legs] == [
        ("test/a/r1", LegOutcome.REFUSED),
        ("test/b/r1", LegOutcome.FLOWN),
        ("test/a/r1", LegOutcome.FLOWN),
    ]
    assert REFUSED_CELL_MAX == 2


def test_who_gave_no_vehicle_file_is_not_asked_to_correct_it():
    assert hover_off(0.21, 0.18, "hexa.yaml").endswith("0.180 in hexa.yaml: more than 10 % off; correct it there")
    assert "assumed 0.180" in hover_off(0.21, 0.18, "")
    assert "--vehicle" in hover_off(0.21, 0.18, "")
