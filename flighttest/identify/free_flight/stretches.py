"""Stretches of free flight without gaps, and the pieces of them that are integrated side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS
from flighttest.estimation.integration.kernel import Kernel
from flighttest.estimation.responses import Response, Stacked, attitude_is_known, max_step_s, prepare
from flighttest.physics.blocks import VELOCITY, Block
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

JOIN_PERIODS = 2.5  # windows this near to each other are one stretch
SHORTEST_S = 4.0
CHUNK_S = 10.0  # of a stretch, integrated side by side
LEAD_S = 1.0  # before each, in which the initial state is forgotten: five time constants of slow motors and of slow attitude loops
# The same where a term has states of unknown start, a swinging load: 95 % of a swing with a damping ratio of 0.05 on a cable of 1 m.
MEMORY_S, MEMORY_CHUNK_S = 20.0, 40.0


def stretches(segments: Sequence[Segment], part: str = "translation") -> list[Segment]:
    """Usable segments of each recording with what a part of the model is estimated from (`estimation.estimator.BLOCKS`), those that adjoin
    or overlap joined: attitude; for the translation heading, velocity and throttle, too."""
    can = _translates if part == "translation" else attitude_is_known
    fit = [s for s in segments if s.usable and s.t_s.size > 2 and can(s)]
    groups: list[list[Segment]] = []
    for s in sorted(fit, key=lambda s: (s.run, s.t_s[0])):
        if groups:
            before = groups[-1][-1]
            period = float(np.median(np.diff(before.t_s)))
            if before.run == s.run and s.t_s[0] - before.t_s[-1] <= JOIN_PERIODS * period:
                groups[-1].append(s)
                continue
        groups.append([s])
    return [one for one in (_joined(g) for g in groups) if one.t_s[-1] - one.t_s[0] >= SHORTEST_S]


def _translates(s: Segment) -> bool:
    velocity = all(np.isfinite(s.y.get(n, np.nan)).any() for n in VELOCITY)
    heading = bool(np.isfinite(s.y.get("yaw_rad", np.nan)).any())
    return velocity and heading and "throttle" in s.u and attitude_is_known(s)


def _joined(windows: Sequence[Segment]) -> Segment:
    """One segment of windows in order."""
    t = np.concatenate([w.t_s for w in windows])
    t, first = np.unique(t, return_index=True)
    names = dict.fromkeys(n for w in windows for n in w.y)
    y = {n: np.concatenate([w.y.get(n, np.full(w.t_s.size, np.nan)) for w in windows])[first] for n in names}
    if "yaw_rad" in y:
        good = np.isfinite(y["yaw_rad"])
        y["yaw_rad"][good] = np.unwrap(y["yaw_rad"][good])
    u: dict[str, tuple[FloatArray, FloatArray]] = {}
    for w in windows:
        for name, (times, values) in w.u.items():
            if name not in u:
                u[name] = times, values
                continue
            new = times > u[name][0][-1]
            u[name] = np.append(u[name][0], times[new]), np.append(u[name][1], values[new])
    head = windows[0]
    context = replace(head.context, voltage_samples=None)
    return replace(head, name=f"{head.run} {t[0]:.0f} s", t_s=t, y=y, u=u, context=context)


class Residual(NamedTuple):
    """What one equation leaves over a stretch. channel; residual (n,) measured less modelled; slopes (n, q) derivatives of the modelled by
    the parameters asked for; state (n, k) that the equation may be wrong as a function of (`estimation.equation_error.lack_of_fit`)."""

    channel: str
    residual: FloatArray
    slopes: FloatArray
    state: FloatArray


def sampling_period_s(flown: Sequence[Segment]) -> float:
    """Median time between samples."""
    return float(np.median(np.concatenate([np.diff(s.t_s) for s in flown])))


def chunk(s: Segment, changed: Mapping[str, FloatArray], a: int, b: int) -> Segment:
    """Samples a to b of a stretch, with the edges that reach into them; changed: channels in the place of those recorded."""
    y = {n: v[a:b] for n, v in {**s.y, **changed}.items()}
    u = {}
    for name, (times, values) in s.u.items():
        first = max(int(np.searchsorted(times, s.t_s[a] - 1.0)) - 1, 0)
        last = max(int(np.searchsorted(times, s.t_s[b - 1])), first + 1)
        u[name] = times[first:last], values[first:last]
    return replace(s, t_s=s.t_s[a:b], y=y, u=u)


def unbroken(t: FloatArray, good: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Index ranges without holes: samples that are good and follow each other."""
    if t.size < 3:
        return []
    period = float(np.median(np.diff(t)))
    breaks = np.flatnonzero(~good[1:] | ~good[:-1] | (np.diff(t) > JOIN_PERIODS * period)) + 1
    bounds = [0, *breaks.tolist(), t.size]
    return [(a, b) for a, b in pairwise(bounds) if b - a >= 3 and good[a:b].all()]


@dataclass
class Chunks:
    """Stretches of one flight in pieces of `CHUNK_S`, each with a lead of its own before it. kept: per piece its samples behind the lead;
    at: these samples in its stretch; stretch: which it is of."""

    pieces: list[Segment]
    kept: list[slice]
    at: list[slice]
    stretch: list[int]
    _kernels: dict[tuple[str, tuple[str, ...]], Kernel] = field(default_factory=dict)

    @classmethod
    def of(cls, flown: Sequence[Segment], long_memory: bool, changed: Sequence[Mapping[str, FloatArray]]) -> Chunks:
        """changed: per stretch, channels in the place of those recorded; long_memory: whether initial states are forgotten slowly."""
        made = cls([], [], [], [])
        lead_s, length_s = (MEMORY_S, MEMORY_CHUNK_S) if long_memory else (LEAD_S, CHUNK_S)
        for k, (s, other) in enumerate(zip(flown, changed, strict=True)):
            period = float(np.median(np.diff(s.t_s)))
            starts = np.arange(s.t_s[0] + LEAD_S, s.t_s[-1], length_s)
            for start, end in pairwise([*starts, s.t_s[-1] + period]):
                a = int(np.searchsorted(s.t_s, start - lead_s - 1e-9))
                first, b = int(np.searchsorted(s.t_s, start - 1e-9)), int(np.searchsorted(s.t_s, end - 1e-9))
                if b - first < 3:
                    continue
                made.pieces.append(chunk(s, other, a, b))
                made.kept.append(slice(first - a, b - a))
                made.at.append(slice(first, b))
                made.stretch.append(k)
        return made

    def simulated(
        self, block: Block, outputs: tuple[str, ...], model: Model, values: Mapping[str, float], names: Sequence[str]
    ) -> list[tuple[int, FloatArray, FloatArray]]:
        """(stretch, outputs (n, c), their derivatives by `names` (n, c, q)) at the samples kept of every stretch, without disturbances."""
        if not self.pieces:
            return []
        free = tuple(n for n in block.params if n in names)
        p = np.array([values[n] for n in block.params])
        made = [
            prepare(s, i, block, outputs, model.nominal_voltage_v, 0.0, values["K"]) for i, s in enumerate(self.pieces)
        ]
        nodes = Stacked.of(made).nodes(float(block.delay_s(p)), max_step_s(block, values))
        mask = np.zeros((len(made), max(r.t_s.size for r in made), len(outputs)), dtype=bool)
        for j, r in enumerate(made):
            mask[j, : r.t_s.size] = True
        known = self.pieces[0].context.filters
        filters = {c: hz for c in outputs if (hz := float(known.get(CHANNELS[c].group, 0.0))) > 0.0}
        kernel = self._kernels.setdefault((block.name, free), Kernel(block, outputs, free, filters))
        y, dy = kernel.at_samples(p, _start(made, block), nodes, mask, True)
        found = []
        for k in dict.fromkeys(self.stretch):
            here = [j for j, of in enumerate(self.stretch) if of == k]
            predicted = np.concatenate([y[j, self.kept[j]] for j in here])
            slopes = np.zeros((*predicted.shape, len(names)))
            slopes[..., [list(names).index(n) for n in free]] = np.concatenate(
                [dy[j, self.kept[j], :, : len(free)] for j in here]
            )
            found.append((k, predicted, slopes))
        return found

    def along(self, k: int, values: FloatArray) -> FloatArray:
        """Of values (n, ...) of a stretch those at the samples kept."""
        return np.concatenate([values[at] for at, of in zip(self.at, self.stretch, strict=True) if of == k])


def _start(made: Sequence[Response], block: Block) -> FloatArray:
    """(m, n_locals) measured initial states, no disturbance."""
    return np.stack([np.concatenate([r.start, np.zeros(len(block.disturbances))]) for r in made])
