"""The rotor vehicle's inner loops, run 400 times a second: shaping of references, angle and rate control, mixer."""

from __future__ import annotations

import math
from math import cos, sin, sqrt, tan

from flighttest.sim.plants.plant import Command
from flighttest.sim.plants.rotor_vehicle import RotorVehicle


def square_root_rate(error: float, gain: float, accel_max: float) -> float:
    """ArduPilot's square-root controller: linear near the target, constant deceleration far from it."""
    linear = accel_max / (gain * gain)
    if abs(error) <= linear:
        return gain * error
    return math.copysign(sqrt(2.0 * accel_max * (abs(error) - 0.5 * linear)), error)


class _Shaper:
    """One axis of reference shaping: a target that moves with limited acceleration."""

    __slots__ = ("_accel", "_gain", "angle", "rate")

    def __init__(self, accel_max: float, time_constant_s: float) -> None:
        self._accel, self._gain = accel_max, 1.0 / max(time_constant_s, 0.01)
        self.angle = self.rate = 0.0

    def update(self, wanted: float, dt: float) -> float:
        step = self._accel * dt
        rate = square_root_rate(wanted - self.angle, self._gain, self._accel)
        self.rate += min(max(rate - self.rate, -step), step)
        self.angle += self.rate * dt
        return self.angle


class Loops:
    """Angle loops of second order by design, a first-order yaw rate loop, and the moments they ask for.

    After `update`: roll, pitch: the (shaped) targets; moment_x, _y, _z: N m.
    """

    def __init__(self, vehicle: RotorVehicle, on: dict[str, dict[str, float]]) -> None:
        v = vehicle
        self._inertia = (v.inertia_x_kg_m2, v.inertia_y_kg_m2, v.inertia_z_kg_m2)
        # angle P and rate P whose product and sum give the wanted natural frequency and damping
        self._rate_roll, self._rate_pitch = 2.0 * v.zeta_roll * v.omega_roll, 2.0 * v.zeta_pitch * v.omega_pitch
        self._angle_roll = v.omega_roll / (2.0 * v.zeta_roll)
        self._angle_pitch = v.omega_pitch / (2.0 * v.zeta_pitch)
        self._yaw = v.sigma_r_1_s
        self._limit = on["rate_limit"]["rate_max"] if "rate_limit" in on else math.inf
        shaping = on.get("reference_shaping")
        self._shapers = (
            tuple(_Shaper(shaping["shaping_accel"], shaping["shaping_tc"]) for _ in range(2)) if shaping else None
        )
        self._pole = on.get("attitude_extra_pole", {}).get("attitude_pole_tau", 0.0)
        coupling = on.get("roll_pitch_coupling", {})
        self._turn = (coupling.get("pitch_to_roll", 0.0), coupling.get("roll_to_pitch", 0.0))
        self._leak = coupling.get("moment_leak", 0.0)
        self._yaw_accel = on.get("yaw_rate_shaping", {}).get("shaping_yaw_accel", math.inf)
        self._yaw_rate = 0.0
        self.roll = self.pitch = 0.0
        self.moment_x = self.moment_y = self.moment_z = 0.0

    def reset(self) -> None:
        """On the ground: no target, no moment."""
        self.roll = self.pitch = self.moment_x = self.moment_y = self.moment_z = self._yaw_rate = 0.0
        if self._shapers:
            for shaper in self._shapers:
                shaper.angle = shaper.rate = 0.0

    def update(self, dt: float, c: Command, roll: float, pitch: float, p: float, q: float, r: float) -> None:
        """One loop: attitude rad as the controller's estimate has it, body rates rad/s."""
        if self._shapers:
            self.roll = self._shapers[0].update(c.roll + self._turn[0] * c.pitch, dt)
            self.pitch = self._shapers[1].update(c.pitch + self._turn[1] * c.roll, dt)
        else:
            self.roll, self.pitch = c.roll + self._turn[0] * c.pitch, c.pitch + self._turn[1] * c.roll
        step = self._yaw_accel * dt
        self._yaw_rate += min(max(c.yaw_rate - self._yaw_rate, -step), step)
        cf, sf, tt = cos(roll), sin(roll), tan(pitch)
        roll_rate = p + tt * (sf * q + cf * r)
        pitch_rate = cf * q - sf * r
        limit = self._limit
        rate_ref = self._angle_roll * (self.roll - roll)
        roll_accel = self._rate_roll * (min(max(rate_ref, -limit), limit) - roll_rate)
        rate_ref = self._angle_pitch * (self.pitch - pitch)
        pitch_accel = self._rate_pitch * (min(max(rate_ref, -limit), limit) - pitch_rate)
        # Euler to body accelerations for r held by its own loop (rate products left to the feedback)
        x = roll_accel - tt * (sf / cf) * pitch_accel
        y = pitch_accel / cf
        x, y = x + self._leak * y, y + self._leak * x
        jx, jy, jz = self._inertia
        mx, my, mz = jx * x, jy * y, jz * self._yaw * (self._yaw_rate - r)
        if self._pole > 0.0:
            share = 1.0 - math.exp(-dt / self._pole)
            self.moment_x += share * (mx - self.moment_x)
            self.moment_y += share * (my - self.moment_y)
        else:
            self.moment_x, self.moment_y = mx, my
        self.moment_z = mz


class Mixer:
    """Moments and a common thrust to single rotors, all as thrust, N.

    priority: attitude before thrust when a rotor would leave its range, as autopilots do: a hard tilt step then lifts the vehicle.
    Without it a rotor pulls both ways, so that a clean vehicle's thrust is what was asked for.
    """

    def __init__(self, vehicle: RotorVehicle, priority: bool) -> None:
        self._priority = priority
        n, arm = vehicle.rotors, vehicle.arm_m
        self.places: list[tuple[float, float]] = []
        spins: list[float] = []
        for i in range(n):
            angle = math.tau * (i + 0.5) / n
            self.places.append((arm * cos(angle), arm * sin(angle)))
            spins.append(1.0 if i % 2 == 0 else -1.0)
        self.spins = spins
        sx, sy = sum(y * y for _, y in self.places), sum(x * x for x, _ in self.places)
        # moment about x (forward) of a thrust at (x, y) is y F, about y (left) -x F
        self._roll = [y / sx for _, y in self.places]
        self._pitch = [-x / sy for x, _ in self.places]
        self._yaw = [s / (n * vehicle.yaw_arm_m) for s in spins]

    def mix(self, thrust: float, mx: float, my: float, mz: float, top: float) -> list[float]:
        """Thrust of each rotor, N, within 0..top under `priority`."""
        share = thrust / len(self.spins)
        parts = [a * mx + b * my + c * mz for a, b, c in zip(self._roll, self._pitch, self._yaw, strict=True)]
        low, high = min(parts), max(parts)
        if self._priority and (share + low < 0.0 or share + high > top):
            spread = high - low
            if spread > top:  # not even all of the range is enough: scale the moments down
                parts = [part * top / spread for part in parts]
                low, high = low * top / spread, high * top / spread
            share = min(max(share, -low), top - high)
        return [share + part for part in parts]
