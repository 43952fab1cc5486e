"""One block of the model integrated over many responses at once, with exact derivatives of what is integrated.

A response is a row of nodes: sample times and delayed input edges, merged (see `estimation.responses`). Between nodes inputs are constant,
so one RK4 step per node is smooth in the state and the parameters. Of the delay the derivative is that of the continuous solution: where
inputs change from u to v, that of the state jumps by f(x, u) - f(x, v), since a later edge keeps the old rate for longer
(jump of forward sensitivities at a discontinuity; Rozenvasser 1967). (Nodes that move
with the delay would take the measured signals along, which are functions of time and not of the delay.) No output depends on an input
directly.

Where a C compiler is at hand this is done by `kernel.c`, else in numpy, in three passes. The states are stepped through time by a compiled
chain, one response after the other. Once they are known every piece can be differentiated by itself: the four stages of all pieces at once,
in numpy (`physics.vectorised`), give A and B of S_next = A S + B. What is left in sequence is this product of small matrices. Known
second-order filters of measured channels follow on top (`estimation.integration.filters`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.integration.compiled import CHAIN, Slopes, chain, differentiated
from flighttest.estimation.integration.filters import filtered
from flighttest.estimation.integration.native import library
from flighttest.estimation.integration.native_block import NativeBlock
from flighttest.estimation.responses import Nodes
from flighttest.physics.blocks import Block

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
PIECES_PER_CALL = 4096  # differentiated at once, in whole responses


@dataclass
class Kernel:
    """Integrates `block` and differentiates `outputs` by `free` parameters, free initial states and disturbances.

    filters_hz: output name to cut-off of its known measurement filter. Columns of a Jacobian: `free`, then locals: free initial states
    and disturbances. What is compiled is kept with the block.
    """

    block: Block
    outputs: tuple[str, ...]
    free: tuple[str, ...]
    filters_hz: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        block = self.block
        self.free = tuple(n for n in self.free if n in block.params)
        self.locals = (*(f"{n}(0)" for n in block.free_states), *block.disturbances)
        self.n_columns = len(self.free) + len(self.locals)
        self.n_data = 1 + len(block.inputs) + 2 * len(block.exogenous)
        self._n_x, self._n_free_x = len(block.states), len(block.free_states)
        self._filtered = [i for i, n in enumerate(self.outputs) if n in self.filters_hz]
        self._started = np.array([block.states.index(n) for n in block.free_states], dtype=np.intp)

    def run(
        self, p: FloatArray, local: FloatArray, nodes: FloatArray, sensitivities: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate m responses over k nodes.

        p: (n_params,) values of block.params, or (m, n_params) for responses of several vehicles or days with the same delay; local: (m,
        n_local); nodes: (m, k, n_data) rows of [h, u, e at the start, e at the end]. Returns y (m, k, n_outputs) and dy (m, k, n_outputs,
        n_columns), the latter empty without sensitivities.
        """
        m, k, _ = nodes.shape
        first = k * np.arange(m + 1)
        every = Nodes(nodes.reshape(m * k, -1), first, np.arange(m * k), first)
        return self.at_samples(p, local, every, np.ones((m, k, len(self.outputs)), dtype=bool), sensitivities)

    def at_samples(
        self, p: FloatArray, local: FloatArray, nodes: Nodes, mask: BoolArray, sensitivities: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate m responses at their samples: y (m, n, n_outputs) and dy (m, n, n_outputs, n_columns), the latter 0 where mask (m, n,
        n_outputs) is."""
        m, n, n_y = mask.shape
        p = np.broadcast_to(p, (m, len(self.block.params)))
        if (native := self._native()) is not None:
            return native.run(p, local, nodes, mask, self._delay_slope(p[0]), slopes=sensitivities)
        y = np.zeros((m, n, n_y))
        dy = np.zeros((m, n, n_y, self.n_columns if sensitivities else 0))
        for which, stacked, samples in nodes.padded:
            made, slopes = self._in_numpy(p[which], local[which], stacked, sensitivities)
            for at, (j, sample) in enumerate(zip(which, samples, strict=True)):
                y[j, : sample.size] = made[at, sample]
                if sensitivities:
                    dy[j, : sample.size] = slopes[at, sample]
        dy *= mask[..., None]
        return y, dy

    def _native(self) -> NativeBlock | None:
        """The block compiled for `kernel.c`, None where that is not to be had."""
        if library() is None:
            return None
        key = ("native", self.outputs, self.free, tuple(self.filters_hz.items()))
        if key not in self.block.made:
            try:
                self.block.made[key] = NativeBlock(self.block, self.outputs, self.free, self.filters_hz)
            except ValueError:
                self.block.made[key] = None
        found: NativeBlock | None = self.block.made[key]
        return found

    def _in_numpy(
        self, p: FloatArray, local: FloatArray, nodes: FloatArray, sensitivities: bool
    ) -> tuple[FloatArray, FloatArray]:
        """As `run`, some responses at once."""
        m, k, _ = nodes.shape
        some = max(1, PIECES_PER_CALL // k)
        # A trial step of a solver may diverge: its cost is then infinite, and it is refused.
        with np.errstate(all="ignore"):
            made = [
                self._run(p[at], local[at], nodes[at], sensitivities)
                for at in (slice(first, first + some) for first in range(0, m, some))
            ]
        return np.concatenate([y for y, _ in made]), np.concatenate([dy for _, dy in made])

    def _run(
        self, p: FloatArray, local: FloatArray, nodes: FloatArray, sensitivities: bool
    ) -> tuple[FloatArray, FloatArray]:
        m, k, _ = nodes.shape
        x, middle = self._states(p, local, nodes)
        data = np.ascontiguousarray(nodes.transpose(2, 1, 0))
        n_u, n_e, shape = len(self.block.inputs), len(self.block.exogenous), (k, m)
        before = np.concatenate([data[1 : 1 + n_u, :1], data[1 : 1 + n_u, :-1]], axis=1)
        flat = data.reshape(len(data), -1)
        now = _Pieces(
            p[0] if (p == p[0]).all() else list(np.tile(p.T, (1, k))),
            flat[0],
            list(flat[1 : 1 + n_u]),
            list(flat[1 + n_u : 1 + n_u + n_e]),
            list(flat[1 + n_u + n_e :]),
            list(np.tile(local[:, self._n_free_x :].T, (1, k))),
            x[:, :-1].reshape(self._n_x, -1),
            x[:, 1:].reshape(self._n_x, -1),
            None if middle is None else middle.reshape(self._n_x, -1),
        )
        # Outputs, of which a filter sees the start and the middle of each piece, too.
        states = [(now.x1, now.e1)] if now.xm is None else [(now.x0, now.e0), (now.xm, now.em), (now.x1, now.e1)]
        y = self._low_passed([self._observe(now, *at).T for at in states], now.h, shape)
        dy = np.empty((k * m, len(self.outputs), 0))
        if sensitivities:
            slopes = self._sensitivities(now, list(before.reshape(n_u, -1)), self._delay_slope(p[0]), shape)
            tangents = [self._report(now, *at, slope) for at, slope in zip(states, slopes, strict=True)]
            dy = self._low_passed(tangents, now.h, shape)
        return y.reshape(*shape, -1).swapaxes(0, 1), dy.reshape(*shape, *dy.shape[1:]).swapaxes(0, 1)

    def _low_passed(self, ends: Sequence[FloatArray], h: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """(n, n_outputs, ...) at the end of each piece, through the filters that are known. ends: at its start, middle and end, or at the
        last of these alone where there are no filters."""
        found = ends[-1]
        for hz in dict.fromkeys(self.filters_hz[self.outputs[i]] for i in self._filtered):
            alike = [i for i in self._filtered if self.filters_hz[self.outputs[i]] == hz]
            found[:, alike] = filtered(hz, [one[:, alike] for one in ends], h, shape)
        return found

    def _states(self, p: FloatArray, local: FloatArray, nodes: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """States before the first piece and after each (n_x, k + 1, m), and in the middle of each (n_x, k, m) where a filter needs it."""
        m, k, _ = nodes.shape
        block, middles = self.block, bool(self._filtered)
        now = np.tile([block.initial.get(n, 0.0) for n in block.states], (m, 1))
        now[:, self._started] = local[:, : self._n_free_x]
        x = np.empty((self._n_x, k + 1, m))
        middle = np.empty((self._n_x, k, m)) if middles else None
        x[:, 0] = now.T
        function = self._mapped(m, middles)
        buffer, step = function.buffer()
        each, d = np.ascontiguousarray(p), np.ascontiguousarray(local[:, self._n_free_x :])
        size = self._n_x * (2 if middles else 1)
        made, part = np.empty((m, CHAIN, size)), np.empty((m, CHAIN, self.n_data))
        start = np.ascontiguousarray(now)
        for i, argument in enumerate((start, each, d, part)):
            buffer.set_arg(i, memoryview(argument.reshape(-1).data))
        buffer.set_res(0, memoryview(made.reshape(-1).data))
        for first in range(0, k, CHAIN):
            pieces = slice(first, min(first + CHAIN, k))
            count = pieces.stop - first
            part[:, :count] = nodes[:, pieces]
            part[:, count:] = nodes[:, -1:]
            step()
            after = made[:, :count].transpose(2, 1, 0)
            x[:, first + 1 : pieces.stop + 1] = after[: self._n_x]
            if middle is not None:
                middle[:, pieces] = after[self._n_x :]
            start[:] = made[:, count - 1, : self._n_x]
        return x, middle

    def _mapped(self, m: int, middles: bool) -> Any:
        made = self.block.made
        key = ("states", m, middles)
        if key not in made:
            if ("chain", middles) not in made:
                made["chain", middles] = chain(self.block, middles)
            made[key] = made["chain", middles].map(m)
        return made[key]

    def _observe(self, now: _Pieces, x: FloatArray, e: list[FloatArray]) -> FloatArray:
        """Outputs (n_outputs, n) before filters."""
        return self._slopes("y", alone=True)(list(x), now.p, now.u, e, now.d)[0]

    def _report(self, now: _Pieces, x: FloatArray, e: list[FloatArray], slope: FloatArray) -> FloatArray:
        """Derivatives of the outputs before filters (n, n_outputs, n_columns), given those of the states."""
        _, entries = self._slopes("y")(list(x), now.p, now.u, e, now.d)
        rows, columns = self._slopes("y").at
        by_state = columns < self._n_x
        jacobian = np.zeros((slope.shape[0], len(self.outputs), self._n_x))
        jacobian[:, rows[by_state], columns[by_state]] = entries[:, by_state]
        dy: FloatArray = jacobian @ slope
        dy[:, rows[~by_state], columns[~by_state] - self._n_x] += entries[:, ~by_state]
        return dy

    def _sensitivities(
        self, now: _Pieces, u_before: list[FloatArray], delay_slope: FloatArray, shape: tuple[int, int]
    ) -> list[FloatArray]:
        """Derivatives of the states (n, n_x, n_columns) at the end of each piece; where there are filters at its start and in its middle
        before that. u_before: inputs of the piece before."""
        after, middle = self._pieces(now)
        n_x, n_c = self._n_x, self.n_columns
        by_x, rest = after[..., :n_x].reshape(*shape, n_x, n_x), after[..., n_x:].reshape(*shape, n_x, n_c)
        rate = self._slopes("x_dot", alone=True)
        kept, new = (rate(list(now.x0), now.p, u, now.e0, now.d)[0] for u in (u_before, now.u))
        jump = (kept - new).T.reshape(*shape, n_x, 1) * delay_slope
        starts, ends = np.empty((2, *shape, n_x, n_c))
        last = np.zeros((shape[1], n_x, n_c))
        last[:, self._started, len(self.free) + np.arange(self._n_free_x)] = 1.0
        for i in range(shape[0]):
            np.add(last, jump[i], out=starts[i])
            last = np.matmul(by_x[i], starts[i], out=ends[i])
            last += rest[i]
        start, end = starts.reshape(-1, n_x, n_c), ends.reshape(-1, n_x, n_c)
        return [end] if middle is None else [start, middle[..., :n_x] @ start + middle[..., n_x:], end]

    def _pieces(self, now: _Pieces) -> tuple[FloatArray, FloatArray | None]:
        """Of the state after each piece, and in its middle: derivatives by the state before it, then by the columns, (n, n_x, ...)."""
        slopes, n_x = self._slopes("x_dot"), self._n_x
        rows, columns = slopes.at
        inner, h = columns < n_x, now.h[:, None, None]
        unit, jacobian = np.eye(n_x, n_x + self.n_columns), np.zeros((now.h.size, n_x, n_x))
        x, d_x, rates = now.x0, np.broadcast_to(unit, (now.h.size, *unit.shape)), []
        for ahead, e in ((0.5, now.e0), (0.5, now.em), (1.0, now.em), (0.0, now.e1)):
            k, entries = slopes(list(x), now.p, now.u, e, now.d)
            jacobian[:, rows[inner], columns[inner]] = entries[:, inner]
            rates.append(jacobian @ d_x)
            rates[-1][:, rows[~inner], columns[~inner]] += entries[:, ~inner]
            x, d_x = now.x0 + ahead * now.h * k, unit + ahead * h * rates[-1]
        after = unit + h / 6.0 * (rates[0] + 2.0 * (rates[1] + rates[2]) + rates[3])
        return after, None if now.xm is None else 0.5 * (unit + after) + h / 8.0 * (rates[0] - rates[3])

    def _delay_slope(self, p: FloatArray) -> FloatArray:
        """Derivative of the delay by each column."""
        made = self.block.made
        if "delay" not in made:
            q = ca.SX.sym("p", len(self.block.params))
            made["delay"] = ca.Function("delay", [q], [ca.densify(ca.jacobian(self.block.delay_s(q), q))])
        slope = np.asarray(made["delay"](p)).ravel()
        found = np.zeros(self.n_columns)
        found[: len(self.free)] = slope[[self.block.params.index(n) for n in self.free]]
        return found

    def _slopes(self, what: str, *, alone: bool = False) -> Slopes:
        """The block's rate ('x_dot') or outputs ('y') with its Jacobian by the states, then the columns; alone: without."""
        free = None if alone else self.free
        key = (what, self.outputs if what == "y" else (), free)
        if key not in self.block.made:
            self.block.made[key] = differentiated(self.block, what, self.outputs, free)
        found = self.block.made[key]
        assert isinstance(found, Slopes)
        return found


@dataclass(frozen=True)
class _Pieces:
    """Some pieces of all responses, n in all: parameters, the same for all or rows of them; lengths h (n,), rows of inputs, of measured
    signals at both ends, of disturbances; states before, after and in the middle of each, (n_x, n)."""

    p: FloatArray | list[FloatArray]
    h: FloatArray
    u: list[FloatArray]
    e0: list[FloatArray]
    e1: list[FloatArray]
    d: list[FloatArray]
    x0: FloatArray
    x1: FloatArray
    xm: FloatArray | None

    @property
    def em(self) -> list[FloatArray]:
        """Measured signals in the middle."""
        return [0.5 * (a + b) for a, b in zip(self.e0, self.e1, strict=True)]
