"""The verbs about runs and about the tool: logs brought in, runs listed, pages and exports written, vehicles served, checks, demonstration,
proof.

Each calls the step of `pipeline` that the command of the same name calls, as those in `verbs` do.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack

from flighttest.api.inputs import (
    AnyPath,
    HiddenEffects,
    ProgressLike,
    ProofOptions,
    ServeOptions,
    as_hidden,
    as_model,
    as_path,
    as_progress,
    paths_in,
)
from flighttest.errors import InputError

if TYPE_CHECKING:
    from flighttest.api.answers import Answer, Written
    from flighttest.api.campaigns import Checks, Demonstrated, Imported, Proved, Runs
    from flighttest.api.fitted_model import FittedModel
    from flighttest.pipeline.results import Result
    from flighttest.pipeline.vehicles.simulator import Serving


def import_log(
    log: AnyPath,
    output: AnyPath,
    *,
    columns: AnyPath | None = None,
    vehicle: AnyPath | None = None,
    progress: ProgressLike | None = None,
) -> Imported:
    """Bring a log into a run folder: .BIN, .log, .tlog, .ulg, .csv or .parquet. vehicle: vehicle.yaml whose components and zone join it.

    InputError where the folder holds something else already.
    """
    from flighttest.api.campaigns import Imported
    from flighttest.pipeline.recordings.sources import import_log as bring

    result = bring(Path(log), Path(output), as_path(columns), as_path(vehicle), as_progress(progress))
    return Imported(
        document=result.document, data=result.data, status=result.status, run=Path(output), recording=result.value
    )


def fetch_log(
    connect: str,
    output: AnyPath,
    *,
    number: int | None = None,
    signing_key: AnyPath | None = None,
    progress: ProgressLike | None = None,
) -> Written:
    """Download an onboard log over MAVLink, the newest where no number is given, into a run folder or a .bin file.

    Given again after a cut, it goes on where it stopped. signing_key: file with the key of MAVLink 2 signing.
    """
    from flighttest.pipeline.flights.fetching import fetch_log as fetch

    result = fetch(connect, Path(output), number, as_progress(progress), as_path(signing_key))
    return _written(result, result.data["file"])


def runs(folder: AnyPath = "runs", *, page: bool = False) -> Runs:
    """The runs in a folder, oldest first: when, which script and vehicle, how they ended, what was fitted. page: write history.html."""
    from flighttest.api.campaigns import Runs
    from flighttest.pipeline.store.table import history

    result = history(Path(folder), page=page)
    return Runs(document=result.document, data=result.data, status=result.status)


def report(
    folder: AnyPath,
    output: AnyPath | None = None,
    *,
    figures: AnyPath | None = None,
    progress: ProgressLike | None = None,
) -> Written:
    """Write one self-contained HTML page about a run, a log, or what `diagnose(output=...)` wrote. figures: folder for every figure as SVG,
    PNG and CSV (its numbers)."""
    from flighttest.datafiles import check_writable
    from flighttest.pipeline.identification.reporting import report as write
    from flighttest.report.render.figure_files import write_figures

    check_writable(as_path(figures))
    words = as_progress(progress)
    result = write(Path(folder), as_path(output), words)
    files: tuple[Path, ...] = ()
    if figures is not None:
        written = write_figures(result.value, Path(figures))
        files = written.files
        words.stage(written.sentence(Path(figures)))
    return _written(result, result.data["report"], *files)


def show(
    log: AnyPath, output: AnyPath | None = None, *, columns: AnyPath | None = None, progress: ProgressLike | None = None
) -> Written:
    """Write one HTML page about a log or run before anything is fitted: health, course, channels, map, what it can determine."""
    from flighttest.pipeline.identification.showing import show as write

    result = write(Path(log), as_path(output), as_path(columns), as_progress(progress))
    return _written(result, result.data["page"])


def export(
    model: FittedModel | AnyPath | None,
    kind: str,
    output: AnyPath = "export",
    *,
    vehicle: AnyPath | None = None,
    runs: AnyPath = "runs",
) -> Written:
    """Write a model for other programs: 'casadi', 'c', 'json', 'fmu', 'rotorpy' or 'ardupilot', into a folder.

    model: with None the one in use in `runs` of the vehicle in vehicle.yaml. InputError for another kind.
    """
    from flighttest.pipeline.identification.exporting import KINDS
    from flighttest.pipeline.identification.exporting import export as write
    from flighttest.pipeline.store.models import named_or_in_use

    if kind not in KINDS:
        raise InputError(f"there is no export called {kind!r}", f"there are {', '.join(KINDS)}")
    chosen = named_or_in_use(None, Path(runs), as_path(vehicle)) if model is None else as_model(model)
    result = write(chosen, kind, Path(output))
    return _written(result, *result.data["files"])


def _written(result: Result, *files: AnyPath) -> Written:
    from flighttest.api.answers import Written

    paths = tuple(Path(file) for file in files)
    return Written(document=result.document, data=result.data, status=result.status, files=paths)


def serve(**options: Unpack[ServeOptions]) -> Iterator[str | Serving]:
    """A MAVLink copter on this machine for any ground station, until it is interrupted: the built-in one or ArduPilot's SITL.

    Yields sentences of what is going on and, once it can be connected to, where. options: `flighttest.api.inputs.ServeOptions`.
    For tests of one's own program, `simulate` is the vehicle as a context manager.
    """
    from flighttest.pipeline.vehicles import simulator

    return simulator.serve(
        simulator.Served(**paths_in(options, "model", "frame") | {"hide": as_hidden(options.get("hide", ()))})
    )


def sign(connect: str, key: AnyPath, *, remove: bool = False, progress: ProgressLike | None = None) -> Answer:
    """Give a vehicle the key in a file (made where there is none): from then on it takes only frames signed with it.

    remove: take it away again. The key crosses the link in the clear: use a cable. LinkError where the vehicle does not take it.
    """
    from flighttest.api.answers import Answer
    from flighttest.pipeline.vehicles.signing import sign as give

    result = give(connect, Path(key), remove, as_progress(progress))
    return Answer(document=result.document, data=result.data, status=result.status)


def doctor(connect: str | None = None, *, signing_key: AnyPath | None = None) -> Checks:
    """What is installed and reachable, and what to do about what is not. connect: URL of a vehicle to try as well; nothing is set.

    signing_key: file with the key of MAVLink 2 signing.
    """
    from flighttest.api.campaigns import Checks
    from flighttest.pipeline.info import doctor as look

    result = look(connect, as_path(signing_key))
    return Checks(document=result.document, data=result.data, status=result.status)


def demo(
    output: AnyPath = "demo",
    *,
    hide: HiddenEffects = (),
    seed: int = 1,
    airframe: Literal["paper", "rotor"] = "rotor",
    progress: ProgressLike | None = None,
) -> Demonstrated:
    """A simulated vehicle conceals an effect (a slung load where none is given): find it, model it, and predict a flight that was not used.

    output: new folder for the page and the runs.
    """
    from flighttest.api.campaigns import Demonstrated
    from flighttest.pipeline import demo as workflow

    request = workflow.DemoRequest(Path(output), seed, as_hidden(hide) or workflow.HIDE, airframe)
    result = workflow.demo(request, as_progress(progress))
    page = Path(result.data["report"])
    return Demonstrated(document=result.document, data=result.data, status=result.status, page=page)


def prove(
    trials: int = 20,
    *,
    seed: int | None = None,
    workers: int = 1,
    output: AnyPath | None = None,
    progress: ProgressLike | None = None,
    **options: Unpack[ProofOptions],
) -> Proved:
    """Hide effects in simulated flights, or add them to real ones, diagnose them blind, and count what was found.

    output: folder for the truths and the scoreboard. options: `flighttest.api.inputs.ProofOptions`, as
    kind="clean".
    """
    from flighttest.api.campaigns import Proved
    from flighttest.proof.prove import ProofRequest
    from flighttest.proof.proving import prove as proof

    request = ProofRequest(trials, seed, workers=workers, **paths_in(options, "recordings", "data"))
    result = proof(request, as_path(output), as_progress(progress))
    return Proved(document=result.document, data=result.data, status=result.status, outcomes=tuple(result.value))
