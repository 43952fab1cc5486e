"""The package's prior model against Eq. 4 written out a second time for these tests."""

import numpy as np
import pytest

from flighttest.pipeline.planning.predictor import ModelPredictor
from flighttest.plan.rehearse import sampled_targets
from flighttest.script.profiles import Piece


@pytest.mark.parametrize("voltage", [21.5, 24.5])
def test_both_fly_the_same(predictor, voltage):
    package = ModelPredictor()
    pieces = (
        Piece("entry", 0.3),
        Piece("tilt", 0.8, roll_rad=0.4, pitch_rad=-0.3, yaw_rate_rad_s=1.0, throttle=0.3),
        Piece("fall", 0.5, pitch_rad=0.3, throttle=0.05),
        Piece("turn", 0.6, yaw_rate_rad_s=-2.0, throttle=0.25),
    )
    t = np.arange(0.0, 3.0, 0.02)
    hover = float(predictor.hover_throttle(np.array([voltage]))[0])
    assert hover == pytest.approx(float(package.hover_throttle(np.array([voltage]))[0]), rel=3e-3)  # 0.18 of K = 54.55
    table = sampled_targets(pieces, hover, t)
    flights = [
        one.fly(
            np.array([[1.0, 2.0, 5.0]]),
            np.array([0.7]),
            np.array([voltage]),
            lambda now: table[None, min(round(now.t_s / 0.02), t.size - 1)],
            2.6,
            0.02,
        )
        for one in (predictor, package)
    ]
    first, second = flights
    assert np.abs(first.p_m[0, -1] - first.p_m[0, 0]).max() > 1.0
    np.testing.assert_allclose(first.p_m, second.p_m, atol=0.05)
    np.testing.assert_allclose(first.rpy_rad, second.rpy_rad, atol=2e-3)
