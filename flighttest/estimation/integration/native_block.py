"""A block as the compiled kernel takes it: programs of rate and outputs, what can depend on what, and one call for many responses."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.integration.compiled import fed_states, jacobian_of, late_parameters
from flighttest.estimation.integration.native import Program, library
from flighttest.estimation.responses import Nodes
from flighttest.physics.blocks import Block

LANES = 16  # of kernel.c
LEAST_GROUPS = 2  # for a thread: below that, handing over takes longer than it saves
FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_COUNT, _AT = ctypes.c_int64, ctypes.c_void_p


class _Program(ctypes.Structure):
    _fields_ = (
        *((n, _COUNT) for n in ("count", "by_parameters", "by_signals", "slots")),
        *((n, _AT) for n in ("code", "constants", "results")),
    )


class _Entries(ctypes.Structure):
    _fields_ = (("count", _COUNT), ("rows", _AT), ("columns", _AT))


class _Block(ctypes.Structure):
    _fields_ = (
        *((n, _COUNT) for n in ("n_x", "n_p", "n_u", "n_e", "n_d", "n_y", "n_c", "n_started", "n_free")),
        *((n, _Program) for n in ("rate", "output", "rate_alone", "output_alone")), ("by_rate", _Entries), ("by_output", _Entries),
        *((n, _AT) for n in ("active_first", "active", "seen_first", "seen", "started", "initial", "filter")),
    )  # fmt: skip


class _Task(ctypes.Structure):
    _fields_ = (
        *((n, _COUNT) for n in ("m", "n_data", "n", "slopes")),
        *((n, _AT) for n in ("p", "local", "nodes", "delay_slope", "mask", "first", "target", "order", "y", "dy")),
    )


def _shares(order: IndexArray) -> list[IndexArray]:
    """Responses (m,), shortest first, to one list for each core, in whole groups of `LANES` of like length."""
    groups = [order[k : k + LANES] for k in range(0, order.size, LANES)]
    cores = max(1, min(usable_cores(), len(groups) // LEAST_GROUPS))
    return [np.ascontiguousarray(np.concatenate(groups[k::cores]), dtype=np.int64) for k in range(cores)]


def usable_cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class NativeBlock:
    """`block` for the compiled kernel, with the columns of `Kernel`: `free`, then free initial states and disturbances.

    ValueError where its equations hold an operation that is not known there.
    """

    def __init__(self, block: Block, outputs: tuple[str, ...], free: tuple[str, ...], hz: Mapping[str, float]) -> None:
        self._kept: list[Any] = []  # what the structure points at
        self._block = block
        n_x, started = len(block.states), [block.states.index(n) for n in block.free_states]
        self.n_columns = len(free) + len(started) + len(block.disturbances)
        self.n_outputs = len(outputs)
        (rate, by_rate), (output, by_output), (rate_alone, _), (output_alone, _) = (
            _differentiated(block, what, outputs if what == "y" else (), columns)
            for columns in (free, None)
            for what in ("x_dot", "y")
        )
        late = [free.index(n) for n in late_parameters(block) if n in free]
        active = np.zeros((n_x, self.n_columns), dtype=bool)
        active[np.ix_(fed_states(block), late)] = True
        active[started, len(free) + np.arange(len(started))] = True
        while True:
            reached = _reached(active, by_rate, n_x, n_x) | active
            if (reached == active).all():
                break
            active = reached
        seen = _reached(active, by_output, n_x, len(outputs))
        initial = np.array([block.initial.get(n, 0.0) for n in block.states])
        programs = (rate, output, rate_alone, output_alone)
        groups = (block.states, block.params, block.inputs, block.exogenous, block.disturbances, outputs)
        self._made = _Block(
            *map(len, groups), self.n_columns, len(started), len(free),
            *map(self._program, programs), self._entries(by_rate), self._entries(by_output),
            *self._lists(active), *self._lists(seen), self._at(np.array(started, dtype=np.int32)), self._at(initial),
            self._at(np.array([2.0 * math.pi * hz.get(n, 0.0) for n in outputs])),
        )  # fmt: skip

    def run(
        self,
        p: FloatArray,
        local: FloatArray,
        nodes: Nodes,
        mask: NDArray[np.bool_],
        delay_slope: FloatArray,
        *,
        slopes: bool,
    ) -> tuple[FloatArray, FloatArray]:
        """Outputs (m, n, n_outputs) and, with slopes, derivatives (m, n, n_outputs, n_columns), 0 where masked.

        p: (m, n_params); mask: (m, n, n_outputs), n samples of the longest response; delay_slope (n_columns,): of the delay by each column.
        """
        first = nodes.first
        m, n, _ = mask.shape
        order = np.argsort(np.diff(first), kind="stable")
        y = np.zeros((m, n, self.n_outputs))
        dy = np.zeros((m, n, self.n_outputs, self.n_columns if slopes else 0))
        arrays = [np.ascontiguousarray(a, dtype=float) for a in (p, local, nodes.rows, delay_slope)]
        indices = [np.ascontiguousarray(a, dtype=np.int64) for a in (first, nodes.target)]
        counted = np.ascontiguousarray(mask)
        kernel = library()
        assert kernel is not None

        def integrate(mine: IndexArray) -> int:
            """Simulate some of the responses, which share nothing with others but what is read."""
            task = _Task(
                mine.size, arrays[2].shape[1], n, int(slopes), *(a.ctypes.data for a in arrays),
                counted.ctypes.data, *(a.ctypes.data for a in (*indices, mine, y, dy)),
            )  # fmt: skip
            return int(kernel.integrate(ctypes.byref(self._made), ctypes.byref(task)))

        first_share, *others = _shares(order)
        # Threads of one call: a process with a thread that lives on cannot be copied for work side by side.
        with ThreadPoolExecutor(max(len(others), 1)) as pool:
            waited = [pool.submit(integrate, share) for share in others]
            failed = integrate(first_share) or any(one.result() for one in waited)
        if failed:
            raise MemoryError(f"no memory for {m} responses")
        return y, dy

    def _at(self, values: NDArray[Any]) -> int:
        """Address of an array that is kept."""
        self._kept.append(np.ascontiguousarray(values))
        return int(self._kept[-1].ctypes.data)

    def _program(self, one: Program) -> _Program:
        return _Program(
            len(one.code), one.by_parameters, one.by_signals, one.slots, self._at(one.code), self._at(one.constants), self._at(one.results)
        )  # fmt: skip

    def _entries(self, at: tuple[NDArray[np.intp], NDArray[np.intp]]) -> _Entries:
        return _Entries(at[0].size, *(self._at(one.astype(np.int32)) for one in at))

    def _lists(self, table: NDArray[np.bool_]) -> tuple[int, int]:
        """Columns of each row that are true, one row after the other, and where each begins."""
        begin = np.concatenate([[0], np.cumsum(table.sum(axis=1))])
        return self._at(begin.astype(np.int32)), self._at(np.nonzero(table)[1].astype(np.int32))


def _reached(
    active: NDArray[np.bool_], at: tuple[NDArray[np.intp], NDArray[np.intp]], n_x: int, rows: int
) -> NDArray[np.bool_]:
    """(rows, n_columns) what a function with these entries in its Jacobian can depend on, given what the states can."""
    found = np.zeros((rows, active.shape[1]), dtype=bool)
    for row, column in zip(*at, strict=True):
        if column < n_x:
            found[row] |= active[column]
        else:
            found[row, column - n_x] = True
    return found


def _differentiated(
    block: Block, what: str, outputs: tuple[str, ...], free: tuple[str, ...] | None
) -> tuple[Program, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Program and entries of a block's rate or outputs with their Jacobian, None for none; kept with the block."""
    key = ("native", what, outputs, free)
    if key not in block.made:
        function, _, at = jacobian_of(block, what, outputs, free)
        block.made[key] = Program.of(function), at
    found: tuple[Program, tuple[NDArray[np.intp], NDArray[np.intp]]] = block.made[key]
    return found
