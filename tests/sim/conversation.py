"""One scripted conversation of a ground station with a copter, word by word, on any vehicle: what it answers is a list of plain lines.

    python tests/sim/conversation.py URL [FILE]     hold it with a vehicle at tcp:HOST:PORT, just booted; write the answers as JSON

No link and no codec of ours: pymavlink's dialect and a socket.
"""

from __future__ import annotations

import json
import math
import socket
import sys
import time
from collections.abc import Callable
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as book

STREAMS = {"HEARTBEAT", "ATTITUDE", "ATTITUDE_TARGET", "LOCAL_POSITION_NED", "SYSTEM_TIME", "EXTENDED_SYS_STATE"}
ASKED = {
    "ATTITUDE": 50, "ATTITUDE_TARGET": 50, "LOCAL_POSITION_NED": 50, "EXTENDED_SYS_STATE": 10, "HEARTBEAT": 10,
}  # fmt: skip
GUIDED, LOITER, LAND, BRAKE, THROW, NOGPS = 4, 5, 9, 17, 18, 20


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
        self._mav = book.MAVLink(None, srcSystem=250, srcComponent=190)
        self._parser = book.MAVLink(None)
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
        self.send(book.MAVLink_command_long_message(1, 1, number, 0, *padded))
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
        self.send(book.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0.0, 0.0, yaw_rate, throttle))

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


def _params(g: Ground) -> None:
    for name in (b"GUID_TIMEOUT", b"ATC_ANGLE_MAX", b"ANGLE_MAX", b"MAV_GCS_SYSID", b"SYSID_MYGCS", b"NO_SUCH_NAME"):
        g.send(book.MAVLink_param_request_read_message(1, 1, name, -1))
        g.run(0.4)
    g.send(book.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 8, 6))
    g.run(0.4)
    g.send(book.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 99, 9))
    g.run(0.4)
    g.send(book.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 3, 9))
    g.run(0.4)
    g.send(book.MAVLink_param_set_message(1, 1, b"NO_SUCH_NAME", 1, 9))
    g.run(0.4)


def _parameter_list(g: Ground) -> None:
    before = len(g.lines)
    g.send(book.MAVLink_param_request_list_message(1, 1))
    seen: set[int] = set()

    def all_there(m: Any) -> bool:
        if m.get_type() == "PARAM_VALUE" and m.param_index != 0xFFFF:
            seen.add(m.param_index)
        return m.get_type() == "PARAM_VALUE" and len(seen) == m.param_count

    complete = g.until(all_there, 20.0) is not None
    texts = [x for x in g.lines[before:] if x.startswith(("STATUSTEXT 6 ArduCopter", "STATUSTEXT 6 Frame"))]
    g.lines[before:] = [*texts, f"every index once {complete}"]


def _intervals(g: Ground) -> None:
    found: list[str] = []

    def ask(what: str, command: int, *params: float) -> None:
        g.take()
        g.command(command, *params)
        g.run(0.1)
        found.append(f"{what}: " + "; ".join(x for x in g.take() if x.startswith(("COMMAND_ACK", "STATUSTEXT"))))

    for name in (
        "SYS_STATUS", "GPS_RAW_INT", "RAW_IMU", "SCALED_PRESSURE", "GLOBAL_POSITION_INT", "SERVO_OUTPUT_RAW",
        "NAV_CONTROLLER_OUTPUT", "RC_CHANNELS", "VFR_HUD", "POSITION_TARGET_LOCAL_NED", "HIGHRES_IMU", "SCALED_IMU2",
        "BATTERY_STATUS", "AUTOPILOT_VERSION", "FENCE_STATUS", "WIND", "RANGEFINDER", "EKF_STATUS_REPORT", "VIBRATION",
        "HOME_POSITION", "SYSTEM_TIME", "ODOMETRY", "DISTANCE_SENSOR", "ATTITUDE_QUATERNION", "ALTITUDE",
    ):  # fmt: skip
        number = getattr(book, f"MAVLINK_MSG_ID_{name}")
        ask(f"{name} at 2 Hz", 511, number, 500000.0)
        g.command(511, number, -1.0)
    ask("ATTITUDE at 400 Hz", 511, 30, 2500.0)
    ask("ATTITUDE at 50 Hz", 511, 30, 20000.0)
    ask("GET_MESSAGE_INTERVAL ATTITUDE", 510, 30)
    message = g.last["MESSAGE_INTERVAL"]
    found.append(f"MESSAGE_INTERVAL {message.message_id} {message.interval_us}")
    before = g.last.get("AUTOPILOT_VERSION")
    ask("REQUEST_MESSAGE AUTOPILOT_VERSION", 512, 148)
    found.append(f"AUTOPILOT_VERSION came {g.last.get('AUTOPILOT_VERSION') is not before}")
    ask("REQUEST_MESSAGE ODOMETRY", 512, 331)
    for name, rate in ASKED.items():
        g.command(511, getattr(book, f"MAVLINK_MSG_ID_{name}"), 1e6 / rate)
    g.lines[:] = found


def _services(g: Ground) -> None:
    g.run(max(25.0 - g.now_s, 0.0))
    g.take()
    g.send(book.MAVLink_timesync_message(0, 12345))
    got = g.until(lambda m: m.get_type() == "TIMESYNC" and m.ts1 == 12345, 1.0)
    g.lines.append(f"TIMESYNC answered {got is not None and got.tc1 != 0}")
    g.send(book.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    got = g.until(lambda m: m.get_type() == "LOG_ENTRY", 2.0)
    g.lines.append(f"LOG_ENTRY num_logs {got.num_logs} last {got.last_log_num} id {got.id}" if got else "no LOG_ENTRY")
    g.send(book.MAVLink_mission_request_list_message(1, 1, 0))
    got = g.until(lambda m: m.get_type() == "MISSION_COUNT", 1.0)
    g.lines.append(f"MISSION_COUNT {got.count}" if got else "no MISSION_COUNT")
    g.send(book.MAVLink_ping_message(77, 5, 0, 0))
    got = g.until(lambda m: m.get_type() == "PING", 1.0)
    g.lines.append(f"PING seq {got.seq}" if got else "no PING")
    g.lines[:] = [x for x in g.lines if x not in ("LOG_ENTRY", "MISSION_COUNT", "PING")]


def _odd_commands(g: Ground) -> None:
    for number, params in (
        (31999, ()), (400, (0.5,)), (22, (0, 0, 0, 0, 0, 0, 5.0)), (176, (1, 99)), (176, (0, 4)), (176, (1, THROW)), (519, (1,)),
        (520, (1,)), (410, ()), (176, (1, LAND)), (400, (1,)),
    ):  # fmt: skip
        g.command(number, *params)
        g.run(0.3)


def _mode_message(g: Ground) -> None:
    g.send(book.MAVLink_set_mode_message(1, 1, NOGPS))
    g.run(1.0)


def _arm_until(g: Ground, mode: int, patience_s: float) -> None:
    """Ask once a second; the refusals in the order in which they first came, then the acceptance."""
    g.command(176, 1, mode)
    g.run(0.5)
    g.take()
    seen: list[str] = []
    end = g.now_s + patience_s
    accepted = False
    while g.now_s < end and not accepted:
        g.command(400, 1)
        g.run(1.0)
        for line in g.take():
            if line.startswith("EXTENDED") or "EKF" in line or line == "TIMESYNC":
                continue
            accepted = accepted or line.startswith("COMMAND_ACK 400 result 0")
            if line not in seen:
                seen.append(line)
    g.lines = seen


def _rise(g: Ground) -> None:
    g.command(22, 0, 0, 0, 0, 0, 0, 8.0)
    g.run(14.0)
    g.lines.append(f"height within 0.5 m {abs(-g.last['LOCAL_POSITION_NED'].z - 8.0) < 0.5}")


def _in_the_air(g: Ground) -> None:
    g.command(400, 0)
    g.command(400, 1)
    g.command(22, 0, 0, 0, 0, 0, 0, 8.0)
    g.run(5.0)


def _roll(g: Ground) -> float:
    return float(g.last["ATTITUDE"].roll)


def _targets(g: Ground) -> None:
    hover = g.hover()
    g.command(176, 1, NOGPS)

    def tell(what: str) -> None:
        g.lines.append(f"{what}: {'followed' if abs(_roll(g)) > 0.15 else 'not followed'}")

    g.run(0.6, lambda: g.target(0.2))
    tell("attitude target 0.2 rad for 0.6 s")
    for name, change in (
        ("mask 64", {"mask": 64 | 7}), ("mixed rate bits", {"mask": 1}), ("|q| 1.01", {"size": 1.01}),
        ("NaN thrust", {"throttle": math.nan}),
    ):  # fmt: skip
        g.run(1.5, g.target)
        g.run(0.6, lambda change=change: g.target(0.2, **change))  # type: ignore[misc]
        tell(f"{name}, 0.2 rad for 0.6 s")
    g.run(1.5, g.target)
    g.run(0.5, lambda: g.target(0.2, 1.02 * hover))
    began = g.now_s
    for at_s in (1.0, 2.0, 2.8):
        g.run(began + at_s - g.now_s)
        held = abs(g.last["ATTITUDE_TARGET"].thrust / hover - 1.02) < 0.01
        g.lines.append(f"silent for {at_s:g} s: roll {abs(round(_roll(g), 1)):.1f}, thrust held {held}")
    g.run(1.2)
    g.lines.append(f"silent for 4 s: roll {abs(round(_roll(g), 1)):.1f}, mode {g.last['HEARTBEAT'].custom_mode}")
    g.run(0.5, lambda: g.target(-0.2))
    tell("alive again, -0.2 rad for 0.5 s")
    g.run(1.5, g.target)
    g.command(22, 0, 0, 0, 0, 0, 0, 5.0)
    g.run(0.5, g.target)
    g.command(176, 1, BRAKE)
    g.run(3.0)
    g.command(176, 1, GUIDED)
    g.run(0.6, lambda: g.target(0.2))
    tell("attitude target in GUIDED")
    g.command(176, 1, LOITER)
    g.run(1.5, lambda: g.target(0.2))
    tell("attitude target in LOITER")
    g.command(176, 1, BRAKE)
    g.run(4.0)


def _fence(g: Ground) -> None:
    hover = g.hover()
    ceiling = -g.last["LOCAL_POSITION_NED"].z + 4.0
    for name, value in ((b"FENCE_TYPE", 1), (b"FENCE_ACTION", 4), (b"FENCE_ALT_MAX", ceiling), (b"FENCE_ENABLE", 1)):
        g.send(book.MAVLink_param_set_message(1, 1, name, value, 9))
        g.run(0.2)
    g.run(0.5)
    g.take()
    g.command(176, 1, NOGPS)
    end = g.now_s + 6.0
    while g.now_s < end and g.last["HEARTBEAT"].custom_mode == NOGPS:
        g.run(0.02, lambda: g.target(0.0, 1.25 * hover))
    g.run(2.0)
    g.send(book.MAVLink_param_set_message(1, 1, b"FENCE_ENABLE", 0, 2))
    g.run(0.5)
    g.lines[:] = [x for x in g.lines if not x.startswith("PARAM_VALUE")]


def _land(g: Ground) -> None:
    g.command(176, 1, LAND)
    g.until(lambda m: m.get_type() == "HEARTBEAT" and not m.base_mode & 128, 90.0)
    g.run(1.0)
    g.send(book.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    got = g.until(lambda m: m.get_type() == "LOG_ENTRY", 2.0)
    g.lines.append(f"LOG_ENTRY num_logs {got.num_logs}" if got else "no LOG_ENTRY")


STEPS: dict[str, Callable[[Ground], None]] = {
    "message intervals": _intervals,
    "parameters": _params,
    "parameter list": _parameter_list,
    "time, logs, mission, ping": _services,
    "odd commands on the ground": _odd_commands,
    "SET_MODE": _mode_message,
    "arming in GUIDED_NOGPS": lambda g: _arm_until(g, NOGPS, 40.0),
    "disarming": lambda g: g.command(400, 0),
    "arming in GUIDED": lambda g: _arm_until(g, GUIDED, 90.0),
    "take-off": _rise,
    "commands in the air": _in_the_air,
    "attitude targets": _targets,
    "fence": _fence,
    "landing": _land,
}


def hold(wire: Wire) -> dict[str, list[str]]:
    """Hold the conversation with a vehicle that has just booted, and give its answers step by step."""
    g = Ground(wire)
    beat = g.until(lambda m: m.get_type() == "HEARTBEAT", 10.0)
    assert beat is not None, "no heartbeat"
    found = {
        "first heartbeat": [
            f"type {beat.type} autopilot {beat.autopilot} base_mode {beat.base_mode} mode {beat.custom_mode}"
        ]
    }
    g.names.clear()
    g.run(5.0)
    found["unasked"] = sorted(g.names)
    g.take()
    for name in ("SYSTEM_TIME", "ATTITUDE"):
        g.command(511, getattr(book, f"MAVLINK_MSG_ID_{name}"), 20000.0)
    g.until(lambda m: m.get_type() == "ATTITUDE", 20.0)
    g.run(3.0)
    found["boot texts"] = [x for x in g.take() if x.startswith("STATUSTEXT")]
    for name, step in STEPS.items():
        g.take()
        step(g)
        found[name] = g.take()
    return found


if __name__ == "__main__":
    answers = json.dumps(hold(Socket(sys.argv[1])), indent=1)
    if len(sys.argv) > 2:
        with open(sys.argv[2], "w", encoding="utf-8") as file:
            file.write(answers + "\n")
    else:
        sys.stdout.write(answers + "\n")
