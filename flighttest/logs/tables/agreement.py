"""Whether columns of a table agree: rates are those of the attitude, a velocity is the rate of its position, and an acceleration what
attitude and specific force make it. What does not agree has another unit, axis or frame than its name states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import names
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.logs.timing import difference

FloatArray = NDArray[np.float64]

_ATTITUDE = ("roll_rad", "pitch_rad", "yaw_rad")
_RATES = ("p_rad_s", "q_rad_s", "r_rad_s")
_VELOCITY = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_POSITION = ("p_x_m", "p_y_m", "p_z_m")
_FORCE = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
_REMEDY = "state it in a column map (--columns)"
_SMOOTH_S = 0.3  # both sides are smoothed over it: sensors' noise is not what is compared
_CERTAIN = 0.9  # correlation from which a ratio is no accident
_FACTOR = 3.0  # filters, tilt and delays change a ratio, and what is left of a signal beside its reference, by less
_FEWEST = 100


@dataclass(frozen=True)
class _Axis:
    """One axis of a vector measured twice: by `name`, values (n,), and by what `stated` names, reference (n,)."""

    name: str
    stated: str
    values: FloatArray
    reference: FloatArray


def disagreements(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[str]:
    """Channels whose size, sign or axis others contradict, each in a sentence with a remedy.

    t_s: (n,) s; columns: channel to (n,), NaN where missing, in the units and frames of their names.
    """
    order = np.argsort(t_s, kind="stable")
    t_s, columns = t_s[order], {name: values[order] for name, values in columns.items()}
    vectors = (_rates(t_s, columns), _velocities(t_s, columns), *_accelerations(t_s, columns))
    return [line for axes in vectors for axis in axes if (line := _contradicted(t_s, axis, axes))]


def _rates(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[_Axis]:
    """Rates of the body against those of the attitude; against the rate of their own angle where another is not there."""
    slope = {n: difference(t_s, _unwrapped(columns[n])) for n in _ATTITUDE if n in columns}
    if len(slope) < len(_ATTITUDE):
        stated = {n: f"the rate of {angle}" for n, angle in zip(_RATES, _ATTITUDE, strict=True) if angle in slope}
        found = {n: slope[angle] for n, angle in zip(_RATES, _ATTITUDE, strict=True) if angle in slope}
    else:
        (roll, pitch, _), (d_roll, d_pitch, d_yaw) = ([v[n] for n in _ATTITUDE] for v in (columns, slope))
        stated = {n: f"what the attitude makes of {n}" for n in _RATES}
        found = {
            "p_rad_s": d_roll - np.sin(pitch) * d_yaw,
            "q_rad_s": np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_yaw,
            "r_rad_s": np.cos(roll) * np.cos(pitch) * d_yaw - np.sin(roll) * d_pitch,
        }
    return [_Axis(n, stated[n], columns[n], found[n]) for n in _RATES if n in columns and n in found]


def _velocities(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[_Axis]:
    pairs = zip(_VELOCITY, _POSITION, strict=True)
    return [
        _Axis(v, f"the rate of {p}", columns[v], difference(t_s, columns[p]))
        for v, p in pairs
        if v in columns and p in columns
    ]


def _accelerations(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[list[_Axis]]:
    """Accelerations of the velocity, else of the position, against the specific force turned by the attitude: level ones as the heading
    sees them (forward goes with pitch and left with roll, whatever the compass shows), and the vertical one. Without an accelerometer
    the level ones alone, with the force that carries the vehicle along the axis of its rotors, as a multirotor's is."""
    if not all(n in columns for n in _ATTITUDE):
        return []
    roll, pitch, yaw = (columns[n] for n in _ATTITUDE)
    named = {v: v if v in columns else p for v, p in zip(_VELOCITY, _POSITION, strict=True)}
    slope = {
        v: difference(t_s, columns[v] if v in columns else difference(t_s, columns[of]))
        for v, of in named.items()
        if of in columns
    }
    measured = all(n in columns for n in _FORCE)
    resting = (0.0 * yaw, 0.0 * yaw, np.full(yaw.size, G_M_S2))
    force = tuple(columns[n] for n in _FORCE) if measured else resting
    level = rotation_from_euler(np.stack([roll, pitch, np.zeros(yaw.size)], axis=1))
    forward, left, up = np.einsum("nij,nj->in", level, np.stack(force, axis=1))
    source = "attitude and specific force" if measured else "roll and pitch, with thrust along the rotors' axis,"
    found: list[list[_Axis]] = []
    if slope.keys() >= set(_VELOCITY[:2]):
        x, y = slope["v_x_m_s"], slope["v_y_m_s"]
        of = f"{named['v_x_m_s']} and {named['v_y_m_s']}"
        both = {
            "forward": (np.cos(yaw) * x + np.sin(yaw) * y, forward),
            "leftward": (np.cos(yaw) * y - np.sin(yaw) * x, left),
        }
        found.append(
            [
                _Axis(f"the {way} acceleration of {of}", f"what {source} make of the {way} one", *v)
                for way, v in both.items()
            ]
        )
    if measured and "v_z_m_s" in slope:
        rate = "the rate of v_z_m_s" if named["v_z_m_s"] == "v_z_m_s" else "the upward acceleration of p_z_m"
        found.append([_Axis(rate, f"what {source} make of it", slope["v_z_m_s"], up - G_M_S2)])
    return found


def _contradicted(t_s: FloatArray, axis: _Axis, axes: Sequence[_Axis]) -> str | None:
    """Of an axis that goes with its own reference, what is wrong with its size or sign; of one that goes with another's instead, which."""
    correlation, ratio = _together(t_s, axis.values, axis.reference)
    if abs(correlation) >= _CERTAIN:
        if 1.0 / _FACTOR < ratio < _FACTOR:
            return None
        return f"{axis.name} is {ratio:.3g} times {axis.stated}: one of them has another unit or frame than its name states; {_REMEDY}"
    for other in axes:
        shared, ratio = _together(t_s, axis.values, other.reference)
        left, left_by_other = np.sqrt(1.0 - correlation**2), np.sqrt(max(1.0 - shared**2, 0.0))
        instead = abs(shared) >= _CERTAIN and left > _FACTOR * left_by_other
        if instead and 1.0 / _FACTOR < abs(ratio) < _FACTOR:
            return (
                f"{axis.name} is {ratio:.3g} times {other.stated}, and does not follow {axis.stated}: axes have another order or frame "
                f"than their names state; {_REMEDY}"
            )
    return None


def _unwrapped(angle: FloatArray) -> FloatArray:
    out = angle.copy()
    good = np.isfinite(angle)
    out[good] = np.unwrap(angle[good])
    return out


def _together(t_s: FloatArray, values: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Correlation of two signals, smoothed, and how much the first is of the second; zeros where too little is known of them."""
    good = np.flatnonzero(np.isfinite(values) & np.isfinite(reference))
    if good.size < _FEWEST:
        return 0.0, 0.0
    width = max(int(_SMOOTH_S / max(float(np.median(np.diff(t_s[good]))), 1e-6)), 1)
    kernel = np.ones(width) / width
    a, b = (np.convolve(x[good], kernel, mode="valid") for x in (values, reference))
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return (float(a @ b) / power, float(a @ b) / float(b @ b)) if power > 0.0 else (0.0, 0.0)


_ONE_G = (0.7, 1.4)  # median length of a specific force in g; in m/s^2 nothing that flies or stands has it
_ENOUGH = 10  # samples
_UP = 0.5  # of the length, for the vertical part to decide the frame


def gravity_warnings(found: Mapping[str, FloatArray], body: Literal["FLU", "FRD"], mapped: bool) -> list[str]:
    """Sentences with a remedy where the specific force looks to be in g, or to have z down. found: channels as imported; body: the frame
    that the column map declares; mapped: whether there is a map."""
    up = names("specific_force")[2]
    if up not in found:
        return []
    table = np.stack([found[name] for name in names("specific_force") if name in found])
    table = table[:, np.isfinite(table).all(axis=0)]
    if table.shape[1] < _ENOUGH:
        return []
    length, vertical = float(np.median(np.linalg.norm(table, axis=0))), float(np.median(table[-1]))
    where = "the column map" if mapped else "a column map (--columns)"
    doubts = []
    if _ONE_G[0] < length < _ONE_G[1]:
        doubts.append(
            f"the specific force is usually {length:.2f} m/s^2 long, where 9.81 is expected: it looks to be in g; if so, give its "
            f"columns `unit: g` in {where}, as in {up}: {{from: {up}, unit: g}}"
        )
    if vertical < -_UP * length:
        if body == "FRD":
            remedy = "the map turns it by `frame: {body: FRD}`; if the table is in FLU already, leave that out"
        else:
            remedy = f"if the table is in FRD (z down), write `frame: {{body: FRD}}` in {where}, which also turns pitch, q, r and y"
        doubts.append(
            f"{up} is usually {vertical:.2f} m/s^2, where a vehicle that stands or hovers reads +9.81: {remedy}"
        )
    return doubts
