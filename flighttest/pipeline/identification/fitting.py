"""Recordings to segments to a fit: the commands `segment` and `fit`, and what `run` does after landing."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from flighttest.datafiles import check_writable
from flighttest.documents import nearest
from flighttest.errors import FitError, InputError
from flighttest.identify.fit import Fit, has_attitude_references
from flighttest.identify.fit import fit as identify
from flighttest.identify.free_flight import fit_by_prediction_errors, parts_by_prediction_errors
from flighttest.identify.free_flight.winds import WIND_TERM
from flighttest.identify.models import model_file
from flighttest.identify.models.model_blocks import ModelData, QualityBlock
from flighttest.identify.selection import LOG_REFERENCES, NOTHING_ASKED, nothing_asked
from flighttest.identify.validation.block_coordinate_descent import cross_checked
from flighttest.physics.body import DELAY, DELAY_PARAM
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import NOMINAL_VOLTAGE_V, PAPER_TERMS, Model, pack_voltage
from flighttest.pipeline.identification.per_flight import motor_section, weather_of, wind_section
from flighttest.pipeline.presenters.fit_view import fit_view, metrics, segment_views, why_nothing
from flighttest.pipeline.recordings.batteries import battery_data
from flighttest.pipeline.recordings.consistency import deduplicate, inconsistencies
from flighttest.pipeline.recordings.fingerprints import of_recordings
from flighttest.pipeline.recordings.sources import Reading, RecordingSource, losses_of, named, open_recordings
from flighttest.pipeline.recordings.time_budget import time_data, time_section
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.identities import identity_of
from flighttest.recording import Recording
from flighttest.recording.manifest import VehicleData
from flighttest.report.document import Document, Tone
from flighttest.report.numbers import join, paths
from flighttest.report.render.plain import plain
from flighttest.report.sections import fit as fit_sections
from flighttest.segments import Segment, cut
from flighttest.twin.flown import mean_steps
from flighttest.validity import matched_pair
from flighttest.validity.between_campaigns import measured
from flighttest.validity.hover import hover
from flighttest.validity.motor_load import motor_load
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import Vehicle


@dataclass(frozen=True)
class FitRequest:
    """Options of a fit: terms beside the model's, parameters to hold at a value, parameters to tie to another, how many processes.

    model: where it is not the paper's; its nominal voltage and the height of its rotors count where neither vehicle nor recordings state
    them. weather: part of a flight's name ('' for all) to 'still' or 'unknown'.
    """

    terms: tuple[str, ...] = ()
    freeze: Mapping[str, float] = field(default_factory=dict)
    tie: Mapping[str, str] = field(default_factory=dict)
    workers: int = 1
    scheduler: str | None = None
    model: Model | None = None
    weather: Mapping[str, str] = field(default_factory=dict)


def cut_all(recordings: Sequence[Recording], progress: Progress = SILENT) -> tuple[Segment, ...]:
    """Segments of all recordings, in order."""
    progress.stage("cutting the responses")
    found: list[Segment] = []
    for done, recording in enumerate(recordings):
        progress.part(done, len(recordings))
        found += cut(recording)
    return tuple(found)


def segment(runs: Sequence[RecordingSource], columns: Path | None = None, progress: Progress = SILENT) -> Result:
    """Table of responses, each accepted or rejected with its reason."""
    recordings = open_recordings(runs, Reading(columns), progress)
    segments = cut_all(recordings, progress)
    views = segment_views(segments)
    section = fit_sections.segments(views)
    used = sum(s.usable for s in segments)
    if not segments:
        verdict, tone = (
            "Nothing was found to cut: no references move in this recording, and there is no flight to window.",
            "bad",
        )
    elif not used:
        verdict, tone = f"None of the {len(segments)} responses can be used; the reasons are below.", "bad"
    else:
        verdict, tone = section.lead, "good" if used == len(segments) else "warn"
    data = {
        "segments": [_segment_data(s) for s in segments],
        "used": used,
        "rejected": len(segments) - used,
        "time": time_data(recordings, segments),
        "losses": losses_of(recordings),
    }
    sections = (replace(section, lead=""), time_section(recordings, segments, brief=bool(used)))
    document = Document("responses", verdict, tone, sections)  # type: ignore[arg-type]
    return Result(document, data, Status.DONE if used else Status.UNUSABLE, segments)


def _segment_data(s: Segment) -> dict[str, Any]:
    return {
        "name": s.name,
        "run": s.run,
        "maneuver": s.maneuver,
        "kind": s.kind,
        "cell": dict(s.cell),
        "repeat": s.repeat,
        "t_step_s": s.t_step_s,
        "duration_s": float(s.t_s[-1] - s.t_step_s) if s.t_s.size else 0.0,
        "usable": s.usable,
        "flaws": [{"name": f.name, "sentence": f.value} for f in s.flaws],
        "notes": list(s.notes),
        "channels": sorted(s.y),
        "inputs": sorted(s.u),
        "metrics": plain(metrics(s)),
    }


def _recorded_pack(recordings: Sequence[Recording]) -> float | None:
    """Nominal voltage of the battery by its readings, V; None where nothing was read."""
    batteries = [r.series["battery"].columns for r in recordings if "battery" in r.series]
    read = [b["voltage_v"] for b in batteries if "voltage_v" in b]
    return pack_voltage(np.concatenate(read)) if read else None


def base_model(
    recordings: Sequence[Recording], vehicle: Vehicle | None, terms: Sequence[str] = (), model: Model | None = None
) -> Model:
    """The paper's model, or the one given, and further terms, with U_n and the height of the rotors: the vehicle file's, else what the
    recordings carry, else the model's own; of the paper's, U_n of the battery that was recorded."""
    base = model or Model(nominal_voltage_v=_recorded_pack(recordings) or NOMINAL_VOLTAGE_V)
    stated = [r.provenance.vehicle for r in recordings] if vehicle is None else [cast(VehicleData, asdict(vehicle))]

    def value_of(key: Literal["nominal_voltage_v", "rotor_height_m"], least: float, otherwise: float) -> float:
        values = [s.get(key) for s in stated]
        return next((float(v) for v in values if isinstance(v, int | float) and v >= least), otherwise)

    return replace(
        base,
        terms=(*base.terms, *terms),
        nominal_voltage_v=value_of("nominal_voltage_v", 0.1, base.nominal_voltage_v),
        rotor_height_m=value_of("rotor_height_m", 0.0, base.rotor_height_m),
    )


def fit_segments(
    segments: Sequence[Segment],
    recordings: Sequence[Recording],
    vehicle: Vehicle | None = None,
    options: FitRequest | None = None,
    progress: Progress = SILENT,
) -> Fit:
    """The paper's model, plus named terms, fitted jointly to all usable segments."""
    options = options or FitRequest()
    usable = [s for s in segments if s.usable]
    known = base_model(recordings, vehicle, _terms(options.terms), options.model)
    if nothing_asked(segments):
        raise FitError(NOTHING_ASKED, LOG_REFERENCES)
    if not usable:
        raise FitError("no response can be used", "see `flighttest segment` for why each was rejected")
    model = replace(known, attitude_loops=has_attitude_references(usable))
    progress.stage(f"fitting {len(usable)} responses")
    held, ties = _held(options.freeze, model), _ties(options.tie)
    both = sorted(set(held) & set(ties))
    if both:
        raise InputError(f"{', '.join(both)} is both held and tied", "either freeze it or tie it")
    for name, source in ties.items():
        units = {model.param[n].unit for n in (name, source) if n in model.param}
        if len(units) > 1:
            raise InputError(
                f"tie {name}={source}: {' and '.join(sorted(units))} are not the same unit",
                "tie parameters of the same unit",
            )
    own = parts_by_prediction_errors(usable)
    if own and not ties and WIND_TERM not in model.terms:
        return fit_by_prediction_errors(usable, model, own, held)
    found = identify(usable, model, frozen=held, ties=ties)
    return cross_checked(found)


def _terms(ids: Sequence[str]) -> tuple[str, ...]:
    known = catalogue()
    for term_id in ids:
        if term_id not in known:
            guess = nearest(term_id, known)
            raise InputError(
                f"there is no term {term_id!r}", f"did you mean {guess}?" if guess else "see `flighttest terms`"
            )
    return tuple(i for i in ids if i not in PAPER_TERMS)


def _held(asked: Mapping[str, float], model: Model) -> dict[str, float]:
    """What is to be held, where a model can be simulated with it. T_d, the paper's one delay, holds that of every channel."""
    found = dict(asked)
    if DELAY.name in found:
        delays = [name for name in DELAY_PARAM.values() if name in model.param]
        both = [name for name in delays if name in found]
        if both:
            raise InputError(
                f"freeze {DELAY.name} holds {', '.join(delays)}, and {join(both)} is given too",
                "give one or the other",
            )
        value = found.pop(DELAY.name)
        found |= dict.fromkeys(delays, value)
    for name, value in found.items():
        known = model.param.get(name)
        if known is not None and not known.lower <= value <= known.upper:
            raise InputError(
                f"freeze {name}={value:g} is outside {known.lower:g} to {known.upper:g} {known.unit}",
                "see `flighttest terms`",
            )
    return found


def _ties(asked: Mapping[str, str]) -> dict[str, str]:
    for name, source in asked.items():
        if source in asked:
            raise InputError(
                f"tie {name}={source}: a parameter is tied twice, or to one that is tied itself",
                "tie each to one that is free",
            )
    return dict(asked)


def model_data(found: Fit, recordings: Sequence[Recording], vehicle: Vehicle | None) -> ModelData:
    """The fit as model.yaml, with the fingerprint of the vehicle that was flown and what is known of its battery."""
    battery = battery_data(recordings)
    extra = for_later_flights(found)
    level = hover(found.problem.segments, found.model.nominal_voltage_v)
    if level is not None:
        extra["hover"] = plain(level)
    load = motor_load(found.problem.segments)
    if load is not None:
        extra["motors"] = plain(load)
    if battery:
        extra["battery"] = battery
    flown = mean_steps(found.problem.segments)
    if flown:
        extra["flown_steps"] = flown
    data = model_file.as_data(found, fingerprint=of_recordings(recordings, vehicle), extra_quality=extra)
    whose = identity_of(recordings, vehicle)
    return {"format": data["format"], "vehicle": whose.as_data(), **data}


def for_later_flights(found: Fit) -> QualityBlock:
    """What later flights are compared with: what this campaign's conditions differ by beyond their errors, relative, per parameter; and
    what the model gets wrong about each kind of step."""
    normal, segments = found.solution.normal, found.problem.segments
    made = measured(normal, found.covariance.names, found.values, segments)
    return {
        "discrepancy": {name: round(value, 5) for name, value in made.items()},
        "steps": matched_pair.matched_pair_data(
            matched_pair.steps_flown(normal, segments, found.model.nominal_voltage_v)
        ),
    }


def fit(
    runs: Sequence[RecordingSource],
    output: Path | None = None,
    columns: Path | None = None,
    vehicle: Path | None = None,
    options: FitRequest | None = None,
    progress: Progress = SILENT,
) -> Result:
    """Estimate the parameters of one or several recordings, jointly; write model.yaml to `output`."""
    options = options or FitRequest()
    check_writable(None if output is None else output.parent)
    declared = load_vehicle(vehicle, to_fly=False) if vehicle is not None else None
    recordings = open_recordings(runs, Reading(columns, options.workers, options.scheduler), progress)
    doubtful = inconsistencies(recordings)
    recordings = deduplicate(recordings)
    segments = cut_all(recordings, progress)
    weather = weather_of(options.weather, recordings, declared)
    found = fit_segments(segments, recordings, declared, options, progress)
    found = replace(found, notes=(*found.notes, *doubtful))
    result = finish_fit(found, segments, recordings, declared, output, [named(r) for r in runs])
    files = [r for r in runs if isinstance(r, Path)]
    facts = dict(result.document.facts)
    if doubtful:
        facts["careful"] = "; ".join(doubtful)
    if output is not None and found.status.good and len(files) == len(runs):
        named_by = "".join(
            f" {option} {shlex.quote(str(path))}"
            for option, path in (("--columns", columns), ("--vehicle", vehicle), ("--model", output))
            if path is not None
        )
        facts["go on"] = f"flighttest diagnose {' '.join(shlex.quote(str(f)) for f in files)}{named_by} -o diagnosis"
    progress.stage("estimating the wind of each flight")
    made = [motor_section(segments), wind_section(segments, found.model, weather)]
    sections = tuple(section for section, _ in made if section is not None)
    return replace(
        result,
        document=replace(result.document, sections=(*result.document.sections, *sections), facts=facts),
        data={**result.data, **made[0][1], **made[1][1]},
    )


def finish_fit(
    found: Fit,
    segments: Sequence[Segment],
    recordings: Sequence[Recording],
    vehicle: Vehicle | None,
    output: Path | None,
    runs: Sequence[str],
) -> Result:
    """Write the model and report what was found."""
    view = fit_view(found, segments)
    data = model_data(found, recordings, vehicle)
    facts = {"runs": paths(list(runs)), "terms": ", ".join(found.model.terms)}
    if output is not None:
        model_file.write(output, data)
        facts["model"] = str(output)
    tone: Tone = "bad" if not found.status.good else "good" if all(p.known for p in view.parameters) else "warn"
    why = why_nothing(found, runs)
    sections = (*((why,) if why is not None else ()), *fit_sections.fit_sections(view))
    document = Document("fit", view.verdict, tone, sections, facts)
    status = Status.DONE if found.status.good else Status.UNEXPLAINED
    return Result(document, data | {"losses": losses_of(recordings)}, status, found)
