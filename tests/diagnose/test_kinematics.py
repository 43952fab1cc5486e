"""A late velocity and a biased accelerometer, which one shows of the other: by kinematics, whatever flies."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.diagnose import diagnose
from flighttest.diagnose.kinematics import KinematicsAnswer, by_kinematics, in_time
from flighttest.diagnose.records import WITH_GUSTS
from flighttest.estimation.drift import DRIFT
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.segments.compatibility import AccelerometerBias, Compatibility
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


@pytest.mark.slow
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
        (row,) = (rows["all"] for rows in made.heldout.values())
        assert [*made.shares.values()] == pytest.approx([(row["rmse_after"] / row["rmse_before"]) ** 2])
        assert made.error == WITH_GUSTS


@pytest.mark.slow
def test_a_stamp_is_no_latency_and_a_smaller_one_would_not_be_seen():
    answer = diagnose(recorded(found(0.004, std_s=0.001)), Model(), only=("velocity_latency",))
    assert answer.not_needed == ("velocity_latency",)
    assert answer.smallest_detectable == {"velocity_latency": 0.02}
    (unknown,) = diagnose(recorded(found(0.004, std_s=0.003)), Model(), only=("velocity_latency",)).untestable
    assert unknown.term == "velocity_latency"


@pytest.mark.slow
def test_a_latency_that_the_model_holds_is_no_candidate():
    assert not diagnose(recorded(found()), Model() + "velocity_latency", only=()).accepted


def test_a_velocity_in_time_is_that_of_later_samples():
    segment = flight(30.0, 5)[2]
    (moved,) = in_time([segment], 0.04)
    assert moved.y["v_x_m_s"][:-2] == pytest.approx(segment.y["v_x_m_s"][2:])
    assert np.isnan(moved.y["v_x_m_s"][-2:]).all()
    assert moved.y["roll_rad"] is segment.y["roll_rad"]


def biased(value=(0.0, 0.0, -2.0), std=0.03, left=0.1, stretches=20):
    """What kinematics show of a recording whose velocity is in time. left: of the mean square error, without the bias."""
    square = float(np.sum(np.square(value)))
    bias = AccelerometerBias(value, tuple(map(tuple, std**2 * np.eye(3))), ((square, left * square),) * stretches)
    return replace(found(0.004, std_s=0.001, stretches=stretches), bias=bias)


@pytest.mark.slow
def test_a_biased_accelerometer_is_named_and_not_taken_for_thrust():
    """An accelerometer that measures 2 m/s^2 too little, of a vehicle whose K is 19.6."""
    windows = flight(60.0, 31, gust=0.2)[1:]
    low = [replace(w, y=w.y | {"f_z_m_s2": w.y["f_z_m_s2"] - 2.0}) for w in windows]
    seen = [replace(w, context=replace(w.context, compatibility=biased())) for w in low]
    right, answer = (diagnose(s, Model(), only=("accelerometer_bias",)) for s in (windows, seen))
    assert answer.accepted == ("accelerometer_bias",)
    (finding,) = answer.findings
    assert finding.parameters["bias_z"]["value"] == pytest.approx(-2.0)
    assert "by kinematics" in finding.sentence
    low_z, high_z = finding.parameters["bias_z"]["interval_95"]
    assert high_z - low_z > 4.0 * DRIFT["f_z_m_s2"]
    assert answer.values["K"] == pytest.approx(right.values["K"], rel=1e-6)
    assert diagnose(low, Model(), only=()).values["K"] < 0.9 * right.values["K"]


@pytest.mark.parametrize(
    ("runs", "named"),
    [
        ((biased(),), True),
        ((biased(), biased((0.1, 0.0, -2.2))), True),
        ((biased(), found(0.004, std_s=0.001)), False),  # of which it is not known
        ((biased((0.0, 0.0, 0.35)),), True),
        ((biased((0.0, 0.0, 0.2)),), False),  # accelerometers drift by 0.05
        ((biased((0.0, 0.0, 0.35), std=0.1),), False),
        ((biased(left=0.45),), True),
        ((biased(left=0.55),), False),  # not the same in all of the flight
        ((biased((0.0, 0.0, -4.5)),), False),  # beyond what the term may have
    ],
)
def test_a_bias_is_one_that_every_recording_shows_and_that_leaves_little(runs, named):
    segments = [s for k, c in enumerate(runs) for s in recorded(c, f"run {k}")]
    made = by_kinematics(segments, POOL)
    assert ("accelerometer_bias" in made.accepted) is named
    if named:
        assert list(made.held.values.values()) == pytest.approx(np.mean([c.bias.value_m_s2 for c in runs], axis=0))
        assert np.diag(made.held.covariance).min() > DRIFT["f_z_m_s2"] ** 2


def test_recordings_whose_biases_differ_have_a_mean_with_that_error():
    runs = biased((0.0, 0.0, -2.0)), biased((0.0, 0.0, -0.2))
    made = by_kinematics([s for k, c in enumerate(runs) for s in recorded(c, f"run {k}")], POOL)
    assert not made.accepted  # -1.1 +- 0.5
    assert "accelerometer_bias" not in made.tried


def test_both_errors_are_named_of_one_recording():
    both = replace(found(), bias=biased().bias)
    made = by_kinematics(recorded(both), POOL)
    assert set(made.accepted) == {"velocity_latency", "accelerometer_bias"}
    (first, *_) = recorded(both)
    (corrected, *_) = made.corrected([first])
    assert corrected.y["f_z_m_s2"] == pytest.approx(first.y["f_z_m_s2"] + 2.0)
    assert corrected.y["v_x_m_s"][:-5] == pytest.approx(first.y["v_x_m_s"][5:])


@pytest.mark.slow
def test_no_bias_and_the_smallest_that_would_have_been_seen():
    made = by_kinematics(recorded(biased((0.0, 0.0, 0.05))), POOL)
    assert "accelerometer_bias" in made.tried
    size, name = made.levels["accelerometer_bias"]
    assert name == "bias_z"
    assert by_kinematics(recorded(biased((0.0, 0.0, 1.05 * size))), POOL).accepted
    assert not by_kinematics(recorded(biased((0.0, 0.0, 0.95 * size))), POOL).accepted
    assert "accelerometer_bias" not in by_kinematics(recorded(biased((0.0, 0.0, 0.05), std=0.06)), POOL).tried


def test_the_drift_of_a_parameter_is_that_of_its_instrument():
    params = {p.name: p.drift for term in catalogue().values() for p in term.params if p.drift}
    assert params == {f"bias_{a}": DRIFT["f_z_m_s2"] for a in "xyz"} | {
        f"offset_{a}": DRIFT[f"{a}_rad"] for a in ("roll", "pitch")
    }
