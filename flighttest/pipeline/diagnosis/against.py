"""`flighttest diagnose REAL... --against SIMULATED...`: what a simulator lacks, has too much of, or has otherwise."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import cast

from flighttest.datafiles import check_writable, write_whole
from flighttest.diagnose import Diagnosis, Verdict
from flighttest.diagnose.against import Against, Difference, Kind, compare_sides, step_by_step
from flighttest.errors import InputError
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.diagnosis.diagnose import run_diagnosis
from flighttest.pipeline.identification.fitting import cut_all, model_data
from flighttest.pipeline.identification.per_flight import weather_of
from flighttest.pipeline.identification.reporting import REPORT_NAME
from flighttest.pipeline.recordings.consistency import deduplicate
from flighttest.pipeline.recordings.sources import Reading, RecordingSource, losses_of, named, open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.identities import of_recording
from flighttest.recording import Recording
from flighttest.report.document import Document, Tone
from flighttest.report.numbers import paths
from flighttest.report.render import html
from flighttest.report.render.plain import plain
from flighttest.report.sections.against import AgainstData, DifferenceRow, SideData, against_sections, sentence
from flighttest.vehicle.load import load_vehicle

AGAINST_NAME = "against.json"
_UNNAMED = (Verdict.PARTLY, Verdict.UNKNOWN_PHYSICS)


def against(
    runs: Sequence[RecordingSource],
    simulated: Sequence[RecordingSource],
    model: Path | ModelFile | None = None,
    output: Path | None = None,
    vehicle: Path | None = None,
    reading: Reading | None = None,
    progress: Progress = SILENT,
) -> Result:
    """Compare; with `output` write against.json, report.html and model.yaml (the model of the real recordings)."""
    check_writable(output)
    declared = load_vehicle(vehicle) if vehicle is not None else None
    stored = model_file.read(model) if isinstance(model, Path) else model
    sides = [deduplicate(open_recordings(paths, reading, progress)) for paths in (runs, simulated)]
    twice = {_content(r): r.name for r in sides[0]}
    for recording in sides[1]:
        if _content(recording) in twice:
            raise InputError(
                f"{recording.name} is on both sides", "real recordings before --against, the simulator's after it"
            )
    for recordings in sides:
        of_one_vehicle(recordings)
    weather = weather_of({} if reading is None else reading.weather, [*sides[0], *sides[1]], declared)
    segments = [cut_all(recordings, progress) for recordings in sides]
    diagnoses = []
    for what, some, recordings in zip(("real", "simulated"), segments, sides, strict=True):
        progress.stage(f"the {what} recordings")
        diagnoses.append(
            run_diagnosis(some, recordings, stored, declared, progress, {r.name: weather[r.name] for r in recordings})
        )
    progress.stage("comparing")
    found = compare_sides(segments[0], segments[1], *diagnoses)
    data = against_data(found, *diagnoses)
    data["steps"] = plain(step_by_step(*segments))
    data["losses"] = losses_of((*sides[0], *sides[1]))
    facts = {
        "real": paths([named(r) for r in runs]),
        "simulated": paths([named(r) for r in simulated]),
        "model": ", ".join(found.real.model.terms),
    }
    document = Document("simulator against reality", sentence(data), tone(found), against_sections(data), facts)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_whole(output / AGAINST_NAME, json.dumps(plain(data), indent=1) + "\n")
        model_file.write(output / "model.yaml", model_data(found.real, sides[0], declared))
        html.write_html(document, output / REPORT_NAME)
        document.facts["written to"] = str(output)  # type: ignore[index]
    unnamed = any(d.verdict in _UNNAMED for d in diagnoses[:1])
    return Result(document, data, Status.UNEXPLAINED if unnamed else Status.DONE, found)


def _content(recording: Recording) -> str:
    return recording.provenance.sha256 or recording.name


def of_one_vehicle(recordings: Sequence[Recording]) -> None:
    """InputError where recordings are of two vehicles, by declared name or by the autopilot's own number. A name and another recording's
    number are two vehicles, unless the named one has that autopilot; a calibration alone may be of the same vehicle, calibrated again."""
    known = [(r.name, one) for r in recordings if (one := of_recording(r)).name or one.autopilot]
    for (here, one), (there, two) in combinations(known, 2):
        if one.key == two.key or (not (one.name and two.name) and one.same_board(two)):
            continue
        raise InputError(
            f"{here} is of vehicle {one.key} and {there} of {two.key}: they cannot share a model",
            "give the recordings of one vehicle",
        )


def tone(found: Against) -> Tone:
    """Of the verdict."""
    return "warn" if found.differing else "good"


def against_data(found: Against, of_real: Diagnosis, of_simulated: Diagnosis) -> AgainstData:
    """against/1: plain data."""
    named: dict[str, list[str]] = {
        kind.value: list(dict.fromkeys(d.term for d in found.differences if d.kind is kind and d.term != "body"))
        for kind in (Kind.LACKS, Kind.TOO_MUCH, Kind.OTHER_VALUE)
    }
    titles = {t.id: t.title for t in found.real.model.built_terms}
    return {
        "format": "against/1",
        "terms": list(found.real.model.terms),
        "titles": titles,
        "lacks": named["LACKS"],
        "too_much": named["TOO_MUCH"],
        "other_value": [d.name for d in found.differences if d.kind is Kind.OTHER_VALUE],
        "parameters": [difference_row(d) for d in found.differences],
        "prediction": plain(found.prediction),
        "held_out": found.held_out,
        "corrected": plain(found.corrected),
        "notes": list(found.notes),
        "real": _side(of_real),
        "simulated": _side(of_simulated),
    }


def difference_row(d: Difference) -> DifferenceRow:
    """One parameter of both sides as plain data."""
    return cast(DifferenceRow, plain({**vars(d), "kind": d.kind.value, "differs": d.differs}))


def _side(found: Diagnosis) -> SideData:
    return {"verdict": found.verdict.name, "sentence": found.sentence, "accepted": list(found.accepted)}
