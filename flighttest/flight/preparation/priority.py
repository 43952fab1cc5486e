"""The program comes first while it flies a real vehicle: targets must leave on time, whatever else the computer does."""

from __future__ import annotations

import contextlib
import gc
import os
from collections.abc import Iterator

_NICER_BY = 15


@contextlib.contextmanager
def first() -> Iterator[None]:
    """Before other programs where the system allows it (root, or a `nice` limit of the user), and without going through the objects that
    are there already for garbage, which takes tens of milliseconds; as before afterwards.

    Four busy processes beside it on two cores: 99 % of the targets within 10 to 14 ms of their time, 24 to 32 ms without
    (benchmarks/target_timing.py).
    """
    gc.freeze()
    before = os.getpriority(os.PRIO_PROCESS, 0) if hasattr(os, "getpriority") else None
    if before is not None:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, before - _NICER_BY)
    try:
        yield
    finally:
        gc.unfreeze()
        if before is not None:
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, 0, before)
