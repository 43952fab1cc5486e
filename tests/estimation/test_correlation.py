"""Errors of a velocity estimate that wander count as often as they are independent, and no more."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.estimation import likelihood_weights
from flighttest.estimation.autocorrelation import correlations
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.likelihood_weights import LikelihoodWeights, State, start_noise
from flighttest.estimation.solver import Start, solve
from flighttest.identify.fit import default_model, fit
from flighttest.identify.fixed_parameters import stored_noise
from flighttest.identify.selection import able
from tests.diagnose.flight import TRUE, campaign, fly
from tests.diagnose.made_rows import autoregressive


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def wandering(rng, rho, responses=200, samples=150):
    return autoregressive(rng, (responses, samples), rho)


def counted(residual, outputs=("f_x_m_s2", "v_x_m_s"), mask=None, size=0.01):
    """Of a residual (m, n) times `size`, m/s, at 50 Hz."""
    whole = size * np.stack([np.zeros_like(residual), residual], axis=2)
    mask = np.ones(whole.shape, dtype=bool) if mask is None else mask
    part = SimpleNamespace(outputs=outputs, mask=mask, interval_s=0.02)
    return correlations(part, SimpleNamespace(residual=whole))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_samples_that_count_as_one_are_the_integrated_autocorrelation(rng, rho):
    # Less, since a trend is left out and so is what correlates by less than 5 %.
    true = (1.0 + rho) / (1.0 - rho)
    assert 0.65 * true < counted(wandering(rng, rho))["v_x_m_s"] < 1.1 * true


def test_gaps_are_no_samples(rng):
    x, mask = wandering(rng, 0.8), np.ones((200, 150, 2), dtype=bool)
    mask[:, 60:75] = False
    assert counted(np.where(mask[..., 1], x, 50.0), mask=mask)["v_x_m_s"] == pytest.approx(6.3, rel=0.1)


def test_what_an_initial_state_and_a_disturbance_take_up_is_no_correlation(rng):
    ramps = rng.normal(size=(200, 1)) + rng.normal(size=(200, 1)) * np.linspace(-1.0, 1.0, 150)
    assert counted(rng.normal(size=(200, 150)) + 30.0 * ramps)["v_x_m_s"] < 1.3


@pytest.mark.parametrize(("size", "most"), [(0.03, 50.0), (0.06, 12.5), (0.3, 1.0)])
def test_no_estimator_wanders_by_more_than_three_centimetres_per_second_for_a_second(rng, size, most):
    """Beyond that it is physics that is missing: on a log of ArduPilot's simulator the velocity counted for nothing beside a linear drag,
    and an accelerometer was said to be 0.14 m/s^2 off, which the velocity excludes."""
    found = counted(wandering(rng, 0.99, samples=600), size=size)["v_x_m_s"]
    assert found == pytest.approx(most, rel=0.1)


@pytest.mark.parametrize(("off", "counted_as_one"), [(0.0, 24.0), (0.1, 7.8), (0.4, 1.0)])
def test_a_velocity_whose_noise_grows_counts_for_no_less_than_an_estimator_may_wander(off, counted_as_one):
    """Learned from small residuals and kept beside larger ones, a correlation made a velocity count less, be predicted worse, and count
    less still: on the same log to 2.9 m/s from 0.002, in fits that did not converge, while the log likelihood fell by 36000."""
    flown = tuple(fly(campaign(1, tilts=False, yaws=False)))[:6]
    pushed = tuple(replace(s, y=s.y | {"v_z_m_s": s.y["v_z_m_s"] + off * np.sin(9.0 * s.t_s)}) for s in flown)
    problem = Estimator(pushed, "translation", able).problem(default_model(flown))
    found = solve(problem, robust=False)
    at = State(np.zeros(0), problem.placed({}), problem.evaluate(found.values, None, found.free))
    known = replace(found.noise, correlation={"v_z_m_s": 24.0})
    noise = LikelihoodWeights.even(problem, known, robust=False).with_noise_of(at, found.free).noise
    assert noise.correlation["v_z_m_s"] == pytest.approx(counted_as_one, rel=0.05)
    interval_s = float(np.median(np.diff(flown[0].t_s)))
    assert noise.counted(["v_z_m_s"])[0] <= max(0.03 / np.sqrt(interval_s), noise.channel["v_z_m_s"]) * 1.001


def test_only_a_velocity_whose_specific_force_was_recorded_counts_less(rng):
    assert counted(wandering(rng, 0.8), outputs=("f_y_m_s2", "v_x_m_s")) == {}
    assert set(counted(wandering(rng, 0.8))) == {"v_x_m_s"}
    assert counted(np.zeros((200, 150)))["v_x_m_s"] == 1.0


@pytest.mark.slow
def test_a_velocity_whose_error_wanders_is_seen_to():
    rng, moved = np.random.default_rng(0), []
    for s in fly(campaign(2)):
        wander = 0.04 * wandering(rng, 0.97, 3, s.t_s.size)
        y = {n: s.y[n] + w for n, w in zip(("v_x_m_s", "v_y_m_s", "v_z_m_s"), wander, strict=True)}
        moved.append(replace(s, y=s.y | y))
    found = fit(moved, select="all", robust=False)
    assert min(found.noise.correlation.values()) > 2.0
    for name, true in zip(("d_x", "d_y", "d_z"), TRUE["d"], strict=True):
        assert found.values[name] == pytest.approx(true, rel=0.03)
    again = solve(found.problem, Start(noise=replace(found.noise, correlation={"v_x_m_s": 7.0})), robust=False)
    assert again.noise.correlation == {"v_x_m_s": 7.0}, "what is known is kept"


def test_a_correlation_that_swings_is_learned_four_times_and_ends(monkeypatch):
    """Residuals depend on the weights: learned at every step it swung between two values, and a fit ended elsewhere after 40 steps."""
    taus = []

    def swinging(_part, _made):
        taus.append(1.0 if len(taus) % 2 else 30.0)
        return {"v_z_m_s": taus[-1]}

    monkeypatch.setattr(likelihood_weights, "correlations", swinging)
    segments = tuple(fly(campaign(1, tilts=False, yaws=False)))[:6]
    estimator, model = Estimator(segments, "translation", able), default_model(segments)
    found = solve(estimator.problem(model), robust=False)
    assert found.status.good
    assert len(taus) == 4
    # 30, then the mean with 1, with 30, with 1.
    assert found.noise.correlation["v_z_m_s"] == pytest.approx(30.0 ** (0.5 * (0.5 * (0.5 + 1.0))))


def test_four_samples_that_count_as_one_weigh_as_twice_the_standard_deviation():
    segments = tuple(fly(campaign(1, tilts=False, yaws=False)))[:6]
    estimator, model = Estimator(segments, "translation", able), default_model(segments)
    problem, names = estimator.problem(model), ("sigma_t", "K", "d_z", "T_d_thrust")
    known = start_noise(problem)
    four = replace(known, correlation={"v_z_m_s": 4.0})
    twice = replace(known, channel={**known.channel, "v_z_m_s": 2.0 * known.channel["v_z_m_s"]})
    seen = []
    for noise in (four, twice):
        at = replace(estimator.start(model), noise=noise)
        weighing = LikelihoodWeights.even(problem, noise, robust=False)
        state = State(np.zeros(0), problem.placed({}), problem.evaluate(at.values, None, names))
        normal, _ = weighing.normal_equations(state, names)
        rows = estimator.linearise(model, at, names)
        profiled = weighing.profiled(state, names)
        seen.append(
            (
                weighing.cost(state), estimator.objective(model, at), normal.hessian, normal.score, rows.residual, rows.jacobian,
                rows.scale, *(x for pair in profiled for x in pair),
            )
        )  # fmt: skip
    for one, other in zip(*seen, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


def test_the_noise_of_a_model_file_is_used_whole():
    problem = SimpleNamespace(
        parts=[SimpleNamespace(outputs=("v_x_m_s",), block=SimpleNamespace(disturbances=("a_d_x_m_s2",)))]
    )
    stored = {"channels": {"v_x_m_s": 0.02}, "disturbances": {"a_d_x_m_s2": 0.1}, "correlations": {"v_x_m_s": 25.0}}
    assert stored_noise(stored, problem).counted(("v_x_m_s",)) == pytest.approx([0.1])
    del stored["correlations"]
    assert stored_noise(stored, problem).counted(("v_x_m_s",)) == pytest.approx([0.02])
    assert stored_noise({"channels": {}, "disturbances": stored["disturbances"]}, problem) is None
