"""What the autopilot looks after ten times a second whatever the mode: boot messages, landing, fence, crash, its own TIMESYNC."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.frames import G_M_S2
from flighttest.sim.autopilot import modes, telemetry
from flighttest.sim.autopilot.fences.breach import breach_words, fence_breaches, fence_mode
from flighttest.sim.autopilot.safety import CrashCheck
from flighttest.sim.autopilot.vehicle import CommandedVehicle

_LAND_DISARM_S = 1.5
_TIMESYNC_S = 10.0
_PREARM_S = 30.0  # how often a vehicle that cannot arm reports why
_SWAP_S = 3.0
_MAXALT, _BOUNDARY = dialect.FENCE_BREACH_MAXALT, dialect.FENCE_BREACH_BOUNDARY
_BOOT_TEXTS = (
    (0.9, "Barometer 1 calibration complete"), (1.4, "ArduPilot Ready"), (1.4, "AHRS: DCM active"),
    (3.4, "EKF3 IMU0 initialised"), (3.4, "AHRS: EKF3 active"), (4.8, "EKF3 IMU0 tilt alignment complete"),
    (4.9, "EKF3 IMU0 MAG0 initial yaw alignment complete"), (8.8, "GPS 1: detected u-blox"),
)  # fmt: skip


class Watch:
    """The slow duties of one vehicle; `look` at every tenth of a second."""

    def __init__(self, vehicle: CommandedVehicle) -> None:
        self._v = vehicle
        self._texts = list(_BOOT_TEXTS)
        self._origin_said = self._gps_said = self._switch_read = False
        self._crash = CrashCheck()
        self._breaches = 0
        self._timesync_s = _TIMESYNC_S
        self._prearm_s = _PREARM_S

    def look(self) -> None:
        """Do what is due now."""
        v = self._v
        t_s = v.time_s
        self._report(t_s)
        self._landing(t_s)
        v.fence.look(t_s)
        if not v.armed:
            self._breaches = 0
            self._swap(t_s)
            return
        self._fence()
        self._crashed(t_s)

    def _report(self, t_s: float) -> None:
        v = self._v
        while self._texts and self._texts[0][0] <= t_s:
            v.say(self._texts.pop(0)[1])
        if not self._origin_said and v.has_home:
            self._origin_said = True
            v.say("EKF3 IMU0 origin set")
            v.say("Field Elevation Set: 584m")
        if v.has_position and not self._gps_said:
            self._gps_said = True
            v.say("EKF3 IMU0 is using GPS")
        if not self._switch_read and t_s >= v.boot.mode_switch_s:
            self._switch_read = True
            if v.mode != modes.STABILIZE and not v.armed:
                v.set_mode(modes.STABILIZE)
            v.say("RC7: SaveWaypoint LOW")
        if t_s >= self._prearm_s:
            self._prearm_s += _PREARM_S
            why = None if v.armed else v.arming_refusal()
            if why is not None:
                v.say(why.replace("Arm:", "PreArm:"), dialect.MAV_SEVERITY_CRITICAL)
        if t_s >= self._timesync_s:
            self._timesync_s += _TIMESYNC_S
            v.outbox.append(v.encoder.message(dialect.MAVLink_timesync_message(0, int(t_s * 1e9) + 1)))

    def _landing(self, t_s: float) -> None:
        v = self._v
        if not v.motion.on_ground:
            v.landed, v.landed_s = False, t_s
            return
        # landing is not detected in thrust mode once any positive thrust was sent
        blind = v.mode in modes.ATTITUDE_TARGETS and v.thrust_is_thrust and v.angle.positive_thrust
        if v.armed and (blind or v.command.throttle > 0.5 * v.control.hover):
            v.landed_s = t_s
            if blind:
                v.landed = False
            return
        rest = t_s - v.landed_s
        if not v.armed or rest >= 1.0:
            v.landed = True
        if not v.armed:
            return
        landing = v.mode in (modes.LAND, modes.RTL) and v.lifting
        patience = _LAND_DISARM_S if landing else v.store["DISARM_DELAY"] or math.inf
        if rest >= patience and (landing or v.landed):
            v.disarm(force=True)

    def _swap(self, t_s: float) -> None:
        """The ground crew: a landed vehicle with an empty pack gets a full one."""
        v = self._v
        if v.plant.battery.charge < v.store["SIM_BATT_SWAP"] and t_s - v.disarmed_s >= _SWAP_S:
            v.replace_battery()
            v.say("SIM battery replaced")

    def _fence(self) -> None:
        v = self._v
        m = v.motion
        breaches = fence_breaches(
            v.store, v.fence.in_force, v.fence.areas, m.px, m.py, m.pz, has_position=v.has_position
        )
        new = breaches & ~self._breaches
        self._breaches = breaches
        if not breaches:
            v.fence_breach = 0
        if not new:
            return
        v.fence_breach = _MAXALT if new & 1 else _BOUNDARY
        frame = telemetry.MAKERS[dialect.MAVLINK_MSG_ID_FENCE_STATUS](v)
        if frame is not None:
            v.outbox.append(frame)
        mode = fence_mode(int(v.store["FENCE_ACTION"]), has_position=v.has_position)
        moved = mode is not None and v.mode != mode and not v.landed and v.set_mode(mode)
        v.say(breach_words(new), dialect.MAV_SEVERITY_NOTICE)
        if moved:
            v.say("Manual recovery started")

    def _crashed(self, t_s: float) -> None:
        v = self._v
        m = v.motion
        lean = math.acos(min(max(math.cos(m.roll) * math.cos(m.pitch), -1.0), 1.0))
        error = math.hypot(m.roll - v.target.roll, m.pitch - v.target.pitch)
        speed = math.sqrt(m.vx * m.vx + m.vy * m.vy + m.vz * m.vz)
        accel = abs(math.sqrt(m.fx * m.fx + m.fy * m.fy + m.fz * m.fz) - G_M_S2)
        if v.store["FS_CRASH_CHECK"] and self._crash.update(t_s, error, lean, speed, accel):
            text = f"Crash: Disarming: AngErr={math.degrees(error):.0f}>30, Accel={accel:.1f}<3.0"
            v.say(text, dialect.MAV_SEVERITY_EMERGENCY)
            v.disarm(force=True)
