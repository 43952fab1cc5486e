"""Cluster-robust covariance against textbook formulas, and against repeated draws."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.estimation.likelihood_weights import Normal
from flighttest.estimation.uncertainty.colored_residuals import ColoredResiduals
from flighttest.estimation.uncertainty.covariance import (
    clock_std_s,
    cluster_covariance,
    interval_factor,
    with_clock_error,
)
from flighttest.segments.model import SegmentContext


def linear(rng, clusters, size, effect, names=("a", "b")):
    """y = a + b x + cluster effect + noise; returns its normal equations at the least squares estimate, and the estimate."""
    x = rng.uniform(-1, 1, (clusters, size))
    design = np.stack([np.ones_like(x), x], axis=2)
    y = effect * rng.standard_normal((clusters, 1)) + rng.standard_normal((clusters, size))
    flat = design.reshape(-1, 2)
    beta = np.linalg.lstsq(flat, y.ravel(), rcond=None)[0]
    residual = y - design @ beta
    return (
        Normal(names, design.swapaxes(1, 2) @ design, np.einsum("ckp,ck->cp", design, residual)),
        beta,
        design,
        residual,
    )


def test_cr2_is_its_definition_in_residual_space():
    normal, _, design, residual = linear(np.random.default_rng(0), 9, 6, 1.0)
    bread = np.linalg.inv(normal.hessian.sum(axis=0))
    meat = np.zeros((2, 2))
    for x, e in zip(design, residual, strict=True):
        values, vectors = np.linalg.eigh(np.eye(len(x)) - x @ bread @ x.T)
        g = x.T @ (vectors @ ((vectors.T @ e) / np.sqrt(values)))
        meat += np.outer(g, g)
    assert np.allclose(cluster_covariance(normal, ("a", "b")).matrix, bread @ meat @ bread)


def test_degrees_of_freedom_of_a_mean_over_equal_clusters_are_their_number_less_one():
    hessian, score = np.full((8, 1, 1), 5.0), np.random.default_rng(1).standard_normal((8, 1))
    covariance = cluster_covariance(Normal(("a",), hessian, score - score.mean()), ("a",))
    assert covariance.dof[0] == pytest.approx(7.0)


def test_intervals_cover_with_few_clusters_and_a_shared_disturbance():
    rng = np.random.default_rng(2)
    hits = {"robust": 0, "white": 0}
    trials = 400
    for _ in range(trials):
        normal, beta, _, _ = linear(rng, 8, 20, 1.0)
        c = cluster_covariance(normal, ("a", "b"))
        hits["robust"] += abs(beta[0]) < interval_factor(c.dof[0]) * np.sqrt(c.matrix[0, 0])
        hits["white"] += abs(beta[0]) < 1.96 * np.sqrt(c.model[0, 0])
    assert 0.91 < hits["robust"] / trials < 0.985
    assert hits["white"] / trials < 0.7


def test_few_clusters_fall_back_on_the_correlation_in_time():
    normal = Normal(("a", "b"), np.array([np.eye(2) * 4.0]), np.zeros((1, 2)))
    colored = ColoredResiduals(np.array([9.0, 4.0]), np.array([30.0, 7.0]))
    covariance = cluster_covariance(normal, ("a", "b"), lambda: colored)
    assert np.allclose(covariance.matrix, np.diag([9.0, 4.0]) / 4.0)
    assert covariance.dof.tolist() == [30.0, 7.0]
    assert cluster_covariance(normal, ("a", "b")).matrix == pytest.approx(np.eye(2) / 4.0)


@pytest.mark.parametrize(("clusters", "in_time"), [(3, True), (4, False)])
def test_a_mean_over_three_clusters_is_determined_by_too_few_and_one_over_four_is_not(clusters, in_time):
    """Two and three degrees of freedom: Student's 97.5 % quantile is 4.3 and 3.2."""
    score = np.random.default_rng(4).standard_normal((clusters, 1))
    asked = []

    def colored():
        asked.append(True)
        return ColoredResiduals(np.array([9.0]), np.array([30.0]))

    normal = Normal(("a",), np.full((clusters, 1, 1), 5.0), score - score.mean())
    covariance = cluster_covariance(normal, ("a",), colored)
    assert bool(asked) is in_time
    assert covariance.dof[0] == pytest.approx(30.0 if in_time else clusters - 1.0)


def test_a_clock_error_widens_all_delays_alike_and_nothing_else(found):
    covariance = found.covariance
    wider = with_clock_error(covariance, 0.002)
    at = {n: i for i, n in enumerate(covariance.names)}
    added = wider.matrix - covariance.matrix
    assert added[at["T_d_thrust"], at["T_d_attitude"]] == pytest.approx(4e-6)
    assert added[at["T_d_thrust"], at["T_d_thrust"]] == pytest.approx(4e-6)
    assert np.all(added[at["K"]] == 0.0)
    assert clock_std_s(found.problem) == 0.0
    first = found.problem.segments[0]
    tabled = replace(found.problem, segments=(replace(first, context=SegmentContext(edge_error_s=0.01)),))
    assert clock_std_s(tabled) == pytest.approx(0.01 / np.sqrt(3.0))


def test_resampling_responses_gives_the_same_errors(found):
    """Cluster bootstrap: one Gauss-Newton step from the solution on every draw of whole responses."""
    normal, names = found.solution.normal, found.covariance.names
    pick = np.array([normal.names.index(n) for n in names])
    hessian, score = normal.hessian[:, pick[:, None], pick], normal.score[:, pick]
    scale = 1.0 / np.sqrt(np.diag(hessian.sum(axis=0)))
    hessian, score = hessian * np.outer(scale, scale), score * scale
    draws = np.random.default_rng(0).multinomial(len(score), np.full(len(score), 1.0 / len(score)), size=400)
    steps = [np.linalg.lstsq(np.tensordot(c, hessian, 1), c @ score, rcond=1e-10)[0] for c in draws]
    std = dict(zip(names, np.std(steps, axis=0) * scale, strict=True))
    for name in ("K", "alpha", "sigma_t", "d_z", "omega_phi"):
        robust = np.sqrt(found.covariance.matrix[names.index(name), names.index(name)])
        assert std[name] == pytest.approx(robust, rel=0.35), name
