"""What ArduCopter made of what it was sent: which targets it dropped, what their thrust meant, which parameters were in force."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from flighttest.mavlink.modes import TAKES_ATTITUDE_TARGETS
from flighttest.recording import Series

FloatArray = NDArray[np.float64]

SELDOM = 0.01  # a few around every change of mode are no loss
_THRUST_IS_THROTTLE = 8  # of GUID_OPTIONS
CLIMB_RATES = "the targets were climb rates (GUID_OPTIONS bit 3 not set), so the throttle is the altitude controller's"


def taken(targets: Series, beats_s: FloatArray, modes: FloatArray, losses: list[str]) -> Series | None:
    """The targets that the vehicle took, NaN where it dropped them; None where it took none.

    It drops those sent in another mode, and those without a throttle. beats_s, modes: (n,) HEARTBEATs; the mode is that of the next one.
    """
    if not beats_s.size:
        return targets
    following = np.minimum(np.searchsorted(beats_s, targets.t_s), beats_s.size - 1)
    dropped = ~np.isin(modes[following], TAKES_ATTITUDE_TARGETS) | np.isnan(targets.columns["throttle"])
    if not dropped.any():
        return targets
    if np.mean(dropped) > SELDOM:
        losses.append(
            f"{int(np.count_nonzero(dropped))} of {dropped.size} SET_ATTITUDE_TARGET are no reference: "
            "the autopilot drops what is sent in another mode than GUIDED or without a throttle"
        )
    if dropped.all():
        return None
    return Series(targets.t_s, {name: np.where(dropped, np.nan, v) for name, v in targets.columns.items()})


def throttle_of(
    targets: Series,
    own: tuple[FloatArray, FloatArray] | None,
    parameters: Mapping[str, float],
    derived: dict[str, str],
    losses: list[str],
) -> Series:
    """The targets with the throttle they led to, where their thrust was a climb rate by GUID_OPTIONS.

    own: times (n,) and thrust (n,) of the vehicle's ATTITUDE_TARGET; without it the throttle is unknown then, which is noted.
    """
    if int(parameters.get("GUID_OPTIONS", _THRUST_IS_THROTTLE)) & _THRUST_IS_THROTTLE:
        return targets
    columns = {name: values for name, values in targets.columns.items() if name != "throttle"}
    if own is None or not own[0].size:
        losses.append(f"{CLIMB_RATES}; no ATTITUDE_TARGET holds it, so there is no throttle here")
        return Series(targets.t_s, columns)
    derived["throttle"] = f"ATTITUDE_TARGET: {CLIMB_RATES}"
    t_s = np.union1d(targets.t_s, own[0])
    columns["throttle"] = own[1]
    held = {}
    for name, values in columns.items():
        since = np.searchsorted(own[0] if name == "throttle" else targets.t_s, t_s, side="right") - 1
        held[name] = np.where(since >= 0, values[np.maximum(since, 0)], np.nan)
    return Series(t_s, held)


def in_force(changes: Iterable[tuple[float, str, float]], until_s: float = math.inf) -> dict[str, float]:
    """Parameter name to its last value at or before `until_s`, the last moment the vehicle was armed.

    changes: (time s, name, value) in the order reported. A value that is first heard of later counts as well: a parameter is usually
    read at leisure. What is set or restored after landing does not describe the flight, though.
    """
    found: dict[str, float] = {}
    for t_s, name, value in changes:
        if name and math.isfinite(value) and (t_s <= until_s or name not in found):
            found[name] = float(value)
    return found
