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

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.integration.compiled import CHAIN, Slopes, chain, differentiated, observed, rate_of
from flighttest.estimation.integration.filters import Butterworth
from flighttest.estimation.integration.native import library
from flighttest.estimation.integration.native_block import NativeBlock, NodeRows
from flighttest.estimation.responses import Nodes
from flighttest.physics.blocks import Block
from flighttest.physics.vectorised import Vectorised

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
RESPONSES_PER_CALL = 96
FLIGHTS_KEPT = 12  # batches of responses of a block whose states are kept
PIECES_PER_CHUNK = 1024  # differentiated at once: what the processor's cache holds


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
        self._filters = Butterworth.of([self.filters_hz[self.outputs[i]] for i in self._filtered])
        self._started = np.array([block.states.index(n) for n in block.free_states], dtype=np.intp)

    def run(
        self, p: FloatArray, local: FloatArray, nodes: FloatArray, sensitivities: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate m responses over k nodes.

        p: (n_params,) values of block.params; local: (m, n_local); nodes: (m, k, n_data) rows of [h, u, e at the start, e at the end].
        Returns y (m, k, n_outputs) and dy (m, k, n_outputs, n_columns), the latter empty without sensitivities.
        """
        m, k, _ = nodes.shape
        if (native := self._native()) is not None:
            first, target = k * np.arange(m + 1), np.tile(np.arange(k), m)
            rows, slope = NodeRows(nodes.reshape(m * k, -1), first, target), self._delay_slope(p)
            return native.run(p, local, rows, k, None, slope, slopes=sensitivities)
        y = np.empty((m, k, len(self.outputs)))
        dy = np.empty((m, k, len(self.outputs), self.n_columns if sensitivities else 0))
        # A trial step of a solver may diverge: its cost is then infinite, and it is refused.
        with np.errstate(all="ignore"):
            for first in range(0, m, RESPONSES_PER_CALL):
                some = slice(first, min(first + RESPONSES_PER_CALL, m))
                self._run(p, local[some], nodes[some], y[some], dy[some])
        return y, dy

    def at_samples(
        self, p: FloatArray, local: FloatArray, nodes: Nodes, mask: BoolArray, sensitivities: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate m responses at their samples: y (m, n, n_outputs) and dy (m, n, n_outputs, n_columns), the latter 0 where mask (m, n,
        n_outputs) is."""
        m, n, n_y = mask.shape
        if (native := self._native()) is not None:
            rows = NodeRows(nodes.rows, nodes.first, nodes.target)
            return native.run(p, local, rows, n, mask, self._delay_slope(p), slopes=sensitivities)
        y = np.zeros((m, n, n_y))
        dy = np.zeros((m, n, n_y, self.n_columns if sensitivities else 0))
        for which, stacked, samples in nodes.padded:
            made, slopes = self.run(p, local[which], stacked, sensitivities)
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

    def _run(self, p: FloatArray, local: FloatArray, nodes: FloatArray, y: FloatArray, dy: FloatArray) -> None:
        m, k, _ = nodes.shape
        flown = self._flown(p, local, nodes)
        n_c = dy.shape[3]
        key = (self.outputs, tuple(self.filters_hz.items()))
        if not n_c and key in flown.y:
            y[:] = flown.y[key]
            return
        x, middle = flown.x, flown.middle
        data = np.ascontiguousarray(nodes.transpose(2, 1, 0))
        n_u, n_e = len(self.block.inputs), len(self.block.exogenous)
        before = np.concatenate([data[1 : 1 + n_u, :1], data[1 : 1 + n_u, :-1]], axis=1)
        begun = np.zeros((m, self._n_x, n_c))
        if n_c:
            begun[:, self._started, len(self.free) + np.arange(self._n_free_x)] = 1.0
        slope, lag = begun, None
        for pieces in _chunks(k, max(1, PIECES_PER_CHUNK // m)):
            of = data[:, pieces].reshape(len(data), -1)
            size = of.shape[1] // m
            now = _Pieces(
                p,
                of[0],
                list(of[1 : 1 + n_u]),
                list(of[1 + n_u : 1 + n_u + n_e]),
                list(of[1 + n_u + n_e :]),
                list(np.tile(local[:, self._n_free_x :].T, (1, size))),
                x[:, pieces].reshape(self._n_x, -1),
                x[:, pieces.start + 1 : pieces.stop + 1].reshape(self._n_x, -1),
                None if middle is None else middle[:, pieces].reshape(self._n_x, -1),
            )
            if lag is None and self._filtered:
                lag = self._filters.start(self._observe(now, now.x0, now.e0)[self._filtered, :m])
            shape = (size, m)
            if not n_c:
                made = self._observe(now, now.x1, now.e1)
                if lag is not None and now.xm is not None:
                    ends = [self._observe(now, now.x0, now.e0), self._observe(now, now.xm, now.em), made]
                    made[self._filtered] = self._filters.run(lag, [e[self._filtered] for e in ends], now.h, shape)
                y[:, pieces] = made.reshape(-1, *shape).transpose(2, 1, 0)
                continue
            slopes, slope = self._sensitivities(now, list(before[:, pieces].reshape(n_u, -1)), slope, shape)
            made, d_made = self._report(now, now.x1, now.e1, slopes[1])
            if lag is not None and now.xm is not None and slopes[2] is not None:
                first, d_first = self._report(now, now.x0, now.e0, slopes[0])
                half, d_half = self._report(now, now.xm, now.em, slopes[2])
                values = [v[self._filtered] for v in (first, half, made)]
                tangents = [d[:, self._filtered] for d in (d_first, d_half, d_made)]
                if pieces.start == 0:
                    self._filters.start_slopes(lag, tangents[0][:m])
                made[self._filtered], d_made[:, self._filtered] = self._filters.run_with_slopes(
                    lag, values, tangents, now.h, shape
                )
            y[:, pieces] = made.reshape(-1, *shape).transpose(2, 1, 0)
            dy[:, pieces] = d_made.reshape(*shape, *d_made.shape[1:]).swapaxes(0, 1)
        flown.y[key] = y.copy()

    def _flown(self, p: FloatArray, local: FloatArray, nodes: FloatArray) -> _Flown:
        """The states of these responses; the last ones are kept, since a point is asked for again: its values, then its slopes."""
        kept: dict[Any, _Flown] = self.block.made.setdefault("flown", {})
        key = (nodes.ctypes.data, nodes.shape, bool(self._filtered))
        known = kept.pop(key, None)
        if nodes.flags.writeable:  # it may be changed before the next call
            return _Flown(p, local, nodes, *self._states(p, local, nodes), {})
        if known is None or not (np.array_equal(known.p, p) and np.array_equal(known.local, local)):
            x, middle = self._states(p, local, nodes)
            known = _Flown(p.copy(), local.copy(), nodes, x, middle, {})
        kept[key] = known
        while len(kept) > FLIGHTS_KEPT:
            del kept[next(iter(kept))]
        return known

    def _states(self, p: FloatArray, local: FloatArray, nodes: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """States before the first piece and after each (n_x, k + 1, m), and in the middle of each (n_x, k, m) where a filter needs it."""
        m, k, _ = nodes.shape
        block, filtered = self.block, bool(self._filtered)
        now = np.tile([block.initial.get(n, 0.0) for n in block.states], (m, 1))
        now[:, self._started] = local[:, : self._n_free_x]
        x = np.empty((self._n_x, k + 1, m))
        middle = np.empty((self._n_x, k, m)) if filtered else None
        x[:, 0] = now.T
        function = self._mapped(m, filtered)
        buffer, step = function.buffer()
        each, d = np.tile(p, m), np.ascontiguousarray(local[:, self._n_free_x :])
        size = self._n_x * (2 if filtered else 1)
        made, part = np.empty((m, CHAIN, size)), np.empty((m, CHAIN, self.n_data))
        start = np.ascontiguousarray(now)
        for i, argument in enumerate((start, each, d, part)):
            buffer.set_arg(i, memoryview(argument.reshape(-1).data))
        buffer.set_res(0, memoryview(made.reshape(-1).data))
        for pieces in _chunks(k, CHAIN):
            count = pieces.stop - pieces.start
            part[:, :count] = nodes[:, pieces]
            part[:, count:] = nodes[:, -1:]
            step()
            after = made[:, :count].transpose(2, 1, 0)
            x[:, pieces.start + 1 : pieces.stop + 1] = after[: self._n_x]
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
        made = self.block.made
        if ("outputs", self.outputs) not in made:
            made["outputs", self.outputs] = observed(self.block, self.outputs)
        return np.asarray(made["outputs", self.outputs](list(x), now.p, now.u, e, now.d))

    def _report(
        self, now: _Pieces, x: FloatArray, e: list[FloatArray], slope: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Outputs (n_outputs, n) before filters and their derivatives (n, n_outputs, n_columns), given those of the states."""
        y, entries = self._slopes("y")(list(x), now.p, now.u, e, now.d)
        rows, columns = self._slopes("y").at
        n_y, by_state = len(self.outputs), columns < self._n_x
        jacobian = np.zeros((slope.shape[0], n_y, self._n_x))
        jacobian[:, rows[by_state], columns[by_state]] = entries[:, by_state]
        dy = jacobian @ slope
        dy[:, rows[~by_state], columns[~by_state] - self._n_x] += entries[:, ~by_state]
        return y, dy

    def _sensitivities(
        self, now: _Pieces, u_before: list[FloatArray], begun: FloatArray, shape: tuple[int, int]
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray | None], FloatArray]:
        """Derivatives of the states (n, n_x, n_columns) at the start, end and middle of each piece; the last ends (m, n_x, n_columns).
        u_before: inputs of the piece before."""
        after, middle = self._pieces(now)
        n_x, n_c = self._n_x, self.n_columns
        by_x, rest = after[..., :n_x].reshape(*shape, n_x, n_x), after[..., n_x:].reshape(*shape, n_x, n_c)
        rate = self._rate()
        kept, new = (rate(list(now.x0), now.p, u, now.e0, now.d) for u in (u_before, now.u))
        jump = (kept - new).T.reshape(*shape, n_x, 1) * self._delay_slope(now.p)
        starts, ends = np.empty((2, *shape, n_x, n_c))
        for i in range(shape[0]):
            np.add(ends[i - 1] if i else begun, jump[i], out=starts[i])
            np.matmul(by_x[i], starts[i], out=ends[i])
            ends[i] += rest[i]
        start, end = starts.reshape(-1, n_x, n_c), ends.reshape(-1, n_x, n_c)
        between = None if middle is None else middle[..., :n_x] @ start + middle[..., n_x:]
        return (start, end, between), ends[-1]

    def _pieces(self, now: _Pieces) -> tuple[FloatArray, FloatArray | None]:
        """Of the state after each piece, and in its middle: derivatives by the state before it, then by the columns, (n, n_x, ...)."""
        slopes, n_x = self._slopes("x_dot"), self._n_x
        n, width = now.h.size, n_x + self.n_columns
        rows, columns = slopes.at
        inner = columns < n_x
        h = now.h[:, None, None]
        jacobian = np.zeros((n, n_x, n_x))
        every = np.arange(n_x)
        x, d_x = now.x0, np.empty((n, n_x, width))
        ks: list[tuple[FloatArray, FloatArray]] = []
        d_total = np.zeros((n, n_x, width))
        em = now.em
        for weight, share, ahead, e in (
            (1.0, 0.0, 0.5, now.e0),
            (2.0, 0.5, 0.5, em),
            (2.0, 0.5, 1.0, em),
            (1.0, 1.0, 0.0, now.e1),
        ):
            if ks:
                x = now.x0 + share * now.h * ks[-1][0].T
            k, entries = slopes(list(x), now.p, now.u, e, now.d)
            jacobian[:, rows[inner], columns[inner]] = entries[:, inner]
            if ks:
                d_k = jacobian @ d_x
            else:
                d_k = np.zeros((n, n_x, width))
                d_k[:, :, :n_x] = jacobian
            d_k[:, rows[~inner], columns[~inner]] += entries[:, ~inner]
            ks.append((k.T, d_k))
            if ahead:
                np.multiply(d_k, ahead * h, out=d_x)
                d_x[:, every, every] += 1.0
            d_total += d_k if weight == 1.0 else weight * d_k
        after = d_total
        after *= h / 6.0
        after[:, every, every] += 1.0
        if now.xm is None:
            return after, None
        middle = 0.5 * after + h / 8.0 * (ks[0][1] - ks[-1][1])
        middle[:, every, every] += 0.5
        return after, middle

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

    def _rate(self) -> Vectorised:
        """Of the states."""
        made = self.block.made
        if "rate" not in made:
            made["rate"] = rate_of(self.block)
        found: Vectorised = made["rate"]
        return found

    def _slopes(self, what: str) -> Slopes:
        """The block's rate ('x_dot') or outputs ('y') with its Jacobian by the states, then the columns."""
        key = (what, self.outputs if what == "y" else (), self.free)
        if key not in self.block.made:
            self.block.made[key] = differentiated(self.block, what, self.outputs, self.free)
        found = self.block.made[key]
        assert isinstance(found, Slopes)
        return found


@dataclass(frozen=True)
class _Flown:
    """Responses as they were integrated at p and local: states before the first piece and after each, in the middle of each, and what came
    out of it by outputs and filters. nodes: held on to, so that no others can take their place in memory."""

    p: FloatArray
    local: FloatArray
    nodes: FloatArray
    x: FloatArray
    middle: FloatArray | None
    y: dict[Any, FloatArray]


@dataclass(frozen=True)
class _Pieces:
    """Some pieces of all responses, n in all: lengths h (n,), rows of inputs, of measured signals at both ends, of disturbances; states
    before, after and in the middle of each, (n_x, n)."""

    p: FloatArray
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


def _chunks(k: int, size: int) -> Iterator[slice]:
    return (slice(first, min(first + size, k)) for first in range(0, k, size))
