"""The second-order Butterworth low-pass of ArduPilot's INS_ACCEL_FILTER and INS_GYRO_FILTER, in its continuous form.

A real autopilot runs the filter at the sensor's rate (1 kHz and more), where it equals the continuous one; here it is solved exactly
for inputs that are linear between ticks, so that the result does not depend on the tick.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm


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
