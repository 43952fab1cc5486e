"""What a run folder keeps beside its recording, and its page: segments.parquet, fit.yaml, report.html."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import pyarrow as pa
import pyarrow.parquet as pq

from flighttest.datafiles import read_json, read_text, type_mismatch
from flighttest.diagnose.records import DiagnosisData
from flighttest.errors import FitError, InputError, RecordingError, ScriptError
from flighttest.identify.fit import Fit
from flighttest.identify.models import model_file
from flighttest.pipeline.identification.fitting import cut_all, fit_segments, model_data
from flighttest.pipeline.presenters.fit_view import METRICS, fit_view, metrics, segment_views
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.recordings.time_budget import time_section
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.flown_with import words_of
from flighttest.pipeline.store.history import FIT_NAME
from flighttest.pipeline.store.models import NEXT_NAME
from flighttest.recording import Recording
from flighttest.recording.store import MANIFEST_NAME
from flighttest.report.document import Document, Section, Tone
from flighttest.report.fit_views import FitView
from flighttest.report.numbers import duration, join
from flighttest.report.render import html
from flighttest.report.sections import fit as fit_sections
from flighttest.report.sections.diagnosis import diagnosis_sections, verdict_tone
from flighttest.segments import Segment
from flighttest.version import __version__

REPORT_NAME = "report.html"
SEGMENTS_NAME = "segments.parquet"
SEGMENTS_FORMAT = "segments/1"  # in the file's own metadata, as in those of the channels
DIAGNOSIS_NAME = "diagnosis.json"


def keep_segments(folder: Path, segments: Sequence[Segment]) -> Path:
    """segments.parquet: one row per response with its metrics (the samples stay in the channels)."""
    found = [metrics(s) for s in segments]
    table = pa.table(
        {
            "name": [s.name for s in segments],
            "run": [s.run for s in segments],
            "maneuver": [s.maneuver for s in segments],
            "kind": [s.kind for s in segments],
            "cell": [json.dumps(dict(s.cell)) for s in segments],
            "repeat": [s.repeat for s in segments],
            "start_s": [float(s.t_s[0]) if s.t_s.size else None for s in segments],
            "t_step_s": [s.t_step_s for s in segments],
            "end_s": [float(s.t_s[-1]) if s.t_s.size else None for s in segments],
            "usable": [s.usable for s in segments],
            "flaws": [", ".join(f.name for f in s.flaws) for s in segments],
            **{name: pa.array([row.get(name) for row in found], pa.float64()) for name in METRICS},
        },
        metadata={"format": SEGMENTS_FORMAT},
    )
    path = folder / SEGMENTS_NAME
    pq.write_table(table, path)
    return path


def provenance(recordings: Sequence[Recording]) -> dict[str, str]:
    """The head of a page: what was flown, with what, when it was recorded by whom."""
    facts: dict[str, str] = {"recordings": join([r.name for r in recordings])}
    first = recordings[-1].provenance
    name = first.vehicle.get("name")
    if name:
        facts["vehicle"] = str(name)
    if first.firmware:
        facts["firmware"] = first.firmware
    if first.components:
        parts = [f"{k} {_component(v)}" for k, v in first.components.items()]
        facts["components"] = ", ".join(parts)
    facts["recorded"] = duration(sum(b - a for a, b in (r.t_span_s for r in recordings)))
    facts["from"] = join([r.provenance.importer for r in recordings[:1]]) + (
        f", sha256 {first.sha256[:12]}" if first.sha256 else ""
    )
    if first.clock.get("error_s") is not None:
        facts["clock"] = f"{first.clock.get('method', '')}, error {float(first.clock['error_s']) * 1000:.2g} ms"
    if first.filters:
        facts["known filters"] = ", ".join(f"{k} {v:g} Hz" for k, v in first.filters.items())
    losses = [loss for r in recordings for loss in r.provenance.losses]
    if losses:
        facts["lost"] = "; ".join(losses[:4]) + (f" and {len(losses) - 4} more" if len(losses) > 4 else "")
    return facts


def _component(fields: object) -> str:
    if isinstance(fields, Mapping):
        return " ".join(str(v) for k, v in fields.items() if k in ("id", "model"))
    return str(fields)


def run_document(
    recordings: Sequence[Recording],
    view: FitView | None,
    segments: Sequence[Segment],
    extra: Sequence[Section] = (),
    diagnosis: DiagnosisData | None = None,
    next_script: str = "",
    headline: tuple[str, Tone | None] = ("", None),
) -> Document:
    """The page of a run or campaign: verdict, provenance, fit, diagnosis, responses. headline: verdict and tone, where not the fit's."""
    verdict, tone = headline
    sections: list[Section] = []
    if view is not None:
        made = fit_sections.fit_sections(view)
        sections += [s for s in made if s.id != "segments"]
    if diagnosis is not None:
        sections = [*diagnosis_sections(diagnosis, next_script), *sections]
    sections += extra
    if segments:
        sections.append(time_section(recordings, segments))
    sections.append(fit_sections.segments(view.segments if view is not None else segment_views(segments)))
    if not verdict:
        verdict = view.verdict if view is not None else "No model could be fitted to this recording."
    if tone is None:
        tone = "bad" if view is None or not view.good else "good" if all(p.known for p in view.parameters) else "warn"
        if diagnosis is not None and tone == "good":
            tone = verdict_tone(diagnosis, tone)
    title = f"flighttest: {join([r.name for r in recordings])}"
    footer = f"flighttest {__version__}. In the pictures: drag to zoom, double click to reset, click a name to hide it."
    return Document(title, verdict, tone, tuple(sections), provenance(recordings), footer)


def report(folder: Path, output: Path | None = None, progress: Progress = SILENT) -> Result:
    """Write the page of a run folder, of a log, or of what `diagnose -o` wrote. With `output` the folder itself stays as it is."""
    if not folder.exists():
        raise InputError(
            f"{folder}: there is no such run or folder", "`flighttest runs` lists the runs on this machine"
        )
    if folder.is_dir() and not (folder / MANIFEST_NAME).exists() and (folder / DIAGNOSIS_NAME).exists():
        return _report_diagnosis(folder, output)
    recordings = open_recordings(campaign_of(folder), progress=progress)
    segments = cut_all(recordings, progress)
    found: Fit | None = None
    reason = ""
    try:
        found = fit_segments(segments, recordings, progress=progress)
    except FitError as error:
        reason = error.message
    view = fit_view(found, segments) if found is not None else None
    diagnosis = read_diagnosis(folder / DIAGNOSIS_NAME) if folder.is_dir() else None
    if diagnosis is not None:
        diagnosis = {**diagnosis, "next_path": str(folder / NEXT_NAME), "next_options": words_of(folder)}
    document = run_document(
        recordings,
        view,
        segments,
        diagnosis=diagnosis,
        headline=(f"No model could be fitted: {reason}." if reason else _with_diagnosis(view, diagnosis), None),
    )
    target = output or (folder / REPORT_NAME if folder.is_dir() else Path(REPORT_NAME))
    if folder.is_dir() and output is None:
        keep_segments(folder, [s for s in segments if s.run == recordings[-1].name])
        if found is not None and not (folder / FIT_NAME).exists():
            model_file.write(folder / FIT_NAME, model_data(found, recordings, None))
    return written(document, target, Status.UNEXPLAINED if found is None else Status.DONE)


def _with_diagnosis(view: FitView | None, diagnosis: DiagnosisData | None) -> str:
    """What the diagnosis found, then the fit; '' without a diagnosis."""
    if view is None or diagnosis is None:
        return ""
    return f"{diagnosis.get('sentence', '')} {view.verdict}".strip()


def campaign_of(folder: Path) -> list[Path]:
    """The runs that were fitted together with this one, as its fit.yaml names them, the run itself last."""
    path = folder / FIT_NAME
    if not folder.is_dir() or not path.is_file():
        return [folder]
    names = [str(r) for r in model_file.read(path).runs]
    here = folder.resolve()
    others = [here.parent / n for n in names if n != here.name and (here.parent / n / MANIFEST_NAME).is_file()]
    return [*others, folder] if here.name in names else [folder]


def written(document: Document, target: Path, status: Status = Status.DONE) -> Result:
    """Write the page; the terminal gets its verdict and its path."""
    html.write_html(document, target)
    short = Document("report", document.verdict, document.tone, (), {"page": str(target)})
    return Result(short, {"report": str(target), "verdict": document.verdict}, status, document)


def read_diagnosis(path: Path) -> DiagnosisData | None:
    """diagnosis.json, None where there is none."""
    if not path.is_file():
        return None
    data = read_json(path, RecordingError, "diagnosis", "run `flighttest diagnose` again")
    if not isinstance(data, dict) or data.get("format") != "diagnosis/1":
        raise RecordingError(f"{path} is not a diagnosis/1 file", "run `flighttest diagnose` again")
    wrong = type_mismatch(data, DiagnosisData)
    if wrong:
        raise RecordingError(f"{path}: {wrong}", "run `flighttest diagnose` again")
    return cast(DiagnosisData, data)


def _report_diagnosis(folder: Path, output: Path | None) -> Result:
    """The page of a diagnosis, from its files alone."""
    data = read_diagnosis(folder / DIAGNOSIS_NAME) or DiagnosisData()
    script = ""
    if (folder / NEXT_NAME).is_file():
        script = read_text(folder / NEXT_NAME, ScriptError, "script")
    facts = {"diagnosis": str(folder / DIAGNOSIS_NAME)}
    if (folder / "model.yaml").is_file():
        facts["model"] = ", ".join(term for term in model_file.read(folder / "model.yaml").model.terms)
    verdict = str(data.get("sentence") or data.get("verdict", ""))
    shown: DiagnosisData = {**data, "next_path": str(folder / NEXT_NAME)}
    document = Document("flighttest diagnosis", verdict, verdict_tone(data), diagnosis_sections(shown, script), facts)
    return written(document, output or folder / REPORT_NAME)
