"""Ask an ArduPilot vehicle over a TCP port whether it can arm: the few messages that answer it, and nothing more."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.wire import Decoder, Encoder

# Not 255: a ground station's failsafe must not start to watch a probe that soon falls silent.
_SYSTEM, _COMPONENT = 254, 190
_ASK_EVERY_S = 1.0
_INTERVAL_US = 200_000.0
_HAS_POSITION = dialect.EKF_POS_HORIZ_ABS | dialect.EKF_VELOCITY_HORIZ
_WANTED = (
    dialect.MAVLINK_MSG_ID_SYS_STATUS,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS,
)


@dataclass
class Readiness:
    """What the vehicle has sent so far. texts: its status texts, oldest first."""

    heard: bool = False
    checks_pass: bool = False
    has_position: bool = False
    texts: list[str] = field(default_factory=list)

    @property
    def ready(self) -> bool:
        """Whether it would arm in GUIDED."""
        return self.checks_pass and self.has_position

    @property
    def missing(self) -> str:
        """What is not there yet, with the vehicle's last reason."""
        if not self.heard:
            return "it sent no heartbeat"
        what = "it does not pass its arming checks" if not self.checks_pass else "its estimator has no position"
        reasons = [text for text in self.texts if "PreArm" in text or "Arm:" in text]
        return f"{what} ({reasons[-1]})" if reasons else what


class ArmingProbe:
    """One TCP connection that asks and listens. `poll` until `state.ready`."""

    def __init__(self, host: str, port: int, timeout_s: float = 1.0) -> None:
        self.state = Readiness()
        self._socket = socket.create_connection((host, port), timeout_s)
        self._encoder, self._decoder = Encoder(_SYSTEM, _COMPONENT), Decoder()
        self._asked_s = float("-inf")

    def poll(self, wait_s: float) -> Readiness:
        """Listen for at most wait_s, s; OSError when the connection breaks."""
        now = time.monotonic()
        if self.state.heard and now - self._asked_s >= _ASK_EVERY_S:
            self._ask()
            self._asked_s = now
        self._socket.settimeout(wait_s)
        try:
            data = self._socket.recv(65536)
        except TimeoutError:
            return self.state
        if not data:
            raise ConnectionResetError("the vehicle closed the connection")
        for message in self._decoder.feed(data):
            self._take(message)
        return self.state

    def close(self) -> None:
        """Hang up."""
        self._socket.close()

    def _ask(self) -> None:
        for number in _WANTED:
            message = dialect.MAVLink_command_long_message(
                1, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, _INTERVAL_US, 0, 0, 0, 0, 0
            )
            self._socket.sendall(self._encoder.message(message))

    def _take(self, message: dialect.MAVLink_message) -> None:
        kind, state = message.get_type(), self.state
        if kind == "HEARTBEAT":
            state.heard = True
        elif kind == "SYS_STATUS":
            bit = dialect.MAV_SYS_STATUS_PREARM_CHECK
            state.checks_pass = bool(message.onboard_control_sensors_health & bit)
        elif kind == "EKF_STATUS_REPORT":
            flags = message.flags
            state.has_position = flags & _HAS_POSITION == _HAS_POSITION and not flags & dialect.EKF_CONST_POS_MODE
        elif kind == "STATUSTEXT":
            state.texts.append(str(message.text))
