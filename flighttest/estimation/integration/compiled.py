"""What the kernel compiles of a block: the chain its states are stepped by, its outputs, and both differentiated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.physics.blocks import Block
from flighttest.physics.simulate import rk4_stages
from flighttest.physics.vectorised import Vectorised

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
CHAIN = 16  # nodes a compiled chain steps over


@dataclass(frozen=True)
class Slopes:
    """A vector function for many columns at once: its value (rows, n) and the entries of its Jacobian that can differ from zero."""

    program: Vectorised
    rows: int
    at: tuple[IntArray, IntArray]

    def __call__(self, *arguments: Any) -> tuple[FloatArray, FloatArray]:
        """Value (rows, n) and entries (n, entries); their rows and columns are `at`."""
        made = self.program(*arguments)
        return made[: self.rows], made[self.rows :].T


def _symbols(block: Block) -> list[Any]:
    """x, p, u, e, d."""
    groups = (block.states, block.params, block.inputs, block.exogenous, block.disturbances)
    return [ca.SX.sym(name, len(group)) for name, group in zip("xpued", groups, strict=True)]


def chain(block: Block, middles: bool) -> ca.Function:
    """(x, p, d, nodes) to the states after each of `CHAIN` pieces, those in the middle below them: (n_x or 2 n_x, CHAIN)."""
    x, p, _, _, d = _symbols(block)
    n_u, n_e = len(block.inputs), len(block.exogenous)
    node = ca.SX.sym("node", 1 + n_u + 2 * n_e)
    h, u, e0, e1 = node[0], node[1 : 1 + n_u], node[1 + n_u : 1 + n_u + n_e], node[1 + n_u + n_e :]
    after, k1, k4 = rk4_stages(lambda x, e: block.function(x, p, u, e, d)[0], x, h, (e0, 0.5 * (e0 + e1), e1))
    # The state in the middle of the piece, from states and rates at both ends (Hermite): filters see the output bend.
    middle = [0.5 * (x + after) + h / 8 * (k1 - k4)] if middles else []
    step = ca.Function("step", [x, p, d, node], [ca.densify(v) for v in ca.cse([after, *middle])])
    at, p, d = ca.MX.sym("x", len(block.states)), ca.MX.sym("p", len(block.params)), ca.MX.sym("d", d.numel())
    nodes = ca.MX.sym("nodes", node.numel(), CHAIN)
    start, rows = at, []
    for column in ca.horzsplit(nodes):
        made = step(at, p, d, column)
        parts = made if isinstance(made, (tuple, list)) else [made]
        at = parts[0]
        rows.append(ca.vertcat(*parts))
    return ca.Function(f"{block.name}_states", [start, p, d, nodes], [ca.horzcat(*rows)])


def fed_states(block: Block) -> list[int]:
    """States whose rate depends on an input."""
    arguments = _symbols(block)
    rates, _ = block.function(*arguments)
    return [i for i in range(len(block.states)) if ca.depends_on(rates[i], arguments[2])]


def late_parameters(block: Block) -> list[str]:
    """Parameters that the delay of the inputs depends on."""
    symbol = ca.SX.sym("p", len(block.params))
    delay = block.delay_s(symbol)
    return [n for i, n in enumerate(block.params) if ca.depends_on(delay, symbol[i])]


def jacobian_of(
    block: Block, what: str, outputs: tuple[str, ...], free: tuple[str, ...] | None
) -> tuple[ca.Function, int, tuple[IntArray, IntArray]]:
    """The block's rate ('x_dot') or outputs ('y') above the entries of its Jacobian, by the states, then the columns of `Kernel`, that can
    differ from zero (none of them for free None); how many rows are values; rows and columns of the entries."""
    arguments = _symbols(block)
    x, p, _, _, d = arguments
    value = block.function(*arguments)[0 if what == "x_dot" else 1]
    if what == "y":
        value = value[[block.outputs.index(n) for n in outputs]]
    if free is None:
        nothing = np.zeros(0, dtype=np.intp)
        return ca.Function(what, arguments, [ca.densify(ca.cse(value))]), value.numel(), (nothing, nothing)
    q = ca.vertcat(x, *(p[block.params.index(n)] for n in free), d)
    jacobian = ca.jacobian(value, q)
    rows, columns = (np.array(at, dtype=np.intp) for at in jacobian.sparsity().get_triplet())
    # Between parameters and disturbances lie the free initial states, which the rate does not depend on.
    columns = np.where(columns >= len(block.states) + len(free), columns + len(block.free_states), columns)
    nonzeros = ca.vertcat(*jacobian.nonzeros()) if rows.size else ca.SX(0, 1)
    both = ca.cse(ca.vertcat(ca.densify(value), nonzeros))
    return ca.Function(what, arguments, [ca.densify(both)]), value.numel(), (rows, columns)


def differentiated(block: Block, what: str, outputs: tuple[str, ...], free: tuple[str, ...] | None) -> Slopes:
    """The same for many columns at once, by numpy."""
    function, rows, at = jacobian_of(block, what, outputs, free)
    return Slopes(Vectorised(function), rows, at)
