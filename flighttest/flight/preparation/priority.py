"""Process priority while a real vehicle is flown: targets must leave on time, whatever else the computer does."""

from __future__ import annotations

import contextlib
import gc
import os
from collections.abc import Iterator

_NICER_BY = 15
_PRIORITY = 1  # before all that is not real time itself; the thread that sends has 2


def granted() -> bool:
    """Whether the system gives this user's programs a real-time priority."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))
        os.sched_setscheduler(0, *before)
    except (OSError, AttributeError):  # not permitted, or not on this system
        return False
    return True


@contextlib.contextmanager
def first() -> Iterator[None]:
    """Before other programs where the system allows it (root, or a limit for `rtprio` or `nice` of the user), and without going through
    the objects that are there already for garbage, which takes tens of milliseconds; as before afterwards."""
    gc.freeze()
    scheduled = None
    with contextlib.suppress(OSError, AttributeError):  # not permitted, or not on this system
        scheduled = os.sched_getscheduler(0), os.sched_getparam(0)
        # Not for what this starts: another program could keep everybody else from a processor.
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))
    before = os.getpriority(os.PRIO_PROCESS, 0) if hasattr(os, "getpriority") else None
    if before is not None:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, before - _NICER_BY)
    try:
        yield
    finally:
        gc.unfreeze()
        if scheduled is not None:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, *scheduled)
        if before is not None:
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, 0, before)
