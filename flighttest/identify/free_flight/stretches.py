"""Stretches of free flight without gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.equation_error import InitialStates
from flighttest.estimation.responses import attitude_is_known
from flighttest.physics.blocks import FORCE, VELOCITY
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

JOIN_PERIODS = 2.5  # windows this near to each other are one stretch
SHORTEST_S = 4.0


def stretches(segments: Sequence[Segment], part: str = "translation") -> list[Segment]:
    """Usable segments of each recording with what a part of the model is estimated from (`estimation.estimator.BLOCKS`), those that adjoin
    or overlap joined: attitude; for the translation heading, throttle and velocity or specific force, too."""
    can = _translates if part == "translation" else attitude_is_known
    fit = [s for s in segments if s.usable and s.t_s.size > 2 and can(s)]
    groups: list[list[Segment]] = []
    for s in sorted(fit, key=lambda s: (s.run, s.t_s[0])):
        if groups:
            before = groups[-1][-1]
            period = float(np.median(np.diff(before.t_s)))
            if before.run == s.run and s.t_s[0] - before.t_s[-1] <= JOIN_PERIODS * period:
                groups[-1].append(s)
                continue
        groups.append([s])
    return [one for one in (_joined(g) for g in groups) if one.t_s[-1] - one.t_s[0] >= SHORTEST_S]


def _translates(s: Segment) -> bool:
    moved = recorded(s, VELOCITY) or recorded(s, FORCE)
    return moved and recorded(s, ("yaw_rad",)) and "throttle" in s.u and attitude_is_known(s)


def recorded(s: Segment, channels: Sequence[str]) -> bool:
    """Whether all of these channels were."""
    return all(np.isfinite(s.y.get(n, np.nan)).any() for n in channels)


def _joined(windows: Sequence[Segment]) -> Segment:
    """One segment of windows in order."""
    t = np.concatenate([w.t_s for w in windows])
    t, first = np.unique(t, return_index=True)
    names = dict.fromkeys(n for w in windows for n in w.y)
    y = {n: np.concatenate([w.y.get(n, np.full(w.t_s.size, np.nan)) for w in windows])[first] for n in names}
    if "yaw_rad" in y:
        good = np.isfinite(y["yaw_rad"])
        y["yaw_rad"][good] = np.unwrap(y["yaw_rad"][good])
    u: dict[str, tuple[FloatArray, FloatArray]] = {}
    for w in windows:
        for name, (times, values) in w.u.items():
            if name not in u:
                u[name] = times, values
                continue
            new = times > u[name][0][-1]
            u[name] = np.append(u[name][0], times[new]), np.append(u[name][1], values[new])
    head = windows[0]
    context = replace(head.context, voltage_samples=None)
    return replace(head, name=f"{head.run} {t[0]:.0f} s", t_s=t, y=y, u=u, context=context)


class Residual(NamedTuple):
    """What one equation leaves over a stretch. stretch: its number; channel; residual (n,) measured less modelled; slopes (n, q)
    derivatives of the modelled by the parameters asked for; state (n, k) that the equation may be wrong as a function of
    (`estimation.equation_error.lack_of_fit`); initial: derivatives by initial states that nothing measured."""

    stretch: int
    channel: str
    residual: FloatArray
    slopes: FloatArray
    state: FloatArray
    initial: InitialStates = InitialStates()


def sampling_period_s(flown: Sequence[Segment]) -> float:
    """Median time between samples."""
    return float(np.median(np.concatenate([np.diff(s.t_s) for s in flown])))


def chunk(s: Segment, changed: Mapping[str, FloatArray], a: int, b: int) -> Segment:
    """Samples a to b of a stretch, with the edges that reach into them; changed: channels in the place of those recorded."""
    y = {n: v[a:b] for n, v in {**s.y, **changed}.items()}
    u = {}
    for name, (times, values) in s.u.items():
        first = max(int(np.searchsorted(times, s.t_s[a] - 1.0)) - 1, 0)
        last = max(int(np.searchsorted(times, s.t_s[b - 1])), first + 1)
        u[name] = times[first:last], values[first:last]
    return replace(s, t_s=s.t_s[a:b], y=y, u=u)


def most_moved(flown: Sequence[Segment], inputs: Sequence[str], seconds: float, count: int) -> list[Segment]:
    """So many pieces of stretches, of so many seconds in all at most, in which these inputs move most."""
    pieces: list[tuple[float, int, Segment]] = []
    for s in flown:
        period = float(np.median(np.diff(s.t_s)))
        n = max(round(seconds / count / period), 10)
        for a in range(0, max(s.t_s.size - n, 1), n):
            piece = chunk(s, {}, a, min(a + n, s.t_s.size))
            moved = sum(float(np.std(piece.u[name][1])) for name in inputs if name in piece.u)
            pieces.append((moved, len(pieces), piece))
    return [p for _, _, p in sorted(pieces, reverse=True)[:count]]


def unbroken(t: FloatArray, good: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Index ranges without holes: samples that are good and follow each other."""
    if t.size < 3:
        return []
    period = float(np.median(np.diff(t)))
    breaks = np.flatnonzero(~good[1:] | ~good[:-1] | (np.diff(t) > JOIN_PERIODS * period)) + 1
    bounds = [0, *breaks.tolist(), t.size]
    return [(a, b) for a, b in pairwise(bounds) if b - a >= 3 and good[a:b].all()]
