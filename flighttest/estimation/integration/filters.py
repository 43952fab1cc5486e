"""Known second-order Butterworth filters of measured channels, exact for outputs that are quadratic within a piece.

The filter's state (its output and that output's rate) after a piece is E(h) times the state before it plus what the output's course within
the piece forces: the forcing of all pieces is found at once, and a product of 2 x 2 matrices is left in sequence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass
class Lag:
    """Where the filters stand: z (m, 2, n_filters), and its derivatives dz (m, 2, n_filters, n_columns)."""

    z: FloatArray
    dz: FloatArray


@dataclass(frozen=True)
class Butterworth:
    """Filters side by side. cutoffs_hz: (n_filters,)."""

    cutoffs_hz: tuple[float, ...]
    SHORTEST_S: ClassVar[float] = 1e-7

    @classmethod
    def of(cls, cutoffs_hz: Sequence[float]) -> Butterworth:
        """Filters of these cut-offs, Hz."""
        return cls(tuple(cutoffs_hz))

    def start(self, y: FloatArray) -> Lag:
        """At rest at these outputs, (n_filters, m)."""
        z = np.zeros((y.shape[1], 2, y.shape[0]))
        z[:, 0] = y.T
        return Lag(z, np.zeros((*z.shape, 0)))

    def start_slopes(self, lag: Lag, dy: FloatArray) -> None:
        """The same of their derivatives, (m, n_filters, n_columns)."""
        lag.dz = np.zeros((dy.shape[0], 2, *dy.shape[1:]))
        lag.dz[:, 0] = dy

    def run(self, lag: Lag, y: Sequence[FloatArray], h: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """Filtered outputs (n_filters, n) at the end of each piece; moves `lag` on.

        y: outputs (n_filters, n) at the start, middle and end of each piece; h: (n,) lengths, s; shape: (pieces, responses), n in all.
        """
        out = np.empty_like(y[0])
        for members, w in self._alike():
            made = self._values(lag, [v[members] for v in y], w, members, h, shape)
            out[members] = made[:, :, 0].reshape(-1, len(members)).T
        return out

    def run_with_slopes(
        self,
        lag: Lag,
        y: Sequence[FloatArray],
        dy: Sequence[FloatArray],
        h: FloatArray,
        shape: tuple[int, int],
    ) -> tuple[FloatArray, FloatArray]:
        """The same with derivatives (n, n_filters, n_columns), given those of the outputs."""
        out, d_out = np.empty_like(y[0]), np.empty_like(dy[0])
        for members, w in self._alike():
            ends = [v[members] for v in y]
            values = self._values(lag, ends, w, members, h, shape)
            out[members] = values[:, :, 0].reshape(-1, len(members)).T
            forced = forced_response(
                w, (dy[0][:, members], dy[1][:, members], dy[2][:, members]), _safe(h)[:, None, None]
            )
            force = np.stack(forced, axis=1).reshape(*shape, 2, -1)
            matrix = _matrix(w, h).reshape(*shape, 2, 2)
            dz = lag.dz[:, :, members].reshape(shape[1], 2, -1)
            made = np.empty_like(force)
            for i in range(shape[0]):
                np.matmul(matrix[i], dz, out=made[i])
                made[i] += force[i]
                dz = made[i]
            lag.dz[:, :, members] = dz.reshape(shape[1], 2, len(members), -1)
            d_out[:, members] = made[:, :, 0].reshape(h.size, len(members), -1)
        return out, d_out

    def _values(
        self, lag: Lag, y: Sequence[FloatArray], w: float, members: list[int], h: FloatArray, shape: tuple[int, int]
    ) -> FloatArray:
        """Filter states after each piece, (pieces, responses, 2, members); moves them on."""
        force = np.stack([f.T for f in forced_response(w, (y[0], y[1], y[2]), _safe(h))], axis=1).reshape(*shape, 2, -1)
        matrix = _matrix(w, h).reshape(*shape, 2, 2)
        made = np.empty((shape[0] + 1, *force.shape[1:]))
        made[0] = lag.z[:, :, members]
        for i in range(shape[0]):
            np.matmul(matrix[i], made[i], out=made[i + 1])
            made[i + 1] += force[i]
        lag.z[:, :, members] = made[-1]
        return made[1:]

    def _alike(self) -> list[tuple[list[int], float]]:
        """Filters of one cut-off, and its angular frequency, rad/s."""
        return [
            ([i for i, f in enumerate(self.cutoffs_hz) if f == hz], 2.0 * math.pi * hz)
            for hz in dict.fromkeys(self.cutoffs_hz)
        ]


def _safe(h: FloatArray) -> FloatArray:
    return np.maximum(h, Butterworth.SHORTEST_S)


def _matrix(w: float, h: FloatArray) -> FloatArray:
    """E of each piece, (n, 2, 2)."""
    e11, e12, e21, e22 = free_response(np, w, _safe(h))
    return np.stack([np.stack([e11, e12], axis=-1), np.stack([e21, e22], axis=-1)], axis=-2)


def free_response(lib: Any, w: float, h: Any) -> tuple[Any, Any, Any, Any]:
    """exp(A h) of w^2/(s^2 + sqrt(2) w s + w^2) for the state (output, its rate), as (e11, e12, e21, e22). lib: numpy or casadi."""
    a = w / math.sqrt(2.0)
    decay, c, s = lib.exp(-a * h), lib.cos(a * h), lib.sin(a * h)
    return decay * (c + s), decay * s / a, -2 * a * decay * s, decay * (c - s)


def forced_response(w: float, y: tuple[Any, Any, Any], h: Any, lib: Any = np) -> tuple[Any, Any]:
    """What the parabola through a piece's ends and middle adds to the filter's output and its rate after a piece of length h."""
    e11, e12, e21, e22 = free_response(lib, w, h)
    (y0, ym, y1), lag = y, math.sqrt(2.0) / w
    bend = ym - 0.5 * (y0 + y1)
    u2 = -4.0 * bend / h**2
    u1 = (y1 - y0) / h + 4.0 * bend / h
    # Particular solution a + b t + u2 t^2 of the filter's equation for the input y0 + u1 t + u2 t^2.
    b = u1 - 2.0 * lag * u2
    a = y0 - 2.0 * u2 / w**2 - lag * b
    return a + b * h + u2 * h**2 - e11 * a - e12 * b, b + 2.0 * u2 * h - e21 * a - e22 * b
