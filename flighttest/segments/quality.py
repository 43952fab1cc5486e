"""Accept or reject a response on facts: gaps, unrest before the step, take-over, clipping. Does not judge outliers or gusts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import INPUTS
from flighttest.recording import Recording
from flighttest.segments.edges import FoundStep, References
from flighttest.segments.model import Flaw

FloatArray = NDArray[np.float64]

SHORTEST_S = 0.3  # after the step: six time constants of the paper's thrust lag
LEAST_SAMPLES = 8  # of a response: `SHORTEST_S` at 25 Hz
_LEAST_VALUES = 4  # of the channel that the response is judged by: fewer have no usual time between them
_BEFORE_S = 0.15
_RATE_MAX_RAD_S = 0.35  # mean before a tilt step; a vehicle that hovers stays below 0.1
_ERROR_MAX_RAD = 0.12
_CLIP_M_S2 = 15.95 * 9.80665  # the usual accelerometers end at 16 g
_GUIDED_NOGPS = 20
_SILENCE_S = 0.25
_LATE_S = (
    0.1  # half of the GUID_TIMEOUT that a flight asks for: later, and the vehicle may have ended the step by itself
)
_GAP_S = 0.1
_PRIMARY = {
    "roll_step": ("roll_rad",), "pitch_step": ("pitch_rad",), "yaw_rate_step": ("r_rad_s",),
    "throttle_step": ("a_z_m_s2",), "tilt_throttle": ("a_z_m_s2",), "free": (),
}  # fmt: skip
_MARKED = {"take_over": Flaw.TAKE_OVER, "abort": Flaw.ABORTED, "link_lost": Flaw.LINK_LOST}


def flaws_of(
    recording: Recording,
    references: References | None,
    response: FoundStep,
    t_s: FloatArray,
    y: Mapping[str, FloatArray],
    streamed: bool,
) -> tuple[tuple[Flaw, ...], tuple[str, ...]]:
    """The reasons against fitting this response, in the order of `Flaw`, and notes on them: the channels whose values are missing.

    streamed: targets were repeated by a ground station.
    """
    found: set[Flaw] = set()
    # A plan records as much at least; the targets that begin and end it are each sent up to a period late.
    period_s = references.period_s if references is not None and references.streamed else 0.0
    if response.end_s - response.t_step_s < SHORTEST_S - period_s:
        found.add(Flaw.TOO_SHORT)
    if t_s.size < LEAST_SAMPLES:
        found.add(Flaw.TOO_FEW)
    holes = _holes(response, t_s, y)
    found |= set(holes.values())
    found |= _events(recording, response)
    if response.kind in ("roll_step", "pitch_step", "yaw_rate_step") and _unrest(references, response, t_s, y):
        found.add(Flaw.NOT_SETTLED)
    if any(np.any(np.abs(y[n]) >= _CLIP_M_S2) for n in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2") if n in y):
        found.add(Flaw.CLIPPED)
    if references is not None:
        inside = (references.t_s >= response.start_s) & (references.t_s <= response.end_s)
        throttle = references.values[inside, INPUTS.index("throttle")]
        if np.any(throttle >= 1.0):
            found.add(Flaw.CLIPPED)
        if np.any(np.isfinite(references.values[:, -1])) and np.count_nonzero(np.isnan(throttle)) > 0.2 * throttle.size:
            found.add(Flaw.WRONG_MODE)
        elif streamed and references.streamed:
            longest_s = _longest_gap_s(references, response)
            if longest_s > max(_SILENCE_S, 5.0 * references.period_s):
                found.add(Flaw.LINK_LOST)
            elif longest_s > references.period_s + _LATE_S:
                found.add(Flaw.LATE)
    return tuple(flaw for flaw in Flaw if flaw in found), (f"missing: {', '.join(holes)}",) if holes else ()


def _holes(response: FoundStep, t_s: FloatArray, y: Mapping[str, FloatArray]) -> dict[str, Flaw]:
    """By channel what is missing of it, by the channel's own rate: one of 10 Hz has a value in every fifth row of one of 50 Hz."""
    found: dict[str, Flaw] = {}
    names = [n for n in _PRIMARY.get(response.kind, ()) if n in y]
    if not names:
        names = [n for n in ("roll_rad", "a_z_m_s2", "f_z_m_s2", "v_x_m_s") if n in y][:1]
    for name in names:
        good = np.isfinite(y[name])
        if np.count_nonzero(good) < _LEAST_VALUES:
            found[name] = Flaw.NOT_A_NUMBER
            continue
        times = np.concatenate([[response.start_s], t_s[good], [response.end_s]])
        usual = float(np.median(np.diff(t_s[good])))
        if np.max(np.diff(times)) > max(3.5 * usual, _GAP_S):
            found[name] = Flaw.GAP
    return found


def _events(recording: Recording, response: FoundStep) -> set[Flaw]:
    found: set[Flaw] = set()
    for marker in recording.markers:
        if not response.start_s - 0.3 < marker.t_s < response.end_s:
            continue
        if marker.kind in _MARKED:
            found.add(_MARKED[marker.kind])
        elif marker.kind == "mode" and marker.t_s > response.start_s and marker.data.get("mode") != _GUIDED_NOGPS:
            # Into the maneuver's own mode is no take-over: HEARTBEAT may report it a second late.
            found.add(Flaw.TAKE_OVER)
    return found


def _unrest(references: References | None, response: FoundStep, t_s: FloatArray, y: Mapping[str, FloatArray]) -> bool:
    before = (t_s >= response.t_step_s - _BEFORE_S) & (t_s <= response.t_step_s + 0.02)
    if not before.any():
        return False
    for name in ("p_rad_s", "q_rad_s"):
        values = y[name][before] if name in y else np.zeros(0)
        values = values[np.isfinite(values)]
        if values.size and abs(float(np.mean(values))) > _RATE_MAX_RAD_S:
            return True
    if references is None:
        return False
    index = int(np.searchsorted(references.t_s, response.t_step_s)) - 1
    for column, name in enumerate(("roll_rad", "pitch_rad")):
        if name not in y or index < 0:
            continue
        values = y[name][before]
        values = values[np.isfinite(values)]
        error = abs(float(np.mean(values)) - references.values[index, column]) if values.size else 0.0
        if error > _ERROR_MAX_RAD:  # false for NaN
            return True
    return False


def _longest_gap_s(references: References, response: FoundStep) -> float:
    """The longest time for which no target came between the start and the end of a response."""
    a = max(int(np.searchsorted(references.t_s, response.start_s, side="right")) - 1, 0)
    b = int(np.searchsorted(references.t_s, response.end_s, side="right"))
    times = np.append(np.maximum(references.t_s[a:b], response.start_s), response.end_s)
    return float(np.max(np.diff(times), initial=0.0))
