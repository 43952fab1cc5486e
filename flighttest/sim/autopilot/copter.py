"""A thin ArduCopter: modes, arming, guided targets, throttle path, landing, safety, telemetry, around any `Plant`.

Behaves as ArduCopter 4.7 was read and flown to behave; what a test of maneuvers never meets
(missions, tuning, other frames) is left out. Time is a count of ticks: nothing here looks at the host's clock or draws from an
unseeded source, so equal messages at equal vehicle times give equal flights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.autopilot import modes, telemetry
from flighttest.sim.autopilot.control import Measured, PositionControl, heading_rate
from flighttest.sim.autopilot.fences.breach import fence_breaches
from flighttest.sim.autopilot.fences.upload import FenceUpload
from flighttest.sim.autopilot.guided import AngleControl
from flighttest.sim.autopilot.mailbox import Mailbox
from flighttest.sim.autopilot.navigation import Navigator
from flighttest.sim.autopilot.parameters import ParameterStore
from flighttest.sim.autopilot.safety import LIFT_S, ORIGIN_S, Boot, arming_refusal
from flighttest.sim.autopilot.vehicle import Target
from flighttest.sim.autopilot.watch import Watch
from flighttest.sim.plants.plant import Command, Plant
from flighttest.sim.sensors import SensorNoise, Sensors
from flighttest.sim.wire import Encoder

_CONTROL_S = 0.02
_SLOW_S = 0.1
_THRUST_AS_THRUST = 8  # GUID_OPTIONS bit 3
_REPORTED_AT_ARMING = (dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, dialect.MAVLINK_MSG_ID_HOME_POSITION)


class Autopilot:
    """One simulated vehicle. `receive` takes messages at the present vehicle time, `tick` moves on, `outbox` collects frames."""

    def __init__(
        self,
        plant: Plant,
        *,
        seed: int = 0,
        noise: SensorNoise | None = None,
        boot: Boot | None = None,
        parameters: Mapping[str, float] | None = None,
        capacity_ah: float = 5.0,
    ) -> None:
        self.plant, self.motion, self.boot = plant, plant.motion, boot or Boot()
        own = {
            "SCHED_LOOP_RATE": round(1.0 / plant.tick_s),
            "MOT_THST_HOVER": plant.hover_throttle,
            "BATT_CAPACITY": round(1e3 * capacity_ah),
            "SIM_BATT_CAP_AH": capacity_ah,
        }
        self.store = ParameterStore(own | dict(parameters or {}))
        self.encoder, self.streams = Encoder(), telemetry.Streams()
        self.sensors = Sensors(
            plant.motion, plant.tick_s, seed, noise, self.store["INS_ACCEL_FILTER"], self.store["INS_GYRO_FILTER"]
        )
        self.command, self.target = Command(), Target()
        self.angle = AngleControl(plant.delays)
        self.control = PositionControl(hover=plant.hover_throttle)
        self.navigator = Navigator(self.store)
        self.outbox: list[bytes] = []
        self.ticks = 0
        self.mode, self.armed, self.landed = modes.STABILIZE, False, True
        self.armed_s = self.landed_s = self.disarmed_s = 0.0
        self.capacity_ah = capacity_ah
        self.fence_breach = 0
        self._text_id = 0
        self._holding = False
        self._throttle_state = 0.0
        self._charge_used_ah = 0.0
        self._control_every = max(round(_CONTROL_S / plant.tick_s), 1)
        self._slow_every = max(round(_SLOW_S / plant.tick_s), 1)
        self._second_every = max(round(1.0 / plant.tick_s), 1)
        self.fence = FenceUpload(self)
        self.mailbox = Mailbox(self)
        self._watch = Watch(self)

    # -- what telemetry and the mailbox read ---------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Vehicle time, s since boot."""
        return self.ticks * self.plant.tick_s

    @property
    def has_position(self) -> bool:
        """Whether the estimator uses GPS."""
        return bool(self.store["SIM_GPS1_ENABLE"]) and self.time_s >= self.boot.gps_s

    @property
    def has_home(self) -> bool:
        """Whether home and the estimator's origin are set: with the first good fix, before the estimator uses it."""
        return bool(self.store["SIM_GPS1_ENABLE"]) and self.time_s >= min(ORIGIN_S, self.boot.gps_s)

    @property
    def armable(self) -> bool:
        """Whether the arming checks pass."""
        return self.armed or self.arming_refusal() is None

    @property
    def taking_off(self) -> bool:
        """Whether it climbs to its take-off height."""
        return self.mode == modes.GUIDED and self.navigator.take_off_m is not None and not self.landed

    @property
    def charge_used_ah(self) -> float:
        """Charge drawn since the battery was last declared full, A h."""
        return self._charge_used_ah

    @property
    def thrust_is_thrust(self) -> bool:
        """GUID_OPTIONS bit 3: the thrust field is a throttle, not a climb rate."""
        return bool(int(self.store["GUID_OPTIONS"]) & _THRUST_AS_THRUST)

    def say(self, text: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """STATUSTEXT, in chunks where it is long."""
        raw = text.encode()
        chunks = [raw[i : i + 50] for i in range(0, len(raw), 50)] or [b""]
        number = 0
        if len(chunks) > 1:
            self._text_id = number = self._text_id % 65535 + 1
        for i, chunk in enumerate(chunks):
            self.outbox.append(self.encoder.message(dialect.MAVLink_statustext_message(severity, chunk, number, i)))

    def receive(self, message: Any) -> None:
        """A message that arrives now."""
        self.mailbox.receive(message)

    def replace_battery(self, voltage_v: float | None = None) -> None:
        """A full battery, or one that rests at a voltage, V."""
        self.plant.replace_battery(voltage_v)
        self._charge_used_ah = 0.0

    # -- modes and arming ----------------------------------------------------------------------------------------------------

    def set_mode(self, mode: int) -> bool:
        """Change mode; False, with the reason as STATUSTEXT, where it is refused."""
        why = modes.mode_refusal(mode, armed=self.armed, has_position=self.has_position)
        if why is not None:
            self.say(why, dialect.MAV_SEVERITY_WARNING)
            return False
        if mode == self.mode:
            return True
        self.mode = mode
        self._holding = False
        self.control.reset()
        seen = self.measured()
        self.navigator.enter(mode, seen)
        self._start_angle(seen)
        self.angle.chosen = mode == modes.GUIDED_NOGPS  # GUIDED begins with holding its place (ModeGuided::init)
        self.outbox.append(telemetry.heartbeat(self))
        return True

    def _start_angle(self, seen: Measured) -> None:
        held = self.angle.last_thrust
        self.angle.start(self.time_s, seen.yaw)
        self.angle.thrust = held  # not reset on re-entry to the mode

    def arm(self, *, force: bool = False) -> bool:
        """Arm the motors; False, with the reason as STATUSTEXT, where it is refused."""
        if self.armed:
            return True
        why = None if force else self.arming_refusal()
        if why is not None:
            self.say(why, dialect.MAV_SEVERITY_CRITICAL)
            return False
        self.armed, self.armed_s, self.landed_s = True, self.time_s, self.time_s
        self.angle.thrust = None
        self.angle.positive_thrust = False
        self.control.reset()
        seen = self.measured()
        self.navigator.enter(self.mode, seen)
        self._start_angle(seen)
        home = (telemetry.MAKERS[i](self) for i in _REPORTED_AT_ARMING)
        self.outbox += [frame for frame in home if frame is not None]
        self.say("Arming motors")
        self.outbox.append(telemetry.heartbeat(self))
        return True

    def arming_refusal(self) -> str | None:
        """Why it would not arm now, in the firmware's words; None when it would."""
        m, known = self.motion, self.has_position
        why = arming_refusal(self.time_s, self.boot, self.mode, self.store, m.voltage, has_position=known)
        if why is None and self._breaches(known):
            why = "Arm: vehicle outside Fence"
        return why

    def _breaches(self, has_position: bool) -> int:
        m, fence = self.motion, self.fence
        return fence_breaches(self.store, fence.in_force, fence.areas, m.px, m.py, m.pz, has_position=has_position)

    def disarm(self, *, force: bool = False) -> bool:
        """Disarm the motors; False in the air unless forced."""
        if self.armed and not force and not self.landed:
            return False
        if self.armed:
            self.armed, self.disarmed_s = False, self.time_s
            self.say("Disarming motors")
            self.outbox.append(telemetry.heartbeat(self))
        return True

    # -- time ----------------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Move on by one loop of the autopilot."""
        n, dt = self.ticks, self.plant.tick_s
        if n % self._control_every == 0:
            self._fly()
        if n % self._slow_every == 0:
            self._watch.look()
        t_s = self.time_s
        if self.armed and self.mode in modes.ATTITUDE_TARGETS and self._angle_rules(t_s):
            self._follow_targets(t_s, dt)
        else:
            self.plant.advance(dt, self.command)
        self.ticks = n + 1
        self.sensors.update()
        t_s = self.time_s
        for i in self.streams.due(t_s):
            frame = telemetry.MAKERS[i](self)
            if frame is not None:
                self.outbox.append(frame)
        if self.ticks % self._second_every == 0 and not self.streams.interval_s(dialect.MAVLINK_MSG_ID_HEARTBEAT):
            self.outbox.append(telemetry.heartbeat(self))

    def _angle_rules(self, t_s: float) -> bool:
        """Whether attitude targets steer now (in GUIDED, when one was sent last; not before the motors have spun up)."""
        if self.mode == modes.GUIDED and not self.angle.chosen:
            return False
        self.angle.due(t_s)
        return t_s - self.angle.last_s <= self.store["GUID_TIMEOUT"] and self.angle.thrust is not None

    def _follow_targets(self, t_s: float, dt_s: float) -> None:
        """One tick under attitude targets, cut at the very times at which they take effect."""
        angle, command, end = self.angle, self.command, t_s + dt_s
        while True:
            angle.due(t_s)
            edge = angle.next_edge(end)
            self._attitude_command(edge - t_s)
            self.plant.advance(edge - t_s, command)
            angle.advance(edge - t_s)
            if edge >= end - 1e-9:
                break
            t_s = edge

    def _attitude_command(self, dt_s: float) -> None:
        a, c, m = self.angle, self.command, self.motion
        c.spinning = self.armed
        c.roll, c.pitch = a.roll, a.pitch
        # with body rates the yaw rate is the paper's input r_r itself; without, the heading in the quaternion is turned to
        c.yaw_rate = a.r if a.with_rates else heading_rate(a.yaw, m.yaw)
        if self.thrust_is_thrust:
            thrust = min(max(a.thrust or 0.0, 0.0), 1.0)
            self._out(thrust if self.lifting else 0.0, dt_s)
        t = self.target
        t.roll, t.pitch, t.yaw, t.yaw_rate = m.shaped_roll, m.shaped_pitch, a.yaw, c.yaw_rate

    @property
    def lifting(self) -> bool:
        """Whether the motors have spun up since arming."""
        return self.time_s - self.armed_s >= LIFT_S

    def _out(self, throttle: float, dt_s: float) -> None:
        """The throttle path: what was asked for, its filter, the tilt boost, battery compensation."""
        store = self.store
        cut = store["PILOT_THR_FILT"]
        if cut > 0.0:
            self._throttle_state += (throttle - self._throttle_state) * (1.0 - math.exp(-math.tau * cut * dt_s))
        else:
            self._throttle_state = throttle
        self.target.throttle = throttle
        out = self._throttle_state
        if store["ATC_ANGLE_BOOST"]:
            m = self.motion  # the lean angle, not the target's, as ArduCopter takes it
            out /= max(math.cos(m.roll) * math.cos(m.pitch), 0.1)
        full, empty = store["MOT_BAT_VOLT_MAX"], store["MOT_BAT_VOLT_MIN"]
        if full > empty > 0.0:
            ratio = min(max(self.motion.voltage, empty), full) / full
            expo = store["MOT_THST_EXPO"]
            out /= ratio * (1.0 - expo) + expo * ratio * ratio
        self.command.throttle = min(max(out, 0.0), 1.0)

    # -- fifty times a second ------------------------------------------------------------------------------------------------

    def measured(self) -> Measured:
        """What the controllers see now."""
        t = self.time_s
        px, py, pz = self.sensors.position(t)
        vx, vy, vz = self.sensors.velocity(t)
        return Measured(t, px, py, pz, vx, vy, vz, self.motion.yaw)

    def _fly(self) -> None:
        c, t_s = self.command, self.time_s
        self._charge_used_ah += self.motion.current * _CONTROL_S / 3600.0
        c.spinning = self.armed
        if not self.armed or not self.lifting:
            c.roll = c.pitch = c.yaw_rate = 0.0
            self._hold_heading()
            self._out(0.0, _CONTROL_S)
            if self.armed and self.mode in modes.ATTITUDE_TARGETS:
                self.angle.due(t_s)
            return
        if self.mode in modes.ATTITUDE_TARGETS and (self.mode == modes.GUIDED_NOGPS or self.angle.chosen):
            self._angle_mode(t_s)
            return
        if self.mode == modes.STABILIZE:
            c.roll = c.pitch = c.yaw_rate = 0.0
            stick = (self.store["SIM_PILOT_THR"] - 1000.0) / 1000.0
            hover = self.control.hover
            curve = 2.0 * hover * stick if stick < 0.5 else hover + (2.0 * stick - 1.0) * (1.0 - hover)
            self._out(curve * (0.9 if self.landed else 1.0), _CONTROL_S)
            self._report_target()
            return
        seen = self.measured()
        wanted = self.navigator.setpoint(self.mode, seen, self._stick_climb(), self.has_position)
        waiting = self.landed and not self.navigator.take_off_m and self.mode in (modes.GUIDED, modes.BRAKE)
        resting = self.motion.on_ground and (waiting or wanted.climb < 0.0 or self._resting(wanted.height))
        if resting:
            c.roll = c.pitch = c.yaw_rate = 0.0
            self._out(0.0, _CONTROL_S)
        else:
            if self.mode == modes.ALT_HOLD or not self.has_position:
                self.control.level(_CONTROL_S, wanted, seen, c)
            else:
                self.control.update(_CONTROL_S, wanted, seen, c)
            self._flown(c.throttle)
        self._report_target()

    @staticmethod
    def _resting(height: float | None) -> bool:
        return height is not None and height < 0.3

    def _flown(self, throttle: float) -> None:
        """Throttle of our own controllers: it already carries the tilt, so no boost is added."""
        self.target.throttle = throttle
        self.command.throttle = throttle
        self._throttle_state = throttle

    def _angle_mode(self, t_s: float) -> None:
        """Attitude targets, or what follows when they stop: level, heading held, climb rate 0."""
        a, c = self.angle, self.command
        if t_s - a.last_s > self.store["GUID_TIMEOUT"] or a.thrust is None:
            if a.thrust is not None and not self._holding:
                self._holding = True
                a.roll = a.pitch = a.p = a.q = a.r = 0.0
                a.yaw = self.motion.yaw
                a.with_rates = False
            self._climb(0.0, a.yaw)
            return
        self._holding = False
        if not self.thrust_is_thrust:
            up, down = self.store["WP_SPD_UP"], self.store["WP_SPD_DN"]
            x = min(max(2.0 * (a.thrust - 0.5), -1.0), 1.0)
            roll, pitch = c.roll, c.pitch
            seen = self.measured()
            wanted = self.navigator.hold
            wanted.position = wanted.velocity = wanted.height = None
            wanted.climb = x * (up if x > 0.0 else down)
            if self.motion.on_ground and wanted.climb <= 0.0:
                self._out(0.0, _CONTROL_S)
            else:
                c.roll, c.pitch = a.roll, a.pitch
                self.control.vertical(_CONTROL_S, wanted, seen, c)
                self._flown(c.throttle)
            c.roll, c.pitch = roll, pitch

    def _climb(self, climb: float, yaw: float) -> None:
        c = self.command
        c.roll = c.pitch = 0.0
        c.yaw_rate = heading_rate(yaw, self.motion.yaw)
        if self.motion.on_ground and climb <= 0.0:
            self._out(0.0, _CONTROL_S)
        else:
            wanted = self.navigator.hold
            wanted.position = wanted.velocity = wanted.height = None
            wanted.climb = climb
            self.control.vertical(_CONTROL_S, wanted, self.measured(), c)
            self._flown(c.throttle)
        self._report_target()

    def _hold_heading(self) -> None:
        self.angle.yaw = self.motion.yaw if self.angle.thrust is None else self.angle.yaw
        self._report_target()

    def _report_target(self) -> None:
        c, t = self.command, self.target
        t.roll, t.pitch, t.yaw_rate = c.roll, c.pitch, c.yaw_rate
        t.yaw = self.angle.yaw if self.mode == modes.GUIDED_NOGPS else self.motion.yaw

    def _stick_climb(self) -> float:
        stick, dead = self.store["SIM_PILOT_THR"] - 1500.0, self.store["THR_DZ"]
        if abs(stick) <= dead:
            return 0.0
        return math.copysign((abs(stick) - dead) / (500.0 - dead), stick) * self.store["PILOT_SPD_UP"]
