"""Whether columns of a table agree: a rate is the rate of its angle, a velocity that of its position, and an acceleration what attitude
and specific force make it. What does not agree has another unit or another frame than its name states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import names
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.logs.timing import difference

FloatArray = NDArray[np.float64]

_RATES = {
    "p_rad_s": "roll_rad", "q_rad_s": "pitch_rad", "r_rad_s": "yaw_rad",
    "v_x_m_s": "p_x_m", "v_y_m_s": "p_y_m", "v_z_m_s": "p_z_m",
}  # fmt: skip
_ATTITUDE = ("roll_rad", "pitch_rad", "yaw_rad")
_VELOCITY = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_FORCE = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
_SAID = "what attitude and specific force make of it"
_SMOOTH_S = 0.3  # both sides are smoothed over it: sensors' noise is not what is compared
_CERTAIN = 0.9  # correlation from which a ratio is no accident
_FACTOR = 3.0  # filters, tilt and delays change a ratio by less
_FEWEST = 100


def disagreements(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[str]:
    """Channels whose size or sign others contradict, each in a sentence with a remedy.

    t_s: (n,) s; columns: channel to (n,), NaN where missing, in the units and frames of their names.
    """
    order = np.argsort(t_s, kind="stable")
    t_s, columns = t_s[order], {name: values[order] for name, values in columns.items()}
    found = []
    for rate, of in _RATES.items():
        if rate in columns and of in columns:
            whole = columns[of] if of.endswith("_m") else _unwrapped(columns[of])
            found.append((rate, f"the rate of {of}", columns[rate], difference(t_s, whole)))
    if all(n in columns for n in (*_ATTITUDE, *_FORCE)):
        roll, pitch, yaw = (columns[n] for n in _ATTITUDE)
        slope = {n: difference(t_s, columns[n]) for n in _VELOCITY if n in columns}
        # As the heading sees it: forward goes with pitch and left with roll, whatever the compass shows.
        level = rotation_from_euler(np.stack([roll, pitch, np.zeros(yaw.size)], axis=1))
        forward, left, up = np.einsum("nij,nj->in", level, np.stack([columns[n] for n in _FORCE], axis=1))
        if slope.keys() >= {"v_x_m_s", "v_y_m_s"}:
            x, y = slope["v_x_m_s"], slope["v_y_m_s"]
            name = "the {} acceleration of v_x_m_s and v_y_m_s"
            found.append((name.format("forward"), _SAID, np.cos(yaw) * x + np.sin(yaw) * y, forward))
            found.append((name.format("leftward"), _SAID, np.cos(yaw) * y - np.sin(yaw) * x, left))
        if "v_z_m_s" in slope:
            found.append(("the rate of v_z_m_s", _SAID, slope["v_z_m_s"], up - G_M_S2))
    ratios = [(name, stated, _ratio(t_s, values, reference)) for name, stated, values, reference in found]
    return [
        f"{name} is {ratio:.3g} times {stated}: one of them has another unit or frame than its name states; state it in a column map "
        "(--columns)"
        for name, stated, ratio in ratios
        if ratio is not None and not 1.0 / _FACTOR < ratio < _FACTOR
    ]


def _unwrapped(angle: FloatArray) -> FloatArray:
    out = angle.copy()
    good = np.isfinite(angle)
    out[good] = np.unwrap(angle[good])
    return out


def _ratio(t_s: FloatArray, values: FloatArray, reference: FloatArray) -> float | None:
    """Of two signals that go together, how much the first is of the second; None where they do not."""
    good = np.flatnonzero(np.isfinite(values) & np.isfinite(reference))
    if good.size < _FEWEST:
        return None
    width = max(int(_SMOOTH_S / max(float(np.median(np.diff(t_s[good]))), 1e-6)), 1)
    kernel = np.ones(width) / width
    a, b = (np.convolve(x[good], kernel, mode="valid") for x in (values, reference))
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    if power <= 0.0 or abs(float(a @ b)) < _CERTAIN * power:
        return None
    return float(a @ b) / float(b @ b)


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
