"""Every second of a recording: used as a step, used as a window of free flight, or not used and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from flighttest.recording import Recording
from flighttest.segments import edges as ed
from flighttest.segments.airborne import control_lost, flights
from flighttest.segments.model import Segment

PAUSE_S = 1.0  # a longer stretch without any sample was not recorded


class Use(Enum):
    """What became of a stretch. The value is the sentence shown to the reader."""

    STEP = "used as a step"
    FREE = "used as a window of free flight"
    REJECTED = "cut, and rejected"
    PAUSE = "nothing was recorded"
    GROUND = "before take-off, after landing or on the ground"
    LOST = "after control was lost: roll or pitch more than 30 degrees from what was asked for, and not yet shown to follow again"
    UNKNOWN = "no command was recorded (for example while the autopilot holds a position)"
    BETWEEN = "between steps: held still, interrupted, or too short for a window"
    SHORT = "too short for a window"

    @property
    def used(self) -> bool:
        """Whether a fit may see it."""
        return self in (Use.STEP, Use.FREE)


@dataclass(frozen=True)
class Stretch:
    """From start_s to end_s, s; why: of a rejected one, its flaw in words."""

    start_s: float
    end_s: float
    use: Use
    why: str = ""


def budget(recording: Recording, segments: Sequence[Segment]) -> tuple[Stretch, ...]:
    """The whole recording in order of time, without gaps or overlaps. segments: what was cut of it."""
    start, end = recording.t_span_s
    own = [s for s in segments if s.t_s.size]
    spans, lost = flights(recording), control_lost(recording)
    pauses, known = _pauses(recording, start, end), _known(recording, end)
    times = [start, end, *(t for pairs in (spans, lost, pauses, known) for pair in pairs for t in pair)]
    times += [float(t) for s in own for t in (s.t_s[0], s.t_s[-1])]
    bounds = np.unique(np.clip(times, start, end))
    steps = any(s.kind != "free" for s in own)
    found: list[Stretch] = []
    for a, b in pairwise(bounds):
        use, why = _use(0.5 * float(a + b), own, spans, lost, pauses, known, steps)
        if found and (found[-1].use, found[-1].why) == (use, why):
            found[-1] = Stretch(found[-1].start_s, float(b), use, why)
        else:
            found.append(Stretch(float(a), float(b), use, why))
    return tuple(found)


def _use(
    t: float,
    segments: Sequence[Segment],
    spans: Sequence[tuple[float, float]],
    lost: Sequence[tuple[float, float]],
    pauses: Sequence[tuple[float, float]],
    known: Sequence[tuple[float, float]],
    steps: bool,
) -> tuple[Use, str]:
    here = [s for s in segments if s.t_s[0] <= t <= s.t_s[-1]]
    usable = [s for s in here if s.usable]
    if any(s.kind != "free" for s in usable):
        return Use.STEP, ""
    if usable:
        return Use.FREE, ""
    if here:
        return Use.REJECTED, here[0].flaws[0].value
    if _within(t, pauses):
        return Use.PAUSE, ""
    if _within(t, lost):
        return Use.LOST, ""
    if not _within(t, spans):
        return Use.GROUND, ""
    if not _within(t, known):
        return Use.UNKNOWN, ""
    return (Use.BETWEEN if steps else Use.SHORT), ""


def _within(t: float, stretches: Sequence[tuple[float, float]]) -> bool:
    return any(a <= t <= b for a, b in stretches)


def _pauses(recording: Recording, start: float, end: float) -> list[tuple[float, float]]:
    """Stretches in which no motion was recorded."""
    moving = [
        s.t_s
        for g, s in recording.series.items()
        if g in ("attitude", "rates", "specific_force", "velocity", "position")
    ]
    times = np.unique(np.concatenate([[start], *moving, [end]]))
    gaps = np.flatnonzero(np.diff(times) > PAUSE_S)
    return [(float(times[i]), float(times[i + 1])) for i in gaps]


def _known(recording: Recording, end: float) -> list[tuple[float, float]]:
    """Stretches in which references were recorded: streamed ones only for as long as they came."""
    references = ed.references_of(recording)
    if references is None:
        return []
    known = references.t_s[np.isfinite(references.values).any(axis=1)]
    if not known.size:
        return []
    if not references.streamed:
        return [(float(known[0]), end)]
    breaks = np.flatnonzero(np.diff(known) > PAUSE_S)
    first = [float(known[0]), *(float(known[i + 1]) for i in breaks)]
    last = [*(float(known[i]) for i in breaks), float(known[-1])]
    return [(a, b + references.period_s) for a, b in zip(first, last, strict=True)]
