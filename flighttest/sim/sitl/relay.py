"""Lock-step for a real firmware on our physics: between a ground program and the firmware's serial port, beside the physics.

A firmware waits for each answer of its physics, and the physics answers no further than the ground program has granted: the protocol of
`flighttest.sim.lockstep`, for a firmware that does not have it. SIM_LOCKSTEP is answered here, grants end here, and every other
frame passes as it is. Without it a target arrives when both processes happen to be scheduled: at four times real time, a host that is
late by 10 ms makes a target late by 40 ms.

The firmware reads and writes its serial ports every 10 ms of its own time (ArduPilot's SITL); that stays. Signed frames pass as they are:
a ground program that signs flies on the firmware's own clock.
"""

from __future__ import annotations

import selectors
import socket
from collections import deque
from contextlib import suppress
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.wire import Decoder

PARAMETER = "SIM_LOCKSTEP"
_READ_BYTES = 65536
_PENDING_MAX_BYTES = 32 << 20  # a client that has not read for this long is gone
_V2, _V1 = 0xFD, 0xFE
_SIGNED_BYTES = 13
_NO_INDEX = 0xFFFF


class FrameSplitter:
    """Cuts what the firmware sends into whole frames. system, component, sequence: of the last one."""

    def __init__(self) -> None:
        self._rest = b""
        self.system, self.component, self.sequence = 1, 1, 255

    def feed(self, data: bytes) -> bytes:
        """As much of what came as ends with a whole frame; bytes that begin none pass as they are."""
        data = self._rest + data
        at, end = 0, len(data)
        while at < end:
            if data[at] == _V2:
                if at + 3 > end:
                    break
                size = 12 + data[at + 1] + _SIGNED_BYTES * (data[at + 2] & 1)
                head = at + 4
            elif data[at] == _V1:
                if at + 2 > end:
                    break
                size, head = 8 + data[at + 1], at + 2
            else:
                at += 1
                continue
            if at + size > end:
                break
            self.sequence, self.system, self.component = data[head], data[head + 1], data[head + 2]
            at += size
        self._rest = data[at:]
        return data[:at]


class Relay:
    """One ground program at a time, and the firmware behind it. lockstep: whether time is granted; resting: the firmware waits for time, so
    that what it is sent now it receives next.

    listening: where ground programs connect; firmware: host and port of its serial port. The owner calls `look` with what `selector`
    finds, `may_run` before each step of the physics, and `waits` whenever the firmware may not have one.
    """

    def __init__(
        self, listening: socket.socket, firmware: tuple[str, int], selector: selectors.BaseSelector | None = None
    ) -> None:
        self._listening, self._firmware_at = listening, firmware
        self.selector = selector or selectors.DefaultSelector()
        listening.setblocking(False)
        self.selector.register(listening, selectors.EVENT_READ)
        self._client: socket.socket | None = None
        self._firmware: socket.socket | None = None
        self._pending = bytearray()
        self._frames, self._decoder = FrameSplitter(), Decoder()
        self._queue: deque[Any] = deque()
        self._encoder = dialect.MAVLink(None)
        self.lockstep = self.resting = False
        self._granted_us: int | None = None
        self._now_us = 0

    @property
    def busy(self) -> bool:
        """Whether bytes wait for a ground program that does not read."""
        return bool(self._pending)

    @property
    def granted(self) -> bool:
        """Whether a grant is not used up."""
        return self._granted_us is not None

    def may_run(self, until_us: int) -> bool:
        """Whether the vehicle's time may go on to until_us, which it then does."""
        may = not self.lockstep or (self._granted_us is not None and until_us <= self._granted_us)
        self.resting = self.resting and not may
        return may

    def waits(self, now_us: int) -> None:
        """The firmware waits for a step and has sent all it had to: at its time now_us, which it may not pass yet."""
        self._now_us, self.resting = now_us, True
        if self._granted_us is not None:
            self._from_firmware()
            self._mark(self._granted_us // 1000)
            self._granted_us = None
        self._serve()

    def look(self, ready: object) -> None:
        """A socket of ours can be read."""
        if ready is self._listening:
            self._accept()
        elif ready is self._client:
            self._from_client()
        elif ready is self._firmware:
            self._from_firmware()

    def close(self) -> None:
        """Hang up on both sides and listen no more."""
        self._leave()
        self._listening.close()

    # -- connections ---------------------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        with suppress(OSError):
            connection, _ = self._listening.accept()
            try:
                firmware = socket.create_connection(self._firmware_at, timeout=1.0)
            except OSError:  # it starts again, or has ended: hang up, and let the client come again
                connection.close()
                return
            self._client, self._firmware = connection, firmware
            for sock in (connection, firmware):
                sock.setblocking(False)
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.selector.register(sock, selectors.EVENT_READ)
            self._frames, self._decoder = FrameSplitter(), Decoder()
            self.selector.unregister(self._listening)  # a second ground program waits until the first has left

    def _leave(self) -> None:
        """A side hung up: what hung on its leash runs freely."""
        self.lockstep, self._granted_us = False, None
        self._queue.clear()
        self._pending.clear()
        for sock in (self._client, self._firmware):
            if sock is not None:
                self.selector.unregister(sock)
                sock.close()
        if self._client is not None:
            self.selector.register(self._listening, selectors.EVENT_READ)
        self._client = self._firmware = None

    @staticmethod
    def _read(sock: socket.socket) -> bytes | None:
        """What has come; None where the other side hung up."""
        try:
            return sock.recv(_READ_BYTES) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    # -- from the ground program ---------------------------------------------------------------------------------------------

    def _from_client(self) -> None:
        assert self._client is not None
        data = self._read(self._client)
        if data is None:
            self._leave()
            return
        self._queue.extend(self._decoder.feed(data))
        self._serve()

    def _serve(self) -> None:
        """Handle what came in order, up to a grant that has to be run first."""
        while self._queue and self._granted_us is None and (self.resting or not self.lockstep):
            message = self._queue.popleft()
            frame = bytes(message.get_msgbuf())
            kind = message.get_type() if not (frame[0] == _V2 and frame[2] & 1) else ""
            if kind == "SYSTEM_TIME" and self.lockstep and message.time_unix_usec == 0:
                until_us = 1000 * message.time_boot_ms
                if until_us > self._now_us:
                    self._granted_us = until_us
                else:
                    self._mark(self._now_us // 1000)
            elif kind == "PARAM_REQUEST_READ" and message.param_id == PARAMETER:
                self._say_parameter()
            elif kind == "PARAM_SET" and message.param_id == PARAMETER:
                self.lockstep = bool(message.param_value)
                self._say_parameter()
            elif self._firmware is not None:
                try:
                    self._firmware.send(frame)  # the firmware reads; some 50 bytes always fit
                except OSError:
                    self._leave()

    # -- to the ground program -----------------------------------------------------------------------------------------------

    def _from_firmware(self) -> None:
        if self._firmware is None:
            return
        while data := self._read(self._firmware):
            self._send(self._frames.feed(data))
        if data is None:
            self._leave()

    def _say_parameter(self) -> None:
        self._say(
            dialect.MAVLink_param_value_message(
                PARAMETER.encode(), float(self.lockstep), dialect.MAV_PARAM_TYPE_INT8, 0, _NO_INDEX
            )
        )

    def _mark(self, now_ms: int) -> None:
        self._say(dialect.MAVLink_system_time_message(0, now_ms & 0xFFFFFFFF))

    def _say(self, message: Any) -> None:
        """A message of the vehicle's. It repeats the last sequence number: the firmware's count goes on without a gap."""
        mav, frames = self._encoder, self._frames
        mav.srcSystem, mav.srcComponent, mav.seq = frames.system, frames.component, frames.sequence
        self._send(bytes(message.pack(mav)))

    def _send(self, data: bytes) -> None:
        self._pending += data
        self.flush()

    def flush(self) -> None:
        """Send what waits, as far as the ground program takes it."""
        if self._client is None or not self._pending:
            return
        try:
            sent = self._client.send(self._pending)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._leave()
            return
        del self._pending[:sent]
        if len(self._pending) > _PENDING_MAX_BYTES:
            self._leave()
