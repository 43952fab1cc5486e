"""Internal resistance of the battery: invisible to K (U/U_n)^alpha where the loaded voltage is logged, so it has a monitor of its own."""

from __future__ import annotations

import math

import numpy as np

from flighttest.validity.model import BatteryCheck, FloatArray

MIN_SAMPLES = 60
MIN_CURRENT_SPREAD_A = 2.0  # standard deviation; below, the slope is not known
BLOCK_S = 5.0  # samples within one block share what the battery remembers; blocks are the units of the error
ALARM_RATIO = 1.10
Z_ALARM = 3.0


def resistance(t_s: FloatArray, voltage_v: FloatArray, current_a: FloatArray) -> tuple[float, float] | str:
    """Slope of voltage against current, Ohm, and its standard error; or the reason why it cannot be determined.

    Both are compared with their own mean over `BLOCK_S`, so that the discharge drops out; the error is cluster-robust over blocks.
    """
    good = np.isfinite(voltage_v) & np.isfinite(current_a)
    t, u, i = t_s[good], voltage_v[good], current_a[good]
    if t.size < MIN_SAMPLES:
        return "battery resistance: UNTESTABLE, no current is recorded; connect and calibrate a current sensor"
    blocks = ((t - t[0]) // BLOCK_S).astype(int)
    _, index = np.unique(blocks, return_inverse=True)
    count = np.bincount(index)
    u = u - (np.bincount(index, u) / count)[index]
    i = i - (np.bincount(index, i) / count)[index]
    if float(np.std(i)) < MIN_CURRENT_SPREAD_A:
        return "battery resistance: UNTESTABLE, the current hardly changes in this recording; fly thrust steps"
    power = float(i @ i)
    slope = float(i @ u) / power
    scores = np.bincount(index, i * (u - slope * i))
    error = math.sqrt(float(scores @ scores)) / power * math.sqrt(len(count) / max(len(count) - 1, 1))
    return -slope, error


def check_resistance(new: tuple[float, float] | str, reference: tuple[float, float] | None) -> BatteryCheck:
    """Compare with the resistance stored with the model."""
    if isinstance(new, str):
        return BatteryCheck(None, reference, False, new)
    value, std = new
    half_width = 1.96 * std * 1000.0
    places = min(max(1 - math.floor(math.log10(half_width)), 0), 2) if half_width > 0.0 else 2
    words = f"battery resistance {value * 1000:.{places}f} ± {half_width:.{places}f} mOhm"
    if reference is None:
        return BatteryCheck(new, None, False, f"{words}; the model carries none to compare with")
    ratio = value / reference[0] if reference[0] else math.inf
    z = (value - reference[0]) / max(math.hypot(std, reference[1]), 1e-9)
    alarm = ratio > ALARM_RATIO and z > Z_ALARM
    tail = f"{(ratio - 1) * 100:+.0f} % against the model's run"
    return BatteryCheck(new, reference, alarm, f"{words}, {tail}{' (an aged or another battery)' if alarm else ''}")
