"""`Estimator`: one set of responses, many models. Fits them (`solver.solve`) and linearises them about their optima.

Of one block of the model at a time (roll and pitch, yaw rate, translation), since blocks share no state and no parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flighttest.estimation.gauss_newton import Tolerances
from flighttest.estimation.likelihood_weights import start_noise
from flighttest.estimation.linearisation import (
    FloatArray,
    Linearisation,
    Optimum,
    Projection,
    in_order,
    orthonormal_each,
    project,
)
from flighttest.estimation.problem import PartEvaluation, Problem, prior_std
from flighttest.estimation.solver import Solution, Start, log_likelihood, solve
from flighttest.estimation.uncertainty.closed_loop import closed_loop_bias
from flighttest.estimation.uncertainty.covariance import Covariance, covariance_of, widened
from flighttest.physics.blocks import Block
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

# Two models are distinguished by several nats: an optimum is looked for to a quarter of one (half the cost), a fifth of a standard error.
COMPARED = Tolerances(step=0.2, decrease=0.5, flat=2)
BLOCKS = ("roll_pitch", "yaw", "translation")
INSENSITIVE = (
    1.0  # whitened sum of squares of a parameter's usual change: less is below one sample's noise in all the data
)


def part_of(block: str) -> str:
    """Which estimator compares a block of the model: roll and pitch together, yaw rate alone unless a term couples it to them."""
    return block if block in ("translation", "yaw") else "roll_pitch"


@dataclass
class Estimator:
    """Usable segments of one vehicle and the models tried on them.

    block: one of `BLOCKS`; select(segments, block): positions of the segments that feed a block of the model.
    """

    segments: tuple[Segment, ...]
    block: str
    select: Callable[[Sequence[Segment], Block], Sequence[int]]
    _problems: dict[Model, Problem] = field(default_factory=dict, repr=False)
    _last: tuple[Optimum, tuple[str, ...], Sequence[PartEvaluation]] | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """What goes to another process: not what was computed here."""
        return self.__dict__ | {"_problems": {}, "_last": None}

    def problem(self, model: Model) -> Problem:
        """The problem of one model, parts of this block only (none where nothing moves it); kept."""
        if model not in self._problems:
            fed = {b.name: self.select(self.segments, b) for b in model.blocks if part_of(b.name) == self.block}
            self._problems[model] = Problem.build(self.segments, model, fed=fed)
        return self._problems[model]

    def start(self, model: Model, values: Mapping[str, float] | None = None) -> Optimum:
        """Where a first fit begins: given values, measured initial states, noise as assumed before anything is known."""
        problem = self.problem(model)
        begun = Optimum(problem.full_values(model.start(values)), {}, start_noise(problem), np.inf)
        return replace(begun, objective=self.objective(model, begun))

    def moved(self, model: Model, at: Optimum, values: Mapping[str, float] | None = None) -> Optimum:
        """The same point under another model, or with other values: what holds for both is kept."""
        made = replace(at, values=self.values_of(model, at, values))
        return replace(made, objective=self.objective(model, made))

    def values_of(self, model: Model, at: Optimum, values: Mapping[str, float] | None = None) -> dict[str, float]:
        """Every value of a model: those given, else those of a point where it has them, else its start's."""
        full = self.problem(model).full_values(model.start())
        return full | {k: v for k, v in at.values.items() if k in full} | dict(values or {})

    def objective(self, model: Model, at: Optimum) -> float:
        """Whitened sum of squares; infinite where the simulation is not finite."""
        problem = self.problem(model)
        nuisance = problem.placed(at.nuisance)
        total = 0.0
        with np.errstate(over="ignore", invalid="ignore"):  # a step too far may diverge: its objective is infinite
            for part, made, l_i in zip(problem.parts, problem.evaluate(at.values, nuisance), nuisance, strict=True):
                std = at.noise.counted(part.outputs)
                total += float(np.sum((made.residual / std) ** 2))
                total += float(np.sum(((l_i - part.start_local()) / prior_std(part, at.noise)) ** 2))
        return total if np.isfinite(total) else np.inf

    def fit(
        self,
        model: Model,
        start: Optimum,
        names: Sequence[str],
        *,
        noise: bool = True,
        iterations: int = 30,
        compared_with: float | None = None,
        reported: bool = False,
    ) -> Optimum:
        """Damped Gauss-Newton over `names` and all nuisance parameters (`solver.solve`); noise: whether variances are estimated, too.
        compared_with: log likelihood that the optimum's is only compared with, for which it needs not be found to the last nat
        (`Tolerances`); reported: found as a fit is, whose values are printed. A correlation that the start has is kept.

        The variance of a response's disturbance is that between repeats of a cell: what repeats have in common is the model's error and
        stays in the residual. A start from which the simulation is not finite is given back as it is.
        """
        if not np.isfinite(start.objective):
            return start
        problem = self.problem(model)
        begun = bool(start.nuisance)
        known = start.noise if begun or not noise else None
        found = solve(
            problem,
            Start(start.values, known, start.nuisance),
            free=names,
            robust=False,
            estimate_noise=noise,
            max_iterations=iterations,
            tolerances=Tolerances() if reported else replace(COMPARED, compared_with=compared_with),
        )
        reached = log_likelihood(problem, found.noise, found.cost)
        made = Optimum(dict(found.values), problem.by_name(found.local), found.noise, found.cost, reached)
        self._last = made, tuple(names), found.evaluations
        return made

    def covariance(self, model: Model, at: Optimum, names: Sequence[str]) -> Covariance:
        """Covariance of `names` at an optimum of them, as a fit has it (`estimation.uncertainty`), closed-loop bias included."""
        problem, solution = self.problem(model), self._solution(model, at, names)
        return widened(covariance_of(problem, solution), closed_loop_bias(problem, solution))

    def _solution(self, model: Model, at: Optimum, names: Sequence[str]) -> Solution:
        """An optimum of `names` as a solution."""
        problem = self.problem(model)
        return solve(
            problem, Start(at.values, at.noise, at.nuisance), free=names, robust=False, estimate_noise=False,
            max_iterations=0,
        )  # fmt: skip

    def linearise(self, model: Model, at: Optimum, names: Sequence[str]) -> Linearisation:
        """Whitened, profiled rows at a point, with Jacobian columns for `names` (coefficients at their null value included)."""
        problem = self.problem(model)
        nuisance = problem.placed(at.nuisance)
        channels = tuple(dict.fromkeys(c for part in problem.parts for c in part.outputs))
        disturbances = tuple(dict.fromkeys(d for part in problem.parts for d in part.block.disturbances))
        strata = (*channels, *disturbances)
        out: list[tuple[FloatArray, ...]] = []
        projections: list[Projection] = []
        raw: list[FloatArray] = []
        for part, made, l_i in zip(problem.parts, self._evaluated(problem, at, names), nuisance, strict=True):
            m, n, n_y = part.y.shape
            n_l, n_f = len(part.locals), part.n_free_states
            scale = np.tile(std := at.noise.counted(part.outputs), n)
            j_p, j_l = made.jacobian_by(names), made.jacobian_by(part.locals) / scale[:, None]
            precision = 1.0 / prior_std(part, at.noise)
            residual, prior = (made.residual / std).reshape(m, -1), (part.start_local() - l_i) * precision
            basis = orthonormal_each(np.concatenate([j_l, precision[..., None] * np.eye(n_l)], axis=1))
            start = basis[..., :n_f]  # the first columns span what the first columns of the Jacobian do
            projection = Projection(basis, start, scale, part.mask.reshape(m, -1))
            r = project(projection.basis, np.concatenate([residual, prior], axis=1)[..., None])[..., 0]
            # Without the disturbance: what it explained goes back into the residual.
            given = residual + np.einsum("mij,mj->mi", j_l[..., n_f:], l_i[:, n_f:])
            given = np.concatenate([given, prior], axis=1)
            given[:, n * n_y + n_f :] = 0.0
            raw.append(j_p)
            code = np.concatenate(
                [
                    np.tile([strata.index(c) for c in part.outputs], n),
                    np.full(n_f, -1),
                    [strata.index(d) for d in part.block.disturbances],
                ]
            )
            sample = np.concatenate([np.repeat(np.arange(n), n_y), np.full(n_l, -1)])
            index = np.array([response.index for response in part.responses])
            projections.append(projection)
            whole = r.shape
            out.append(
                (
                    r,
                    projection.profiled(j_p),
                    project(start, given[..., None])[..., 0] * np.concatenate([scale, np.zeros(n_l)]),
                    np.broadcast_to(np.concatenate([scale, np.ones(n_l)]), whole),
                    np.broadcast_to(index[:, None], whole),
                    np.broadcast_to(sample, whole),
                    np.broadcast_to(code, whole),
                )
            )
        rows = [in_order(projections, [o[k] for o in out]) for k in range(7)]
        segment, sample_at, stratum = (rows[k].astype(np.intp) for k in (4, 5, 6))
        return Linearisation(
            residual=rows[0], jacobian=rows[1], unprofiled_residual=rows[2], derivatives=tuple(raw), scale=rows[3],
            segment=segment, sample=sample_at, stratum=stratum, channels=channels, disturbances=disturbances,
            names=tuple(names), projections=tuple(projections),
        )  # fmt: skip

    def _evaluated(self, problem: Problem, at: Optimum, names: Sequence[str]) -> Sequence[PartEvaluation]:
        """With derivatives by `names`; not computed again at the optimum that was found last."""
        if self._last is not None:
            found, by, made = self._last
            if found.values is at.values and found.nuisance is at.nuisance and by == tuple(names):
                return made
        return problem.evaluate(at.values, problem.placed(at.nuisance), list(names))

    def derivatives(
        self, model: Model, at: Optimum, names: Sequence[str], values: Mapping[str, float] | None = None
    ) -> list[FloatArray]:
        """Per part (m, samples times outputs, len(names)): derivatives of the outputs, in the channels' units. values: other than the
        point's."""
        problem, there = self.problem(model), self.values_of(model, at, values)
        return [made.jacobian_by(names) for made in problem.evaluate(there, problem.placed(at.nuisance), list(names))]

    def differences(
        self, model: Model, at: Optimum, others: Iterable[tuple[Model, Mapping[str, float] | None]]
    ) -> Iterator[list[FloatArray]]:
        """Of each other (model, values): per part (m, samples times outputs, 1), change of the outputs from a point of one model to the
        same point of the other, or with its values, in the channels' units.

        All models must have the same parts; the nuisance parameters are `at`'s.
        """
        here = self.problem(model)
        base = here.evaluate(at.values, here.placed(at.nuisance))
        for changed, values in others:
            there = self.problem(changed)
            made = there.evaluate(self.values_of(changed, at, values), there.placed(at.nuisance))
            yield [
                (a.residual - b.residual).reshape(part.y.shape[0], -1, 1)
                for part, a, b in zip(here.parts, base, made, strict=True)
            ]

    def insensitive(self, model: Model, at: Optimum) -> frozenset[str]:
        """Base parameters that change nothing in this data (the voltage exponent where no voltage varies): held where they are."""
        problem = self.problem(model)
        power = dict.fromkeys(problem.names, 0.0)
        for part, columns in zip(problem.parts, self.derivatives(model, at, problem.names), strict=True):
            std = np.tile(at.noise.counted(part.outputs), part.y.shape[1])
            for name, value in zip(problem.names, np.sum((columns / std[:, None]) ** 2, axis=(0, 1)), strict=True):
                power[name] += float(value) * model.param[name].scale ** 2
        return frozenset(n for n, p in power.items() if model.param[n].kind == "base" and p < INSENSITIVE)


def finite(parts: Sequence[FloatArray]) -> bool:
    """Whether a simulated change is a number everywhere."""
    return all(bool(np.isfinite(one).all()) for one in parts)
