"""Messages the vehicle can be asked for, made from what its instruments read (NWU/FLU to NED/FRD, SI to MAVLink's units), and when each is
due: SET_MESSAGE_INTERVAL as ArduPilot grants it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.autopilot.modes import LAND
from flighttest.sim.autopilot.vehicle import TelemetrySource

RATE_MAX_HZ = 200.0
HOME_LAT_E7, HOME_LON_E7, HOME_ALT_M = -353632621, 1491652374, 584.09
_M_PER_LAT_E7 = 6378137.0 * math.pi / 180.0 * 1e-7
_M_PER_LON_E7 = _M_PER_LAT_E7 * math.cos(math.radians(HOME_LAT_E7 * 1e-7))
_U32, _U16 = 0xFFFFFFFF, 0xFFFF
FIRMWARE = (4 << 24) | (7 << 16) | (0 << 8) | 0  # 4.7.0-dev: what this facade was read from
_CAPABILITIES = (
    dialect.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)


def global_of(px: float, py: float) -> tuple[int, int]:
    """Latitude and longitude, degE7, of a place north and west of home, m."""
    return HOME_LAT_E7 + round(px / _M_PER_LAT_E7), HOME_LON_E7 - round(py / _M_PER_LON_E7)


def local_of(lat_e7: int, lon_e7: int) -> tuple[float, float]:
    """North and west of home, m, of a latitude and longitude, degE7."""
    return (lat_e7 - HOME_LAT_E7) * _M_PER_LAT_E7, (HOME_LON_E7 - lon_e7) * _M_PER_LON_E7


def _short(value: float, scale: float) -> int:
    return min(max(round(value * scale), -32768), 32767)


def _ms(v: TelemetrySource) -> int:
    return int(v.time_s * 1e3 + 1e-6) & _U32


def _us(v: TelemetrySource) -> int:
    return int(v.time_s * 1e6 + 0.5)


def _quaternion_ned(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """(w, x, y, z) FRD to NED of an NWU/FLU attitude."""
    r, p, y = 0.5 * roll, -0.5 * pitch, -0.5 * yaw
    cr, sr, cp, sp, cy, sy = math.cos(r), math.sin(r), math.cos(p), math.sin(p), math.cos(y), math.sin(y)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _wrapped(angle: float) -> float:
    return math.remainder(angle, math.tau)


def _attitude(v: TelemetrySource) -> bytes:
    roll, pitch, yaw = v.sensors.attitude(v.time_s)
    g = v.sensors.gyro
    return v.encoder.fields(dialect.MAVLink_attitude_message, _ms(v), roll, -pitch, -_wrapped(yaw), g.x, -g.y, -g.z)


def _attitude_quaternion(v: TelemetrySource) -> bytes:
    g = v.sensors.gyro
    q = _quaternion_ned(*v.sensors.attitude(v.time_s))
    message = dialect.MAVLink_attitude_quaternion_message(_ms(v), *q, g.x, -g.y, -g.z)
    return v.encoder.message(message)


def _attitude_target(v: TelemetrySource) -> bytes:
    t = v.target
    q = _quaternion_ned(t.roll, t.pitch, t.yaw)
    # wire order: time, q[4], rates, thrust, type_mask
    return v.encoder.fields(dialect.MAVLink_attitude_target_message, _ms(v), *q, 0.0, 0.0, -t.yaw_rate, t.throttle, 0)


def _highres_imu(v: TelemetrySource) -> bytes:
    a, g = v.sensors.accel, v.sensors.gyro
    height = v.sensors.pressure_height(v.time_s)
    altitude = HOME_ALT_M + height
    pressure = 1013.25 * (1.0 - 2.25577e-5 * altitude) ** 5.25588
    return v.encoder.fields(
        dialect.MAVLink_highres_imu_message,
        _us(v), a.x, -a.y, -a.z, g.x, -g.y, -g.z, 0.235, -0.037, -0.529, pressure, 0.0, altitude, 31.2, 0x1FFF, 0,
    )  # fmt: skip


def _milli_imu(kind: Any, stamp: Callable[[TelemetrySource], int]) -> Callable[[TelemetrySource], bytes]:
    def make(v: TelemetrySource) -> bytes:
        a, g = v.sensors.accel, v.sensors.gyro
        k = 1e3 / 9.80665
        return v.encoder.message(
            kind(
                stamp(v), _short(a.x, k), _short(-a.y, k), _short(-a.z, k),
                _short(g.x, 1e3), _short(-g.y, 1e3), _short(-g.z, 1e3), 235, -37, -529,
            )
        )  # fmt: skip

    return make


def _local_position(v: TelemetrySource) -> bytes | None:
    if not v.has_position:
        return None
    t = v.time_s
    px, py, pz = v.sensors.position(t)
    vx, vy, vz = v.sensors.velocity(t)
    return v.encoder.fields(dialect.MAVLink_local_position_ned_message, _ms(v), px, -py, -pz, vx, -vy, -vz)


def _global_position(v: TelemetrySource) -> bytes:
    t = v.time_s
    heading = round(math.degrees(-v.sensors.attitude(t)[2]) * 100.0) % 36000
    if not v.has_position:
        message = dialect.MAVLink_global_position_int_message(_ms(v), 0, 0, 0, 0, 0, 0, 0, heading)
        return v.encoder.message(message)
    px, py, pz = v.sensors.position(t)
    vx, vy, vz = v.sensors.velocity(t)
    lat, lon = global_of(px, py)
    return v.encoder.message(
        dialect.MAVLink_global_position_int_message(
            _ms(v), lat, lon, round((HOME_ALT_M + pz) * 1e3), round(pz * 1e3),
            _short(vx, 100), _short(-vy, 100), _short(-vz, 100), heading,
        )
    )  # fmt: skip


def _vfr_hud(v: TelemetrySource) -> bytes:
    t = v.time_s
    vx, vy, vz = v.sensors.velocity(t) if v.has_position else (0.0, 0.0, v.motion.vz)
    speed = math.hypot(vx, vy)
    heading = int(math.degrees(-v.motion.yaw) % 360.0)
    altitude = HOME_ALT_M + v.sensors.position(t)[2] if v.has_position else 0.0
    throttle = int(100.0 * v.command.throttle) if v.armed else 0
    return v.encoder.message(dialect.MAVLink_vfr_hud_message(speed, speed, heading, throttle, altitude, vz))


def _battery(v: TelemetrySource) -> bytes:
    cells = [min(max(round(v.sensors.voltage() * 1e3), 0), 65534)] + [_U16] * 9
    used = v.charge_used_ah
    left = max(0, min(100, int(100.0 * (1.0 - used / v.capacity_ah))))
    return v.encoder.message(
        dialect.MAVLink_battery_status_message(
            0, 0, 0, 32767, cells, _short(v.motion.current, 100), int(used * 1e3), int(used * 22.2 * 36.0), left, 0, 1,
        )
    )  # fmt: skip


def _sys_status(v: TelemetrySource) -> bytes:
    sensors = 0x5361_FC2F if v.has_position else 0x5361_FC0F
    health = sensors if v.armable else sensors & ~dialect.MAV_SYS_STATUS_PREARM_CHECK
    if v.store["SIM_RC_FAIL"]:
        health &= ~dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    used = v.charge_used_ah
    left = max(0, min(100, int(100.0 * (1.0 - used / v.capacity_ah))))
    volts = min(max(round(v.sensors.voltage() * 1e3), 0), 65534)
    return v.encoder.message(
        dialect.MAVLink_sys_status_message(
            sensors, sensors, health, 250, volts, _short(v.motion.current, 100), left, 0, 0, 0, 0, 0, 0
        )
    )


def _pressure(v: TelemetrySource) -> bytes:
    return v.encoder.message(dialect.MAVLink_scaled_pressure_message(_ms(v), _hpa(v), 0.0, 3120))


def _hpa(v: TelemetrySource) -> float:
    altitude = HOME_ALT_M + v.sensors.pressure_height(v.time_s)
    return float(1013.25 * (1.0 - 2.25577e-5 * altitude) ** 5.25588)


def _vibration(v: TelemetrySource) -> bytes:
    return v.encoder.message(dialect.MAVLink_vibration_message(_us(v), 0.3, 0.3, 0.3, 0, 0, 0))


def _fence(v: TelemetrySource) -> bytes | None:
    if not v.store["FENCE_ENABLE"]:
        return None
    return v.encoder.message(dialect.MAVLink_fence_status_message(int(v.fence_breach > 0), 0, v.fence_breach, _ms(v)))


def _navigation(v: TelemetrySource) -> bytes:
    t = v.target
    roll, pitch, heading = math.degrees(t.roll), -math.degrees(t.pitch), round(math.degrees(-t.yaw)) % 360
    return v.encoder.message(
        dialect.MAVLink_nav_controller_output_message(roll, pitch, heading, heading, 0, 0.0, 0.0, 0.0)
    )


def _silent(_: TelemetrySource) -> None:
    """Accepted, and never sent: there is no such instrument."""


def _power(v: TelemetrySource) -> bytes:
    return v.encoder.message(dialect.MAVLink_power_status_message(5000, 0, 0))


def _ekf(v: TelemetrySource) -> bytes:
    flags = 831 if v.has_position else (167 if v.time_s > 15.0 else 1024)
    return v.encoder.message(dialect.MAVLink_ekf_status_report_message(flags, 0.01, 0.01, 0.005, 0.02, 0.0, 0.0))


def _extended_state(v: TelemetrySource) -> bytes:
    state = dialect.MAV_LANDED_STATE_ON_GROUND if v.landed else dialect.MAV_LANDED_STATE_IN_AIR
    if v.taking_off:
        state = dialect.MAV_LANDED_STATE_TAKEOFF
    elif v.mode == LAND and not v.landed:
        state = dialect.MAV_LANDED_STATE_LANDING
    return v.encoder.message(dialect.MAVLink_extended_sys_state_message(0, state))


def _rc_channels(v: TelemetrySource) -> bytes:
    if v.store["SIM_RC_FAIL"]:
        return v.encoder.message(dialect.MAVLink_rc_channels_message(_ms(v), 0, *([_U16] * 18), 0))
    switch = 1000 if v.store["SIM_PILOT_MODE"] < 0 else _switch_us(v)
    sticks = [1500, 1500, int(v.store["SIM_PILOT_THR"]), 1500, switch, 1500, 1500, 1500] + [0] * 10
    return v.encoder.message(dialect.MAVLink_rc_channels_message(_ms(v), 16, *sticks, 254))


def _switch_us(v: TelemetrySource) -> int:
    """The mode switch at the position of the pilot's mode; at the second one where no position has it."""
    modes = [v.store[f"FLTMODE{n}"] for n in range(1, 7)]
    place = modes.index(v.store["SIM_PILOT_MODE"], 1) if v.store["SIM_PILOT_MODE"] in modes[1:] else 1
    return (1165, 1300, 1425, 1555, 1685, 1815)[place]


def _servo(v: TelemetrySource) -> bytes:
    out = round(1000 + 1000 * v.command.throttle) if v.armed else 1000
    return v.encoder.message(dialect.MAVLink_servo_output_raw_message(_us(v) & _U32, 0, out, out, out, out, 0, 0, 0, 0))


def _home(v: TelemetrySource) -> bytes | None:
    if not v.has_home:
        return None
    nan = float("nan")
    return v.encoder.message(
        dialect.MAVLink_home_position_message(
            HOME_LAT_E7, HOME_LON_E7, round(HOME_ALT_M * 1e3), 0.0, 0.0, 0.0, [nan] * 4, 0.0, 0.0, 0.0, _us(v)
        )
    )


def _origin(v: TelemetrySource) -> bytes | None:
    if not v.has_home:
        return None
    return v.encoder.message(
        dialect.MAVLink_gps_global_origin_message(HOME_LAT_E7, HOME_LON_E7, round(HOME_ALT_M * 1e3), _us(v))
    )


def _gps(v: TelemetrySource) -> bytes:
    if not v.store["SIM_GPS1_ENABLE"] or v.time_s < 12.0:
        return v.encoder.message(dialect.MAVLink_gps_raw_int_message(_us(v), 0, 0, 0, 0, _U16, _U16, 0, _U16, 0))
    m = v.motion
    lat, lon = global_of(m.px, m.py)
    speed = round(100.0 * math.hypot(m.vx, m.vy))
    return v.encoder.message(
        dialect.MAVLink_gps_raw_int_message(
            _us(v), 6, lat, lon, round((HOME_ALT_M + m.pz) * 1e3), 121, 200, speed, 0, 10
        )
    )


def _version(v: TelemetrySource) -> bytes:
    commit = [ord(c) for c in "simulate"]
    none = [0] * 8
    return v.encoder.message(
        dialect.MAVLink_autopilot_version_message(_CAPABILITIES, FIRMWARE, 0, 0, 0, commit, none, none, 0, 0, 0)
    )


def heartbeat(v: TelemetrySource) -> bytes:
    """HEARTBEAT: the mode in custom_mode."""
    base = 89 | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if v.armed else 0)  # 89 whatever the mode, as a real SITL sends
    state = dialect.MAV_STATE_STANDBY if v.landed else dialect.MAV_STATE_ACTIVE
    if v.time_s < 1.0:
        state = dialect.MAV_STATE_BOOT
    kind, autopilot = dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    return v.encoder.message(dialect.MAVLink_heartbeat_message(kind, autopilot, base, v.mode, state, 3))


def _system_time(v: TelemetrySource) -> bytes:
    return v.encoder.message(dialect.MAVLink_system_time_message(1_763_000_000_000_000 + _us(v), _ms(v)))


Maker = Callable[[TelemetrySource], bytes | None]

MAKERS: dict[int, Maker] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: _gps,
    dialect.MAVLINK_MSG_ID_SCALED_IMU2: _milli_imu(dialect.MAVLink_scaled_imu2_message, _ms),
    dialect.MAVLINK_MSG_ID_RAW_IMU: _milli_imu(dialect.MAVLink_raw_imu_message, _us),
    dialect.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servo,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _origin,
    dialect.MAVLINK_MSG_ID_RC_CHANNELS: _rc_channels,
    dialect.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    dialect.MAVLINK_MSG_ID_ATTITUDE_TARGET: _attitude_target,
    dialect.MAVLINK_MSG_ID_HIGHRES_IMU: _highres_imu,
    dialect.MAVLINK_MSG_ID_POWER_STATUS: _power,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery,
    dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: _home,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_state,
    dialect.MAVLINK_MSG_ID_SCALED_PRESSURE: _pressure,
    dialect.MAVLINK_MSG_ID_VIBRATION: _vibration,
    dialect.MAVLINK_MSG_ID_FENCE_STATUS: _fence,
    dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: _navigation,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _silent,
    dialect.MAVLINK_MSG_ID_RANGEFINDER: _silent,
    dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR: _silent,
    dialect.MAVLINK_MSG_ID_WIND: _silent,
}
"""Every message that can be asked for, by id; None means: accepted, and nothing is there to send."""


class Streams:
    """Message ids with their intervals, s. A message is due at a tick when its time has come: the interval is an average."""

    def __init__(self) -> None:
        self._interval: dict[int, float] = {}
        self._next: dict[int, float] = {}
        self._first = float("inf")

    def interval_s(self, message_id: int) -> float:
        """The interval of a message, s; 0 when it is not sent."""
        return self._interval.get(message_id, 0.0)

    def set(self, message_id: int, interval_s: float, t_s: float) -> None:
        """Send a message every interval_s, s, from t_s on; 0 or less stops it."""
        if interval_s <= 0.0:
            self._interval.pop(message_id, None)
            self._next.pop(message_id, None)
        else:
            self._interval[message_id] = interval_s
            # on a grid of its own interval, so that streams of one rate come in one tick
            self._next[message_id] = (int(t_s / interval_s + 1e-6) + 1) * interval_s
        self._first = min(self._next.values(), default=float("inf"))

    def due(self, t_s: float) -> list[int]:
        """Ids to be sent at t_s, s."""
        late = t_s + 1e-9
        if self._first > late:
            return []
        found = []
        times, intervals = self._next, self._interval
        for i, when in times.items():
            if when <= late:
                found.append(i)
                when += intervals[i]
                times[i] = when if when > late else t_s + intervals[i]
        self._first = min(times.values())
        return found
