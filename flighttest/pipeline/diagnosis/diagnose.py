"""`flighttest diagnose`: recordings and a model to a diagnosis, and the files it leaves."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from flighttest.datafiles import check_writable, write_whole
from flighttest.diagnose import Diagnosis, Support, Verdict
from flighttest.diagnose import diagnose as search
from flighttest.diagnose.records import DiagnosisData
from flighttest.diagnose.step_error import rows_of
from flighttest.documents import write_text
from flighttest.errors import InputError
from flighttest.identify.fit import Fit
from flighttest.identify.free_flight.equation_fit import fit_of_estimates
from flighttest.identify.models import model_file
from flighttest.identify.models.informative_prior import carry_over, fitted_to, known_before
from flighttest.identify.models.model_blocks import DiagnosedBlock
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.diagnosis.next_flight import flyable_in, held_against_zone
from flighttest.pipeline.identification.fitting import base_model, cut_all, model_data
from flighttest.pipeline.identification.per_flight import weather_of
from flighttest.pipeline.identification.reporting import DIAGNOSIS_NAME, REPORT_NAME, run_document
from flighttest.pipeline.parallel import in_parallel
from flighttest.pipeline.presenters.fit_view import fit_view
from flighttest.pipeline.recordings.consistency import deduplicate, inconsistencies
from flighttest.pipeline.recordings.fingerprints import differences
from flighttest.pipeline.recordings.sources import Reading, RecordingSource, losses_of, named, open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.flown_with import words_of
from flighttest.pipeline.store.history import folder_of_runs
from flighttest.pipeline.store.models import NEXT_NAME, accept_command, accepted
from flighttest.recording import Recording
from flighttest.report.document import Document
from flighttest.report.numbers import join
from flighttest.report.render import html
from flighttest.report.render.plain import plain
from flighttest.report.sections.diagnosis import diagnosis_sections, verdict_tone
from flighttest.segments import Segment
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import Vehicle

MODEL_NAME = "model.yaml"
UNFINISHED = (Verdict.PARTLY, Verdict.UNKNOWN_PHYSICS)


def run_diagnosis(
    segments: Sequence[Segment],
    recordings: Sequence[Recording],
    stored: ModelFile | None,
    vehicle: Vehicle | None,
    progress: Progress = SILENT,
    weather: Mapping[str, str] | None = None,
) -> Diagnosis:
    """The diagnosis of segments, from the stored model's physics or the paper's; its proposal held against the vehicle's zone.

    weather: flight to 'still' or 'unknown', the vehicle's where it is not given.
    """
    previous = None
    if stored is not None:
        # What no flight determined is a start value: whatever is found now, it has not changed.
        previous = {n: (p.value, p.scatter if p.identifiable else math.inf) for n, p in stored.parameters.items()}
    progress.stage("searching for what the model lacks")
    found = search(
        segments,
        stored.model if stored is not None else base_model(recordings, vehicle),
        previous=previous,
        weather=weather_of({}, recordings, vehicle) if weather is None else weather,
        support=Support(progress.stage, in_parallel, flyable_in(recordings, vehicle)),
    )
    if stored is not None and fitted_to(stored, segments):
        found = replace(found, mass={})  # the vehicle's mass was one and the same
    return held_against_zone(found, recordings, vehicle)


def diagnose(
    runs: Sequence[RecordingSource],
    model: Path | ModelFile | None = None,
    output: Path | None = None,
    vehicle: Path | None = None,
    reading: Reading | None = None,
    progress: Progress = SILENT,
    keep: bool = False,
) -> Result:
    """Diagnose recordings; with `output` write diagnosis.json, model.yaml, report.html and, where one is due, next.yaml. keep: the model
    becomes its vehicle's, in the folder of runs that the recordings are in, else in the usual one."""
    check_writable(output)
    if keep and output is None:
        raise InputError("--accept needs a folder for the model", "name one with -o DIR")
    declared = load_vehicle(vehicle, to_fly=False) if vehicle is not None else None
    stored = model_file.read(model) if isinstance(model, Path) else model
    recordings = open_recordings(runs, reading, progress)
    doubtful = inconsistencies(recordings)
    recordings = deduplicate(recordings)
    segments = cut_all(recordings, progress)
    weather = weather_of({} if reading is None else reading.weather, recordings, declared)
    found = run_diagnosis(segments, recordings, stored, declared, progress, weather)
    found = replace(found, notes=(*found.notes, *doubtful))
    data = found.to_json()
    facts = {"recordings": join([named(r) for r in runs]), "base": ", ".join(_base_terms(found))}
    if doubtful:
        facts["careful"] = "; ".join(doubtful)
    other = differences(stored.fingerprint, recordings) if stored is not None else ""
    if other:
        facts["another vehicle"] = f"the model's has {other}; see `flighttest status`"
    if output is not None:
        facts["written to"] = str(output)
        data, _ = write_diagnosis(found, segments, recordings, declared, stored, output, progress)
        facts["model"] = str(output / MODEL_NAME)
        place = folder_of_runs(runs)
        facts["accept it"] = accepted(output, place, vehicle) if keep else accept_command(output, place)
    data |= {"losses": losses_of(recordings), "another_vehicle": facts.get("another vehicle", "")}
    script = write_text(found.next_script) if found.next_script else ""
    if script and output is not None:
        data |= {
            "next_path": str(output / NEXT_NAME),
            "next_options": words_of(runs[-1]) if isinstance(runs[-1], Path) else "",
        }
    document = Document("diagnosis", found.sentence, verdict_tone(data), diagnosis_sections(data, script), facts)
    unexplained = found.verdict in UNFINISHED or not found.complete
    return Result(document, data, Status.UNEXPLAINED if unexplained else Status.DONE, found)


def _base_terms(found: Diagnosis) -> list[str]:
    """Terms of the model before anything was added to it."""
    estimated = {found.model.term_of(name) for name in found.before}
    return [t for t in found.model.terms if t not in found.accepted and t in estimated]


def refit(found: Diagnosis, base: ModelFile | None = None) -> tuple[Fit, tuple[str, ...]]:
    """The diagnosis' own fit of the accepted model; fitted anew where parameters are held as in the base model, and which."""
    assert found.fit is not None
    fitted = found.fit
    known = known_before(fitted, base)
    if not known:
        return fitted, ()
    again = fit_of_estimates(fitted.problem.segments, found.model, found.held, start=fitted.start, frozen=known)
    return again, tuple(known)


def write_diagnosis(
    found: Diagnosis,
    segments: Sequence[Segment],
    recordings: Sequence[Recording],
    vehicle: Vehicle | None,
    base: ModelFile | None,
    folder: Path,
    progress: Progress = SILENT,
) -> tuple[DiagnosisData, Fit]:
    """diagnosis.json, model.yaml, report.html and, where one is due, next.yaml; gives the data written, and the fit of the improved model.
    base: the model given."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / NEXT_NAME).unlink(missing_ok=True)  # of an earlier diagnosis
    data = found.to_json()
    script = ""
    if found.next_script:
        script = write_text(found.next_script)
        write_whole(folder / NEXT_NAME, script)
        data["next_flight"] = NEXT_NAME
    write_whole(folder / DIAGNOSIS_NAME, json.dumps(plain(data), indent=1) + "\n")
    fitted, kept = refit(found, base)
    model = model_data(fitted, recordings, vehicle) | {"diagnosed": looked_for(found)}
    if base is not None and kept:
        model = carry_over(model, base, kept)
        before = base.fit_quality.get("flown_steps") or {}
        model["fit_quality"]["flown_steps"] = {**before, **model["fit_quality"].get("flown_steps", {})}
    model_file.write(folder / MODEL_NAME, model)
    page = run_document(
        recordings,
        fit_view(fitted, segments),
        segments,
        diagnosis={**data, "next_path": str(folder / NEXT_NAME)},
        next_script=script,
        headline=(found.sentence, verdict_tone(data)),
    )
    html.write_html(page, folder / REPORT_NAME)
    return data, fitted


def looked_for(found: Diagnosis) -> DiagnosedBlock:
    """What model.yaml keeps of a diagnosis: what else its flights would have shown, and from which size on; what they could not show."""
    kept: DiagnosedBlock = {
        "verdict": found.verdict.name,
        "complete": found.complete,
        "not_needed": sorted(found.not_needed),
        "untestable": sorted({u.term for u in found.untestable}),
        "smallest_detectable": {k: float(f"{v:.4g}") for k, v in found.smallest_detectable.items()},
    }
    if left := rows_of(found.left):
        kept["left"] = left
    if found.winds:
        kept["winds"] = list(found.winds)
    return kept
