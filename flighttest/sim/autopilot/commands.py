"""COMMAND_LONG and COMMAND_INT, each with the result ArduCopter answers."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.autopilot import modes, telemetry
from flighttest.sim.autopilot.navigation import GuidedGoal
from flighttest.sim.autopilot.vehicle import CommandedVehicle

ACCEPTED, TEMPORARILY, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
_FORCE = 21196
_EVERY_FENCE = 15


def acknowledge(v: CommandedVehicle, message: Any, command: int, result: int) -> None:
    """COMMAND_ACK to the sender of the message."""
    sender = (message.get_srcSystem(), message.get_srcComponent())
    v.outbox.append(v.encoder.message(dialect.MAVLink_command_ack_message(command, result, 0, 0, *sender)))


def handle(v: CommandedVehicle, m: Any) -> None:
    """Do what is asked, and acknowledge it. Messages that it causes come after that, as ArduPilot's queues have it."""
    if m.target_component not in (0, v.encoder.component):
        return
    action = _ACTIONS.get(m.command)
    before = len(v.outbox)
    result = UNSUPPORTED if action is None else action(v, m)
    caused = v.outbox[before:]
    del v.outbox[before:]
    if m.command == dialect.MAV_CMD_GET_HOME_POSITION:  # the one that answers first
        v.outbox += caused
        caused = []
    acknowledge(v, m, m.command, result)
    v.outbox += caused


def _place(m: Any) -> tuple[float, float, float]:
    """param5..7 as latitude and longitude, degE7, and altitude, m: COMMAND_INT has them in x, y, z."""
    if m.get_type() == "COMMAND_INT":
        return m.x, m.y, m.z
    return m.param5 * 1e7, m.param6 * 1e7, m.param7


def _altitude(m: Any) -> float:
    return float(m.z if m.get_type() == "COMMAND_INT" else m.param7)


def _arm(v: CommandedVehicle, m: Any) -> int:
    force = round(m.param2) == _FORCE
    if m.param1 not in (0.0, 1.0):
        return UNSUPPORTED
    return ACCEPTED if (v.arm(force=force) if m.param1 else v.disarm(force=force)) else FAILED


def _mode(v: CommandedVehicle, m: Any) -> int:
    if not int(m.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return DENIED
    return ACCEPTED if v.set_mode(int(m.param2)) else FAILED


def _mode_command(mode: int) -> Any:
    def action(v: CommandedVehicle, _: Any) -> int:
        return ACCEPTED if v.set_mode(mode) else FAILED

    return action


def _set_interval(v: CommandedVehicle, m: Any) -> int:
    message_id, interval_us = int(m.param1), m.param2
    if message_id not in telemetry.MAKERS:
        v.say(f"No ap_message for mavlink id ({message_id})")
        return DENIED
    if interval_us > 0.0 and 1e6 / interval_us > telemetry.RATE_MAX_HZ * 1.001:
        v.say(f"Requested rate for message ID {message_id} too fast. Increase SCHED_LOOP_RATE")
        return DENIED
    # 0 is the default rate, which is none: nothing is streamed unasked
    v.streams.set(message_id, interval_us * 1e-6 if interval_us > 0.0 else 0.0, v.time_s)
    return ACCEPTED


def _get_interval(v: CommandedVehicle, m: Any) -> int:
    message_id = int(m.param1)
    known = message_id in telemetry.MAKERS
    interval = (round(v.streams.interval_s(message_id) * 1e6) or -1) if known else 0
    v.outbox.append(v.encoder.message(dialect.MAVLink_message_interval_message(message_id, interval)))
    return ACCEPTED


def _request(v: CommandedVehicle, m: Any) -> int:
    if int(m.param1) not in telemetry.MAKERS:
        return FAILED
    _send(v, int(m.param1))
    return ACCEPTED


def _send(v: CommandedVehicle, message_id: int) -> None:
    frame = telemetry.MAKERS[message_id](v)
    if frame is not None:
        v.outbox.append(frame)


def _capabilities(v: CommandedVehicle, _: Any) -> int:
    _send(v, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    return ACCEPTED


def _take_off(v: CommandedVehicle, m: Any) -> int:
    height = _altitude(m)
    if not v.armed or not v.landed or not math.isfinite(height) or height <= 0.0:
        return FAILED
    if v.mode == modes.GUIDED_NOGPS:
        return ACCEPTED  # flown: accepted, and without effect
    if v.mode != modes.GUIDED or not v.has_position:
        return FAILED
    seen = v.measured()
    v.navigator.goal = GuidedGoal(position=(seen.px, seen.py), height=height, yaw=seen.yaw, stamp_s=v.time_s)
    v.navigator.take_off_m = height
    v.angle.chosen = False
    return ACCEPTED


def _turn(v: CommandedVehicle, m: Any) -> int:
    if v.mode != modes.GUIDED:
        return FAILED
    angle = math.radians(m.param1)
    relative = v.motion.yaw - angle * (1.0 if m.param3 >= 0 else -1.0)  # param3: 1 clockwise
    yaw = relative if m.param4 else -angle
    v.navigator.goal.yaw, v.navigator.goal.yaw_rate = math.remainder(yaw, math.tau), None
    return ACCEPTED


def _speed(v: CommandedVehicle, m: Any) -> int:
    name = {0: "WP_SPD", 1: "WP_SPD", 2: "WP_SPD_UP", 3: "WP_SPD_DN"}.get(int(m.param1))
    if name is None or not m.param2 > 0.0:
        return FAILED
    v.store.set(name, m.param2)
    return ACCEPTED


def _reposition(v: CommandedVehicle, m: Any) -> int:
    if v.mode != modes.GUIDED and not (int(m.param2) & 1 and v.set_mode(modes.GUIDED)):
        return DENIED
    lat, lon, altitude = _place(m)
    frame = getattr(m, "frame", dialect.MAV_FRAME_GLOBAL)
    relative = (dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
    height = altitude if frame in relative else altitude - telemetry.HOME_ALT_M
    yaw = v.navigator.goal.yaw
    v.navigator.goal = GuidedGoal(telemetry.local_of(int(lat), int(lon)), None, height, yaw=yaw, stamp_s=v.time_s)
    v.navigator.take_off_m = None
    v.angle.chosen = False
    return ACCEPTED


def _battery_reset(v: CommandedVehicle, _: Any) -> int:
    v.replace_battery()
    return ACCEPTED


def _home(v: CommandedVehicle, _: Any) -> int:
    if not v.has_home:
        return FAILED
    _send(v, dialect.MAVLINK_MSG_ID_HOME_POSITION)
    _send(v, dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
    return ACCEPTED


def _denied(_: CommandedVehicle, __: Any) -> int:
    return DENIED


def _fence_enable(v: CommandedVehicle, m: Any) -> int:
    kinds = int(m.param2) or _EVERY_FENCE
    if m.param1 not in (0.0, 1.0) or (m.param1 and not kinds & int(v.store["FENCE_TYPE"])):
        return FAILED
    v.fence.switch(bool(m.param1), kinds)
    return ACCEPTED


_ACTIONS: dict[int, Any] = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    dialect.MAV_CMD_DO_SET_MODE: _mode,
    dialect.MAV_CMD_NAV_LAND: _mode_command(modes.LAND),
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _mode_command(modes.RTL),
    dialect.MAV_CMD_NAV_LOITER_UNLIM: _mode_command(modes.LOITER),
    dialect.MAV_CMD_NAV_TAKEOFF: _take_off,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    dialect.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    dialect.MAV_CMD_REQUEST_MESSAGE: _request,
    dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _capabilities,
    dialect.MAV_CMD_CONDITION_YAW: _turn,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_DO_REPOSITION: _reposition,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION: _denied,
    dialect.MAV_CMD_BATTERY_RESET: _battery_reset,
    dialect.MAV_CMD_GET_HOME_POSITION: _home,
    dialect.MAV_CMD_DO_FENCE_ENABLE: _fence_enable,
}
