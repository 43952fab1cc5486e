"""A flight of an hour in flat memory, and long flights with faults drawn at random: `python -m tests.faults.table --endurance`."""

from __future__ import annotations

import ctypes
import random
import resource
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from flighttest.flight import FlightResult, LegOutcome
from flighttest.sim import SimOptions
from tests.faults.cells import FAULTS, FOR_GOOD_S, Cell, judge
from tests.faults.lines import Line
from tests.faults.proxy import EPOCH_S, Fault, Proxy, When
from tests.flight.faulty import fly, make_leg, make_plan

HOUR_S = 3600.0
WARM_S = 300.0  # by then every module is loaded, and every buffer as large as it becomes
GROWTH_MAX_MB = 20.0
FLIGHT_S = 600.0
RANDOM_FLIGHTS = 20
_LEG_S = 3.8  # a step of make_leg with its way back
_CAPACITY_AH = 400.0  # a pack that lasts: what is looked at is the program
_EVERY_S = 60.0
_LIVE_BAUD = 921600  # a flight controller's USB or fast UART: it carries all rates


def resident_mb() -> float:
    """Memory of this process that is in use, MB. What was freed is given back first: its pages are no growth."""
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


class Watched(Proxy):
    """A proxy that looks at the memory once a minute. memory: (flight time s, MB)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.memory: list[tuple[float, float]] = []

    def _act(self) -> None:
        super()._act()
        if self.now_s - EPOCH_S >= _EVERY_S * len(self.memory):
            self.memory.append((self.now_s - EPOCH_S, resident_mb()))


@dataclass(frozen=True)
class Soak:
    """A long flight. flown: steps; growth_mb: most memory after `warm_s`, less that at `warm_s`; host_s: what it took."""

    ended: str
    seconds: float
    host_s: float
    flown: int
    legs: int
    warm_s: float
    memory: tuple[tuple[float, float], ...]
    written_mb: float
    wrong: tuple[str, ...]

    @property
    def growth_mb(self) -> float:
        """Most memory after the start, less that at its end, MB."""
        warm = next(mb for t, mb in self.memory if t >= self.warm_s)
        return max(mb for t, mb in self.memory if t >= self.warm_s) - warm


def options() -> SimOptions:
    """The built-in vehicle in free-running time, with a pack that lasts."""
    return SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0, capacity_ah=_CAPACITY_AH)


def soak(span_s: float = HOUR_S, warm_s: float = WARM_S) -> Soak:
    """Steps one after the other over span_s of flight time, on a link without a fault."""
    proxy = Watched(options(), Fault("nothing"), When.LANDING, limit_s=2.0 * span_s)
    plan = make_plan(*(make_leg(f"s{k}") for k in range(round(span_s / _LEG_S))))
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        result = fly(plan, "proxy", run, transport=proxy, clock=proxy.clock())
        written = sum(file.stat().st_size for file in run.rglob("*") if file.is_file()) / 1e6
    return _judged(
        result, len(plan.legs), proxy.now_s - EPOCH_S, span_s, time.monotonic() - began, warm_s, proxy.memory, written
    )


def live_soak(span_s: float = HOUR_S, warm_s: float = WARM_S) -> Soak:
    """Steps one after the other over span_s of the host's own time: the vehicle runs in this process, the client in another, by a pty.

    memory, growth_mb: of the client alone.
    """
    line = Line(_LIVE_BAUD, options=options())
    with line, ProcessPoolExecutor(1) as other:
        return other.submit(_live_client, line.url, span_s, warm_s).result()


def _live_client(url: str, span_s: float, warm_s: float) -> Soak:
    """The client's process of `live_soak`."""
    plan = make_plan(*(make_leg(f"s{k}") for k in range(round(span_s / _LEG_S))))
    over, began = threading.Event(), time.monotonic()
    memory: list[tuple[float, float]] = []

    def watch() -> None:
        while not over.wait(max(_EVERY_S * len(memory) - (time.monotonic() - began), 0.0)):
            memory.append((time.monotonic() - began, resident_mb()))
            sys.stderr.write(f"{memory[-1][0]:.0f} s: {memory[-1][1]:.1f} MB\n")
            sys.stderr.flush()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        result = fly(plan, url, run)
        written = sum(file.stat().st_size for file in run.rglob("*") if file.is_file()) / 1e6
    over.set()
    watcher.join()
    seconds = time.monotonic() - began
    return _judged(result, len(plan.legs), seconds, span_s, seconds, warm_s, memory, written)


def _judged(
    result: FlightResult,
    legs: int,
    seconds: float,
    span_s: float,
    host_s: float,
    warm_s: float,
    memory: list[tuple[float, float]],
    written_mb: float,
) -> Soak:
    """A long flight, and what is wrong with it."""
    flown = sum(leg.outcome is LegOutcome.FLOWN for leg in result.legs)
    wrong = []
    found = Soak(
        f"{result.outcome.name}, {result.left.name}",
        seconds,
        host_s,
        flown,
        legs,
        warm_s,
        tuple(memory),
        written_mb,
        (),
    )
    if found.growth_mb > GROWTH_MAX_MB:
        wrong.append(f"memory grew by {found.growth_mb:.1f} MB")
    if found.ended != "COMPLETED, LANDED":
        wrong.append(found.ended)
    if flown < legs:
        wrong.append(f"{legs - flown} steps were not flown")
    if seconds < span_s:
        wrong.append(f"it lasted only {seconds:.0f} s")
    return replace(found, wrong=tuple(wrong))


@dataclass(frozen=True)
class Drawn:
    """One long flight with faults at random times. cell: how it ended; faults: (name, from s, for s)."""

    seed: int
    faults: tuple[tuple[str, float, float], ...]
    flown: int
    cell: Cell
    growth_mb: float


PASSING = tuple(
    f for f in FAULTS
    if f.lasts_s < FOR_GOOD_S and f.name != "nothing" and not (f.reboot or f.presses or f.disk or f.leap)
    and f.pilot_after_s is None and f.freeze_s < 60.0
)  # fmt: skip
"""Faults after which a flight may go on."""


class Drawing(Watched):
    """One fault after the other, at random times."""

    schedule: list[tuple[float, Fault]]

    def _act(self) -> None:
        if self.schedule and self.now_s - EPOCH_S >= self.schedule[0][0]:
            _, self.fault = self.schedule.pop(0)
            self.began_s = self.now_s
            self._done.clear()
        super()._act()


def random_flight(seed: int, span_s: float = FLIGHT_S) -> Drawn:
    """A flight of span_s with a fault about every minute, the last one of any kind, also one that ends it."""
    draw = random.Random(seed)
    at_s = draw.uniform(5.0, 60.0)
    schedule: list[tuple[float, Fault]] = []
    while at_s < span_s:
        ending = at_s > 0.8 * span_s and draw.random() < 0.7
        fault = draw.choice([f for f in FAULTS if f.name != "nothing"] if ending else PASSING)
        lasts_s = (
            fault.lasts_s if fault.lasts_s >= 1e3 or fault.lasts_s <= 1.0 else fault.lasts_s * draw.uniform(0.3, 1.5)
        )
        schedule.append((at_s, replace(fault, lasts_s=lasts_s)))
        if ending:
            break
        at_s += lasts_s + draw.uniform(10.0, 80.0)
    proxy = Drawing(options(), Fault("nothing"), When.FLYING, limit_s=3.0 * span_s, seed=seed)
    proxy.schedule = list(schedule)
    plan = make_plan(*(make_leg(f"r{k}") for k in range(round(span_s / _LEG_S))))
    flown = 0
    with tempfile.TemporaryDirectory() as folder:

        def flight(stops):  # type: ignore[no-untyped-def]
            nonlocal flown
            run = Path(folder) / "run"
            result = fly(plan, "proxy", run, transport=proxy, clock=proxy.clock(), stop_requested=stops)
            flown = sum(leg.outcome is LegOutcome.FLOWN for leg in result.legs)
            return result

        cell = judge(proxy, flight, lambda: proxy.sim.vehicle)
    warm = [mb for t, mb in proxy.memory if t >= 60.0]
    reported = tuple((f.name, t, f.lasts_s) for t, f in schedule)
    return Drawn(seed, reported, flown, cell, max(warm) - warm[0] if warm else 0.0)
