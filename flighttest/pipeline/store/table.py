"""The runs on this machine as a table, and each parameter over them as a page."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from flighttest.errors import FlighttestError
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.results import Result
from flighttest.pipeline.store.history import FIT_NAME, check_runs, when
from flighttest.pipeline.store.identities import known_in, of_manifest, recognised, run_folders
from flighttest.recording.manifest import Manifest
from flighttest.recording.store import CHANNELS_DIR, MANIFEST_NAME, RAW_NAME, read_manifest, rebuild_hint
from flighttest.report.document import Document
from flighttest.report.render import html
from flighttest.report.sections.history import HistoryPoint, history_document

_IMPORTED = {
    "ardupilot_bin": "imported from .BIN", "tlog": "imported from .tlog", "ulg": "imported from .ulg", "table": "imported from a table",
}  # fmt: skip


def history(folder: Path, *, page: bool = False) -> Result:
    """The table of runs; with `page` also history.html in the folder."""
    check_runs(folder)
    points, units, broken, known = [], {}, _without_manifest(folder), known_in(folder)
    for run in run_folders(folder):
        try:
            manifest = read_manifest(run)
        except FlighttestError as error:
            broken.append(_reason(run, error))
            continue
        stored = None
        if (run / FIT_NAME).is_file():
            try:
                stored = model_file.read(run / FIT_NAME)
            except FlighttestError as error:
                broken.append(_reason(run / FIT_NAME, error))
        points.append(_point(run, manifest, stored, recognised(of_manifest(manifest), known)))
        if stored is not None:
            units.update({n: p.unit for n, p in stored.parameters.items()})
    document = history_document(points, units, [line.removeprefix(f"{folder}{os.sep}") for line in broken])
    if page and points:
        document = _written(document, folder / "history.html")
    data = {"runs": [_data(p) for p in points], "broken": broken}
    return Result(document, data)


def _reason(path: Path, error: FlighttestError) -> str:
    """Why a file cannot be read, in one line that names it once."""
    first, *others = str(error).splitlines()
    words = first if first.startswith(str(path)) else f"{path}: {first}"
    return f"{words} (and {len(others)} more)" if others else words


def _without_manifest(folder: Path) -> list[str]:
    """What was a run, by what else it holds, and has lost its manifest."""
    found = sorted(p for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []
    return [
        f"{run}: it has no {MANIFEST_NAME}; {rebuild_hint(run)}"
        for run in found
        if not (run / MANIFEST_NAME).is_file() and ((run / RAW_NAME).is_file() or (run / CHANNELS_DIR).is_dir())
    ]


def _written(document: Document, path: Path) -> Document:
    html.write_html(document, path)
    return replace(document, footer=f"page: {path}")


def _point(run: Path, manifest: Manifest, stored: ModelFile | None, vehicle: str) -> HistoryPoint:
    parameters = {}
    if stored is not None:
        for name, p in stored.parameters.items():
            if p.identifiable and p.interval_95 is not None:
                parameters[name] = (p.value, (p.interval_95[1] - p.interval_95[0]) / 2.0)
    components = {
        str(name): ", ".join(str(v) for k, v in dict(fields or {}).items() if k in ("id", "model"))
        for name, fields in (manifest.get("components") or {}).items()
    }
    script = manifest.get("script") or {}
    return HistoryPoint(
        run=run.name,
        when=str(manifest.get("started") or manifest.get("created") or when(run.name)),
        vehicle=vehicle,
        script=str(script.get("name", "") if isinstance(script, Mapping) else script),
        outcome=str(manifest.get("outcome") or _IMPORTED.get(str(manifest.get("importer")), "")),
        parameters=parameters,
        components=components,
        completed=manifest.get("outcome_name") == "COMPLETED",
        campaign=tuple(map(str, stored.runs)) if stored is not None else (),
    )


def _data(point: HistoryPoint) -> dict[str, Any]:
    return {
        "run": point.run,
        "when": point.when,
        "vehicle": point.vehicle,
        "script": point.script,
        "outcome": point.outcome,
        "components": dict(point.components),
        "parameters": {n: {"value": v, "half_width_95": h} for n, (v, h) in point.parameters.items()},
    }
