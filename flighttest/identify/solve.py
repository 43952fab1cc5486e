"""Levenberg-Marquardt on a `Problem`, each response's own unknowns eliminated, so that cost is linear in the responses.

Minimised is the penalised least squares of output error: residuals over the channel's noise, initial states about their
measurement, and one constant disturbance per response as a random effect whose variance is estimated. Noise and random-effect
variances are updated beside the parameters. Outlying responses are weighted down (never dropped) and reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from flighttest.identify.problem import Noise, PartEvaluation, Problem, prior_std

FloatArray = NDArray[np.float64]

MAX_ITERATIONS = 40
STEP_TOLERANCE = 0.05  # root mean square parameter step at the end, in standard errors of white noise
LOCAL_TOLERANCE = 0.05  # the same for the locals, in prior standard deviations, where only they are estimated
CHORD_TOLERANCE = 3.0  # steps smaller than this, in the same unit, keep the Jacobian
COST_TOLERANCE = 1e-6  # or: relative decrease of the cost by the last step
BLIND = 1e-4
MAX_REJECTIONS = 9
FLAT_STEPS = 4  # steps in a row that do not lower the cost: a kink (an edge passing a sample) or a flat direction
OUTLIER_RATIO = 2.5  # a response whose residual is this many times the median response's is weighted down
SPIKE_STDS = 5.0  # a sample further out than this is weighted down
_START_NOISE = {"m/s^2": 0.3, "m/s": 0.1, "rad": 0.01, "rad/s": 0.05}
_STD_FLOOR = {"m/s^2": 1e-3, "m/s": 5e-4, "rad": 5e-5, "rad/s": 2e-4}
_START_DISTURBANCE = {"m_s2": 0.1, "rad": 0.01, "rad_s": 0.02}


class FitStatus(Enum):
    """How the solver ended. The value is the sentence shown to the reader."""

    CONVERGED = "the estimate converged"
    AT_BOUND = "the estimate converged with a parameter at its bound; see which, and what would make it known"
    NO_DESCENT = "no step lowers the error any further, though it is not small; treat the intervals with care"
    MAX_ITERATIONS = "the solver stopped before it converged; check the segments and the start values"

    @property
    def good(self) -> bool:
        """Whether the estimate is a minimum."""
        return self in (FitStatus.CONVERGED, FitStatus.AT_BOUND)


@dataclass(frozen=True)
class Normal:
    """Normal equations of every response with its locals eliminated, at the solution.

    hessian: (n_clusters, p, p), score: (n_clusters, p), a cluster being a segment; p as `names`.
    """

    names: tuple[str, ...]
    hessian: FloatArray
    score: FloatArray


@dataclass(frozen=True)
class Solution:
    """values: every parameter; free: those estimated; blind: free ones without any effect in this data, left at their start;
    at_bound; local: per part (m, n_locals); response_weight: (n_segments,); iterations."""

    status: FitStatus
    values: dict[str, float]
    free: tuple[str, ...]
    blind: tuple[str, ...]
    at_bound: tuple[str, ...]
    local: tuple[FloatArray, ...]
    noise: Noise
    response_weight: FloatArray
    evaluations: tuple[PartEvaluation, ...]
    normal: Normal
    cost: float
    iterations: int


@dataclass
class State:
    """Where the solver stands: parameters, the responses' own unknowns, and what was evaluated there."""

    theta: FloatArray
    local: list[FloatArray]
    made: list[PartEvaluation]
    stale: bool = False  # whether the Jacobian is that of a point close by


def solve(
    problem: Problem,
    start: Mapping[str, float] | None = None,
    *,
    free: Sequence[str] | None = None,
    robust: bool = True,
    noise: Noise | None = None,
    local: Sequence[FloatArray] | None = None,
    estimate_noise: bool = True,
    max_iterations: int = MAX_ITERATIONS,
) -> Solution:
    """Minimise from `start` (default: the problem's values).

    free: names to estimate, default problem.names; with none, only initial states and disturbances are estimated, which is how
    a fit is judged on segments it has not seen. noise, local: a previous fit's, to start from (or, with estimate_noise False,
    to keep).
    """
    free = tuple(problem.names if free is None else free)
    base = problem.full_values(start or {})
    params = [problem.model.param[n] for n in free]
    scale = np.array([p.scale for p in params])
    lower, upper = np.array([p.lower for p in params]), np.array([p.upper for p in params])
    theta = np.clip(np.array([base[n] for n in free]), lower, upper)
    warm = noise is not None
    least = 2 if warm or not robust else 4
    noise = noise or start_noise(problem)
    weight = np.ones(len(problem.segments))

    def at(values: FloatArray) -> dict[str, float]:
        return {**base, **dict(zip(free, values.tolist(), strict=True))}

    centres = [part.start_local() for part in problem.parts]
    begun = [c.copy() for c in centres] if local is None else [np.array(x) for x in local]
    now = State(theta, begun, problem.evaluate(at(theta), begun, free))
    damping, status, iteration = 1e-3, FitStatus.MAX_ITERATIONS, 0
    blind = np.zeros(len(free), dtype=bool)
    flat = 0
    for iteration in range(1, max_iterations + 1):
        previous = noise
        if estimate_noise:
            noise = _update_noise(problem, now, noise, weight, centres, free)
        if robust and (warm or iteration > 2):
            weight = response_weights(problem, now.made, noise)
        hessian, score, backs = normal_equations(problem, now, noise, weight, centres, free, robust)
        h, g = hessian.sum(axis=0), score.sum(axis=0)
        sensed = np.diag(h) * scale**2
        # Information in units of the parameter's own scale: below this its standard error is a hundred scales.
        blind = sensed < max(1e-14 * float(sensed.max(initial=0.0)), BLIND)
        pushed = ((theta <= lower) & (g < 0)) | ((theta >= upper) & (g > 0))
        active = np.flatnonzero(~blind & ~pushed)
        cost = _cost(problem, now, noise, weight, centres, robust)
        sub = h[np.ix_(active, active)]
        root = np.sqrt(np.diag(sub))
        normal = sub / np.outer(root, root)
        step, full_step = np.zeros(len(free)), np.zeros(len(free))
        full_step[active] = _damped(normal, root, g[active], 1e-9)
        full_step = np.clip(_stepped(theta, full_step, lower), lower, upper) - theta
        accepted = False
        for _ in range(MAX_REJECTIONS):
            step[active] = _damped(normal, root, g[active], damping)
            target = np.clip(_stepped(theta, step, lower), lower, upper)
            moved = target - theta
            trial_local = [
                x + back_g - np.einsum("mlp,p->ml", back_h, moved)
                for x, (back_g, back_h) in zip(now.local, backs, strict=True)
            ]
            if active.size and _small(moved, h, active, CHORD_TOLERANCE):
                # So near that the Jacobian is known: residuals alone cost a fifth.
                fresh = problem.evaluate(at(target), trial_local)
                made = [replace(old, residual=new.residual) for old, new in zip(now.made, fresh, strict=True)]
                trial = State(target, trial_local, made, stale=True)
            else:
                trial = State(target, trial_local, problem.evaluate(at(target), trial_local, free))
            new_cost = _cost(problem, trial, noise, weight, centres, robust)
            if np.isfinite(new_cost) and new_cost <= cost * (1 + 1e-9) + 1e-9:
                accepted = True
                break
            if now.stale:
                break
            damping = max(damping * 10.0, 1e-3)
        if not accepted and now.stale:
            now = State(theta, now.local, problem.evaluate(at(theta), now.local, free))
            continue
        if not accepted:
            status = FitStatus.CONVERGED if _small(full_step, h, active, 0.2) else FitStatus.NO_DESCENT
            break
        flat = flat + 1 if cost - new_cost <= max(COST_TOLERANCE * cost, 0.01) else 0
        still = bool(active.size) or _locals_settled(problem, now.local, trial.local, noise)
        now, theta = trial, target
        settled = _settled(previous, noise) or not estimate_noise
        near = _small(full_step, h, active, STEP_TOLERANCE) or (flat > 0 and damping <= 1e-2) or flat >= FLAT_STEPS
        if still and near and settled and iteration >= least:
            status = FitStatus.CONVERGED
            break
        damping = damping / 10.0 if damping > 1e-9 else 0.0
    hessian, score, _ = normal_equations(problem, now, noise, weight, centres, free, robust)
    at_bound = tuple(n for n, t, lo, up in zip(free, theta, lower, upper, strict=True) if t <= lo or t >= up)
    if status is FitStatus.CONVERGED and at_bound:
        status = FitStatus.AT_BOUND
    cost = _cost(problem, now, noise, weight, centres, robust)
    return Solution(
        status, problem.full_values(at(theta)), free, tuple(n for n, b in zip(free, blind, strict=True) if b), at_bound,
        tuple(now.local), noise, weight, tuple(now.made), Normal(free, hessian, score), cost, iteration,
    )  # fmt: skip


def start_noise(problem: Problem) -> Noise:
    """Noise before anything is known about it."""
    units = {c: _unit(c) for part in problem.parts for c in part.outputs}
    names = [n for part in problem.parts for n in part.block.disturbances]
    return Noise(
        {c: _START_NOISE[u] for c, u in units.items()},
        {n: next(v for k, v in _START_DISTURBANCE.items() if n.endswith(f"_{k}")) for n in names},
    )


def _unit(channel: str) -> str:
    for tail, unit in (("_m_s2", "m/s^2"), ("_m_s", "m/s"), ("_rad_s", "rad/s")):
        if channel.endswith(tail):
            return unit
    return "rad"


def _small(step: FloatArray, h: FloatArray, active: NDArray[np.intp], tolerance: float) -> bool:
    """Whether a step is small against what the data can resolve."""
    sub = h[np.ix_(active, active)]
    return bool(step[active] @ sub @ step[active] <= tolerance**2 * max(active.size, 1))


def _damped(normal: FloatArray, root: FloatArray, g: FloatArray, damping: float) -> FloatArray:
    """Levenberg's step in the active parameters; normal: the Hessian scaled to a unit diagonal by `root`."""
    if not root.size:
        return root
    return np.asarray(np.linalg.lstsq(normal + damping * np.eye(root.size), g / root, rcond=1e-13)[0] / root)


def _stepped(theta: FloatArray, step: FloatArray, lower: FloatArray) -> FloatArray:
    """A step taken in the logarithm of parameters that are positive by nature (lags, gains), at most by a factor of two."""
    positive = (lower > 0) & (theta > 0)
    ratio = np.exp(np.clip(step / np.where(positive, theta, 1.0), -0.7, 0.7))
    return np.where(positive, theta * ratio, theta + step)


def _locals_settled(problem: Problem, before: Sequence[FloatArray], after: Sequence[FloatArray], noise: Noise) -> bool:
    return all(
        bool(np.all(np.abs(b - a) < LOCAL_TOLERANCE * prior_std(part, noise)))
        for part, a, b in zip(problem.parts, before, after, strict=True)
    )


def _settled(before: Noise, after: Noise) -> bool:
    return all(abs(after.channel[c] / before.channel[c] - 1.0) < 0.03 for c in after.channel)


def sample_weights(residual: FloatArray, std: FloatArray, robust: bool) -> FloatArray:
    """Huber weights of single samples, same shape as the residual."""
    if not robust:
        return np.ones_like(residual)
    z = np.abs(residual) / std
    return np.minimum(1.0, SPIKE_STDS / np.maximum(z, SPIKE_STDS))


def response_weights(problem: Problem, made: Sequence[PartEvaluation], noise: Noise) -> FloatArray:
    """(n_segments,): below 1 for responses whose residuals are far larger than their like's (same kind)."""
    weight = np.ones(len(problem.segments))
    for part, evaluation in zip(problem.parts, made, strict=True):
        std = np.array([noise.channel[c] for c in part.outputs])
        count = part.mask.sum(axis=(1, 2))
        size = np.sqrt(((evaluation.residual / std) ** 2).sum(axis=(1, 2)) / np.maximum(count, 1))
        kinds = np.array([problem.segments[r.index].kind for r in part.responses])
        for kind in np.unique(kinds):
            mine = kinds == kind
            if mine.sum() < 4:
                continue
            ratio = size[mine] / max(float(np.median(size[mine])), 0.3)
            for j, w in zip(
                np.flatnonzero(mine), np.minimum(1.0, (OUTLIER_RATIO / np.maximum(ratio, 1e-9)) ** 2), strict=True
            ):
                index = part.responses[j].index
                weight[index] = min(weight[index], float(w))
    return weight


def _weights(
    problem: Problem, i: int, made: PartEvaluation, noise: Noise, weight: FloatArray, robust: bool
) -> FloatArray:
    part = problem.parts[i]
    std = np.array([noise.channel[c] for c in part.outputs])
    w = weight[[r.index for r in part.responses]]
    return np.asarray(sample_weights(made.residual, std, robust) * part.mask * w[:, None, None] / std**2)


def _cost(
    problem: Problem, at: State, noise: Noise, weight: FloatArray, centres: Sequence[FloatArray], robust: bool
) -> float:
    """Penalised cost; single samples count by Huber's rho, so that it is what the weights descend on."""
    total = 0.0
    for i, (part, made) in enumerate(zip(problem.parts, at.made, strict=True)):
        std = np.array([noise.channel[c] for c in part.outputs])
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # a trial step may diverge: its cost is then infinite, and it is refused
            z = np.abs(made.residual) / std
            rho = np.where(z > SPIKE_STDS, 2 * SPIKE_STDS * z - SPIKE_STDS**2, z**2) if robust else z**2
        w = weight[[r.index for r in part.responses]]
        total += float((rho * part.mask * w[:, None, None]).sum())
        total += float((((at.local[i] - centres[i]) / prior_std(part, noise)) ** 2).sum())
    return total


def normal_equations(
    problem: Problem,
    at: State,
    noise: Noise,
    weight: FloatArray,
    centres: Sequence[FloatArray],
    free: Sequence[str],
    robust: bool,
) -> tuple[FloatArray, FloatArray, list[tuple[FloatArray, FloatArray]]]:
    """Per segment Hessian and score by `free`, locals eliminated; per part what takes a step of the parameters back to the locals."""
    n = len(problem.segments)
    hessian, score = np.zeros((n, len(free), len(free))), np.zeros((n, len(free)))
    backs = []
    position = {name: k for k, name in enumerate(free)}
    for i, (part, made) in enumerate(zip(problem.parts, at.made, strict=True)):
        m, _, _, n_c = made.jacobian.shape
        n_p = n_c - len(part.locals)
        root = np.sqrt(_weights(problem, i, made, noise, weight, robust))
        a = (made.jacobian * root[..., None]).reshape(m, -1, n_c)
        r = (made.residual * root).reshape(m, -1, 1)
        full = a.swapaxes(1, 2) @ a
        grad = (a.swapaxes(1, 2) @ r)[..., 0]
        prior = 1.0 / prior_std(part, noise) ** 2
        h_ll = full[:, n_p:, n_p:] + np.einsum("ml,lk->mlk", prior, np.eye(prior.shape[1]))
        g_l = grad[:, n_p:] + prior * (centres[i] - at.local[i])
        solved = np.linalg.solve(h_ll, np.concatenate([g_l[..., None], full[:, n_p:, :n_p]], axis=2))
        back_g, back_h = solved[..., 0], solved[..., 1:]
        h_pl = full[:, :n_p, n_p:]
        columns = np.array([position[c] for c in made.columns[:n_p]], dtype=np.intp)
        placed = np.zeros((m, prior.shape[1], len(free)))
        placed[:, :, columns] = back_h
        backs.append((back_g, placed))
        index = np.array([response.index for response in part.responses])
        hessian[np.ix_(index, columns, columns)] += full[:, :n_p, :n_p] - h_pl @ back_h
        score[np.ix_(index, columns)] += grad[:, :n_p] - np.einsum("mpl,ml->mp", h_pl, back_g)
    return hessian, score, backs


def _update_noise(
    problem: Problem, at: State, noise: Noise, weight: FloatArray, centres: Sequence[FloatArray], free: Sequence[str]
) -> Noise:
    """Channel noise from the residuals, disturbance variances from the locals (MacKay's fixed point)."""
    channel, disturbance = dict(noise.channel), dict(noise.disturbance)
    for i, (part, made) in enumerate(zip(problem.parts, at.made, strict=True)):
        std = np.array([noise.channel[c] for c in part.outputs])
        w = (
            sample_weights(made.residual, std, True)
            * part.mask
            * weight[[r.index for r in part.responses]][:, None, None]
        )
        total = w.sum(axis=(0, 1))
        squares = (w * made.residual**2).sum(axis=(0, 1))
        spent = (len(free) + len(part.locals) * len(part.responses)) / max(float(part.mask.sum()), 1.0)
        for k, c in enumerate(part.outputs):
            found = np.sqrt(squares[k] / max(total[k], 1.0) / max(1.0 - spent, 0.2))
            channel[c] = max(float(found), _STD_FLOOR[_unit(c)])
        n_l, n_d = len(part.locals), len(part.block.disturbances)
        if not n_d or len(part.responses) < 3:
            continue
        w_full = part.mask / np.array([channel[c] for c in part.outputs]) ** 2
        j_l = made.jacobian[..., -n_l:] * np.sqrt(w_full)[..., None]
        j_l = j_l.reshape(len(part.responses), -1, n_l)
        prior = 1.0 / prior_std(part, noise) ** 2
        posterior = np.linalg.inv(j_l.swapaxes(1, 2) @ j_l + np.einsum("ml,lk->mlk", prior, np.eye(n_l)))
        for k, name in enumerate(part.block.disturbances):
            at_k = n_l - n_d + k
            known = 1.0 - posterior[:, at_k, at_k] * prior[:, at_k]
            found = np.sum(at.local[i][:, at_k] ** 2) / max(float(known.sum()), 1e-3 * len(known))
            low = 1e-2 * next(v for tail, v in _START_DISTURBANCE.items() if name.endswith(f"_{tail}"))
            disturbance[name] = float(
                np.clip(np.sqrt(found), max(low, 0.2 * disturbance[name]), 5.0 * disturbance[name])
            )
    return Noise(channel, disturbance)
