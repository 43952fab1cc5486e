"""What the vehicle does with each message it is sent: parameters, commands, targets, the fence, mission stubs, time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.autopilot import commands, modes, telemetry
from flighttest.sim.autopilot.fences.upload import KIND
from flighttest.sim.autopilot.guided import accept
from flighttest.sim.autopilot.navigation import GuidedGoal
from flighttest.sim.autopilot.vehicle import CommandedVehicle

_NO_INDEX = 0xFFFF


class Mailbox:
    """Handlers by message name. lockstep_asked, speed_asked: what SIM_ parameters request of the simulation's server; None: nothing."""

    def __init__(self, vehicle: CommandedVehicle) -> None:
        self._v = vehicle
        self._confessed = False
        self.lockstep_asked: bool | None = None
        self.speed_asked: float | None = None
        self._handlers: dict[str, Callable[[Any], None]] = {
            "SET_ATTITUDE_TARGET": self._attitude_target,
            "TIMESYNC": self._timesync,
            "SETUP_SIGNING": self._setup_signing,
            "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_SET": self._parameter_set,
            "SET_MODE": self._set_mode,
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "SET_POSITION_TARGET_LOCAL_NED": self._local_target,
            "SET_POSITION_TARGET_GLOBAL_INT": self._global_target,
            "REQUEST_DATA_STREAM": self._data_stream,
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_REQUEST_INT": self._mission_request,
            "MISSION_REQUEST": self._mission_request,
            "MISSION_COUNT": self._mission_count,
            "MISSION_ITEM_INT": self._mission_item,
            "MISSION_CLEAR_ALL": self._mission_clear,
            "LOG_REQUEST_LIST": self._log_list,
        }

    def receive(self, message: Any) -> None:
        """Handle one message; those for other systems, and unknown ones are ignored."""
        if not self._v.encoder.signing.takes(message):
            return
        handler = self._handlers.get(message.get_type())
        if handler is None:
            return
        wanted = getattr(message, "target_system", 0)
        if wanted not in (0, self._v.encoder.system):
            return
        handler(message)

    # -- targets -------------------------------------------------------------------------------------------------------------

    def _attitude_target(self, m: Any) -> None:
        v = self._v
        if v.mode not in modes.ATTITUDE_TARGETS:
            return
        target = accept(m.type_mask, m.q, (m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate), m.thrust)
        if target is None:
            return
        if not v.angle.chosen:
            v.angle.chosen = True
            v.angle.start(v.time_s, v.motion.yaw)
            # At once: the throttle of before was a step's, and is not flown for the delay of this one.
            v.angle.thrust = target.thrust
        if not math.isfinite(m.thrust) and not self._confessed:
            self._confessed = True
            v.say("Internal Errors 0x400", dialect.MAV_SEVERITY_CRITICAL)
        v.angle.receive(v.time_s, target)

    def _local_target(self, m: Any) -> None:
        v = self._v
        if v.mode != modes.GUIDED or not v.has_position:
            return
        frame = m.coordinate_frame
        if frame not in (
            dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_LOCAL_OFFSET_NED, dialect.MAV_FRAME_BODY_NED, dialect.MAV_FRAME_BODY_OFFSET_NED,
        ):  # fmt: skip
            return
        px, py, pz, vx, vy, vz = m.x, -m.y, -m.z, m.vx, -m.vy, -m.vz
        if frame in (dialect.MAV_FRAME_BODY_NED, dialect.MAV_FRAME_BODY_OFFSET_NED):
            c, s = math.cos(v.motion.yaw), math.sin(v.motion.yaw)
            px, py, vx, vy = c * px - s * py, s * px + c * py, c * vx - s * vy, s * vx + c * vy
        if frame != dialect.MAV_FRAME_LOCAL_NED:
            seen = v.measured()
            px, py, pz = px + seen.px, py + seen.py, pz + seen.pz
        self._goal(m, (px, py), pz, (vx, vy), vz)

    def _global_target(self, m: Any) -> None:
        v = self._v
        if v.mode != modes.GUIDED or not v.has_position:
            return
        place = telemetry.local_of(m.lat_int, m.lon_int)
        relative = (dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
        height = m.alt if m.coordinate_frame in relative else m.alt - telemetry.HOME_ALT_M
        self._goal(m, place, height, (m.vx, -m.vy), -m.vz)

    def _goal(
        self, m: Any, place: tuple[float, float], height: float, velocity: tuple[float, float], climb: float
    ) -> None:
        v, mask = self._v, m.type_mask
        no_position, no_velocity, no_acceleration = (mask & 7) == 7, (mask & 56) == 56, (mask & 448) == 448
        if no_position and no_velocity and no_acceleration:
            return
        if no_position and no_velocity:
            return  # acceleration alone is not flown here
        goal = GuidedGoal(stamp_s=v.time_s)
        goal.position = None if no_position else place
        goal.height = None if no_position else height
        if not no_velocity:
            goal.velocity, goal.climb = velocity, climb
        old = v.navigator.goal
        goal.yaw = old.yaw if mask & 1024 else -m.yaw
        goal.yaw_rate = None if mask & 2048 else -m.yaw_rate
        if not mask & 1024:
            goal.yaw_rate = None
        v.navigator.goal = goal
        v.navigator.take_off_m = None
        self._v.angle.chosen = False

    # -- parameters ----------------------------------------------------------------------------------------------------------

    def _send_parameter(self, name: str, index: int) -> None:
        v = self._v
        v.outbox.append(
            v.encoder.message(
                dialect.MAVLink_param_value_message(
                    name.encode(), v.store[name], v.store.kind(name), len(v.store), index
                )
            )
        )

    def _parameter_read(self, m: Any) -> None:
        name = m.param_id.rstrip("\0") if m.param_index < 0 else self._v.store.name_at(m.param_index)
        if name is not None and name in self._v.store:
            self._send_parameter(name, m.param_index if m.param_index >= 0 else _NO_INDEX)

    def _parameter_list(self, _: Any) -> None:
        self._v.say("ArduCopter V4.7.0-dev (simulate)")
        self._v.say("Frame: QUAD/X")
        for i, name in enumerate(self._v.store):
            self._send_parameter(name, i)

    def _parameter_set(self, m: Any) -> None:
        v, name = self._v, m.param_id.rstrip("\0")
        if name not in v.store or not math.isfinite(m.param_value):
            return
        value = v.store.set(name, m.param_value)
        self._send_parameter(name, _NO_INDEX)
        if name in ("INS_ACCEL_FILTER", "INS_GYRO_FILTER"):
            v.sensors.set_filters(v.store["INS_ACCEL_FILTER"], v.store["INS_GYRO_FILTER"])
        elif name == "SIM_LOCKSTEP":
            self.lockstep_asked = bool(value)
        elif name == "SIM_SPEEDUP":
            self.speed_asked = max(value, 0.01)
        elif name == "SIM_BATT_VOLTAGE":
            v.replace_battery(value)
        elif name == "SIM_PILOT_MODE" and value >= 0:
            v.set_mode(int(value))

    # -- commands and the rest -----------------------------------------------------------------------------------------------

    def _set_mode(self, m: Any) -> None:
        self._v.set_mode(m.custom_mode)  # flown: acknowledged by nothing but the HEARTBEAT

    def _command(self, m: Any) -> None:
        commands.handle(self._v, m)

    def _timesync(self, m: Any) -> None:
        if m.tc1 == 0:
            v = self._v
            now = int(v.time_s * 1e9)
            v.outbox.append(v.encoder.message(dialect.MAVLink_timesync_message(now, m.ts1)))

    def _setup_signing(self, m: Any) -> None:
        if not self._v.armed:
            self._v.encoder.signing.set(bytes(m.secret_key), m.initial_timestamp)

    def _data_stream(self, m: Any) -> None:
        v = self._v
        interval = 1.0 / m.req_message_rate if m.start_stop and m.req_message_rate > 0 else 0.0
        for i in _STREAM_GROUPS.get(m.req_stream_id, ()):
            v.streams.set(i, max(interval, v.plant.tick_s) if interval else 0.0, v.time_s)

    def _mission_request(self, m: Any) -> None:
        if m.mission_type == KIND:
            self._v.fence.wanted(m)

    def _mission_count(self, m: Any) -> None:
        if m.mission_type == KIND:
            self._v.fence.count(m)

    def _mission_item(self, m: Any) -> None:
        if m.mission_type == KIND:
            self._v.fence.item(m)

    def _mission_list(self, m: Any) -> None:
        v = self._v
        kind = getattr(m, "mission_type", 0)
        if kind == KIND:
            v.fence.listed(m)
            return
        sender = (m.get_srcSystem(), m.get_srcComponent())
        v.outbox.append(v.encoder.message(dialect.MAVLink_mission_count_message(*sender, int(v.has_home), kind)))

    def _mission_clear(self, m: Any) -> None:
        v = self._v
        kind = getattr(m, "mission_type", 0)
        if kind == KIND:
            v.fence.clear(m)
            return
        sender = (m.get_srcSystem(), m.get_srcComponent())
        v.outbox.append(v.encoder.message(dialect.MAVLink_mission_ack_message(*sender, 0, kind)))

    def _log_list(self, _: Any) -> None:
        v = self._v
        v.outbox.append(v.encoder.message(dialect.MAVLink_log_entry_message(0, 0, 0, 0, 0)))


_RAW = (dialect.MAVLINK_MSG_ID_RAW_IMU, dialect.MAVLINK_MSG_ID_SCALED_IMU2)
_STATUS = (
    dialect.MAVLINK_MSG_ID_SYS_STATUS, dialect.MAVLINK_MSG_ID_POWER_STATUS, dialect.MAVLINK_MSG_ID_GPS_RAW_INT,
)  # fmt: skip
_EXTRA_3 = (
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME, dialect.MAVLINK_MSG_ID_BATTERY_STATUS, dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
)  # fmt: skip
_POSITION = (dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
# REQUEST_DATA_STREAM's groups, as GCS_MAVLink_Copter.cpp fills them
_STREAM_GROUPS: dict[int, tuple[int, ...]] = {
    1: _RAW,
    2: _STATUS,
    3: (dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, dialect.MAVLINK_MSG_ID_RC_CHANNELS),
    6: _POSITION,
    10: (dialect.MAVLINK_MSG_ID_ATTITUDE,),
    11: (dialect.MAVLINK_MSG_ID_VFR_HUD,),
    12: _EXTRA_3,
}
_STREAM_GROUPS[0] = tuple(i for group in _STREAM_GROUPS.values() for i in group)
