"""The ground crew of a SITL vehicle: a full pack after each landing, as the built-in vehicle gets one.

ArduPilot's simulated pack is full again when SIM_BATT_VOLTAGE changes. The crew has a connection of its own and touches nothing else.
"""

from __future__ import annotations

import socket
import threading
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.wire import Decoder, Encoder

_SYSTEM, _COMPONENT = 253, 190  # an id that no ground station uses
_NAME = b"SIM_BATT_VOLTAGE"
# The pack is only swapped when the value differs from the last one.
_OTHER_V = 0.01
_RETRY_S = 0.5


class GroundCrew:
    """Watches a vehicle at host:port from a thread of its own until `stop`. swapped: packs so far."""

    def __init__(self, host: str, port: int) -> None:
        self.swapped = 0
        self._address = (host, port)
        self._stop = threading.Event()
        self._full_v: float | None = None
        self._last_v: float | None = None
        self._armed = False
        self._encoder, self._decoder = Encoder(_SYSTEM, _COMPONENT), Decoder()
        self._thread = threading.Thread(target=self._run, name="ground crew", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the watch; a second call does nothing."""
        self._stop.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                with socket.create_connection(self._address, 1.0) as connection:
                    connection.settimeout(0.2)
                    self._watch(connection)
            except OSError:
                # Not listening yet, or gone: the launcher decides about that.
                self._stop.wait(_RETRY_S)

    def _watch(self, connection: socket.socket) -> None:
        while not self._stop.is_set():
            try:
                data = connection.recv(65536)
            except TimeoutError:
                continue
            if not data:
                return
            for message in self._decoder.feed(data):
                answer = self.take(message)
                if answer is not None:
                    connection.sendall(self._encoder.message(answer))

    def take(self, message: Any) -> Any | None:
        """What the crew answers to a message of the vehicle, None where nothing."""
        kind = message.get_type()
        if kind == "PARAM_VALUE" and message.param_id == _NAME.decode():
            self._full_v = self._full_v or float(message.param_value)
            self._last_v = float(message.param_value)
            return None
        if kind != "HEARTBEAT" or message.autopilot != dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
            return None
        if self._full_v is None:
            return dialect.MAVLink_param_request_read_message(1, 1, _NAME, -1)
        landed = self._armed and not message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED
        self._armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        if not landed:
            return None
        self.swapped += 1
        value = self._full_v - _OTHER_V if self._last_v == self._full_v else self._full_v
        self._last_v = value
        return dialect.MAVLink_param_set_message(1, 1, _NAME, value, dialect.MAV_PARAM_TYPE_REAL32)
