"""A vehicle unlike its prior: what its thrust is like is seen in flight, and the rest of the script is planned for it."""

from pathlib import Path

import numpy as np
import pytest

from flighttest.flight import FlightOutcome, LegOutcome
from flighttest.flight.execution.leg_order import REFUSED_CELL_MAX
from flighttest.flight.execution.response import Learnt, ThrottleTrace, ThrustSeen, hover_off, learnt
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
repeat: {each: 1, order: sequential}
"""


def trace_of(
    age_s: float,
    lag_s: float,
    damping_1_s: float,
    tilt_rad: float = 0.0,
    step: float = 0.3,
    curvature: float = 0.0,
    noise_m_s: float = 0.0,
) -> ThrottleTrace:
    """Throttle 0.1 for 0.4 s, then a step, on a vehicle that hovers at 0.18, heard at 50 Hz with so much noise of the climb rate."""
    trace, dt = ThrottleTrace(0.18, angle_boost=True), 0.001
    climb = height = thrust = 0.0
    throttles = {k: 0.1 if k * dt < 0.4 else step for k in range(1200)}
    for k in range(1200):
        asked = throttles.get(k - round((age_s - lag_s) / dt), 0.18)
        wanted = asked / 0.18 * (1.0 + curvature * (asked / 0.18 - 1.0)) - 1.0
        thrust += dt / lag_s * (wanted - thrust) if lag_s else wanted - thrust
        climb += dt * (9.81 * thrust - damping_1_s * climb)
        height += dt * climb
        if k % 20 == 0:
            trace.sent(k * dt, AttitudeTarget(k * dt, tilt_rad, 0.0, 0.0, throttles[k]))
            trace.seen(k * dt, climb + noise_m_s * (-1) ** (k // 20), 5.0 + height)
    return trace


@pytest.mark.parametrize(("age", "lag"), [(0.149, 0.049), (0.02, 0.02), (0.25, 0.05)])
def test_the_age_of_thrust_is_seen_through_drag(age: float, lag: float) -> None:
    for damping in (0.0, 0.5):
        assert trace_of(age, lag, damping).thrust().age_s == pytest.approx(age, abs=0.02)


def test_a_tilted_leg_shows_the_age_by_what_acts_upwards() -> None:
    assert trace_of(0.06, 0.05, 0.5, tilt_rad=0.35).thrust().age_s == pytest.approx(0.06, abs=0.02)
    bare, boosted = trace_of(0.06, 0.05, 0.5, tilt_rad=0.35), trace_of(0.06, 0.05, 0.5, tilt_rad=0.35)
    bare.angle_boost = False
    for t_s, _ in boosted._sent:
        bare.sent(t_s, AttitudeTarget(t_s, 0.35, 0.0, 0.0, 0.3))
    assert bare._sent[-1][1] == pytest.approx(0.3 * np.cos(0.35))


@pytest.mark.parametrize("curvature", [-0.2, 0.0, 0.25, 0.6])
def test_how_thrust_grows_with_throttle_is_seen_through_drag(curvature: float) -> None:
    seen = trace_of(0.08, 0.05, 0.5, curvature=curvature).thrust()
    assert seen is not None
    assert seen.curvature == pytest.approx(curvature, abs=0.05)
    tilted = trace_of(0.08, 0.05, 0.5, curvature=curvature, tilt_rad=0.35).thrust()
    assert tilted is not None
    assert not tilted.weight


def test_a_leg_that_fits_better_than_climb_rates_are_heard_is_not_trusted_more() -> None:
    clean, noisy = (trace_of(0.08, 0.0, 0.5, noise_m_s=noise).thrust() for noise in (0.0, 0.02))
    assert clean is not None
    assert noisy is not None
    assert clean.weight / noisy.weight == pytest.approx(2.0, rel=0.2)


def test_a_leg_that_shows_the_curvature_better_counts_more() -> None:
    good, poor = ThrustSeen(0.05, 0.3, 400.0), ThrustSeen(0.07, -0.5, 4.0)
    both = learnt(0.18, 24.0, [good, poor])
    assert both.curvature == pytest.approx((400 * 0.3 - 4 * 0.5) / 404)
    assert both.thrust_age_s == pytest.approx(0.06)
    assert "29 % more of it at twice that throttle" in both.words
    assert "less" in Learnt(0.18, 24.0, 0.05, -0.1).words
    assert learnt(0.18, 24.0, []) == Learnt(0.18, 24.0)


def test_a_plan_follows_how_thrust_grows_with_throttle() -> None:
    prior = predictor_for(None, DEFAULT_VEHICLE)
    plan = compile_plan(parse_script(SCRIPT.replace("0.25, 0.40", "0.30, 0.35")), DEFAULT_VEHICLE, prior)
    replanner = ScriptReplanner(plan, prior)
    as_assumed = float(prior.hover_throttle(np.array([24.0]))[0])
    own = prior.curvature(24.0)
    assert own == pytest.approx(0.0, abs=0.05)
    assert not replanner.due(Learnt(as_assumed, 24.0, None, own + 0.025))
    assert replanner.due(Learnt(as_assumed, 24.0, None, own + 0.035)), "four of 26 steps are refused at 0.04"
    seen = Learnt(as_assumed, 24.0, None, own + 0.25)
    assert replanner.due(seen)
    new = replanner.plan(seen)
    assert not replanner.due(seen), "the corrected prior is compared with from now on"
    record = {c.label: dict(c.held_s)["step"] for c in plan.cells}
    assert all(dict(c.held_s)["step"] < record[c.label] for c in new.cells), "a stronger climb is held shorter"


@pytest.mark.parametrize("voltage", [21.0, 22.2, 25.0])
def test_a_corrected_prior_shows_the_curvature_and_the_hover_that_were_seen(voltage: float) -> None:
    prior = predictor_for(None, DEFAULT_VEHICLE)
    hover, own = 1.05 * float(prior.hover_throttle(np.array([voltage]))[0]), prior.curvature(voltage)
    once = prior.corrected(hover, voltage, None, 0.25)
    assert once.curvature(voltage) == pytest.approx(own + 0.25, abs=0.02)
    assert once.hover_throttle(np.array([voltage]))[0] == pytest.approx(hover, rel=1e-6)
    back = once.corrected(hover, voltage, None, -0.25)
    assert back.values["curvature"] == pytest.approx(0.0, abs=1e-9)
    assert back.values["K"] == pytest.approx(prior.corrected(hover, voltage).values["K"])


@pytest.mark.slow
def test_a_vehicle_whose_thrust_grows_faster_than_its_throttle_is_flown_to_the_end(run_dir: Path) -> None:
    curved = options(hide={"throttle_curve": {"curvature": 0.25}})
    prior = predictor_for(None, DEFAULT_VEHICLE)
    plan = compile_plan(parse_script(SCRIPT.replace("0.25, 0.40", "0.22, 0.30")), DEFAULT_VEHICLE, prior)
    blind = fly(plan, "sim", run_dir.with_name("blind"), transport=FaultyLink(curved))
    assert blind.outcome is FlightOutcome.ABORTED_BY_GATE

    result = fly(plan, "sim", run_dir, transport=FaultyLink(curved), replanner=ScriptReplanner(plan, prior))
    assert result.outcome is FlightOutcome.COMPLETED
    assert {r.leg for r in result.legs if r.outcome is LegOutcome.FLOWN} == {leg.id for leg in plan.legs}
    assert any("more of it at twice that throttle" in note for note in result.notes)


def test_what_cannot_tell_an_age_gives_none() -> None:
    assert trace_of(0.1, 0.05, 0.5, tilt_rad=0.5).thrust() is None
    assert ThrottleTrace(0.18).thrust() is None
    even = ThrottleTrace(0.18)
    for k in range(60):
        even.sent(0.02 * k, AttitudeTarget(0.0, 0.0, 0.0, 0.0, 0.185))
        even.seen(0.02 * k, 0.01 * k, 5.0)
    assert even.thrust() is None
    gust = trace_of(0.1, 0.05, 0.5)
    gust._seen = [(t, v + np.sin(9.0 * t), h) for t, v, h in gust._seen]
    assert gust.thrust() is None


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


@pytest.mark.slow
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


@pytest.mark.slow
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
