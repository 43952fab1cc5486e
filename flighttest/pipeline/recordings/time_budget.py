"""The time budget of recordings: how much of them is used, and why the rest is not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypedDict

from flighttest.identify.selection import LOG_REFERENCES, NOTHING_ASKED, nothing_asked
from flighttest.recording import Recording
from flighttest.report.document import Cell, Section, Table
from flighttest.report.numbers import number
from flighttest.segments import Segment, Use, budget


class TimeShare(TypedDict):
    """One use of recorded time, or one reason why it was not used."""

    use: str
    sentence: str
    used: bool
    seconds: float
    share: float
    stretches: int


def time_data(recordings: Sequence[Recording], segments: Sequence[Segment]) -> list[TimeShare]:
    """What became of every second, largest share first, used stretches before the others: use, why, seconds, share, stretches."""
    rows: dict[tuple[Any, str], list[float]] = {}
    for recording in recordings:
        for s in budget(recording, [one for one in segments if one.run == recording.name]):
            rows.setdefault((s.use, s.why), []).append(s.end_s - s.start_s)
    total = sum(sum(lengths) for lengths in rows.values()) or 1.0
    ordered = sorted(rows.items(), key=lambda row: (not row[0][0].used, -sum(row[1])))
    return [
        {
            "use": use.name.lower(),
            "sentence": f"{use.value}: {why}" if why else use.value,
            "used": use.used,
            "seconds": sum(lengths),
            "share": sum(lengths) / total,
            "stretches": len(lengths),
        }
        for (use, why), lengths in ordered
    ]


def in_the_air_s(data: Sequence[TimeShare]) -> float:
    """Time of which anything was recorded and that is known to be in the air, s: what lost control flies, falls or lies."""
    elsewhere = [use.name.lower() for use in (Use.GROUND, Use.PAUSE, Use.LOST)]
    return sum(row["seconds"] for row in data if row["use"] not in elsewhere)


def time_section(recordings: Sequence[Recording], segments: Sequence[Segment], *, brief: bool = False) -> Section:
    """The same as a table. brief: a sentence stands for it on a terminal, unless everything is asked for."""
    data = time_data(recordings, segments)
    used = sum(row["seconds"] for row in data if row["used"])
    total = sum(row["seconds"] for row in data)
    rows = tuple(
        (
            Cell(row["sentence"], "good" if row["used"] else "quiet"),
            f"{row['seconds']:.1f}",
            f"{row['share']:.0%}",
            str(row["stretches"]),
        )
        for row in data
    )
    heads = ("what became of it", "s", "share", "stretches")
    sentence = f"{number(used, 3)} of {number(total, 3)} s are used"
    if nothing_asked(segments):
        sentence = f"none of {number(total, 3)} s can be used: {NOTHING_ASKED}; {LOG_REFERENCES}"
    if brief:
        short = f"{sentence}; --all shows what became of the rest."
        return Section("time", "", (Table(heads, rows, ("left", "right", "right", "right"), brief=short),))
    return Section("time", "Time budget", (Table(heads, rows, ("left", "right", "right", "right")),), f"{sentence}.")
