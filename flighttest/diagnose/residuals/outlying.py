"""Responses that something pushed which did not push their repeats: weather or a hand, no physics of the vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.records import SetAside
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

FAR = 8.0  # robust standard deviations of what pushes a response: weather as usual does not reach it
LEAST_SPREAD_M_S2 = 0.05  # what estimators wander by looks like a push of this size
NEAR = 0.5  # of a push: a repeat that got less did not share it
MOST = 1 / 3  # of all responses: what comes more often is no exception
LEAST = 12  # responses: of fewer it is not known what is usual


Nuisance = Mapping[str, FloatArray]  # name of a disturbance to (n_segments,)


def set_aside(segments: tuple[Segment, ...], nuisance: Nuisance) -> tuple[tuple[Segment, ...], SetAside]:
    """The responses without those that something pushed once, and those by name with a sentence on them. nuisance: of the base model's
    fit."""
    if len(segments) < LEAST or len({s.cell_key for s in segments}) == len(segments):
        return segments, {}  # or nothing was flown twice
    odd = outlying(nuisance, segments)
    if not odd:
        return segments, {}
    aside: SetAside = {
        "segments": [segments[i].name for i in sorted(odd)],
        "sentence": outlying_in_words(odd, segments),
    }
    return tuple(s for i, s in enumerate(segments) if i not in odd), aside


def outlying(nuisance: Nuisance, segments: Sequence[Segment]) -> dict[int, float]:
    """Index of a response to how hard it was pushed, m/s^2, where a repeat of the same step was not.

    nuisance: of a fitted base model; the push is what it found constant over the response, along the ground or upwards, less what is usual.
    """
    pushes = _pushes(nuisance, len(segments))
    if not pushes.size:
        return {}
    cells: dict[object, list[int]] = {}
    for i, segment in enumerate(segments):
        if segment.kind != "free":
            cells.setdefault(segment.cell_key, []).append(i)
    found: dict[int, float] = {}
    for push in pushes:
        spread = 1.4826 * float(np.nanmedian(np.abs(push)))
        far = np.flatnonzero(push > FAR * max(spread, LEAST_SPREAD_M_S2))
        for i in map(int, far):
            others = [j for j in cells.get(segments[i].cell_key, ()) if j != i]
            if any(push[j] < NEAR * push[i] for j in others):
                found[i] = max(float(push[i]), found.get(i, 0.0))
    return found if len(found) <= MOST * len(segments) else {}


def outlying_in_words(found: Mapping[int, float], segments: Sequence[Segment]) -> str:
    """A sentence on what was set aside."""
    times = [float(segments[i].t_s[0]) for i in found]
    runs = list(dict.fromkeys(segments[i].run for i in found))
    where = f" of {runs[0]}" if len(runs) == 1 else f" of {len(runs)} flights"
    one = len(found) == 1
    when = f"at {times[0]:.0f} s" if one else f"between {min(times):.0f} and {max(times):.0f} s"
    return (
        f"{len(found)} of {len(segments)} responses, {when}{where}, {'was' if one else 'were'} pushed by up to "
        f"{max(found.values()):.1f} m/s^2 and their repeats were not: a gust, or something else that happened once; set aside here"
    )


def _pushes(nuisance: Nuisance, n: int) -> FloatArray:
    """(2, n): along the ground and upwards, m/s^2, less the usual (median over responses); NaN where a response has none."""
    axes = [nuisance.get(f"a_d_{axis}_m_s2", np.full(n, np.nan)) for axis in "xyz"]
    if not all(np.any(np.isfinite(a)) for a in axes):
        return np.empty((0, n))
    x, y, z = (a - np.nanmedian(a) for a in axes)
    return np.stack([np.hypot(x, y), np.abs(z)])
