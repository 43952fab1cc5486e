"""A flight over a serial line: a pty at whose other end the built-in vehicle sends and receives no more than the line's baud carries."""

from __future__ import annotations

import contextlib
import os
import random
import select
import tempfile
import termios
import threading
import time
import tty
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flighttest.errors import FlighttestError
from flighttest.flight import LegOutcome
from flighttest.mavlink.dialect import book, parser
from flighttest.plan import Plan
from flighttest.recording.store import read_manifest
from flighttest.sim import InProcess, SimOptions
from tests.flight.faulty import fly

_BITS_PER_BYTE = 10
_BUFFER_S = 0.5  # of a radio or a UART: what comes while it is full is lost
_TICK_S = 0.002


@dataclass
class Line:
    """A pty at a baud rate: `url` is what the flight opens. loss: share of the frames lost each way; sent, dropped: bytes and frames of
    the vehicle that passed, or found the buffer full."""

    baud: int
    loss: float = 0.0
    seed: int = 1
    options: SimOptions = field(default_factory=lambda: SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0))

    def __post_init__(self) -> None:
        self.sim = InProcess(self.options)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.url = f"serial:{os.ttyname(self._slave)}:{self.baud}"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._draw = random.Random(self.seed)
        self._codecs = {True: parser(1, 1), False: parser(1, 1)}
        self._waiting: dict[bool, list[tuple[float, bytes]]] = {True: [], False: []}
        self._free_s = {True: 0.0, False: 0.0}
        self.sent: dict[bool, int] = {True: 0, False: 0}
        self.dropped: dict[bool, int] = {True: 0, False: 0}
        self.behind_s = 0.0

    def __enter__(self) -> Line:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _run(self) -> None:
        began_s = time.monotonic() - self.sim.time_s
        while not self._over.is_set():
            select.select([self._master], [], [], _TICK_S)
            with contextlib.suppress(BlockingIOError):
                self._take(up=True, data=os.read(self._master, 65536))
            arrived = self._due(up=True)
            if arrived:
                self.sim.send(arrived)
            behind_s = time.monotonic() - began_s - self.sim.time_s
            self.behind_s = max(self.behind_s, behind_s)
            if behind_s > 0.0:
                self.sim.advance(min(behind_s, 0.02))
            self._take(up=False, data=self.sim.receive())
            out = self._due(up=False)
            if out:
                try:
                    os.write(self._master, out)
                except BlockingIOError:
                    self.dropped[False] += 1

    def _take(self, *, up: bool, data: bytes) -> None:
        """Frames onto the line: each waits until those before it are through."""
        now_s = time.monotonic()
        for message in (self._codecs[up].parse_buffer(data) or []) if data else []:
            if message.get_type() in ("PARAM_REQUEST_READ", "PARAM_SET") and message.param_id == "SIM_LOCKSTEP":
                continue  # the vehicle of a real line takes no grants of time
            frame = bytes(message.get_msgbuf()) if up else renamed(message)
            free_s = max(self._free_s[up], now_s)
            if free_s - now_s > _BUFFER_S:
                self.dropped[up] += 1
                continue
            self._free_s[up] = free_s + len(frame) * _BITS_PER_BYTE / self.baud
            self.sent[up] += len(frame)
            if self._draw.random() >= self.loss:
                self._waiting[up].append((self._free_s[up], frame))

    def _due(self, *, up: bool) -> bytes:
        now_s, waiting = time.monotonic(), self._waiting[up]
        count = next((k for k, (t, _) in enumerate(waiting) if t > now_s), len(waiting))
        data = b"".join(frame for _, frame in waiting[:count])
        del waiting[:count]
        return data


def renamed(message: Any) -> bytes:
    """A frame of the vehicle, which on a real line has no lock-step to offer."""
    if message.get_type() != "PARAM_VALUE" or message.param_id != "SIM_LOCKSTEP":
        return bytes(message.get_msgbuf())
    again = parser(message.get_srcSystem(), message.get_srcComponent())
    again.seq = message.get_seq()
    value = (message.param_value, message.param_type, message.param_count, message.param_index)
    return bytes(book.MAVLink_param_value_message(b"SIM_NO_LOCKSTEP", *value).pack(again))


@dataclass(frozen=True)
class OverLine:
    """A flight over a line. flown: of `legs` steps; rates_hz: as measured before arming; dropped: frames that found a buffer full,
    up and down; in_air: whether a step leaves the ground; late_s: most that the vehicle's simulation was behind the time of day."""

    baud: int
    loss: float
    script: str
    ended: str
    flown: int
    legs: int
    seconds: float
    rates_hz: dict[str, float]
    dropped: tuple[int, int]
    late_s: float
    notes: tuple[str, ...]
    in_air: bool = True

    @property
    def wrong(self) -> tuple[str, ...]:
        """What should not be."""
        found = []
        if self.ended != ("COMPLETED, LANDED" if self.in_air else "COMPLETED, NOT_ARMED"):
            found.append(self.ended)
        if self.flown < self.legs:
            found.append(f"{self.legs - self.flown} of {self.legs} steps not flown")
        return tuple(found)


def fly_line(plan: Plan, baud: int, loss: float, steps: int | None = None) -> OverLine:
    """Fly a plan (its first `steps` steps, where given) over a line, in real time."""
    if steps is not None:
        plan = replace(plan, legs=plan.legs[:steps])
    began_s = time.monotonic()
    with Line(baud, loss) as line, tempfile.TemporaryDirectory() as folder:
        try:
            result = fly(plan, line.url, Path(folder) / "run")
        except FlighttestError as error:
            ended, flown, rates, notes = f"REFUSED: {error.message}", 0, {}, ()
        else:
            ended, notes = f"{result.outcome.name}, {result.left.name}", result.notes
            flown = sum(leg.outcome is LegOutcome.FLOWN for leg in result.legs)
            rates = dict(read_manifest(result.run_dir).get("rates_hz", {}))
    return OverLine(
        baud, loss, plan.script.name, ended, flown, len(plan.legs), time.monotonic() - began_s, rates,
        (line.dropped[True], line.dropped[False]), line.behind_s, notes,
        any(leg.kind != "rest" for leg in plan.legs),
    )  # fmt: skip


def fly_script(baud: int, loss: float, name: str, steps: int | None) -> OverLine:
    """A shipped script over a line."""
    from flighttest import plan

    (one,) = plan(name).plans
    return fly_line(one, baud, loss, steps)
