"""A vehicle that sends and answers MAVLink as PX4 does, on a UDP port of this machine: its modes, refusals and failsafe, no aerodynamics.

After PX4 1.15 (commander's mode and failsafe checks, mavlink_receiver): custom_mode is main << 16 | sub << 24; offboard is refused
while no setpoint has come for COM_OF_LOSS_T, and left for Position when they stop; arming is refused with a STATUSTEXT while a
check fails; take-off climbs to MIS_TAKEOFF_ALT and then loiters; landing disarms.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import threading
import time
from dataclasses import dataclass, field

from flighttest.mavlink.dialect import Message, dialect, parser

POSITION, OFFBOARD = 3 << 16, 6 << 16
TAKE_OFF, LOITER, LAND = (4 << 16 | sub << 24 for sub in (2, 3, 6))
LOSS_S = 1.0  # COM_OF_LOSS_T
CLIMB_M_S = 8.0  # quicker than PX4, for the tests' sake
_BEAT_S = 0.2


@dataclass
class Px4Double:
    """A context manager; `url` is what a client connects to. why_not: the check that keeps it from arming, '' where none does.

    targets: (host time s, roll, pitch, yaw rad in NED/FRD, thrust, type mask) of each SET_ATTITUDE_TARGET; modes: custom modes in order.
    """

    why_not: str = ""
    armed: bool = False
    mode: int = LOITER
    height_m: float = 0.0
    targets: list[tuple[float, float, float, float, float, int]] = field(default_factory=list)
    modes: list[int] = field(default_factory=list)
    takeoff_m: float = 2.5

    def __post_init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self._there = free.getsockname()
        self.url = f"udpin:127.0.0.1:{self._there[1]}"
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.bind(("127.0.0.1", 0))
        self._mav, self._ours = parser(1, 1), parser(1, 1)
        self._over = threading.Event()
        self._heard_s = -math.inf  # the last setpoint
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Px4Double:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._line.close()

    def pilot(self) -> None:
        """The pilot moves the sticks (COM_RC_OVERRIDE): Position."""
        self._switch(POSITION)

    def _switch(self, mode: int) -> None:
        self.mode = mode
        self.modes.append(mode)

    def _run(self) -> None:
        beat_s = then_s = time.monotonic()
        while not self._over.is_set():
            if select.select([self._line], [], [], 0.01)[0]:
                for message in self._ours.parse_buffer(self._line.recv(65536)) or []:
                    self._take(message)
            now_s = time.monotonic()
            self._move(now_s - then_s, now_s)
            then_s = now_s
            if now_s >= beat_s:
                beat_s += _BEAT_S
                self._say_state()

    def _move(self, span_s: float, now_s: float) -> None:
        if self.mode == OFFBOARD and now_s - self._heard_s > LOSS_S:
            self._switch(POSITION)
            self._text("Failsafe activated: no offboard signal")
        if not self.armed:
            return
        if self.mode == TAKE_OFF:
            self.height_m = min(self.height_m + CLIMB_M_S * span_s, self.takeoff_m)
            if self.height_m >= self.takeoff_m:
                self._switch(LOITER)
        elif self.mode == LAND:
            self.height_m = max(self.height_m - CLIMB_M_S * span_s, 0.0)
            if self.height_m == 0.0:
                self.armed = False

    def _say_state(self) -> None:
        base = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        self._send(
            dialect.MAVLink_heartbeat_message(2, dialect.MAV_AUTOPILOT_PX4, base, self.mode, 4 if self.armed else 3, 3)
        )
        down = dialect.MAV_LANDED_STATE_IN_AIR if self.height_m > 0.0 else dialect.MAV_LANDED_STATE_ON_GROUND
        self._send(dialect.MAVLink_extended_sys_state_message(0, down))

    def _send(self, message: Message) -> None:
        self._line.sendto(bytes(message.pack(self._mav)), self._there)
        self._mav.seq = (self._mav.seq + 1) % 256

    def _text(self, text: str) -> None:
        self._send(dialect.MAVLink_statustext_message(4, text.encode()))

    def _take(self, message: Message) -> None:
        kind = message.get_type()
        if kind == "COMMAND_LONG":
            result = self._command(message)
            self._send(dialect.MAVLink_command_ack_message(message.command, result))
        elif kind == "SET_ATTITUDE_TARGET":
            self._heard_s = time.monotonic()
            w, x, y, z = message.q
            roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
            pitch, yaw = math.asin(2 * (w * y - z * x)), math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            self.targets.append((self._heard_s, roll, pitch, yaw, message.thrust, message.type_mask))
        elif kind in ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"):
            self._heard_s = time.monotonic()
        elif kind in ("PARAM_SET", "PARAM_REQUEST_READ") and message.param_id == "MIS_TAKEOFF_ALT":
            if kind == "PARAM_SET":
                self.takeoff_m = float(message.param_value)
            self._send(dialect.MAVLink_param_value_message(b"MIS_TAKEOFF_ALT", self.takeoff_m, 9, 1, 0))

    def _command(self, message: Message) -> int:
        number, first = int(message.command), message.param1
        if number in (dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES):
            if (
                number == dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES
                or first == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
            ):
                flags = (
                    dialect.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
                    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
                )
                version = struct.unpack("<I", bytes([255, 0, 15, 1]))[0]
                nothing = [0] * 8
                self._send(
                    dialect.MAVLink_autopilot_version_message(
                        flags, version, 0, 0, 0, nothing, nothing, nothing, 0, 0, 1
                    )
                )
                return int(dialect.MAV_RESULT_ACCEPTED)
            return int(dialect.MAV_RESULT_DENIED)
        if number == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            if first == 1.0 and self.why_not:
                self._text(f"Arming denied: {self.why_not}")
                return int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
            self.armed = first == 1.0
            return int(dialect.MAV_RESULT_ACCEPTED)
        wanted = {dialect.MAV_CMD_NAV_TAKEOFF: TAKE_OFF, dialect.MAV_CMD_NAV_LAND: LAND}.get(number)
        if number == dialect.MAV_CMD_DO_SET_MODE:
            wanted = int(message.param2) << 16 | int(message.param3) << 24
        if wanted is None:
            return int(dialect.MAV_RESULT_UNSUPPORTED)
        if wanted == OFFBOARD and time.monotonic() - self._heard_s > LOSS_S:
            self._text("Switching to mode 'Offboard' is currently not possible")
            return int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
        self._switch(wanted)
        return int(dialect.MAV_RESULT_ACCEPTED)
