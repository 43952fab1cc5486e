"""The verbs of the public interface. Each calls the step of `pipeline` that the command of the same name calls.

A recording is given as a run folder, a log, or what `read` returned; a vehicle as its vehicle.yaml; a model as a file, a folder that holds
one, or a `FittedModel`. Every error is a `FlighttestError`: RecordingError and InputError for what cannot be read or used, FitError
where nothing can be estimated, LinkError and PreflightError for a vehicle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack, cast

from flighttest.api.inputs import (
    AnyPath,
    DiagnoseOptions,
    FitOptions,
    HiddenEffects,
    ProgressLike,
    SimulateOptions,
    Source,
    as_hidden,
    as_model,
    as_path,
    as_physics,
    as_progress,
    as_sources,
    reading_options,
)  # fmt: skip
from flighttest.recording.model import Recording

if TYPE_CHECKING:
    from flighttest.api.answers import Diagnosed, Fitted, Models, Planned, Responses, Validated, Validity
    from flighttest.api.fitted_model import FittedModel
    from flighttest.physics.model import Model
    from flighttest.pipeline.results import Result
    from flighttest.sim.simulation import Simulation


def read(source: AnyPath, *, columns: AnyPath | None = None) -> Recording:
    """Read a run folder or a log (.BIN, .log, .tlog, .ulg, .csv, .parquet, .mat, .mcap, packed or not).

    columns: column map (columns/1) of a foreign table. The recording has channels by name in SI, world North-West-Up, body
    Forward-Left-Up, each group on its own times (n,); `to_frame` and `plot` show them. RecordingError: what is wrong with the file.
    """
    from flighttest.pipeline.recordings.sources import open_recording

    return open_recording(Path(source), as_path(columns))


def segment(*sources: Source, columns: AnyPath | None = None, progress: ProgressLike | None = None) -> Responses:
    """Cut recordings into step responses and windows of free flight, each accepted, or rejected with its reason."""
    from flighttest.api.answers import Responses
    from flighttest.pipeline.identification import fitting as analysis

    result = analysis.segment(as_sources(sources), as_path(columns), as_progress(progress))
    return Responses(document=result.document, data=result.data, status=result.status, segments=tuple(result.value))


def fit(
    *sources: Source,
    model: Model | FittedModel | None = None,
    vehicle: AnyPath | None = None,
    freeze: Mapping[str, float] | None = None,
    tie: Mapping[str, str] | None = None,
    columns: AnyPath | None = None,
    progress: ProgressLike | None = None,
    **options: Unpack[FitOptions],
) -> Fitted:
    """Estimate a model's parameters from one or several recordings, jointly.

    model: the paper's where none is given; add terms with `+`; of a fitted one the terms count. vehicle: vehicle.yaml, for nominal
    voltage and components. freeze: parameters held at a value (T_d holds every delay); tie: parameter to the one it equals. progress:
    called with each stage's words. options: `flighttest.api.inputs.FitOptions`. FitError where no response can be used.
    """
    from flighttest.pipeline.identification import fitting as analysis

    further = reading_options(options, "output")
    output = further.pop("output", None)
    asked = analysis.FitRequest(model=as_physics(model), freeze=freeze or {}, tie=tie or {}, **further)
    result = analysis.fit(
        as_sources(sources),
        output,
        columns=as_path(columns),
        vehicle=as_path(vehicle),
        options=asked,
        progress=as_progress(progress),
    )
    return _fitted(result)


def _fitted(result: Result) -> Fitted:
    from flighttest.api.answers import Fitted
    from flighttest.api.fitted_model import model_of
    from flighttest.identify.models.model_blocks import ModelData

    # Winds, motors and losses are reported of a fit and not kept in its model.
    kept = cast(ModelData, {k: v for k, v in result.data.items() if k in ModelData.__annotations__})
    model = model_of(result.value, kept)
    return Fitted(document=result.document, data=result.data, status=result.status, fit=result.value, model=model)


def read_model(path: AnyPath) -> FittedModel:
    """Read model.yaml, or the one in a run or diagnosis folder. ModelError lists everything wrong with it."""
    from flighttest.api.fitted_model import fitted_model

    return fitted_model(path)


def validate(
    model: FittedModel | AnyPath | None,
    *sources: Source,
    previous: FittedModel | AnyPath | None = None,
    horizons_s: Sequence[float] = (),
    output: AnyPath | None = None,
    columns: AnyPath | None = None,
    runs: AnyPath | None = None,
    progress: ProgressLike | None = None,
) -> Validated:
    """Compare a model and its simplifications, run open loop on recorded commands, with flights it was not fitted to (paper, section 4).

    model: with None the first of several sources where that holds one, else the model in use of the recorded vehicle in
    `runs`, which by itself is the folder that holds the first run. previous:
    an earlier model to compare as well; horizons_s: times after each start at which errors are taken, s; output: HTML page to write.
    FitError where no recording can be run open loop.
    """
    from flighttest.api.answers import Validated
    from flighttest.pipeline.identification.validation import Beside
    from flighttest.pipeline.identification.validation import validate as compare

    beside = Beside(None if previous is None else as_model(previous), tuple(horizons_s))
    result = compare(
        None if model is None else as_model(model), as_sources(sources), beside, as_path(output), as_path(columns),
        as_progress(progress), out=as_path(runs),
    )  # fmt: skip
    return Validated(document=result.document, data=result.data, status=result.status, validation=result.value)


def diagnose(
    *sources: Source,
    model: FittedModel | AnyPath | None = None,
    vehicle: AnyPath | None = None,
    output: AnyPath | None = None,
    columns: AnyPath | None = None,
    progress: ProgressLike | None = None,
    **options: Unpack[DiagnoseOptions],
) -> Diagnosed:
    """Find where simulation and recordings differ, what physics the model leaves out, and what to fly next.

    model: what to start from, one fitted to the recordings where none is given. output: folder for diagnosis.json, model.yaml,
    report.html and, where one is due, next.yaml. options: `flighttest.api.inputs.DiagnoseOptions`, as weather="still".
    """
    from flighttest.api.answers import Diagnosed
    from flighttest.api.fitted_model import model_of
    from flighttest.identify.models import model_file
    from flighttest.pipeline.diagnosis.diagnose import diagnose as search
    from flighttest.pipeline.recordings.sources import Reading

    base = None if model is None else as_model(model)
    further = reading_options(options)
    accepting = further.pop("accept", False)
    reading = Reading(as_path(columns), **further)
    result = search(
        as_sources(sources), base, as_path(output), as_path(vehicle), reading, as_progress(progress), accepting
    )
    found = result.value.fit
    accepted = None if found is None else model_of(found, model_file.as_data(found))
    return Diagnosed(
        document=result.document, data=result.data, status=result.status, diagnosis=result.value, model=accepted
    )


def check_validity(
    *sources: Source,
    model: FittedModel | AnyPath | None = None,
    vehicle: AnyPath | None = None,
    connect: str | None = None,
    runs: AnyPath = "runs",
    output: AnyPath | None = None,
    columns: AnyPath | None = None,
    progress: ProgressLike | None = None,
) -> Validity:
    """Does a stored model still hold for this vehicle: declared changes, its parameters today, and new recordings, possibly none.

    model: the vehicle's model in use in `runs` where none is given; vehicle: vehicle.yaml as it is today; connect: URL of the vehicle,
    whose firmware and parameters are read, and nothing is set (with the signing key that `vehicle` names, where it
    names one). output: folder for status.html and the scripts to fly.
    """
    from flighttest.api.answers import Validity
    from flighttest.pipeline.recordings.sources import Reading, open_recordings
    from flighttest.pipeline.validity.status import status
    from flighttest.pipeline.vehicles.live import key_for, read_vehicle

    words = as_progress(progress)
    present = None
    if connect is not None:
        present = read_vehicle(connect, words, key_for(None, as_path(vehicle)))
    given: Sequence[Path | Recording] = as_sources(sources) if sources else []
    if columns is not None:
        given = open_recordings(given, Reading(Path(columns)), words)
    stored = None if model is None else as_model(model)
    result = status(given, as_path(vehicle), stored, Path(runs), as_path(output), words, present)
    return Validity(document=result.document, data=result.data, status=result.status, assessment=result.value)


def models(runs: AnyPath = "runs") -> Models:
    """The models accepted for each vehicle in a folder of runs: which flights, which terms joined when, which change ended each."""
    from flighttest.api.answers import Models
    from flighttest.pipeline.store.lineage import lineages
    from flighttest.pipeline.store.models import models as listed

    result = listed(Path(runs))
    return Models(
        document=result.document, data=result.data, status=result.status, lineages=tuple(lineages(Path(runs)))
    )


def accept(model: AnyPath, *, vehicle: AnyPath | None = None, runs: AnyPath = "runs") -> Models:
    """Make the model of a run or diagnosis folder, or a model file, its vehicle's model in use; gives all accepted ones.

    vehicle: vehicle.yaml, where the model holds no name of its vehicle. InputError where there is none at all.
    """
    from flighttest.api.answers import Models
    from flighttest.pipeline.store.lineage import lineages
    from flighttest.pipeline.store.models import accept as accept_model

    result = accept_model(Path(model), Path(runs), as_path(vehicle))
    return Models(
        document=result.document, data=result.data, status=result.status, lineages=tuple(lineages(Path(runs)))
    )


def plan(
    *scripts: AnyPath,
    vehicle: AnyPath | None = None,
    model: FittedModel | AnyPath | None = None,
    runs: AnyPath = "runs",
    phases: bool = False,
) -> Planned:
    """Compile maneuver scripts without a vehicle: steps, duration, battery, predicted envelope against the zone.

    scripts: paths, or names of shipped maneuvers; vehicle: vehicle.yaml, the built-in vehicle where none is given; model: flown
    through the scripts, else the vehicle's in use in `runs`, else the paper's. phases: those of every leg, too. ScriptError lists
    everything wrong with a script.
    """
    from flighttest.api.answers import Planned
    from flighttest.pipeline.planning.checking import check

    words = [str(script) for script in scripts]
    result = check(words, as_path(vehicle), None if model is None else as_model(model), out=Path(runs), verbose=phases)
    return Planned(document=result.document, data=result.data, status=result.status, plans=tuple(result.value))


def simulate(
    airframe: Literal["paper", "rotor"] = "paper",
    *,
    model: FittedModel | AnyPath | None = None,
    hide: HiddenEffects = (),
    seed: int = 1,
    speed: float = 20.0,
    port: int = 0,
    lockstep: bool = True,
    **options: Unpack[SimulateOptions],
) -> Simulation:
    """A MAVLink copter on this machine, for tests of whatever talks to one: `with ft.simulate() as vehicle: connect(vehicle.url)`.

    airframe: 'paper' (the paper's model) or 'rotor' (rotor-level first principles). model: an identified model flies instead. hide:
    concealed physics, {"ground_effect": {"R2_m2": 0.1}} or ["ground_effect:R2_m2=0.1"]. speed: times real time; port: 0 takes any free
    one; lockstep: deterministic for a seed, time stands still until the client grants some. options:
    `flighttest.api.inputs.SimulateOptions`. It ends with the block, or with this process. InputError for options that cannot be.
    """
    from flighttest.sim import SimOptions, parse_hide, start_simulator

    hidden = parse_hide(as_hidden(hide))
    if model is not None:
        from flighttest.api.fitted_model import fitted_model
        from flighttest.twin.vehicle import simulator_options

        twin = simulator_options(
            fitted_model(model).stored, hidden, seed=seed, speed=speed, lockstep=lockstep, **options
        )
        return start_simulator(twin, port=port)
    made = SimOptions(airframe=airframe, hide=hidden, seed=seed, speed=speed, lockstep=lockstep, **options)
    return start_simulator(made, port=port)
