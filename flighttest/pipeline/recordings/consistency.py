"""What makes recordings doubtful before anything is computed of them: several vehicles, one recording twice, an unstated filter."""

from __future__ import annotations

from collections.abc import Sequence

from flighttest.pipeline.recordings.fingerprints import differences, of_recordings
from flighttest.recording import Recording
from flighttest.report.numbers import join


def inconsistencies(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence for each doubt, the gravest first."""
    return tuple(doubt for doubt in (conflicts(recordings), repeated(recordings), unfiltered(recordings)) if doubt)


def conflicts(recordings: Sequence[Recording]) -> str:
    """Signs that recordings are not of one vehicle in one state, in one sentence; empty where nothing does."""
    for recording in recordings[1:]:
        names = [str(r.provenance.vehicle.get("name") or "") for r in (recordings[0], recording)]
        named = f"{names[0]} and {names[1]}" if all(names) and names[0] != names[1] else ""
        different = named or differences(of_recordings(recordings[:1], None), [recording])
        if different:
            return f"{recordings[0].name} and {recording.name} are not of one vehicle: {different}; one model of both is a compromise"
    return ""


def repeated(recordings: Sequence[Recording]) -> str:
    """Which recording was given twice, in one sentence; empty where none was."""
    kept = {_content(r): r.name for r in deduplicate(recordings)}
    again = next((r for r in recordings if kept[_content(r)] != r.name), None)
    return "" if again is None else f"{kept[_content(again)]} and {again.name} are one recording: it is counted once"


def unfiltered(recordings: Sequence[Recording]) -> str:
    """Whose accelerometer may have a filter that was not declared, in one sentence; empty where none has."""
    names = [r.name for r in recordings if r.has("f_z_m_s2") and "specific_force" not in r.provenance.filters]
    if not names:
        return ""
    return (
        f"the accelerometer's filter is not stated for {join(names)}: none is assumed, and one reads as a slower thrust "
        "(filters_hz: {specific_force: Hz} in a column map)"
    )


def deduplicate(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Each recording the first time it was given: a second time it would narrow every interval and repeat its own noise."""
    first: dict[str, Recording] = {}
    for recording in recordings:
        first.setdefault(_content(recording), recording)
    return tuple(first.values())


def _content(recording: Recording) -> str:
    return recording.provenance.sha256 or recording.name
