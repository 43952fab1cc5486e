"""The prior model flown for `plan`: hovers, and follows what can be worked out by hand."""

import math

import numpy as np
import pytest

from flighttest.pipeline.predictor import ModelPredictor


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
