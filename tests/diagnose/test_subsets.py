"""Marginal likelihoods of subsets against exact ones, and what their ranking finds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_rows import rows_of
from scipy import integrate, stats

from flighttest.diagnose.residuals.discrepancy import Discrepancy
from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor
from flighttest.diagnose.selection.candidates import Candidate, grid
from flighttest.diagnose.selection.comparison import log_odds_asked
from flighttest.diagnose.selection.subsets import Subsets
from flighttest.physics.catalogue import catalogue

N = 60


def param(name, nominal=1.0, one_sided=False):
    return SimpleNamespace(name=name, nominal=nominal, off=0.0, one_sided=one_sided, prior_std=3.0 * abs(nominal))


def candidate(name, columns, shape=None, family="propulsion", **how):
    columns = np.asarray(columns, dtype=float).reshape(len(columns), -1)
    names = tuple(f"{name}{k}" for k in range(columns.shape[1]))
    term = SimpleNamespace(states=(), id=name, family=family, params=tuple(param(n, **how) for n in names))
    return Candidate(term, shape or {}, names, columns, lambda: columns)


def subsets(residual, base, candidates, floor=1e6, inflation=1.0, variance=1.0):
    """Of one channel with as many effective samples as rows; a high floor makes its variance a known one."""
    rows = rows_of(residual, base, segments=1)
    n = float(residual.size)
    known = Discrepancy(np.array([variance, 1.0]), np.zeros(2), np.array([inflation, 1.0]), np.array([n, 0.0]))
    noise = NoiseFloor({"f_z_m_s2": floor, "v_z_m_s": 1.0}, frozenset(), {})
    return Subsets.at(rows, rows.names, candidates, known, noise)


def exact(residual, base, columns, prior_std, inflation=1.0):
    """Log odds of a linear model over the base alone, variance one: restricted to what the base cannot reach."""
    q = np.linalg.svd(base, full_matrices=True)[0][:, base.shape[1] :] if base.shape[1] else np.eye(len(residual))
    y, a = q.T @ residual / np.sqrt(inflation), q.T @ columns / np.sqrt(inflation)
    zero = np.zeros(y.size)
    with_it = stats.multivariate_normal(zero, np.eye(y.size) + (a * prior_std**2) @ a.T).logpdf(y)
    return with_it - stats.multivariate_normal(zero, np.eye(y.size)).logpdf(y)


@pytest.mark.parametrize("inflation", [1.0, 7.0])
def test_a_marginal_likelihood_of_known_variance_is_exact(rng, inflation):
    base, a, b = rng.normal(size=(N, 2)), rng.normal(size=(N, 2)), rng.normal(size=(N, 1))
    residual = 0.4 * a[:, 0] - 0.3 * b[:, 0] + rng.normal(size=N)
    # The floor is the variance that rows were whitened by: no subset can be below it.
    found = subsets(residual, base, [candidate("a", a), candidate("b", b)], floor=1.0, inflation=inflation)
    found.now[:], found.least[:], found.size[:] = 1.0, 1.0, 0.0  # all variances known, as those of priors are
    for members, columns in (((0,), a), ((1,), b), ((0, 1), np.hstack([a, b]))):
        (scored,) = found.score([members])
        catalogue_odds = len(members) * np.log(2.0)
        expected = exact(residual, base, columns, 3.0, inflation) - catalogue_odds
        assert scored.log_odds == pytest.approx(expected, abs=1e-8)


def test_a_variance_at_its_floor_counts_as_a_known_one(rng):
    base, a = rng.normal(size=(N, 2)), rng.normal(size=(N, 1))
    residual = 0.2 * a[:, 0] + 0.1 * rng.normal(size=N)
    found = subsets(residual, base, [candidate("a", a)], floor=1.0)
    assert found.now[0] == 1.0
    (scored,) = found.score([(0,)])
    assert scored.log_odds == pytest.approx(exact(residual, base, a, 3.0), abs=1e-8)


def test_a_free_variance_is_profiled(rng):
    """Of many samples, with a weak prior, half the change of n log v."""
    n = 4000
    a = rng.normal(size=(n, 1))
    residual = 0.5 * a[:, 0] + rng.normal(size=n)
    found = subsets(residual, np.zeros((n, 0)), [candidate("a", a)], floor=1e-3)
    (scored,) = found.score([(0,)])
    left = residual - a[:, 0] * (a[:, 0] @ residual) / (a[:, 0] @ a[:, 0])
    gain = 0.5 * n * np.log((residual @ residual) / (left @ left))
    occam = 0.5 * np.log(1 + 9.0 * (a[:, 0] @ a[:, 0]) / (left @ left / n))
    assert scored.log_odds == pytest.approx(gain - occam - 0.5 * (0.5 / 3.0) ** 2, abs=0.1)


@pytest.mark.parametrize(
    ("families", "counts"), [(("propulsion",), False), (("sensor",), True), (("propulsion", "sensor"), False)]
)
def test_what_only_the_velocity_shows_is_proposed_for_an_instrument_alone(rng, families, counts):
    """Specific force is recorded: the first half of the rows."""
    n = 400
    channel = np.repeat([0, 1], n // 2)
    a = rng.normal(size=(n, len(families))) * channel[:, None]
    rows = rows_of(a.sum(axis=1) + 0.3 * rng.normal(size=n), np.zeros((n, 0)), segments=1, channel=channel)
    known = Discrepancy(np.ones(2), np.zeros(2), np.ones(2), np.array([n / 2, n / 2]))
    of = [candidate(f"c{j}", a[:, [j]], family=family) for j, family in enumerate(families)]
    found = Subsets.at(rows, rows.names, of, known, NoiseFloor(dict.fromkeys(rows.channels, 0.1), frozenset(), {}))
    (scored,) = found.score([tuple(range(len(of)))])
    assert (scored.log_odds > 0.0) is counts


@pytest.mark.parametrize("size", [0.6, 0.1, -0.1, -0.6])
def test_a_one_sided_prior_is_a_half_normal_and_penalises_the_wrong_side(rng, size):
    a = rng.normal(size=(N, 1))
    residual = size * a[:, 0] + rng.normal(size=N)
    found = subsets(residual, np.zeros((N, 0)), [candidate("a", a, one_sided=True)], floor=1.0)
    found.now[:], found.least[:], found.size[:] = 1.0, 1.0, 0.0
    (scored,) = found.score([(0,)])

    def density(x):
        gain = x * (a[:, 0] @ residual) - 0.5 * x**2 * (a[:, 0] @ a[:, 0])
        return 2.0 * stats.norm(0.0, 3.0).pdf(x) * np.exp(gain)

    assert scored.log_odds == pytest.approx(np.log(integrate.quad(density, 0.0, 3.0, points=[0.3])[0]), abs=1e-4)
    if size < -0.5:
        assert scored.log_odds < 0.0


def test_a_prior_is_three_usual_sizes_wide():
    wind = catalogue()["steady_wind"]
    names = tuple(p.name for p in wind.amplitudes)
    c = Candidate(wind, {}, names, np.zeros((1, len(names))), lambda: np.zeros((1, len(names))))
    np.testing.assert_allclose(c.prior_std, [3.0 * abs(p.nominal) for p in wind.amplitudes])


def test_prior_odds_count_the_catalogue_and_the_grid(rng):
    a, b, rest = (rng.normal(size=(N, 1)) for _ in range(3))
    residual = rng.normal(size=N)
    alone = subsets(residual, np.zeros((N, 0)), [candidate("a", a)]).score([(0,)])[0].log_odds
    pool = [candidate("a", a), candidate("b", b), candidate("c", rest)]
    of_three = subsets(residual, np.zeros((N, 0)), pool).score([(0,)])[0].log_odds
    assert of_three == pytest.approx(alone - np.log(3))
    on_a_grid = [candidate("a", a, {"tau": 1.0}), candidate("a", 0.9 * a, {"tau": 2.0}), *pool[1:]]
    assert subsets(residual, np.zeros((N, 0)), on_a_grid).score([(0,)])[0].log_odds == pytest.approx(alone - np.log(6))
    (pair,) = subsets(residual, np.zeros((N, 0)), pool).score([(0, 1)])
    pair_alone = subsets(residual, np.zeros((N, 0)), [candidate("a", np.hstack([a, b]))]).score([(0,)])[0]
    assert pair.log_odds == pytest.approx(pair_alone.log_odds - 2 * np.log(3))


def test_a_pair_is_found_of_which_neither_shows_alone(rng):
    """Suppression: two nearly equal columns whose difference is the effect, beside a decoy that is a part of each."""
    n = 2000
    common, apart = rng.normal(size=n), rng.normal(size=n)
    a, b = common + 0.1 * apart, common - 0.1 * apart
    decoy = apart + 1.0 * rng.normal(size=n)
    residual = 0.2 * apart + 0.3 * rng.normal(size=n)  # a - b, in truth
    pool = [candidate("a", a), candidate("b", b), candidate("decoy", decoy), candidate("none", rng.normal(size=n))]
    found = subsets(residual, np.zeros((n, 0)), pool, floor=1e-3)
    ranked = found.ranked()
    assert found.terms(ranked[0]) == {"a", "b"}
    np.testing.assert_allclose(ranked[0].coefficients, [1.0, -1.0], atol=0.2)
    single = {next(iter(found.terms(s))): s.log_odds for s in ranked if len(s.members) == 1}
    assert max(single, key=single.get) == "decoy"  # what stepwise selection takes first
    assert single["a"] < single["decoy"] - 50
    assert single["b"] < single["decoy"] - 50


def test_subsets_of_up_to_three_hold_one_candidate_of_a_term(rng):
    columns = rng.normal(size=(500, 5))
    residual = columns[:, [0, 2, 4]] @ [0.5, -0.5, 0.5] + rng.normal(size=500)
    pool = [candidate("a", columns[:, 0], {"tau": 1.0}), candidate("a", columns[:, 1], {"tau": 2.0})]
    pool += [candidate(name, columns[:, k]) for name, k in (("b", 2), ("c", 3), ("d", 4))]
    found = subsets(residual, np.zeros((500, 0)), pool, floor=1e-3)
    ranked = found.ranked()
    assert found.terms(ranked[0]) == {"a", "b", "d"}
    assert pool[ranked[0].members[0]].shape == {"tau": 1.0}
    for s in ranked:
        assert len(found.terms(s)) == len(s.members) <= 3
    sets = [found.terms(s) for s in ranked]
    assert len(set(sets)) == len(sets) == 4 + 6 + 4


def test_a_column_the_base_can_copy_is_no_candidate(rng):
    base = rng.normal(size=(500, 2))
    copy = 3 * base[:, [0]] - base[:, [1]]
    other = rng.normal(size=(500, 1))
    residual = rng.normal(size=500)
    found = subsets(residual, base, [candidate("copy", copy), candidate("other", other)])
    assert found.left[0] < 1e-6
    assert {t for s in found.ranked() for t in found.terms(s)} == {"other"}
    nearly = subsets(residual, base, [candidate("copy", copy + 0.01 * other), candidate("other", other)])
    assert {t for s in nearly.ranked() for t in nearly.terms(s)} == {"copy", "other"}


@pytest.mark.parametrize(("left", "tried"), [(0.0008, False), (0.0013, True)])
def test_a_column_of_which_a_thousandth_is_left_is_a_candidate(rng, left, tried):
    base, other = np.linalg.qr(rng.normal(size=(500, 2)))[0].T
    found = subsets(rng.normal(size=500), base[:, None], [candidate("a", base + left * other)])
    assert found.left[0] == pytest.approx(left, rel=1e-3)
    assert bool(found.ranked()) is tried


def test_a_difference_without_a_coefficient_is_there_about_once(rng):
    """A term without a linear coefficient: multiple one of its whole change is expected, none is not it."""
    effect = rng.normal(size=(N, 1))
    term = SimpleNamespace(states=(), id="limit", family="propulsion", params=())
    scored = []
    for multiple in (1.0, 0.0):
        residual = multiple * effect[:, 0] + 0.5 * rng.normal(size=N)
        found = subsets(
            residual, np.zeros((N, 0)), [Candidate(term, {"x": 1.0}, (), effect, lambda: effect)], floor=1.0
        )
        scored.append(found.score([(0,)])[0])
    assert scored[0].coefficients[0] == pytest.approx(1.0, abs=0.25)
    assert scored[0].log_odds > 10.0
    assert scored[1].log_odds < -1.0


def test_the_multiple_of_a_difference_is_known_to_two_fifths(rng):
    a = rng.normal(size=(N, 1))
    residual = 0.3 * a[:, 0] + rng.normal(size=N)
    term = SimpleNamespace(states=(), id="a", family="propulsion", params=())
    found = subsets(residual, np.zeros((N, 0)), [Candidate(term, {}, (), a, lambda: a)], floor=1.0)
    found.now[:], found.least[:], found.size[:] = 1.0, 1.0, 0.0
    (scored,) = found.score([(0,)])
    with_it = stats.multivariate_normal(a[:, 0], np.eye(N) + 0.4**2 * a @ a.T).logpdf(residual)
    without = stats.multivariate_normal(np.zeros(N), np.eye(N)).logpdf(residual)
    assert scored.log_odds == pytest.approx(with_it - without, abs=1e-8)


@pytest.mark.slow
def test_of_noise_alone_hardly_anything_is_proposed_however_many_candidates_there_are(rng):
    proposed = {3: 0, 30: 0}
    for _ in range(60):
        for size in proposed:
            columns = rng.normal(size=(800, size)).cumsum(axis=0)
            pool = [candidate(f"t{k}", columns[:, k] / np.std(columns[:, k])) for k in range(size)]
            found = subsets(rng.normal(size=800), np.ones((800, 1)), pool, floor=1e-3)
            best = max(s.log_odds for s in found.ranked(2))
            proposed[size] += best > 0.0
            assert best < log_odds_asked(size)
    assert proposed[3] <= 6
    assert proposed[30] <= 6


def test_a_nonlinear_parameter_without_values_to_try_is_tried_at_its_usual_one():
    sag = catalogue()["voltage_sag"]
    bare = replace(sag, params=tuple(replace(p, screen=()) for p in sag.params))
    assert grid(bare) == [{p.name: p.nominal for p in sag.shapes}]
    assert len(grid(sag)) >= 3
