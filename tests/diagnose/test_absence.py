"""What may be nothing though it predicts better."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flight import campaign, fly
from made_rows import rows_of

from flighttest.diagnose.residuals.lack_of_fit import floor_of
from flighttest.diagnose.selection.absence import may_be_absent, may_be_nothing, undriven
from flighttest.diagnose.selection.comparison import Fitted, log_evidence
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import Optimum
from flighttest.estimation.problem import Noise
from flighttest.estimation.uncertainty.covariance import Covariance
from flighttest.identify.selection import able
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model

NOISE = Noise({}, {})


@pytest.mark.parametrize(("gain", "said"), [(-4.0, True), (76.0, True), (78.0, False)])
@pytest.mark.parametrize("values", [{"fade_depth": 0.01, "fade_tau": 97.0}, {"fade_depth": 0.2, "fade_tau": 120.0}])
def test_absence_is_excluded_by_the_likelihood_ratio_over_the_inflation_of_the_printed_covariance(gain, said, values):
    """A fade of 0.010 +- 0.11 was named with 212 nats on a firmware's calm log; the share of a pole of 3400 nats is 1 +- 10, since it and
    the delay are one direction. chi-squared of two degrees of freedom is 15.4 at 1 % over 22 candidates: here five times that, whatever
    the estimates."""
    names = ("fade_depth", "fade_tau")
    of_noise = np.array([[1e-4, 0.05], [0.05, 400.0]])
    known = Covariance(names, 2.0 * of_noise, of_noise, np.full(2, 1e6), 3.0 * of_noise)
    term = catalogue()["thrust_fade"]
    fitted = Fitted(Model((term.id,)), names, Optimum(values, {}, NOISE, 0.0), None)
    absent = may_be_absent(term, fitted, gain, known, SimpleNamespace(), 22)
    assert ("may be nothing" in absent) is said
    assert "nan" not in absent


@pytest.mark.parametrize(("worth", "said"), [({"arm_x": 600.0}, False), ({}, True), ({"arm_x": 10.0}, True)])
def test_one_certain_coefficient_is_enough(worth, said):
    """Arms of -0.075 +- 0.006 and -0.05 +- 0.09 m had p 0.002 together, since the second makes the likelihood ratio uncertain."""
    names = ("arm_x", "arm_y", "arm_z")
    of_noise, values = np.eye(3) * 1e-6, {"arm_x": -0.075, "arm_y": 0.05, "arm_z": -0.05}
    known = Covariance(names, np.diag([9e-6, 9e-6, 2e-3]), of_noise, np.full(3, 12.0))
    asked = []

    def fit(_model, start, free, *, noise):
        (gone,) = {*names} - {*free}
        assert (start[gone], noise) == (0.0, False)
        asked.append(gone)
        return Optimum(start, {}, NOISE, 100.0 + worth.get(gone, 0.0))

    estimator = SimpleNamespace(moved=lambda _m, at, to: {**at.values, **to}, fit=fit)
    term = catalogue()["imu_lever_arm"]
    fitted = Fitted(Model((term.id,)), names, Optimum(values, {}, NOISE, 100.0), None)
    assert bool(may_be_absent(term, fitted, 20000.0, known, estimator, 22)) is said
    assert asked == (["arm_x", "arm_y", "arm_z"] if said else ["arm_x"])
    asked.clear()
    assert not may_be_absent(term, fitted, 200000.0, known, estimator, 22)
    assert not asked, "together they are certain"


@pytest.mark.parametrize(
    ("shows", "term", "said"), [(0, "axial_inflow", False), (1, "axial_inflow", True), (1, "velocity_latency", False)]
)
def test_what_only_the_velocity_shows_excludes_the_absence_of_no_force(shows, term, said):
    """On a part of the real firmware's log, without any, a load of 0.030 +- 0.034 was named: of a likelihood ratio of 2610, the velocity's
    own wander was 2124, and without it p is 0.011."""
    channel = np.tile([0, 1], 500)
    y = np.where(channel == shows, 2.0, 0.0)
    (name,) = (p.name for p in catalogue()[term].params)
    at = Optimum({name: 1.0}, {}, NOISE, 0.0)
    without, fitted = (
        Fitted(Model((term,)), (name,), at, rows_of(r, np.ones((1000, 1)), 20, channel=channel)) for r in (y, 0.0 * y)
    )
    known = Covariance((name,), np.ones((1, 1)), np.ones((1, 1)), np.full(1, 1e6))
    estimator = SimpleNamespace(covariance=lambda *_: known)
    assert bool(may_be_nothing(catalogue()[term], fitted, without, estimator, 22)) is said


def test_a_term_of_which_nothing_is_determined_may_be_absent():
    nothing = Covariance((), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0))
    term = catalogue()["thrust_fade"]
    at_bounds = Fitted(Model((term.id,)), (), Optimum({"fade_depth": 0.6, "fade_tau": 15.0}, {}, NOISE, 0.0), None)
    assert may_be_absent(term, at_bounds, 1e6, nothing, SimpleNamespace(), 22)


@pytest.mark.parametrize(
    ("shows", "gain", "said"), [(0, 7.0, False), (0, 6.2, True), (1, 700.0, True), (0, -4.0, True)]
)
def test_a_swing_that_nothing_moves_is_excluded_at_one_per_cent_by_what_contains_information(shows, gain, said):
    """Of one parameter, whose printed variance is that of the noise: chi-squared of one degree of freedom is 6.63 at 1 %."""
    channel, name, term = np.tile([0, 1], 500), "payload_ratio", catalogue()["slung_payload"]
    at = Optimum({name: 0.1}, {}, NOISE, 0.0)
    driven, swinging = (
        rows_of(
            np.where(channel == shows, np.sqrt(max(left, 0.0) / 500.0), 0.0), np.ones((1000, 1)), 20, channel=channel
        )
        for left in (-gain, gain)
    )
    estimator = SimpleNamespace(moved=lambda _m, at: at, fit=lambda _m, at, _n: at, linearise=lambda *_: swinging)
    known = Covariance((name,), np.ones((1, 1)), np.ones((1, 1)), np.full(1, 1e6))
    assert bool(undriven(term, Fitted(Model((term.id,)), (name,), at, driven), known, estimator)) is said


@pytest.mark.slow
@pytest.mark.parametrize("hung", [True, False])
def test_a_load_that_only_swings_before_each_response_is_no_load(hung):
    """In throttle steps under the real firmware, velocity wandered by 5 mm/s: four initial states per response followed it, and a load of
    0.10 was named with a probability above 0.999."""
    rng = np.random.default_rng(7)
    if hung:
        segments = fly(campaign(2, yaws=False), payload=(0.3, 1.0))
    else:
        swing = 0.05 * rng.standard_normal((2, 80)), rng.uniform(0.0, 2.0 * np.pi, (2, 80))
        segments = [
            replace(s, y=s.y | {
                c: s.y[c] + swing[0][i][k] * np.sin(2.8 * (s.t_s - s.t_s[0]) + swing[1][i][k])
                for i, c in enumerate(("v_x_m_s", "v_y_m_s"))
            })
            for k, s in enumerate(fly(campaign(1, tilts=False, yaws=False)))
        ]  # fmt: skip
    estimator = Estimator(tuple(segments), "translation", able)
    base, loaded = Model(("linear_drag",)), Model(("linear_drag", "slung_payload"))

    def fit_of(model, values):
        names = estimator.problem(model).names
        at = estimator.fit(model, estimator.start(model, values), names)
        return Fitted(model, names, at, estimator.linearise(model, at, names))

    smaller = fit_of(base, {})
    larger = fit_of(loaded, smaller.at.values | {"payload_ratio": 0.1, "cable_m": 1.2})
    groups = np.arange(len(segments)) % 5
    floor = floor_of(larger.rows, segments, {})
    assert sum(log_evidence(larger, smaller, estimator, groups, floor).values()) > 10.0
    known = estimator.covariance(loaded, larger.at, larger.names)
    said = undriven(catalogue()["slung_payload"], larger, known, estimator)
    assert ("the flight does not move it" in said) != hung
