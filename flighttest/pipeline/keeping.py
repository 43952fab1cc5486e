"""Keeping models: export, compare, currency (`status`), and the runs on this machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flighttest.errors import InputError
from flighttest.identify import model_file
from flighttest.identify.export import export as write_export
from flighttest.identify.model_file import ModelFile
from flighttest.pipeline.analysis import cut_all, fit_segments
from flighttest.pipeline.results import SILENT, Progress, Result
from flighttest.pipeline.sources import open_recordings
from flighttest.report.document import Align, Cell, Document, Section, Table
from flighttest.report.numbers import join, percent, to_error, unit

DIFFERENT_Z = 3.0


def export(model: Path, kind: str, output: Path) -> Result:
    """Write a model for other programs."""
    stored = model_file.read(model)
    written = write_export(stored, kind, output)  # type: ignore[arg-type]
    rows = tuple((str(path), _what(path)) for path in written)
    verdict = f"{len(written)} file{'s' if len(written) != 1 else ''} written to {output}."
    section = Section("files", "", (Table(("file", "what it is"), rows),))
    return Result(Document("export", verdict, "good", (section,)), {"files": [str(p) for p in written], "to": kind})


def _what(path: Path) -> str:
    return {
        "model.json": "states, inputs, delays, parameters, covariance, validity",
        "dynamics.casadi": "x_dot = dynamics(x, u)",
        "step.casadi": "x_next = step(x, u, dt), one RK4 step",
        "step_jacobian.casadi": "A, B = step_jacobian(x, u, dt)",
        "flighttest_model.c": "the same functions in C99",
        "flighttest_model.h": "its header",
        "example.c": "a small program that calls them",
    }.get(path.name, "")


def open_model(path: Path, progress: Progress = SILENT) -> ModelFile:
    """A model file, or the fit of a run or log."""
    if not path.exists():
        raise InputError(f"{path}: there is no such model or run", "give a model.yaml, a run folder or a log")
    if path.suffix in (".yaml", ".yml"):
        return model_file.read(path)
    recordings = open_recordings([path], progress=progress)
    found = fit_segments(cut_all(recordings, progress), recordings, progress=progress)
    return model_file.from_fit(found)


def compare(first: Path, second: Path, progress: Progress = SILENT) -> Result:
    """z-scores per parameter between two models or two runs."""
    a, b = open_model(first, progress), open_model(second, progress)
    rows: list[tuple[Cell | str, ...]] = []
    data: list[dict[str, Any]] = []
    differing = []
    for name in [n for n in a.parameters if n in b.parameters]:
        p, q = a.parameters[name], b.parameters[name]
        std = math.hypot(p.std, q.std) if p.std is not None and q.std is not None else math.nan
        z = (q.value - p.value) / std if std and np.isfinite(std) else math.nan
        change = (q.value - p.value) / abs(p.value) if p.value else math.nan
        different = abs(z) > DIFFERENT_Z
        if different:
            differing.append(name)
        word = (
            Cell("-", "quiet", "not estimated in both")
            if not np.isfinite(z)
            else Cell("differs", "bad")
            if different
            else Cell("same", "good")
        )
        rows.append(
            (
                name,
                to_error(p.value, p.std),
                to_error(q.value, q.std),
                unit(p.unit),
                percent(change),
                f"{z:+.1f}" if np.isfinite(z) else "-",
                word,
            )
        )
        data.append(
            {
                "name": name,
                "first": p.value,
                "second": q.value,
                "std": std,
                "z": z,
                "change": change,
                "different": different,
            }
        )
    align: tuple[Align, ...] = ("left", "right", "right", "left", "right", "right", "left")
    table = Table(
        ("parameter", "first", "second", "unit", "change", "z", ""),
        tuple(rows),
        align,
        f"differs: |z| above {DIFFERENT_Z:g}",
    )
    only = sorted(set(a.parameters) ^ set(b.parameters))
    verdict = f"{join(differing)} differ{'s' if len(differing) == 1 else ''}." if differing else "No parameter differs."
    if only:
        verdict += f" In one of them only: {join(only)}."
    facts = {"first": str(first), "second": str(second)}
    document = Document("compare", verdict, "warn" if differing else "good", (Section("table", "", (table,)),), facts)
    return Result(document, {"parameters": data, "differing": differing, "only_in_one": only})


def status(
    runs: Sequence[Path],
    vehicle: Path | None,
    model: Path | None,
    out: Path,
    output: Path | None,
    progress: Progress = SILENT,
) -> Result:
    """Current, stale or unknown."""
    from flighttest.pipeline.currency import status as judge

    return judge(runs, vehicle, model, out, output, progress)


def runs(folder: Path, *, html: bool = False) -> Result:
    """The runs in a folder, oldest first."""
    from flighttest.pipeline.history import history

    return history(folder, page=html)
