"""The share of the discrepancy and the variance inflation, where both are known in closed form."""

import numpy as np
import pytest
from made_rows import autoregressive, responses, rows_of

from flighttest.diagnose.residuals.discrepancy import correlation_times, discrepancy_of
from flighttest.diagnose.residuals.lack_of_fit import floor_of

CELLS, REPEATS, EACH = 10, 4, 50
SEGMENTS = CELLS * REPEATS


def known(x, repeats=REPEATS):
    """Discrepancy of the one channel of residuals (responses, samples)."""
    segments = responses(x.shape[0], x.shape[1], repeats)
    rows = rows_of(x.ravel(), np.zeros((x.size, 0)), x.shape[0])
    return discrepancy_of(rows, rows.residual, segments, floor_of(rows, segments, {})), rows, segments


@pytest.mark.parametrize("common", [0.5, 1.0, 3.0])
def test_the_share_of_the_discrepancy_is_that_of_reml_in_a_one_way_layout(rng, common):
    # One number per response, so that the layout is the textbook's: cell and repeat, both random, mean known to be zero.
    y = np.repeat(common * rng.normal(size=CELLS), REPEATS).reshape(CELLS, REPEATS) + 0.3 * rng.normal(
        size=(CELLS, REPEATS)
    )
    within = np.sum((y - y.mean(axis=1, keepdims=True)) ** 2) / (CELLS * (REPEATS - 1))
    between = (REPEATS * np.mean(y.mean(axis=1) ** 2) - within) / REPEATS
    found, _, _ = known(np.repeat(y.reshape(-1, 1), EACH, axis=1))
    assert found.share[0] == pytest.approx(between / (between + within), abs=1e-6)
    assert found.variance[0] == pytest.approx(between + within)


@pytest.mark.parametrize("rho", [0.9, 0.97])
def test_the_share_of_a_discrepancy_that_changes_within_responses(rng, rho):
    cells = np.repeat(autoregressive(rng, (CELLS, EACH), rho), REPEATS, axis=0)
    found, _, _ = known(cells + autoregressive(rng, (SEGMENTS, EACH), rho))
    assert found.share[0] == pytest.approx(0.5, abs=0.1)


def test_where_nothing_is_missing_samples_count_by_their_correlation_time(rng):
    x = autoregressive(rng, (SEGMENTS, EACH), 0.8)
    found, rows, segments = known(x)
    assert found.share[0] == 0.0
    assert found.inflation[0] == correlation_times(rows, rows.residual, segments)[0]
    assert found.inflation[0] == pytest.approx(9.0, rel=0.2)
    np.testing.assert_allclose(found.weights(rows), 1.0 / (found.variance[0] * found.inflation[0]))


def test_where_all_is_discrepancy_a_cell_counts_once(rng):
    phase = rng.uniform(0, 2 * np.pi, (CELLS, 1))
    x = np.repeat(np.sin(np.arange(EACH) / 12.0 + phase), REPEATS, axis=0)
    found, _, _ = known(x + 1e-6 * rng.normal(size=x.shape))
    assert found.share[0] == pytest.approx(1.0, abs=1e-3)
    assert found.inflation[0] == pytest.approx(REPEATS * EACH, rel=1e-2)


def test_between_both_ends_the_inflation_is_their_weighted_mean(rng):
    x = np.repeat(autoregressive(rng, (CELLS, EACH), 0.9), REPEATS, axis=0) + autoregressive(rng, (SEGMENTS, EACH), 0.9)
    found, rows, segments = known(x)
    f, tau = found.share[0], correlation_times(rows, rows.residual, segments)[0]
    assert 0.3 < f < 0.7
    assert found.inflation[0] == pytest.approx((1 - f) * tau + f * REPEATS * EACH)


def test_more_repeats_say_more_of_the_noise_only(rng):
    def information(repeats):
        g = np.repeat(autoregressive(np.random.default_rng(5), (CELLS, EACH), 0.9), repeats, axis=0)
        found, rows, _ = known(g + 0.5 * autoregressive(rng, g.shape, 0.9), repeats)
        return float(found.weights(rows).sum())

    assert information(16) < 1.25 * information(4)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 0.9])
def test_the_correlation_time_of_a_first_order_process(rng, rho):
    x = autoregressive(rng, (200, 400), rho)
    segments, rows = responses(200, 400), rows_of(x.ravel(), np.zeros((x.size, 0)), 200)
    tau = correlation_times(rows, rows.residual, segments)[0]
    # The sum ends where the correlation falls below 0.05, which leaves out a twentieth.
    expected = (1 + rho) / (1 - rho)
    assert 0.925 * expected < tau < 1.06 * expected


def test_a_channel_that_errs_alike_in_all_repeats_is_correlated_beyond_a_response(rng):
    alone = autoregressive(rng, (SEGMENTS, EACH), 0.8)
    shared = np.repeat(autoregressive(rng, (CELLS, EACH), 0.8), REPEATS, axis=0)
    times = []
    for x in (alone, shared):
        rows = rows_of(x.ravel(), np.zeros((x.size, 0)), SEGMENTS)
        times.append(correlation_times(rows, rows.residual, responses(SEGMENTS, EACH, REPEATS))[0])
    assert times[1] == pytest.approx(REPEATS * times[0], rel=0.35)
