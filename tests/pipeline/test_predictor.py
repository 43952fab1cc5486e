"""The prior model flown for `plan`: hovers, and follows what can be worked out by hand."""

import math

import numpy as np
import pytest

from flighttest.physics.model import Model
from flighttest.pipeline.planning.predictor import ModelPredictor
from flighttest.plan.model import PredictedMotion


@pytest.fixture(scope="module")
def predictor():
    return ModelPredictor()


def level(throttle):
    return lambda now: np.tile([0.0, 0.0, 0.0, throttle], (len(now.p_m), 1))


def test_hover_throttle_hovers(predictor):
    volts = np.array([22.2, 24.5])
    hover = predictor.hover_throttle(volts)
    assert hover[0] == pytest.approx(9.81 / 54.55, rel=1e-6)
    motion = predictor.fly(
        np.array([[0, 0, 5.0], [1, 2, 3.0]]),
        np.zeros(2),
        volts,
        lambda now: np.column_stack([np.zeros((2, 3)), hover]),
        3.0,
        0.02,
    )
    assert np.abs(motion.p_m[:, -1] - [[0, 0, 5.0], [1, 2, 3.0]]).max() < 1e-6


def test_full_throttle_step_has_the_delay_and_climbs_as_worked_out(predictor):
    motion = predictor.fly(np.array([[0, 0, 5.0]]), np.zeros(1), np.array([22.2]), level(0.30), 0.6, 0.02)
    early = motion.t_s <= predictor.delay_s
    assert np.abs(motion.v_m_s[0, early, 2]).max() < 1e-9
    # After delay and lag the climb gains a = K T - g, less a little drag: v = a (t - delay - 1/sigma).
    a = 54.55 * 0.30 - 9.81
    expected = a * (0.6 - 0.1 - 1 / 20.36)
    assert motion.v_m_s[0, -1, 2] == pytest.approx(expected, rel=0.12)


def test_pitch_forward_goes_where_the_nose_points(predictor):
    yaw = np.array([0.0, math.pi / 2])
    hover = float(predictor.hover_throttle(np.array([22.2]))[0])
    policy = lambda now: np.tile([0.0, 0.3, 0.0, hover / math.cos(0.3)], (2, 1))  # noqa: E731
    motion = predictor.fly(np.tile([0, 0, 5.0], (2, 1)), yaw, np.array([22.2, 22.2]), policy, 1.0, 0.02)
    assert motion.p_m[0, -1, 0] > 0.8
    assert abs(motion.p_m[0, -1, 1]) < 0.01
    assert motion.p_m[1, -1, 1] == pytest.approx(motion.p_m[0, -1, 0], rel=1e-6)


def test_lags_are_those_of_the_paper(predictor):
    assert predictor.delay_s == pytest.approx(0.1)
    assert predictor.thrust_lag_s == pytest.approx(1 / 20.36)
    assert predictor.attitude_lag_s == pytest.approx(2 * 0.44 / 25.43)


def test_a_flight_straight_up_and_down_is_computed_briefly_and_the_same():
    predictor = ModelPredictor()
    assert predictor.forms.level is not None
    start, yaw, volts = np.zeros((2, 3)), np.array([0.0, 1.0]), np.array([24.0, 22.0])

    def steer(tilt_rad: float, from_s: float) -> PredictedMotion:
        def policy(now):
            targets = np.zeros((2, 4))
            targets[:, 3] = 0.25 if now.t_s < 0.5 else 0.1
            targets[:, 0] = tilt_rad if now.t_s >= from_s else 0.0
            return targets

        return predictor.fly(start, yaw, volts, policy, 1.2, 0.04)

    level = steer(0.0, 0.0)
    # A tilt too small to matter, from the first moment on, takes the long way.
    full = steer(1e-12, 0.0)
    np.testing.assert_allclose(level.p_m, full.p_m, atol=1e-9)
    np.testing.assert_allclose(level.v_m_s, full.v_m_s, atol=1e-9)
    turned = steer(0.3, 0.6)
    assert np.abs(turned.p_m[:, :, :2]).max() > 0.05, "what tilts later is not taken for level"


def test_in_wind_nothing_is_taken_for_straight():
    model = Model().with_terms("steady_wind")
    windy = ModelPredictor(model, {"w_north": 3.0})
    assert windy.forms.level is None


def test_a_corrected_prior_hovers_where_it_was_seen_to():
    prior = ModelPredictor()
    for hover, age in ((0.2, None), (0.15, 0.01), (0.16, 0.2)):
        found = prior.corrected(hover, 23.5, age)
        assert found.hover_throttle(np.array([23.5]))[0] == pytest.approx(hover)
        assert found.thrust_age_s == pytest.approx(prior.thrust_age_s if age is None else max(age, 0.025))
    assert prior.corrected(0.2, 23.5).hover_throttle(np.array([21.5]))[0] > 0.2, "the battery's law stays"


@pytest.mark.parametrize("roll_rad", [0.0, 0.2])
def test_a_vehicle_quicker_than_the_steps_flies_all_the_same(roll_rad):
    """A fit of a simulator without motor lag has sigma_t at its bound; with a step of 40 ms RK4 alone runs away."""
    quick = ModelPredictor(Model(), {"sigma_t": 150.0, "sigma_r": 90.0, "omega_phi": 70.0, "zeta_phi": 0.5})
    asked = lambda now: np.array([[roll_rad, 0.0, 0.0, 0.2]])  # noqa: E731
    coarse, fine = (
        quick.fly(np.array([[0.0, 0.0, 5.0]]), np.zeros(1), np.array([22.2]), asked, 1.0, dt_s)
        for dt_s in (0.04, 0.002)
    )
    assert coarse.p_m[0, -1] == pytest.approx(fine.p_m[0, -1], abs=0.03)


@pytest.mark.parametrize(
    ("term", "values", "factor"),
    [
        ("slung_payload", {"payload_ratio": 0.15, "cable_m": 0.7}, 1.15),  # the load's weight hangs below the vehicle
        ("steady_wind", {"w_north": 3.0}, 1.0),
        ("throttle_curve", {"curvature": 0.25}, 1.0),
        ("rotor_speed_lag", {}, 1.0),
        ("thrust_extra_lag", {}, 1.0),
    ],
)
def test_a_model_with_a_term_hovers_where_nothing_pulls_it_up_or_down(term, values, factor):
    """By the body alone a vehicle with a load of 0.15 sank 2.4 m in 3 s, and what was proposed to be flown next did not fit the zone."""
    made = ModelPredictor(Model().with_terms(term), values)
    volts = np.array([22.2, 24.5])
    hover = made.hover_throttle(volts)
    assert hover[0] == pytest.approx(factor * 9.81 / 54.55, rel=1e-6)
    motion = made.fly(
        np.tile([0, 0, 5.0], (2, 1)),
        np.zeros(2),
        volts,
        lambda now: np.column_stack([np.zeros((2, 3)), hover]),
        3.0,
        0.02,
    )
    assert motion.p_m[:, -1, 2] == pytest.approx(5.0, abs=1e-3)


def test_a_model_whose_throttle_is_offset_hovers_at_more_of_it():
    made = ModelPredictor(Model().with_terms("throttle_offset"), {"T_min": 0.02})
    assert made.hover_throttle(np.array([22.2]))[0] == pytest.approx(9.81 / 54.55 + 0.02, rel=1e-6)
