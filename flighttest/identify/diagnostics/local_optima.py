"""Would other numbers serve as well (local optima, multistart)? Lag and delay are looked for once more from slower and from quicker loops.

Steps that the model follows to within its noise have one optimum. Free flight at a few samples per time constant, or a loop that is not the
model's, may have several: a slow loop without delay beside a quick one with. Which of two optima serves better is asked of every response
by itself, since residuals of a wrong model are no noise, and their likelihood must not be used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.gauss_newton import FitStatus
from flighttest.estimation.problem import Part, Problem
from flighttest.estimation.solver import Solution, Start, finite_or_error, solve
from flighttest.estimation.uncertainty.covariance import Covariance, scatter_of, std_of
from flighttest.identify.diagnostics.quality import noise_floor

FloatArray = NDArray[np.float64]

COARSE_STRIDE = 4
ON_SAMPLE = 0.02  # of the sample interval: clocks are known to a fiftieth of it or better
LIKELIER = 10.0  # log-likelihood by which another optimum must be better, beyond what the stopping rule leaves
FOLLOWED = 0.98  # of how steps move: with more than this explained, other numbers explain less
SCOUTED = 24  # responses of each kind of block that are enough to find another optimum
SCOUT_STEPS, MANY_STEPS = 12, 25
SLOWER, QUICKER = 0.45, 2.2
BETTER = 2.5  # standard errors, over the responses, by which an optimum serves better
APART = 2.0  # standard errors by which parameters differ
NOISE_SHARE = 0.1  # of the variance of residuals: less than this is left alike by all
NOTHING = 0.01  # of a value: a smaller difference between optima is none
_MAIN = {"roll": "roll_rad", "pitch": "pitch_rad", "yaw": "r_rad_s"}


@dataclass(frozen=True)
class LocalOptimum:
    """Another optimum's value of a parameter, and by how many standard errors the one taken serves better."""

    value: float
    better: float

    def away(self, value: float) -> float:
        """The standard deviation that makes an interval about `value` reach the other optimum."""
        return 0.5 * abs(self.value - value)

    def sentence(self, unit: str) -> str:
        """In words."""
        name = f" {unit}" if unit != "1" else ""
        return f"another optimum, at {self.value:.3g}{name}, serves as well"


def local_optima(problem: Problem, solution: Solution, robust: bool) -> tuple[Solution, dict[str, LocalOptimum]]:
    """The best of several optima, and by name the parameters of others that this data does not separate from it."""
    if not solution.status.good:
        return solution, {}
    known = scatter_of(problem, solution)
    taken: dict[str, float] = {}
    found: dict[str, LocalOptimum] = {}
    for group in _groups(problem, solution):
        if all(followed(problem, solution, i) for i in group):
            continue
        own = replace(
            problem,
            parts=tuple(problem.parts[i] for i in group),
            values={**problem.values, **solution.values},
        )
        here = replace(solution, evaluations=tuple(solution.evaluations[i] for i in group))
        better, rivals = _of_group(own, here, known, robust)
        taken |= better
        found |= rivals
    if taken:
        again = solve(problem, Start({**solution.values, **taken}, solution.noise), robust=robust)
        if again.status.good:
            return again, found
    return solution, found


def _of_group(
    problem: Problem, best: Solution, known: Covariance, robust: bool
) -> tuple[dict[str, float], dict[str, LocalOptimum]]:
    """(values of a better optimum, empty where none is; the parameters of others that serve as well) of parts that share parameters.

    Looked for in a part of the responses first: what is no other optimum of these, or serves them worse, is not followed further.
    """
    free = tuple(n for n in best.free if any(n in part.block.params for part in problem.parts))
    stride = -(-max(len(part.responses) for part in problem.parts) // SCOUTED)
    few = problem.thinned(stride) if stride > 1 else problem
    here = solve(few, Start(best.values, best.noise), free=free, robust=robust, max_iterations=SCOUT_STEPS)
    if here.status is FitStatus.DIVERGED:
        return {}, {}
    mine = scatter_of(few, here)
    taken: dict[str, float] = {}
    found: dict[str, LocalOptimum] = {}
    for factor in (SLOWER, QUICKER):
        start = _moved(problem, best, free, factor)
        scout = solve(few, start, free=free, robust=robust, max_iterations=SCOUT_STEPS)
        if scout.status is FitStatus.DIVERGED:
            continue
        theirs = scatter_of(few, scout)
        if not any(_apart(n, here, mine, scout, theirs) for n in free) or _better(few, here, scout) > BETTER:
            continue
        there = {**best.values, **{n: scout.values[n] for n in free}}
        other = solve(problem, Start(there, best.noise), free=free, robust=robust, max_iterations=MANY_STEPS)
        if not other.status.good:
            continue
        known_there = scatter_of(problem, other)
        apart = [n for n in free if _apart(n, best, known, other, known_there)]
        better = _better(problem, best, other)
        if apart and better < -BETTER:
            taken, found = {n: other.values[n] for n in free}, {}
            best, known, here, mine = other, known_there, scout, theirs
        elif apart and better <= BETTER:
            found = {**found, **{n: LocalOptimum(other.values[n], better) for n in apart if n not in found}}
    return taken, found


def _groups(problem: Problem, solution: Solution) -> list[list[int]]:
    """Parts that share free parameters, and are found together: positions."""
    groups: list[tuple[set[str], list[int]]] = []
    for i, part in enumerate(problem.parts):
        names, members = set(part.block.params) & set(solution.free), [i]
        for other in [g for g in groups if g[0] & names]:
            groups.remove(other)
            names, members = names | other[0], other[1] + members
        groups.append((names, members))
    return [sorted(members) for _, members in groups]


def followed(problem: Problem, solution: Solution, i: int) -> bool:
    """Whether a part's responses are steps that the model follows, or have no lag to be looked for."""
    part, made = problem.parts[i], solution.evaluations[i]
    if not any(n.startswith(("T_d", "omega", "sigma")) for n in part.block.params if n in solution.free):
        return True
    if any(problem.segments[r.index].steered for r in part.responses):
        return False
    channel = _MAIN.get(part.block.name) or next(
        (c for c in ("f_z_m_s2", "a_z_m_s2", "v_z_m_s") if c in part.outputs), ""
    )
    if channel not in part.outputs:
        return False
    k = part.outputs.index(channel)
    mask = part.mask[..., k]
    y, left = part.y[..., k][mask], made.residual[..., k][mask]
    floor = np.mean(
        [noise_floor(row[m]) ** 2 for row, m in zip(made.residual[..., k], mask, strict=True) if m.sum() > 4]
    )
    spread = float(np.var(y))
    return spread > 0 and float(np.mean(left**2) - np.nan_to_num(floor)) < (1.0 - FOLLOWED) * spread


def _moved(problem: Problem, solution: Solution, free: Sequence[str], factor: float) -> dict[str, float]:
    """A start from a loop that is slower or quicker by a factor, its delay so that the whole comes as late."""
    values = dict(solution.values)
    late: dict[str, float] = {}
    for name in free:
        value = values[name]
        if name.startswith("omega"):
            zeta = values[name.replace("omega", "zeta")]
            late["T_d_attitude"] = 2.0 * zeta / value * (1.0 - 1.0 / factor)
        elif name.startswith("sigma"):
            late["T_d_yaw_rate" if name == "sigma_r" else "T_d_thrust"] = 1.0 / value * (1.0 - 1.0 / factor)
        if name.startswith(("omega", "sigma")):
            values[name] = value * factor
        elif name.startswith("zeta"):
            values[name] = 0.25 if value > 0.45 else 0.7
    for name in free:
        if name.startswith("T_d"):
            values[name] = max(values[name] + late.get(name, 0.0), 0.0)
    bounds = problem.model.param
    return {n: min(max(v, bounds[n].lower), bounds[n].upper) if n in bounds else v for n, v in values.items()}


def _apart(name: str, a: Solution, known_a: Covariance, b: Solution, known_b: Covariance) -> bool:
    """Whether two optima differ in a parameter by more than its standard errors."""
    difference = abs(a.values[name] - b.values[name])
    if difference <= NOTHING * abs(a.values[name]):
        return False
    stds = [std_of(k, name) for k in (known_a, known_b) if name in k.names]
    return difference > APART * math.hypot(*stds)


def _better(problem: Problem, a: Solution, b: Solution) -> float:
    """By how many standard errors, over the responses, `a` leaves less than `b`: the logarithm of what each leaves of each response."""
    gains: dict[int, list[float]] = {}
    for i, part in enumerate(problem.parts):
        left = [_left(part, s.evaluations[i].residual, a) for s in (a, b)]
        for j, response in enumerate(part.responses):
            gains.setdefault(response.index, []).append(float(np.log(left[1][j] / left[0][j])))
    each = np.array([sum(g) for g in gains.values()])
    if each.size < 3:
        return 0.0
    return float(each.mean() / max(each.std(ddof=1) / np.sqrt(each.size), 1e-12))


def _left(part: Part, residual: FloatArray, reference: Solution) -> FloatArray:
    """(m,) squares left of every response, in units of the channels' noise, the noise itself not counted as a difference."""
    std = np.array([reference.noise.channel[c] for c in part.outputs])
    return np.asarray(((residual / std) ** 2 + NOISE_SHARE * part.mask).sum(axis=(1, 2)) + 1e-9)


def best_of_starts(
    problem: Problem, robust: bool, nominal: Mapping[str, float], begun: Start | None = None
) -> Solution:
    """Solve from the shape-based start; from others too where that did not end well.

    begun: with noise, the start is an estimate already: of optima that serve alike, the one next to it is meant. Values are the problem's.
    """
    start, noise_was_estimated = replace(begun or Start(), values={}), begun is None or begun.noise is None
    if noise_was_estimated and len(problem.segments) >= 3 * COARSE_STRIDE**2:
        # Most of the way is gone on a part of the responses: the full problem then needs a few steps only.
        coarse = solve(problem.thinned(COARSE_STRIDE), robust=robust, max_iterations=12)
        if coarse.status is not FitStatus.DIVERGED:
            start = Start(coarse.values, coarse.noise)
            problem.values = dict(coarse.values)  # which also sets the integrator's step
    first = solve(problem, start, robust=robust)
    if first.status.good:
        return _off_the_samples(problem, first, robust) if noise_was_estimated else first
    held = {n: v for n, v in problem.values.items() if n not in (*problem.names, *problem.ties)}
    others = [nominal, {**first.values, **{n: v * 0.6 for n, v in problem.values.items() if n.startswith("T_d")}}]
    found = [first] + [solve(problem, {**other, **held}, robust=robust) for other in others]
    finite = [s for s in found if s.status is not FitStatus.DIVERGED]
    good = [s for s in finite if s.status.good] or finite or [finite_or_error(first)]
    return min(good, key=lambda solution: misfit(problem, solution))


def _off_the_samples(problem: Problem, found: Solution, robust: bool) -> Solution:
    """A solution, or a better one from delays half a sample away where one of its delays puts edges on samples.

    There the cost has a kink, since an edge passes from one piece between samples to the next, and a solver may end on it (one did with
    sigma_t 113 1/s for 41). Scouted on a part of the responses.
    """
    steps = [float(np.median(np.diff(s.t_s))) for s in problem.segments if s.t_s.size > 1]
    interval = float(np.median(steps or [0.0]))
    if not interval > 0.0:
        return found
    delays = [n for n in found.free if n.startswith("T_d")]
    off = {n: abs(found.values[n] / interval - round(found.values[n] / interval)) for n in delays}
    on_sample = {n: found.values[n] + 0.5 * interval for n in delays if off[n] < ON_SAMPLE}
    if not on_sample:
        return found
    few = problem.thinned(COARSE_STRIDE) if len(problem.segments) >= 3 * COARSE_STRIDE**2 else problem
    here, there = (
        solve(few, Start({**found.values, **moved}, found.noise), robust=robust, max_iterations=12)
        for moved in ({}, on_sample)
    )
    if FitStatus.DIVERGED in (here.status, there.status) or misfit(few, there) > misfit(few, here) - LIKELIER:
        return found
    other = solve(problem, Start(there.values, there.noise), robust=robust)
    return other if other.status.good and misfit(problem, other) < misfit(problem, found) else found


def misfit(problem: Problem, solution: Solution) -> float:
    """Log-likelihood's noise part: comparable between solutions, whose noise differs."""
    return sum(
        float(part.mask[..., k].sum()) * math.log(solution.noise.channel[c])
        for part in problem.parts
        for k, c in enumerate(part.outputs)
    )
