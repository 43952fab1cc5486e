"""The verbs of the public interface. Each calls the step of `pipeline` that the command of the same name calls.

A recording is given as a run folder, a log, or what `read` returned; a vehicle as its vehicle.yaml; a model as a file, a folder that holds
one, or a `FittedModel`. Every error is a `FlighttestError`: RecordingError and InputError for what cannot be read or used, FitError
where nothing can be estimated, LinkError and PreflightError for a vehicle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from flighttest.errors import InputError
from flighttest.recording.model import Recording

if TYPE_CHECKING:
    from flighttest.api.answers import Diagnosed, Fitted, Flown, Models, Planned, Responses, Validated, Validity
    from flighttest.api.fitted_model import FittedModel
    from flighttest.identify.fit import Fit
    from flighttest.physics.model import Model
    from flighttest.pipeline.flights.run import FlightRequest
    from flighttest.pipeline.results import Result
    from flighttest.sim.simulation import Simulation

AnyPath = str | PathLike[str]
Source = str | PathLike[str] | Recording
Tell = Callable[[str], object]


class Stages:
    """Progress that hands each stage's words to a function."""

    def __init__(self, tell: Tell | None) -> None:
        self._tell = tell

    def stage(self, text: str) -> None:
        """A new step begins."""
        if self._tell is not None:
            self._tell(text)

    def part(self, done: float, of: float) -> None:
        """So many pieces are done; a stage's words are all that is handed on."""

    def flight(self, progress: Any) -> None:
        """The flight went on; its words are in the stages."""


def as_path(path: AnyPath | None) -> Path | None:
    """A path, where one is given."""
    return None if path is None else Path(path)


def as_sources(sources: Source | Iterable[Source]) -> list[Path | Recording]:
    """One recording or several, as the pipeline takes them; InputError where there is none."""
    given = [sources] if isinstance(sources, str | PathLike | Recording) else list(sources)
    if not given:
        raise InputError("no recording was given", "name a run folder, a log, or what `read` returned")
    return [source if isinstance(source, Recording) else Path(source) for source in given]


def read(source: AnyPath, *, columns: AnyPath | None = None) -> Recording:
    """Read a run folder or a log (.BIN, .tlog, .ulg, .csv, .parquet, .mat, .mcap, packed or not).

    columns: column map (columns/1) of a foreign table. The recording has channels by name in SI, world North-West-Up, body
    Forward-Left-Up, each group on its own times (n,); `to_frame` and `plot` show them. RecordingError says what is wrong with the file.
    """
    from flighttest.pipeline.recordings.sources import open_recording

    return open_recording(Path(source), as_path(columns))


def segment(*sources: Source, columns: AnyPath | None = None) -> Responses:
    """Cut recordings into step responses and windows of free flight, each accepted, or rejected with its reason."""
    from flighttest.api.answers import Responses
    from flighttest.pipeline.identification import fitting as analysis

    result = analysis.segment(as_sources(sources), as_path(columns))
    return Responses(document=result.document, data=result.data, status=result.status, segments=tuple(result.value))


def fit(
    *sources: Source,
    model: Model | None = None,
    vehicle: AnyPath | None = None,
    freeze: Mapping[str, float] | None = None,
    tie: Mapping[str, str] | None = None,
    columns: AnyPath | None = None,
    progress: Tell | None = None,
) -> Fitted:
    """Estimate a model's parameters from one or several recordings, jointly.

    model: the paper's where none is given; add terms with `+`. vehicle: vehicle.yaml, for nominal voltage and components. freeze:
    parameters held at a value (T_d holds every delay); tie: parameter to the one it equals. progress: called with each stage's words.
    FitError where no response can be used.
    """
    from flighttest.pipeline.identification import fitting as analysis

    options = analysis.FitOptions(model=model, freeze=freeze or {}, tie=tie or {})
    result = analysis.fit(
        as_sources(sources),
        columns=as_path(columns),
        vehicle=as_path(vehicle),
        options=options,
        progress=Stages(progress),
    )
    return _fitted(result)


def _fitted(result: Result) -> Fitted:
    from flighttest.api.answers import Fitted

    model = model_of(result.value, {k: v for k, v in result.data.items() if k != "losses"})
    return Fitted(document=result.document, data=result.data, status=result.status, fit=result.value, model=model)


def model_of(found: Fit, data: Mapping[str, Any]) -> FittedModel:
    """A fit as the model that later steps take. data: as model.yaml holds it."""
    from flighttest.api.fitted_model import FittedModel
    from flighttest.identify.models import model_file

    stored = replace(model_file.from_fit(found), fingerprint=data["fingerprint"], fit_quality=data["fit_quality"])
    stored = replace(stored, vehicle=data.get("vehicle") or {})
    return FittedModel(stored, data)


def read_model(path: AnyPath) -> FittedModel:
    """Read model.yaml, or the one in a run or diagnosis folder. ModelError lists everything wrong with it."""
    from flighttest.api.fitted_model import fitted_model

    return fitted_model(path)


def validate(
    model: FittedModel | AnyPath,
    *sources: Source,
    previous: FittedModel | AnyPath | None = None,
    columns: AnyPath | None = None,
) -> Validated:
    """Compare a model and its simplifications, run open loop on recorded commands, with flights it was not fitted to (paper, section 4).

    previous: an earlier model to compare as well. FitError where no recording can be run open loop.
    """
    from flighttest.api.answers import Validated
    from flighttest.api.fitted_model import fitted_model
    from flighttest.pipeline.identification.validation import Beside
    from flighttest.pipeline.identification.validation import validate as compare

    earlier = None if previous is None else fitted_model(previous).stored
    result = compare(fitted_model(model).stored, as_sources(sources), Beside(earlier), columns=as_path(columns))
    return Validated(document=result.document, data=result.data, status=result.status, validation=result.value)


def diagnose(
    *sources: Source,
    model: FittedModel | AnyPath | None = None,
    vehicle: AnyPath | None = None,
    output: AnyPath | None = None,
    columns: AnyPath | None = None,
    weather: Sequence[str] = (),
    progress: Tell | None = None,
) -> Diagnosed:
    """Say where simulation and recordings differ, what physics the model leaves out, and what to fly next.

    model: what to start from, one fitted to the recordings where none is given. output: folder for diagnosis.json, model.yaml,
    report.html and, where one is due, next.yaml. weather: 'still', or 'FLIGHT=still' for flights whose name holds FLIGHT.
    """
    from flighttest.api.answers import Diagnosed
    from flighttest.api.fitted_model import fitted_model
    from flighttest.identify.models import model_file
    from flighttest.pipeline.diagnosis.diagnose import diagnose as search
    from flighttest.pipeline.recordings.sources import Reading

    base = None if model is None else fitted_model(model).stored
    reading = Reading(as_path(columns), weather=tuple(weather))
    result = search(as_sources(sources), base, as_path(output), as_path(vehicle), reading, Stages(progress))
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
) -> Validity:
    """Does a stored model still hold for this vehicle: declared changes, its parameters today, and new recordings, possibly none.

    model: the vehicle's model in use in `runs` where none is given; vehicle: vehicle.yaml as it is today; connect: URL of the vehicle,
    whose firmware and parameters are read, and nothing is set.
    """
    from flighttest.api.answers import Validity
    from flighttest.api.fitted_model import fitted_model
    from flighttest.pipeline.validity.status import status
    from flighttest.pipeline.vehicles.live import read as read_vehicle

    stored = None if model is None else fitted_model(model).stored
    present = None if connect is None else read_vehicle(connect)
    given = as_sources(sources) if sources else []
    result = status(given, as_path(vehicle), stored, Path(runs), present=present)
    return Validity(document=result.document, data=result.data, status=result.status, currency=result.value)


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

    vehicle: vehicle.yaml, where the model does not say which vehicle it is of. InputError where that is not known at all.
    """
    from flighttest.api.answers import Models
    from flighttest.pipeline.store.lineage import lineages
    from flighttest.pipeline.store.models import accept as accept_model

    result = accept_model(Path(model), Path(runs), as_path(vehicle))
    return Models(
        document=result.document, data=result.data, status=result.status, lineages=tuple(lineages(Path(runs)))
    )


def plan(*scripts: AnyPath, vehicle: AnyPath | None = None, model: AnyPath | None = None) -> Planned:
    """Compile maneuver scripts without a vehicle: steps, duration, battery, predicted envelope against the zone.

    scripts: paths, or names of shipped maneuvers; vehicle: vehicle.yaml, the built-in vehicle where none is given; model: model.yaml flown
    through the scripts, else the paper's. ScriptError lists everything wrong with a script.
    """
    from flighttest.api.answers import Planned
    from flighttest.pipeline.planning.checking import check
    from flighttest.plan import check as check_plan

    result = check([str(script) for script in scripts], as_path(vehicle), as_path(model))
    checks = tuple(check_plan(one) for one in result.value)
    return Planned(
        document=result.document, data=result.data, status=result.status, plans=tuple(result.value), checks=checks
    )


def fly(
    *scripts: AnyPath,
    connect: str = "sim",
    vehicle: AnyPath | None = None,
    out: AnyPath = "runs",
    arm: bool = False,
    hide: Iterable[str] = (),
    seed: int = 1,
    progress: Tell | None = None,
    **options: Any,
) -> Flown:
    """Fly maneuver scripts and record them; nothing is fitted.

    connect: URL of the vehicle; 'sim' is the built-in one. A real vehicle flies only with arm=True: set it when
    the area is clear and a pilot is ready. hide: effects concealed in the built-in vehicle, as 'ground_effect:R2_m2=0.1'. options:
    further fields of `pipeline.flights.run.FlightRequest`. LinkError, PreflightError; how a flight ended is an outcome, not an error.
    """
    from flighttest.api.answers import Flown
    from flighttest.pipeline.flights import run as flights

    request = flights.FlightRequest(
        tuple(str(script) for script in scripts), vehicle=as_path(vehicle), connect=connect, out=Path(out), hide=tuple(hide), seed=seed,
        fly_only=True, **options,
    )  # fmt: skip
    result = flights.run(flight_request(request, arm), Stages(progress))
    folders = tuple(Path(run) for run in result.data["runs"])
    return Flown(
        document=result.document, data=result.data, status=result.status, runs=folders, flights=tuple(result.value)
    )


def flight_request(request: FlightRequest, arm: bool) -> FlightRequest:
    """The request, with what a run that it resumes was flown with. InputError for a real vehicle that may not arm."""
    from flighttest.pipeline.flights import run as flights

    request = flights.as_before(request)
    if flights.needs_consent(request) and not arm:
        raise InputError(f"{request.connect} may be a real vehicle, which would arm and take off", "give arm=True")
    return request


def simulate(
    airframe: Literal["paper", "rotor"] = "paper",
    *,
    model: FittedModel | AnyPath | None = None,
    hide: Mapping[str, Mapping[str, float]] | None = None,
    seed: int = 1,
    speed: float = 20.0,
    port: int = 0,
    lockstep: bool = True,
    **options: Any,
) -> Simulation:
    """A MAVLink copter on this machine, for tests of whatever talks to one: `with ft.simulate() as vehicle: connect(vehicle.url)`.

    airframe: 'paper' (the paper's model) or 'rotor' (rotor-level first principles). model: an identified model flies instead. hide:
    concealed physics, catalogue id to its values.
    speed: times real time; port: 0 takes any free one; lockstep: deterministic for a seed, time stands still until the client grants some.
    options: further fields of `sim.SimOptions`. It ends with the block, or with this process. InputError for options that cannot be.
    """
    from flighttest.sim import SimOptions, start_simulator

    if model is not None:
        from flighttest.api.fitted_model import fitted_model
        from flighttest.twin.vehicle import options_of

        twin = options_of(fitted_model(model).stored, hide, seed=seed, speed=speed, lockstep=lockstep, **options)
        return start_simulator(twin, port=port)
    made = SimOptions(airframe=airframe, hide=hide or {}, seed=seed, speed=speed, lockstep=lockstep, **options)
    return start_simulator(made, port=port)
