"""ArduCopter's attitude control of one axis, as its source has it (AC_AttitudeControl, AC_PID; 4.3 to 4.7), around a frame with motors.

Target shaping, angle controller, rate controller and their filters at 400 Hz; the frame turns its output 0..1 into an angular acceleration
through a first-order lag. Left out: slew and sum limits of the rate controller, notch filters, boosts on fast throttle changes.

Two numbers are of the firmware as it runs here, on a physics of 800 steps a second, and were measured: a frame of 400 rad/s^2 and 6.8 ms,
flown under it, looked like one of 374 rad/s^2 and 8.6 ms through these loops without them, and like 397 and 6.6 with them; the rotor
vehicle's own 426 rad/s^2 and 5 ms came out as 401 and 7.1, with them as 428 and 5.0.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LOOP_S = 0.0025
_SUBSTEPS = 2  # of the physics behind the firmware, whose gyro filter runs at that rate
_OUTPUT_STEPS = 2  # of the physics, until what the controller put out turns the frame
# From a throttle's arrival to the motors: the next loop's output. Two flights of a twin under the firmware had 5.0 and 4.6 ms.
THRUST_DELAY_S = LOOP_S + _OUTPUT_STEPS * LOOP_S / _SUBSTEPS
_GYRO_BAND = 1.25  # cut-off of the gyro filter, of the one that is set
# What the firmware does where nothing is set (AC_AttitudeControl.h, AC_AttitudeControl_Multi.h, AP_InertialSensor.cpp).
DEFAULTS: dict[str, float] = {
    "ATC_RATE_FF_ENAB": 1.0, "ATC_INPUT_TC": 0.15, "INS_GYRO_FILTER": 20.0,
    **{f"ATC_ACCEL_{a}_MAX": v for a, v in (("R", 110000.0), ("P", 110000.0), ("Y", 27000.0))},
    **{f"ATC_RATE_{a}_MAX": 0.0 for a in "RPY"},
    **{f"ATC_ANG_{a}_P": 4.5 for a in ("RLL", "PIT", "YAW")},
    **{f"ATC_RAT_{a}_{n}": v for a in ("RLL", "PIT")
       for n, v in (("P", 0.135), ("I", 0.135), ("D", 0.0036), ("FF", 0.0), ("FLTT", 20.0), ("FLTE", 0.0), ("FLTD", 20.0))},
    "ATC_RAT_YAW_P": 0.18, "ATC_RAT_YAW_I": 0.018, "ATC_RAT_YAW_D": 0.0, "ATC_RAT_YAW_FF": 0.0,
    "ATC_RAT_YAW_FLTT": 20.0, "ATC_RAT_YAW_FLTE": 2.5, "ATC_RAT_YAW_FLTD": 20.0,
}  # fmt: skip
AXES = {"roll": ("R", "RLL"), "pitch": ("P", "PIT"), "yaw": ("Y", "YAW")}
# Limits of the angle controller's acceleration, deg/s^2 (AC_AttitudeControl.h).
_CONTROLLER_DEG_S2 = {"roll": (40.0, 720.0), "pitch": (40.0, 720.0), "yaw": (10.0, 120.0)}


@dataclass(frozen=True)
class Loop:
    """Settings of one axis, SI: gains; filters Hz (0: none); tc: of the shaping, s; accel, rate_max: limits, rad/s^2 and rad/s (0: none);
    feedforward: whether the target is shaped at all; braking: acceleration the angle controller counts on, rad/s^2 (0: linear)."""

    angle_p: float
    rate_p: float
    rate_i: float
    rate_d: float
    rate_ff: float
    target_hz: float
    error_hz: float
    derivative_hz: float
    gyro_hz: float
    tc: float
    accel: float
    rate_max: float
    feedforward: bool
    braking: float


def loop_of(axis: str, parameters: Mapping[str, float]) -> Loop:
    """The loop of 'roll', 'pitch' or 'yaw' with these parameters, the firmware's defaults for the rest."""
    letter, name = AXES[axis]
    p = {**DEFAULTS, **current_names(parameters)}
    accel = math.radians(0.01 * p[f"ATC_ACCEL_{letter}_MAX"])
    low, high = (math.radians(v) for v in _CONTROLLER_DEG_S2[axis])
    kp, ki, kd, ff, filter_t, filter_e, filter_d = (
        p[f"ATC_RAT_{name}_{n}"] for n in ("P", "I", "D", "FF", "FLTT", "FLTE", "FLTD")
    )
    return Loop(
        angle_p=p[f"ATC_ANG_{name}_P"], rate_p=kp, rate_i=ki, rate_d=kd, rate_ff=ff,
        target_hz=filter_t, error_hz=filter_e, derivative_hz=filter_d, gyro_hz=p["INS_GYRO_FILTER"],
        tc=max(p["ATC_INPUT_TC"], 0.01), accel=accel, rate_max=math.radians(p[f"ATC_RATE_{letter}_MAX"]),
        feedforward=p["ATC_RATE_FF_ENAB"] > 0.0, braking=min(max(0.5 * accel, low), high) if accel > 0.0 else 0.0,
    )  # fmt: skip


def current_names(parameters: Mapping[str, float]) -> dict[str, float]:
    """Parameters under the names of 4.6 and before: 4.7 has ATC_ACC_R_MAX, deg/s^2, for ATC_ACCEL_R_MAX, centidegrees/s^2."""
    found = dict(parameters)
    for letter in "RPY":
        if f"ATC_ACC_{letter}_MAX" in found:
            found[f"ATC_ACCEL_{letter}_MAX"] = 100.0 * found.pop(f"ATC_ACC_{letter}_MAX")
    return found


def square_root(error: float, p: float, accel: float) -> float:
    """The rate towards a target: linear near it, with constant deceleration far from it (AP_Math, sqrt_controller)."""
    if accel <= 0.0:
        return p * error
    linear, rate = accel / (p * p) if p else 0.0, p * error
    if abs(error) > linear:
        rate = math.copysign(math.sqrt(2.0 * accel * (abs(error) - 0.5 * linear)), error)
    most = abs(error) / LOOP_S
    return min(max(rate, -most), most)


def simulate_loop(
    loop: Loop, gain: float, lag_s: float, angle: FloatArray, rate: FloatArray, most: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Angle rad and rate rad/s after every loop, (n,) each, from rest. gain: angular acceleration of a full output, rad/s^2; lag_s: of the
    motors; angle, rate (n,): the demanded angle rad and rate rad/s; most: output that the mixer lets through at the present throttle."""
    gyro_step = _low_pass_2(_GYRO_BAND * loop.gyro_hz, LOOP_S / _SUBSTEPS)
    under_way = deque([0.0] * _OUTPUT_STEPS)
    share_t, share_e, share_d = (_share(hz) for hz in (loop.target_hz, loop.error_hz, loop.derivative_hz))
    h = LOOP_S / _SUBSTEPS
    keep = math.exp(-h / lag_s)
    x = v = accel = gyro = 0.0
    target, target_rate, wanted = 0.0, 0.0, 0.0
    filtered = error = derivative = integral = 0.0
    angles, rates = np.empty(len(angle)), np.empty(len(angle))
    bound = loop.accel * LOOP_S
    for k, (to, to_rate) in enumerate(zip(angle.tolist(), rate.tolist(), strict=True)):
        filtered += share_t * (wanted - filtered)
        before = error
        error += share_e * (filtered - gyro - error)
        derivative += share_d * ((error - before) / LOOP_S - derivative)
        integral = min(max(integral + loop.rate_i * error * LOOP_S, -0.5), 0.5)
        out = loop.rate_p * error + integral + loop.rate_d * derivative + loop.rate_ff * filtered
        push = gain * min(max(out, -most), most)
        for _ in range(_SUBSTEPS):
            under_way.append(push)
            now = under_way.popleft()
            accel = now + (accel - now) * keep
            x += h * (v + 0.5 * h * accel)
            v += h * accel
            gyro = gyro_step(v)
        target += target_rate * LOOP_S
        if loop.feedforward:
            goal = to_rate + square_root(to - target, 1.0 / loop.tc, loop.accel)
            if loop.rate_max > 0.0:
                goal = min(max(goal, -loop.rate_max), loop.rate_max)
            target_rate = min(max(goal, target_rate - bound), target_rate + bound) if bound > 0.0 else goal
        else:
            target, target_rate = to, to_rate
        wanted = square_root(target - x, loop.angle_p, loop.braking)
        if loop.rate_max > 0.0:
            wanted = min(max(wanted, -loop.rate_max), loop.rate_max)
        wanted += target_rate
        angles[k], rates[k] = x, v
    return angles, rates


def _share(hz: float) -> float:
    """Of the new sample, of a first-order low-pass at the loop rate."""
    return 1.0 if hz <= 0.0 else LOOP_S / (LOOP_S + 1.0 / (math.tau * hz))


def _low_pass_2(hz: float, dt: float) -> Callable[[float], float]:
    """A second-order Butterworth low-pass, sample by sample (LowPassFilter2p)."""
    if hz <= 0.0:
        return lambda value: value
    ohm = math.tan(math.pi * hz * dt)
    c = 1.0 + 2.0 * math.cos(math.pi / 4.0) * ohm + ohm * ohm
    b0, a1 = ohm * ohm / c, 2.0 * (ohm * ohm - 1.0) / c
    a2 = (1.0 - 2.0 * math.cos(math.pi / 4.0) * ohm + ohm * ohm) / c
    d1 = d2 = 0.0

    def step(value: float) -> float:
        nonlocal d1, d2
        d0 = value - d1 * a1 - d2 * a2
        out = b0 * (d0 + 2.0 * d1 + d2)
        d1, d2 = d0, d1
        return out

    return step
