"""Marked stretches of a recording: legs of our own flights, `STEP ...` texts, numbered steps of a table."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from flighttest.recording import Marker, Recording

_STEP = re.compile(r"^STEP\s+(\w+)\b(.*)$", re.IGNORECASE)
_FREE = re.compile(r"^FREE(\s+\w+)?$", re.IGNORECASE)
_REPEAT = re.compile(r"^r(\d+)$")
# The words people write for the reference they step.
_KINDS = {
    "roll": ("roll_step",), "pitch": ("pitch_step",), "yaw": ("yaw_rate_step",), "yawrate": ("yaw_rate_step",),
    "yaw_rate": ("yaw_rate_step",), "thrust": ("throttle_step", "tilt_throttle"), "throttle": ("throttle_step", "tilt_throttle"),
}  # fmt: skip
_OVER = {"reset", "end", "done", "settle", "abort", "take_over", "link_lost", "landing", "idle"}
_LEAD = {"entry", "hold_0", "goto", "climb"}


@dataclass(frozen=True)
class Marked:
    """One marked stretch: from start_s to end_s.

    kinds: what the mark says it is (empty: anything). t_step_s: where the mark puts the step, None where it does not say. record_s: where
    a stretch without a step is worth cutting into windows, None for nowhere. repeat 0: to be counted. numbered: a step number of a table
    made the mark, which says neither what the step is nor where exactly.
    """

    name: str
    start_s: float
    end_s: float
    kinds: tuple[str, ...] = ()
    t_step_s: float | None = None
    record_s: tuple[float, float] | None = None
    maneuver: str = ""
    repeat: int = 0
    numbered: bool = False
    data: Mapping[str, Any] = field(default_factory=dict)


def marked(recording: Recording) -> list[Marked]:
    """All marked stretches in order of time; empty for a recording nobody marked."""
    legs = [m for m in recording.markers if m.kind == "leg"]
    if legs:
        return [_leg(recording, m, legs[i + 1].t_s if i + 1 < len(legs) else None) for i, m in enumerate(legs)]
    return _texts(recording)


def _leg(recording: Recording, leg: Marker, next_s: float | None) -> Marked:
    end = next_s if next_s is not None else recording.t_span_s[1]
    phases = [m for m in recording.markers if m.kind == "phase" and leg.t_s - 1e-3 <= m.t_s < end]
    over = next((m.t_s for m in phases if m.label in _OVER - {"settle"} and m.t_s > leg.t_s), None)
    end = min(end, over) if over is not None else end
    step = next((m.t_s for m in phases if m.label == "step"), None)
    first = next((m.t_s for m in phases if m.label not in _LEAD), leg.t_s)
    last = next((m.t_s for m in phases if m.t_s > first and m.label in _OVER | {"coast"}), end)
    words = leg.label.split("/")
    repeat = _REPEAT.match(words[-1])
    kind = str(leg.data.get("kind", ""))
    rest = kind == "rest" or any(word.startswith("rest") for word in words)
    return Marked(
        name=leg.label,
        start_s=leg.t_s,
        end_s=end,
        kinds=(kind,) if kind and kind not in ("free", "rest") else (),
        t_step_s=step,
        record_s=None if rest else (first, last),
        maneuver=str(leg.data.get("maneuver", words[0] if len(words) > 1 else "")),
        repeat=int(leg.data.get("repeat", repeat.group(1) if repeat else 0)),
        numbered="step" in leg.data,
        data=leg.data,
    )


def _texts(recording: Recording) -> list[Marked]:
    notes = [m for m in recording.markers if m.kind == "note"]
    marks = [m for m in notes if _STEP.match(m.label) or _FREE.match(m.label) or m.label in ("BEGIN", "END")]
    if not any(_STEP.match(m.label) or _FREE.match(m.label) for m in marks):
        return []
    found: list[Marked] = []
    for i, mark in enumerate(marks):
        end = marks[i + 1].t_s if i + 1 < len(marks) else recording.t_span_s[1]
        step = _STEP.match(mark.label)
        if step:
            kinds = _KINDS.get(step.group(1).lower(), ())
            found.append(
                Marked(mark.label, mark.t_s, end, kinds, maneuver=kinds[0] if kinds else step.group(1).lower())
            )
        elif _FREE.match(mark.label) and "end" not in mark.label.lower():
            found.append(Marked("FREE", mark.t_s, end, record_s=(mark.t_s, end), maneuver="free"))
    return found
