"""Frames, quaternions and angles: the only place that converts NED from NWU.

Inside the package the world is North-West-Up (NWU) and the body Forward-Left-Up (FLU); R = R_psi R_theta R_phi maps body to
world (paper Eq. 2). MAVLink and ArduPilot use NED and FRD. Both conversions are the same half turn about x, hence each
function here is its own inverse: quaternion (w, x, -y, -z); roll kept, pitch and yaw negated; vectors (x, -y, -z).

Quaternions are (w, x, y, z), Hamilton, body to world. All functions take arrays with the components on the last axis.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

G_M_S2 = 9.81  # of the paper; down in every world frame here

_FLIP_VECTOR = np.array([1.0, -1.0, -1.0])
_FLIP_QUATERNION = np.array([1.0, 1.0, -1.0, -1.0])


def _parts(values: FloatArray) -> list[Any]:
    """Components on the last axis: arrays, or of a single vector plain numbers, which are quicker to calculate with and round the same."""
    return values.tolist() if values.ndim == 1 else list(np.moveaxis(values, -1, 0))


def _joined(parts: list[Any]) -> FloatArray:
    """The reverse of `_parts`."""
    return np.array(parts) if isinstance(parts[0], float) else np.stack(parts, axis=-1)


def flip_vector(vector: ArrayLike) -> FloatArray:
    """NED to NWU, FRD to FLU, and back: (..., 3) positions, velocities, accelerations or rates."""
    flipped: FloatArray = np.multiply(np.asarray(vector, dtype=float), _FLIP_VECTOR)
    return flipped


def flip_quaternion(q: ArrayLike) -> FloatArray:
    """Attitude FRD-to-NED as FLU-to-NWU, and back: (..., 4)."""
    flipped: FloatArray = np.multiply(np.asarray(q, dtype=float), _FLIP_QUATERNION)
    return flipped


def flip_euler(rpy: ArrayLike) -> FloatArray:
    """Roll, pitch, yaw (rad) of FRD in NED as those of FLU in NWU, and back: (..., 3)."""
    flipped: FloatArray = np.multiply(np.asarray(rpy, dtype=float), _FLIP_VECTOR)
    return flipped


def flip_components(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """The components of a vector, or roll, pitch and yaw, from NED to NWU or FRD to FLU, and back; numbers or arrays."""
    return x, -y, -z


_ENU_TO_NWU_QUATERNION = np.array([math.cos(-math.pi / 4), 0.0, 0.0, math.sin(-math.pi / 4)])


def quaternion_enu_to_nwu(q: ArrayLike) -> FloatArray:
    """Attitude given against East-North-Up as one against NWU (yaw_NWU = yaw_ENU - 90 deg): (..., 4)."""
    return quaternion_multiply(_ENU_TO_NWU_QUATERNION, q)


def quaternion_multiply(p: ArrayLike, q: ArrayLike) -> FloatArray:
    """Hamilton product p q: (..., 4)."""
    pw, px, py, pz = np.moveaxis(np.asarray(p, dtype=float), -1, 0)
    qw, qx, qy, qz = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )


def euler_from_quaternion(q: ArrayLike) -> FloatArray:
    """Roll, pitch, yaw (rad, ZYX) of a unit quaternion: (..., 4) to (..., 3)."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def quaternion_from_euler(rpy: ArrayLike) -> FloatArray:
    """Unit quaternion of roll, pitch, yaw (rad, ZYX): (..., 3) to (..., 4)."""
    half = 0.5 * np.asarray(rpy, dtype=float)
    cr, cp, cy = _parts(np.cos(half))
    sr, sp, sy = _parts(np.sin(half))
    return _joined(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def rotation_from_euler(rpy: ArrayLike) -> FloatArray:
    """R, body to world (paper Eq. 2), of roll, pitch, yaw (rad): (..., 3) to (..., 3, 3)."""
    rpy = np.asarray(rpy, dtype=float)
    cr, cp, cy = _parts(np.cos(rpy))
    sr, sp, sy = _parts(np.sin(rpy))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.array(rows) if rpy.ndim == 1 else np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_rates_from_body(rpy: ArrayLike, rates: ArrayLike) -> FloatArray:
    """(..., 3) rates of roll, pitch and yaw, rad/s, from these angles, rad, and body rates p, q, r, rad/s."""
    (roll, pitch, _), (p, q, r) = (np.moveaxis(np.asarray(x, dtype=float), -1, 0) for x in (rpy, rates))
    turning = np.sin(roll) * q + np.cos(roll) * r
    return np.stack(
        [p + np.tan(pitch) * turning, np.cos(roll) * q - np.sin(roll) * r, turning / np.cos(pitch)], axis=-1
    )


def wrap_angle(angle_rad: Any) -> Any:
    """The same angle in [-pi, pi): float to float, array to array."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


def yaw_from_compass(heading_deg: float) -> float:
    """NWU yaw (rad, counter-clockwise from north) of a compass heading (deg, clockwise from north)."""
    return float(wrap_angle(-math.radians(heading_deg)))


def compass_from_yaw(yaw_rad: float) -> float:
    """Compass heading (deg, clockwise from north, [0, 360)) of an NWU yaw (rad)."""
    return float(-math.degrees(yaw_rad) % 360.0)
