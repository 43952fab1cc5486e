"""Height above ground where the rangefinder reads for a part of the time alone."""

import numpy as np
import pytest

from flighttest.logs.heights import ranged_height
from flighttest.recording import Series

T = np.arange(0.0, 30.0, 0.1)
UP = np.interp(T, [10.0, 15.0, 20.0, 25.0], [0.0, 4.0, 4.0, 0.0])


def test_beyond_its_reach_the_height_is_that_of_the_position():
    """A log whose rangefinder read 0.10 m before take-off and after landing had a height of 0.10 m throughout a flight at 2.4 m."""
    position = Series(T, {"p_z_m": UP + 1.5 + 0.01 * T})  # its zero lies elsewhere, and drifts
    good = UP < 1.0
    height, how = ranged_height(T, np.where(good, UP + 0.1, 40.0), good, position)
    assert height == pytest.approx(UP + 0.1, abs=0.05)
    assert height[good] == pytest.approx(UP[good] + 0.1)
    assert f"{100 * good.mean():.0f} %" in how
    assert "p_z_m" in how


def test_what_nothing_shows_is_not_known():
    good = UP < 1.0
    for position in (None, Series(T, {"p_z_m": np.full(T.size, np.nan)})):
        height, how = ranged_height(T, UP, good, position)
        assert np.isnan(height[~good]).all()
        assert height[good] == pytest.approx(UP[good])
        assert how == ""
    short = Series(T[:150], {"p_z_m": UP[:150]})
    assert np.isnan(ranged_height(T, UP, good, short)[0][~good & (T > 15.0)]).all()
    assert ranged_height(T, UP, np.ones(T.size, dtype=bool), short)[1] == ""
