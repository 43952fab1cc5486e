"""`Problem`: segments x model to residuals and Jacobians.

    problem = Problem.build(segments, model, fed={"translation": [0, 1, 2]})     # block name: positions of its segments
    solution = solve(problem)                                                    # estimation.solver

A `Part` is one block of the model with the responses that feed it. Parameters not in `names` stay at their value.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS
from flighttest.estimation.integration.kernel import Kernel
from flighttest.estimation.responses import (
    Nodes,
    Response,
    Stacked,
    dead_channels,
    max_step_s,
    node_bucket,
    outputs_of,
    prepare,
)
from flighttest.physics.blocks import Block
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Cutoffs = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Part:
    """One block with its responses. outputs: channels compared; mask: (m, n, n_outputs), n the longest response's samples."""

    block: Block
    outputs: tuple[str, ...]
    responses: tuple[Response, ...]
    y: FloatArray
    mask: BoolArray
    start: FloatArray
    start_std: FloatArray

    @property
    def n_free_states(self) -> int:
        """Locals are the free initial states, then the disturbances."""
        return len(self.block.free_states)

    @property
    def locals(self) -> tuple[str, ...]:
        """Names of the per-response unknowns."""
        return (*(f"{n}(0)" for n in self.block.free_states), *self.block.disturbances)

    def start_local(self) -> FloatArray:
        """(m, n_locals): measured initial states, no disturbance."""
        return np.concatenate([self.start, np.zeros((len(self.responses), len(self.block.disturbances)))], axis=1)

    @cached_property
    def interval_s(self) -> float:
        """Usual time between samples."""
        return float(np.median([np.median(np.diff(r.t_s)) for r in self.responses]))

    def only(self, rows: Sequence[int]) -> Part:
        """Some of the responses."""
        responses = tuple(self.responses[j] for j in rows)
        n = max(r.t_s.size for r in responses)
        y, mask = self.y[rows, :n], self.mask[rows, :n]
        return replace(
            self, responses=responses, y=y, mask=mask, start=self.start[rows], start_std=self.start_std[rows]
        )

    def by_length(self) -> list[Part]:
        """The same in parts of responses of like length, which take less room together."""
        groups: dict[int, list[int]] = {}
        for j, response in enumerate(self.responses):
            groups.setdefault(node_bucket(response.t_s.size), []).append(j)
        return [self.only(rows) for rows in groups.values()]


@dataclass(frozen=True)
class PartEvaluation:
    """residual: (m, n, n_outputs) measured minus simulated, 0 where masked; jacobian: (m, n, n_outputs, n_columns) of the simulated
    output by `columns` (parameters, then locals), 0 where masked; empty last axis when not asked for."""

    residual: FloatArray
    jacobian: FloatArray
    columns: tuple[str, ...]

    def jacobian_by(self, names: Sequence[str]) -> FloatArray:
        """(m, samples times outputs, len(names)) columns of the Jacobian by name, 0 where there is none."""
        m, n, n_y = self.residual.shape
        found = np.zeros((m, n * n_y, len(names)))
        for k, name in enumerate(names):
            if name in self.columns:
                found[..., k] = self.jacobian[..., self.columns.index(name)].reshape(m, -1)
        return found

    @cached_property
    def sums(self) -> Sums:
        """Over the samples of each response, per output: all that least squares asks of them, whatever the outputs' noise."""
        outputs = [(self.jacobian[:, :, k], self.residual[:, :, k, None]) for k in range(self.residual.shape[2])]
        return Sums(
            gram=np.stack([a.swapaxes(1, 2) @ a for a, _ in outputs], axis=1),
            moment=np.stack([(a.swapaxes(1, 2) @ r)[..., 0] for a, r in outputs], axis=1),
            square=np.stack([(r.swapaxes(1, 2) @ r)[:, 0, 0] for _, r in outputs], axis=1),
        )


@dataclass(frozen=True)
class Sums:
    """Of the Jacobian J and the residual r of m responses, per output k and summed over samples: gram (m, k, n_columns, n_columns) J'J,
    moment (m, k, n_columns) J'r, square (m, k) r'r."""

    gram: FloatArray
    moment: FloatArray
    square: FloatArray


@dataclass(frozen=True)
class _Batch:
    """Responses of one part with the same filters, which are integrated together. members: positions in the part."""

    cutoffs: Cutoffs
    members: NDArray[np.intp]
    nodes: Nodes


@dataclass(frozen=True)
class Noise:
    """What residuals are measured against: std per channel, and per disturbance (constant over a response). correlation: samples of a
    channel that count as one, 1 where it is not given: the integrated autocorrelation time of what a state estimator wanders by."""

    channel: Mapping[str, float]
    disturbance: Mapping[str, float]
    correlation: Mapping[str, float] = field(default_factory=dict)

    def counted(self, outputs: Sequence[str]) -> FloatArray:
        """(n_outputs,) std by which a sample counts in a sum of squares: that of white noise with the same power at low frequencies."""
        return np.array([self.channel[c] * np.sqrt(self.correlation.get(c, 1.0)) for c in outputs])

    def __or__(self, other: Noise) -> Noise:
        """This noise with another's in its place where that is known."""
        return Noise(
            {**self.channel, **other.channel},
            {**self.disturbance, **other.disturbance},
            {**self.correlation, **other.correlation},
        )


def cells_of(segments: Sequence[Segment]) -> NDArray[np.intp]:
    """(n_segments,) index of each segment's cell: repeats of one step share it, a window of free flight is a cell of its own."""
    index: dict[Hashable, int] = {}
    keys = [s.cell_key if s.kind != "free" else ("free", i) for i, s in enumerate(segments)]
    return np.array([index.setdefault(key, len(index)) for key in keys], dtype=np.intp)


def kinds_of(segments: Sequence[Segment]) -> NDArray[np.intp]:
    """(n_segments,) index of each segment's kind of maneuver; a window of free flight is a kind of its own."""
    index: dict[Hashable, int] = {}
    keys = [s.kind if s.kind != "free" else ("free", i) for i, s in enumerate(segments)]
    return np.array([index.setdefault(key, len(index)) for key in keys], dtype=np.intp)


@dataclass
class Problem:
    """Segments, model, what is free. Build with `Problem.build`."""

    segments: tuple[Segment, ...]
    model: Model
    parts: tuple[Part, ...]
    names: tuple[str, ...]
    values: dict[str, float]
    ties: Mapping[str, str]
    _kernels: dict[Any, Kernel] = field(default_factory=dict, repr=False)
    _laid_out: dict[int, tuple[tuple[float, float], list[_Batch]]] = field(default_factory=dict, repr=False, init=False)

    @classmethod
    def build(
        cls,
        segments: Sequence[Segment],
        model: Model,
        *,
        fed: Mapping[str, Collection[int]],
        values: Mapping[str, float] | None = None,
        fixed: Sequence[str] = (),
        ties: Mapping[str, str] | None = None,
        dead: Sequence[str] | None = None,
    ) -> Problem:
        """The problem of these segments, all of them usable; without parts where no segment feeds any block.

        fed: block name to the positions of its segments, each of which is read through its context.filters (`Provenance.filters`);
        values: start values by name; fixed: names that stay there; ties: name to the name it equals; dead: channels that were not
        measured, None: those that never change.
        """
        segments = tuple(segments)
        start = model.start(values)
        found = []
        still = dead_channels(segments) if dead is None else dead
        for block in model.blocks:
            members = sorted(fed.get(block.name, ()))
            outputs = outputs_of(segments, members, block, still)
            if members and outputs:
                found.append(_part(segments, members, block, outputs, model, start))
        tied = {k: v for k, v in (ties or {}).items() if k in start and v in start}
        reached = {n for part in found for n in part.block.params}
        names = tuple(n for n in model.names if n in reached and n not in fixed and n not in tied)
        return cls(segments, model, tuple(found), names, start, tied)

    @cached_property
    def cells(self) -> NDArray[np.intp]:
        """(n_segments,), as `cells_of`."""
        return cells_of(self.segments)

    @cached_property
    def same_mean(self) -> NDArray[np.intp]:
        """(n_segments,) index of responses whose disturbances have the same mean: of the repeats of a cell, and of all free flight."""
        return np.where([s.kind == "free" for s in self.segments], -1, self.cells)

    def placed(self, nuisance: Mapping[str, FloatArray]) -> list[FloatArray]:
        """Nuisance parameters by part, (m, n_nuisance), of name to (n_segments,); where they begin for those not given, or NaN."""
        found = []
        for part in self.parts:
            values = part.start_local()
            index = [r.index for r in part.responses]
            for k, name in enumerate(part.locals):
                if name in nuisance:
                    mine = nuisance[name][index]
                    values[:, k] = np.where(np.isfinite(mine), mine, values[:, k])
            found.append(values)
        return found

    def by_name(self, local: Sequence[FloatArray]) -> dict[str, FloatArray]:
        """The inverse of `placed`: NaN where a segment has no such parameter."""
        found: dict[str, FloatArray] = {}
        for part, values in zip(self.parts, local, strict=True):
            for k, name in enumerate(part.locals):
                column = found.setdefault(name, np.full(len(self.segments), np.nan))
                column[[r.index for r in part.responses]] = values[:, k]
        return found

    def thinned(self, every: int) -> Problem:
        """The same problem on each `every`-th response of every kind of step, sharing what was compiled."""
        order = sorted(range(len(self.segments)), key=lambda i: (self.segments[i].cell_key, self.segments[i].repeat))
        keep = set(order[::every])
        parts = []
        for part in self.parts:
            rows = [j for j, r in enumerate(part.responses) if r.index in keep]
            rows = rows if len(rows) >= 4 else list(range(len(part.responses)))
            parts.append(part.only(rows))
        return replace(self, parts=tuple(parts))

    def full_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Every parameter of the model: given values, ties followed, the rest as at the start."""
        full = {**self.values, **{k: float(v) for k, v in values.items() if k in self.values}}
        for name, source in self.ties.items():
            full[name] = full[source]
        return full

    def evaluate(
        self,
        values: Mapping[str, float],
        local: Sequence[FloatArray] | None = None,
        free: Sequence[str] | None = None,
    ) -> list[PartEvaluation]:
        """Residuals of every part, and Jacobians by `free` (and the locals) unless it is None.

        values: parameters by name; local: per part (m, n_locals), measured initial states where None.
        """
        full = self.full_values(values)
        return [
            self._evaluate_part(i, full, part.start_local() if local is None else local[i], free)
            for i, part in enumerate(self.parts)
        ]

    def _evaluate_part(
        self, i: int, full: Mapping[str, float], local: FloatArray, free: Sequence[str] | None
    ) -> PartEvaluation:
        part = self.parts[i]
        sensitivities = free is not None
        # A tied parameter moves with its source: both columns are needed, and added up.
        wanted = [] if free is None else [*free, *(k for k, v in self.ties.items() if v in free)]
        free_here = tuple(n for n in part.block.params if n in wanted)
        kernel = self._kernel(i, free_here, ())
        p = np.array([full[n] for n in part.block.params])
        y, dy = np.zeros(part.y.shape), np.zeros((*part.y.shape, kernel.n_columns if sensitivities else 0))
        for batch in self._batches(i, (float(part.block.delay_s(p)), max_step_s(part.block, full))):
            kernel = self._kernel(i, free_here, batch.cutoffs)
            members = slice(None) if len(batch.members) == len(y) else batch.members
            made = kernel.at_samples(p, local[members], batch.nodes, part.mask[members], sensitivities)
            if len(batch.members) == len(y):
                y, dy = made
            else:
                y[members], dy[members] = made
        residual = np.where(part.mask, part.y - y, 0.0)
        if not sensitivities:
            return PartEvaluation(residual, dy, ())
        columns = list(kernel.free)
        for name in [c for c in columns if c in self.ties]:
            source, at = self.ties[name], columns.index(name)
            if source in columns:
                dy[..., columns.index(source)] += dy[..., at]
                dy = np.delete(dy, at, axis=-1)
                columns.pop(at)
            else:
                columns[at] = source
        return PartEvaluation(residual, dy, (*columns, *part.locals))

    def _batches(self, i: int, key: tuple[float, float]) -> list[_Batch]:
        """The responses of a part for a delay and a longest step, those of like filters together; one point is often asked for twice."""
        part = self.parts[i]
        if i in self._laid_out and self._laid_out[i][0] == key:
            return self._laid_out[i][1]
        alike: dict[Cutoffs, list[int]] = {}
        for j, response in enumerate(part.responses):
            alike.setdefault(self._cutoffs(part, response.index), []).append(j)
        found = [
            _Batch(cutoffs, np.array(members), Stacked.of([part.responses[j] for j in members]).nodes(*key))
            for cutoffs, members in alike.items()
        ]
        self._laid_out[i] = key, found
        return found

    def _cutoffs(self, part: Part, index: int) -> Cutoffs:
        """Known measurement filters of a segment: (output, Hz) of those that have one."""
        known = self.segments[index].context.filters
        return tuple((c, float(hz)) for c in part.outputs if (hz := known.get(CHANNELS[c].group, 0.0)) > 0.0)

    def _kernel(self, i: int, free: tuple[str, ...], cutoffs: Cutoffs) -> Kernel:
        part = self.parts[i]
        key = (part.block.name, part.outputs, free, cutoffs)
        if key not in self._kernels:
            self._kernels[key] = Kernel(part.block, part.outputs, free, dict(cutoffs))
        return self._kernels[key]


def prior_std(part: Part, noise: Noise) -> FloatArray:
    """(m, n_locals) prior standard deviations of the locals about `part.start_local()`."""
    extra = np.array([noise.disturbance[n] for n in part.block.disturbances])
    return np.concatenate([part.start_std, np.tile(extra, (len(part.responses), 1))], axis=1)


def _part(
    segments: Sequence[Segment],
    members: Sequence[int],
    block: Block,
    outputs: tuple[str, ...],
    model: Model,
    start: Mapping[str, float],
) -> Part:
    delay = start.get("T_d_attitude", start.get("T_d", 0.1))
    made = tuple(prepare(segments[i], i, block, outputs, model.nominal_voltage_v, delay, start["K"]) for i in members)
    n = max(r.t_s.size for r in made)
    y = np.full((len(made), n, len(outputs)), np.nan)
    for j, r in enumerate(made):
        y[j, : r.t_s.size] = r.y
    mask = np.isfinite(y)
    return Part(
        block,
        outputs,
        made,
        np.where(mask, y, 0.0),
        mask,
        np.stack([r.start for r in made]),
        np.stack([r.start_std for r in made]),
    )
