"""`flighttest demo`: a simulated vehicle with a concealed effect is flown, diagnosed and modelled; a flight that was not used and the
twin show the improvement. The concealed effect reaches the simulator and the last section of the page; no step between reads it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from flighttest.datafiles import check_writable
from flighttest.diagnose.model import short
from flighttest.diagnose.records import DiagnosisData
from flighttest.diagnose.residuals.prediction import prediction_quality
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.identify.validation.ablations import measured_channels, open_loop, voltage_for
from flighttest.pipeline import twin as twins
from flighttest.pipeline.diagnosis.diagnose import MODEL_NAME
from flighttest.pipeline.flights.run import FlightRequest, run
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.identification.reporting import REPORT_NAME
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.history import FIT_NAME
from flighttest.pipeline.vehicles.live import BUILTIN
from flighttest.pipeline.vehicles.simulator import options
from flighttest.report.render import html
from flighttest.report.render.plain import plain
from flighttest.report.render.svg import as_svg
from flighttest.report.sections.demo import DemoData, ErrorRow, ShownStretch, demo_document, figure_of
from flighttest.report.sections.twin import TwinData
from flighttest.segments import Segment
from flighttest.sim import parse_hide
from flighttest.sim.build import build_plant
from flighttest.twin.replay import runnable, starts_in

HIDE = ("slung_payload:payload_ratio=0.1,cable_m=1.0,swing_damping=0.05",)
CAMPAIGN = ("thrust_hover", "yaw_rate", "lateral_stop")
UNUSED = "spot_check"
FIGURE_NAME = "figure.svg"
_HORIZON_S = 3.0  # of the runs drawn


@dataclass(frozen=True)
class DemoRequest:
    """A demonstration. hide: what the vehicle conceals; campaign: scripts to identify from; unused: the script of the flight
    that is predicted only."""

    out: Path = Path("demo")
    seed: int = 1
    hide: tuple[str, ...] = HIDE
    airframe: str = "rotor"
    campaign: tuple[str, ...] = CAMPAIGN
    unused: str = UNUSED


def demo(request: DemoRequest, progress: Progress = SILENT) -> Result:
    """Fly, diagnose, predict, verify; report.html, figure.svg and all runs go into a new folder."""
    hidden = parse_hide(request.hide)
    # Where the vehicle has no such effect that is reported before anything is written.
    build_plant(options(request.airframe, request.hide, request.seed))
    check_writable(request.out)
    out = _new_folder(request.out)
    asked = FlightRequest(
        request.campaign, connect=BUILTIN, out=out, seed=request.seed, airframe=request.airframe, hide=request.hide
    )
    progress.stage(
        "first part: a simulated vehicle with a concealed effect flies; its recordings are fitted and diagnosed"
    )
    found = run(asked, progress)
    if found.status is Status.UNUSABLE or "diagnosis" not in found.data:
        return found
    progress.stage("second part: one more flight, to be predicted and not used")
    seed = request.seed + len(request.campaign)
    other = run(replace(asked, scripts=(request.unused,), seed=seed, fly_only=True), progress)
    if other.status is Status.UNUSABLE:
        return other
    progress.stage(
        "third part: the improved model predicts that flight, and flies its script as a vehicle of its own, its twin"
    )
    return composed(
        Path(found.data["runs"][-1]), Path(other.data["runs"][-1]), out, hidden, found.data["diagnosis"], progress
    )


def composed(
    folder: Path,
    unused: Path,
    out: Path,
    hidden: Mapping[str, Mapping[str, float]],
    diagnosis: DiagnosisData,
    progress: Progress = SILENT,
) -> Result:
    """The page of a diagnosed campaign, by its last run folder, and of a recorded flight that was not used. hidden: shown in its last
    section, and used for nothing else."""
    base, improved = (model_file.read(folder / name, whole=True) for name in (FIT_NAME, MODEL_NAME))
    verified = twins.verify(folder / MODEL_NAME, [unused], out / "twin", progress=progress)
    segments = [s for s in cut_all(open_recordings([unused], progress=progress), progress) if s.usable]
    before = prediction_quality(segments, base.model, base.values, verified.value.fit.noise)
    floors = diagnosis["noise_floor"]  # of the campaign, whose steps were repeated
    prediction: dict[str, ErrorRow] = {
        c: {"before": before[c].rmse, "after": v["rmse"], "floor": floors[short(c)]["value"]}
        for c, v in verified.data["channels"].items()
        if c in before and short(c) in floors
    }
    findings = diagnosis["findings"]
    data: DemoData = {
        "format": "demo/1",
        "hidden": {term: dict(values) for term, values in hidden.items()},
        "findings": findings,
        "as_hidden": {f["term"] for f in findings} == set(hidden),
        "prediction": prediction,
        "shown": plain(predicted_stretch(segments, base, improved, {c: v["floor"] for c, v in prediction.items()})),
        "twin": cast(TwinData, verified.data),
        "twin_report": str(out / "twin" / REPORT_NAME),
        "unused": unused.name,
        "runs": [str(folder), str(unused)],
        "report": str(out / REPORT_NAME),
    }
    commands = (
        ("Make the improved model this vehicle's:", f"flighttest accept {_quoted(folder)} --out {_quoted(out)}"),
        ("Test whether it is still valid:", f"flighttest status {_quoted(unused)} --out {_quoted(out)}"),
        (
            "Predict a flight with one volt less:",
            f"flighttest twin {_quoted(folder / MODEL_NAME)} \\\n    --replay {_quoted(unused)} --set battery=-1",
        ),
    )
    document = demo_document(data, commands, str(out / REPORT_NAME))
    figure = figure_of(data)
    if figure is not None:
        (out / FIGURE_NAME).write_text(as_svg(figure), encoding="utf-8")
    html.write_html(document, out / REPORT_NAME)
    return Result(document, data, value=verified.value)


def _quoted(path: Path) -> str:
    return shlex.quote(str(path))


def _new_folder(wanted: Path) -> Path:
    """The folder, or where it holds something, one beside it: models accepted there would be the base of this diagnosis."""
    folder, count = wanted, 2
    while folder.exists() and any(folder.iterdir()):
        folder, count = wanted.with_name(f"{wanted.name}-{count}"), count + 1
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def predicted_stretch(
    segments: Sequence[Segment], base: ModelFile, improved: ModelFile, floors: Mapping[str, float]
) -> ShownStretch | None:
    """The stretch and channel in which the improved model's open-loop error falls furthest below the base model's, in noise floors."""
    pieces = runnable(segments)
    starts = starts_in(pieces, _HORIZON_S)
    made = [open_loop(m.model, m.values, [voltage_for(m, s) for s in pieces], starts) for m in (base, improved)]
    best = 0.0
    found: ShownStretch | None = None
    for start, before, after in zip(starts, *made, strict=True):
        segment, here = pieces[start.segment], slice(start.first, start.last + 1)
        for channel, y in measured_channels(segment).items():
            if channel not in floors or not np.isfinite(y[here]).all():
                continue
            measured = y[here]
            errors = [float(np.sqrt(np.mean((m[channel] - measured) ** 2))) for m in (before, after)]
            gain = (errors[0] - errors[1]) / floors[channel]
            if gain > best:
                t_s = segment.t_s[here] - segment.t_s[start.first]
                best = gain
                found = {
                    "segment": segment.name, "channel": channel, "t_s": t_s, "measured": measured, "before": before[channel],
                    "after": after[channel],
                }  # fmt: skip
    return found
