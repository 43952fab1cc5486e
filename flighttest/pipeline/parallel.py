"""Work divided over the cores of this machine, where its duration matters to a person at a terminal."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_all_start_methods, get_context
from typing import Any, TypeVar

A = TypeVar("A")
B = TypeVar("B")

_given: tuple[Callable[[Sequence[Any]], list[Any]], Sequence[Any]]  # in a copy of this process: the work, and all items


def in_parallel(work: Callable[[Sequence[A]], list[B]], items: Sequence[A], sizes: Sequence[float]) -> list[B]:
    """work(items), one result for each, in order: a part of it here, the others in copies of this process, one per core.

    sizes: what share of the work each item is, roughly. What fails there is done again here, and fails here with its own words. Where a
    process cannot be copied (no fork on this system, or other threads that may hold locks) all of it is done here.
    """
    parts = _dealt(sizes, min(len(items), usable_processes()))
    if len(parts) < 2:
        return work(items)
    mine, *others = parts
    with ProcessPoolExecutor(len(others), get_context("fork"), _take, (work, items)) as pool:
        with warnings.catch_warnings():
            # Threads of the linear algebra library, which are idle and which it takes care of.
            warnings.simplefilter("ignore", DeprecationWarning)
            theirs = [pool.submit(_part, part) for part in others]
        found = dict(zip(mine, work([items[i] for i in mine]), strict=True))
        for part, future in zip(others, theirs, strict=True):
            found |= zip(part, _result(future) or work([items[i] for i in part]), strict=True)
    return [found[i] for i in range(len(items))]


def _dealt(sizes: Sequence[float], count: int) -> list[list[int]]:
    """Positions in so many parts of like size, each in rising order: the largest first, each to the lightest part."""
    parts: list[list[int]] = [[] for _ in range(max(count, 1))]
    loads = [0.0] * len(parts)
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        lightest = loads.index(min(loads))
        parts[lightest].append(i)
        loads[lightest] += sizes[i]
    return [sorted(part) for part in parts]


def usable_processes() -> int:
    """Processes that may work at once; 1 where this one cannot be copied, or where a thread of ours may hold a lock just now."""
    if "fork" not in get_all_start_methods() or threading.active_count() > 1:
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _take(work: Callable[[Sequence[A]], list[B]], items: Sequence[A]) -> None:
    """In a copy: keep what it was copied with. Nothing of it has to be picklable."""
    global _given
    _given = work, items


def _part(positions: Sequence[int]) -> list[Any]:
    work, items = _given
    signal.signal(signal.SIGINT, signal.default_int_handler)
    done = work([items[i] for i in positions])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt that finds this copy idle is the first process' affair
    return done


def _result(future: Future[list[B]]) -> list[B] | None:
    """What a copy found; None where it failed.

    An interrupt reaches the copy as well, which may still report what it has: that is waited for, unless it was interrupted itself.
    """
    try:
        return future.result()
    except KeyboardInterrupt:
        if future.done() and isinstance(future.exception(), KeyboardInterrupt):
            raise
        return future.result()
    except Exception:  # noqa: BLE001  whatever it is, the first process meets it too
        return None
