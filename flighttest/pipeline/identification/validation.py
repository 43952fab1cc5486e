"""`flighttest validate`: a model and its simplifications against flights it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flighttest.datafiles import check_writable
from flighttest.errors import InputError
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.identify.validation.ablations import Variation
from flighttest.identify.validation.validate import HORIZONS_S, Validation, comparable
from flighttest.identify.validation.validate import validate as compare_models
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.recordings.fingerprints import differences
from flighttest.pipeline.recordings.sources import Reading, RecordingSource, losses_of, named, open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.history import check_runs, folder_of_runs
from flighttest.pipeline.store.identities import whose
from flighttest.pipeline.store.lineage import in_use
from flighttest.recording import Recording
from flighttest.report.document import Document, Tone
from flighttest.report.numbers import join
from flighttest.report.render import html
from flighttest.report.sections.validation import validation_sections
from flighttest.segments import Segment


@dataclass(frozen=True)
class Beside:
    """What a model is compared with. previous: an earlier model; horizons_s: at which errors are taken, empty: the usual ones."""

    previous: Path | ModelFile | None = None
    horizons_s: Sequence[float] = ()


def validate(
    model: Path | ModelFile | None,
    runs: Sequence[RecordingSource],
    beside: Beside | None = None,
    output: Path | None = None,
    columns: Path | None = None,
    progress: Progress = SILENT,
    *,
    out: Path | None = None,
) -> Result:
    """Paper section 4; `output`: also write the page; `out`: where the vehicle's model is, by itself the folder that holds the first run.

    Free flight and steps, where both are given, are compared apart: they ask different things of a model, and an error over both together
    would show little of either.
    """
    check_writable(None if output is None else output.parent)
    if out is not None:
        check_runs(out)
    if model is None:
        model, runs = _parted(runs)
    recordings = open_recordings(runs, Reading(columns), progress) if model is None else ()
    if model is None:
        model = _in_use(recordings, runs, out or folder_of_runs(runs))
    stored = model_file.read(model, whole=True) if isinstance(model, Path) else model
    beside = beside or Beside()
    earlier = model_file.read(beside.previous) if isinstance(beside.previous, Path) else beside.previous
    horizons_s = beside.horizons_s or HORIZONS_S
    recordings = recordings or open_recordings(runs, Reading(columns), progress)
    every = cut_all(recordings, progress)
    segments = [s for s in every if not s.between_steps]
    progress.stage("running the models open loop")
    usable = [s for s in segments if comparable(s)]
    steps = [s for s in usable if s.kind != "free"]
    found = compare_models(stored, segments, earlier, horizons_s)
    steps_alone = compare_models(stored, steps, earlier, horizons_s) if steps and len(steps) < len(usable) else None
    left_out = _left_out(every)
    facts = {"model": stored.path or "as fitted", "flights": join([named(r) for r in runs])}
    facts |= _reservations(stored, recordings) | ({"left out": left_out} if left_out else {})
    verdict, tone = _verdict(found)
    sections, data = validation_sections(found), _data(found) | {"left_out": left_out, "losses": losses_of(recordings)}
    data |= {name.replace(" ", "_"): facts.get(name, "") for name in ("careful", "another vehicle")}
    if steps_alone is not None:
        on_steps, steps_tone = _verdict(steps_alone)
        verdict = " ".join(
            f"In {kind}: {v[0].lower()}{v[1:]}" for kind, v in (("free flight", verdict), ("steps", on_steps))
        )
        tone = next((t for t in _WORST_FIRST if t in (tone, steps_tone)), tone)
        sections = (*validation_sections(found, "free flight"), *validation_sections(steps_alone, "steps"))
        data["steps"] = _data(steps_alone)
    document = Document("validation", verdict, tone, sections, facts)
    if output is not None:
        html.write_html(document, output)
    return Result(document, data, Status.DONE, found)


def _in_use(recordings: Sequence[Recording], runs: Sequence[RecordingSource], out: Path) -> Path:
    """The accepted model of the recordings' vehicle. InputError where the vehicle is unknown, or has none."""
    name = whose(recordings, None, out)
    if not name:
        raise InputError(
            f"{join([named(r) for r in runs])}: of an unknown vehicle, and no model was given",
            "name the model: flighttest validate MODEL RUN",
        )
    try:
        return Path(in_use(out, name).path)
    except InputError as none:
        raise InputError(
            none.message, "name the model: flighttest validate MODEL RUN, or with --out where it is"
        ) from none


def _reservations(stored: ModelFile, recordings: Sequence[Recording]) -> dict[str, str]:
    """Why the comparison is worth less than it looks: recordings that the model was fitted to, or of another vehicle."""
    found = {}
    seen = sorted({r.name for r in recordings} & {str(r) for r in stored.runs})
    if seen:
        found["careful"] = f"{join(seen)} was used in the fit: this shows the fit, not its power to predict"
    other = differences(stored.fingerprint, recordings)
    if other:
        found["another vehicle"] = f"the model's has {other}"
    return found


def _parted(paths: Sequence[RecordingSource]) -> tuple[Path | None, Sequence[RecordingSource]]:
    """The model among what was named, and the recordings: a model file, or the first of several folders where it holds one."""
    first, others = paths[0], paths[1:]
    if isinstance(first, Recording):
        return None, paths
    if first.suffix in (".yaml", ".yml"):
        if not others:
            raise InputError(f"no recording to compare {first} with", "name a recording: flighttest validate MODEL RUN")
        return first, others
    holds = first.is_dir() and any((first / name).is_file() for name in model_file.NAMES)
    return (first, others) if holds and others else (None, paths)


def _left_out(segments: Sequence[Segment]) -> str:
    """How many responses are not in the comparison, and why."""
    rejected = sum(not s.usable for s in segments)
    between = sum(s.usable and s.between_steps for s in segments)
    rest = sum(s.usable and not s.between_steps and not comparable(s) for s in segments)
    words = [f"{rejected} rejected (see `flighttest segment`)"] if rejected else []
    words += [f"{between} between steps, in which the vehicle was brought back"] if between else []
    words += [f"{rest} too short or without a recorded throttle"] if rest else []
    return f"of {len(segments)} responses {join(words)}" if words else ""


_WORST_FIRST: tuple[Tone, ...] = ("bad", "warn")


def _verdict(found: Validation) -> tuple[str, Tone]:
    at = min((e.horizon_s for e in found.errors), key=lambda h: abs(h - 1.0), default=1.0)
    full = {e.group: e for e in found.errors if e.variation is Variation.FULL and e.horizon_s == at}
    group = next((g for g in ("velocity", "position", "roll") if g in full), None)
    if group is None:
        return (found.sentences[0] if found.sentences else "Nothing could be compared."), "warn"
    others = {
        v: r
        for v in (Variation.LINEARISED, Variation.NO_DRAG, Variation.NO_BATTERY, Variation.ONLY_DELAY)
        if (r := found.rmse(v, group, at)) is not None
    }
    mine = full[group].rmse
    better = [v.value for v, r in others.items() if r > mine * 1.02]
    worse = [v.value for v, r in others.items() if r < mine * 0.98]
    units = {"velocity": "m/s", "position": "m", "roll": "rad"}[group]
    few = full[group].few
    tone: Tone = "warn" if few else "good"
    head = f"After {at:g} s the {group} error of the model is {mine:.3g} {units} (RMS{', ' if few else ''}{few})"
    held = found.rmse(Variation.HOLD, group, at)
    if held is not None and held < mine * 0.98:
        return (
            f"{head}; that of the last measurement, held for {at:g} s, is {held:.3g} {units}: worse than no model.",
            "bad",
        )
    if worse:
        return f"{head}; that of a simplification ({join(worse)}) is smaller on this flight.", "warn"
    if not better:
        return f"{head}.", tone
    if len(better) <= 2:
        return f"{head}, smaller than with {join(better, 'or')}.", tone
    return f"{head}, smaller than with any of the {len(better)} simplifications that differ from it.", tone


def _data(found: Validation) -> dict[str, Any]:
    return {
        "starts": found.starts,
        "segments": list(found.segments),
        "sentences": list(found.sentences),
        "errors": [
            {
                "model": e.variation.name,
                "group": e.group,
                "horizon_s": e.horizon_s,
                "rmse": e.rmse,
                "mean": e.mean,
                "count": e.count,
                "stretches": e.stretches,
            }
            for e in found.errors
        ],
    }
