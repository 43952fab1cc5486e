"""The paper's delay (dead time): time from an applied input to the first observed change, per response; and start values from the shape.

Onset alone is late by 1 to 20 ms depending on amplitude and noise: it is reported, and used to start the joint estimate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.responses import zero_order_hold
from flighttest.frames import G_M_S2
from flighttest.physics.model import Model
from flighttest.segments.metrics import crossing
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

# kind of step: reference, measured channels in order of preference, delay channel
_STEPS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "roll_step": ("roll_ref_rad", ("roll_rad",), "attitude"),
    "pitch_step": ("pitch_ref_rad", ("pitch_rad",), "attitude"),
    "yaw_rate_step": ("yaw_rate_ref_rad_s", ("r_rad_s",), "yaw_rate"),
    "throttle_step": ("throttle", ("f_z_m_s2", "a_z_m_s2"), "thrust"),
}
# What is seen is late: the threshold is crossed some ms after the response begins.
LATE_S = {"attitude": 0.01, "yaw_rate": 0.003, "thrust": 0.004}
_FLOOR = {"roll_rad": 0.003, "pitch_rad": 0.003, "r_rad_s": 0.02, "f_z_m_s2": 0.1, "a_z_m_s2": 0.1}


@dataclass(frozen=True)
class Onset:
    """One response's shape: delay until the change is seen, then times from there, s; None where undefined."""

    channel: str
    kind: str
    delay_s: float
    t63_s: float | None
    rise_s: float | None
    overshoot: float | None
    gain: float | None


@dataclass(frozen=True)
class OnsetDelay:
    """The paper's estimate. mean_s, std_s: over responses; count; per channel: mean, s."""

    mean_s: float
    std_s: float
    count: int
    channel_s: Mapping[str, float]


def onset(segment: Segment) -> Onset | None:
    """The shape of one step response; None where there is no step or no change is seen."""
    if segment.kind not in _STEPS:
        return None
    reference, candidates, channel = _STEPS[segment.kind]
    name = next((c for c in candidates if np.isfinite(segment.y.get(c, np.empty(0))).sum() > 8), None)
    if name is None or reference not in segment.u:
        return None
    times, values = segment.u[reference]
    later = np.flatnonzero(times >= segment.t_step_s - 1e-3)
    if not later.size:
        return None
    first = int(later[0])
    t_in, after = float(times[first]), float(values[first])
    before = float(values[first - 1]) if first else 0.0
    until = float(times[first + 1]) if first + 1 < times.size else math.inf
    good = np.isfinite(segment.y[name])
    t, y = segment.t_s[good], segment.y[name][good]
    quiet = t <= t_in + 1e-6
    active = (t > t_in) & (t < until + 0.05)
    if active.sum() < 8:
        return None
    early = y[quiet] if quiet.sum() >= 3 else y[active][:2]
    base, spread = float(np.mean(early)), float(np.std(early)) if early.size > 2 else _FLOOR[name]
    tail = y[active][-max(3, int(active.sum() // 5)) :]
    change = float(np.median(tail)) - base
    peak = float(np.max((y[active] - base) * np.sign(change)))
    threshold = max(4.0 * spread, _FLOOR[name], 0.04 * abs(change))
    if peak < 2.0 * threshold or after == before:
        return None
    moved = (y[active] - base) * np.sign(change)
    ta = t[active]
    seen = crossing(ta, moved, threshold)
    if seen is None:
        return None
    t10, t63, t90 = (crossing(ta, moved, share * abs(change)) for share in (0.1, 0.632, 0.9))
    return Onset(
        channel,
        segment.kind,
        seen - t_in,
        None if t63 is None else t63 - seen,
        None if t10 is None or t90 is None else t90 - t10,
        max(0.0, peak / abs(change) - 1.0) if segment.kind in ("roll_step", "pitch_step") else None,
        None if name == "r_rad_s" or after == before else change / (after - before),
    )


def onset_delay(segments: Sequence[Segment]) -> OnsetDelay | None:
    """The paper's T_d: mean over all responses in which a change is seen; None where there is none."""
    found = [o for s in segments if s.usable and (o := onset(s)) is not None and 0.0 <= o.delay_s < 0.6]
    if not found:
        return None
    every = np.array([o.delay_s for o in found])
    channels = {
        c: float(np.mean([o.delay_s for o in found if o.channel == c])) for c in dict.fromkeys(o.channel for o in found)
    }
    return OnsetDelay(float(every.mean()), float(every.std()), len(found), channels)


def start_values(segments: Sequence[Segment], model: Model, delay: OnsetDelay | None) -> dict[str, float]:
    """Rough parameters from the shapes of the responses, to start the solver from. Only names the model has."""
    found = [o for s in segments if s.usable and (o := onset(s)) is not None]
    values: dict[str, float] = {}

    def median(numbers: list[float]) -> float | None:
        return float(np.median(numbers)) if numbers else None

    for axis, kind in (("phi", "roll_step"), ("theta", "pitch_step")):
        mine = [o for o in found if o.kind == kind]
        rise, over = (
            median([o.rise_s for o in mine if o.rise_s]),
            median([o.overshoot for o in mine if o.overshoot is not None]),
        )
        if rise is not None and over is not None:
            log = math.log(min(max(over, 0.01), 0.9))
            zeta = -log / math.hypot(math.pi, log)
            values[f"zeta_{axis}"] = min(max(zeta, 0.15), 1.2)
            values[f"omega_{axis}"] = (0.6 + 2.16 * values[f"zeta_{axis}"]) / max(rise, 0.01)
    for name, kind in (("sigma_r", "yaw_rate_step"), ("sigma_t", "throttle_step")):
        t63 = median([o.t63_s for o in found if o.kind == kind and o.t63_s])
        if t63 is not None:
            values[name] = 1.0 / max(t63, 1.0 / 30.0)  # an onset seen late makes the rest look quick
    gain = thrust_gain(segments, model.nominal_voltage_v)
    if gain is not None:
        values["K"] = gain
    if delay is not None:
        for channel, seen in delay.channel_s.items():
            values[f"T_d_{channel}"] = max(seen - LATE_S[channel], 0.004)
        values["T_d"] = max(delay.mean_s - 0.006, 0.004)
    params = model.param
    return {k: min(max(v, params[k].lower * 1.01), params[k].upper * 0.99) for k, v in values.items() if k in params}


def thrust_gain(segments: Sequence[Segment], nominal_voltage_v: float) -> float | None:
    """Median of specific force over throttle at nominal voltage, m/s^2."""
    ratios: list[FloatArray] = []
    for s in segments:
        if not s.usable or "throttle" not in s.u:
            continue
        f = s.y.get("f_z_m_s2")
        if f is None and "a_z_m_s2" in s.y:
            f = s.y["a_z_m_s2"] + G_M_S2
        if f is None and "v_z_m_s" in s.y and s.t_s.size > 4:
            f = np.gradient(s.y["v_z_m_s"], s.t_s) + G_M_S2
        if f is None:
            continue
        throttle = zero_order_hold(s.u["throttle"], s.t_s - 0.15)
        voltage = s.y.get("voltage_v", np.full(s.t_s.size, np.nan))
        voltage = np.where(np.isfinite(voltage), voltage, nominal_voltage_v)
        good = np.isfinite(f) & (throttle > 0.03)
        ratios.append((f / np.maximum(throttle, 0.03) / (voltage / nominal_voltage_v) ** 1.5)[good])
    every = np.concatenate(ratios) if ratios else np.empty(0)
    return float(np.median(every)) if every.size > 20 else None
