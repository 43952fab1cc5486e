"""Attitude targets as MAVLink's SET_ATTITUDE_TARGET, and back: the one place with its signs and its mask."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flighttest import frames
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, dialect

FloatArray = NDArray[np.float64]

MASK_ATTITUDE_ONLY = 7
MASK_ATTITUDE_AND_RATES = 0
_IGNORE_YAW_RATE = dialect.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
_IGNORE_THROTTLE = dialect.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
_IGNORE_ATTITUDE = dialect.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE

REFERENCE_FIELDS = ("type_mask", "q", "body_yaw_rate", "thrust")


def target_message(
    *,
    t_vehicle_s: float,
    system: int,
    roll_rad: float,
    pitch_rad: float,
    yaw_rad: float,
    yaw_rate_rad_s: float | None,
    throttle: float,
) -> Message:
    """SET_ATTITUDE_TARGET of an NWU/FLU attitude.

    t_vehicle_s: sending time on the vehicle's clock, s. yaw_rad: the absolute heading that goes into the quaternion (NWU).
    yaw_rate_rad_s: body rate, left positive; None sends attitude only (mask 7), a number sends attitude and body rates (mask
    0: ArduPilot refuses mixed bits).
    """
    q = frames.flip_quaternion(frames.quaternion_from_euler([roll_rad, pitch_rad, yaw_rad]))
    rates = frames.flip_vector([0.0, 0.0, yaw_rate_rad_s or 0.0])
    return dialect.MAVLink_set_attitude_target_message(
        time_boot_ms=int(max(t_vehicle_s, 0.0) * 1e3 + 1e-6)
        & 0xFFFFFFFF,  # 4.007 s is 4007 ms, whatever its binary digits
        target_system=system,
        target_component=COMPONENT_AUTOPILOT,
        type_mask=MASK_ATTITUDE_ONLY if yaw_rate_rad_s is None else MASK_ATTITUDE_AND_RATES,
        q=[float(x) for x in q],
        body_roll_rate=float(rates[0]),
        body_pitch_rate=float(rates[1]),
        body_yaw_rate=float(rates[2]),
        thrust=float(throttle),
    )


def reference_columns(raw: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
    """Reference channels (n,) from the fields `REFERENCE_FIELDS` of n SET_ATTITUDE_TARGET messages.

    Parts that the mask has the vehicle ignore are NaN, except the yaw rate: attitude alone means a heading held, so it is 0.
    """
    mask = np.asarray(raw["type_mask"], dtype=int)
    roll, pitch, _ = attitude_columns(raw["q"])
    ignored = (mask & _IGNORE_ATTITUDE) != 0
    rate = frames.flip_vector(
        np.stack([np.zeros(mask.shape), np.zeros(mask.shape), np.asarray(raw["body_yaw_rate"], dtype=float)], axis=-1)
    )[..., 2]
    return {
        "roll_ref_rad": np.where(ignored, np.nan, roll),
        "pitch_ref_rad": np.where(ignored, np.nan, pitch),
        "yaw_rate_ref_rad_s": np.where(mask & _IGNORE_YAW_RATE, 0.0, rate),
        "throttle": np.where(mask & _IGNORE_THROTTLE, np.nan, np.asarray(raw["thrust"], dtype=float)),
    }


def attitude_columns(q_ned: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Roll, pitch, yaw (NWU/FLU, rad) of quaternions (n, 4) as MAVLink carries them; NaN where one has no length."""
    q = np.asarray(q_ned, dtype=float).reshape(-1, 4)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        q = np.where(length > 0.5, q / length, np.nan)
    rpy = frames.euler_from_quaternion(frames.flip_quaternion(q))
    return rpy[:, 0], rpy[:, 1], rpy[:, 2]
