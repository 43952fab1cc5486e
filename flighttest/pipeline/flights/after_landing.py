"""After landing: recordings of one campaign to fit, diagnosis, validity and page, in the run folders."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flighttest.diagnose import Diagnosis
from flighttest.diagnose.records import DiagnosisData
from flighttest.errors import FitError
from flighttest.identify.fit import Fit
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.diagnosis.diagnose import MODEL_NAME, UNFINISHED, run_diagnosis, write_diagnosis
from flighttest.pipeline.identification.fitting import cut_all, fit_segments, model_data
from flighttest.pipeline.identification.reporting import REPORT_NAME, keep_segments, provenance, run_document
from flighttest.pipeline.presenters.fit_view import fit_view, segment_views
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.flown_with import out_words, words_of
from flighttest.pipeline.store.history import FIT_NAME, as_good
from flighttest.pipeline.store.identities import WRITE_NAME_FIRST, whose
from flighttest.pipeline.store.lineage import joint_fit_command, model_of, worse
from flighttest.pipeline.store.models import NEXT_NAME, accepted, twin_command
from flighttest.pipeline.validity.reflights import reflights
from flighttest.pipeline.validity.status import Today, gather_evidence
from flighttest.recording import Recording
from flighttest.report.document import Bullets, Document, Section, Tone
from flighttest.report.fit_views import FitView
from flighttest.report.render import html
from flighttest.report.sections import fit as fit_sections
from flighttest.report.sections.diagnosis import missing_sections
from flighttest.report.sections.validity import TONES, status_document
from flighttest.segments import Segment
from flighttest.validity.model import Assessment, ValidityVerdict
from flighttest.vehicle.model import Vehicle


@dataclass(frozen=True)
class Analysis:
    """What was found in a campaign; any part may be missing, `reason`: why the fit is."""

    recordings: tuple[Recording, ...]
    segments: tuple[Segment, ...]
    fit: Fit | None
    reason: str = ""
    validity: Assessment | None = None
    diagnosis: DiagnosisData | None = None
    explained: bool = True
    previous: ModelFile | None = None
    improved: Fit | None = None

    @property
    def own(self) -> Fit | None:
        """The fit of the campaign's model: with what the diagnosis added, else the base's."""
        return self.improved or self.fit


@dataclass(frozen=True)
class Landed:
    """A campaign that was flown. folders: its runs, all in `out`; notes: of the flights; usable: False when one was aborted; resume: the
    command that flies what it lacks, '' where that is nothing."""

    folders: Sequence[Path]
    out: Path
    vehicle: Vehicle | None = None
    notes: Sequence[str] = ()
    usable: bool = True
    resume: str = ""


def analyse(
    landed: Landed,
    previous: ModelFile | None = None,
    *,
    diagnose: bool = True,
    keep: bool = False,
    progress: Progress = SILENT,
) -> Result:
    """Cut, fit, compare with the previous model, diagnose, and write it all into the run folders. keep: the model becomes the vehicle's."""
    folders, out, vehicle, notes = landed.folders, landed.out, landed.vehicle, landed.notes
    recordings = open_recordings(folders, progress=progress)
    name = whose(recordings, vehicle, out)
    if previous is None and vehicle is not None and not vehicle.name:
        previous = model_of(out, name)  # a vehicle without a name is known by its autopilot once it has been read
    found = _analysis(landed, recordings, name, previous, diagnose, progress)
    for folder, recording in zip(folders, recordings, strict=True):
        keep_segments(folder, [s for s in found.segments if s.run == recording.name])
    data: dict[str, Any] = {"runs": [str(f) for f in folders], "notes": list(notes)}
    if found.fit is not None:
        model = model_data(found.fit, recordings, vehicle)
        for folder in folders:
            model_file.write(folder / FIT_NAME, model)
        data["model"] = model
    progress.stage("writing the report")
    view = fit_view(found.own, found.segments) if found.own is not None else None
    page = _page(found, view, landed)
    for folder in folders:
        html.write_html(page, folder / REPORT_NAME)
    data["report"] = str(folders[-1] / REPORT_NAME)
    data["segments"] = {"used": sum(s.usable for s in found.segments), "of": len(found.segments)}
    if found.validity is not None:
        answer = {"verdict": found.validity.verdict.name, "sentence": found.validity.sentence}
        data |= {"validity": answer, "currency": answer}  # the second is what programs may read yet
    if found.diagnosis is not None:
        data["diagnosis"] = found.diagnosis
    status = status_of(found, landed.usable)
    words = how_to_accept(found, status, folders[-1], name, out, keep)
    return Result(_summary(found, view, landed, page, words), data, status, found)


def _changed(found: Analysis) -> bool:
    """Whether what is declared of the vehicle has changed since the model in use: flights of both are not to be fitted together."""
    return found.validity is not None and bool(found.validity.changes)


def how_to_accept(found: Analysis, status: Status, folder: Path, name: str, out: Path, keep: bool) -> str:
    """How the campaign's model becomes the vehicle's: done, or the command that does it; '' where it makes none."""
    own = found.own
    if own is None or not own.status.good or not (renewed(found) or found.diagnosis is not None):
        return ""
    if not any(e.identifiable for e in own.estimates.values()):
        return ""
    words = f"flighttest accept {shlex.quote(str(folder))}{out_words(out)}"
    used = found.previous
    if used is not None and not _changed(found) and worse(model_file.from_fit(own), used):
        return f"together with the flights of the model in use, which determines more:\n{joint_fit_command(out, used, folder)}"
    if not name:
        return f"{WRITE_NAME_FIRST}\n{words} --vehicle vehicle.yaml"
    if not keep:
        return words
    if status is Status.UNUSABLE:
        return f"not accepted, since the flight did not end as planned:\n{words}"
    return accepted(folder, out, None)


def _analysis(
    landed: Landed,
    recordings: Sequence[Recording],
    name: str,
    previous: ModelFile | None,
    diagnose: bool,
    progress: Progress,
) -> Analysis:
    vehicle, folder = landed.vehicle, landed.folders[-1]
    segments = cut_all(recordings, progress)
    try:
        fitted: Fit | None = fit_segments(segments, recordings, vehicle, progress=progress)
        reason = ""
    except FitError as error:
        fitted, reason = None, error.message
    diagnosis, explained, improved = None, True, None
    result: Diagnosis | None = None
    if fitted is not None and diagnose:
        try:
            result = run_diagnosis(segments, recordings, previous, vehicle, progress)
            diagnosis, improved = write_diagnosis(result, segments, recordings, vehicle, previous, folder, progress)
            explained = result.verdict not in UNFINISHED
        except FitError as error:
            progress.stage(f"no diagnosis: {error.message}")
    validity = None
    if previous is not None and fitted is not None:
        validity = gather_evidence(previous, Today(recordings, vehicle, name, landed.out), progress, diagnosed=result)
    return Analysis(tuple(recordings), segments, fitted, reason, validity, diagnosis, explained, previous, improved)


def renewed(found: Analysis) -> bool:
    """Whether the campaign's own model takes the place of the previous one (a spot check's does not)."""
    own = found.own
    if own is None:
        return False
    return found.previous is None or as_good(model_file.from_fit(own), found.previous)


def status_of(found: Analysis, usable: bool) -> Status:
    """What the command exits with. usable: False when a flight of the campaign was aborted."""
    if not usable:
        return Status.UNUSABLE
    if found.own is None:
        return Status.UNUSABLE if not any(s.usable for s in found.segments) else Status.UNEXPLAINED
    if not found.own.status.good:
        return Status.UNEXPLAINED
    if found.validity is not None and found.validity.verdict is ValidityVerdict.STALE and not renewed(found):
        return Status.STALE
    return Status.DONE if found.explained else Status.UNEXPLAINED


def _verdict(found: Analysis, view: FitView | None) -> tuple[str, Tone]:
    """The sentence on top: the validity first where this flight does not make a model of its own (a spot check)."""
    if view is None:
        return f"No model could be fitted: {found.reason}.", "bad"
    tone: Tone = "bad" if not view.good else "good" if all(p.known for p in view.parameters) else "warn"
    parts = [view.verdict]
    if found.diagnosis is not None:
        parts.insert(0, str(found.diagnosis.get("sentence", "")))
        tone = tone if found.explained else "warn"
    if found.validity is not None:
        stale = found.validity.verdict is ValidityVerdict.STALE
        if not renewed(found):
            # A few steps make no model: what was asked is whether the one in use still holds.
            parts = [found.validity.sentence, *parts[:-1]]
            tone = TONES[found.validity.verdict]
            tone = tone if found.explained or tone != "good" else "warn"
        elif stale:
            parts.append("The earlier model was stale: " + found.validity.sentence.removeprefix("Stale: "))
            tone = "warn"
    return " ".join(p for p in parts if p).strip(), tone


def _page(found: Analysis, view: FitView | None, landed: Landed) -> Document:
    verdict, tone = _verdict(found, view)
    extra: list[Section] = []
    if landed.notes:
        extra.append(Section("flight", "Notes of the flight", (Bullets(tuple(landed.notes)),)))
    if found.validity is not None:
        extra += status_document(found.validity, {}, ()).sections
    diagnosis = found.diagnosis
    if diagnosis is not None:
        folder = landed.folders[-1]
        options = f"{words_of(folder)}{out_words(landed.out)}"
        diagnosis = {**diagnosis, "next_path": str(folder / NEXT_NAME), "next_options": options}
    return run_document(found.recordings, view, found.segments, extra, diagnosis=diagnosis, headline=(verdict, tone))


def _summary(found: Analysis, view: FitView | None, landed: Landed, page: Document, accepting: str) -> Document:
    """What the terminal shows: the verdict, what is missing, the parameters (or the evidence for and against the model in use), where
    everything is."""
    folders, notes = landed.folders, landed.notes
    sections: list[Section] = list(missing_sections(found.diagnosis)) if found.diagnosis is not None else []
    if found.validity is not None and found.previous is not None and not renewed(found):
        rows, _, _ = reflights(
            found.validity,
            found.previous,
            landed.vehicle,
            options=f"{words_of(folders[-1])}{out_words(landed.out)}",
        )
        sections += status_document(found.validity, {}, rows, brief=True).sections
    elif view is not None:
        better = found.improved is not None and bool((found.diagnosis or {}).get("findings"))
        made = fit_sections.parameter_section(view)
        sections.append(replace(made, title="Parameters of the improved model") if better else made)
    else:
        sections.append(fit_sections.segments(segment_views(found.segments)))
    facts = {k: v for k, v in provenance(found.recordings).items() if k in ("vehicle", "firmware", "lost")}
    used = sum(s.usable for s in found.segments)
    facts["responses"] = f"{used} of {len(found.segments)} used"
    if notes:
        facts["notes"] = "; ".join(notes)
    kept = MODEL_NAME if found.diagnosis is not None else FIT_NAME
    facts["model"] = str(folders[-1] / kept) if found.fit is not None else "-"
    if accepting:
        facts["accept it"] = accepting
    if (
        found.previous is not None
        and found.previous.path
        and not renewed(found)
        and found.previous.model.attitude_loops
    ):
        facts["its twin"] = twin_command(Path(found.previous.path), folders)
    facts["report"] = str(folders[-1] / REPORT_NAME)
    if landed.resume:
        facts["fly next"] = landed.resume
        facts["what for"] = "What the campaign lacks: what can be known without it is preliminary."
    elif found.diagnosis is not None and (folders[-1] / "next.yaml").is_file():
        reason = found.diagnosis.get("next_reason") or {}
        command = (
            f"flighttest run {shlex.quote(str(folders[-1] / NEXT_NAME))}{words_of(folders[-1])}{out_words(landed.out)}"
        )
        facts["fly next"] = (
            f"{reason.get('maneuver')}: {reason['zone']}" if reason.get("fits_zone") is False else command
        )
        facts["what for"] = str(reason.get("sentence", ""))
    return Document("flight", page.verdict, page.tone, tuple(sections), facts)
