"""How far the estimates may be off because the equations are coarser than the data: covariance of a discrepancy that all responses of one
kind of maneuver share.

Of the whitened residual of repeat r of cell c, r_cr(t) = J_cr(t) d_theta + g_c(t) + e_cr(t), the variance s_g^2 of what repeats have in
common is known by a one-way analysis of variance of its means over `BIN_S` only with an error: with F = (mean square between
cells) / (mean square between repeats), each bin of each cell being a group, v = 1 + r s_g^2 / s_e^2 is distributed as F / F(d_1, d_2). What
is not known of a variance adds its mean to the variance of the estimates (law of total variance):

    s_g^2 = s_e^2 E[max(0, v - 1)] / r,      r repeats; d_1, d_2 independent bins of cells, of differences between repeats.

An equation that errs, errs alike in all cells of a kind, and no scatter between responses or cells shows that (the estimates absorb
the part of g along J). Counting g once per kind k of n_k samples (variance inflation n / C of docs/diagnosis.md), the estimates have

    cov = H^-1 [sum_k s_g^2 n_k J_k' J_k] H^-1

per channel, J with each response's own unknowns profiled out and H the information, their priors included. Where noise is large, that
mean is large: no more than `SHARE` of what the model makes the responses do is taken for an error of its equations; more is a lack of
fit, which other tests name. Without repeats neighbouring samples take their place, since an error of equations is smooth and noise is
not: r is 2 and noise that is smooth counts as an error of the equations.

Instruments drift by what all responses of a flight share as well, b_d of each constant disturbance d. To the score it adds, with L_id the
part of response i that its own disturbance does not take up, var(b_d) (sum_i J_i' L_id) (sum_i J_i' L_id)'. Where that is a parameter
itself, as of an accelerometer's bias, its variance is added to the estimate's (`Param.drift`): an effect is what comes on top.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.drift import DISTURBANCE_DRIFT
from flighttest.estimation.linearisation import inverse_of_gram
from flighttest.estimation.problem import Noise, Part, Problem, kinds_of, prior_std
from flighttest.estimation.solver import Solution
from flighttest.estimation.uncertainty.distributions import expected_excess

FloatArray = NDArray[np.float64]

BIN_S = 0.1  # residuals are averaged over it before repeats are compared
# Of the standard deviation of the modelled responses. `python -m benchmarks.intervals`: of 48 known parameters of effects in 35 sealed
# flights 77 % are inside their 95 % intervals at 0, 96 % from 0.02 to 0.2. More than is needed there, for vehicles that obey the
# equations less.
SHARE = 0.05
FEWEST_DIFFERENCES = 5.0  # degrees of freedom between repeats below which they are not used


def discrepancy_covariance(problem: Problem, solution: Solution, active: Sequence[str]) -> FloatArray:
    """(p, p) of the `active` names, in their units: see the module's text."""
    weighing, at = solution.weighed(problem)
    kinds = kinds_of(problem.segments)
    normal, backs = weighing.normal_equations(at, solution.free)
    pick = [solution.free.index(n) for n in active]
    total, spread = normal.hessian.sum(axis=0)[np.ix_(pick, pick)], _of_drift(problem, solution, backs, active)
    for i, (residual, jacobian) in enumerate(weighing.profiled(at, active)):
        part = problem.parts[i]
        segment = np.array([r.index for r in part.responses])
        for k, variance in enumerate(_variances(problem, solution, i, residual)):
            for kind in np.unique(kinds[segment]):
                mine = kinds[segment] == kind
                columns = jacobian[mine, :, k][part.mask[mine, :, k]]
                spread += variance * columns.shape[0] * columns.T @ columns
    inverse = inverse_of_gram(total)
    own = np.diag([problem.model.param[n].drift ** 2 for n in active])
    return np.asarray(inverse @ spread @ inverse) + own


def _of_drift(
    problem: Problem, solution: Solution, backs: Sequence[tuple[FloatArray, FloatArray]], active: Sequence[str]
) -> FloatArray:
    """(p, p) covariance of the score: constant disturbances that all responses share (`DISTURBANCE_DRIFT`), as far as the prior of each
    response's own disturbance keeps that from taking them up. backs: as of `LikelihoodWeights.normal_equations`, of all free parameters."""
    pick = [solution.free.index(n) for n in active]
    found = np.zeros((len(active), len(active)))
    for part, (_, back) in zip(problem.parts, backs, strict=True):
        precision = 1.0 / prior_std(part, solution.noise) ** 2
        for k, name in enumerate(part.block.disturbances, start=len(part.locals) - len(part.block.disturbances)):
            score = DISTURBANCE_DRIFT[name] * precision[:, k] @ back[:, k][:, pick]
            found += np.outer(score, score)
    return found


def _variances(problem: Problem, solution: Solution, i: int, residual: FloatArray) -> list[float]:
    """s_g^2 of the outputs of one part, its whitened residual (m, n, n_outputs) profiled."""
    part, left = problem.parts[i], solution.evaluations[i].residual
    found = (_between_cells(problem, part, residual[..., k], part.mask[..., k]) for k in range(len(part.outputs)))
    return [min(variance, SHARE**2 * _moved(part, left, k, solution.noise)) for k, variance in enumerate(found)]


def _moved(part: Part, residual: FloatArray, k: int, noise: Noise) -> float:
    """Variance of what the model makes output k of the responses do, in noise variances."""
    mask = part.mask[..., k]
    modelled = np.where(mask, part.y[..., k] - residual[..., k], 0.0)
    count = np.maximum(mask.sum(axis=1, keepdims=True), 1)
    apart = np.where(mask, modelled - modelled.sum(axis=1, keepdims=True) / count, 0.0)
    return float((apart**2).sum() / max(mask.sum(), 1) / noise.counted(part.outputs)[k] ** 2)


def _between_cells(problem: Problem, part: Part, residual: FloatArray, mask: NDArray[np.bool_]) -> float:
    """s_g^2 of one channel, (m, n) whitened residual and which samples were measured."""
    segments = [problem.segments[r.index] for r in part.responses]
    cells = np.unique(problem.cells[[r.index for r in part.responses]], return_inverse=True)[1]
    since = np.zeros(residual.shape)
    for j, (response, s) in enumerate(zip(part.responses, segments, strict=True)):
        zero = s.t_step_s if s.kind != "free" else s.t_s[0]
        since[j, : response.t_s.size] = response.t_s - zero
    bins = np.floor(np.where(mask, since, 0.0) / BIN_S).astype(np.intp)
    bins -= bins.min(initial=0)
    rows = np.broadcast_to(np.arange(len(segments))[:, None], bins.shape)
    shape = (len(segments), int(bins.max(initial=0)) + 1)
    count, mean = np.zeros(shape), np.zeros(shape)
    np.add.at(count, (rows[mask], bins[mask]), 1.0)
    np.add.at(mean, (rows[mask], bins[mask]), residual[mask])
    seen = count > 0
    if not seen.any():
        return 0.0
    mean /= np.maximum(count, 1.0)
    repeats, shared = np.zeros((int(cells.max()) + 1, shape[1])), np.zeros((int(cells.max()) + 1, shape[1]))
    np.add.at(repeats, cells, seen.astype(float))
    np.add.at(shared, cells, mean)
    shared /= np.maximum(repeats, 1.0)
    several = repeats >= 2
    differing = np.where(seen & several[cells], mean - shared[cells], 0.0)
    together = _bins_together(differing, seen & several[cells])
    groups, free = several.sum() / together, (repeats[several] - 1.0).sum() / together
    if free < FEWEST_DIFFERENCES:
        return _between_neighbours(residual, mask)
    noise = max(float((differing**2).sum() / (free * together)), 1e-12)
    ratio = float((repeats[several] * shared[several] ** 2).sum() / (groups * together)) / noise
    return noise * expected_excess(ratio, groups, free) / float(repeats[several].mean())


def _between_neighbours(residual: FloatArray, mask: NDArray[np.bool_]) -> float:
    """s_g^2 where nothing was repeated, (m, n) whitened residual and which samples were measured: neighbouring samples take
    the place of repeats, since an error of equations is smooth and noise is not. Noise that is smooth counts as such an error."""
    even = residual.shape[1] // 2 * 2
    pairs, measured = (values[:, :even].reshape(len(values), -1, 2) for values in (residual, mask))
    both = np.asarray(measured.all(axis=2))
    left = float(np.mean(residual[mask] ** 2))
    if both.sum() < FEWEST_DIFFERENCES:
        return left
    mean = np.where(both, pairs.mean(axis=2), 0.0)
    noise = max(float(((pairs[..., 0] - pairs[..., 1])[both] ** 2).mean() / 2.0), 1e-12)
    ratio = 2.0 * float((mean**2).sum() / both.sum()) / noise
    return min(noise * expected_excess(ratio, both.sum() / _bins_together(mean, both), float(both.sum())) / 2.0, left)


def _bins_together(values: FloatArray, seen: NDArray[np.bool_]) -> float:
    """Integrated autocorrelation time of (m, bins) values, in bins, 1 or more."""
    own = float((values**2).sum())
    if own <= 0.0:
        return 1.0
    power = own / float(seen.sum())
    found = 1.0
    for lag in range(1, values.shape[1]):
        pairs = float((seen[:, lag:] & seen[:, :-lag]).sum())
        rho = float((values[:, lag:] * values[:, :-lag]).sum()) / (max(pairs, 1.0) * power)
        if rho <= 0.0:
            break
        found += 2.0 * rho
    return found
