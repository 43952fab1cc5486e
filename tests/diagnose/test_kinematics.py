"""A late velocity, shown by the accelerometer: by kinematics, whatever flies."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.diagnose import diagnose
from flighttest.diagnose.kinematics import KinematicsAnswer, by_kinematics, in_time
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.segments.compatibility import Compatibility
from tests.identify.test_free_flight import flight

POOL = tuple(catalogue().values())
LATE_S = 0.1


def found(late_s=LATE_S, std_s=0.002, left=0.04, stretches=20):
    """What kinematics show of a recording; left: of the mean square error, with the velocity at its time."""
    return Compatibility(late_s, std_s, 0.0, 0.001, 0.0, 0.002, stretches, ((0.01, 0.01 * left),) * stretches)


def recorded(compatibility=None, run="run"):
    """A minute of free flight whose velocity is recorded 5 samples of 20 ms late, and what kinematics show of it."""
    late = round(LATE_S * 50)
    windows = flight(60.0, 31, gust=0.2, run=run)
    joined = {n: np.concatenate([w.y[n] for w in windows]) for n in ("v_x_m_s", "v_y_m_s", "v_z_m_s")}
    found = []
    for k, w in enumerate(windows[1:], start=1):
        at = slice(k * w.t_s.size - late, (k + 1) * w.t_s.size - late)
        y = w.y | {n: v[at] for n, v in joined.items()}
        found.append(replace(w, y=y, context=replace(w.context, compatibility=compatibility)))
    return tuple(found)


def test_a_late_velocity_is_named_and_the_rest_sees_it_at_its_time():
    answer = diagnose(recorded(found()), Model(), only=("velocity_latency",))
    assert answer.accepted == ("velocity_latency",)
    (finding,) = answer.findings
    low, high = finding.parameters["velocity_latency"]["interval_95"]
    assert low < LATE_S < high
    assert high - low < 0.05
    assert finding.heldout["velocity"]["rmse_after"] < finding.heldout["velocity"]["rmse_before"]
    assert answer.located[0].channel == "velocity"
    assert "velocity_latency" in answer.model.terms
    assert answer.values["velocity_latency"] == pytest.approx(LATE_S)
    for name, truth in (("d_x", 0.4), ("d_y", 0.3)):
        assert abs(answer.values[name] - truth) < 3.0 * answer.fit.estimates[name].std


@pytest.mark.parametrize(
    ("runs", "late"),
    [
        ((found(),), True),
        ((found(), found(0.12)), True),
        ((found(), None), False),  # of a recording without accelerometer nothing is known
        ((found(0.015),), False),  # a stamp
        ((found(std_s=0.05),), False),
        ((found(std_s=LATE_S / 12.0, stretches=7),), True),  # t with 4 degrees of freedom
        ((found(std_s=LATE_S / 8.0, stretches=7),), False),
        ((found(left=0.45),), True),
        ((found(left=0.55),), False),  # other errors of the estimate look like a latency
    ],
)
def test_a_latency_is_one_that_every_recording_shows_and_that_leaves_little(runs, late):
    segments = [s for k, c in enumerate(runs) for s in recorded(c, f"run {k}")]
    made = by_kinematics(segments, POOL)
    assert isinstance(made, KinematicsAnswer) is late
    if late:
        (mean,) = made.held.values.values()
        assert mean == pytest.approx(np.mean([c.velocity_late_s for c in runs]))
        assert made.held.covariance[0, 0] >= 0.01**2  # of the stamp


def test_a_stamp_is_no_latency_and_a_smaller_one_would_not_be_seen():
    answer = diagnose(recorded(found(0.004, std_s=0.001)), Model(), only=("velocity_latency",))
    assert answer.not_needed == ("velocity_latency",)
    assert answer.smallest_detectable == {"velocity_latency": 0.02}
    (unknown,) = diagnose(recorded(found(0.004, std_s=0.003)), Model(), only=("velocity_latency",)).untestable
    assert unknown.term == "velocity_latency"


def test_a_latency_that_the_model_holds_is_no_candidate():
    assert not diagnose(recorded(found()), Model() + "velocity_latency", only=()).accepted


def test_a_velocity_in_time_is_that_of_later_samples():
    segment = flight(30.0, 5)[2]
    (moved,) = in_time([segment], 0.04)
    assert moved.y["v_x_m_s"][:-2] == pytest.approx(segment.y["v_x_m_s"][2:])
    assert np.isnan(moved.y["v_x_m_s"][-2:]).all()
    assert moved.y["roll_rad"] is segment.y["roll_rad"]
