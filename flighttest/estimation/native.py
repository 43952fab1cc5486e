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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

SOURCE = Path(__file__).with_name("kernel.c")
COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
COMPILE_S = 120.0
IntArray = NDArray[np.int32]

# As `enum` in kernel.c.
_NAMES = (
    "CONST", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "SQRT", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "SINH", "COSH",
    "TANH", "ASINH", "ACOSH", "ATANH", "EXP", "EXPM1", "LOG", "LOG1P", "FABS", "SIGN", "FLOOR", "CEIL", "ASSIGN", "POW", "FMIN", "FMAX",
    "FMOD", "COPYSIGN", "HYPOT", "ATAN2", "LT", "LE", "EQ", "NE", "AND", "OR", "NOT", "IF_ELSE_ZERO",
)  # fmt: skip
_CODES = {getattr(ca, f"OP_{name}"): code for code, name in enumerate(_NAMES)} | {ca.OP_CONSTPOW: _NAMES.index("POW")}
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
    told = "\n".join((SOURCE.read_text(encoding="utf-8"), compiler, *FLAGS, _processor()))
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "flighttest"
    found = folder / f"kernel-{hashlib.sha256(told.encode()).hexdigest()[:16]}.so"
    if found.exists():
        return found
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        made = Path(scratch) / found.name
        command = [compiler, *FLAGS, "-o", str(made), str(SOURCE), "-lm"]
        subprocess.run(command, check=True, capture_output=True, timeout=COMPILE_S)
        made.replace(found)  # in one step: another process may be looking
    return found


def _processor() -> str:
    """What code for this processor may use: a home folder may be shared by several."""
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line for line in lines if line.startswith(("flags", "Features")))
    return f"{platform.machine()} {platform.processor()}"


@dataclass(frozen=True)
class Program:
    """A function (x, p, u, e, d) of columns as `program` in kernel.c. code (n, 4); results: slot of each row of its result."""

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
        made: list[tuple[int, int, int, int]] = []  # operation, value, first, second
        constants = [0.0]
        work: dict[int, int] = {}
        results: dict[int, int] = {}
        zero = _value(lies, PARAMETERS)
        made.append((0, zero, 0, 0))
        for k in range(function.n_instructions()):
            operation, out = function.instruction_id(k), function.instruction_output(k)
            if operation == ca.OP_CONST:
                constants.append(float(function.instruction_constant(k)))
                work[out[0]] = _value(lies, PARAMETERS)
                made.append((0, work[out[0]], len(constants) - 1, 0))
                continue
            into = function.instruction_input(k)
            if operation == ca.OP_INPUT:
                work[out[0]] = int(begin[into[0]]) + into[1]
            elif operation == ca.OP_OUTPUT:
                results[out[1]] = work.get(into[0], zero)
            elif operation in _CODES:
                first, second = work[into[0]], work[into[1]] if len(into) > 1 else zero
                work[out[0]] = _value(lies, max(lies[first], lies[second]))
                made.append((_CODES[operation], work[out[0]], first, second))
            else:
                raise ValueError(f"operation {operation} of {function.name()} is not known to the compiled kernel")
        kept = [results.get(i, zero) for i in range(function.size1_out(0))]
        return cls._laid_out(made, lies, int(begin[-1]), np.array(constants), kept)

    @classmethod
    def _laid_out(
        cls,
        made: Sequence[tuple[int, int, int, int]],
        lies: Sequence[int],
        inputs: int,
        constants: NDArray[np.float64],
        results: Sequence[int],
    ) -> Program:
        """Instructions in three parts; a value that only its own part reads leaves its slot to later ones of that part."""
        ordered = sorted(made, key=lambda one: lies[one[1]])
        last: dict[int, int] = {}
        needed = set(results)
        for at, (_, value, first, second) in enumerate(ordered):
            for read in (first, second):
                last[read] = at
                if read >= inputs and lies[read] != lies[value]:
                    needed.add(read)
        slot = {i: i for i in range(inputs)}
        free: dict[int, list[int]] = {PARAMETERS: [], SIGNALS: [], STATES: []}
        slots, code = inputs, []
        for at, (operation, value, first, second) in enumerate(ordered):
            part = lies[value]
            a, b = (first, 0) if operation == 0 else (slot[first], slot[second])
            for read in {first, second} if operation else ():
                if read >= inputs and read not in needed and last[read] == at:
                    free[part].append(slot[read])
            if free[part]:
                slot[value] = free[part].pop()
            else:
                slot[value], slots = slots, slots + 1
            code.append((operation, slot[value], a, b))
        parts = [lies[value] for _, value, _, _ in ordered]
        return cls(
            np.array(code, dtype=np.int32), parts.count(PARAMETERS), len(parts) - parts.count(STATES), slots, constants,
            np.array([slot[r] for r in results], dtype=np.int32),
        )  # fmt: skip


def _value(lies: list[int], part: int) -> int:
    """A further value, made by a part."""
    lies.append(part)
    return len(lies) - 1
