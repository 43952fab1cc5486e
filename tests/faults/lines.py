"""Flights over a serial line that carries no more than its baud rate: at the time of day over a pty, and in virtual time."""

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
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flighttest.errors import FlighttestError
from flighttest.flight import LegOutcome
from flighttest.mavlink.dialect import dialect, parser
from flighttest.plan import Plan
from flighttest.recording.store import read_manifest
from flighttest.sim import InProcess, SimOptions
from tests.faults.proxy import EPOCH_S, Endless, Fault, Proxy, When
from tests.flight.faulty import fly

_BITS_PER_BYTE = 10
_BUFFER_S = 0.5  # of a radio or a UART: what comes while it is full is lost
_TICK_S = 0.002
_LONGEST_S = 2000.0  # the longest script takes 500 s


def _options() -> SimOptions:
    return SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0)


@dataclass
class OneWay:
    """One direction of a serial line. loss: share of the frames lost on the way; sent, dropped: bytes that passed, and frames that found
    the buffer full."""

    baud: int
    loss: float
    draw: random.Random
    sent: int = 0
    dropped: int = 0

    def __post_init__(self) -> None:
        self._free_s = 0.0  # when all that waits has left
        self._waiting: deque[tuple[float, bytes]] = deque()

    def take(self, frame: bytes, now_s: float) -> None:
        """A frame onto the line: it waits until those before it are through."""
        free_s = max(self._free_s, now_s)
        if free_s - now_s > _BUFFER_S:
            self.dropped += 1
            return
        self._free_s = free_s + len(frame) * _BITS_PER_BYTE / self.baud
        self.sent += len(frame)
        if self.draw.random() >= self.loss:
            self._waiting.append((self._free_s, frame))

    def due(self, now_s: float) -> bytes:
        """What has arrived at the other end by now."""
        data = b""
        while self._waiting and self._waiting[0][0] <= now_s:
            data += self._waiting.popleft()[1]
        return data


class VirtualLine(Proxy):
    """A serial line in virtual time: the same flight on any computer, however busy."""

    def __init__(self, baud: int, loss: float, seed: int = 1) -> None:
        self.url = f"serial:/dev/virtual:{baud}"
        draw = random.Random(seed)
        self.up, self.down = OneWay(baud, loss, draw), OneWay(baud, loss, draw)
        super().__init__(_options(), Fault("nothing"), When.LANDING, limit_s=_LONGEST_S)

    def _way(self, queue: object) -> OneWay:
        return self.up if queue is self._up else self.down

    def _queue(self, queue: list[tuple[float, int, bytes]], frame: bytes, *, lost: bool) -> None:
        self._way(queue).take(frame, self.now_s)

    def _arrived(self, queue: list[tuple[float, int, bytes]]) -> bytes:
        return self._way(queue).due(self.now_s)


@dataclass
class Line:
    """A serial line at the time of day: a pty, at whose other end the built-in vehicle sends and receives. `url` is what the flight
    opens; behind_s: most that the vehicle's simulation was behind the time of day."""

    baud: int
    loss: float = 0.0
    seed: int = 1
    options: SimOptions = field(default_factory=_options)

    def __post_init__(self) -> None:
        self.sim = InProcess(self.options)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.url = f"serial:{os.ttyname(self._slave)}:{self.baud}"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._codecs = {True: parser(1, 1), False: parser(1, 1)}
        draw = random.Random(self.seed)
        self.up, self.down = OneWay(self.baud, self.loss, draw), OneWay(self.baud, self.loss, draw)
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
            arrived = self.up.due(time.monotonic())
            if arrived:
                self.sim.send(arrived)
            behind_s = time.monotonic() - began_s - self.sim.time_s
            self.behind_s = max(self.behind_s, behind_s)
            if behind_s > 0.0:
                self.sim.advance(min(behind_s, 0.02))
            self._take(up=False, data=self.sim.receive())
            out = self.down.due(time.monotonic())
            if out:
                try:
                    os.write(self._master, out)
                except BlockingIOError:
                    self.down.dropped += 1

    def _take(self, *, up: bool, data: bytes) -> None:
        """Frames onto the line."""
        for message in (self._codecs[up].parse_buffer(data) or []) if data else []:
            if message.get_type() in ("PARAM_REQUEST_READ", "PARAM_SET") and message.param_id == "SIM_LOCKSTEP":
                continue  # the vehicle of a real line takes no grants of time
            way, frame = (self.up, bytes(message.get_msgbuf())) if up else (self.down, renamed(message))
            way.take(frame, time.monotonic())


def renamed(message: Any) -> bytes:
    """A frame of the vehicle, which on a real line has no lock-step to offer."""
    if message.get_type() != "PARAM_VALUE" or message.param_id != "SIM_LOCKSTEP":
        return bytes(message.get_msgbuf())
    again = parser(message.get_srcSystem(), message.get_srcComponent())
    again.seq = message.get_seq()
    value = (message.param_value, message.param_type, message.param_count, message.param_index)
    return bytes(dialect.MAVLink_param_value_message(b"SIM_NO_LOCKSTEP", *value).pack(again))


@dataclass(frozen=True)
class OverLine:
    """A flight over a line. flown: of `legs` steps; seconds: how long it took, by the vehicle's time; rates_hz: as measured before arming;
    dropped: frames that found a buffer full, up and down; in_air: whether a step leaves the ground; late_s: most that the vehicle's
    simulation was behind the time of day, None in virtual time."""

    baud: int
    loss: float
    script: str
    ended: str
    flown: int
    legs: int
    seconds: float
    rates_hz: dict[str, float]
    dropped: tuple[int, int]
    late_s: float | None
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


def fly_line(plan: Plan, baud: int, loss: float, *, real_time: bool) -> OverLine:
    """Fly a plan over a line: at the time of day over a pty, or in virtual time."""
    with contextlib.ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory())) / "run"
        line = held.enter_context(Line(baud, loss)) if real_time else VirtualLine(baud, loss)
        virtual = {} if isinstance(line, Line) else {"transport": line, "clock": line.clock()}
        began_s = time.monotonic()
        flown, rates, notes = 0, {}, ()
        try:
            result = fly(plan, line.url, folder, **virtual)
        except (FlighttestError, Endless) as error:
            ended = f"REFUSED: {getattr(error, 'message', error)}"
        else:
            ended, notes = f"{result.outcome.name}, {result.left.name}", result.notes
            flown = sum(leg.outcome is LegOutcome.FLOWN for leg in result.legs)
            rates = dict(read_manifest(result.run_dir).get("rates_hz", {}))
        seconds = time.monotonic() - began_s if isinstance(line, Line) else line.now_s - EPOCH_S
    return OverLine(
        baud, loss, plan.script.name, ended, flown, len(plan.legs), seconds, rates, (line.up.dropped, line.down.dropped),
        line.behind_s if isinstance(line, Line) else None, notes, any(leg.kind != "rest" for leg in plan.legs),
    )  # fmt: skip


def fly_script(baud: int, loss: float, name: str, real_time: bool) -> OverLine:
    """A shipped script over a line, whole."""
    from flighttest import plan

    (one,) = plan(name).plans
    return fly_line(one, baud, loss, real_time=real_time)
