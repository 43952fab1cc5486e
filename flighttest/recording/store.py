"""A recording on disk: the run folder of docs/formats.md. Reads what a killed flight left, too.

RUN/manifest.yaml  script.yaml  plan.json  raw.tlog  events.jsonl  channels/<group>.parquet
"""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from flighttest.channels import CHANNELS, GROUPS
from flighttest.datafiles import MOST_VALUES, naming, parse_json, read_bytes, read_yaml, write_whole
from flighttest.errors import RecordingError
from flighttest.recording.manifest import EventData, Manifest
from flighttest.recording.model import Marker, Provenance, Recording, Series

RAW_NAME = "raw.tlog"
MANIFEST_NAME = "manifest.yaml"
EVENTS_NAME = "events.jsonl"
CHANNELS_DIR = "channels"
_CHANNELS_PART, _CHANNELS_OLD = f"{CHANNELS_DIR}.part", f"{CHANNELS_DIR}.old"
# What a run folder holds beside its manifest; see docs/formats.md.
_OF_A_RUN = frozenset(
    {
        CHANNELS_DIR, _CHANNELS_OLD, EVENTS_NAME, RAW_NAME, "script.yaml", "plan.json", "command.yaml", "onboard.bin", "segments.parquet",
        "fit.yaml", "model.yaml", "diagnosis.json", "next.yaml", "vehicle.yaml", "report.html", "show.html",
    }
)  # fmt: skip
CHANNELS_FORMAT = "channels/1"  # in the metadata of each Parquet file
FORMAT = "run/1"
EVENTS_FORMAT = "events/1"
_EVENTS_BYTES = 32_000_000  # an hour of steps takes 1 MB
_BLOCKS = (
    "parameters",
    "parameters_changed",
    "parameters_left",
    "parameters_set",
    "fence_set",
    "components",
    "vehicle",
    "clock",
    "filters",
    "derived",
)
_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # libyaml's own: the same text in a quarter of the time
_REBUILD = "rebuild the run from its raw file with `flighttest import`"


def write_manifest(run_dir: Path, manifest: Manifest) -> None:
    """Write manifest.yaml whole or not at all: a killed program leaves the last good one."""
    data = {"format": FORMAT, **_plain(dict(manifest))}
    text = yaml.dump(data, Dumper=_DUMPER, sort_keys=False, allow_unicode=True)
    write_whole(run_dir / MANIFEST_NAME, text)


def read_manifest(run_dir: Path) -> Manifest:
    """The manifest, without its format. RecordingError when it is missing or no run's."""
    path = run_dir / MANIFEST_NAME
    if not path.is_file():
        was = is_remains(run_dir) and any(run_dir.iterdir())
        raise RecordingError(
            f"{run_dir} is not a run folder: it has no {MANIFEST_NAME}"
            + (" (was its import ended early?)" if was else ""),
            rebuild_hint(run_dir) if was else "name a folder that `flighttest run` or `import` wrote",
        )
    remedy = f"move it away, then {rebuild_hint(run_dir)}"
    manifest = read_yaml(path, RecordingError, "manifest", remedy)
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise RecordingError(f"{path} is not a {FORMAT} manifest", "was it written by a newer version?")
    manifest.pop("format")
    for key in _BLOCKS:
        if not isinstance(manifest.get(key) or {}, dict):
            raise RecordingError(f"{path}: {key} is not a block of keys and values", remedy)
    for name, declared in (manifest.get("components") or {}).items():
        if not isinstance(declared or {}, dict):
            raise RecordingError(f"{path}: components.{name} is not a block of keys and values", remedy)
    if not isinstance(manifest.get("losses") or [], list):
        raise RecordingError(f"{path}: losses is not a list", remedy)
    for key in ("parameters", "parameters_changed", "parameters_left", "filters"):
        for name, value in (manifest.get(key) or {}).items():
            _number(value, f"{path}: {key}.{name}", remedy)
    for key in ("given", "hardware"):
        block = (manifest.get("parameters_set") or {}).get(key) or {}
        if not isinstance(block, dict):
            raise RecordingError(f"{path}: parameters_set.{key} is not a block of keys and values", remedy)
        for name, value in block.items() if key == "given" else ():
            _number(value, f"{path}: parameters_set.given.{name}", remedy)
    clock = manifest.get("clock") or {}
    for name in ("offset_s", "error_s"):
        if clock.get(name) is not None:
            _number(clock[name], f"{path}: clock.{name}", remedy)
    return cast(Manifest, manifest)


def _number(value: Any, where: str, remedy: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RecordingError(f"{where} is not a number, but {str(value)[:30]!r}", remedy)


def events_header() -> bytes:
    """First line of events.jsonl."""
    return (json.dumps({"format": EVENTS_FORMAT}) + "\n").encode()


def read_events(run_dir: Path) -> tuple[tuple[Marker, ...], tuple[str, ...]]:
    """Markers of events.jsonl, and what could not be read of it (a killed program may leave half a line)."""
    path = run_dir / EVENTS_NAME
    if not path.is_file():
        return (), ()
    markers: list[Marker] = []
    losses: list[str] = []
    text = read_bytes(path, RecordingError, "list of events", _EVENTS_BYTES, _REBUILD).decode("utf-8", "replace")
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            event = parse_json(line)
            if "format" in event:
                continue
            marker = Marker(float(event["t_s"]), event["kind"], event["label"], event.get("data") or EventData())
            if not (math.isfinite(marker.t_s) and isinstance(marker.kind, str) and isinstance(marker.label, str)):
                raise ValueError
            markers.append(replace(marker, data=cast(EventData, dict(marker.data))))
        except (ValueError, KeyError, TypeError):
            losses.append(f"{EVENTS_NAME}:{number}: not an event (cut off?)")
    return tuple(sorted(markers, key=lambda m: m.t_s)), tuple(losses)


def write_recording(run_dir: Path, recording: Recording) -> None:
    """Write channels, events and manifest of a recording; other fields of an existing manifest are kept.

    The channels are there all or not at all: a folder with some of them would be read as a recording that has no others.
    """
    try:
        with naming(run_dir):
            _write_recording(run_dir, recording)
    except BaseException:
        shutil.rmtree(run_dir / _CHANNELS_PART, ignore_errors=True)
        for part in run_dir.glob("*.part"):
            part.unlink(missing_ok=True)  # half a file takes the space that a full disk does not have
        raise


def _write_recording(run_dir: Path, recording: Recording) -> None:
    folder = run_dir / _CHANNELS_PART
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for group, series in recording.series.items():
        columns = {"t_s": series.t_s, **series.columns}
        table = pa.table(
            {name: pa.array(values, type=pa.float64(), from_pandas=False) for name, values in columns.items()},
            metadata={"format": CHANNELS_FORMAT},
        )
        pq.write_table(table, folder / f"{group}.parquet", compression="zstd")
    _swap(folder, run_dir / CHANNELS_DIR, run_dir / _CHANNELS_OLD)
    with (run_dir / (EVENTS_NAME + ".part")).open("w", encoding="utf-8") as stream:
        stream.write(events_header().decode())
        for marker in recording.markers:
            line = {"t_s": marker.t_s, "kind": marker.kind, "label": marker.label}
            stream.write(
                json.dumps({**line, **({"data": dict(marker.data)} if marker.data else {})}, default=str) + "\n"
            )
    os.replace(run_dir / (EVENTS_NAME + ".part"), run_dir / EVENTS_NAME)
    manifest = read_manifest(run_dir) if (run_dir / MANIFEST_NAME).exists() else Manifest()
    p = recording.provenance
    manifest |= {
        "name": recording.name,
        "source": p.source,
        "importer": p.importer,
        "sha256": p.sha256,
        "firmware": p.firmware,
        "parameters": dict(p.parameters),
        "components": dict(p.components),
        "vehicle": p.vehicle,
        "clock": p.clock,
        "losses": list(p.losses),
        "filters": dict(p.filters),
        "derived": dict(p.derived),
        "reference_clock": p.reference_clock,
        "autopilot": p.autopilot,
    }
    write_manifest(run_dir, manifest)


def _swap(made: Path, kept: Path, old: Path) -> None:
    """Put a folder that was made in the place of the one that is kept there, which is moved aside and then removed."""
    shutil.rmtree(old, ignore_errors=True)
    if kept.exists():
        os.replace(kept, old)
    os.replace(made, kept)
    shutil.rmtree(old, ignore_errors=True)


def is_remains(folder: Path) -> bool:
    """Whether a folder without a manifest holds nothing but what a run has: what a program that was killed while it wrote one leaves, or a
    run that has lost it."""
    return folder.is_dir() and all(p.name in _OF_A_RUN or p.suffix == ".part" for p in folder.iterdir())


def open_run(path: Path | str) -> Recording:
    """The recording of a run folder, from its channels.

    RecordingError when it is no run folder, or when its channels were never written: then with the remedy to rebuild them from raw.tlog.
    """
    run_dir = Path(path)
    if not run_dir.is_dir():
        raise RecordingError(
            f"{run_dir} is not a folder", "name a run folder; logs are imported with `flighttest import` first"
        )
    manifest = read_manifest(run_dir)
    series: dict[str, Series] = {}
    losses = list(manifest.get("losses") or [])
    for group in GROUPS:
        file = run_dir / CHANNELS_DIR / f"{group}.parquet"
        if file.exists():
            series[group] = _read_series(file, group, rebuild_hint(run_dir, str(manifest.get("source", ""))))
    if not series:
        hint = rebuild_hint(run_dir, str(manifest.get("source", "")))
        raise RecordingError(f"{run_dir} has no channels (was the flight killed?)", hint)
    markers, unread = read_events(run_dir)
    return Recording(
        name=str(manifest.get("name") or run_dir.name),
        series=series,
        markers=markers,
        provenance=Provenance(
            source=str(manifest.get("source", run_dir)),
            importer=str(manifest.get("importer", "flight")),
            sha256=str(manifest.get("sha256", "")),
            firmware=str(manifest.get("firmware", "")),
            parameters={k: float(v) for k, v in (manifest.get("parameters") or {}).items()},
            components=manifest.get("components") or {},
            vehicle=manifest.get("vehicle") or {},
            clock=manifest.get("clock") or {},
            losses=(*losses, *(u for u in unread if u not in losses)),
            filters=manifest.get("filters") or {},
            derived={str(k): str(v) for k, v in (manifest.get("derived") or {}).items()},
            reference_clock=str(manifest.get("reference_clock", "vehicle")),
            autopilot=str(manifest.get("autopilot") or ""),
        ),
    )


def rebuild_hint(run_dir: Path, source: str = "") -> str:
    """How a run folder is written again: the command, where the file that it was made from is there."""
    raw = run_dir / RAW_NAME
    origin = raw if raw.is_file() else Path(source) if source and Path(source).is_file() else None
    if origin is None:
        return f"write it again from its log: `flighttest import LOG -o {shlex.quote(str(run_dir))}`"
    return f"write it again: `flighttest import {shlex.quote(str(origin))} -o {shlex.quote(str(run_dir))}`"


def _read_series(file: Path, group: str, rebuild: str) -> Series:
    try:
        with pq.ParquetFile(file) as parquet:
            there = parquet.schema_arrow.names
            mine = ["t_s", *(n for n in there if n in CHANNELS and CHANNELS[n].group == group)]
            if "t_s" not in there:
                raise RecordingError(f"{file} has no column t_s", rebuild)
            if parquet.metadata.num_rows * len(mine) > MOST_VALUES:
                raise RecordingError(f"{file} states {parquet.metadata.num_rows} rows", rebuild)
            table = parquet.read(columns=mine)
    except (pa.ArrowException, OSError) as error:
        raise RecordingError(f"{file} cannot be read: {_first_line(error)}", rebuild) from error
    try:
        columns = {name: table.column(name).to_numpy().astype(float) for name in mine}
        return Series(columns.pop("t_s"), columns)
    except (ValueError, TypeError) as error:
        raise RecordingError(f"{file} holds a value that is not a number: {_first_line(error)}", rebuild) from error
    except RecordingError as error:
        raise RecordingError(f"{file}: {error.message}", rebuild) from error


def _plain(value: Any) -> Any:
    """The same in types of every YAML reader."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and math.isfinite(value) and value == int(value) and abs(value) < 1e15:
        return float(value)
    return value


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
