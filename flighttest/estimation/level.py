"""Segments without a measured roll and pitch: may level flight be assumed?

The vertical thrust of a vehicle that is taken as level is too large by 1 - cos(tilt). What was recorded bounds the tilt from below: the one
angle that was measured, the attitude that was asked for, and horizontal accelerations, which take a tilt of |a| / g. A steady tilt against
wind or drag at constant speed shows in none of these.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.responses import attitude_is_known, zero_order_hold
from flighttest.frames import G_M_S2
from flighttest.segments.model import Segment

if TYPE_CHECKING:
    from flighttest.estimation.problem import Problem
    from flighttest.estimation.solver import Solution

FloatArray = NDArray[np.float64]

LEVEL_RAD = 0.14  # root mean square; 1 % of the thrust
PIECE_S = 0.5  # accelerations are means over so long: shorter ones are noise of a differentiated position


def taken_as_level(segment: Segment) -> bool:
    """Whether roll and pitch were not measured, and nothing that was recorded shows that the vehicle was tilted."""
    return not attitude_is_known(segment) and tilt_rad(segment) <= LEVEL_RAD


def tilt_rad(segment: Segment) -> float:
    """Root mean square tilt that the recorded channels show at least, rad; 0 where none of them shows any."""
    t = segment.t_s
    found = [0.0]
    for axis in ("roll", "pitch"):
        if f"{axis}_rad" in segment.y:
            found.append(_rms(segment.y[f"{axis}_rad"]))
        if f"{axis}_ref_rad" in segment.u:
            found.append(_rms(zero_order_hold(segment.u[f"{axis}_ref_rad"], t)))
    found.append(math.hypot(*(_rms(_acceleration(segment, axis)) for axis in "xy")) / G_M_S2)
    return max(found)


def level_share(problem: Problem, solution: Solution) -> float:
    """Share of the thrust by which K may be wrong for taking segments as level; 0 where attitude was measured in all.

    Not below what responses call a constant vertical disturbance: where attitude is not known, nothing shows that it is none of K's.
    """
    found = 0.0
    for part, local in zip(problem.parts, solution.local, strict=True):
        rows = [j for j, r in enumerate(part.responses) if taken_as_level(problem.segments[r.index])]
        if rows and "a_d_z_m_s2" in part.block.disturbances:
            at = part.n_free_states + part.block.disturbances.index("a_d_z_m_s2")
            found = max(0.5 * LEVEL_RAD**2, abs(float(np.mean(local[rows, at]))) / G_M_S2)
    return found


def level_notes(segments: Sequence[Segment], share: float) -> list[str]:
    """What a fit reports of segments without a measured attitude. share: `level_share` of it."""
    unknown = [s for s in segments if not attitude_is_known(s)]
    if not unknown:
        return []
    level = [s for s in unknown if taken_as_level(s)]
    notes = [
        "attitude was not recorded throughout: where it was not, only level flight determines thrust, and nothing drag"
    ]
    if level:
        largest = max(tilt_rad(s) for s in level)
        notes.append(
            f"{_of(len(level), len(segments))} taken as level, since nothing recorded there shows otherwise (tilts of up to "
            f"{largest:.2f} rad show); a steady tilt against wind or drag would not show: K is not known "
            f"better than to {100 * share:.2g} %"
        )
    if len(level) < len(unknown):
        notes.append(refusal([s for s in unknown if s not in level]))
    return notes


def refusal(segments: Sequence[Segment]) -> str:
    """Why segments without a measured attitude cannot be taken as level; '' where none of these segments is such."""
    tilted = [tilt_rad(s) for s in segments if not attitude_is_known(s) and not taken_as_level(s)]
    if not tilted:
        return ""
    return (
        f"{_of(len(tilted), len(segments))} neither of measured roll and pitch nor level (accelerations, velocities or attitude references "
        f"show tilts of {min(tilted):.2f} to {max(tilted):.2f} rad), so that the direction of the thrust is not known"
    )


def _of(some: int, every: int) -> str:
    return f"{some} of {every} segments {'is' if some == 1 else 'are'}"


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


def _acceleration(segment: Segment, axis: str) -> FloatArray:
    """Means over pieces of the acceleration along a horizontal axis: measured, else slope of velocity, else curvature of position."""
    t = segment.t_s
    count = max(int((t[-1] - t[0]) / PIECE_S), 1) if t.size else 1
    for name, order in ((f"a_{axis}_m_s2", 0), (f"v_{axis}_m_s", 1), (f"p_{axis}_m", 2)):
        y = segment.y.get(name)
        if y is None or np.isfinite(y).sum() < 5:
            continue
        known = np.isfinite(y)
        piece = np.minimum(((t[known] - t[0]) / PIECE_S).astype(int), count - 1)
        found = [_derivative(t[known][piece == k], y[known][piece == k], order) for k in range(count)]
        return np.array(found)
    return np.zeros(0)


def _derivative(t: FloatArray, y: FloatArray, order: int) -> float:
    """The derivative of this order of the least-squares polynomial of this order; NaN for too few samples."""
    if t.size < order + 2:
        return float("nan")
    return float(np.polyfit(t - t.mean(), y, order)[0]) * math.factorial(order)
