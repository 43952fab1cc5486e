"""How far a predicted flight leaves the zone."""

import numpy as np

from flighttest.plan.clearance import Clearance, Track, worst


def test_a_model_whose_flight_diverges_leaves_the_zone():
    """A drag below zero, fitted to recordings that contain no information on it, makes speeds whose square no float holds."""
    low, high = np.array([-15.0, -7.0, 0.0]), np.array([15.0, 7.0, 10.0])
    clearance = Clearance(low + 1.0, high - 1.0, low, high, (1.0, 9.0))
    p_m = np.array([[0.0, 0.0, 5.0], [1e200, 0.0, 5.0]])
    v_m_s = np.array([[0.0, 0.0, 0.0], [1e200, 0.0, 0.0]])
    found = worst([], [Track(np.array([0.0, 1.0]), p_m, v_m_s)], clearance, np.zeros(3), fence=True)
    assert found is not None
    assert found.lost
    assert found.metres > 1e9
