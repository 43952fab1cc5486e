"""The step loop on nonlinear regression problems with certified answers, from both of their starting points, and beside scipy's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares

from flighttest.estimation.gauss_newton import FitStatus, Minimum, Space, Tolerances, minimise
from flighttest.estimation.likelihood_weights import Normal
from flighttest.estimation.uncertainty.covariance import cluster_covariance
from tests.estimation.nist import REFERENCES, Reference

SHARP = Tolerances(step=1e-8, end=1e-5, cost=1e-15, decrease=0.0)
POSITIVE = (
    "MGH10",
    "Eckerle4",
)  # every parameter is positive by nature, and declared so: steps are then taken in the logarithm
FAR = (("MGH17", 0), ("MGH10", 0))  # the first step leads to where a parameter has no effect any more
STARTS = [(r, k) for r in REFERENCES for k in (0, 1) if (r.name, k) not in FAR]


@dataclass(frozen=True)
class At:
    theta: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.residual).all() and np.isfinite(self.jacobian).all())


@dataclass
class PlainSquares:
    """Residuals of one unknown variance, which is learned as RSS / (n - p); no nuisance parameters."""

    function: Callable  # theta to residual (n,) and its derivatives (n, p)
    std: float = 1.0
    residuals: int = 0

    def at(self, theta: np.ndarray) -> At:
        residual, jacobian = self.function(theta)
        return At(theta, np.asarray(residual).ravel(), np.asarray(jacobian))

    def learn(self, at: At, iteration: int) -> bool:
        n, p = at.jacobian.shape
        self.residuals = n
        self.std = float(np.sqrt(at.residual @ at.residual / (n - p)))
        return True

    def cost(self, at: At) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            return float(at.residual @ at.residual) / self.std**2

    def log_likelihood(self, cost: float) -> float:
        return -self.residuals * np.log(self.std) - 0.5 * cost

    def normal_equations(self, at: At) -> tuple[np.ndarray, np.ndarray, None]:
        return at.jacobian.T @ at.jacobian / self.std**2, -at.jacobian.T @ at.residual / self.std**2, None

    def stepped(self, at: At, target: np.ndarray, nuisance: None, share: float, *, differentiated: bool) -> At:
        return self.at(target)

    def refreshed(self, at: At) -> At:
        return self.at(at.theta)

    def nuisance_settled(self, before: At, after: At) -> bool:
        return True


def residuals_of(reference: Reference) -> Callable:
    b = ca.SX.sym("b", len(reference.estimates))
    made = ca.vertcat(*(y - reference.model(b, x) for x, y in zip(reference.x, reference.y, strict=True)))
    return ca.Function("residuals", [b], [made, ca.densify(ca.jacobian(made, b))])


def space_of(start: np.ndarray, lower: float = -np.inf, upper: float = np.inf) -> Space:
    return Space(np.full(start.size, lower), np.full(start.size, upper), np.abs(start))


def solved(
    reference: Reference, which: int, tolerances: Tolerances = SHARP, **bounds: float
) -> tuple[PlainSquares, Minimum[At]]:
    start = np.array(reference.starts[which], dtype=float)
    objective = PlainSquares(residuals_of(reference))
    if reference.name in POSITIVE:
        bounds = {"lower": 1e-12, **bounds}
    space = space_of(start, **bounds)
    begun = objective.at(space.inside(start))
    return objective, minimise(objective, begun, space, tolerances=tolerances, max_iterations=1000)


def by_scipy(reference: Reference, upper: float = np.inf) -> np.ndarray:
    function, start = residuals_of(reference), np.minimum(np.array(reference.starts[1], dtype=float), upper)
    return least_squares(
        lambda b: np.asarray(function(b)[0]).ravel(), start, lambda b: np.asarray(function(b)[1]),
        (-np.inf, upper), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=2000,
    ).x  # fmt: skip


def named(value: Reference | int) -> str:
    return value.name if isinstance(value, Reference) else f"start {value + 1}"


def digits(found: np.ndarray, certified: np.ndarray) -> float:
    """Fewest significant digits that agree."""
    return float(-np.log10(np.max(np.abs(found / certified - 1.0)) + 1e-16))


def standard_errors(objective: PlainSquares, at: At) -> np.ndarray:
    """Of the model-based covariance, each residual a cluster."""
    rows = objective.at(at.theta)
    objective.learn(rows, 0)
    names = tuple(f"b{k}" for k in range(at.theta.size))
    hessian = np.einsum("ni,nj->nij", rows.jacobian, rows.jacobian) / objective.std**2
    score = rows.jacobian * rows.residual[:, None] / objective.std**2
    return np.sqrt(np.diag(cluster_covariance(Normal(names, hessian, score), names).model))


@pytest.mark.parametrize("reference", REFERENCES, ids=named)
def test_the_data_are_those_that_were_certified(reference):
    residual = PlainSquares(residuals_of(reference)).at(np.array(reference.estimates)).residual
    assert residual @ residual == pytest.approx(reference.squares, rel=1e-9)


@pytest.mark.parametrize(("reference", "which"), STARTS, ids=named)
def test_certified_estimates_and_standard_errors_are_found(reference, which):
    objective, found = solved(reference, which)
    assert found.status is FitStatus.CONVERGED
    assert not found.insensitive.any()
    assert digits(found.point.theta, np.array(reference.estimates)) >= 6.0
    assert digits(standard_errors(objective, found.point), np.array(reference.errors)) >= 4.0


@pytest.mark.parametrize(("name", "which"), FAR)
def test_where_a_parameter_has_lost_its_effect_it_is_named(name, which):
    _, found = solved(next(r for r in REFERENCES if r.name == name), which)
    assert found.insensitive.any()


@pytest.mark.parametrize("reference", REFERENCES, ids=named)
def test_the_minimum_is_that_of_scipy(reference):
    _, found = solved(reference, 1)
    assert digits(found.point.theta, by_scipy(reference)) >= 6.0


def test_a_minimum_beyond_a_bound_is_that_of_scipy_and_reported():
    box = next(r for r in REFERENCES if r.name == "BoxBOD")
    _, found = solved(box, 1, upper=200.0)
    assert found.status is FitStatus.AT_BOUND
    assert found.at_bound.tolist() == [True, False]
    assert digits(found.point.theta, by_scipy(box, upper=200.0)) >= 6.0


def test_steps_in_the_logarithm_lead_to_the_same_minimum():
    misra = REFERENCES[0]
    _, plain = solved(misra, 0)
    _, logarithmic = solved(misra, 0, lower=1e-12)
    assert digits(logarithmic.point.theta, plain.point.theta) >= 8.0
    assert logarithmic.iterations < plain.iterations


@dataclass(frozen=True)
class Bent:
    theta: np.ndarray
    nuisance: float
    finite: bool = True


class BentNuisance:
    """(1 - theta)^2 + atan(nuisance)^2: a full Gauss-Newton step of the nuisance parameter from 3 leads to -9.5, uphill."""

    def learn(self, at: Bent, iteration: int) -> bool:
        return True

    def cost(self, at: Bent) -> float:
        return float((1.0 - at.theta[0]) ** 2 + np.arctan(at.nuisance) ** 2)

    def normal_equations(self, at: Bent) -> tuple[np.ndarray, np.ndarray, float]:
        return np.eye(1), 1.0 - at.theta, -np.arctan(at.nuisance) * (1.0 + at.nuisance**2)

    def stepped(self, at: Bent, target: np.ndarray, nuisance: float, share: float, *, differentiated: bool) -> Bent:
        return Bent(target, at.nuisance + share * nuisance)

    def refreshed(self, at: Bent) -> Bent:
        return at

    def nuisance_settled(self, before: Bent, after: Bent) -> bool:
        return abs(after.nuisance - before.nuisance) < 1e-6


def test_nuisance_parameters_are_damped_with_the_parameters():
    space = Space(np.array([-np.inf]), np.array([np.inf]), np.ones(1))
    found = minimise(BentNuisance(), Bent(np.array([0.5]), 3.0), space, tolerances=SHARP)
    assert found.status is FitStatus.CONVERGED
    assert abs(found.point.nuisance) < 1e-3


@pytest.mark.slow
def test_a_model_that_is_only_compared_with_a_better_one_is_near_enough_its_minimum_sooner():
    apart, steps, share = 100.0, [0, 0], []
    for reference, which in STARTS:
        objective, found = solved(reference, which)
        best = objective.log_likelihood(objective.cost(found.point))
        rough, compared = solved(reference, which, replace(SHARP, compared_with=best + apart))
        rough.learn(compared.point, 0)
        share.append((best - rough.log_likelihood(rough.cost(compared.point))) / apart)
        steps = [a + b for a, b in zip(steps, (found.iterations, compared.iterations), strict=True)]
    assert np.median(share) < 0.02 / 20  # of the share that may be left
    # From one start (Eckerle4) the data say next to nothing, and the loop expects as little.
    assert sum(s > 0.11 for s in share) == 1
    assert steps[1] < 0.8 * steps[0]
