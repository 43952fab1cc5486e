"""A multirotor from its rotors up: ESC, rotor, air, rigid body, inner loops. Written without a look at `physics`.

What a clean one does, and why the paper's model can follow it: ESCs whose thrust is linear in throttle at constant voltage and goes
with a constant power of it; a common ramp of first order in thrust (soft start and governor of the ESCs), with fast rotors around
it for the moments; angle loops of second order by design; linear drag. What is left over (rotor lag of 5 ms, 400 Hz loops, products
of rates, gyroscopic moments, mixer limits) stays below half of the usual noise floor after the base parameters are fitted.
Everything else is a switch: see `rotor_effects`.

World NWU, body FLU. One step is one loop of the flight controller: midpoint for the attitude, trapezoid for velocity and position.
"""

from __future__ import annotations

from collections import deque
from math import cos, exp, sin, sqrt

from flighttest.frames import G_M_S2
from flighttest.sim.plants.battery import Battery
from flighttest.sim.plants.plant import Command, Delays, Hidden, Motion
from flighttest.sim.plants.rotor_effects import effects_on
from flighttest.sim.plants.rotor_loops import Loops, Mixer
from flighttest.sim.plants.rotor_propulsion import Propulsion
from flighttest.sim.plants.rotor_vehicle import RotorVehicle
from flighttest.sim.plants.slung import SlungLoad
from flighttest.sim.plants.weather import Air

TICK_S = 0.0025
_HARD_LANDING_M_S = 4.0


class RotorPlant:
    """A rotor-level multirotor in motion (a `Plant`)."""

    tick_s = TICK_S

    def __init__(
        self,
        vehicle: RotorVehicle | None = None,
        hide: Hidden | None = None,
        battery: Battery | None = None,
        air: Air | None = None,
    ) -> None:
        self.vehicle = v = vehicle or RotorVehicle()
        self.on = on = effects_on(hide or {}, v)
        self.battery = battery or Battery(v.cells, v.capacity_ah, v.resistance_ohm)
        self.motion = Motion(voltage=self.battery.voltage)
        late = on.get("channel_delay", {})
        own = v.delay_s
        self.delays = Delays(own + late.get("delay_attitude", 0.0), own + late.get("delay_yaw_rate", 0.0), own)
        self.hover_throttle = v.hover_throttle * (v.nominal_voltage_v / self.battery.voltage) ** v.alpha
        self._air = air
        self._loops, self._mixer, self._motors = Loops(v, on), Mixer(v, "attitude_priority" in on), Propulsion(v, on)
        self.rotor_thrust_n = [0.0] * v.rotors  # static thrust of each at its present speed, N
        self._load = SlungLoad(v.mass_kg, on["slung_payload"]) if "slung_payload" in on else None
        self._roll = self._pitch = self._yaw = 0.0
        self._p = self._q = self._r = 0.0
        self._v = self._pos = self._accel = (0.0, 0.0, 0.0)
        self._frozen = False
        self.time_s = 0.0
        self._read_effects()

    def _read_effects(self) -> None:
        on, v = self.on, self.vehicle
        drag = on.get("linear_drag", {"d_x": v.drag_x_1_s, "d_y": v.drag_y_1_s, "d_z": v.drag_z_1_s})
        self._d = (drag["d_x"], drag["d_y"], drag["d_z"])
        square = on.get("quadratic_drag")
        self._k = (square["k_x"], square["k_y"], square["k_z"]) if square else None
        wind = on.get("steady_wind", {})
        self._wind = (wind.get("w_north", 0.0), wind.get("w_west", 0.0), wind.get("w_up", 0.0))
        self._ground = on.get("ground_effect", {}).get("R2_m2", 0.0) / 16.0
        self._h_force = on.get("thrust_scaled_drag", {}).get("c_h", 0.0)
        self._lift = on.get("translational_lift", {}).get("k_lift", 0.0)
        self._inflow = on.get("axial_inflow", {}).get("k_inflow", 0.0)
        self._ring = on.get("vortex_ring")
        self._hubs = on.get("airflow_moment")
        self._aero = bool(self._ground or self._h_force or self._lift or self._inflow or self._ring)
        self._swirl = on.get("swirl", {}).get("rate_1_s", 0.0)
        self._tether, self._updraft, self._front = on.get("tether"), on.get("updraft"), on.get("gust_front")
        offset = on.get("attitude_offset", {})
        self._offset = (-offset.get("offset_roll", 0.0), -offset.get("offset_pitch", 0.0))  # reported minus true
        self._trim = tuple((sin(a), cos(a)) for a in self._offset) if offset else None
        bias = on.get("accelerometer_bias", {})
        self._bias = (bias.get("bias_x", 0.0), bias.get("bias_y", 0.0), bias.get("bias_z", 0.0))
        arm = on.get("imu_lever_arm")
        self._arm = (arm["arm_x"], arm["arm_y"], arm["arm_z"]) if arm else None
        self._latency = on.get("velocity_latency", {}).get("velocity_latency", 0.0)
        self._late: deque[tuple[float, float, float, float]] = deque()

    def replace_battery(self, voltage_v: float | None = None) -> None:
        """A full battery, or one that rests at a voltage, V; the motors have cooled."""
        self.battery.replace(voltage_v)
        self._motors.cool()

    def advance(self, dt_s: float, command: Command) -> None:
        """Move on by dt_s, s, under a constant command."""
        steps = int(dt_s / TICK_S - 1e-6) + 1
        h = dt_s / steps
        for _ in range(steps):
            self._step(h, command)

    # -- one loop ------------------------------------------------------------------------------------------------------------

    def _step(self, h: float, command: Command) -> None:
        m, v = self.motion, self.vehicle
        self.time_s += h
        if self._air is not None:
            self._air.advance(h)
        loops = self._loops
        if m.on_ground:
            loops.reset()
        else:
            roll, pitch = self._roll + self._offset[0], self._pitch + self._offset[1]
            loops.update(h, command, roll, pitch, self._p, self._q, self._r)
        throttle = command.throttle if command.spinning else 0.0
        gain = self._motors.voltage_gain(self.battery.voltage)
        thrust = self._motors.common(h, throttle, loops.roll, loops.pitch, gain, command.spinning)
        top = gain * v.thrust_max_n / v.rotors
        wanted = self._mixer.mix(thrust, loops.moment_x, loops.moment_y, loops.moment_z, top)
        self._turn(h, wanted, command.spinning)
        m.shaped_roll, m.shaped_pitch, m.shaped_yaw_rate = loops.roll, loops.pitch, command.yaw_rate

    def _turn(self, h: float, wanted: list[float], spinning: bool) -> None:
        """One step of the rotors towards the wanted thrusts, N, and of everything they move."""
        m, v = self.motion, self.vehicle
        share = 1.0 - exp(-h / v.rotor_lag_s)
        rotors = self.rotor_thrust_n = [f + share * (w - f) for f, w in zip(self.rotor_thrust_n, wanted, strict=True)]
        if m.on_ground:
            self._stand(sum(rotors))
        else:
            self._fly(h, rotors)
        load = max(sum(rotors), 0.0) / (v.mass_kg * G_M_S2)
        idle = 0.4 if spinning else 0.2
        self.battery.draw(idle + v.hover_current_a * load * sqrt(load), h)
        m.voltage, m.current = self.battery.voltage - self._motors.drop_logged, self.battery.current

    def _stand(self, thrust: float) -> None:
        """On the ground until the rotors carry the weight."""
        m, v = self.motion, self.vehicle
        hanging = self._load.mass_kg if self._load else 0.0
        if thrust > (v.mass_kg + hanging) * G_M_S2 and not self._frozen:
            m.on_ground = False
            if self._load:
                self._load.hang()
        self._report(0.0, (0.0, 0.0, 0.0))

    def _wind_now(self) -> tuple[float, float, float]:
        x, y, z = self._wind
        if self._air is not None:
            x, y, z = x + self._air.x, y + self._air.y, z + self._air.z
        if self._updraft:
            u = self._updraft
            d2 = (self._pos[0] - u["x_m"]) ** 2 + (self._pos[1] - u["y_m"]) ** 2
            z += u["speed_m_s"] * exp(-d2 / max(u["radius_m"] ** 2, 1e-9))
        if self._front:
            f = self._front
            if 0.0 <= self.time_s - f["from_s"] < f["for_s"]:
                x, y = x + f["w_north"], y + f["w_west"]
        return x, y, z

    def _fly(self, h: float, rotors: list[float]) -> None:
        v = self.vehicle
        sf, cf, s, c = sin(self._roll), cos(self._roll), sin(self._pitch), cos(self._pitch)
        sy, cy = sin(self._yaw), cos(self._yaw)
        r00, r01, r02 = cy * c, cy * s * sf - sy * cf, cy * s * cf + sy * sf
        r10, r11, r12 = sy * c, sy * s * sf + cy * cf, sy * s * cf - cy * sf
        r20, r21, r22 = -s, c * sf, c * cf
        wx, wy, wz = self._wind_now()
        vx, vy, vz = self._v
        ax, ay, az = vx - wx, vy - wy, vz - wz
        bx, by, bz = r00 * ax + r10 * ay + r20 * az, r01 * ax + r11 * ay + r21 * az, r02 * ax + r12 * ay + r22 * az
        if self._aero:
            rotors, hx, hy = self._rotor_air(rotors, bx, by, bz, r20, r21)
        else:
            hx = hy = 0.0
        mass = v.mass_kg
        fx, fy = hx / mass - self._d[0] * bx, hy / mass - self._d[1] * by
        fz = sum(rotors) / mass - self._d[2] * bz
        if self._k:
            kx, ky, kz = self._k
            fx, fy, fz = fx - kx * abs(bx) * bx, fy - ky * abs(by) * by, fz - kz * abs(bz) * bz
        gx, gy, gz = r00 * fx + r01 * fy + r02 * fz, r10 * fx + r11 * fy + r12 * fz, r20 * fx + r21 * fy + r22 * fz
        if self._swirl or self._tether:
            gx, gy, gz = self._odd_forces(gx, gy, gz, ax, ay)
        if self._load:
            gx, gy, gz = self._load.pull(h, (gx, gy, gz))
        # rigid body
        mx = my = mz = 0.0
        arm = v.yaw_arm_m
        for lift, (ox, oy), spin in zip(rotors, self._mixer.places, self._mixer.spins, strict=True):
            mx += oy * lift
            my -= ox * lift
            mz += spin * arm * lift
        jx, jy, jz = v.inertia_x_kg_m2, v.inertia_y_kg_m2, v.inertia_z_kg_m2
        if self._hubs:
            hubs, load = self._hubs, sqrt(max(sum(rotors), 0.0) / (mass * G_M_S2))
            mx += jx * load * (hubs["l_v"] * by + hubs["l_w"] * bz)
            my += jy * load * (hubs["m_w"] * bz - hubs["m_u"] * bx)
        p, q, r = self._p, self._q, self._r
        dp, dq, dr = (mx - (jz - jy) * q * r) / jx, (my - (jx - jz) * p * r) / jy, (mz - (jy - jx) * p * q) / jz
        pm, qm, rm = p + 0.5 * h * dp, q + 0.5 * h * dq, r + 0.5 * h * dr
        self._p, self._q, self._r = p + h * dp, q + h * dq, r + h * dr
        turn = sf * qm + cf * rm
        self._roll += h * (pm + s / c * turn)
        self._pitch += h * (cf * qm - sf * rm)
        self._yaw += h * turn / c
        # translation
        az_world = gz - G_M_S2
        nvx, nvy, nvz = vx + h * gx, vy + h * gy, vz + h * az_world
        x, y, z = self._pos
        x, y, z = x + 0.5 * h * (vx + nvx), y + 0.5 * h * (vy + nvy), z + 0.5 * h * (vz + nvz)
        self._v, self._pos = (nvx, nvy, nvz), (x, y, z)
        if z <= 0.0 and nvz < 0.0:
            self._touch_down(-nvz)
            return
        f = (r00 * gx + r10 * gy + r20 * gz, r01 * gx + r11 * gy + r21 * gz, r02 * gx + r12 * gy + r22 * gz)
        if self._arm:
            lx, ly, lz = self._arm
            p, q, r = self._p, self._q, self._r
            along = p * lx + q * ly + r * lz
            square = p * p + q * q + r * r
            f = (
                f[0] + dq * lz - dr * ly + p * along - lx * square,
                f[1] + dr * lx - dp * lz + q * along - ly * square,
                f[2] + dp * ly - dq * lx + r * along - lz * square,
            )
        self._report(h, f)

    def _rotor_air(
        self, rotors: list[float], bx: float, by: float, bz: float, r20: float, r21: float
    ) -> tuple[list[float], float, float]:
        """Thrust of each rotor in its own air, N, and the sum of their in-plane forces, N."""
        v, mixer = self.vehicle, self._mixer
        p, q, r = self._p, self._q, self._r
        hover = v.mass_kg * G_M_S2 / v.rotors
        height = self._pos[2] + v.rotor_height_m
        hx = hy = 0.0
        found = []
        for f, (x, y) in zip(rotors, mixer.places, strict=True):
            ux, uy, uz = bx - r * y, by + r * x, bz + p * y - q * x
            flat = ux * ux + uy * uy
            gain = 1.0 + self._lift * flat
            if self._ground:
                z = max(height + r20 * x + r21 * y, 0.5 * v.radius_m)
                gain /= 1.0 - min(self._ground / (z * z), 0.6)
            if self._ring:
                ring = self._ring
                away = (-uz - ring["vortex_centre"]) / ring["vortex_width"]
                blown = flat / (2.0 * v.induced_velocity_m_s) ** 2
                gain *= 1.0 - ring["vortex_depth"] * exp(-away * away - blown)
            f = f * gain
            if self._inflow:
                f -= self._inflow * sqrt(max(f, 0.0) * hover) * uz
            hx -= self._h_force * f * ux
            hy -= self._h_force * f * uy
            found.append(f)
        return found, hx, hy

    def _odd_forces(self, gx: float, gy: float, gz: float, ax: float, ay: float) -> tuple[float, float, float]:
        if self._swirl:
            gx, gy = gx - self._swirl * ay, gy + self._swirl * ax
        if self._tether:
            x, y, z = self._pos
            length = sqrt(x * x + y * y + z * z)
            beyond = length - self._tether["rest_m"]
            if beyond > 0.0:
                pull = self._tether["stiffness_1_s2"] * beyond / length
                gx, gy, gz = gx - pull * x, gy - pull * y, gz - pull * z
        return gx, gy, gz

    def _touch_down(self, speed: float) -> None:
        """The ground stops everything; after a hard or tilted landing the vehicle lies as it fell."""
        m = self.motion
        m.impact_m_s, m.on_ground = speed, True
        self._frozen = speed > _HARD_LANDING_M_S or cos(self._roll) * cos(self._pitch) < 0.7
        if not self._frozen:
            self._roll = self._pitch = 0.0
        self._p = self._q = self._r = 0.0
        self._v, self._pos = (0.0, 0.0, 0.0), (self._pos[0], self._pos[1], 0.0)
        self._report(0.0, (0.0, 0.0, 0.0))

    def _report(self, h: float, f: tuple[float, float, float]) -> None:
        """What perfect instruments read."""
        m = self.motion
        roll, pitch = self._roll, self._pitch
        if h == 0.0:
            f = (-sin(pitch) * G_M_S2, cos(pitch) * sin(roll) * G_M_S2, cos(pitch) * cos(roll) * G_M_S2)
        m.px, m.py, m.pz = self._pos
        m.vx, m.vy, m.vz = self._late_velocity() if self._latency else self._v
        m.roll, m.pitch, m.yaw = roll + self._offset[0], pitch + self._offset[1], self._yaw
        m.p, m.q, m.r = self._p, self._q, self._r
        if self._trim is not None:
            # The board is mounted askew: attitude and accelerometer report in its frame, thrust acts in the vehicle's.
            (sr, cr), (sp, cp) = self._trim
            f = (cp * f[0] - sp * f[2], f[1], sp * f[0] + cp * f[2])
            f = (f[0], cr * f[1] + sr * f[2], cr * f[2] - sr * f[1])
        b = self._bias
        m.fx, m.fy, m.fz = f[0] + b[0], f[1] + b[1], f[2] + b[2]

    def _late_velocity(self) -> tuple[float, float, float]:
        """The velocity of `latency` ago, between samples by interpolation."""
        late, wanted = self._late, self.time_s - self._latency
        late.append((self.time_s, *self._v))
        while len(late) > 2 and late[1][0] <= wanted:
            late.popleft()
        t0, x0, y0, z0 = late[0]
        if len(late) < 2 or wanted <= t0:
            return x0, y0, z0
        t1, x1, y1, z1 = late[1]
        k = min((wanted - t0) / (t1 - t0), 1.0)
        return x0 + k * (x1 - x0), y0 + k * (y1 - y0), z0 + k * (z1 - z0)
