"""One block of the model integrated over many responses at once, with forward sensitivities, in CasADi.

A response is a row of nodes: sample times and delayed input edges, merged (see `identify.nodes`). Between nodes inputs are constant, so one
RK4 step per node is smooth in the state, the parameters and the delay: h = h0 + hd * delay(p) is the piece's length, with hd = +1 for
a piece that ends at an edge, -1 for one that starts there. Sensitivities are propagated as S_next = A S + B.
Known second-order Butterworth filters of measured channels are integrated exactly for outputs quadratic within a piece.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.physics.blocks import Block

FloatArray = NDArray[np.float64]
# Numbers of nodes are rounded up to one of these, so that few functions are built.
_BUCKETS = (16, 32, 48, 64, 80, 96, 128, 160, 192, 224, 256, 320, 384, 448, 512, 640, 768, 896, 1024)
RESPONSES_PER_CALL = 96
THREADS = 2


@dataclass
class Kernel:
    """Integrates `block` and differentiates `outputs` by `free` parameters, free initial states and disturbances.

    filters_hz: output name to cut-off of its known measurement filter. Columns of a Jacobian: `free`, then locals: free initial states
    and disturbances. Keeps the functions it builds.
    """

    block: Block
    outputs: tuple[str, ...]
    free: tuple[str, ...]
    filters_hz: dict[str, float] = field(default_factory=dict)
    _built: dict[Any, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        self.free = tuple(n for n in self.free if n in self.block.params)
        self.locals = (*(f"{n}(0)" for n in self.block.free_states), *self.block.disturbances)
        self.n_columns = len(self.free) + len(self.locals)
        self.n_data = 2 + len(self.block.inputs) + 2 * len(self.block.exogenous)

    def run(
        self, p: FloatArray, local: FloatArray, nodes: FloatArray, sensitivities: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate m responses over k nodes.

        p: (n_params,) values of block.params; local: (m, n_local); nodes: (m, k, n_data) rows of [h0, hd, u, e at the start, e at the end].
        Returns y (m, k, n_outputs) and dy (m, k, n_outputs, n_columns), the latter empty without sensitivities.
        """
        m, k, _ = nodes.shape
        bucket = node_bucket(k)
        if bucket != k:
            nodes = np.concatenate([nodes, np.repeat(_padding(nodes), bucket - k, axis=1)], axis=1)
        n_y, n_c = len(self.outputs), self.n_columns if sensitivities else 0
        out = np.empty((m, bucket, n_y * (1 + n_c)))
        for first in range(0, m, RESPONSES_PER_CALL):
            some = slice(first, min(first + RESPONSES_PER_CALL, m))
            out[some] = self._call(p, local[some], nodes[some], sensitivities)
        y = out[:, :k, :n_y]
        dy = out[:, :k, n_y:].reshape(m, k, n_c, n_y).swapaxes(2, 3)
        return y, dy

    def _call(self, p: FloatArray, local: FloatArray, nodes: FloatArray, sensitivities: bool) -> FloatArray:
        m, k, _ = nodes.shape
        function = self._mapped(m, k, sensitivities)
        out = np.empty((m, k, len(self.outputs) * (1 + (self.n_columns if sensitivities else 0))))
        buffer, run = function.buffer()
        arguments = [np.ascontiguousarray(np.tile(p, m)), np.ascontiguousarray(local), np.ascontiguousarray(nodes)]
        for i, argument in enumerate(arguments):
            buffer.set_arg(i, memoryview(argument.reshape(-1).data))
        buffer.set_res(0, memoryview(out.reshape(-1).data))
        run()
        return out

    def _mapped(self, m: int, k: int, sensitivities: bool) -> Any:
        key = ("map", m, k, sensitivities)
        if key not in self._built:
            one = self._chain(k, sensitivities)
            self._built[key] = one.map(m, "thread", THREADS) if m >= 2 * THREADS else one.map(m)
        return self._built[key]

    def _chain(self, k: int, sensitivities: bool) -> Any:
        key = ("chain", k, sensitivities)
        if key in self._built:
            return self._built[key]
        initial, step = self._steps(sensitivities)
        p, local = ca.MX.sym("p", len(self.block.params)), ca.MX.sym("l", len(self.locals))
        nodes = ca.MX.sym("nodes", self.n_data, k)
        columns = ca.horzsplit(nodes)
        state = initial(p, local, columns[0])
        rows = []
        for column in columns:
            state, y = step(state, p, local, column)
            rows.append(y)
        self._built[key] = ca.Function(f"{self.block.name}_{k}", [p, local, nodes], [ca.horzcat(*rows)])
        return self._built[key]

    def _steps(self, sensitivities: bool) -> Any:
        """(initial(p, local, node) -> state, step(state, p, local, node) -> state, y) as SX functions."""
        key = ("steps", sensitivities)
        if key not in self._built:
            self._built[key] = _build_steps(self, sensitivities)
        return self._built[key]


def node_bucket(k: int) -> int:
    """The number of nodes a response of k nodes is padded to."""
    return next((b for b in _BUCKETS if b >= k), -(-k // 512) * 512)


def _padding(nodes: FloatArray) -> FloatArray:
    """The last node again, of no length."""
    last = nodes[:, -1:, :].copy()
    last[..., :2] = 0.0
    return last


def _filter_matrix(w: float, h: Any) -> tuple[Any, Any, Any, Any]:
    """exp(A h) of w^2/(s^2 + sqrt(2) w s + w^2) for the state (output, its rate), as (e11, e12, e21, e22)."""
    a = w / math.sqrt(2.0)
    decay, c, s = ca.exp(-a * h), ca.cos(a * h), ca.sin(a * h)
    return decay * (c + s), decay * s / a, -2 * a * decay * s, decay * (c - s)


def _build_steps(kernel: Kernel, sensitivities: bool) -> tuple[ca.Function, ca.Function]:
    block = kernel.block
    n_x, n_u, n_e = len(block.states), len(block.inputs), len(block.exogenous)
    chosen = [block.outputs.index(n) for n in kernel.outputs]
    x, p, d = ca.SX.sym("x", n_x), ca.SX.sym("p", len(block.params)), ca.SX.sym("d", len(block.disturbances))
    node = ca.SX.sym("node", kernel.n_data)
    h0, hd, u, e0, e1 = node[0], node[1], node[2 : 2 + n_u], node[2 + n_u : 2 + n_u + n_e], node[2 + n_u + n_e :]
    em = 0.5 * (e0 + e1)
    h = h0 + hd * block.delay_s(p)

    def rate(at: Any, e: Any) -> Any:
        return block.function(at, p, u, e, d)[0]

    k1 = rate(x, e0)
    k2 = rate(x + h / 2 * k1, em)
    k3 = rate(x + h / 2 * k2, em)
    k4 = rate(x + h * k3, e1)
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def output(at: Any, e: Any) -> Any:
        return block.function(at, p, u, e, d)[1][chosen]

    free = [p[block.params.index(n)] for n in kernel.free]
    n_p, n_free_x, n_d = len(free), len(block.free_states), len(block.disturbances)
    q = ca.vertcat(*free, d)
    local = ca.SX.sym("local", n_free_x + n_d)
    n_c = kernel.n_columns if sensitivities else 0
    # Columns of S: free parameters, free initial states, disturbances. `spread` puts d/dq into them.
    spread = ca.DM.zeros(n_p + n_d, n_c)
    if sensitivities:
        for i in range(n_p):
            spread[i, i] = 1
        for i in range(n_d):
            spread[n_p + i, n_p + n_free_x + i] = 1

    def total(expr: Any, at: Any, s_at: Any) -> Any:
        """d expr / d columns, where `expr` depends on the state `at` (with sensitivities s_at), parameters and d."""
        if not n_c:
            return ca.SX(expr.shape[0], 0)
        return ca.jacobian(expr, at) @ s_at + ca.jacobian(expr, q) @ spread

    s = ca.SX.sym("s", n_x, n_c)
    filtered = [i for i, n in enumerate(kernel.outputs) if n in kernel.filters_hz]
    # The state in the middle of the piece, from states and rates at both ends (Hermite): filters see the output bend.
    middle = 0.5 * (x + after) + h / 8 * (k1 - k4)
    both = total(ca.vertcat(after, middle) if filtered else after, x, s)
    s_after, s_middle = both[:n_x, :], both[n_x:, :]
    x1, s1 = ca.SX.sym("x1", n_x), ca.SX.sym("s1", n_x, n_c)
    y1, dy1 = output(x1, e1), None
    dy1 = total(y1, x1, s1)

    n_f = len(filtered)
    z, sz = ca.SX.sym("z", 2 * n_f), ca.SX.sym("sz", 2 * n_f, n_c)
    y0 = output(x, e0)
    dy0 = total(y0, x, s)
    z_after, sz_after = [], []
    h_safe = ca.fmax(h, 1e-7)
    dh = total(h_safe, x, s)
    xm, sm = ca.SX.sym("xm", n_x), ca.SX.sym("sm", n_x, n_c)
    y_mid = output(xm, em)
    dy_mid = total(y_mid, xm, sm)
    for j, i in enumerate(filtered):
        w = 2 * math.pi * kernel.filters_hz[kernel.outputs[i]]
        symbols = [ca.SX.sym(n) for n in ("y0", "ym", "y1", "z", "z_dot", "h")]
        new = _filtered(w, *symbols)
        now = [y0[i], y_mid[i], y1[i], z[2 * j], z[2 * j + 1], h_safe]
        made = ca.substitute([new, ca.jacobian(new, ca.vertcat(*symbols))], symbols, now)
        z_after.append(made[0])
        if n_c:
            rows = [dy0[i, :], dy_mid[i, :], dy1[i, :], sz[2 * j, :], sz[2 * j + 1, :], dh]
            sz_after.append(made[1] @ ca.vertcat(*rows))
    z_next = ca.vertcat(*z_after) if n_f else ca.SX(0, 1)
    sz_next = ca.vertcat(*sz_after) if n_f else ca.SX(0, n_c)
    y_out, dy_out = ca.SX(y1), ca.SX(dy1)
    for j, i in enumerate(filtered):
        y_out[i] = z[2 * j]
        if n_c:
            dy_out[i, :] = sz[2 * j, :]

    def pack(*parts: Any) -> Any:
        return ca.vertcat(*(ca.vec(part) for part in parts))

    middles = [middle, s_middle] if filtered else [x, s]
    advance = ca.Function("advance", [x, s, p, d, node], [after, s_after, *middles])
    observe = ca.Function("observe", [x, s, xm, sm, x1, s1, z, sz, p, d, node], [z_next, sz_next])
    report = ca.Function("report", [x1, s1, z, sz, p, d, node], [ca.densify(y_out), ca.densify(dy_out)])
    xa, sa, xma, sma = advance(x, s, p, d, node)
    za_, sza_ = observe(x, s, xma, sma, xa, sa, z, sz, p, d, node)
    ya, dya = report(xa, sa, za_, sza_, p, d, node)
    state = pack(x, s, z, sz)
    outs = ca.cse([ca.densify(pack(xa, sa, za_, sza_)), ca.densify(pack(ya, dya))])
    outs = [ca.substitute(o, d, local[n_free_x:]) if n_d else o for o in outs]
    x_start = [
        local[block.free_states.index(n)] if n in block.free_states else ca.SX(block.initial[n]) for n in block.states
    ]
    s_start = ca.DM.zeros(n_x, n_c)
    if sensitivities:
        for i, n in enumerate(block.free_states):
            s_start[block.states.index(n), n_p + i] = 1
    y_start = ca.substitute(output(x, e0), d, local[n_free_x:]) if n_d else output(x, e0)
    dy_start = ca.substitute(total(output(x, e0), x, s), d, local[n_free_x:]) if n_d else total(output(x, e0), x, s)
    at = [ca.vertcat(*x_start), ca.SX(s_start)]
    z_start = [ca.vertcat(y_start[i], 0) for i in filtered]
    sz_start = [ca.vertcat(dy_start[i, :], ca.SX(1, n_c)) for i in filtered]
    begun = pack(x, s, ca.vertcat(*z_start) if n_f else ca.SX(0, 1), ca.vertcat(*sz_start) if n_f else ca.SX(0, n_c))
    begun = ca.substitute([begun], [x, s], at)[0]
    initial = ca.Function("initial", [p, local, node], [ca.densify(begun)])
    slopes = [*range(n_x, n_x + n_x * n_c), *range(state.numel() - 2 * n_f * n_c, state.numel())]
    outs = _without_zeros(state, slopes, begun, outs)
    return initial, ca.Function("step", [state, p, local, node], outs)


def _without_zeros(state: Any, slopes: list[int], begun: Any, outs: list[Any]) -> list[Any]:
    """Drop sensitivities that are zero for good (a_t does not depend on drag): `slopes` are the state's entries that may be."""
    start = ca.densify(begun)
    live = {i for i in slopes if not start[i].is_zero()}
    while True:
        dead = [i for i in slopes if i not in live]
        if not dead:
            return outs
        made = ca.substitute(outs, [state[i] for i in dead], [ca.SX(0)] * len(dead))
        grown = {i for i in dead if not made[0][i].is_zero()}
        if not grown:
            return list(ca.cse(made))
        live |= grown


def _filtered(w: float, y0: Any, ym: Any, y1: Any, z: Any, z_dot: Any, h: Any) -> Any:
    """Filter state (output, its rate) after a piece of length h, exact for the parabola through the piece's ends and middle, (2, 1)."""
    e11, e12, e21, e22 = _filter_matrix(w, h)
    lag = math.sqrt(2.0) / w
    bend = ym - 0.5 * (y0 + y1)
    u2 = -4.0 * bend / h**2
    u1 = (y1 - y0) / h + 4.0 * bend / h
    # Particular solution a + b t + u2 t^2 of the filter's equation for the input y0 + u1 t + u2 t^2.
    b = u1 - 2.0 * lag * u2
    a = y0 - 2.0 * u2 / w**2 - lag * b
    off, off_dot = z - a, z_dot - b
    after = a + b * h + u2 * h**2 + e11 * off + e12 * off_dot
    return ca.vertcat(after, b + 2.0 * u2 * h + e21 * off + e22 * off_dot)
