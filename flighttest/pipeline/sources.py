"""Where recordings come from: run folders, and logs imported on the fly. Several at once in processes."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from flighttest.errors import InputError, RecordingError
from flighttest.logs import import_log as read_log
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.recording import Recording
from flighttest.report.document import Bullets, Cell, Document, Section, Table
from flighttest.report.numbers import duration, number


def open_recording(path: Path, columns: Path | None = None) -> Recording:
    """A run folder or a log of any kind as a Recording. RecordingError says what is wrong with it."""
    if not path.exists():
        raise RecordingError(f"{path}: there is no such run or log", "`flighttest runs` lists the runs on this machine")
    if path.is_dir():
        from flighttest.recording.store import load_run

        return load_run(path)
    return read_log(path, columns)


def open_recordings(
    paths: Sequence[Path], columns: Path | None = None, workers: int = 1, progress: Progress = SILENT
) -> tuple[Recording, ...]:
    """All of them, in order; each name is made unique, since segments carry it."""
    if workers > 1 and len(paths) > 1:
        progress.stage(f"reading {len(paths)} recordings in {min(workers, len(paths))} processes")
        with ProcessPoolExecutor(min(workers, len(paths))) as pool:
            found = list(pool.map(partial(open_recording, columns=columns), paths))
    else:
        found = []
        for path in paths:
            progress.stage(f"reading {path}")
            found.append(open_recording(path, columns))
    names: set[str] = set()
    unique = []
    for recording in found:
        name, count = recording.name, 2
        while name in names:
            name, count = f"{recording.name}-{count}", count + 1
        names.add(name)
        unique.append(
            recording
            if name == recording.name
            else Recording(name, recording.series, recording.markers, recording.provenance)
        )
    return tuple(unique)


def import_log(
    log: Path, output: Path, columns: Path | None = None, vehicle: Path | None = None, progress: Progress = SILENT
) -> Result:
    """Bring a log into a run folder."""
    from dataclasses import replace

    from flighttest.recording.store import save_run
    from flighttest.vehicle.load import load_vehicle

    if log.is_dir():
        raise InputError(f"{log} is a folder", "name the log file; a run folder needs no import")
    if output.exists() and any(output.iterdir()):
        raise InputError(f"{output} is not empty", "name a folder that does not exist yet")
    declared = load_vehicle(vehicle) if vehicle is not None else None
    progress.stage(f"reading {log}")
    recording = open_recording(log, columns)
    if declared is not None:
        provenance = replace(
            recording.provenance, components=dict(declared.components), vehicle=_vehicle_data(declared)
        )
        recording = replace(recording, provenance=provenance)
    progress.stage(f"writing {output}")
    save_run(recording, output, raw=log)
    return describe(recording, output)


def _vehicle_data(vehicle: object) -> dict[str, object]:
    from flighttest.report.plain import plain

    return dict(plain(vehicle))


def describe(recording: Recording, folder: Path) -> Result:
    """What is in a recording: channels with rate and span, what was lost, what was derived."""
    first, last = recording.t_span_s
    source = recording.provenance
    rows = []
    channels = {}
    for group, series in recording.series.items():
        missing = {n: float((v != v).mean()) for n, v in series.columns.items()}
        worst = max(missing.values(), default=0.0)
        rows.append(
            (
                group,
                ", ".join(series.columns),
                f"{number(series.rate_hz, 3)} Hz",
                f"{len(series)}",
                Cell(f"{worst:.0%} missing" if worst > 0.005 else "", "warn"),
            )
        )
        channels[group] = {
            "columns": list(series.columns),
            "rate_hz": series.rate_hz,
            "samples": len(series),
            "missing": missing,
        }
    table = Table(("group", "channels", "rate", "samples", ""), tuple(rows), ("left", "left", "right", "right", "left"))
    sections = [Section("channels", "Channels", (table,))]
    if source.losses:
        sections.append(Section("losses", "What was lost", (Bullets(source.losses),)))
    if source.derived:
        lines = tuple(f"{name}: {how}" for name, how in source.derived.items())
        sections.append(Section("derived", "What was derived", (Bullets(lines),)))
    facts = {
        "run": str(folder),
        "source": source.source,
        "firmware": source.firmware or "not said",
        "importer": source.importer,
    }
    verdict = f"{duration(last - first)} of flight imported into {folder}."
    data = {
        "run": str(folder),
        "duration_s": last - first,
        "channels": channels,
        "losses": list(source.losses),
        "derived": dict(source.derived),
        "firmware": source.firmware,
        "importer": source.importer,
    }
    tone = "warn" if source.losses else "good"
    return Result(Document("import", verdict, tone, tuple(sections), facts), data, Status.DONE, recording)  # type: ignore[arg-type]
