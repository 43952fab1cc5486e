"""What makes recordings doubtful before anything is computed of them: several vehicles, one recording twice, an accelerometer that does not
carry the vehicle, an unstated filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flighttest.frames import G_M_S2
from flighttest.pipeline.recordings.fingerprints import differences, of_recordings
from flighttest.recording import Recording
from flighttest.report.numbers import join
from flighttest.segments.airborne import flights

_WRONG_SHARE = 0.25  # of g: an accelerometer of 2014 read 16 % too little, and what carried the vehicle was seen by it all the same
_FEWEST_S = 5.0  # of flight: a mean of less says little


def inconsistencies(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence for each doubt, the gravest first."""
    found = (conflicts(recordings), not_carried(recordings), repeated(recordings), unfiltered(recordings))
    return tuple(doubt for doubt in found if doubt)


def conflicts(recordings: Sequence[Recording]) -> str:
    """Signs that recordings are not of one vehicle in one state, in one sentence; empty where nothing does."""
    for recording in recordings[1:]:
        names = [str(r.provenance.vehicle.get("name") or "") for r in (recordings[0], recording)]
        named = f"{names[0]} and {names[1]}" if all(names) and names[0] != names[1] else ""
        different = named or differences(of_recordings(recordings[:1], None), [recording])
        if different:
            return f"{recordings[0].name} and {recording.name} are not of one vehicle: {different}; one model of both is a compromise"
    return ""


def not_carried(recordings: Sequence[Recording]) -> str:
    """Whose accelerometer reads something else in flight than what carried the vehicle by its velocity, in one sentence; empty where none
    does. The mean upward force of a flight is g and what the vertical velocity gained, whatever was flown."""
    for recording in recordings:
        if not recording.has("f_z_m_s2", "v_z_m_s", "roll_rad", "pitch_rad"):
            continue
        (t, force), (at, speed) = recording.channel("f_z_m_s2"), recording.channel("v_z_m_s")
        tilt = [np.interp(t, *recording.channel(angle)) for angle in ("roll_rad", "pitch_rad")]
        up = force * np.cos(tilt[0]) * np.cos(tilt[1])
        read, carried, flown_s = 0.0, 0.0, 0.0
        for start, end in flights(recording):
            inside, known = (x & (s >= start) & (s <= end) for x, s in ((np.isfinite(up), t), (np.isfinite(speed), at)))
            if np.count_nonzero(inside) > 1 and np.count_nonzero(known) > 1:
                flown_s += end - start
                read += (end - start) * float(np.mean(up[inside]))
                carried += (end - start) * G_M_S2 + float(speed[known][-1] - speed[known][0])
        if flown_s >= _FEWEST_S and abs(read - carried) > _WRONG_SHARE * G_M_S2 * flown_s:
            return (
                f"the accelerometer of {recording.name} reads {read / flown_s:.1f} m/s^2 up in the mean of the flight, and by the velocity "
                f"{carried / flown_s:.1f} m/s^2 carried the vehicle: it has another unit, or it or its simulator is faulty, and K and "
                "the drag are wrong by as much"
            )
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
