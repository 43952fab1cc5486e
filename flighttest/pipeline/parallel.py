"""Half of some work done in a second process, while somebody waits for it at a terminal."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

A = TypeVar("A")
B = TypeVar("B")


def in_halves(work: Callable[[Sequence[A]], list[B]], items: Sequence[A], sizes: Sequence[float]) -> list[B]:
    """work(items), one result for each, in order: half of it by a copy of this process where there is a core for it.

    sizes: what share of the work each item is, roughly. What fails there is done again here, and fails here with its own words.
    """
    if len(items) < 2 or not _second_core():
        return work(items)
    here, there = _dealt(sizes)
    child, answer = _begin(work, [items[i] for i in there])
    try:
        mine = work([items[i] for i in here])
        others = _read(answer)
    finally:
        os.close(answer)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    if others is None:
        others = work([items[i] for i in there])
    found = dict(zip((*here, *there), (*mine, *others), strict=True))
    return [found[i] for i in range(len(items))]


def _dealt(sizes: Sequence[float]) -> tuple[list[int], list[int]]:
    """Positions in two halves of like size, each in rising order: the largest first, each to the lighter half."""
    halves: tuple[list[int], list[int]] = ([], [])
    loads = [0.0, 0.0]
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        lighter = 0 if loads[0] <= loads[1] else 1
        halves[lighter].append(i)
        loads[lighter] += sizes[i]
    return sorted(halves[0]), sorted(halves[1])


def _second_core() -> bool:
    """Whether a copy of this process has a core to run on, and no lock that a thread of ours holds at that moment."""
    return sys.platform == "linux" and threading.active_count() == 1 and len(os.sched_getaffinity(0)) > 1


def _begin(work: Callable[[Sequence[A]], list[B]], items: Sequence[A]) -> tuple[int, int]:
    """Start a copy of this process that does the work and writes the result down a pipe: its id, and the pipe's end."""
    answer, result = os.pipe()
    with warnings.catch_warnings():
        # The idle threads of the linear algebra library, which it takes care of.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        try:
            done = pickle.dumps(work(items))
            with os.fdopen(result, "wb") as pipe:
                pipe.write(done)
        finally:
            # Whatever went wrong: nothing of this copy's may be printed or tidied up twice.
            os._exit(0)
    os.close(result)
    return child, answer


def _read(answer: int) -> Any:
    """What the copy wrote; None where it did not get to the end of it.

    An interrupt reaches the copy as well, which may still tell what it has: that is waited for, unless there is another.
    """
    written, interrupted = bytearray(), False
    while True:
        try:
            some = os.read(answer, 1 << 20)
        except KeyboardInterrupt:
            if interrupted:
                raise
            interrupted = True
            continue
        if not some:
            break
        written += some
    try:
        return pickle.loads(written)
    except (EOFError, pickle.UnpicklingError):
        if interrupted:
            raise KeyboardInterrupt from None
        return None
