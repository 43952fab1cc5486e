"""Telemetry logs (.tlog: 8-byte big-endian microseconds and a MAVLink frame, both directions) to a Recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from flighttest.errors import RecordingError
from flighttest.logs.ardupilot.importer import DEFAULT_ACCEL_FILTER_HZ, known_filters
from flighttest.logs.opening import LogFile, name_of
from flighttest.logs.other_vehicles import quadplane, refuse_by_type
from flighttest.logs.timing import clock_steps, held_union, outliers
from flighttest.mavlink import WANTED
from flighttest.mavlink.dialect import dialect
from flighttest.mavlink.tlog_frames import Frames, decoder_of, fields_of, good_checksums, split
from flighttest.recording import Provenance, Recording, Series

_SEQUENCE_LOSS = 0.005  # the share of missing sequence numbers that is worth a sentence


def import_tlog(path: Path) -> Recording:
    """Read a telemetry log (plain, .gz or .xz) of one vehicle. RecordingError where it holds none."""
    file = LogFile(path)
    data = b"".join(file.pieces())
    frames = split(data)
    if frames.at.size == 0:
        raise RecordingError(
            f"{path}: no MAVLink frame was found in {len(data)} bytes", "is this a telemetry log (.tlog)?"
        )
    losses = [*file.losses, *_lost_sentences(frames)]
    frames = _on_one_clock(_checked(frames, losses), losses)
    decoder = decoder_of(frames)
    try:
        decoded = decoder.result()
    except RecordingError as error:
        raise RecordingError(f"{path}: {error.message}", error.hint) from error
    winged = refuse_by_type(path, decoded.vehicle_type, decoded.parameters)
    others = sorted({system for system, _ in decoder.autopilots} - {decoded.vehicle_system})
    if others:
        losses.append(
            f"the log holds several vehicles; system {decoded.vehicle_system} was read, not {', '.join(map(str, others))}"
        )
    series, derived = _with_targets(dict(decoded.series), dict(decoded.derived))
    filters = known_filters(dict(decoded.parameters))
    if "specific_force" not in filters and decoded.autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
        filters["specific_force"] = DEFAULT_ACCEL_FILTER_HZ
        losses.append(
            f"INS_ACCEL_FILTER was not recorded: the autopilot's default of {DEFAULT_ACCEL_FILTER_HZ:g} Hz is assumed"
        )
    recording = Recording(
        name=name_of(path),
        series=series,
        markers=decoded.markers,
        provenance=Provenance(
            source=str(path),
            importer="tlog",
            sha256=file.sha256,
            firmware=decoded.firmware,
            parameters=decoded.parameters,
            clock={
                "offset_s": decoded.clock.offset_s,
                "error_s": decoded.clock.error_s,
                "method": decoded.clock.method,
                "system": decoded.vehicle_system,
            },
            losses=(*losses, *decoded.losses),
            filters=filters,
            derived=derived,
            reference_clock=decoded.reference_clock,
            autopilot=decoded.board,
        ),
    )
    return quadplane(path, recording) if winged else recording


def _with_targets(series: dict[str, Series], derived: dict[str, str]) -> tuple[dict[str, Series], dict[str, str]]:
    """Where the ground's targets were not recorded, the autopilot's own are taken for them; `derived` notes it."""
    shaped, reference = series.get("shaped"), series.get("reference")
    if shaped is None or (reference is not None and "roll_ref_rad" in reference.columns):
        return series, derived
    columns = {name.replace("_shaped_", "_ref_"): values for name, values in shaped.columns.items()}
    parts = [(shaped.t_s, columns)]
    if reference is not None:
        parts.append((reference.t_s, dict(reference.columns)))
    sentence = "the autopilot's own target is taken for the reference: no SET_ATTITUDE_TARGET was recorded"
    return {**series, "reference": held_union(parts)}, {**derived, **dict.fromkeys(columns, sentence)}


def _checked(frames: Frames, losses: list[str]) -> Frames:
    """Frames whose checksum and time stamp are right, as far as the dialect defines them; what is dropped is noted."""
    good = np.ones(frames.at.size, dtype=bool)
    unknown = 0
    for kind in np.unique(frames.kind):
        chosen = np.flatnonzero(frames.kind == kind)
        if int(kind) in dialect.mavlink_map:
            good[chosen] = good_checksums(frames.where(chosen), int(kind))
        else:
            unknown += chosen.size
    if unknown:
        losses.append(f"{unknown} of {good.size} messages are of types the ArduPilot dialect does not define")
    if not good.all():
        first = int(frames.at[np.flatnonzero(~good)[0]])
        losses.append(
            f"{int(np.count_nonzero(~good))} of {good.size} messages have a wrong checksum and were dropped (first at byte {first})"
        )
    wild = good & outliers(frames.time_s)
    if wild.any():
        losses.append(f"{int(np.count_nonzero(wild))} messages have a damaged time stamp and were dropped")
    kept = frames.where(good & ~wild)
    losses += missing_messages(kept)
    return kept


def _on_one_clock(frames: Frames, losses: list[str]) -> Frames:
    """Frames as if the ground's clock had not been set while it recorded, by the stamps of the vehicle that sent most."""
    best = np.zeros(0, dtype=np.int64)
    for kind in np.unique(frames.kind):
        message = dialect.mavlink_map.get(int(kind))
        if message is None or message.msgname not in WANTED or "time_boot_ms" not in message.fieldnames:
            continue
        chosen = np.flatnonzero((frames.kind == kind) & (frames.kind != dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET))
        senders, counts = np.unique(frames.sender[chosen], return_counts=True)
        if counts.size and int(np.max(counts)) > best.size:
            best = chosen[frames.sender[chosen] == senders[np.argmax(counts)]]
    if best.size < 2:
        return frames
    mine = frames.where(best)
    made_s = fields_of(mine, int(mine.kind[0]))["time_boot_ms"].astype(np.float64) * 1e-3
    steps = clock_steps(mine.time_s, made_s)
    found = np.flatnonzero(steps)
    if not found.size:
        return frames
    words = ", ".join(f"{steps[i]:+.1f} s" for i in found[:5])
    losses.append(f"the clock of the computer that recorded was set {found.size} times ({words}); put right")
    taken_us = np.zeros(frames.at.size, dtype=np.int64)
    for i in found:
        between = np.diff(frames.stamp_us[best[i - 1] : best[i] + 1]) * np.sign(steps[i])
        taken_us[best[i - 1] + 1 + int(np.argmax(between)) :] += round(steps[i] * 1e6)
    return replace(frames, stamp_us=frames.stamp_us - taken_us)


def missing_messages(frames: Frames) -> list[str]:
    """Sentences on messages that never arrived, by gaps in each sender's sequence numbers."""
    sentences: list[str] = []
    for one in np.unique(frames.sender):
        sequence = frames.sequence[frames.sender == one].astype(np.int64)
        # Frames that overtook one another step back a little: that is no loss.
        steps = (np.diff(sequence) + 127) % 256 - 128
        missing = max(int(np.sum(steps)), 0) if sequence.size > 1 else 0
        # A sender that restarts its count, or counts per link, looks like a loss of everything: nothing is reported then.
        if _SEQUENCE_LOSS * sequence.size < missing < sequence.size:
            share = 100.0 * missing / (missing + sequence.size)
            sentences.append(
                f"about {missing} messages ({share:.1f} %) of system {one // 256}/{one % 256} never arrived"
            )
    return sentences


def _lost_sentences(frames: Frames) -> list[str]:
    total = sum(size for _, size in frames.lost)
    if not total:
        return []
    shown = ", ".join(f"{size} at {at}" for at, size in frames.lost[:5])
    more = f" and {len(frames.lost) - 5} more places" if len(frames.lost) > 5 else ""
    return [f"{total} of {frames.data.size} bytes could not be read as MAVLink frames: {shown}{more}"]
