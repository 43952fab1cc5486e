"""Whitened least squares: against closed forms, and against ordinary least squares where a loop answers the noise."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from flighttest.estimation.equation_error import (
    Autoregression,
    Stream,
    autoregression,
    block_covariances,
    heterogeneity,
    lack_of_fit,
    log_scale,
    noises,
    second_order,
    step,
    whiten,
)


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


def test_a_noise_whose_spectrum_falls_by_decades_is_described_to_its_least():
    """An attitude in gusts, sampled at 50 Hz. By the autocovariance its innovations came out six times as large, and the likelihood of a
    model with a further term as 2300 nats less than without."""
    rng = np.random.default_rng(5)
    e, w = np.zeros(6000), rng.standard_normal(6000)
    a = np.poly([0.995, 0.99, 0.9 + 0.2j, 0.9 - 0.2j]).real
    for k in range(4, e.size):
        e[k] = w[k] - a[1:] @ e[k - 4 : k][::-1]
    assert autoregression([e[:3000], e[3000:]]).std == pytest.approx(1.0, rel=0.1)


def test_of_several_stretches_only_samples_of_one_are_paired():
    """Against Burg's recursion stretch by stretch, as a textbook has it."""
    rng = np.random.default_rng(9)
    stretches = [coloured(rng, n) + 5.0 * k for k, n in enumerate((400, 9, 60, 7, 900))]
    forward, backward = [s[1:] for s in stretches], [s[:-1] for s in stretches]
    of_order = [np.ones(1)]
    for _ in range(12):
        product = sum(f @ b for f, b in zip(forward, backward, strict=True))
        reflection = -2.0 * product / sum(f @ f + b @ b for f, b in zip(forward, backward, strict=True))
        longer = np.append(of_order[-1], 0.0)
        of_order.append(longer + reflection * longer[::-1])
        pairs = [(f + reflection * b, b + reflection * f) for f, b in zip(forward, backward, strict=True)]
        forward, backward = [f[1:] for f, _ in pairs], [b[:-1] for _, b in pairs]
    found = autoregression(stretches, most=12)
    assert found.order > 1
    assert found.coefficients == pytest.approx(of_order[found.order])


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


def test_a_prior_keeps_its_size_beside_innovations_that_count_too_often():
    """Every sample four times: estimates err twice as much as the information says. The posterior is that of single samples."""
    rng = np.random.default_rng(8)
    x, e, slope = rng.standard_normal(2000), rng.standard_normal(2000), 0.05
    once, every = (Stream("y", 0, np.repeat(slope * x + e, k), np.repeat(x, k)[:, None]) for k in (1, 4))
    white = {"y": Autoregression(np.array([1.0]), 1.0)}
    plain = step(whiten([once], white, 50), np.zeros(1), np.array([0.02]))
    counted = step(whiten([every], white, 200), np.zeros(1), np.array([0.02 / 2.0]), inflation=4.0)
    assert counted.delta == pytest.approx(plain.delta)
    assert counted.robust[0, 0] == pytest.approx(plain.robust[0, 0], rel=0.15)


def test_a_direction_without_information_has_no_variance():
    stream = Stream("y", 0, np.random.default_rng(5).standard_normal(400), np.zeros((400, 2)))
    stream.columns[:, 0] = np.sin(np.arange(400.0))
    made = step(whiten([stream], noises([stream]), 50), np.zeros(2), np.full(2, np.inf))
    assert np.isfinite(made.covariance[0, 0])
    assert np.isinf(made.covariance[1, 1])


def test_what_blocks_show_is_as_uncertain_as_estimates_without_each_of_them_differ():
    """Against the estimates themselves, with a prior."""
    rng = np.random.default_rng(15)
    x, y, block = rng.standard_normal((60, 3)) * [1.0, 10.0, 0.1], rng.standard_normal(60), np.repeat(np.arange(6), 10)
    prior = np.diag([0.0, 4.0, 0.0])

    def estimate(kept: np.ndarray) -> np.ndarray:
        return np.linalg.solve(x[kept].T @ x[kept] + prior, x[kept].T @ y[kept])

    apart = np.array([estimate(block != k) for k in range(6)]) - estimate(block >= 0)
    left, shuffled = y - x @ estimate(block >= 0), rng.permutation(60)
    found = block_covariances(x[shuffled], left[shuffled], block[shuffled], x.T @ x + prior)
    assert found.left_out == pytest.approx(5.0 / 6.0 * apart.T @ apart)
    assert not found.alone.any()


def test_of_white_rows_the_covariance_that_is_expected_is_that_of_the_information():
    """However unlike the blocks: the scores at the estimate alone make it a third too small here."""
    rng = np.random.default_rng(17)
    block = np.repeat(np.arange(8), 5)
    x = rng.standard_normal((40, 3)) * np.where(block == 2, 6.0, 1.0)[:, None]
    full = x.T @ x
    rows = rng.standard_normal((4000, 40))
    left = rows - rows @ x @ np.linalg.solve(full, x.T)
    mean = np.mean([block_covariances(x, one, block, full).unbiased for one in left], axis=0)
    assert mean == pytest.approx(np.linalg.inv(full), abs=0.06 * np.linalg.inv(full).max())


def test_what_a_single_block_shows_has_no_robust_variance():
    """That block fits its own parameter, whatever its noise."""
    rng = np.random.default_rng(16)
    columns = np.column_stack([np.ones(400), np.where(np.arange(400) // 50 == 3, rng.standard_normal(400), 0.0)])
    stream = Stream("y", 0, rng.standard_normal(400), columns)
    white = {"y": Autoregression(np.array([1.0]), 1.0)}
    made = step(whiten([stream], white, 50), np.zeros(2), np.full(2, np.inf))
    assert np.isfinite(made.covariance).all()
    assert np.isfinite(made.robust[0, 0])
    assert np.isinf(made.robust[1, 1])
    known = step(whiten([stream], white, 50), np.zeros(2), np.array([np.inf, 0.1]))  # by its prior
    assert np.isfinite(known.robust).all()


@pytest.mark.parametrize(("apart", "known"), [(0.0, False), (0.003, True)])
def test_columns_that_are_alike_determine_neither_of_their_parameters(apart, known):
    rng = np.random.default_rng(18)
    one = rng.standard_normal(400)
    columns = np.column_stack([one, one + apart * rng.standard_normal(400)])
    white = {"y": Autoregression(np.array([1.0]), 1.0)}
    stream = Stream("y", 0, rng.standard_normal(400), columns)
    made = step(whiten([stream], white, 50), np.zeros(2), np.full(2, np.inf))
    for matrix in (made.covariance, made.robust):
        assert (np.isfinite(np.diag(matrix)) == known).all()


def flown(missing: float, seed: int = 6, n: int = 4000) -> Stream:
    """Residual of y = x + missing * x^2 + coloured noise beside a line in x, x slow."""
    rng = np.random.default_rng(seed)
    x = coloured(rng, n, (-0.98, 0.0))
    columns = np.column_stack([np.ones(n), x])
    y = missing * x**2 + coloured(rng, n)
    return Stream("y", 0, y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0], columns, x[:, None])


def test_second_order_functions_are_states_squares_and_products():
    state = np.random.default_rng(7).normal([1.0, -2.0], [1.0, 3.0], (50, 2))
    found = np.concatenate(second_order(state), axis=1)
    assert found.shape == (50, 5)
    assert found.std(axis=0) == pytest.approx(np.ones(5))
    assert abs(np.corrcoef(found[:, 3], ((state - state.mean(axis=0)) / state.std(axis=0)).prod(axis=1))[0, 1]) > 0.999


def test_equations_that_are_right_have_no_lack_of_fit():
    ratios = [lack_of_fit([s], noises([s]))["y"].ratio for s in (flown(0.0, seed) for seed in range(40))]
    assert np.mean(ratios) == pytest.approx(
        1.0 + np.sqrt(2.0 / np.pi) / 2.0, abs=0.5
    )  # one function: chi-square, at least 1
    assert min(ratios) == 1.0


def test_what_equations_get_wrong_as_a_function_of_the_state_is_lack_of_fit():
    """A missing square that explains 10 % of the residual; noise of the same size does not recur with the state."""
    wrong = flown(0.05)
    ratio = lack_of_fit([wrong], noises([wrong]))["y"].ratio
    more = second_order(wrong.state)[1][:, 0]
    noise = noises([wrong])["y"]
    explained = np.corrcoef(noise.whitened(more), noise.whitened(wrong.residual))[0, 1] ** 2 * noise.whitened(more).size
    assert ratio == pytest.approx(explained, rel=0.1)
    assert ratio > 5.0


def test_functions_that_are_parameters_already_are_no_lack_of_fit():
    s = flown(0.0)
    square = (s.state**2)[:, :1]
    held = Stream("y", 0, s.residual, np.column_stack([s.columns, square]), s.state)
    assert lack_of_fit([held], noises([held]))["y"].ratio == 1.0


def test_only_what_functions_of_the_state_make_of_a_column_errs_with_them():
    """A moment of the air acts over seconds, and what loops get wrong of a step over tenths: its intervals are not wider for it."""
    s = flown(0.05)
    other = np.random.default_rng(9).standard_normal(s.residual.size)
    beside = Stream("y", 0, s.residual, np.column_stack([s.columns, other]), s.state)
    noise = noises([beside])
    columns, lack = noise["y"].whitened(beside.columns), lack_of_fit([beside], noise)["y"]
    share = np.diag(lack.excess) / (lack.ratio - 1.0) / np.sum(columns**2, axis=0)
    assert share[1] == pytest.approx(1.0, abs=0.01)
    assert share[2] < 0.01


def test_linear_functions_of_the_state_err_by_their_own_lack_of_fit():
    """A loop holds 5 % more than its reference, and nothing is wrong with its squares: one F of two states and their three products was a
    fifth of that of the angle itself. Where products are wrong and linear functions are parameters, F is that of both."""
    rng = np.random.default_rng(12)
    state = np.column_stack([coloured(rng, 4000, (-0.98, 0.0)) for _ in range(2)])
    state -= state.mean(axis=0)
    along = state[:, 1:]  # of a parameter that is a linear function of the second
    wrong = Stream("y", 0, 0.05 * state[:, 0] + coloured(rng, 4000), along, state)
    noise = noises([wrong])
    lack = lack_of_fit([wrong], noise)["y"]
    own = float(np.diag(lack.excess)[0] / np.sum(noise["y"].whitened(along) ** 2))
    assert own == pytest.approx(4.0 * lack.ratio, rel=0.2)  # of four functions beside the parameter three are products
    square = Stream("y", 0, 0.05 * state[:, 0] ** 2 + coloured(rng, 4000), state, state)
    lack, white = lack_of_fit([square], noises([square]))["y"], noises([square])["y"].whitened(state)
    assert lack.ratio > 5.0
    assert np.diag(lack.excess) == pytest.approx((lack.ratio - 1.0) * np.sum(white**2, axis=0), rel=0.01)


def test_every_sample_is_whitened_by_what_is_known_before_it():
    """Against the Cholesky factor of the covariance of a stationary noise. Without its first samples a noise of 40 lags had 111 nats more
    than one of 17 on tunnel flights, at the same parameters."""
    noise = Autoregression(np.array([1.0, -1.5, 0.9, -0.2]), 0.3)
    answer = lfilter([0.3], noise.coefficients, np.eye(1, 4000)[0])
    covariance = toeplitz([answer[: 4000 - k] @ answer[k:] for k in range(80)])
    root, values = np.linalg.cholesky(covariance), np.random.default_rng(4).standard_normal((80, 2))
    assert noise.whitened(values) == pytest.approx(np.linalg.solve(root, values))
    assert noise.whitened(values[:, 0]) == pytest.approx(np.linalg.solve(root, values[:, 0]))
    assert noise.whitened(values[:, :0]).shape == (80, 0)
    assert noise.whitened(values[:2]) == pytest.approx(
        np.linalg.solve(root[:2, :2], values[:2])
    )  # shorter than its order
    assert noise.log_scale(80) == pytest.approx(np.sum(np.log(np.diag(root))))


@pytest.mark.parametrize("std", [0.1, 10.0])
def test_orders_of_the_noise_are_compared_on_the_same_samples(std):
    """White noise has one likelihood, whatever order describes it; 40 samples that only start a filter were 92 nats at a std of 0.1. Each
    coefficient counts for one."""
    s = Stream("y", 0, std * np.random.default_rng(8).standard_normal(2000), np.zeros((2000, 0)))
    found = []
    for order in (0, 40):
        noise = {"y": Autoregression(np.eye(1, order + 1)[0], std)}
        found.append(-log_scale([s], noise) - 0.5 * np.sum(noise["y"].whitened(s.residual) ** 2))
    assert found[1] == pytest.approx(found[0] - 40.0, abs=3.0 * np.sqrt(40 / 2))


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-100, 1e-12])
def test_a_channel_that_is_stuck_does_not_weigh_more_than_can_be_squared(size):
    """A constant accelerometer was modelled to within 1e-160 m/s^2; its normal equations overflowed, and a fit ended in a traceback."""
    found = autoregression([size * np.random.default_rng(3).standard_normal(500)])
    assert found.std == pytest.approx(1e-9)
    assert autoregression([1e-6 * np.random.default_rng(3).standard_normal(500)]).std == pytest.approx(1e-6, rel=0.2)
