"""The throttle that holds height: what a free flight determines of thrust or mass where K and its lag cannot be distinguished."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.estimation.level import taken_as_level
from flighttest.estimation.responses import attitude_is_known, zero_order_hold
from flighttest.estimation.uncertainty.distributions import beyond, quantile
from flighttest.frames import G_M_S2
from flighttest.segments import Segment
from flighttest.validity.model import FloatArray, SubsetTest

MIN_WINDOW_S = 1.0
DISCREPANCY = 0.015  # relative, one sigma: what one flight after another differs by (packs, air density)
UNKNOWN_VOLTAGE = 0.015  # on top of it where no voltage was recorded
NAME = "hover_throttle"


@dataclass(frozen=True)
class Hover:
    """throttle: middle over the recordings; std: of it; dof of std; log_voltage: ln(U / U_n), None where it was not recorded."""

    throttle: float
    std: float
    dof: float
    log_voltage: float | None


def hover(segments: Sequence[Segment], nominal_voltage_v: float) -> Hover | None:
    """From windows of free flight; None where there are too few. Recordings are the units of the error."""
    found: dict[str, list[tuple[float, float]]] = {}
    for s in segments:
        if s.usable and s.kind == "free" and not s.between_steps and (one := _window(s)) is not None:
            found.setdefault(s.run, []).append(one)
    windows = [one for runs in found.values() for one in runs]
    if len(windows) < 3:
        return None
    # One recording's windows share its pack and its air; several recordings show what those do.
    units = [np.mean([t for t, _ in runs]) for runs in found.values()] if len(found) > 1 else [t for t, _ in windows]
    volts = [v for _, v in windows if np.isfinite(v)]
    there = math.log(float(np.mean(volts)) / nominal_voltage_v) if volts else None
    values = np.array(units, dtype=float)
    std = float(np.std(values, ddof=1)) / math.sqrt(values.size)
    return Hover(float(np.mean(values)), std, float(values.size - 1), there)


def _window(s: Segment) -> tuple[float, float] | None:
    """Throttle that would hold height, and voltage, of one window: its mean, for its mean tilt and climb."""
    climb = s.y.get("v_z_m_s")
    if "throttle" not in s.u or climb is None or not (attitude_is_known(s) or taken_as_level(s)):
        return None
    level = np.zeros(s.t_s.size)
    roll, pitch = s.y.get("roll_rad", level), s.y.get("pitch_rad", level)
    known = np.isfinite(climb)
    duration = float(s.t_s[known][-1] - s.t_s[known][0]) if known.sum() > 1 else 0.0
    if duration < MIN_WINDOW_S:
        return None
    up = np.cos(roll) * np.cos(pitch) * zero_order_hold(s.u["throttle"], s.t_s)
    a_z = float(climb[known][-1] - climb[known][0]) / duration
    volts = s.y.get("voltage_v", np.full(1, np.nan))
    lift = float(np.nanmean(up)) / (1.0 + a_z / G_M_S2)
    return (lift, float(np.nanmean(volts)) if np.isfinite(volts).any() else math.nan) if lift > 0.0 else None


def hover_test(stored: Hover, new: Hover, alpha: float | None, level: float) -> SubsetTest:
    """Thrust by the throttle that holds height. alpha: exponent of the voltage, None where it is not known."""
    change = math.log(new.throttle / stored.throttle)
    doubt = DISCREPANCY
    if stored.log_voltage is None or new.log_voltage is None:
        doubt = math.hypot(doubt, UNKNOWN_VOLTAGE)
    else:
        away = new.log_voltage - stored.log_voltage
        # A battery that the autopilot compensates for has alpha 0, a bare one 1.7.
        change += (0.85 if alpha is None else alpha) * away
        doubt = math.hypot(doubt, (0.6 if alpha is None else 0.1) * away)
    parts: FloatArray = np.array([stored.std / stored.throttle, new.std / new.throttle])
    total = float(parts @ parts) + doubt**2
    dof = total**2 / max(float(parts[0] ** 4 / stored.dof + parts[1] ** 4 / new.dof), 1e-12)
    z = change / math.sqrt(total)
    p_value = beyond(z, dof)
    alarm = p_value < level
    verb = "rose" if change > 0 else "fell"
    share = math.expm1(change)
    words = f"the throttle that holds height {verb} {abs(share) * 100:.1f} %"
    sentence = f"{words} (chance of this without a change: {p_value:.1g})" if alarm else f"{words}: no more than usual"
    detectable = {NAME: -quantile(level / 2.0, dof) * math.sqrt(total)}
    return SubsetTest("thrust", z * z, 1, p_value, level, alarm, {NAME: (share, z)}, sentence, detectable)
