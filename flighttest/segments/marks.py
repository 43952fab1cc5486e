"""Marked stretches of a recording: legs of our own flights, `STEP ...` texts, numbered steps of a table."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from flighttest.recording import Marker, Recording
from flighttest.recording.manifest import EventData

_STEP = re.compile(r"^STEP\s+(\w+)\b(.*)$", re.IGNORECASE)
_FREE = re.compile(r"^FREE(\s+\w+)?$", re.IGNORECASE)
_REPEAT = re.compile(r"^r(\d+)$")
# The words people write for the reference they step.
_KINDS = {
    "roll": ("roll_step",), "pitch": ("pitch_step",), "yaw": ("yaw_rate_step",), "yawrate": ("yaw_rate_step",),
    "yaw_rate": ("yaw_rate_step",), "thrust": ("throttle_step", "tilt_throttle"), "throttle": ("throttle_step", "tilt_throttle"),
}  # fmt: skip
_ID_MAX = 32
_PHASES = frozenset({"phase", "abort", "take_over", "link_lost"})
_OVER = frozenset({"reset", "end", "done", "abort", "take_over", "link_lost", "landing"})
_OUTCOMES = {"abort": "ABORTED", "take_over": "TAKE_OVER", "link_lost": "LINK_LOST"}
_LEAD = frozenset({"entry", "hold_0"})
_AFTER = frozenset({"coast", "settle", "stop", "counter"})


@dataclass(frozen=True)
class Marked:
    """One marked stretch: from start_s to end_s.

    kinds: what the mark calls it (empty: anything). t_step_s: where the mark puts the step, None where it has none. record_s: where
    a stretch without a step is worth cutting into windows, None for nowhere. repeat: which repeat of its step, from 1; 0 where the
    mark does not hold it. numbered: a step number of a table made the mark, which holds neither what the step is nor where exactly.
    outcome: how the leg ended, where that was recorded.
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
    outcome: str = ""
    data: EventData = field(default_factory=EventData)


def marked(recording: Recording) -> list[Marked]:
    """All marked stretches in order of time; empty for a recording without marks."""
    legs = _legs(recording)
    known = [leg for leg in legs if "kind" in leg.data]
    return known or legs or _texts(recording)


def _legs(recording: Recording) -> list[Marked]:
    legs = [m for m in recording.markers if m.kind == "leg"]
    return [_leg(recording, m, legs[i + 1].t_s if i + 1 < len(legs) else None) for i, m in enumerate(legs)]


def _leg(recording: Recording, leg: Marker, next_s: float | None) -> Marked:
    end = next_s if next_s is not None else recording.t_span_s[1]
    phases = [m for m in recording.markers if m.kind in _PHASES and leg.t_s - 1e-3 <= m.t_s < end]
    over = next((m for m in phases if m.label in _OVER and m.t_s > leg.t_s), None)
    end = min(end, over.t_s) if over is not None else end
    outcome = next((str(m.data["outcome"]) for m in phases if "outcome" in m.data), "")
    if not outcome and over is not None and over.label in _OUTCOMES:
        outcome = _OUTCOMES[over.label]
    step = next((m.t_s for m in phases if m.label == "step"), None)
    first, last = _recorded(phases, leg.t_s, end)
    words = leg.label.split("/")
    repeat = _REPEAT.match(words[-1])
    kind = str(leg.data.get("kind", ""))
    stated = leg.data.get("repeat")
    rest = kind == "rest" or any(word.startswith("rest") for word in words)
    return Marked(
        name=leg.label,
        start_s=leg.t_s,
        end_s=end,
        kinds=(kind,) if kind and kind not in ("free", "rest") else (),
        t_step_s=step,
        record_s=None if rest else (first, last),
        # A mark carries the last 32 bytes of a leg's id: what is left of a maneuver's name then is not its name.
        maneuver=str(
            leg.data.get("maneuver", words[0] if len(words) > 1 and len(leg.label.encode()) < _ID_MAX else "")
        ),
        repeat=stated if isinstance(stated, int) else int(repeat.group(1)) if repeat else 0,
        numbered="step" in leg.data,
        outcome=outcome,
        data=leg.data,
    )


def _recorded(phases: list[Marker], start_s: float, end_s: float) -> tuple[float, float]:
    """Where the leg's record lies: by the plan's own flags, else by what phases are called."""
    if any("record" in m.data for m in phases):
        wanted = [m for m in phases if m.data.get("record")]
        begin = wanted[0].t_s if wanted else start_s
        after = [m.t_s for m in phases if m.t_s > begin and m.data.get("record") is False]
    else:
        begin = next((m.t_s for m in phases if m.label not in _LEAD), start_s)
        after = [m.t_s for m in phases if m.t_s > begin and m.label in _AFTER]
    return begin, min([*after, end_s])


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
