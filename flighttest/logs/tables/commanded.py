"""Whether a table's commands are those that its vehicle answered: a closed loop follows its reference, and thrust rises with throttle.

A reference of the other sign and a throttle that is 0 at full power fit a flight as badly as they fit a model of it, and no other column
is measured in their place. What the vehicle did afterwards is: an attitude that follows its reference has a positive gain at low
frequencies, near one; a vehicle that is at rest has idle motors, and one that moves accelerates upwards with more throttle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import REFERENCE_OF, names
from flighttest.frames import G_M_S2
from flighttest.logs.tables.agreement import CERTAIN, REMEDY, MeasuredTwice, contradicted, correlated
from flighttest.logs.timing import difference

FloatArray = NDArray[np.float64]

_GRID_S = 0.02
_ANSWERED_S = 0.5  # loops and motors of multirotors have answered by then
_FEWEST_S = 5.0
# Of the cosine of the tilt: about and beyond the horizontal Euler angles jump, and nothing follows any more.
_UPRIGHT = 0.5
_RESTS_M_S, _RESTS_S = 0.15, 1.0  # as `segments.airborne`
_FULL = 0.98  # 1 less what is idle; at full throttle every multirotor that flies with less accelerates upwards
_SLOWEST_LOOP_S, _SHORTEST_HOLD_S = 0.105, 0.5  # slower than 10 Hz no attitude loop and no stick is read
_FEWEST_SAMPLES = 20
_UNEVEN, _MOSTLY = 0.25, 0.9  # of the usual time between samples; of the samples
_TURNED = "if its 0 is full throttle, turn it in a column map (--columns): `scale: -1, offset: 1`"


def sampled_throttle(t_s: FloatArray, throttle: FloatArray) -> tuple[FloatArray, str] | None:
    """A throttle that was sampled more slowly than the table's rows and repeated, as a line between its samples (n,), and the sentence that
    says so; None where it is a command. Loops that keep a multirotor in the air command it faster than `_SLOWEST_LOOP_S`, and no script
    holds one value for less than `_SHORTEST_HOLD_S`: what is new at an even pace between the two was measured, as rotor speeds are by the
    telemetry of motor controllers.

    t_s: (n,) s; throttle: (n,); NaN where missing.
    """
    order = np.argsort(t_s, kind="stable")
    order = order[np.isfinite(t_s[order]) & np.isfinite(throttle[order])]
    if order.size < 2:
        return None
    t, values = t_s[order], throttle[order]
    new = np.concatenate([[True], np.diff(values) != 0.0])
    apart = np.diff(t[new])
    if apart.size < _FEWEST_SAMPLES:
        return None
    usual_s = float(np.median(apart))
    even = np.abs(apart / usual_s - np.round(apart / usual_s)) < _UNEVEN
    if not _SLOWEST_LOOP_S < usual_s < _SHORTEST_HOLD_S or np.mean(even) < _MOSTLY:
        return None
    # What was idle between two flights is no line from the last value of the one to the first of the other.
    rests = (
        np.append(np.diff(t) < usual_s, True) & ~new & (t - t[np.flatnonzero(new)[np.cumsum(new) - 1]] > 2.0 * usual_s)
    )
    known = new | rests
    line = np.where(np.isfinite(t_s), np.interp(t_s, t[known], values[known], left=np.nan, right=np.nan), np.nan)
    return line, (
        f"throttle is new every {usual_s:.2g} s and repeated between: it was measured, not commanded (rotor speeds by telemetry?); a line "
        "was drawn between its samples, and no step is seen in it; map the commands if they were recorded"
    )


def misread_commands(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> list[str]:
    """References and throttle whose sign or size the vehicle's motion contradicts, each in a sentence with a remedy.

    t_s: (n,) s, NaN where missing; columns: channel to (n,), NaN where missing, in the units and frames of their names.
    """
    known = np.flatnonzero(np.isfinite(t_s))
    order = known[np.argsort(t_s[known], kind="stable")]
    if order.size < 2 or t_s[order[-1]] - t_s[order[0]] < _FEWEST_S:
        return []
    t, table = t_s[order], {name: values[order] for name, values in columns.items()}
    even = np.arange(t[0], t[-1], _GRID_S)
    return [*_references(t, table, even), *_throttle(t, table, even)]


def _references(t: FloatArray, table: Mapping[str, FloatArray], even: FloatArray) -> list[str]:
    """Of roll, pitch and yaw rate, against what follows them."""
    upright = _cosine_of_tilt(t, table, even) > _UPRIGHT
    axes = []
    for response, reference in REFERENCE_OF.items():
        if response in table and reference in table:
            asked = np.where(upright, _held(t, table[reference], even), np.nan)
            late_s, did = _answer(even, asked, _between(t, table[response], even))
            axes.append(MeasuredTwice(reference, f"{response} {late_s:.2g} s later", asked, did))
    return [line for axis in axes if (line := contradicted(even, axis, axes))]


def _throttle(t: FloatArray, table: Mapping[str, FloatArray], even: FloatArray) -> list[str]:
    if "throttle" not in table:
        return []
    throttle = _held(t, table["throttle"], even)
    velocity = [_between(t, v, even) for v in _velocity(t, table)]
    resting = _resting(velocity) if velocity else np.zeros(even.size, dtype=bool)
    full = resting & (throttle >= _FULL)
    seconds = float(np.count_nonzero(full)) * _GRID_S
    if seconds >= _RESTS_S and np.any(throttle[~resting] < _FULL):
        return [
            f"throttle is {_FULL:g} or more for {seconds:.1f} s in which the vehicle is at rest, and less where it moves: {_TURNED}"
        ]
    moving = np.where(resting, np.nan, throttle)
    for name, carried in _carried(t, table, even).items():
        late_s, did = _answer(even, moving, carried)
        correlation, _ = correlated(even, moving, did)
        if correlation <= -CERTAIN:
            return [
                f"throttle falls where {name} rises {late_s:.2g} s later (correlation {correlation:.2f}): {_TURNED}, else {REMEDY}"
            ]
    return []


def _carried(t: FloatArray, table: Mapping[str, FloatArray], even: FloatArray) -> dict[str, FloatArray]:
    """What shows the thrust, by name: the specific force along the rotors' axis, else what the vertical motion makes of it."""
    if "f_z_m_s2" in table:
        return {"f_z_m_s2": _between(t, table["f_z_m_s2"], even)}
    vertical = _velocity(t, table, "v_z_m_s")
    if not vertical:
        return {}
    cosine = np.maximum(_cosine_of_tilt(t, table, even), _UPRIGHT)
    return {"the upward acceleration": (np.gradient(_between(t, vertical[0], even), _GRID_S) + G_M_S2) / cosine}


def _velocity(t: FloatArray, table: Mapping[str, FloatArray], only: str = "") -> list[FloatArray]:
    """Recorded velocities (n,), else those that the positions have; of one axis where only that is asked for."""
    pairs = zip(names("velocity"), names("position"), strict=True)
    wanted = [(v, p) for v, p in pairs if not only or v == only]
    found = [table[v] if v in table else difference(t, table[p]) for v, p in wanted if v in table or p in table]
    return [values for values in found if np.isfinite(values).any()]


def _cosine_of_tilt(t: FloatArray, table: Mapping[str, FloatArray], even: FloatArray) -> FloatArray:
    angles = [_between(t, table[n], even) for n in ("roll_rad", "pitch_rad") if n in table]
    return np.prod([np.cos(a) for a in angles], axis=0) if angles else np.ones(even.size)


def _resting(velocity: list[FloatArray]) -> NDArray[np.bool_]:
    """(n,) where no velocity is faster than what rests, for at least `_RESTS_S`."""
    slow: NDArray[np.bool_] = np.max(np.abs(velocity), axis=0) < _RESTS_M_S
    turns = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8)))
    for first, after in zip(turns[::2], turns[1::2], strict=True):
        if (after - first) * _GRID_S < _RESTS_S:
            slow[first:after] = False
    return slow


def _answer(even: FloatArray, asked: FloatArray, did: FloatArray) -> tuple[float, FloatArray]:
    """By how much later the response goes best with what was asked for, s, and the response at that time (n,)."""
    best, late_s, answer = -1.0, 0.0, did
    for k in range(round(_ANSWERED_S / _GRID_S) + 1):
        later = np.append(did[k:], np.full(k, np.nan))
        correlation, _ = correlated(even, asked, later)
        if abs(correlation) > best:
            best, late_s, answer = abs(correlation), k * _GRID_S, later
    return late_s, answer


def _held(t: FloatArray, values: FloatArray, even: FloatArray) -> FloatArray:
    """Each value until the next one; NaN before the first."""
    known = np.flatnonzero(np.isfinite(values))
    at = np.searchsorted(t[known], even, side="right") - 1
    return np.where(at >= 0, values[known][np.maximum(at, 0)], np.nan) if known.size else np.full(even.size, np.nan)


def _between(t: FloatArray, values: FloatArray, even: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    if not known.any():
        return np.full(even.size, np.nan)
    return np.interp(even, t[known], values[known], left=np.nan, right=np.nan)
