"""One block of the model over stretches of flight, in pieces that are integrated side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS
from flighttest.estimation.equation_error import InitialStates
from flighttest.estimation.integration.compiled import late_parameters
from flighttest.estimation.integration.kernel import Kernel
from flighttest.estimation.integration.native_block import LANES
from flighttest.estimation.responses import Response, Stacked, max_step_s, prepare
from flighttest.identify.free_flight.stretches import chunk
from flighttest.physics.blocks import Block
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
InitialValues: TypeAlias = Mapping[str, FloatArray]
"""State to its initial value in every piece (pieces,), in units of its prior standard deviation."""

CHUNK_S = 10.0  # the longest piece of a stretch
LEAST_SAMPLES = 3  # of a piece: an equation is between two, and `unbroken` asks for three
LEAD_S = 1.0  # before each, in which the initial state is forgotten: five time constants of slow motors and of slow attitude loops
# The same where a term has states of unknown start, a swinging load: 95 % of a swing with a damping ratio of 0.05 on a cable of 1 m.
MEMORY_S, MEMORY_CHUNK_S = 20.0, 40.0


class _Piece(NamedTuple):
    """A piece of a stretch with a lead before it. kept: its samples behind the lead; at: positions (n,) of these in the stretch; first:
    position in the stretch that it is integrated from."""

    segment: Segment
    kept: slice
    at: IndexArray
    first: int


class Chunks:
    """Each piece of a stretch has a lead of its own before it. There are as many as fill the lanes of the kernel, in which sixteen take no
    longer than the longest of them. count_initial: how many initial states they have (`estimation.equation_error.initial_states`)."""

    def __init__(
        self,
        flown: Sequence[Segment],
        block: Block,
        outputs: tuple[str, ...],
        model: Model,
        *,
        long_memory: bool = False,
        changed: Sequence[Mapping[str, FloatArray]] = (),
    ) -> None:
        """flown: of one flight or several, whose channels had the same filters; long_memory: whether initial states are forgotten slowly;
        changed: per stretch, channels in the place of those recorded, the same whenever they are given for it."""
        self._block, self._outputs = block, outputs
        lead_s, most_s = (MEMORY_S, MEMORY_CHUNK_S) if long_memory else (LEAD_S, CHUNK_S)
        whole_s = sum(float(np.ptp(s.t_s)) for s in flown)
        length_s = whole_s / (LANES * math.ceil(whole_s / (LANES * most_s)))
        others = changed or [{}] * len(flown)
        cut = [
            s.once(("pieces", lead_s, length_s, *other), partial(_cut, s, other, lead_s, length_s))
            for s, other in zip(flown, others, strict=True)
        ]
        self._at = [np.concatenate([p.at for p in pieces]) for pieces in cut]
        pieces = [p for some in cut for p in some]
        made, gained = (
            [prepare(p.segment, i, block, outputs, model.nominal_voltage_v, 0.0, gain) for i, p in enumerate(pieces)]
            for gain in (0.0, 1.0)
        )
        self._start = _start(made, block)
        self._start_by_gain = (
            _start(gained, block) - self._start
        )  # that of a thrust which was not measured is linear in K
        self._stacked = Stacked.of(made)
        sizes = np.array([r.t_s.size for r in made])
        within = np.arange(sizes.max()) < sizes[:, None]
        self._mask = np.repeat(within[..., None], len(outputs), axis=2)
        self._late = [block.params.index(n) for n in late_parameters(block)]
        self._stretch = np.repeat(np.arange(len(cut)), [len(some) for some in cut])
        # Of each stretch the rows of its samples, where those of all pieces are one after the other.
        row = [sizes.max() * i + np.arange(sizes[i])[p.kept] for i, p in enumerate(pieces)]
        ends = np.cumsum([0, *map(len, cut)])
        self._rows = [np.concatenate(row[a:b]) for a, b in pairwise(ends)]
        # Pieces that are integrated from the same sample begin in the same states.
        begins = dict.fromkeys((k, p.first) for k, some in enumerate(cut) for p in some)
        number = {one: i for i, one in enumerate(begins)}
        self.count_initial = len(begins)
        self._number = [
            np.concatenate([np.full(p.at.size, number[k, p.first]) for p in some]) for k, some in enumerate(cut)
        ]
        self._number_of_piece = np.array([number[k, p.first] for k, some in enumerate(cut) for p in some])
        self._spread = {n: block.spread[n] for n in block.free_states if n in block.spread}
        known = flown[0].context.filters
        self._filters = {c: hz for c in outputs if (hz := float(known.get(CHANNELS[c].group, 0.0))) > 0.0}

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Names of the states whose initial values nothing measured."""
        return tuple(self._spread)

    def simulated(
        self, values: Sequence[Mapping[str, float]], names: Sequence[str], initial: InitialValues
    ) -> list[tuple[FloatArray, FloatArray]]:
        """values: for each stretch, of the same delays. Of every stretch the outputs (n, c) at the samples kept, without
        disturbances, and their derivatives (n, c, q + k) by q `names` and by the k initial states that nothing measured, in units of their
        prior standard deviation, about `initial`, 0 where none."""
        block, width = self._block, len(self._outputs)
        free = tuple(n for n in block.params if n in names)
        p = np.array([[one[n] for n in block.params] for one in values])
        if np.ptp(p[:, self._late], axis=0).any():
            raise ValueError("flights that are integrated together have the same delays")
        step_s = min(max_step_s(block, one) for one in values)
        nodes = self._stacked.nodes(float(block.delay_s(p[0])), step_s)
        kernel = Kernel(block, self._outputs, free, self._filters)
        gain = np.array([one["K"] for one in values])[self._stretch, None]
        start = self._start + gain * self._start_by_gain
        for n in self._spread.keys() & initial.keys():
            start[:, block.free_states.index(n)] += self._spread[n] * initial[n][self._number_of_piece]
        y, dy = kernel.at_samples(p[self._stretch], start, nodes, self._mask, True)
        y, dy = y.reshape(-1, width), dy.reshape(-1, width, dy.shape[-1])
        columns = [list(names).index(n) for n in free]
        unknown = [len(free) + block.free_states.index(n) for n in self._spread]
        spread = np.array([*self._spread.values()])
        found = []
        for rows in self._rows:
            slopes = np.zeros((rows.size, width, len(names) + len(unknown)))
            slopes[..., columns] = dy[rows, :, : len(free)]
            slopes[..., len(names) :] = dy[rows][..., unknown] * spread
            found.append((y[rows], slopes))
        return found

    def initial_states(
        self, k: int, slopes: FloatArray, rows: IndexArray | slice, initial: InitialValues
    ) -> InitialStates:
        """What the samples `rows` of those kept of a stretch began from, with derivatives (n, k) there, about `initial`."""
        if not slopes.shape[1]:
            return InitialStates()
        number, none = self._number[k][rows], np.zeros(self.count_initial)
        return InitialStates(slopes, number, np.stack([initial.get(n, none)[number] for n in self._spread], axis=1))

    def along(self, k: int, values: FloatArray) -> FloatArray:
        """Of values (n, ...) of a stretch those at the samples kept."""
        found: FloatArray = values[self._at[k]]
        return found


def _cut(s: Segment, changed: Mapping[str, FloatArray], lead_s: float, length_s: float) -> list[_Piece]:
    """A stretch in pieces of equal length, about `length_s` but no shorter than `LEAD_S` or ten samples; without those in a hole."""
    period = float(np.median(np.diff(s.t_s)))
    begin, end = s.t_s[0] + LEAD_S, s.t_s[-1] + period
    count = max(round((end - begin) / max(length_s, LEAD_S, 10.0 * period)), 1)
    found = []
    for start, stop in pairwise(np.linspace(begin, end, count + 1) - 1e-9):
        a, first, b = (int(np.searchsorted(s.t_s, t)) for t in (start - lead_s, start, stop))
        if b - first >= LEAST_SAMPLES:
            found.append(_Piece(chunk(s, changed, a, b), slice(first - a, b - a), np.arange(first, b), a))
    return found


def _start(made: Sequence[Response], block: Block) -> FloatArray:
    """(m, n_locals) measured initial states, no disturbance."""
    return np.stack([np.concatenate([r.start, np.zeros(len(block.disturbances))]) for r in made])
