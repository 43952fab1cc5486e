"""A CasADi function evaluated for many columns at once by numpy, instruction by instruction.

CasADi's own `map` walks the instructions once per column (12 us for one step of the paper's model); here each instruction is walked once
for all columns. The equations stay where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_BINARY: dict[int, Callable[..., Any]] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
}
_UNARY: dict[int, Callable[..., Any]] = {
    ca.OP_NEG: np.negative,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_INV: np.reciprocal,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_NOT: np.logical_not,
    ca.OP_ASSIGN: np.positive,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
}


class Vectorised:
    """A single-output SX function of (rows, n) arrays: column k of the result is the function of column k of each argument.

    ValueError where the function holds an operation that is not known here.
    """

    def __init__(self, function: ca.Function) -> None:
        self.rows = function.size1_out(0)
        self._work = function.sz_w()
        self._program: list[tuple[str, Any, int, int, int]] = []
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            into, out = function.instruction_input(k), function.instruction_output(k)
            if code == ca.OP_CONST:
                self._program.append(("const", function.instruction_constant(k), out[0], 0, 0))
            elif code == ca.OP_INPUT:
                self._program.append(("input", into[0], out[0], into[1], 0))
            elif code == ca.OP_OUTPUT:
                self._program.append(("output", None, out[1], into[0], 0))
            elif code == ca.OP_TWICE:
                self._program.append(("binary", np.add, out[0], into[0], into[0]))
            elif code == ca.OP_IF_ELSE_ZERO:
                self._program.append(("choose", None, out[0], into[0], into[1]))
            elif code in _BINARY:
                self._program.append(("binary", _BINARY[code], out[0], into[0], into[1]))
            elif code in _UNARY:
                self._program.append(("unary", _UNARY[code], out[0], into[0], 0))
            else:
                raise ValueError(f"operation {code} of {function.name()} is not known to numpy here")

    def __call__(self, *arguments: FloatArray) -> FloatArray:
        """The result (rows, n) of arguments (rows_i, n)."""
        w: list[Any] = [0.0] * self._work
        result = np.zeros((self.rows, arguments[0].shape[1]))
        for kind, what, out, first, second in self._program:
            if kind == "binary":
                w[out] = what(w[first], w[second])
            elif kind == "unary":
                w[out] = what(w[first])
            elif kind == "input":
                w[out] = arguments[what][first]
            elif kind == "const":
                w[out] = what
            elif kind == "output":
                result[out] = w[first]
            else:
                # CasADi's own meaning: zero where the condition fails, even beside an infinity.
                w[out] = np.where(w[first], w[second], 0.0)
        return result
