"""A known effect added to a real recording: the difference that it makes is simulated beside the recording and added to it.

The recorded flight is followed sample by sample; beside it runs the same vehicle with the effect in it. Only their difference is
simulated: noise, wind and whatever else is in the recording stay as they are. Between scripted steps the controller answers the
difference (a position loop of a drawn bandwidth asks for tilt and throttle against it), so that commands change, too; in a step the
script's commands hold, on top of the throttle that hovered before it. World NWU, body FLU. Shares no line with the physics that diagnoses.

    f_B = f_A + (a_B - a_A) e_z - D (R_B' v_B - R_A' v_A) + effect(R_B, v_B, thrust),   v_B' - v_A' = R_B f_B - R_A f_A

f: specific force; a: thrust of the base model for the commands of each; D: linear drag; A: as recorded; B: with the effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, exp, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from flighttest.channels import CHANNELS, HELD_GROUPS
from flighttest.frames import G_M_S2
from flighttest.proof.oracle import body_to_world
from flighttest.proof.recorded.side_by_side import (
    DAMPING,
    STEP_S,
    AirEffects,
    AttitudeLoops,
    Effects,
    OracleVehicle,
    Thrust,
)
from flighttest.recording.model import Recording, Series
from flighttest.sim.plants.slung import SlungLoad

FloatArray = NDArray[np.float64]

SMOOTH_S = 0.2  # window over which a force is differentiated from velocities, or thrust is read off an accelerometer
# Window over which rates are differentiated, by quartics: steps of attitude have accelerations of 10 Hz, of which parabolas lose 40 %.
TURN_S = 0.07
GAP = 3.0  # sampling periods without a sample
MOST_TILT_RAD = 0.3  # that it asks for beyond the recorded


def inject(
    recording: Recording,
    effects: Effects,
    vehicle: OracleVehicle,
    spans: Sequence[tuple[float, float]],
    steps: Sequence[tuple[float, float]],
) -> Recording:
    """The recording as it would have been with the effects. spans: (begin, end) of the flights in it, s; steps: of the scripted steps, in
    which no controller answers. Gaps stay, and every channel keeps its own times."""
    series = dict(recording.series)
    for begin, end in spans:
        change = _difference(recording, effects, vehicle, (begin, end), steps)
        series = {group: _changed(s, group, change) for group, s in series.items()}
    late = effects.get("velocity_latency", {}).get("velocity_latency", 0.0)
    if late and "velocity" in series:
        series["velocity"] = _late(series["velocity"], late, spans)
    return replace(recording, series=series)


@dataclass(frozen=True)
class _Change:
    """What is added: at times t_s (n,), channel to (n,)."""

    t_s: FloatArray
    added: Mapping[str, FloatArray]


def _changed(series: Series, group: str, change: _Change) -> Series:
    inside = (series.t_s >= change.t_s[0]) & (series.t_s <= change.t_s[-1])
    columns = dict(series.columns)
    for name in columns.keys() & change.added.keys():
        values = np.array(columns[name])
        if group in HELD_GROUPS:  # what is asked for holds from the moment it is asked for
            at = np.clip(np.searchsorted(change.t_s, series.t_s[inside]), 0, change.t_s.size - 1)
            values[inside] += change.added[name][at]
        else:
            values[inside] += np.interp(series.t_s[inside], change.t_s, change.added[name])
        columns[name] = values
    return Series(series.t_s, columns)


def _late(series: Series, late_s: float, spans: Sequence[tuple[float, float]]) -> Series:
    columns = {}
    for name, values in series.columns.items():
        delayed = np.interp(series.t_s - late_s, series.t_s, values)
        inside = np.zeros(series.t_s.size, dtype=bool)
        for begin, end in spans:
            inside |= (series.t_s >= begin + late_s) & (series.t_s <= end)
        columns[name] = np.where(inside & np.isfinite(values), delayed, values)
    return Series(series.t_s, columns)


class _Recorded:
    """Channels of a recording on one grid of time; zero, or the default, where they were not recorded."""

    def __init__(self, recording: Recording, span: tuple[float, float]) -> None:
        self._recording = recording
        self.t_s = np.arange(span[0], span[1], STEP_S)

    def has(self, *names: str) -> bool:
        return self._recording.has(*names)

    def get(self, name: str, default: float = 0.0) -> FloatArray:
        if not self.has(name):
            return np.full(self.t_s.size, default)
        t, x = self._samples(name)
        if CHANNELS[name].group in HELD_GROUPS:
            return np.asarray(x[np.clip(np.searchsorted(t, self.t_s, side="right") - 1, 0, None)])
        if name == "yaw_rad":
            x = np.unwrap(x)
        return np.asarray(np.interp(self.t_s, t, x))

    def curved(self, name: str) -> FloatArray:
        """As `get` where 0 is the default, by a cubic spline, whose derivative is not blurred, but in gaps and outside of what was
        recorded: of samples of 25 Hz a line between neighbours has lost an eighth of the accelerations of attitude steps."""
        found = self.get(name)
        t, x = self._samples(name) if self.has(name) else (found[:0], found[:0])
        if t.size < 4:
            return found
        after = np.clip(np.searchsorted(t, self.t_s), 1, t.size - 1)
        near = (self.t_s >= t[0]) & (self.t_s <= t[-1]) & (t[after] - t[after - 1] < GAP * np.median(np.diff(t)))
        return np.where(near, CubicSpline(t, x)(self.t_s), found)

    def _samples(self, name: str) -> tuple[FloatArray, FloatArray]:
        t, x = self._recording.channel(name)
        known = np.isfinite(x)
        return t[known], x[known]

    def target(self, axis: str) -> FloatArray:
        """What the attitude loop of an axis follows: the autopilot's own target behind its shaping, where that was recorded."""
        own = f"{axis}_shaped_rad"
        return self.get(own if self.has(own) else f"{axis}_ref_rad")

    def smooth(self, x: FloatArray, derivative: int = 0, over_s: float = SMOOTH_S, order: int = 2) -> FloatArray:
        window = min(int(over_s / STEP_S) | 1, x.size - 1 + x.size % 2)
        if window < 5:
            return np.zeros_like(x) if derivative else x
        return np.asarray(savgol_filter(x, window, order, deriv=derivative, delta=STEP_S))

    def behind_filters(self, x: FloatArray, group: str, of: str = "") -> FloatArray:
        """What a channel group shows of x (n,), which another one measured, by the delays of their known second-order filters; without
        another one, of what is so."""
        cutoffs = (self._recording.provenance.filters.get(g) for g in (group, of))
        late, early = (sqrt(2.0) / (2.0 * pi * hz) if hz else 0.0 for hz in cutoffs)
        return np.asarray(np.interp(self.t_s - late + early, self.t_s, x))


def _difference(
    recording: Recording,
    effects: Effects,
    vehicle: OracleVehicle,
    span: tuple[float, float],
    steps: Sequence[tuple[float, float]],
) -> _Change:
    seen = _Recorded(recording, span)
    tilted = seen.has("roll_rad", "pitch_rad")  # half an attitude is none
    rpy = np.stack([seen.get(f"{a}_rad") for a in ("roll", "pitch", "yaw")], axis=1) * (tilted, tilted, 1.0)
    velocity = np.stack([seen.get(f"v_{a}_m_s") for a in "xyz"], axis=1)
    turn = body_to_world(*rpy.T)
    force = _specific_force(seen, velocity, turn)
    idle = np.zeros(seen.t_s.size, dtype=bool)
    for begin, end in steps:
        idle |= (seen.t_s >= begin) & (seen.t_s <= end)
    voltage = (seen.get("voltage_v", vehicle.nominal_voltage_v) / vehicle.nominal_voltage_v) ** vehicle.alpha
    recorded = seen.get("throttle")
    thrust = Thrust(vehicle, effects, recorded, voltage)
    loops = AttitudeLoops(vehicle, effects, seen.target("roll"), seen.target("pitch"), seen.get("yaw_rate_ref_rad_s"))
    air = AirEffects(effects, seen.get("height_m"), seen.t_s - seen.t_s[0])
    load = SlungLoad(1.0, dict(effects["slung_payload"])) if "slung_payload" in effects else None
    load_trim = np.array([0.0, 0.0, G_M_S2 * load.mass_kg if load else 0.0])  # the pilot hovers with the load
    trim = float(
        load_trim[2]
    )  # upward, of the controller, on the average of its own time: what a script's steps start from
    drag, w = np.array(vehicle.drag_1_s), vehicle.bandwidth_1_s
    tilts, has_throttle = tilted and seen.has("roll_ref_rad", "pitch_ref_rad"), seen.has("throttle")
    v, p = np.zeros(3), np.zeros(3)
    rows = np.zeros((seen.t_s.size, len(_ADDED)))
    for k in range(seen.t_s.size):
        if not idle[k]:
            against = load_trim - 2.0 * DAMPING * w * v - w * w * p
            trim = trim + (1.0 - exp(-w * STEP_S)) * (against[2] - trim)
        else:
            against = np.array([0.0, 0.0, trim])
        roll_ref, pitch_ref = _tilt_for(against, float(rpy[k, 2])) if tilts else (0.0, 0.0)
        throttle = float(against[2]) / (vehicle.gain_m_s2 * float(voltage[k])) if has_throttle else 0.0
        throttle = min(max(throttle, -float(recorded[k])), max(1.0 - float(recorded[k]), 0.0))  # from none to all of it
        more = thrust.advance(k, throttle)
        angles, rates = loops.advance(k, roll_ref, pitch_ref)
        after = body_to_world(*(rpy[k] + angles * (tilted, tilted, 1.0)))
        body_before, body = turn[k].T @ velocity[k], after.T @ (velocity[k] + v)
        lift = float(force[k, 2] + drag[2] * body_before[2]) + more
        total = force[k] - drag * (body - body_before) + air.force(k, body, lift, float(p[2]))
        total[2] += more
        pushed = after @ total
        if load is not None:
            pushed = np.array(load.pull(STEP_S, (float(pushed[0]), float(pushed[1]), float(pushed[2]))))
            total = after.T @ pushed
        accel = pushed - turn[k] @ force[k]
        rows[k] = (*(total - force[k]), *accel, *v, *p, *angles, *rates, roll_ref, pitch_ref, throttle)
        v = v + STEP_S * accel
        p = p + STEP_S * v
    added = dict(zip(_ADDED, rows.T, strict=True))
    return _Change(seen.t_s, _with_copies(added | _instruments(added, effects, seen)))


_ADDED = (
    "f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "a_x_m_s2", "a_y_m_s2", "a_z_m_s2", "v_x_m_s", "v_y_m_s", "v_z_m_s", "p_x_m", "p_y_m", "p_z_m",
    "roll_rad", "pitch_rad", "yaw_rad", "p_rad_s", "q_rad_s", "r_rad_s", "roll_ref_rad", "pitch_ref_rad", "throttle",
)  # fmt: skip


def _with_copies(added: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """What else shows the same: height, the autopilot's own targets, its throttle and that of the motors."""
    copies = {
        "height_m": "p_z_m", "roll_shaped_rad": "roll_ref_rad", "pitch_shaped_rad": "pitch_ref_rad", "throttle_out": "throttle",
        **{f"motor_{k}": "throttle" for k in range(1, 5)},
    }  # fmt: skip
    return dict(added) | {name: added[of] for name, of in copies.items()}


def _specific_force(seen: _Recorded, velocity: FloatArray, turn: FloatArray) -> FloatArray:
    """(n, 3) body, smoothed: as measured, else of the velocities' derivative."""
    pushed = np.stack([seen.smooth(velocity[:, k], 1) for k in range(3)], axis=1)
    pushed[:, 2] += G_M_S2
    found: FloatArray = np.einsum("nji,nj->ni", turn, pushed)
    for k, axis in enumerate("xyz"):
        if seen.has(f"f_{axis}_m_s2"):
            found[:, k] = seen.smooth(seen.get(f"f_{axis}_m_s2"))
    return found


def _tilt_for(accel: FloatArray, yaw: float) -> tuple[float, float]:
    """Roll and pitch, rad, that push with a horizontal acceleration (world, m/s^2)."""
    forward, left = cos(yaw) * accel[0] + sin(yaw) * accel[1], -sin(yaw) * accel[0] + cos(yaw) * accel[1]
    most = MOST_TILT_RAD
    return min(max(-left / G_M_S2, -most), most), min(max(forward / G_M_S2, -most), most)


def _instruments(added: Mapping[str, FloatArray], effects: Effects, seen: _Recorded) -> dict[str, FloatArray]:
    """Channels of gyroscope and accelerometer as their known filters show them, and as an accelerometer with a bias, or off the centre of
    mass, adds to them."""
    rates = {f"{a}_rad_s": seen.behind_filters(added[f"{a}_rad_s"], "rates") for a in "pqr"}
    force = np.stack([seen.behind_filters(added[f"f_{a}_m_s2"], "specific_force") for a in "xyz"], axis=1)
    bias = effects.get("accelerometer_bias", {})
    force = force + [bias.get(f"bias_{a}", 0.0) for a in "xyz"]
    if "imu_lever_arm" in effects:
        arm = np.array([effects["imu_lever_arm"][f"arm_{a}"] for a in "xyz"])
        whole = np.stack([seen.curved(name) + more for name, more in rates.items()], axis=1)
        turned = np.stack([seen.smooth(whole[:, k], 1, TURN_S, order=4) for k in range(3)], axis=1)
        extra = np.cross(turned, arm) + np.cross(whole, np.cross(whole, arm))
        force = force + np.stack([seen.behind_filters(x, "specific_force", "rates") for x in extra.T], axis=1)
    return rates | {f"f_{a}_m_s2": force[:, k] for k, a in enumerate("xyz")}
