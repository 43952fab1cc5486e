"""Known second-order Butterworth filters of measured channels, exact for outputs that are quadratic within a piece.

The filter's state (its output and that output's rate) after a piece is E(h) times the state before it plus what the output's course within
the piece forces: the forcing of all pieces is found at once, and a product of 2 x 2 matrices is left in sequence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SHORTEST_S = 1e-7  # of a piece


def filtered(cutoff_hz: float, ends: Sequence[FloatArray], h: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """(n, ...) at the end of each piece, of outputs (n, ...) at the start, middle and end of each, or of their derivatives; at rest before
    the first. h: (n,) lengths, s; shape: (pieces, responses), n in all, one piece of every response after the other."""
    w, h = 2.0 * math.pi * cutoff_hz, np.maximum(h, SHORTEST_S)
    forced = forced_response(w, (ends[0], ends[1], ends[2]), h.reshape(-1, *[1] * (ends[0].ndim - 1)))
    force = np.stack(forced, axis=1).reshape(*shape, 2, -1)
    matrix = np.stack(free_response(np, w, h), axis=-1).reshape(*shape, 2, 2)
    z, made = np.zeros(force.shape[1:]), np.empty_like(force)
    z[:, 0] = ends[0][: shape[1]].reshape(shape[1], -1)
    for i in range(shape[0]):
        z = np.matmul(matrix[i], z, out=made[i])
        z += force[i]
    return np.asarray(made[:, :, 0].reshape(ends[0].shape))


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
