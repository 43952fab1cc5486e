"""What the equations may err is in the intervals, and not in the scatter by which two fits of like flights differ."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.estimation.uncertainty.discrepancy import discrepancy_covariance
from flighttest.identify.fit import fit
from tests.identify.campaign import TRUTH, campaign


@pytest.fixture(scope="module")
def yaw():
    return [s for s in campaign(7, thrust_repeats=0, tilt_repeats=0, yaw_repeats=6) if s.kind == "yaw_rate_step"]


def slower(segments, size):
    """The same flights of a vehicle whose rate comes up in another shape, in all cells alike."""
    made = []
    for s in segments:
        since = np.maximum(s.t_s - s.t_step_s - TRUTH["T_d"], 0.0)
        shape = since * np.exp(-since * TRUTH["sigma_r"])
        made.append(replace(s, y={**s.y, "r_rad_s": s.y["r_rad_s"] - s.cell["rate_rad_s"] * size * shape}))
    return made


def test_an_error_that_all_cells_share_is_in_the_interval_and_in_no_scatter(yaw):
    found = fit(slower(yaw, 2.0)).estimates["sigma_r"]
    off = abs(found.value - TRUTH["sigma_r"])
    assert off > 4 * found.scatter, "no spread between cells shows it"
    assert found.interval_95[0] < TRUTH["sigma_r"] < found.interval_95[1]


def test_more_repeats_leave_less_room_for_a_discrepancy(yaw):
    few = fit([s for s in yaw if s.repeat <= 2])
    many = fit(yaw)
    widths = [
        float(np.sqrt(discrepancy_covariance(one.problem, one.solution, ("sigma_r",))[0, 0])) for one in (few, many)
    ]
    assert 0.0 < widths[1] < widths[0]


def test_without_repeats_neighbouring_samples_take_their_place(yaw):
    once = fit([s for s in yaw if s.repeat == 1])
    again = fit(yaw)
    assert once.estimates["sigma_r"].std > 1.5 * once.estimates["sigma_r"].scatter
    assert once.estimates["sigma_r"].std > 1.5 * again.estimates["sigma_r"].std


def noisy(segments, std, seed):
    rng = np.random.default_rng(seed)
    return [replace(s, y={**s.y, "r_rad_s": s.y["r_rad_s"] + rng.normal(0.0, std, s.t_s.size)}) for s in segments]


def rates(found):
    """The part of the problem that compares yaw rates, and what was evaluated there."""
    return next(
        (part, made)
        for part, made in zip(found.problem.parts, found.solution.evaluations, strict=True)
        if part.outputs == ("r_rad_s",)
    )


def variance_of(found):
    """The discrepancy's variance in noise variances: one channel, one kind of maneuver."""
    k = found.covariance.names.index("sigma_r")
    own = discrepancy_covariance(found.problem, found.solution, found.covariance.names)[k, k]
    return own / (found.covariance.model[k, k] * rates(found)[0].mask.sum())


def test_behind_noise_the_equations_err_by_five_per_cent_of_the_response_at_most(yaw):
    found = fit(noisy(yaw, 3.0, 1))
    part, made = rates(found)
    modelled = np.where(part.mask, part.y - made.residual, np.nan)[..., 0]
    moved = np.nanmean((modelled - np.nanmean(modelled, axis=1, keepdims=True)) ** 2)
    assert variance_of(found) == pytest.approx(0.05**2 * moved / found.noise.channel["r_rad_s"] ** 2, rel=0.02)


def mean_of(dof_above, dof_below, seed=0):
    """What the variance ratio less one, where that is positive, is on the average, of equations that hold: what is observed is an F ratio,
    and what follows of the variance ratio is that one over another F ratio."""
    rng = np.random.default_rng(seed)
    observed, other = (rng.f(dof_above, dof_below, 200_000) for _ in range(2))
    return np.maximum(observed / other - 1.0, 0.0).mean()


@pytest.mark.slow
def test_of_equations_that_hold_the_variance_is_the_mean_of_what_an_analysis_of_variance_leaves_open(yaw):
    """White noise of std 1 in means over 0.1 s, of 5 samples, has variance 1/5; 24 of these in each of 4 cells, 6 repeats."""
    variances = [variance_of(fit(noisy(yaw, 0.05, seed))) for seed in range(16)]
    groups, repeats = 4 * 24, 6
    expected = 0.2 * mean_of(groups, groups * (repeats - 1)) / repeats
    assert np.mean(variances) == pytest.approx(expected, rel=0.3)


@pytest.mark.slow
def test_flown_once_white_noise_leaves_little_room_and_a_smooth_error_is_in_the_interval(yaw):
    """All of the residual was taken for an error of the equations where nothing was repeated: noise of 1 counted as 1."""
    once = [s for s in yaw if s.repeat == 1]
    variances = [variance_of(fit(noisy(once, 0.05, seed))) for seed in range(16)]
    pairs = rates(fit(noisy(once, 0.05, 0)))[0].mask.sum() / 2
    assert np.mean(variances) == pytest.approx(mean_of(pairs, pairs) / 2, rel=0.5)
    found = fit(noisy(slower(once, 2.0), 0.01, 0)).estimates["sigma_r"]
    assert abs(found.value - TRUTH["sigma_r"]) > 4 * found.scatter
    assert found.interval_95[0] < TRUTH["sigma_r"] < found.interval_95[1]
