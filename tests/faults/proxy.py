"""The built-in vehicle, free-running in virtual time, behind a link that fails as it is set: a socket's bytes without the waiting.

`Proxy` is a transport and the host's clock at once: time passes only while the client waits for bytes, so a flight in real time takes
as long as its computation, and a seed gives the same flight again.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from enum import Enum

from flighttest.flight import FlightState
from flighttest.link.clock import FollowedClock
from flighttest.mavlink import CopterMode
from flighttest.mavlink.dialect import dialect, parser
from flighttest.sim import InProcess, SimOptions

STEP_S = 0.0025
EPOCH_S = 1000.0
LEAP_S = 86400.0
_ID = slice(7, 10)  # of a MAVLink 2 frame
_BY_FORCE = 21196  # of arming and disarming commands


class When(Enum):
    """What the client is at, as its frames show; a fault begins `after_s` after."""

    CONNECTING = "connecting"
    PREFLIGHT = "preflight"
    ARMING = "arming"
    CLIMBING = "climb"
    RETURNING = "return"
    ENTERING = "entry"
    FLYING = "step"
    ABORTING = "abort"
    LANDING = "landing"


class Endless(Exception):
    """The flight did not end in time."""


class Broken(Exception):
    """What no transport should raise."""


@dataclass(frozen=True)
class Fault:
    """What is done to frames from its beginning on, for `lasts_s`. up, down: whether that direction is lost for good meanwhile.

    loss: share lost each way; double: each frame twice; jitter_s: each frame late by up to this, in any order; latency_s: all late;
    hold: nothing passes, and all of it at the end; freeze_s: for how long the client itself stands still; leap, stamp: the vehicle's
    clock a day ahead, for good or in one frame; twin: a second vehicle of the same id; station: another ground station switches streams
    off, once; reboot: the vehicle starts anew; pilot_after_s: when the pilot chooses `pilot_mode` (also when another fault is there);
    corrupt: share of frames each way of which one bit is turned; bytes_per_s: of a serial line, with a buffer of a second; false_mode,
    false_disarmed: one HEARTBEAT that is not so; presses: how often Ctrl-C is pressed; disk: the disk of the record is full; cut: the
    first frame each way breaks off in its middle, as where a connection is reset; kill: the pilot stops the motors, once; no_beats: the
    vehicle's HEARTBEATs are lost meanwhile; back_after_s: when the pilot chooses GUIDED_NOGPS; anew: the vehicle's clock begins anew,
    which nothing else shows; arm: the pilot arms, once; broken: the transport raises an error of a kind that the code does not expect;
    old_beats: how many HEARTBEATs after the pilot's switch show the mode of before.
    """

    name: str
    lasts_s: float = 0.0
    up: bool = False
    down: bool = False
    loss: float = 0.0
    double: bool = False
    jitter_s: float = 0.0
    latency_s: float = 0.0
    hold: bool = False
    freeze_s: float = 0.0
    leap: bool = False
    stamp: bool = False
    twin: bool = False
    station: bool = False
    reboot: bool = False
    pilot_after_s: float | None = None
    pilot_mode: CopterMode = CopterMode.LOITER
    corrupt: float = 0.0
    bytes_per_s: float | None = None
    false_mode: CopterMode | None = None
    false_disarmed: bool = False
    presses: int = 0
    disk: bool = False
    cut: bool = False
    kill: bool = False
    arm: bool = False
    no_beats: bool = False
    old_beats: int = 0
    back_after_s: float | None = None
    anew: bool = False
    broken: bool = False

    @property
    def for_good(self) -> bool:
        """Whether it never passes. A disk is no reason to leave a vehicle."""
        return self.lasts_s >= 1e3 and not self.disk


@dataclass
class Proxy:
    """A transport for `fly`, and the clock that goes with it (`clock`)."""

    options: SimOptions
    fault: Fault
    when: When | FlightState
    after_s: float = 0.0
    limit_s: float = 400.0
    seed: int = 1
    now_s: float = EPOCH_S
    began_s: float | None = None
    switched_s: float | None = None
    sent_after_switch: list[tuple[float, str]] = field(default_factory=list)
    presses: int = 0

    def __post_init__(self) -> None:
        self.sim = InProcess(self.options)
        self._start_s = self.now_s
        self._prepare()

    def _prepare(self) -> None:
        self._draw = random.Random(self.seed)
        self._up: list[tuple[float, int, bytes]] = []
        self._down: list[tuple[float, int, bytes]] = []
        self._order = 0
        self._ours, self._theirs = parser(1, 1), parser(1, 1)
        self._station, self._twin = parser(255, 190), parser(1, 1)
        self._twin.seq = 120
        self._twin_next_s = 0.0
        self._free_s: dict[bool, float] = {}  # when a serial line will have sent all, by whether it is the uplink
        self._done: set[str] = set()
        self._mode, self._old_beats = 0, 0
        self._reached: dict[When | FlightState, float] = {}

    def clock(self) -> FollowedClock:
        """The client's clock, on this host's time."""
        return FollowedClock(lambda: self.now_s, lambda: self.now_s)

    # -- the fault -----------------------------------------------------------------------------------------------------------

    @property
    def active(self) -> bool:
        """Whether the fault is there now."""
        return self.began_s is not None and self.began_s <= self.now_s < self.began_s + self.fault.lasts_s

    def reached(self, when: When | FlightState) -> bool:
        """Whether the client has come to that."""
        return when in self._reached

    def reach(self, when: When | FlightState) -> None:
        """Note that the client has come to that; the fault may begin with it."""
        self._reached.setdefault(when, self.now_s)
        if self.began_s is None and self.when in self._reached:
            self.began_s = self._reached[self.when] + self.after_s

    def _look(self, message: object) -> None:
        """What the client is at."""
        kind = message.get_type()  # type: ignore[attr-defined]
        seen: When | None = None
        if kind == "HEARTBEAT":
            seen = When.CONNECTING
        elif kind == "PARAM_SET":
            seen = When.PREFLIGHT
        elif kind == "STATUSTEXT" and message.text.endswith(" step"):  # type: ignore[attr-defined]
            seen = When.FLYING
        elif kind == "COMMAND_LONG":
            seen = self._command(int(message.command), float(message.param1), int(message.param2))  # type: ignore[attr-defined]
        if seen is not None:
            self.reach(seen)

    def _command(self, command: int, first: float, second: int) -> When | None:
        if command == dialect.MAV_CMD_COMPONENT_ARM_DISARM and first == 1.0:
            return When.ARMING
        if command == dialect.MAV_CMD_NAV_TAKEOFF:
            return When.CLIMBING
        if command != dialect.MAV_CMD_DO_SET_MODE:
            return None
        if second == CopterMode.GUIDED:
            return When.RETURNING if When.FLYING in self._reached else None
        modes = {CopterMode.GUIDED_NOGPS: When.ENTERING, CopterMode.BRAKE: When.ABORTING, CopterMode.LAND: When.LANDING}
        return modes.get(CopterMode(second))

    def _once(self, name: str, wanted: bool, after_s: float = 0.0) -> bool:
        if not wanted or name in self._done or self.began_s is None or self.now_s < self.began_s + after_s:
            return False
        self._done.add(name)
        return True

    def _act(self) -> None:
        """What happens once."""
        fault = self.fault
        if self._once("presses", fault.presses > 0):
            self.presses = fault.presses
        if self._once("station", fault.station):
            for number in (
                dialect.MAVLINK_MSG_ID_ATTITUDE,
                dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
                dialect.MAVLINK_MSG_ID_HEARTBEAT,
            ):
                off = (dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, -1.0, 0, 0, 0, 0, 0)
                self._to_vehicle(bytes(dialect.MAVLink_command_long_message(1, 1, *off).pack(self._station)))
        if self._once("pilot", fault.pilot_after_s is not None, fault.pilot_after_s or 0.0):
            self.switched_s = self.now_s
            self._switch()
        if self._once("back", fault.back_after_s is not None, fault.back_after_s or 0.0):
            self._choose(CopterMode.GUIDED_NOGPS)
        if self._once("kill", fault.kill):
            self._kill()
        if self._once("arm", fault.arm):
            self._arm()
        if self._once("reboot", fault.reboot):
            self._reboot()

    # -- the vehicle ---------------------------------------------------------------------------------------------------------

    def _to_vehicle(self, data: bytes) -> None:
        """Frames of others."""
        self.sim.send(data)

    def _switch(self) -> None:
        """The pilot moves the mode switch."""
        self._choose(self.fault.pilot_mode)

    def _choose(self, mode: CopterMode) -> None:
        chosen = dialect.MAVLink_param_set_message(1, 1, b"SIM_PILOT_MODE", float(mode), 9)
        self._to_vehicle(bytes(chosen.pack(self._station)))

    def _arm(self) -> None:
        """The pilot arms, as by the sticks of the transmitter."""
        arm = (dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, 0, 0, 0, 0, 0, 0)
        self._to_vehicle(bytes(dialect.MAVLink_command_long_message(1, 1, *arm).pack(self._station)))

    def _kill(self) -> None:
        """The pilot stops the motors, as by a switch of the transmitter."""
        stop = (dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0.0, _BY_FORCE, 0, 0, 0, 0, 0)
        self._to_vehicle(bytes(dialect.MAVLink_command_long_message(1, 1, *stop).pack(self._station)))

    def _reboot(self) -> None:
        """The vehicle starts anew."""
        self.sim = InProcess(self.options)
        self._start_s = self.now_s

    def _freeze(self) -> None:
        """The program stands still, and time does not."""
        self._pass(self.fault.freeze_s)

    # -- as a transport ------------------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Frames of the client."""
        self._raise_where_broken()
        for message in self._ours.parse_buffer(data) or []:
            self._look(message)
            if message.get_type() in ("PARAM_REQUEST_READ", "PARAM_SET") and message.param_id == "SIM_LOCKSTEP":
                continue  # time is not granted here
            if self.switched_s is not None:
                self.sent_after_switch.append((self.now_s, message.get_type()))
            self._queue(self._up, bytes(message.get_msgbuf()), lost=self.fault.up)

    def receive(self, timeout_s: float) -> bytes:
        """Let up to timeout_s pass; what has arrived."""
        if self.now_s - EPOCH_S > self.limit_s:
            raise Endless(f"still flying after {self.limit_s:.0f} s")
        self._raise_where_broken()
        if self._once("freeze", self.fault.freeze_s > 0.0):
            self._freeze()
        wait_s = max(timeout_s, 1e-6) if timeout_s > 0.0 else 0.0  # one below rounding would never end
        end_s = self.now_s + wait_s
        while True:
            data = self._arrived(self._down)
            if data or self.now_s >= end_s:
                return data
            self._pass(STEP_S)  # all of it: time moves on however short the wait

    def _raise_where_broken(self) -> None:
        if self.fault.broken and self.active:
            raise Broken("the transport is broken")

    def close(self) -> None:
        """Nothing to give back."""

    def _pass(self, span_s: float) -> None:
        end_s = self.now_s + span_s
        while self.now_s < end_s - 1e-9:
            self.now_s = min(self.now_s + STEP_S, end_s)
            self._act()
            self.sim.send(self._arrived(self._up))
            behind_s = self.now_s - self._start_s - self.sim.time_s
            if behind_s > 0.0:
                self.sim.advance(behind_s)
            said = self.sim.receive()
            for message in (self._theirs.parse_buffer(said) or []) if said else []:
                self._queue(self._down, self._altered(message), lost=self.fault.down)
            self._send_as_twin()

    def _altered(self, message: object) -> bytes:
        kind, fault = message.get_type(), self.fault  # type: ignore[attr-defined]
        again = parser(message.get_srcSystem(), message.get_srcComponent())  # type: ignore[attr-defined]
        again.seq = message.get_seq()  # type: ignore[attr-defined]
        if kind == "PARAM_VALUE" and message.param_id == "SIM_LOCKSTEP":  # type: ignore[attr-defined]
            value = (message.param_value, message.param_type, message.param_count, message.param_index)  # type: ignore[attr-defined]
            return bytes(dialect.MAVLink_param_value_message(b"SIM_NO_LOCKSTEP", *value).pack(again))
        if kind == "HEARTBEAT" and self.switched_s is None:
            self._mode = int(message.custom_mode)  # type: ignore[attr-defined]
        if self.began_s is None or self.now_s < self.began_s:
            return bytes(message.get_msgbuf())  # type: ignore[attr-defined]
        if kind == "HEARTBEAT" and self.switched_s is not None and self._old_beats < fault.old_beats:
            self._old_beats += 1
            message.custom_mode = self._mode  # type: ignore[attr-defined]
            return bytes(message.pack(again))  # type: ignore[attr-defined]
        if kind == "HEARTBEAT" and self._once("false", fault.false_mode is not None or fault.false_disarmed):
            if fault.false_mode is not None:
                message.custom_mode = int(fault.false_mode)  # type: ignore[attr-defined]
            else:
                message.base_mode &= ~dialect.MAV_MODE_FLAG_SAFETY_ARMED  # type: ignore[attr-defined]
            return bytes(message.pack(again))  # type: ignore[attr-defined]
        if fault.anew and getattr(message, "time_boot_ms", 0):
            message.time_boot_ms -= int(1e3 * (self.began_s - self._start_s))  # type: ignore[attr-defined]
            return bytes(message.pack(again))  # type: ignore[attr-defined]
        if not (fault.leap or fault.stamp):
            return bytes(message.get_msgbuf())  # type: ignore[attr-defined]
        if fault.stamp and kind != "ATTITUDE":
            return bytes(message.get_msgbuf())  # type: ignore[attr-defined]
        if hasattr(message, "time_boot_ms") and self._once("stamp", fault.stamp) | fault.leap:
            message.time_boot_ms += int(LEAP_S * 1e3)
        elif fault.leap and kind == "TIMESYNC" and message.tc1:  # type: ignore[attr-defined]
            message.tc1 += int(LEAP_S * 1e9)  # type: ignore[attr-defined]
        return bytes(message.pack(again))  # type: ignore[attr-defined]

    def _send_as_twin(self) -> None:
        if not (self.fault.twin and self.active) or self.now_s < self._twin_next_s:
            return
        self._twin_next_s = self.now_s + 0.25
        for message in (
            dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3),
            dialect.MAVLink_attitude_message(5_000_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        ):
            self._down.append((self.now_s, self._order, bytes(message.pack(self._twin))))
            self._twin.seq = (self._twin.seq + 1) % 256
            self._order += 1

    def _queue(self, queue: list[tuple[float, int, bytes]], frame: bytes, *, lost: bool) -> None:
        fault, due_s = self.fault, self.now_s
        copies = 1
        if self.active:
            if fault.cut and self._once("cut up" if queue is self._up else "cut down", True):
                frame, lost = frame[: len(frame) // 2], False
            if lost or self._draw.random() < fault.loss:
                return
            if (
                fault.no_beats
                and queue is self._down
                and int.from_bytes(frame[_ID], "little") == dialect.MAVLINK_MSG_ID_HEARTBEAT
            ):
                return
            due_s += fault.latency_s + fault.jitter_s * self._draw.random()
            if self._draw.random() < fault.corrupt:
                place = self._draw.randrange(8 * len(frame))
                frame = bytes(b ^ (1 << place % 8 if i == place // 8 else 0) for i, b in enumerate(frame))
            if fault.bytes_per_s is not None:
                free_s = max(self._free_s.get(queue is self._up, 0.0), self.now_s)
                if free_s - self.now_s > 1.0:
                    return
                due_s = self._free_s[queue is self._up] = free_s + len(frame) / fault.bytes_per_s
            copies = 2 if fault.double else 1
            if fault.hold:
                assert self.began_s is not None
                due_s = self.began_s + fault.lasts_s
        for _ in range(copies):
            self._order += 1
            queue.append((due_s, self._order, frame))

    def _arrived(self, queue: list[tuple[float, int, bytes]]) -> bytes:
        due = sorted(entry for entry in queue if entry[0] <= self.now_s)
        if due:
            queue[:] = [entry for entry in queue if entry[0] > self.now_s]
        return b"".join(frame for _, _, frame in due)
