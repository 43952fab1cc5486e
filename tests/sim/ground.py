"""A bare ground station: a socket, pymavlink's dialect, and every answer of the vehicle as a plain line. No link and no codec of ours."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

STREAMS = {"HEARTBEAT", "ATTITUDE", "ATTITUDE_TARGET", "LOCAL_POSITION_NED", "SYSTEM_TIME", "EXTENDED_SYS_STATE"}


class Wire(Protocol):
    """Bytes to and from a vehicle, and its time."""

    def send(self, data: bytes) -> None: ...
    def pump(self) -> bytes:
        """What has come; lets about 20 ms of vehicle time pass."""
        ...


class Socket:
    """A vehicle at tcp:HOST:PORT."""

    def __init__(self, url: str, patience_s: float = 60.0) -> None:
        host, port = url.removeprefix("tcp:").rsplit(":", 1)
        end = time.monotonic() + patience_s
        while True:
            try:
                self._socket = socket.create_connection((host, int(port)), 1.0)
                break
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)
        self._socket.settimeout(0.005)

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def pump(self) -> bytes:
        try:
            return self._socket.recv(65536)
        except TimeoutError:
            return b""


class Ground:
    """The ground station: sends, listens, and notes what is worth comparing. `lines` are the answers since the last `take`."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self._mav = dialect.MAVLink(None, srcSystem=250, srcComponent=190)
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self.last: dict[str, Any] = {}
        self.names: set[str] = set()
        self.lines: list[str] = []
        self.now_s = 0.0
        self._text = ""
        self._beat = self._state = ""
        self._hover = 0.3

    # -- talking -------------------------------------------------------------------------------------------------------------

    def send(self, message: Any) -> None:
        self.wire.send(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) & 0xFF

    def command(self, number: int, *params: float) -> None:
        padded = [*params, *([0.0] * (7 - len(params)))]
        self.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *padded))
        self.until(lambda m: m.get_type() == "COMMAND_ACK" and m.command == number, 2.0)

    def target(
        self, roll: float = 0.0, throttle: float | None = None, mask: int = 7, size: float = 1.0, yaw_rate: float = 0.0
    ) -> None:
        """SET_ATTITUDE_TARGET at the present heading; throttle None holds the height roughly."""
        if throttle is None:
            throttle = self.holding()
        yaw = self.last["ATTITUDE"].yaw if "ATTITUDE" in self.last else 0.0
        cr, sr, cy, sy = math.cos(roll / 2), math.sin(roll / 2), math.cos(yaw / 2), math.sin(yaw / 2)
        q = [size * x for x in (cr * cy, sr * cy, sr * sy, cr * sy)]
        self.send(dialect.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0.0, 0.0, yaw_rate, throttle))

    def hover(self) -> float:
        """Take the present throttle as the one that holds height."""
        self._hover = float(self.last["ATTITUDE_TARGET"].thrust)
        return self._hover

    def holding(self) -> float:
        """Throttle that holds 8 m, roughly."""
        place = self.last["LOCAL_POSITION_NED"]
        wanted = min(max(0.5 * (8.0 + place.z), -1.0), 1.0)
        return self._hover * min(max(1.0 + 0.3 * (wanted + place.vz), 0.5), 1.5)

    # -- listening -----------------------------------------------------------------------------------------------------------

    def until(self, wanted: Callable[[Any], bool], timeout_s: float) -> Any | None:
        """Listen until a message is there, or so many vehicle seconds have passed."""
        found: Any | None = None
        end = self.now_s + timeout_s
        quiet = time.monotonic() + 20.0 + 2.0 * timeout_s
        while self.now_s < end and time.monotonic() < quiet:
            for message in self._parser.parse_buffer(self.wire.pump()) or []:
                self._take(message)
                if found is None and wanted(message):
                    found = message
            if found is not None:
                return found
        return None

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Listen for so many vehicle seconds, calling `each` about 50 times in each of them."""
        end = self.now_s + seconds
        while self.now_s < end:
            if each is not None:
                each()
            self.until(lambda _m: False, 0.02)

    def _take(self, m: Any) -> None:
        kind = m.get_type()
        if kind == "BAD_DATA" or m.get_srcSystem() != 1:
            return
        self.names.add(kind)
        self.last[kind] = m
        boot = getattr(m, "time_boot_ms", None)
        if boot is not None:
            self.now_s = max(self.now_s, boot * 1e-3)
        elif kind == "HEARTBEAT" and "ATTITUDE" not in self.last:
            self.now_s += 1.0
        if kind == "HEARTBEAT":
            beat = f"HEARTBEAT mode {m.custom_mode} {'armed' if m.base_mode & 128 else 'disarmed'}"
            if beat != self._beat:
                self._beat = beat
                self.lines.append(beat)
        elif kind == "STATUSTEXT":
            self._text = self._text + m.text if m.chunk_seq else m.text
            if m.id == 0 or len(m.text) < 50:
                self.lines.append(f"STATUSTEXT {m.severity} {self._text}")
        elif kind == "COMMAND_ACK":
            self.lines.append(f"COMMAND_ACK {m.command} result {m.result} to {m.target_system}/{m.target_component}")
        elif kind == "PARAM_VALUE":
            self.lines.append(f"PARAM_VALUE {m.param_id} {m.param_value:.6g} type {m.param_type} index {m.param_index}")
        elif kind == "EXTENDED_SYS_STATE":
            state = f"EXTENDED_SYS_STATE landed_state {m.landed_state}"
            if state != self._state:
                self._state = state
                self.lines.append(state)
        elif kind not in STREAMS and kind != "TIMESYNC":
            self.lines.append(kind)

    def take(self) -> list[str]:
        """The answers since the last call."""
        lines, self.lines = self.lines, []
        return lines
