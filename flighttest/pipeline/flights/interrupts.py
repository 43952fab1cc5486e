"""Ctrl-C during a flight: presses are counted and answered at once; the flight asks for their number in its own time."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

STOPPING = "Ctrl-C: stopping; in the air it lands (again, before LAND: its safe mode)"
LEAVING = "Ctrl-C again: a landing goes on; else take it over with the mode switch"
"""Short enough for a terminal of 80 columns, on which they have one line."""
_ANEW = "\r\x1b[2K"  # to the beginning of the terminal's line, and erase it


@contextmanager
def counted_interrupts() -> Iterator[Callable[[], int]]:
    """While this is open, Ctrl-C is counted instead of raised: once lands, twice leaves a vehicle in the air in its safe mode unless it
    lands already. A closed terminal or a shutdown lands."""
    presses = 0

    def count(_signal: int, _frame: object) -> None:
        nonlocal presses
        presses += 1
        _answer(STOPPING if presses == 1 else LEAVING)

    def end(_signal: int, _frame: object) -> None:
        nonlocal presses
        presses = max(presses, 1)  # often comes twice, and the second is no second request

    if threading.current_thread() is not threading.main_thread():
        yield lambda: 0
        return
    before = {signal.SIGINT: signal.signal(signal.SIGINT, count)}
    for name in ("SIGTERM", "SIGHUP"):  # the latter not on every system
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # as nohup has it
            before[number] = signal.signal(number, end)
    try:
        yield lambda: presses
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _answer(text: str) -> None:
    """Answer Ctrl-C past Python's own buffers, which the signal may have interrupted. On a terminal in the line where the cursor is, and no
    other: a live picture is erased upwards from there, and a new line would leave its first ones behind."""
    with suppress(OSError):
        if os.isatty(2):
            text = _ANEW + text[: os.get_terminal_size(2).columns - 1]
        else:
            text += "\n"
        os.write(2, text.encode())
