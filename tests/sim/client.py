"""A bare pymavlink client of the built-in vehicle, in one process with it: no link, no codec of ours."""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim import InProcess, SimOptions

QUIET = {"noise": 0.0, "ready_s": 0.5, "gps_s": 0.6}


class Client:
    """Sends messages and collects what comes back, by name; `texts` are the STATUSTEXTs with their vehicle time."""

    def __init__(self, **options: Any) -> None:
        self.io = InProcess(SimOptions(**options))
        self.vehicle = self.io.vehicle
        self.motion = self.io.vehicle.motion
        self._mav = dialect.MAVLink(None, srcSystem=245, srcComponent=190)
        self._parser = dialect.MAVLink(None)
        self.got: dict[str, list[Any]] = {}
        self.texts: list[str] = []
        self.poll()

    def poll(self) -> None:
        for m in self._parser.parse_buffer(self.io.receive()) or []:
            self.got.setdefault(m.get_type(), []).append(m)
            if m.get_type() == "STATUSTEXT":
                if m.chunk_seq:
                    self.texts[-1] += m.text
                else:
                    self.texts.append(m.text)

    def last(self, name: str) -> Any:
        return self.got[name][-1]

    def send(self, message: Any) -> None:
        self.io.send(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) & 0xFF
        self.poll()

    def run(self, seconds: float, each: Any = None) -> None:
        """Let time pass in steps of 20 ms, calling `each` before every one."""
        for _ in range(round(seconds / 0.02)):
            if each is not None:
                each()
            self.io.advance(0.02)
            self.poll()

    def command(self, number: int, *params: float) -> int:
        padded = [*params, *([0.0] * (7 - len(params)))]
        self.send(dialect.MAVLink_command_long_message(1, 1, number, 0, *padded))
        ack = self.last("COMMAND_ACK")
        assert ack.command == number
        return int(ack.result)

    def mode(self, number: int) -> int:
        return self.command(dialect.MAV_CMD_DO_SET_MODE, 1, number)

    def set(self, name: str, value: float) -> float | None:
        """The value echoed, or None where the vehicle keeps silent."""
        before = len(self.got.get("PARAM_VALUE", ()))
        self.send(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        values = self.got.get("PARAM_VALUE", [])
        return float(values[-1].param_value) if len(values) > before else None

    def target(
        self, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, throttle: float = 0.2, mask: int = 7,
        yaw_rate: float = 0.0, size: float = 1.0,
    ) -> None:  # fmt: skip
        """SET_ATTITUDE_TARGET, angles NWU/FLU."""
        r, p, y = 0.5 * roll, -0.5 * pitch, -0.5 * yaw
        cr, sr, cp, sp, cy, sy = math.cos(r), math.sin(r), math.cos(p), math.sin(p), math.cos(y), math.sin(y)
        q = [
            cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy,
        ]  # fmt: skip
        q = [size * v for v in q]
        self.send(dialect.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0.0, 0.0, -yaw_rate, throttle))

    def airborne(self, height: float = 6.0) -> float:
        """Arm in GUIDED, climb, settle, enter GUIDED_NOGPS with thrust as thrust; returns the hover throttle."""
        self.run(1.0)
        assert self.set("GUID_OPTIONS", 8) == 8
        assert self.mode(4) == 0
        assert self.command(400, 1) == 0, self.texts
        assert self.command(22, 0, 0, 0, 0, 0, 0, height) == 0
        self.run(12.0)
        assert abs(self.motion.pz - height) < 0.3
        hover = self.vehicle.command.throttle
        assert self.mode(20) == 0
        return hover
