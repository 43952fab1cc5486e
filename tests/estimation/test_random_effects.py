"""Random effects of equations of motion: the same as least squares in the covariance that they make."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from flighttest.estimation.equation_error import (
    Autoregression,
    InitialStates,
    Stream,
    beside_random_effects,
    misfit_of,
    noises,
    whiten,
    without_levels,
)

NOISE = {"a": Autoregression(np.array([1.0, -0.6, 0.2]), 0.3), "b": Autoregression(np.array([1.0, 0.5]), 0.7)}
SIZES = (30, 25, 40)  # rows that began from each of three initial states; the last is of another stretch


@pytest.fixture(params=[{}, {"a": 0.4}, {"a": 0.4, "b": 2.0}], ids=["no level", "one level", "two levels"])
def noise(request):
    """Of each channel, with the standard deviation of its level."""
    return {c: replace(one, level=request.param.get(c, 0.0)) for c, one in NOISE.items()}


def whitening(noise, n):
    """(n, n) matrix of the filter."""
    return noise.whitened(np.eye(n))


@pytest.fixture(params=[0.0, 0.7], ids=["about rest", "about other states"])
def about(request):
    """(3, 2) initial states that the equations are linear about."""
    return request.param * np.random.default_rng(4).standard_normal((3, 2))


@pytest.fixture
def streams(about):
    """What they leave there: of one truth, whatever they are linear about."""
    rng = np.random.default_rng(3)
    numbers = np.repeat([0, 1, 2], SIZES)
    made = []
    for group, rows in enumerate((slice(0, 55), slice(55, None))):
        for channel in NOISE:
            number = numbers[rows]
            n = number.size
            initial = InitialStates(rng.standard_normal((n, 2)), number, about[number])
            left = rng.standard_normal(n) - np.einsum("nk,nk->n", initial.derivatives, about[number])
            made.append(Stream(channel, group, left, rng.standard_normal((n, 3)), initial=initial))
    return made


def dense(streams, noise):
    """Residual about rest, columns, derivatives by every initial state and level in units of their standard deviations, all whitened and
    stacked: the levels last, of each group and channel in turn."""
    white = [whitening(noise[s.channel], s.residual.size) for s in streams]
    placed = []
    for s in streams:
        own = np.zeros((s.residual.size, 6 + 4))
        for i, number in enumerate(s.initial.number):
            own[i, 2 * number : 2 * number + 2] = s.initial.derivatives[i]
        own[:, 6 + 2 * s.group + list(noise).index(s.channel)] = noise[s.channel].level
        placed.append(own)
    w = block_diag(*white)
    at_rest = [s.residual + np.einsum("nk,nk->n", s.initial.derivatives, s.initial.values) for s in streams]
    r, c = np.concatenate(at_rest), np.concatenate([s.columns for s in streams])
    return w @ r, w @ c, w @ np.concatenate(placed)


def test_normal_equations_are_those_of_least_squares_with_the_covariance_of_the_random_effects(streams, noise):
    r, c, n = dense(streams, noise)
    inverse = np.linalg.inv(np.eye(r.size) + n @ n.T)
    hessian, score = whiten(streams, noise, 10).information()
    assert hessian == pytest.approx(c.T @ inverse @ c, rel=1e-9)
    assert score == pytest.approx(c.T @ inverse @ r, rel=1e-9, abs=1e-9)


def test_misfit_and_determinant_are_those_of_the_marginal_likelihood(streams, noise):
    r, _, n = dense(streams, noise)
    covariance = np.eye(r.size) + n @ n.T
    square, log_determinant = misfit_of(streams, noise)
    assert square == pytest.approx(r @ np.linalg.solve(covariance, r), rel=1e-9)
    assert log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)


def test_rows_of_predictions_are_of_the_block_that_the_states_begin_in(streams):
    rows = whiten(streams, NOISE, 10)
    predictions = rows.channel == ""
    assert predictions.sum() == 6
    assert rows.block[predictions].tolist() == [0, 0, 3, 3, 6, 6]


def test_residuals_beside_random_effects_lack_what_these_explain(streams, noise):
    r, _, n = dense(streams, noise)
    effects = np.linalg.solve(n.T @ n + np.eye(10), n.T @ r)
    states, levels = effects[:6].reshape(3, 2), effects[6:].reshape(2, 2)
    left = beside_random_effects(streams, noise)
    for before, after in zip(streams, left, strict=True):
        own = states[before.initial.number] - before.initial.values
        explained = np.einsum("nk,nk->n", before.initial.derivatives, own)
        explained += noise[before.channel].level * levels[before.group, list(noise).index(before.channel)]
        assert after.residual == pytest.approx(before.residual - explained, abs=1e-9)
        assert not after.initial


def test_predicted_states_are_those_beside_the_levels(streams, noise):
    r, c, n = dense(streams, noise)
    states = whiten(streams, noise, 10).states
    for k, regressand in enumerate((r, *c.T)):
        effects = np.linalg.solve(n.T @ n + np.eye(10), n.T @ regressand)[:6].reshape(3, 2)
        assert states.steps[..., k] + (states.values if k == 0 else 0.0) == pytest.approx(effects, abs=1e-9)


def test_noise_is_of_what_varies_in_a_group(streams):
    """What stays in a group is its level's: it makes the noise neither larger nor slower."""
    level = {0: 5.0, 1: -3.0}
    apart = [replace(s, residual=s.residual + level[s.group]) for s in streams]
    for found, known in zip(noises(apart, {"a": 0.4}).values(), noises(streams).values(), strict=True):
        assert found.coefficients == pytest.approx(known.coefficients)
        assert found.std == pytest.approx(known.std)
    assert [one.level for one in noises(apart, {"a": 0.4}).values()] == [0.4, 0.0]
    assert without_levels(noises(apart, {"a": 0.4}))["a"].level == 0.0


def test_equations_without_initial_states_are_left_as_they_are(streams):
    plain = [Stream(s.channel, s.group, s.residual, s.columns) for s in streams]
    square, log_determinant = misfit_of(plain, NOISE)
    assert log_determinant == 0.0
    assert square == pytest.approx(sum(np.sum(NOISE[s.channel].whitened(s.residual) ** 2) for s in plain))
    assert (whiten(plain, NOISE, 10).channel != "").all()
