"""What an accelerometer makes of a motion: a bias for all of a flight, beside the noise."""

import numpy as np
import pytest

from flighttest.sim.build import ACCEL_DRIFT_M_S2, build_vehicle
from flighttest.sim.options import SimOptions


def at_rest(seed, **options):
    """Accelerometer of a vehicle on the ground, mean over samples: (3,)."""
    sensors = build_vehicle(SimOptions(seed=seed, **options)).sensors
    samples = []
    for _ in range(1000):
        sensors.update()
        samples.append((sensors.accel.x, sensors.accel.y, sensors.accel.z))
    return np.mean(samples[200:], axis=0)


def test_what_drifts_stays_for_a_flight_and_differs_between_flights():
    off = np.array([at_rest(s, drift=1.0, noise=0.0) - at_rest(s, noise=0.0) for s in range(60)])
    stated = [ACCEL_DRIFT_M_S2] * 3
    assert np.sqrt(np.mean(off**2, axis=0)) == pytest.approx(stated, rel=0.35)
    assert np.abs(np.corrcoef(off.T) - np.eye(3)).max() < 0.4


def test_drift_is_beside_the_noise_and_none_is_usual():
    assert at_rest(3, drift=1.0) - at_rest(3) == pytest.approx(at_rest(3, drift=1.0, noise=0.0) - at_rest(3, noise=0.0))
