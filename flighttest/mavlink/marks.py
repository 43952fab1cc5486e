"""Segment marks as STATUSTEXT: `FT <leg id> <phase>`, which the vehicle writes into its onboard log on its own clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flighttest.mavlink.clock import ClockEstimate
from flighttest.mavlink.dialect import Message, dialect
from flighttest.recording import Marker
from flighttest.recording.manifest import EventData

PREFIX = "FT"
TEXT_MAX = 50  # bytes of one STATUSTEXT


@dataclass(frozen=True)
class Text:
    """One STATUSTEXT, or a chunk of one, with the ground time it was sent or received, s."""

    ground_s: float
    system: int
    severity: int
    text: str
    id: int = 0
    chunk: int = 0


def mark_text(leg_id: str, phase: str) -> str:
    """The text of a mark; ValueError where it does not fit (leg ids and phase names are ours: no spaces)."""
    text = f"{PREFIX} {leg_id} {phase}"
    if len(text.encode()) > TEXT_MAX or len(text.split()) != 3:
        raise ValueError(f"mark {text!r} does not fit into one STATUSTEXT of {TEXT_MAX} bytes and three words")
    return text


def mark_message(leg_id: str, phase: str) -> Message:
    """The STATUSTEXT that carries a mark to the vehicle."""
    return dialect.MAVLink_statustext_message(
        severity=dialect.MAV_SEVERITY_INFO, text=mark_text(leg_id, phase).encode()
    )


def parse_mark(text: str) -> tuple[str, str] | None:
    """(leg id, phase) of a mark's text, else None."""
    words = text.split()
    return (words[1], words[2]) if len(words) == 3 and words[0] == PREFIX else None


def mark_markers(t_s: float, text: str) -> list[Marker]:
    """Markers of a mark's text at vehicle time t_s: `leg` at the leg's first phase is left to the caller, which has the order of phases."""
    mark = parse_mark(text)
    if mark is None:
        return []
    leg, phase = mark
    kind = phase if phase in ("abort", "take_over", "link_lost") else "phase"
    return [Marker(t_s, kind, phase, {"leg": leg})]


def markers_from_texts(texts: Sequence[Text], vehicle_system: int, clock: ClockEstimate) -> list[Marker]:
    """Markers of all texts: marks become phases, a leg's first mark a `leg` before it, other texts become notes."""
    markers: list[Marker] = []
    leg_now = ""
    for text in _joined(texts):
        t_s = float(clock.to_vehicle(text.ground_s))
        mark = parse_mark(text.text)
        if mark is None:
            data: EventData = {
                "system": text.system,
                "severity": text.severity,
                "from_vehicle": text.system == vehicle_system,
            }
            markers.append(Marker(t_s, "note", text.text, data))
            continue
        if text.system == vehicle_system:
            continue  # an autopilot that repeats our own mark
        if mark[0] != leg_now:
            leg_now = mark[0]
            markers.append(Marker(t_s, "leg", leg_now, {"leg": leg_now}))
        markers += mark_markers(t_s, text.text)
    return markers


def _joined(texts: Sequence[Text]) -> list[Text]:
    """Long texts put together from their chunks, in order of their first chunk."""
    whole: list[Text] = []
    open_chunks: dict[tuple[int, int], int] = {}
    for text in texts:
        key = (text.system, text.id)
        if text.id and text.chunk and key in open_chunks:
            head = whole[open_chunks[key]]
            whole[open_chunks[key]] = Text(head.ground_s, head.system, head.severity, head.text + text.text, head.id, 0)
            continue
        if text.id:
            open_chunks[key] = len(whole)
        whole.append(text)
    return whole
