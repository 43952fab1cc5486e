"""Telemetry logs (.tlog: 8-byte big-endian microseconds and a MAVLink frame, both directions) to a Recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from flighttest.errors import RecordingError
from flighttest.logs.ardupilot_bin import known_filters
from flighttest.logs.opening import LogFile
from flighttest.mavlink import WANTED, decode_stream
from flighttest.mavlink.dialect import book, parser
from flighttest.recording import Provenance, Recording


def import_tlog(path: Path) -> Recording:
    """Read a telemetry log (plain, .gz or .xz). RecordingError where it holds no vehicle."""
    file = LogFile(path)
    data = b"".join(file.pieces())
    try:
        decoded = decode_stream(_messages(data))
    except RecordingError as error:
        raise RecordingError(f"{path}: {error.message}", error.hint) from error
    return Recording(
        name=path.name.split(".")[0],
        series=decoded.series,
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
            losses=(*file.losses, *decoded.losses),
            filters=known_filters(dict(decoded.parameters)),
            derived=decoded.derived,
            reference_clock=decoded.reference_clock,
        ),
    )


def _messages(data: bytes) -> Iterator[tuple[float, Any]]:
    wanted = {kind.id for kind in book.mavlink_map.values() if kind.msgname in WANTED}
    mav = parser(0, 0)
    at, size = 0, len(data)
    while at + 16 < size:
        start = at + 8
        magic = data[start]
        if magic == 0xFD:
            length = data[start + 1] + 12 + (13 if data[start + 2] & 1 else 0)
            kind = int.from_bytes(data[start + 7 : start + 10], "little")
        elif magic == 0xFE:
            length = data[start + 1] + 8
            kind = data[start + 5]
        else:
            at += 1
            continue
        if kind in wanted and start + length <= size:
            message = mav.decode(bytearray(data[start : start + length]))
            yield int.from_bytes(data[at : at + 8], "big") * 1e-6, message
        at = start + length
