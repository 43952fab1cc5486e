"""`flighttest twin model.yaml`: an identified model flown as the recorded vehicle was, and what still differs (`--verify RUN...`); recorded
commands on the vehicle with another battery, payload, propeller, wind or parameter (`--replay RUN --set NAME=VALUE`)."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

from flighttest.datafiles import check_writable
from flighttest.diagnose import Diagnosis
from flighttest.diagnose.against import (
    Difference,
    Side,
    differences_of,
    errors_of,
    notes_of,
    side_of,
    step_by_step,
)
from flighttest.diagnose.residuals.prediction import floors_of, prediction_quality
from flighttest.errors import FlighttestError, InputError
from flighttest.flight import FlightSettings, fly
from flighttest.identify.fit import fit
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.pipeline.diagnosis.against import difference_row, of_one_vehicle
from flighttest.pipeline.diagnosis.diagnose import run_diagnosis
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.identification.reporting import REPORT_NAME
from flighttest.pipeline.planning.checking import plans
from flighttest.pipeline.planning.predictor import ModelPredictor, ScriptReplanner
from flighttest.pipeline.recordings.consistency import deduplicate
from flighttest.pipeline.recordings.fingerprints import differences
from flighttest.pipeline.recordings.sources import Reading, RecordingSource, losses_of, named, open_recordings
from flighttest.pipeline.results import SILENT, Progress, Result, Status
from flighttest.pipeline.store.flown_with import VEHICLE_NAME, flown_with
from flighttest.report.document import Document
from flighttest.report.numbers import paths
from flighttest.report.render import html
from flighttest.report.render.plain import plain
from flighttest.report.sections.twin import (
    ReplayData,
    TwinData,
    replay_sections,
    replay_sentence,
    verify_sections,
    verify_sentence,
)
from flighttest.segments import Segment
from flighttest.sim import Simulation, start_simulator
from flighttest.sim.sitl.launcher import find_arducopter
from flighttest.sim.sitl.physics import PhysicsSitl, launch_on_physics
from flighttest.twin.firmware import firmware_options
from flighttest.twin.flown import flown_errors
from flighttest.twin.replay import HORIZON_S
from flighttest.twin.replay import replay as run_commands
from flighttest.twin.vehicle import assumed, fly_able, simulator_options
from flighttest.twin.what_if import outside, what_if
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import DEFAULT_VEHICLE, Vehicle

NEAR_FLOOR = 1.2  # noise floors that the twin's error may have in a channel that it predicts
_DOF = 30.0  # of the model's own standard errors, which a model file does not keep
# Delays ahead of the firmware's loops: of the link and of the wait for the next cycle (2.5 ms), which all repeats of a run share. Of one
# vehicle's yaw rate, by run: 10.8, 10.7, 12.1 ms; of its twin's: 13.2, 13.7 ms. 1.4 ms is 1.28 noise floors on a ramp of 4.7 rad/s^2.
_OF_THE_RUN = ("T_d", "T_d_attitude", "T_d_yaw_rate")
_SPEED = 20.0
_FIRMWARE_SPEED = 20.0  # at most: time is granted, and a machine that is slower takes longer
NOT_A_FILE = "as given"  # of a model that is in no file
_Launched = AbstractContextManager[Simulation] | AbstractContextManager[PhysicsSitl]


@dataclass(frozen=True)
class Flying:
    """How a twin is verified. offline: recorded commands alone; firmware: under the real ArduCopter, not the built-in autopilot; seed:
    of the twin's noise."""

    offline: bool = False
    firmware: bool = False
    seed: int = 1

    def check(self) -> None:
        """InputError where both are asked for, LinkError where there is no firmware on this machine."""
        if self.offline and self.firmware:
            raise InputError(
                "--offline flies nothing, so it cannot be combined with --backend sitl", "leave one of them out"
            )
        if self.firmware:
            find_arducopter()


def verify(
    model: Path | ModelFile,
    runs: Sequence[RecordingSource],
    output: Path | None = None,
    *,
    flying: Flying = Flying(),
    columns: Path | None = None,
    progress: Progress = SILENT,
) -> Result:
    """Fly the scripts of recorded runs on the twin and compare; runs without a script, or all of them offline, are compared with what the
    model makes of their recorded commands. With `output` the twin's flights and report.html are kept there."""
    check_writable(output)
    stored = model if isinstance(model, ModelFile) else model_file.read(model, whole=True)
    fly_able(stored)
    flying.check()
    recordings = deduplicate(open_recordings(runs, Reading(columns), progress))
    of_one_vehicle(recordings)
    segments = cut_all(recordings, progress)
    kept = [run for run in runs if isinstance(run, Path)]
    scripted = [] if flying.offline else [run for run in kept if (run / "script.yaml").is_file()]
    found = run_diagnosis(segments, recordings, stored, None, progress)
    flown: tuple[Segment, ...] = ()
    folders: list[Path] = []
    if flying.firmware and not scripted:
        raise InputError(
            "none of these recordings has a script to fly under the firmware", "give run folders of `flighttest run`"
        )
    if scripted:
        sides = _sides(stored, flying, progress)
        with tempfile.TemporaryDirectory() as scratch:
            folders = [
                _fly(stored, run, (output or Path(scratch)) / f"twin-{run.name}", sides(flying.seed + i), progress)
                for i, run in enumerate(scripted)
            ]
            flown = cut_all(open_recordings(folders, progress=progress), progress)
    progress.stage("comparing the twin with the recordings")
    data = compare_with_recordings(stored, segments, found, flown, flying.firmware)
    data |= {
        "backend": "sitl" if flying.firmware else "builtin",
        "flown": [str(f) for f in folders] if output is not None else [],
        "flights": len(folders),
        "assumed": list(assumed(stored)),
        "losses": losses_of(recordings),
    }
    facts = {
        "model": NOT_A_FILE if isinstance(model, ModelFile) else str(model),
        "recordings": paths([named(r) for r in runs]),
    }
    other = differences(stored.fingerprint, recordings)
    if other:
        facts["another vehicle"] = f"the model's has {other}"
    good = data["verdict"] == "NOTHING_MISSING"
    document = Document("twin", verify_sentence(data), "good" if good else "warn", verify_sections(data), facts)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        html.write_html(document, output / REPORT_NAME)
        facts["written to"] = str(output)
    return Result(document, data, Status.DONE if good else Status.UNEXPLAINED, found)


def replay(
    model: Path | ModelFile,
    runs: Sequence[RecordingSource],
    changes: Sequence[str] = (),
    output: Path | None = None,
    columns: Path | None = None,
    progress: Progress = SILENT,
) -> Result:
    """Recorded commands on the vehicle of a model with changes, beside the recording; with `output` write report.html there."""
    check_writable(output)
    stored = model if isinstance(model, ModelFile) else model_file.read(model, whole=True)
    fly_able(stored)
    change = what_if(stored, changes)
    recordings = deduplicate(open_recordings(runs, Reading(columns), progress))
    of_one_vehicle(recordings)
    segments = cut_all(recordings, progress)
    progress.stage("running the recorded commands on the twin")
    found = run_commands(stored, segments, change)
    data: ReplayData = {
        "format": "replay/1",
        "changes": list(change.sentences),
        "effects": plain(found.effects),
        "starts": found.starts,
        "horizon_s": HORIZON_S,
        "terms": list(change.model.terms),
        "losses": losses_of(recordings),
    }
    facts = {
        "model": NOT_A_FILE if isinstance(model, ModelFile) else str(model),
        "recordings": paths([named(r) for r in runs]),
    }
    other = differences(stored.fingerprint, recordings)
    if other:
        facts["another vehicle"] = f"the model's has {other}"
    beyond = outside(stored, change)
    if beyond:
        facts["careful"] = beyond
    sections = replay_sections(data, plain(found.shown))
    document = Document("what if", replay_sentence(data), "plain", sections, facts)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        html.write_html(document, output / REPORT_NAME)
        facts["written to"] = str(output)
    return Result(document, data, Status.DONE, found)


def vehicle_of(run: Path) -> Vehicle:
    """The vehicle that a run was flown with: its copy of the vehicle file, else the built-in one."""
    if (run / VEHICLE_NAME).is_file():
        return load_vehicle(run / VEHICLE_NAME)
    before = flown_with(run)
    name = before.airframe if before is not None else DEFAULT_VEHICLE.name
    return replace(DEFAULT_VEHICLE, name=name)


def _sides(stored: ModelFile, flying: Flying, progress: Progress) -> Callable[[int], _Launched]:
    """What starts the twin with a seed: behind the built-in autopilot, or under the real firmware, whose frame is fitted once."""
    if not flying.firmware:
        return lambda seed: start_simulator(simulator_options(stored, seed=seed, speed=_SPEED, lockstep=True))
    progress.stage("fitting a frame whose attitude loops under the firmware are the identified ones")
    made, _ = firmware_options(stored, speed=_FIRMWARE_SPEED)
    return lambda seed: launch_on_physics(replace(made, seed=seed))


def _fly(stored: ModelFile, run: Path, folder: Path, launched: _Launched, progress: Progress) -> Path:
    """One recorded script on the twin; gives the run folder."""
    prior = ModelPredictor(stored.model, stored.values)
    (plan,) = plans([str(run / "script.yaml")], vehicle_of(run), prior)
    refused = {leg for leg, _, _ in plan.refusals}
    progress.stage(f"flying {plan.script.name} on the twin: {len(plan.legs) - len(refused)} steps")
    asked = FlightSettings(
        set_params=True, skip=refused, replanner=ScriptReplanner(plan, prior), on_progress=progress.flight
    )
    with launched as simulation:
        ended = fly(plan, simulation.url, folder, asked)
    if not ended.outcome.orderly:
        raise FlighttestError(
            f"the twin did not fly {plan.script.name}: {ended.sentence}",
            "see `flighttest check` with this model, or compare recorded commands alone with --offline",
        )
    return ended.run_dir


def compare_with_recordings(
    stored: ModelFile, segments: Sequence[Segment], found: Diagnosis, flown: Sequence[Segment], firmware: bool = False
) -> TwinData:
    """twin/1: parameters, error by channel in noise floors, steps, and the verdict. firmware: the attitude loops that flew are the
    firmware's, not the model's: the channels of the steps are judged by the flown responses, the others with the delays of the recorded
    runs, and a term of the loops that the recordings need is looked for in the twin's flights."""
    assert found.fit is not None
    model = stored.model
    errors = {n: (p.std, _DOF) for n, p in stored.parameters.items() if p.std is not None and n in model.names}
    values: Mapping[str, float] = stored.values
    loops: tuple[str, ...] = ()
    if flown:
        usable = [s for s in flown if s.usable]
        if firmware:
            loops = tuple(t for t in found.accepted if t not in model.terms and block_of(catalogue()[t]) == "attitude")
        again = fit(usable, model.with_terms(*loops), select="all", start={**found.fit.values, **stored.values})
        known = errors_of(again)
        # The twin's own recordings, and the error of the model that it flies.
        errors = {n: (math.hypot(s, known[n][0]), min(d, known[n][1])) for n, (s, d) in errors.items() if n in known}
        errors |= {n: e for n, e in known.items() if n not in model.names}
        model, values = again.model, again.values
    real, twin = side_of(found.fit, found), Side(model, values, errors)
    rows = differences_of(real, twin)
    usable = [s for s in segments if s.usable]
    late = [n for n in _OF_THE_RUN if firmware and n in stored.model.names]
    made = prediction_quality(usable, stored.model, stored.values, found.fit.noise, late)
    floors, fitted = floors_of(found.fit, found), found.fit.quality
    channels = {
        c: {"rmse": q.rmse, "floor": floors[c], "ratio": q.rmse / floors[c], "fitted": fitted[c].rmse / floors[c]}
        for c, q in made.items()
        if c in floors and floors[c] > 0
    }
    steps_flown = flown_errors(segments, flown, stored.values["alpha"], stored.model.nominal_voltage_v)
    judged = channels | steps_flown if firmware else channels
    above = [c for c, v in judged.items() if v["ratio"] > NEAR_FLOOR]
    differing: list[Difference] = [d for d in rows if d.differs]
    return {
        "format": "twin/1",
        "verdict": "NOTHING_MISSING" if not differing and not above else "DIFFERS",
        "near_floor": NEAR_FLOOR,
        "terms": list(stored.model.terms),
        "titles": {t.id: t.title for t in found.model.built_terms},
        "lacks": [t for t in found.accepted if t not in loops],
        "differing": [d.name for d in differing],
        "channels": plain(channels),
        "flown_channels": plain(steps_flown),
        "above": above,
        "parameters": [difference_row(d) for d in rows],
        "notes": list(notes_of(rows, real, twin)),
        "steps": plain(step_by_step(segments, flown)) if flown else [],
        "diagnosis": {"verdict": found.verdict.name, "sentence": found.sentence},
    }
