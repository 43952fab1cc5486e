"""What a residual counts: over its channel's noise, less where a response or a sample is far out; the normal equations made of it, with
each response's own unknowns eliminated; and the noise learned from the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.autocorrelation import correlations, limited, wander_of
from flighttest.estimation.problem import Noise, Part, PartEvaluation, Problem, prior_std

FloatArray = NDArray[np.float64]

OUTLIER_RATIO = 2.5  # a response whose residual is this many times the median response's is weighted down
FEWEST_REPEATS = (
    8  # beyond the first of each cell: a variance of fewer is known to less than a factor of two (chi-square, 90 %)
)
SPIKE_STDS = 5.0  # a sample further out than this is weighted down
LARGEST = (
    1e12  # SI units: no residual or sensitivity of an aircraft comes near, one of a simulation that diverged passes it
)
SAME_CORRELATION = 0.1  # by which a correlation has to change to be learned anew
NOISE_STEPS = 50
NOISE_TOLERANCE = 0.003  # of the fixed point of the variances; the solver asks for 3 % between its steps
LEAST_LEFT = 0.5  # of a channel's residual, between two steps of the solver
RIDGE = 1e-14  # of the largest entry: what rounding leaves of the others is no larger
_START_NOISE = {"m/s^2": 0.3, "m/s": 0.1, "rad": 0.01, "rad/s": 0.05}
_STD_FLOOR = {"m/s^2": 1e-3, "m/s": 5e-4, "rad": 5e-5, "rad/s": 2e-4}
_START_DISTURBANCE = {"m_s2": 0.1, "rad": 0.01, "rad_s": 0.02}


@dataclass(frozen=True)
class Normal:
    """Normal equations of every response with its locals eliminated, at the solution.

    hessian: (n_clusters, p, p), score: (n_clusters, p), a cluster being a segment, or a cell (`by`); p as `names`.
    """

    names: tuple[str, ...]
    hessian: FloatArray
    score: FloatArray

    def by(self, cells: NDArray[np.intp]) -> Normal:
        """The same summed over cells, (n_segments,) the index of each segment's."""
        hessian = np.zeros((int(cells.max(initial=0)) + 1, *self.hessian.shape[1:]))
        score = np.zeros((hessian.shape[0], self.score.shape[1]))
        np.add.at(hessian, cells, self.hessian)
        np.add.at(score, cells, self.score)
        return Normal(self.names, hessian, score)


@dataclass
class State:
    """Where a solver stands: parameters, the responses' own unknowns, and what was evaluated there."""

    theta: FloatArray
    local: list[FloatArray]
    made: list[PartEvaluation]

    @property
    def finite(self) -> bool:
        """Whether a step can be computed from here: residuals and Jacobian are numbers, and small enough to be squared and summed."""
        return all(within_bounds(p.residual) and within_bounds(p.jacobian) for p in self.made)


@dataclass(frozen=True)
class LikelihoodWeights:
    """How a problem's residuals are weighed. response (n_segments,): weight of each; robust: whether single samples far out count less."""

    problem: Problem
    noise: Noise
    response: FloatArray
    robust: bool

    @classmethod
    def even(cls, problem: Problem, noise: Noise | None, *, robust: bool) -> LikelihoodWeights:
        """Every response alike. noise: as far as it is known; the rest as assumed before anything is."""
        assumed = start_noise(problem)
        return cls(problem, assumed | noise if noise else assumed, np.ones(len(problem.segments)), robust)

    def by_response(self, made: Sequence[PartEvaluation]) -> LikelihoodWeights:
        """The same with responses that are far worse than their like weighted down."""
        return replace(self, response=response_weights(self.problem, made, self.noise))

    def cost(self, at: State) -> float:
        """Penalised cost; single samples count by Huber's rho, so that it is what the weights descend on."""
        total = 0.0
        for part, made, local in zip(self.problem.parts, at.made, at.local, strict=True):
            std = np.array([self.noise.channel[c] for c in part.outputs])
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # a trial step may diverge: its cost is then infinite, and it is refused
                z = np.abs(made.residual) / std
                rho = np.where(z > SPIKE_STDS, 2 * SPIKE_STDS * z - SPIKE_STDS**2, z**2) if self.robust else z**2
                rho = rho * (std / self.noise.counted(part.outputs)) ** 2
            w = self.response[[r.index for r in part.responses]]
            total += float((rho * part.mask * w[:, None, None]).sum())
            total += float((((local - part.start_local()) / prior_std(part, self.noise)) ** 2).sum())
        return total

    def normal_equations(self, at: State, free: Sequence[str]) -> tuple[Normal, list[tuple[FloatArray, FloatArray]]]:
        """Per segment by `free`, locals eliminated; and per part what takes a step of the parameters back to the locals."""
        n = len(self.problem.segments)
        hessian, score = np.zeros((n, len(free), len(free))), np.zeros((n, len(free)))
        backs = []
        position = {name: k for k, name in enumerate(free)}
        for part, made, local in zip(self.problem.parts, at.made, at.local, strict=True):
            sums, n_p = self._weighted(part, made).sums, len(made.columns) - len(part.locals)
            precision = self.noise.counted(part.outputs) ** -2.0
            full, grad = np.einsum("mkab,k->mab", sums.gram, precision), np.einsum("mka,k->ma", sums.moment, precision)
            prior = 1.0 / prior_std(part, self.noise) ** 2
            h_ll = full[:, n_p:, n_p:] + np.einsum("ml,lk->mlk", prior, np.eye(prior.shape[1]))
            g_l = grad[:, n_p:] + prior * (part.start_local() - local)
            solved = np.linalg.solve(regular(h_ll), np.concatenate([g_l[..., None], full[:, n_p:, :n_p]], axis=2))
            back_g, back_h = solved[..., 0], solved[..., 1:]
            h_pl = full[:, :n_p, n_p:]
            columns = np.array([position[c] for c in made.columns[:n_p]], dtype=np.intp)
            placed = np.zeros((*prior.shape, len(free)))
            placed[:, :, columns] = back_h
            backs.append((back_g, placed))
            index = np.array([response.index for response in part.responses])
            hessian[np.ix_(index, columns, columns)] += full[:, :n_p, :n_p] - h_pl @ back_h
            score[np.ix_(index, columns)] += grad[:, :n_p] - np.einsum("mpl,ml->mp", h_pl, back_g)
        return Normal(tuple(free), hessian, score), backs

    def profiled(self, at: State, free: Sequence[str]) -> list[tuple[FloatArray, FloatArray]]:
        """Per part the whitened residual (m, n, n_outputs) and its Jacobian by `free` (m, n, n_outputs, p), locals eliminated."""
        found = []
        for part, made in zip(self.problem.parts, at.made, strict=True):
            weighted, std = self._weighted(part, made), self.noise.counted(part.outputs)
            m = len(part.responses)
            a = (weighted.jacobian / std[:, None]).reshape(m, -1, len(made.columns))
            r = (weighted.residual / std).reshape(m, -1, 1)
            n_p = a.shape[2] - len(part.locals)
            a_l, rest = a[..., n_p:], np.concatenate([r, a[..., :n_p]], axis=2)
            prior = np.einsum("ml,lk->mlk", 1.0 / prior_std(part, self.noise) ** 2, np.eye(a_l.shape[2]))
            rest = rest - a_l @ np.linalg.solve(regular(a_l.swapaxes(1, 2) @ a_l + prior), a_l.swapaxes(1, 2) @ rest)
            jacobian = np.zeros((*made.residual.shape, len(free)))
            for k, name in enumerate(made.columns[:n_p]):
                if name in free:
                    jacobian[..., list(free).index(name)] = rest[..., 1 + k].reshape(made.residual.shape)
            found.append((rest[..., 0].reshape(made.residual.shape), jacobian))
        return found

    def _weighted(self, part: Part, made: PartEvaluation) -> PartEvaluation:
        """A part times the square roots of its weights."""
        weights = self._weights(part, made)
        if (weights == part.mask).all():
            return made
        root = np.sqrt(weights)
        return replace(made, residual=made.residual * root, jacobian=made.jacobian * root[..., None])

    def _weights(self, part: Part, made: PartEvaluation) -> FloatArray:
        """(m, n, n_outputs) of single samples, 0 where masked."""
        std = np.array([self.noise.channel[c] for c in part.outputs])
        response = self.response[[r.index for r in part.responses]]
        return np.asarray(sample_weights(made.residual, std, self.robust) * part.mask * response[:, None, None])

    def with_correlation_of(self, at: State) -> LikelihoodWeights:
        """Correlation of each channel from the residuals, geometric mean with that of before, on which the residuals depend; as it is where
        nothing has changed by much."""
        now, parts = self.noise.correlation, zip(self.problem.parts, at.made, strict=True)
        every = (pair for part, made in parts for pair in correlations(part, made).items())
        found = {name: float(np.sqrt(tau * now[name])) if name in now else tau for name, tau in every}
        if all(abs(found[c] / now.get(c, 1.0) - 1.0) < SAME_CORRELATION for c in found):
            return self
        return replace(self, noise=replace(self.noise, correlation={**now, **found}))

    def with_noise_of(self, at: State, free: Sequence[str]) -> LikelihoodWeights:
        """Channel noise from the residuals, disturbance variances from the locals, together, at these parameters.

        The fixed point of MacKay's updates, the locals where they have their minimum in each noise (linearised: no simulation is needed).
        Disturbances vary between repeats of a cell and between windows of free flight where there are enough: what these have in common is
        the model's error and stays in the residual. A correlation stays one that an estimator's wander can have beside the new noise: a
        velocity that counts less is predicted worse, and would count less and less.
        """
        found = self.noise
        for part, made, local in zip(self.problem.parts, at.made, at.local, strict=True):
            found |= self._noise_of(part, made, local, len(free))
        return replace(self, noise=found)

    def _noise_of(self, part: Part, made: PartEvaluation, local: FloatArray, n_free: int) -> Noise:
        """Of one part."""
        std = np.array([self.noise.channel[c] for c in part.outputs])
        n_l, n_d = len(part.locals), len(part.block.disturbances)
        index, sums = [r.index for r in part.responses], self._weighted(part, made).sums
        n_p = len(made.columns) - n_l
        gram, moment, square = sums.gram[..., n_p:, n_p:], sums.moment[..., n_p:], sums.square
        # Single samples far out count less in the noise, whether or not they do in the cost.
        robust = replace(self, robust=True)._weights(part, made)
        spikes = np.einsum("mnk,mnk->k", robust * made.residual, made.residual) / np.maximum(square.sum(axis=0), 1e-300)
        spent = (n_free + n_l * len(part.responses)) / max(float(part.mask.sum()), 1.0)
        scale = spikes / np.maximum(robust.sum(axis=(0, 1)), 1.0) / max(1.0 - spent, 0.2)
        floor = np.array([_STD_FLOOR[_unit(c)] for c in part.outputs])
        # Far from the optimum the locals are not linear: what is left of the residuals where they are limits what may be left.
        lowest_std = np.maximum(LEAST_LEFT * np.sqrt(scale * square.sum(axis=0)), floor)
        together, wander = np.array([self.noise.correlation.get(c, 1.0) for c in part.outputs]), wander_of(part)
        before, begun = prior_std(part, self.noise), part.start_local()
        spread, lowest = before.copy(), np.array([_least_disturbance(n) for n in part.block.disturbances])
        groups = self.problem.same_mean[index]
        for _ in range(NOISE_STEPS):
            prior = 1.0 / spread**2
            counted = 1.0 / (limited(together, std**2, wander) * std**2)
            precision = np.einsum("mklp,k->mlp", gram, counted) + np.einsum("ml,lk->mlk", prior, np.eye(n_l))
            posterior = np.linalg.inv(regular(precision)) if n_l else precision
            pull = np.einsum("mkl,k->ml", moment, counted) + prior * (begun - local)
            step = np.einsum("mlp,mp->ml", posterior, pull)
            left = square - np.einsum("mkl,ml->mk", 2.0 * moment - np.einsum("mklp,mp->mkl", gram, step), step)
            was, std = std, np.maximum(np.sqrt(scale * np.maximum(left, 0.0).sum(axis=0)), lowest_std)
            moved = [std / was]
            if n_d and len(part.responses) >= 3:
                for k in range(n_l - n_d, n_l):
                    known = 1.0 - posterior[:, k, k] * prior[:, k]
                    values = local[:, k] + step[:, k]
                    found = np.sum(values**2) / max(float(known.sum()), 1e-3 * len(known))
                    found = np.sqrt(min(found, variance_between_repeats(values, known, groups, found)))
                    low = max(lowest[k - n_l + n_d], 0.2 * before[0, k])
                    moved.append(np.array([np.clip(found, low, 5.0 * before[0, k]) / spread[0, k]]))
                    spread[:, k] *= moved[-1]
            if all(np.all(np.abs(one - 1.0) < NOISE_TOLERANCE) for one in moved):
                break
        together = limited(together, std**2, wander)
        return Noise(
            dict(zip(part.outputs, std.tolist(), strict=True)),
            dict(zip(part.block.disturbances, spread[0, n_l - n_d :].tolist(), strict=True)),
            {c: float(t) for c, t in zip(part.outputs, together, strict=True) if c in self.noise.correlation},
        )


def variance_between_repeats(values: FloatArray, known: FloatArray, cells: NDArray[np.intp], otherwise: float) -> float:
    """Variance of estimates (m,) between repeats of a cell (one-way analysis of variance), each shrunk to `known` of itself by its prior;
    `otherwise` where too few were repeated."""
    _, which, count = np.unique(cells, return_inverse=True, return_counts=True)
    mean = np.bincount(which, values) / count
    square = float(np.sum((values - mean[which]) ** 2))
    freedom = float(np.sum(known * (1.0 - 1.0 / count[which])))
    return square / max(freedom, 1e-3 * values.size) if values.size - count.size >= FEWEST_REPEATS else otherwise


def within_bounds(values: FloatArray) -> bool:
    """Whether these are numbers that can be squared and summed."""
    return not values.size or bool(values.max() < LARGEST and values.min() > -LARGEST)  # false for NaN


def regular(matrices: FloatArray) -> FloatArray:
    """(m, l, l) sums of squares that can be inverted: with a ridge of the size of what was rounded away."""
    largest = np.einsum("mll->ml", matrices).max(axis=1, initial=0.0)
    return np.asarray(matrices + RIDGE * largest[:, None, None] * np.eye(matrices.shape[1]))


def start_noise(problem: Problem) -> Noise:
    """Noise before anything is known about it."""
    units = {c: _unit(c) for part in problem.parts for c in part.outputs}
    names = [n for part in problem.parts for n in part.block.disturbances]
    return Noise(
        {c: _START_NOISE[u] for c, u in units.items()},
        {n: next(v for k, v in _START_DISTURBANCE.items() if n.endswith(f"_{k}")) for n in names},
    )


def _least_disturbance(name: str) -> float:
    """A hundredth of what is assumed before anything is known."""
    return 1e-2 * next(v for tail, v in _START_DISTURBANCE.items() if name.endswith(f"_{tail}"))


def _unit(channel: str) -> str:
    for tail, unit in (("_m_s2", "m/s^2"), ("_m_s", "m/s"), ("_rad_s", "rad/s")):
        if channel.endswith(tail):
            return unit
    return "rad"


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
