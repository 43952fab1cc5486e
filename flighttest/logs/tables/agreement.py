"""Whether columns of a table agree: rates are those of the attitude, a velocity is the rate of its position, and an acceleration what
attitude and specific force make it. What does not agree has another unit, axis or frame than its name states.

Rates and accelerations are no linear functions of the attitude: in another unit it need not go with them at all. So where nothing that
holds the attitude agrees, it is tried in the other unit.
"""

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
REMEDY = "state it in a column map (--columns)"
_SMOOTH_S = 0.3  # both sides are smoothed over it: sensors' noise is not what is compared
CERTAIN = 0.9  # correlation from which a ratio is no accident
_FACTOR = 3.0  # filters, tilt and delays change a ratio, and what is left of a signal beside its reference, by less
_FEWEST = 100
_AGREES = 2  # axes that must agree in another unit: one alone may be an accident
# By how much an attitude in one unit is too small or large where the other one was declared.
_OTHER_UNITS = {
    np.degrees(1.0): "they look to be in radians, taken for degrees",
    np.radians(1.0): "they look to be in degrees, taken for radians",
}


@dataclass(frozen=True)
class MeasuredTwice:
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
    lines = [line for axes in vectors for axis in axes if (line := contradicted(t_s, axis, axes))]
    return lines or _in_another_unit(t_s, columns)


def _in_another_unit(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[str]:
    """That the attitude has another unit, where rates and level accelerations agree with it in that one and not in its own."""
    if not all(n in columns for n in _ATTITUDE) or _agreeing(t_s, columns):
        return []
    for factor, said in _OTHER_UNITS.items():
        found = _agreeing(t_s, {**columns, **{n: factor * columns[n] for n in _ATTITUDE}})
        if len(found) >= _AGREES:
            return [
                f"{', '.join(_ATTITUDE)} do not go with {' and '.join(found[:_AGREES])}, and do if they are multiplied by "
                f"{factor:.3g}: {said}; {REMEDY}"
            ]
    return []


def _agreeing(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[str]:
    """Names of rates and accelerations that are what the attitude makes of them."""
    axes = [*_rates(t_s, columns), *(axis for found in _accelerations(t_s, columns) for axis in found)]
    both = [(axis, *correlated(t_s, axis.values, axis.reference)) for axis in axes]
    return [a.name for a, correlation, ratio in both if abs(correlation) >= CERTAIN and _alike(ratio)]


def _alike(ratio: float) -> bool:
    return 1.0 / _FACTOR < ratio < _FACTOR


def _rates(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[MeasuredTwice]:
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
    return [MeasuredTwice(n, stated[n], columns[n], found[n]) for n in _RATES if n in columns and n in found]


def _velocities(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[MeasuredTwice]:
    pairs = zip(_VELOCITY, _POSITION, strict=True)
    return [
        MeasuredTwice(v, f"the rate of {p}", columns[v], difference(t_s, columns[p]))
        for v, p in pairs
        if v in columns and p in columns
    ]


def _accelerations(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[list[MeasuredTwice]]:
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
    found: list[list[MeasuredTwice]] = []
    if slope.keys() >= set(_VELOCITY[:2]):
        x, y = slope["v_x_m_s"], slope["v_y_m_s"]
        of = f"{named['v_x_m_s']} and {named['v_y_m_s']}"
        both = {
            "forward": (np.cos(yaw) * x + np.sin(yaw) * y, forward),
            "leftward": (np.cos(yaw) * y - np.sin(yaw) * x, left),
        }
        found.append(
            [
                MeasuredTwice(f"the {way} acceleration of {of}", f"what {source} make of the {way} one", *v)
                for way, v in both.items()
            ]
        )
    if measured and "v_z_m_s" in slope:
        rate = "the rate of v_z_m_s" if named["v_z_m_s"] == "v_z_m_s" else "the upward acceleration of p_z_m"
        found.append([MeasuredTwice(rate, f"what {source} make of it", slope["v_z_m_s"], up - G_M_S2)])
    return found


def contradicted(t_s: FloatArray, axis: MeasuredTwice, axes: Sequence[MeasuredTwice]) -> str | None:
    """Of an axis that goes with its own reference, what is wrong with its size or sign; of one that goes with another's instead, which."""
    correlation, ratio = correlated(t_s, axis.values, axis.reference)
    if abs(correlation) >= CERTAIN:
        if _alike(ratio):
            return None
        return f"{axis.name} is {ratio:.3g} times {axis.stated}: one of them has another unit, sign or frame than its name states; {REMEDY}"
    for other in axes:
        shared, ratio = correlated(t_s, axis.values, other.reference)
        left, left_by_other = np.sqrt(1.0 - correlation**2), np.sqrt(max(1.0 - shared**2, 0.0))
        instead = abs(shared) >= CERTAIN and left > _FACTOR * left_by_other
        if instead and _alike(abs(ratio)):
            return (
                f"{axis.name} is {ratio:.3g} times {other.stated}, and does not follow {axis.stated}: axes have another order or frame "
                f"than their names state; {REMEDY}"
            )
    return None


def _unwrapped(angle: FloatArray) -> FloatArray:
    out = angle.copy()
    good = np.isfinite(angle)
    out[good] = np.unwrap(angle[good])
    return out


def correlated(t_s: FloatArray, values: FloatArray, reference: FloatArray) -> tuple[float, float]:
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
# Median length of a specific force: what is carried has g, and no flight has less than a third of that, or more than three times, for half
# of its time.
_NO_FORCE = (3.3, 29.4)
_ENOUGH = 10  # samples
_UP = 0.5  # of the length, for the vertical part to decide the frame


def gravity_warnings(found: Mapping[str, FloatArray], body: Literal["FLU", "FRD"], mapped: bool) -> list[str]:
    """Sentences with a remedy where the specific force looks to be in g, to be none, or to have z down. found: channels as imported; body:
    the frame that the column map declares; mapped: whether there is a map."""
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
    elif not _NO_FORCE[0] < length < _NO_FORCE[1]:
        doubts.append(
            f"the specific force is usually {length:.3g} m/s^2 long, where 9.81 is expected: its columns have another unit, or hold "
            f"something else (angular rates?); name unit and columns in {where}"
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
