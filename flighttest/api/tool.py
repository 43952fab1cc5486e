"""The verbs about runs and about the tool: a whole campaign, logs brought in, runs listed, pages written, checks, demonstration, proof.

Each calls the step of `pipeline` that the command of the same name calls, as those in `verbs` do.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from flighttest.api.verbs import AnyPath, Stages, Tell, as_path, flight_request, model_of

if TYPE_CHECKING:
    from flighttest.api.campaigns import Campaign, Checks, Demonstrated, Imported, Proved, Runs


def run(
    *scripts: AnyPath,
    connect: str = "sim",
    vehicle: AnyPath | None = None,
    out: AnyPath = "runs",
    arm: bool = False,
    hide: Iterable[str] = (),
    seed: int = 1,
    progress: Tell | None = None,
    **options: Any,
) -> Campaign:
    """Fly maneuver scripts, record, cut, fit, compare with the vehicle's model in use, diagnose and report.

    As `fly`, which stops after recording. options: further fields of `pipeline.flights.run.FlightRequest`, as accept=True.
    """
    from flighttest.api.campaigns import Campaign
    from flighttest.identify.models import model_file
    from flighttest.pipeline.flights import run as flights
    from flighttest.pipeline.flights.after_landing import Analysis

    request = flights.FlightRequest(
        tuple(str(script) for script in scripts), vehicle=as_path(vehicle), connect=connect, out=Path(out), hide=tuple(hide), seed=seed,
        **options,
    )  # fmt: skip
    result = flights.run(flight_request(request, arm), Stages(progress))
    found = result.value if isinstance(result.value, Analysis) else None
    fitted = None if found is None else found.improved or found.fit
    model = None if fitted is None else model_of(fitted, model_file.as_data(fitted))
    folders = tuple(Path(folder) for folder in result.data["runs"])
    return Campaign(
        document=result.document, data=result.data, status=result.status, runs=folders, analysis=found, model=model
    )


def import_log(
    log: AnyPath,
    output: AnyPath,
    *,
    columns: AnyPath | None = None,
    vehicle: AnyPath | None = None,
    progress: Tell | None = None,
) -> Imported:
    """Bring a log into a run folder: .BIN, .tlog, .ulg, .csv or .parquet. vehicle: vehicle.yaml whose components and zone join it.

    InputError where the folder holds something else already.
    """
    from flighttest.api.campaigns import Imported
    from flighttest.pipeline.recordings.sources import import_log as bring

    result = bring(Path(log), Path(output), as_path(columns), as_path(vehicle), Stages(progress))
    return Imported(
        document=result.document, data=result.data, status=result.status, run=Path(output), recording=result.value
    )


def fetch_log(connect: str, output: AnyPath, *, number: int | None = None, progress: Tell | None = None) -> Path:
    """Download an onboard log over MAVLink, the newest where no number is given, into a run folder or a .bin file; gives the log's path."""
    from flighttest.pipeline.flights.fetching import fetch_log as fetch

    return Path(fetch(connect, Path(output), number, Stages(progress)).data["file"])


def runs(folder: AnyPath = "runs", *, page: bool = False) -> Runs:
    """The runs in a folder, oldest first: when, which script and vehicle, how they ended, what was fitted. page: write history.html."""
    from flighttest.api.campaigns import Runs
    from flighttest.pipeline.store.table import history

    result = history(Path(folder), page=page)
    return Runs(document=result.document, data=result.data, status=result.status)


def report(folder: AnyPath, output: AnyPath | None = None, *, progress: Tell | None = None) -> Path:
    """Write one self-contained HTML page about a run, a log, or what `diagnose(output=...)` wrote; gives the page's path."""
    from flighttest.pipeline.identification.reporting import report as write

    return Path(write(Path(folder), as_path(output), Stages(progress)).data["report"])


def show(
    log: AnyPath, output: AnyPath | None = None, *, columns: AnyPath | None = None, progress: Tell | None = None
) -> Path:
    """Write one HTML page about a log or run before anything is fitted: health, course, channels, map, what it can tell; gives its path."""
    from flighttest.pipeline.identification.showing import show as write

    return Path(write(Path(log), as_path(output), as_path(columns), Stages(progress)).data["page"])


def sign(connect: str, key: AnyPath, *, remove: bool = False, progress: Tell | None = None) -> str:
    """Give a vehicle the key in a file (made where there is none): from then on it takes only frames signed with it; gives a sentence.

    remove: take it away again. The key crosses the link in the clear: use a cable. LinkError where the vehicle does not take it.
    """
    from flighttest.pipeline.vehicles.signing import sign as give

    return give(connect, Path(key), remove, Stages(progress)).document.verdict


def doctor(connect: str | None = None) -> Checks:
    """What is installed and reachable, and what to do about what is not. connect: URL of a vehicle to try as well; nothing is set."""
    from flighttest.api.campaigns import Checks
    from flighttest.pipeline.info import doctor as look

    result = look(connect)
    return Checks(document=result.document, data=result.data, status=result.status)


def demo(
    out: AnyPath = "demo",
    *,
    hide: Iterable[str] = (),
    seed: int = 1,
    airframe: Literal["paper", "rotor"] = "rotor",
    progress: Tell | None = None,
) -> Demonstrated:
    """A simulated vehicle conceals an effect (a slung load where none is given): find it, model it, and predict a flight that was not used.

    out: new folder for the page and the runs. FitError where the flights were of no use.
    """
    from flighttest.api.campaigns import Demonstrated
    from flighttest.errors import FitError
    from flighttest.pipeline import demo as workflow

    request = workflow.DemoRequest(Path(out), seed, tuple(hide) or workflow.HIDE, airframe)
    result = workflow.demo(request, Stages(progress))
    if result.data.get("format") != "demo/1":
        raise FitError(result.document.verdict, "see the report in its run folder")
    page = Path(result.data["report"])
    return Demonstrated(document=result.document, data=result.data, status=result.status, page=page)


def prove(
    trials: int = 20,
    *,
    seed: int | None = None,
    workers: int = 1,
    output: AnyPath | None = None,
    progress: Tell | None = None,
    **options: Any,
) -> Proved:
    """Hide effects in simulated flights, diagnose them blind, and count what was found.

    output: folder for the truths and the scoreboard. options: further fields of `proof.prove.Asked`, as kind="clean".
    """
    from flighttest.api.campaigns import Proved
    from flighttest.proof.prove import Asked
    from flighttest.proof.proving import prove as proof

    result = proof(Asked(trials, seed, workers=workers, **options), as_path(output), Stages(progress))
    return Proved(document=result.document, data=result.data, status=result.status, outcomes=tuple(result.value))
