"""The kernel in C (`kernel.c`): compiled once by the machine's C compiler and kept in a cache; None where there is no compiler.

Equations do not become C, which would take a second per model: they stay CasADi's instructions, which the compiled kernel carries out for
eight responses at a time.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

SOURCE = Path(__file__).with_name("kernel.c")
COMPILERS = ("cc", "gcc", "clang")
# Sums and products are rounded one by one: outputs then are the same numbers with and without their derivatives.
FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
LIBRARIES = (
    ("-DVECTOR_FUNCTIONS", "-lmvec", "-lm"),
    ("-lm",),
)  # tried in this order: not every C library has the first
COMPILE_S = 120.0
IntArray = NDArray[np.int32]

# In the order of kernel.c; the last three are products of the first two with a third added, subtracted, subtracted from.
_NAMES = (
    "CONST", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "SQRT", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "SINH", "COSH",
    "TANH", "ASINH", "ACOSH", "ATANH", "EXP", "EXPM1", "LOG", "LOG1P", "FABS", "SIGN", "FLOOR", "CEIL", "ASSIGN", "POW", "FMIN", "FMAX",
    "FMOD", "COPYSIGN", "HYPOT", "ATAN2", "LT", "LE", "EQ", "NE", "AND", "OR", "NOT", "IF_ELSE_ZERO",
    "MUL_ADD", "MUL_SUB", "SUB_MUL",
)  # fmt: skip
_CODES = {getattr(ca, f"OP_{name}"): code for code, name in enumerate(_NAMES[:-3])} | {
    ca.OP_CONSTPOW: _NAMES.index("POW")
}
PARAMETERS, SIGNALS, STATES = range(3)  # what a part of a program depends on
_DEPENDS = (
    STATES,
    PARAMETERS,
    SIGNALS,
    SIGNALS,
    PARAMETERS,
)  # x, p, u, e, d: disturbances do not change within a response


@cache
def library() -> ctypes.CDLL | None:
    """The compiled kernel; None where it cannot be had."""
    compiler = next((path for name in COMPILERS if (path := shutil.which(name))), None)
    if compiler is None:
        return None
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        return ctypes.CDLL(str(_compiled(compiler)))
    return None


def _compiled(compiler: str) -> Path:
    """The library of this source, compiler and processor, compiled where it is not there yet."""
    with contextlib.suppress(OSError):
        compiler = str(Path(compiler).resolve())
    built_from = "\n".join((SOURCE.read_text(encoding="utf-8"), compiler, *FLAGS, *map(str, LIBRARIES), _processor()))
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "flighttest"
    found = folder / f"kernel-{hashlib.sha256(built_from.encode()).hexdigest()[:16]}.so"
    if found.exists():
        return found
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        made = Path(scratch) / found.name
        for libraries in LIBRARIES:
            command = [compiler, *FLAGS, "-o", str(made), str(SOURCE), *libraries]
            if subprocess.run(command, capture_output=True, timeout=COMPILE_S, check=False).returncode == 0:
                made.replace(found)  # in one step: another process may be looking
                return found
    raise OSError(f"{compiler} does not compile {SOURCE.name}")


def _processor() -> str:
    """What code for this processor may use: a home folder may be shared by several."""
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line for line in lines if line.startswith(("flags", "Features")))
    return f"{platform.machine()} {platform.processor()}"


Instruction = tuple[int, int, tuple[int, ...]]  # operation, value it makes, values it reads (of a constant: its index)


@dataclass(frozen=True)
class Program:
    """A function (x, p, u, e, d) of columns as `program` in kernel.c. code (n, 5); results: slot of each row of its result."""

    code: IntArray
    by_parameters: int
    by_signals: int
    slots: int
    constants: NDArray[np.float64]
    results: IntArray

    @classmethod
    def of(cls, function: ca.Function) -> Program:
        """ValueError where the function holds an operation that is not known here."""
        sizes = [function.size1_in(i) for i in range(function.n_in())]
        begin = np.concatenate([[0], np.cumsum(sizes)])
        lies = [
            d for d, size in zip(_DEPENDS, sizes, strict=True) for _ in range(size)
        ]  # of each value: which part makes it
        made: list[Instruction] = []
        constants = [0.0]
        work: dict[int, int] = {}
        results: dict[int, int] = {}
        zero = _value(lies, PARAMETERS)
        made.append((0, zero, (0,)))
        for k in range(function.n_instructions()):
            operation, out = function.instruction_id(k), function.instruction_output(k)
            if operation == ca.OP_CONST:
                constants.append(float(function.instruction_constant(k)))
                work[out[0]] = _value(lies, PARAMETERS)
                made.append((0, work[out[0]], (len(constants) - 1,)))
                continue
            into = function.instruction_input(k)
            if operation == ca.OP_INPUT:
                work[out[0]] = int(begin[into[0]]) + into[1]
            elif operation == ca.OP_OUTPUT:
                results[out[1]] = work.get(into[0], zero)
            elif operation in _CODES:
                read = tuple(work[i] for i in into)
                work[out[0]] = _value(lies, max(PARAMETERS, *(lies[v] for v in read)))
                made.append((_CODES[operation], work[out[0]], read))
            else:
                raise ValueError(f"operation {operation} of {function.name()} is not known to the compiled kernel")
        kept = [results.get(i, zero) for i in range(function.size1_out(0))]
        return cls._laid_out(_fused(made, lies, kept), lies, int(begin[-1]), np.array(constants), kept)

    @classmethod
    def _laid_out(
        cls,
        made: Sequence[Instruction],
        lies: Sequence[int],
        inputs: int,
        constants: NDArray[np.float64],
        results: Sequence[int],
    ) -> Program:
        """Instructions in three parts; a value that only its own part reads leaves its slot to later ones of that part."""
        ordered = sorted(made, key=lambda one: lies[one[1]])
        last: dict[int, int] = {}
        needed = set(results)
        for at, (operation, value, read) in enumerate(ordered):
            for one in read if operation else ():
                last[one] = at
                if one >= inputs and lies[one] != lies[value]:
                    needed.add(one)
        slot = {i: i for i in range(inputs)}
        free: dict[int, list[int]] = {PARAMETERS: [], SIGNALS: [], STATES: []}
        slots, code = inputs, []
        for at, (operation, value, read) in enumerate(ordered):
            part = lies[value]
            numbers = [slot[one] for one in read] if operation else list(read)
            for one in set(read) if operation else ():
                if one >= inputs and one not in needed and last[one] == at:
                    free[part].append(slot[one])
            if free[part]:
                slot[value] = free[part].pop()
            else:
                slot[value], slots = slots, slots + 1
            code.append((operation, slot[value], *numbers, *([0] * (3 - len(numbers)))))
        parts = [lies[value] for _, value, _ in ordered]
        return cls(
            np.array(code, dtype=np.int32), parts.count(PARAMETERS), len(parts) - parts.count(STATES), slots, constants,
            np.array([slot[r] for r in results], dtype=np.int32),
        )  # fmt: skip


def _value(lies: list[int], part: int) -> int:
    """A further value, made by a part."""
    lies.append(part)
    return len(lies) - 1


def _fused(made: Sequence[Instruction], lies: Sequence[int], results: Sequence[int]) -> list[Instruction]:
    """The same with a product that only one sum or difference of its part reads taken into it."""
    multiply, plus, minus = (_NAMES.index(n) for n in ("MUL", "ADD", "SUB"))
    times = Counter([*results, *(one for operation, _, read in made if operation for one in read)])
    products = {value: read for operation, value, read in made if operation == multiply and times[value] == 1}
    gone: set[int] = set()
    found: list[Instruction] = []
    for operation, value, read in made:
        mine = [v for v in read if v in products and lies[v] == lies[value]] if operation in (plus, minus) else []
        if not mine:
            found.append((operation, value, read))
            continue
        product = mine[0]
        other = read[1] if product == read[0] else read[0]
        name = "MUL_ADD" if operation == plus else "MUL_SUB" if product == read[0] else "SUB_MUL"
        gone.add(product)
        found.append((_NAMES.index(name), value, (*products[product], other)))
    return [one for one in found if one[1] not in gone]
