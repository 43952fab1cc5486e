"""What the vehicle's instruments and its estimator make of the motion: sensor noise, filters, rates.

Accelerometer and gyro pass the autopilot's own low-pass at every tick; attitude, velocity and position are an estimator's: errors
that wander slowly with a little white noise on top, drawn when they are asked for.

The low-pass is the second-order Butterworth of ArduPilot's INS_ACCEL_FILTER and INS_GYRO_FILTER in its continuous form. A real autopilot
runs it at the sensor's rate (1 kHz and more), where it equals the continuous one; here it is solved exactly for inputs that are linear
between ticks, so that the result does not depend on the tick.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from scipy.linalg import expm

from flighttest.sim.noise import NoiseStream
from flighttest.sim.plants.plant import Motion


def _discretise(cutoff_hz: float, dt_s: float) -> tuple[float, ...]:
    """(a11 a12 a21 a22 b1 b2 c1 c2): x+ = A x + b u + c (u+ - u), state (output, its rate)."""
    w = 2.0 * np.pi * cutoff_hz
    full = np.zeros((4, 4))
    full[0, 1] = 1.0
    full[1, :3] = (-w * w, -np.sqrt(2.0) * w, w * w)
    full[2, 3] = 1.0 / dt_s
    e = expm(full * dt_s)
    return tuple(float(v) for v in (e[0, 0], e[0, 1], e[1, 0], e[1, 1], e[0, 2], e[1, 2], e[0, 3], e[1, 3]))


class LowPass3:
    """Three axes through one filter. cutoff_hz <= 0 passes everything."""

    __slots__ = ("_c", "_rx", "_ry", "_rz", "_ux", "_uy", "_uz", "off", "x", "y", "z")

    def __init__(self, cutoff_hz: float, dt_s: float, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> None:
        self.off = cutoff_hz <= 0.0
        self._c = (0.0,) * 8 if self.off else _discretise(cutoff_hz, dt_s)
        self.x, self.y, self.z = x, y, z
        self._ux, self._uy, self._uz = x, y, z
        self._rx = self._ry = self._rz = 0.0

    def update(self, x: float, y: float, z: float) -> None:
        """One tick on: the filtered values are then in `x`, `y`, `z`."""
        if self.off:
            self.x, self.y, self.z = x, y, z
            return
        a11, a12, a21, a22, b1, b2, c1, c2 = self._c
        u, d, s, r = self._ux, x - self._ux, self.x, self._rx
        self.x, self._rx = a11 * s + a12 * r + b1 * u + c1 * d, a21 * s + a22 * r + b2 * u + c2 * d
        u, d, s, r = self._uy, y - self._uy, self.y, self._ry
        self.y, self._ry = a11 * s + a12 * r + b1 * u + c1 * d, a21 * s + a22 * r + b2 * u + c2 * d
        u, d, s, r = self._uz, z - self._uz, self.z, self._rz
        self.z, self._rz = a11 * s + a12 * r + b1 * u + c1 * d, a21 * s + a22 * r + b2 * u + c2 * d
        self._ux, self._uy, self._uz = x, y, z


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations. accel: m/s^2 in a 400 Hz sample before the low-pass; *_wander: of the slowly varying part; accel_stays: of
    the accelerometer's bias, the same for all of a flight.

    Magnitudes as ArduPilot flights with a good mount show them: 0.1 m/s^2 and 0.05 m/s after the estimator, 0.1 deg.
    """

    accel_m_s2: float = 0.30
    gyro_rad_s: float = 0.004
    attitude_wander_rad: float = 0.0012
    attitude_rad: float = 0.0003
    velocity_wander_m_s: float = 0.03
    velocity_m_s: float = 0.008
    position_wander_m: float = 0.05
    position_m: float = 0.004
    voltage_v: float = 0.010
    pressure_m: float = 0.05
    accel_stays_m_s2: float = 0.0

    def scaled(self, factor: float) -> SensorNoise:
        """Everything louder or quieter by a factor."""
        return SensorNoise(**{f.name: factor * float(getattr(self, f.name)) for f in fields(self)})


class _Wander:
    """One slowly varying error: a first-order Gauss-Markov process, sampled whenever it is asked for."""

    __slots__ = ("_noise", "_sigma", "_t", "_tau", "value")

    def __init__(self, noise: NoiseStream, sigma: float, tau_s: float) -> None:
        self._noise, self._sigma, self._tau, self._t = noise, sigma, tau_s, 0.0
        self.value = sigma * noise.draw()

    def at(self, t_s: float) -> float:
        dt = t_s - self._t
        if dt > 0.0:
            keep = math.exp(-dt / self._tau)
            self.value = keep * self.value + self._sigma * math.sqrt(1.0 - keep * keep) * self._noise.draw()
            self._t = t_s
        return self.value


class Sensors:
    """Instruments of one vehicle. `update` once per tick; the rest when a message needs it."""

    def __init__(
        self,
        motion: Motion,
        tick_s: float,
        seed: int,
        noise: SensorNoise | None = None,
        accel_filter_hz: float = 20.0,
        gyro_filter_hz: float = 0.0,
    ) -> None:
        self.noise = noise or SensorNoise()
        self._motion, self._tick = motion, tick_s
        n = self.noise
        self._white = NoiseStream(seed, "white")
        slow = NoiseStream(seed, "wander")
        # White noise of one density whatever the tick: a 400 Hz sample has the stated deviation.
        self._accel_sigma = n.accel_m_s2 / math.sqrt(400.0 * tick_s)
        self._gyro_sigma = n.gyro_rad_s / math.sqrt(400.0 * tick_s)
        self._imu = NoiseStream(seed, "imu")
        stays = NoiseStream(seed, "stays")
        self._bias = tuple(n.accel_stays_m_s2 * stays.draw() for _ in range(3))
        self._attitude = [_Wander(slow, n.attitude_wander_rad, 4.0) for _ in range(3)]
        self._velocity = [_Wander(slow, n.velocity_wander_m_s, 3.0) for _ in range(3)]
        self._position = [_Wander(slow, n.position_wander_m, 8.0) for _ in range(3)]
        self._pressure = _Wander(slow, n.pressure_m, 10.0)
        self.set_filters(accel_filter_hz, gyro_filter_hz)

    def set_filters(self, accel_filter_hz: float, gyro_filter_hz: float) -> None:
        """Change INS_ACCEL_FILTER and INS_GYRO_FILTER, Hz; 0 is none."""
        m = self._motion
        self.accel = LowPass3(accel_filter_hz, self._tick, m.fx, m.fy, m.fz)
        self.gyro = LowPass3(gyro_filter_hz, self._tick, m.p, m.q, m.r)

    def update(self) -> None:
        """One tick: what the inertial sensors sample."""
        m, draw, sigma, (x, y, z) = self._motion, self._imu.draw, self._accel_sigma, self._bias
        self.accel.update(m.fx + x + sigma * draw(), m.fy + y + sigma * draw(), m.fz + z + sigma * draw())
        sigma = self._gyro_sigma
        self.gyro.update(m.p + sigma * draw(), m.q + sigma * draw(), m.r + sigma * draw())

    def attitude(self, t_s: float) -> tuple[float, float, float]:
        """Estimated roll, pitch, yaw, rad."""
        m, w, draw, a = self._motion, self.noise.attitude_rad, self._white.draw, self._attitude
        return (
            m.roll + a[0].at(t_s) + w * draw(),
            m.pitch + a[1].at(t_s) + w * draw(),
            m.yaw + a[2].at(t_s) + w * draw(),
        )

    def velocity(self, t_s: float) -> tuple[float, float, float]:
        """Estimated velocity, m/s, NWU."""
        m, w, draw, a = self._motion, self.noise.velocity_m_s, self._white.draw, self._velocity
        return m.vx + a[0].at(t_s) + w * draw(), m.vy + a[1].at(t_s) + w * draw(), m.vz + a[2].at(t_s) + w * draw()

    def position(self, t_s: float) -> tuple[float, float, float]:
        """Estimated position, m, NWU."""
        m, w, draw, a = self._motion, self.noise.position_m, self._white.draw, self._position
        return m.px + a[0].at(t_s) + w * draw(), m.py + a[1].at(t_s) + w * draw(), m.pz + a[2].at(t_s) + w * draw()

    def voltage(self) -> float:
        """Measured battery voltage, V."""
        return self._motion.voltage + self.noise.voltage_v * self._white.draw()

    def pressure_height(self, t_s: float) -> float:
        """Height by the barometer, m."""
        return self._motion.pz + self._pressure.at(t_s)
