"""Targets that the autopilot dropped are no references; a few around a change of mode are not worth a word."""

import numpy as np
import pytest

from flighttest.mavlink.accepted import taken
from flighttest.mavlink.modes import TAKES_ATTITUDE_TARGETS
from flighttest.recording import Series

GUIDED, LOITER = TAKES_ATTITUDE_TARGETS[0], 5.0


@pytest.mark.parametrize(("until_s", "reported"), [(0.5, False), (20.0, True)])
def test_only_many_dropped_targets_are_reported(until_s, reported):
    t = np.arange(0.0, 100.0, 0.1)
    beats = np.arange(0.0, 100.0, 0.5)
    losses = []
    kept = taken(
        Series(t, {"throttle": np.full(t.size, 0.3)}), beats, np.where(beats <= until_s, LOITER, GUIDED), losses
    )
    assert np.isnan(kept.columns["throttle"]).sum() == np.sum(t <= until_s)
    assert bool(losses) == reported
