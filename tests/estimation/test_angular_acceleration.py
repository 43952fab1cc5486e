"""What is worked out of the gyro: angular acceleration as sharp as its samples allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from flighttest.estimation.responses import exogenous
from flighttest.segments import Segment
from flighttest.segments.model import SegmentContext


def segment(t: np.ndarray, rate: np.ndarray) -> Segment:
    """A segment with nothing but a roll rate."""
    return Segment("a", "run", "roll_step", {}, 1, 0.0, t, {"p_rad_s": rate}, {})


@pytest.mark.parametrize("frequency_hz", [2.0, 8.0])
def test_a_fast_turn_is_not_blurred(frequency_hz: float) -> None:
    """The sine of a loop, sampled at 50 Hz: neighbours' differences lose 1 % and 16 % of its slope."""
    t = np.arange(0.0, 2.0, 0.02)
    w = 2 * np.pi * frequency_hz
    found = exogenous(segment(t, np.sin(w * t)), "p_dot_rad_s2", 22.2, 0.0)
    inner = slice(10, -10)
    assert np.abs(found - w * np.cos(w * t))[inner].max() < 0.02 * w
    assert found.shape == t.shape


def test_a_turn_is_at_its_time_where_the_gyroscopes_filter_is_known() -> None:
    """A rate behind a Butterworth filter of 20 Hz is 11 ms late, 0.28 rad of the phase of 4 Hz, unless that is known."""
    fine, every, hz, w = np.arange(0.0, 3.0, 0.001), 10, 20.0, 2 * np.pi * 4.0
    behind = signal.lfilter(*signal.butter(2, hz, fs=1000.0), np.sin(w * fine))
    filtered = segment(fine[::every], behind[::every])
    known = replace(filtered, context=SegmentContext(filters={"rates": hz}))
    inner = slice(50, -10)
    for name, true in (("p_rad_s", np.sin(w * fine)), ("p_dot_rad_s2", w * np.cos(w * fine))):
        goal = true[::every][inner]
        assert np.abs(exogenous(known, name, 22.2, 0.0)[inner] - goal).max() < 0.02 * np.abs(goal).max()
        assert np.abs(exogenous(filtered, name, 22.2, 0.0)[inner] - goal).max() > 0.2 * np.abs(goal).max()
