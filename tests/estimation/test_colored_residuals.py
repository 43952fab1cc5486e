"""What correlation of residuals in time makes of standard errors, against repeated draws and the limit of the textbooks."""

from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.estimation.likelihood_weights import Normal, State
from flighttest.estimation.uncertainty.colored_residuals import colored_residuals

NAMES = ("step", "wave")
AT = State(np.zeros(0), [], [])


def autoregressive(rng, rows, samples, rho):
    """(rows, samples) of variance one."""
    e = rng.standard_normal((rows, samples))
    for k in range(1, samples):
        e[:, k] = rho * e[:, k - 1] + np.sqrt(1.0 - rho**2) * e[:, k]
    return e


def sensitivities(rows, samples):
    """A step that fades and a quick wave, each without its mean, as a disturbance of each response leaves them: (rows, samples, 1, 2)."""
    t = np.arange(samples) / 50.0
    both = np.stack([np.exp(-2.0 * t), np.sin(20.0 * t)], axis=1)
    return np.tile((both - both.mean(axis=0))[None, :, None, :], (rows, 1, 1, 1))


def found_of(residual, jacobian, mask=None, correlation=None):
    """As of one part with one output, (m, n) whitened residuals and their sensitivities (m, n, 1, p)."""
    mask = np.ones(residual.shape, bool) if mask is None else mask
    part = SimpleNamespace(outputs=("v_x_m_s",), mask=mask[..., None])
    weighing = SimpleNamespace(
        problem=SimpleNamespace(parts=[part]),
        noise=SimpleNamespace(correlation=correlation or {}),
        profiled=lambda at, active: [(residual[..., None], jacobian)],
    )
    flat = jacobian[mask].reshape(-1, jacobian.shape[-1])
    names = NAMES[: flat.shape[1]]
    return colored_residuals(weighing, AT, Normal(names, (flat.T @ flat)[None], np.zeros((1, len(names)))), names)


def test_standard_errors_are_the_scatter_of_repeated_flights():
    rng = np.random.default_rng(1)
    jacobian = sensitivities(12, 150)
    flat = jacobian.reshape(-1, 2)
    white = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)))
    errors, claimed = [], []
    for _ in range(300):
        noise = autoregressive(rng, 12, 150, 0.9)
        theta = np.linalg.lstsq(flat, noise.ravel(), rcond=None)[0]
        left = noise - (jacobian[:, :, 0] @ theta)
        errors.append(theta)
        claimed.append(found_of(left, jacobian).inflation)
    scatter = np.std(errors, axis=0) / white
    assert np.sqrt(np.median(claimed, axis=0)) == pytest.approx(scatter, rel=0.15)
    assert scatter[0] > 1.5 * scatter[1], "noise of low frequency moves what changes slowly"


def test_an_influence_that_never_changes_has_the_factor_of_frequency_zero():
    noise = autoregressive(np.random.default_rng(2), 300, 500, 0.8)
    assert found_of(noise, np.ones((300, 500, 1, 1))).inflation[0] == pytest.approx(9.0, rel=0.15)


def test_white_residuals_add_nothing_and_their_samples_count_each():
    rng = np.random.default_rng(3)
    found = found_of(rng.standard_normal((12, 150)), sensitivities(12, 150))
    assert found.inflation == pytest.approx([1.0, 1.0], abs=0.35)
    assert found.inflation.min() >= 1.0
    assert found.dof.min() > 800.0, "of 1800 samples; what chance adds to the correlations at long lags takes some"
    assert found_of(autoregressive(rng, 12, 150, 0.9), sensitivities(12, 150)).dof.max() < 400.0


def test_samples_that_are_missing_do_not_hide_correlation():
    rng = np.random.default_rng(4)
    noise = np.repeat(rng.standard_normal((40, 100)), 10, axis=1)
    mask = np.zeros(noise.shape, bool)
    mask[:, ::2] = True
    found = found_of(np.where(mask, noise, 0.0), np.where(mask, 1.0, 0.0)[..., None, None], mask)
    assert found.inflation[0] == pytest.approx(5.0, rel=0.25), "five that were measured are alike"


def test_correlation_that_the_weights_contain_counts_once():
    noise = autoregressive(np.random.default_rng(5), 300, 500, 0.8)
    found = found_of(noise / 3.0, np.ones((300, 500, 1, 1)), correlation={"v_x_m_s": 9.0})
    assert found.inflation[0] == pytest.approx(1.0, abs=0.15)


def test_an_output_that_left_no_residual_adds_none():
    found = found_of(np.zeros((3, 50)), sensitivities(3, 50))
    assert found.inflation == pytest.approx([1.0, 1.0])
