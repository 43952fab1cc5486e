"""How long several responses were commanded alike: two plans of one script differ in the stops that follow the record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import INPUTS
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

_ALIKE = dict(
    zip(INPUTS, (0.03, 0.03, 0.1, 0.02), strict=True)
)  # rad, rad, rad/s, 1: hover throttle and outer loop differ by less
_JITTER_S = 0.01  # that an edge comes earlier in one of them: half a target at 50 Hz; a whole one turns a roll of 0.5 rad by 0.06
_GRID_S = 0.005


def alike_until_s(segments: Sequence[Segment]) -> float:
    """Seconds after the step until the commands of these responses part, or the first of their records ends."""
    end = min(float(s.t_s[-1]) - s.t_step_s for s in segments)
    if end <= 0.0:
        return end
    t: FloatArray = np.arange(0.0, end, _GRID_S)
    apart = np.zeros(t.size, dtype=bool)
    for name, bound in _ALIKE.items():
        held = [_held(s, name, t) for s in segments if name in s.u and len(s.u[name][0])]
        if len(held) == len(segments):
            if name == "throttle":  # hover throttle rises while the battery empties: its change since the step
                held = [h - h[0] for h in held]
            apart |= np.ptp(held, axis=0) > bound
    longest = round(_JITTER_S / _GRID_S)
    run = np.convolve(apart, np.ones(longest + 1), mode="valid") if t.size > longest else np.zeros(0)
    parted = np.flatnonzero(run > longest)
    return float(t[parted[0]]) if parted.size else end


def held_until_s(segment: Segment) -> float:
    """Seconds for which the commands stay as the step has set them, or until the record ends."""
    end = float(segment.t_s[-1]) - segment.t_step_s
    for name, bound in _ALIKE.items():
        if name in segment.u and len(segment.u[name][0]):
            t, values = segment.u[name][0] - segment.t_step_s, segment.u[name][1]
            first = values[max(int(np.searchsorted(t, 1e-6, side="right")) - 1, 0)]
            left = t[(t > 0.0) & (np.abs(values - first) > bound)]
            end = min(end, float(left[0])) if left.size else end
    return end


def _held(segment: Segment, name: str, t: FloatArray) -> FloatArray:
    """A reference at times since the step, held from each edge to the next."""
    edges, values = segment.u[name]
    at = np.searchsorted(edges - segment.t_step_s, t + 1e-9, side="right") - 1
    return np.asarray(values[np.maximum(at, 0)])
