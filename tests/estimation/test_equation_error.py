"""Whitened least squares: against closed forms, and against ordinary least squares where a loop answers the noise."""

import numpy as np
import pytest

from flighttest.estimation.equation_error import Stream, autoregression, heterogeneity, noises, step, whiten


def coloured(rng: np.random.Generator, n: int, a: tuple[float, ...] = (-1.6, 0.7)) -> np.ndarray:
    e, w = np.zeros(n), rng.standard_normal(n)
    for k in range(2, n):
        e[k] = w[k] - a[0] * e[k - 1] - a[1] * e[k - 2]
    return e


def test_the_coefficients_of_a_known_autoregression_are_found():
    found = autoregression([coloured(np.random.default_rng(1), 20000)])
    assert found.coefficients[:3] == pytest.approx([1.0, -1.6, 0.7], abs=0.03)
    assert found.std == pytest.approx(1.0, rel=0.02)
    left = found.whitened(coloured(np.random.default_rng(2), 20000))
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 0.03


def test_its_spectrum_holds_the_variance():
    e = coloured(np.random.default_rng(3), 50000)
    found = autoregression([e])
    f = np.linspace(0.0, 25.0, 4000)
    assert np.trapezoid(found.spectrum(f, 0.02), f) == pytest.approx(e.var(), rel=0.1)


def answered(n: int = 6000, seeds: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """y = 2 u + e with u = reference - 0.3 e of the sample before: (by ordinary least squares, whitened), one row per seed."""
    ordinary, whitened = [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        e = coloured(rng, n, (-0.95, 0.0))
        u = 0.5 * rng.standard_normal(n) - 0.3 * np.concatenate([[0.0], e[:-1]])
        y = 2.0 * u + e
        ordinary.append(float(u @ y / (u @ u)))
        value = 0.0
        for _ in range(6):
            stream = Stream("y", 0, y - value * u, u[:, None])
            value += float(step(whiten([stream], noises([stream]), 100), np.zeros(1), np.full(1, np.inf)).delta[0])
        whitened.append(value)
    return np.array(ordinary), np.array(whitened)


def test_a_loop_that_answers_the_noise_does_not_bias_the_whitened_estimate():
    ordinary, whitened = answered()
    assert abs(ordinary.mean() - 2.0) > 0.5
    assert whitened.mean() == pytest.approx(2.0, abs=0.03)


def test_flights_that_differ_in_a_shared_parameter_widen_what_depends_on_it():
    rng = np.random.default_rng(4)
    slopes, n = [1.0, 1.3, 0.7, 1.1], 800
    streams = []
    for g, slope in enumerate(slopes):
        x = rng.standard_normal(n)
        columns = np.zeros((n, 5))
        columns[:, 0], columns[:, 1 + g] = x + 2.0, 1.0
        streams.append(Stream("y", g, slope * (x + 2.0) - (x + 2.0) + 0.1 * rng.standard_normal(n), columns))
    rows = whiten(streams, noises(streams), 100)
    own = np.array([False, True, True, True, True])
    spread, extra = heterogeneity(rows, own, np.full(5, np.inf))
    assert spread[0] == pytest.approx(np.std(slopes, ddof=1), rel=0.3)
    assert np.sqrt(extra[1, 1]) == pytest.approx(
        2.0 * spread[0], rel=0.1
    )  # the constant makes up for the slope at a mean of 2
    alike = [Stream("y", s.group, 0.1 * rng.standard_normal(n), s.columns) for s in streams]
    quiet, _ = heterogeneity(whiten(alike, noises(alike), 100), own, np.full(5, np.inf))
    assert quiet[0] < 0.1 * spread[0]


def test_a_direction_without_information_has_no_variance():
    stream = Stream("y", 0, np.random.default_rng(5).standard_normal(400), np.zeros((400, 2)))
    stream.columns[:, 0] = np.sin(np.arange(400.0))
    made = step(whiten([stream], noises([stream]), 50), np.zeros(2), np.full(2, np.inf))
    assert np.isfinite(made.covariance[0, 0])
    assert np.isinf(made.covariance[1, 1])
