"""Every fault in every state of a flight, and what must hold in each: the flight ends, and what it says of the vehicle is so."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol
from unittest import mock

from flighttest.errors import FlighttestError
from flighttest.flight import FlightOutcome, FlightResult, FlightState, LegOutcome, recorder
from flighttest.flight.execution.machine import TABLE, Event, Machine
from flighttest.mavlink import CopterMode
from flighttest.sim import SimOptions
from tests.faults.proxy import EPOCH_S, Broken, Endless, Fault, Proxy, When
from tests.flight.faulty import fly, make_leg, make_plan

FOR_GOOD_S = 1e6
FAULTS: tuple[Fault, ...] = (
    Fault("nothing"),
    Fault("down 3.2 s", 3.2, down=True),
    Fault("down 5.5 s", 5.5, down=True),
    Fault("down 15 s", 15.0, down=True),
    Fault("down for good", FOR_GOOD_S, down=True),
    Fault("up 3.2 s", 3.2, up=True),
    Fault("up 15 s", 15.0, up=True),
    Fault("up for good", FOR_GOOD_S, up=True),
    Fault("both 3.2 s", 3.2, up=True, down=True),
    Fault("both 15 s", 15.0, up=True, down=True),
    Fault("both for good", FOR_GOOD_S, up=True, down=True),
    Fault("20 % lost", 30.0, loss=0.2),
    Fault("all doubled", 30.0, double=True),
    Fault("150 ms reordering", 30.0, jitter_s=0.15),
    Fault("300 ms latency", 30.0, latency_s=0.3),
    Fault("one bit in 10 % of the frames", 30.0, corrupt=0.1),
    Fault("5760 bytes/s", 30.0, bytes_per_s=5760.0),
    Fault("reset for 1 s", 1.0, up=True, down=True, cut=True),
    Fault("stall 4 s, then all", 4.0, hold=True),
    Fault("client frozen 4 s", 4.0, freeze_s=4.0),
    Fault("client frozen 65 s", 1.0, freeze_s=65.0),
    Fault("clock leaps a day", 1.0, leap=True),
    Fault("one false stamp", 1.0, stamp=True),
    Fault("one false mode", 1.0, false_mode=CopterMode.LOITER),
    Fault("one false disarmed", 1.0, false_disarmed=True),
    Fault("second vehicle", 10.0, twin=True),
    Fault("streams switched off", 1.0, station=True),
    Fault("reboot", 1.0, reboot=True),
    Fault("disk full", FOR_GOOD_S, disk=True),
    Fault("Ctrl-C", 1.0, presses=1),
    Fault("Ctrl-C twice", 1.0, presses=2),
    Fault("pilot", 1.0, pilot_after_s=0.15),
    Fault("pilot brakes", 1.0, pilot_after_s=0.15, pilot_mode=CopterMode.BRAKE),
    Fault("pilot while down 3.2 s", 3.2, down=True, pilot_after_s=1.0),
    Fault("pilot while up 15 s", 15.0, up=True, pilot_after_s=1.0),
    Fault("pilot while 300 ms latency", 30.0, latency_s=0.3, pilot_after_s=0.5),
)
STATES = tuple(when for when in When if when is not When.CONNECTING)
QUICK: tuple[tuple[str, When], ...] = (
    ("down 3.2 s", When.ENTERING),
    ("down 5.5 s", When.RETURNING),
    ("up for good", When.FLYING),
    ("both for good", When.LANDING),
    ("both for good", When.PREFLIGHT),
    ("clock leaps a day", When.FLYING),
    ("second vehicle", When.CLIMBING),
    ("streams switched off", When.FLYING),
    ("pilot while down 3.2 s", When.ENTERING),
    ("pilot while down 3.2 s", When.ARMING),
)
"""The cells that were wrong first, and cost little: part of the default suite."""
SEEN_S = 0.35  # from a pilot's switch to the last frame that is sent: a HEARTBEAT every 0.1 s, and a frame that is not the next one
CHANGES = frozenset((state, event) for (state, event), following in TABLE.items() if following.state is not state)
"""The rows of the table of states that change it."""
REFUSED = "REFUSED"  # before arming, with a sentence


@dataclass(frozen=True)
class Cell:
    """One flight. ended: outcome and state in which the vehicle was left, or the error; wrong: what should not be; changes: (state, event)
    of every change of the flight's state."""

    fault: Fault
    when: When | FlightState
    ended: str
    seconds: float
    wrong: tuple[str, ...]
    changes: frozenset[tuple[FlightState, Event]] = frozenset()

    @property
    def ok(self) -> bool:
        """Whether all held."""
        return not self.wrong


def fly_cell(fault: Fault, when: When, folder: Path) -> Cell:
    """Fly two steps with a fault in one state."""
    options = SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0)
    proxy = Proxy(options, fault, when, after_s=0.05 if when is When.FLYING else 0.0)
    plan = make_plan(make_leg("a"), make_leg("b"))
    return judge(
        proxy,
        lambda stops: fly(plan, "proxy", folder, transport=proxy, clock=proxy.clock(), stop_requested=stops),
        lambda: proxy.sim.vehicle,
    )


class Vehicle(Protocol):
    """What is true of the vehicle in the end."""

    @property
    def armed(self) -> bool: ...

    @property
    def landed(self) -> bool: ...

    @property
    def mode(self) -> int: ...


def judge(proxy: Proxy, flight: Callable[[Callable[[], int]], FlightResult], truth: Callable[[], Vehicle]) -> Cell:
    """Fly (given how often Ctrl-C was pressed), and hold what the flight says against the truth."""
    with changes_of_state(proxy) as changes:
        cell = _judged(proxy, flight, truth, changes)
    return replace(cell, changes=frozenset(changes))


@contextlib.contextmanager
def changes_of_state(proxy: Proxy) -> Iterator[set[tuple[FlightState, Event]]]:
    """The changes of state of a flight meanwhile, as (state, event); the proxy gets each of them."""

    def on(machine: Machine, event: Event, why: str = "") -> FlightState:
        before = machine.state
        try:
            return taken_in(machine, event, why)
        finally:
            if machine.state is not before:
                seen.add((before, event))
                proxy.reach(machine.state)

    seen: set[tuple[FlightState, Event]] = set()
    taken_in = Machine.on
    with mock.patch.object(Machine, "on", on):
        yield seen


def _judged(
    proxy: Proxy,
    flight: Callable[[Callable[[], int]], FlightResult],
    truth: Callable[[], Vehicle],
    changes: Collection[tuple[FlightState, Event]],
) -> Cell:
    fault, when = proxy.fault, proxy.when
    try:
        with full_disk(proxy):
            result = flight(_presses(proxy))
    except FlighttestError as error:
        wrong = [] if not truth().armed else [f"an error left an armed vehicle: {error.message}"]
        wrong += [] if proxy.began_s is not None else ["refused before the fault began"]
        return Cell(fault, when, f"{REFUSED}: {error.message}", proxy.now_s - EPOCH_S, tuple(wrong))
    except Broken as broken:  # as it is meant to: a defect is raised, after the vehicle was seen to
        return Cell(fault, when, f"BROKEN: {broken}", proxy.now_s - EPOCH_S, ())
    except Endless as endless:
        return Cell(fault, when, "ENDLESS", proxy.now_s - EPOCH_S, (str(endless),))
    seconds = proxy.now_s - EPOCH_S
    handed = (FlightState.OFFERED, Event.FOREIGN_MODE) in changes
    overruled = (FlightState.WITH_PILOT, Event.OVERRULED) in changes
    wrong = tuple(_wrong(proxy, result, truth(), handed=handed, overruled=overruled))
    return Cell(fault, when, f"{result.outcome.name}, {result.left.name}", seconds, wrong)


def _presses(proxy: Proxy) -> Callable[[], int]:
    """How often Ctrl-C was pressed: by the fault, or once in the first step where an abort is what is looked at."""

    def count() -> int:
        first = When.ABORTING is proxy.when and proxy.reached(When.FLYING)
        return max(proxy.presses, int(first))

    return count


@contextlib.contextmanager
def full_disk(proxy: Proxy) -> Iterator[None]:
    """While the fault is there, nothing that is recorded can be written."""

    def flush(lines: recorder.LineFile) -> None:
        if proxy.fault.disk and proxy.active and lines.waiting:
            raise OSError(errno.ENOSPC, "No space left on device")
        written(lines)

    written = recorder.LineFile.flush
    with mock.patch.object(recorder.LineFile, "flush", flush):
        yield


def _wrong(proxy: Proxy, result: FlightResult, vehicle: Vehicle, *, handed: bool, overruled: bool) -> list[str]:
    """What the result says that is not so, and what should have been. handed: to the pilot, by agreement; overruled: a request that was
    under way when the pilot switched arrived after it, and the flight says so."""
    fault, left = proxy.fault, result.left
    found = []
    truths = {
        FlightState.LANDED: not vehicle.armed and vehicle.landed,
        FlightState.NOT_ARMED: not vehicle.armed,
        FlightState.DISARMED: not vehicle.armed,
        FlightState.WITH_PILOT: (handed and vehicle.mode != CopterMode.GUIDED)
        or (proxy.switched_s is not None and vehicle.mode == fault.pilot_mode)
        or (fault.arm and vehicle.armed and not proxy.reached(When.ARMING)),
        FlightState.IN_ABORT_MODE: vehicle.armed
        and vehicle.mode in (CopterMode.BRAKE, CopterMode.LOITER, CopterMode.LAND),
    }
    if not truths.get(left, True):
        found.append(f"said {left.name}; armed {vehicle.armed}, mode {vehicle.mode}")
    reported_unsafe = left in (
        FlightState.TO_AUTOPILOT,
        FlightState.UNKNOWN,
        FlightState.STILL_ARMED,
        FlightState.LANDING_UNSEEN,
        FlightState.DISARMED,
    )
    # One that never took off disarms by itself.
    grounded = left is FlightState.DISARMED and vehicle.landed and not vehicle.armed and not proxy.reached(When.FLYING)
    if reported_unsafe and not (fault.for_good or fault.reboot or fault.kill or grounded or overruled):
        found.append(f"left {left.name} by a fault that passed")
    if vehicle.armed and not reported_unsafe and left not in (FlightState.WITH_PILOT, FlightState.IN_ABORT_MODE):
        found.append("armed, and not said so")
    if proxy.switched_s is not None and fault.lasts_s < 1e3 and not handed and not overruled:
        same = proxy.when is When.ABORTING and fault.pilot_mode is CopterMode.BRAKE  # what was asked for anyhow
        if proxy.when is not When.PREFLIGHT and not same and vehicle.mode != fault.pilot_mode:
            found.append(f"the pilot chose {fault.pilot_mode.name}, the vehicle is in mode {vehicle.mode}")
        late = [t for t, kind in proxy.sent_after_switch if t > _seen_by(proxy) + SEEN_S and kind.startswith("SET_")]
        if vehicle.armed and late and not same:
            found.append(f"{len(late)} targets sent after the pilot was seen")
    flown = {leg.leg for leg in result.legs if leg.outcome is LegOutcome.FLOWN}
    if result.as_planned and not flown:
        found.append("as planned, with nothing flown")
    if fault.disk and proxy.began_s is not None and not result.incomplete:
        found.append("nothing was written, and the record is called whole")
    if fault.presses and proxy.began_s is not None and result.as_planned and proxy.when is not When.LANDING:
        found.append("the operator asked to stop, and it is called as planned")
    stopped = left is FlightState.NOT_ARMED and result.outcome is FlightOutcome.OPERATOR_STOP
    if (left is FlightState.LANDED or stopped) and result.parameters_left:
        found.append("on the ground, and parameters were not restored")
    return found


def _seen_by(proxy: Proxy) -> float:
    """When the pilot's mode can be seen at the latest."""
    assert proxy.switched_s is not None
    if proxy.fault.latency_s:
        return proxy.switched_s + proxy.fault.latency_s
    if not proxy.fault.down or proxy.began_s is None:
        return proxy.switched_s
    return max(proxy.switched_s, proxy.began_s + proxy.fault.lasts_s)
