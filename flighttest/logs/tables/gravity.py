"""What an accelerometer's table says of its own unit and frame: a vehicle that stands or hovers measures 9.81 m/s^2, upwards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import names

FloatArray = NDArray[np.float64]

_ONE_G = (0.7, 1.4)  # median length of a specific force in g; in m/s^2 nothing that flies or stands has it
_ENOUGH = 10  # samples
_UP = 0.5  # of the length, for the vertical part to tell the frame


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
            remedy = f"if the table is in FRD (z down), say `frame: {{body: FRD}}` in {where}, which also turns pitch, q, r and y"
        doubts.append(
            f"{up} is usually {vertical:.2f} m/s^2, where a vehicle that stands or hovers reads +9.81: {remedy}"
        )
    return doubts
