"""Frames that leave at their times, from a thread of its own: what the program does meanwhile does not delay them."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable

from flighttest.mavlink.dialect import Message

_SWITCH_S = 0.0005  # how long Python lets one thread go on while another is due; 5 ms by default
_PRIORITY = 2  # above the rest of the program, which has 1 at most (`flight.priority`)


class Sender:
    """Sends each message at its time (time.monotonic). send: hands one over; called with the lock held, so that after `cancel` nothing
    leaves."""

    def __init__(self, send: Callable[[Message], object]) -> None:
        self._send = send
        self._late_s = 0.0
        self._waiting: deque[tuple[float, Message]] = deque()
        self._changed = threading.Condition(threading.RLock())
        self._open = True
        self._interval_s = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_S)
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    def at(self, due_s: float, message: Message) -> None:
        """Send this at due_s, after what waits already."""
        with self._changed:
            self._waiting.append((due_s, message))
            self._changed.notify()

    def cancel(self) -> None:
        """Drop what waits. Nothing of it leaves after this returns."""
        with self._changed:
            self._waiting.clear()

    @property
    def late_s(self) -> float:
        """How late one left at most since `forget_late`, or has waited beyond its time by now."""
        try:
            waits_s = time.monotonic() - self._waiting[0][0]
        except IndexError:
            waits_s = 0.0
        return max(self._late_s, waits_s)

    def forget_late(self) -> None:
        """Measure `late_s` from now on."""
        self._late_s = 0.0

    def close(self) -> None:
        """Drop what waits and end the thread."""
        with self._changed:
            self._open = False
            self._waiting.clear()
            self._changed.notify()
        self._thread.join(timeout=1.0)
        sys.setswitchinterval(self._interval_s)

    def _run(self) -> None:
        with contextlib.suppress(OSError, AttributeError):  # not permitted, or not on this system
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_PRIORITY))
        with self._changed:
            while self._open:
                if not self._waiting:
                    self._changed.wait()
                    continue
                due_s, message = self._waiting[0]
                wait_s = due_s - time.monotonic()
                if wait_s > 0.0:
                    self._changed.wait(wait_s)
                    continue
                self._waiting.popleft()
                self._send(message)
                self._late_s = max(self._late_s, time.monotonic() - due_s)
