"""Where recordings come from: run folders, and logs imported on the fly. Several at once in processes."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import cast

from flighttest.errors import InputError, LinkError, RecordingError
from flighttest.logs import import_log as read_log
from flighttest.logs.opening import KINDS
from flighttest.logs.tables.columns import load_columns
from flighttest.pipeline.recordings.time_budget import in_the_air_s, time_data, time_section
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.recording import Recording
from flighttest.recording.manifest import Manifest, VehicleData
from flighttest.recording.store import (
    CHANNELS_DIR,
    MANIFEST_NAME,
    RAW_NAME,
    is_remains,
    open_run,
    read_events,
    read_manifest,
    write_recording,
)
from flighttest.report.document import Bullets, Cell, Document, Section, Table
from flighttest.report.numbers import duration, number
from flighttest.report.render.plain import plain
from flighttest.segments import cut
from flighttest.vehicle.load import load_vehicle

RecordingSource = Path | Recording  # a run folder or log, or a recording that was read before


def named(source: RecordingSource) -> str:
    """What a source is called in facts and sentences: its path, or the recording's name."""
    return source.name if isinstance(source, Recording) else str(source)


def open_recording(path: Path, columns: Path | None = None) -> Recording:
    """A run folder or a log of any kind as a Recording. RecordingError: what is wrong with it."""
    if not path.exists():
        raise RecordingError(f"{path}: there is no such run or log", "`flighttest runs` lists the runs on this machine")
    if columns is not None:
        load_columns(columns)  # what needs none is read without, but one that is named must be sound
    if not path.is_dir():
        return read_log(path, columns)
    manifest = read_manifest(path)
    raw = path / RAW_NAME
    if not any((path / CHANNELS_DIR).glob("*.parquet")) and raw.exists():
        return _rebuilt(path, manifest, raw)
    return open_run(path)


def _rebuilt(folder: Path, manifest: Manifest, raw: Path) -> Recording:
    """A run whose program was killed: channels from raw.tlog, marks from events.jsonl, what was declared from the manifest."""
    recording = read_log(raw)
    markers, unread = read_events(folder)
    marks = markers or recording.markers
    source = recording.provenance
    provenance = replace(
        source,
        components=manifest.get("components") or source.components,
        vehicle=manifest.get("vehicle") or source.vehicle,
        parameters=manifest.get("parameters") or source.parameters,
        firmware=str(manifest.get("firmware") or source.firmware),
        autopilot=str(manifest.get("autopilot") or source.autopilot),
        losses=(*source.losses, *unread),
    )
    return Recording(folder.name, recording.series, marks, provenance)


@dataclass(frozen=True)
class Reading:
    """How recordings are read. columns: column map of foreign tables; workers: processes on this machine; scheduler: address of a Dask
    cluster instead, whose workers see the same paths; weather: part of a flight's name
    ('' for all) to 'still' or 'unknown'."""

    columns: Path | None = None
    workers: int = 1
    scheduler: str | None = None
    weather: Mapping[str, str] = field(default_factory=dict)


def open_recordings(
    sources: Sequence[RecordingSource], reading: Reading | None = None, progress: Progress = SILENT
) -> tuple[Recording, ...]:
    """All of them, in order, those that were read before as they are; each name is made unique, since segments carry it."""
    reading = reading or Reading()
    workers, scheduler = reading.workers, reading.scheduler
    read = partial(open_recording, columns=reading.columns)
    paths = [source for source in sources if isinstance(source, Path)]
    if scheduler is not None:
        progress.stage(f"reading {len(paths)} recordings on {scheduler}")
        found = _on_cluster(scheduler, read, [p.resolve() for p in paths])
    elif workers > 1 and len(paths) > 1:
        progress.stage(f"reading {len(paths)} recordings in {min(workers, len(paths))} processes")
        with ProcessPoolExecutor(min(workers, len(paths)), mp_context=get_context("spawn")) as pool:
            found = list(pool.map(read, paths))
    else:
        found = []
        if paths:
            progress.stage(f"reading {paths[0]}" if len(paths) == 1 else f"reading {len(paths)} recordings")
        for done, path in enumerate(paths):
            progress.part(done, len(paths))
            found.append(read(path))
    for path, recording in zip(paths, found, strict=True):
        for loss in unreported(path, recording):
            progress.stage(f"{path}: {loss}")
    names: set[str] = set()
    unique = []
    opened = iter(found)
    for recording in (source if isinstance(source, Recording) else next(opened) for source in sources):
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


def unreported(path: Path, recording: Recording) -> tuple[str, ...]:
    """What reading a table in passing found wrong with it, columns that were not read among it; of a run folder `import` reported it."""
    source = recording.provenance
    return source.losses if source.importer == "table" and not path.is_dir() else ()


def losses_of(recordings: Sequence[Recording]) -> list[str]:
    """What was lost or looks wrong in each recording, by name, for a program that reads the result."""
    return [f"{r.name}: {loss}" for r in recordings for loss in r.provenance.losses]


def _on_cluster(scheduler: str, read: Callable[[Path], Recording], paths: Sequence[Path]) -> list[Recording]:
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs the package `distributed`", "pip install flighttest[cluster]") from error
    try:
        with Client(scheduler, timeout="10s") as client:
            return list(client.gather(client.map(read, list(paths))))
    except OSError as error:
        raise LinkError(f"the cluster at {scheduler} does not answer", "is the scheduler running there?") from error


def import_log(
    log: Path, output: Path, columns: Path | None = None, vehicle: Path | None = None, progress: Progress = SILENT
) -> Result:
    """Bring a log into a run folder."""
    if not log.exists():
        raise InputError(
            f"{log}: there is no such file",
            f"name a log that exists: {KINDS}, as it is or packed",
        )
    if log.is_dir():
        raise InputError(f"{log} is a folder", "name the log file; a run folder needs no import")
    rebuilding = (output / MANIFEST_NAME).exists()
    new = not output.exists()
    if not (new or rebuilding or is_remains(output)):
        raise InputError(f"{output} exists and is not a run folder", "name a folder that does not exist yet")
    declared = load_vehicle(vehicle, to_fly=False) if vehicle is not None else None
    progress.stage(f"reading {log}")
    same = rebuilding and log.resolve() == (output / RAW_NAME).resolve()
    recording = _rebuilt(output, read_manifest(output), log) if same else open_recording(log, columns)
    provenance = recording.provenance
    if rebuilding and log.resolve().parent != output.resolve():
        kept = read_manifest(output)
        if kept.get("sha256") not in ("", None, provenance.sha256) and kept.get("source") != provenance.source:
            raise InputError(
                f"{output} holds another recording already, of {kept.get('source')}",
                "name a folder that does not exist yet",
            )
    if declared is not None:
        provenance = replace(
            provenance, components=dict(declared.components), vehicle=cast(VehicleData, plain(declared))
        )
    recording = Recording(output.name, recording.series, recording.markers, provenance)
    progress.stage(f"writing {output}")
    try:
        output.mkdir(parents=True, exist_ok=True)
        write_recording(output, recording)
    except BaseException:
        if new:
            shutil.rmtree(output, ignore_errors=True)
        raise
    return describe_recording(recording, output)


def describe_recording(recording: Recording, folder: Path) -> Result:
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
    segments = cut(recording)
    sections = [Section("channels", "Channels", (table,)), time_section([recording], segments)]
    time = time_data([recording], segments)
    if source.losses:
        sections.append(Section("losses", "What was lost, or looks wrong", (Bullets(source.losses),)))
    if source.derived:
        lines = tuple(f"{name}: {how}" for name, how in source.derived.items())
        sections.append(Section("derived", "What was derived", (Bullets(lines),)))
    facts = {
        "run": str(folder),
        "source": source.source,
        "firmware": source.firmware or "not stated",
        "importer": source.importer,
        "go on": f"flighttest show {shlex.quote(str(folder))}",
    }
    flown_s = round(in_the_air_s(time))
    flown = f"{duration(flown_s)} of it in the air" if flown_s else "none of it in the air"
    verdict = f"A recording of {duration(last - first)} imported into {folder}, {flown}."
    data = {
        "run": str(folder),
        "duration_s": last - first,
        "time": time,
        "channels": channels,
        "losses": list(source.losses),
        "derived": dict(source.derived),
        "firmware": source.firmware,
        "importer": source.importer,
    }
    tone = "warn" if source.losses or not flown_s else "good"
    return Result(Document("import", verdict, tone, tuple(sections), facts), data, Status.DONE, recording)  # type: ignore[arg-type]
