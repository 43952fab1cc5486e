"""`flighttest fetch-log`: the onboard log, over MAVLink."""

from __future__ import annotations

from pathlib import Path

from flighttest.errors import InputError
from flighttest.flight.preparation.preflight import refuse_other_vehicles
from flighttest.link.onboard import fetch
from flighttest.link.parameters import read_parameter
from flighttest.link.session import Session
from flighttest.logs.other_vehicles import NO_MULTIROTORS
from flighttest.mavlink.dialect import Message, dialect
from flighttest.mavlink.signing import read_key
from flighttest.pipeline.recordings.sources import open_recording
from flighttest.pipeline.results import SILENT, Progress, Result
from flighttest.pipeline.vehicles.live import BUILTIN
from flighttest.recording.store import MANIFEST_NAME, write_recording
from flighttest.report.document import Document


def fetch_log(
    url: str, output: Path, number: int | None = None, progress: Progress = SILENT, key: Path | None = None
) -> Result:
    """Download an onboard log: into a file named so, or as onboard.bin into a run folder (made where there is none)."""
    is_file = output.suffix.lower() in (".bin", ".ulg", ".log")
    path = output if is_file else output / "onboard.bin"
    if url == BUILTIN:
        raise InputError(
            "the built-in vehicle keeps no onboard log: what it sends is in its run's raw.tlog",
            "name a vehicle that keeps one, as tcp:HOST:PORT; `flighttest sim --backend sitl` starts an ArduPilot that does",
        )
    progress.stage(f"connecting to {url}")
    words = -1

    def report(share: float) -> None:
        nonlocal words
        tenth = int(share * 10)
        if tenth > words:
            words = tenth
            progress.stage(f"downloading: {tenth * 10} %")

    log = fetch(url, path, number, report, read_key(key) if key is not None else None, refuse_unreadable)
    if not is_file and not (output / MANIFEST_NAME).exists():
        progress.stage("reading the log")
        write_recording(output, open_recording(path))
    facts = {
        "log": f"{log.number} {log.date}".strip(),
        "size": f"{log.size_bytes / 1e6:.1f} MB",
        "by": log.by,
        "file": str(path),
    }
    document = Document("fetch-log", f"Log {log.number} is in {path}.", "good", (), facts)
    return Result(document, {"file": str(path), "number": log.number, "date": log.date, "size_bytes": log.size_bytes})


def refuse_unreadable(session: Session, beat: Message) -> None:
    """LinkError for a vehicle whose log no import takes, before minutes of a download. A quadplane's HEARTBEAT is a fixed-wing
    aircraft's, and its log is taken."""
    quadplane = beat.type == dialect.MAV_TYPE_FIXED_WING and read_parameter(session, "Q_ENABLE")
    if beat.type in NO_MULTIROTORS and not quadplane:
        refuse_other_vehicles(beat)
