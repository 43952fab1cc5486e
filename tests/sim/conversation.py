"""One scripted conversation of a ground station with a copter, word by word, on any vehicle: what it answers is a list of plain lines.

    python -m tests.sim.conversation URL [FILE]     hold it with a vehicle at tcp:HOST:PORT, just booted; write the answers as JSON

No link and no codec of ours: pymavlink's dialect and a socket.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from tests.sim.ground import Ground, Socket, Wire

ASKED = {
    "ATTITUDE": 50, "ATTITUDE_TARGET": 50, "LOCAL_POSITION_NED": 50, "EXTENDED_SYS_STATE": 10, "HEARTBEAT": 10,
}  # fmt: skip
GUIDED, LOITER, LAND, BRAKE, THROW, NOGPS = 4, 5, 9, 17, 18, 20


def _params(g: Ground) -> None:
    for name in (b"GUID_TIMEOUT", b"ATC_ANGLE_MAX", b"ANGLE_MAX", b"MAV_GCS_SYSID", b"SYSID_MYGCS", b"NO_SUCH_NAME"):
        g.send(dialect.MAVLink_param_request_read_message(1, 1, name, -1))
        g.run(0.4)
    g.send(dialect.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 8, 6))
    g.run(0.4)
    g.send(dialect.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 99, 9))
    g.run(0.4)
    g.send(dialect.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 3, 9))
    g.run(0.4)
    g.send(dialect.MAVLink_param_set_message(1, 1, b"NO_SUCH_NAME", 1, 9))
    g.run(0.4)


def _parameter_list(g: Ground) -> None:
    before = len(g.lines)
    g.send(dialect.MAVLink_param_request_list_message(1, 1))
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
        number = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
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
        g.command(511, getattr(dialect, f"MAVLINK_MSG_ID_{name}"), 1e6 / rate)
    g.lines[:] = found


def _services(g: Ground) -> None:
    g.run(max(25.0 - g.now_s, 0.0))
    g.take()
    g.send(dialect.MAVLink_timesync_message(0, 12345))
    got = g.until(lambda m: m.get_type() == "TIMESYNC" and m.ts1 == 12345, 1.0)
    g.lines.append(f"TIMESYNC answered {got is not None and got.tc1 != 0}")
    g.send(dialect.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    got = g.until(lambda m: m.get_type() == "LOG_ENTRY", 2.0)
    g.lines.append(f"LOG_ENTRY num_logs {got.num_logs} last {got.last_log_num} id {got.id}" if got else "no LOG_ENTRY")
    g.send(dialect.MAVLink_mission_request_list_message(1, 1, 0))
    got = g.until(lambda m: m.get_type() == "MISSION_COUNT", 1.0)
    g.lines.append(f"MISSION_COUNT {got.count}" if got else "no MISSION_COUNT")
    g.send(dialect.MAVLink_ping_message(77, 5, 0, 0))
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
    g.send(dialect.MAVLink_set_mode_message(1, 1, NOGPS))
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
        g.send(dialect.MAVLink_param_set_message(1, 1, name, value, 9))
        g.run(0.2)
    g.run(0.5)
    g.take()
    g.command(176, 1, NOGPS)
    end = g.now_s + 6.0
    while g.now_s < end and g.last["HEARTBEAT"].custom_mode == NOGPS:
        g.run(0.02, lambda: g.target(0.0, 1.25 * hover))
    g.run(2.0)
    g.send(dialect.MAVLink_param_set_message(1, 1, b"FENCE_ENABLE", 0, 2))
    g.run(0.5)
    g.lines[:] = [x for x in g.lines if not x.startswith("PARAM_VALUE")]


def _land(g: Ground) -> None:
    g.command(176, 1, LAND)
    g.until(lambda m: m.get_type() == "HEARTBEAT" and not m.base_mode & 128, 90.0)
    g.run(1.0)
    g.send(dialect.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
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
        g.command(511, getattr(dialect, f"MAVLINK_MSG_ID_{name}"), 20000.0)
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
