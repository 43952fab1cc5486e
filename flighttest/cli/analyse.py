"""Commands that work on recordings: import, show, segment, fit, diagnose, report."""

from __future__ import annotations

from pathlib import Path

import click

from flighttest.cli.base import ANY, FILE, FOLDER, Context, command
from flighttest.cli.live import LiveProgress
from flighttest.cli.words import held, ties
from flighttest.pipeline.results import check_writable

RUNS = click.argument("runs", nargs=-1, required=True, type=ANY, metavar="RUN...")
COLUMNS = click.option("--columns", type=FILE, help="Column map (columns/1) for foreign tables.")


@command("import")
@click.argument("log", type=ANY)
@COLUMNS
@click.option("-o", "--output", type=FOLDER, required=True, metavar="RUN", help="Run folder to write.")
@click.option("--vehicle", type=FILE, help="vehicle.yaml whose components and zone join the recording.")
def import_(context: Context, log: Path, columns: Path | None, output: Path, vehicle: Path | None) -> int:
    """Bring a log into a run folder: .BIN, .tlog, .ulg, .csv, .parquet, .mat or .mcap."""
    from flighttest.pipeline.recordings import sources

    with LiveProgress(context.show) as progress:
        result = sources.import_log(log, output, columns, vehicle, progress)
    return context.finish(result)


@command("show")
@click.argument("log", type=ANY)
@COLUMNS
@click.option(
    "-o",
    "--output",
    type=FILE,
    metavar="HTML",
    help="Page to write; otherwise show.html in the run, or LOG-show.html here.",
)
def show(context: Context, log: Path, columns: Path | None, output: Path | None) -> int:
    """One page about a log or run before anything is fitted: health, course, channels, map, what it can tell."""
    from flighttest.pipeline.identification import showing

    with LiveProgress(context.show) as progress:
        result = showing.show(log, output, columns, progress)
    return context.finish(result)


WEATHER = click.option(
    "--weather",
    multiple=True,
    metavar="[FLIGHT=]still",
    help="Flights in still air: a prior for the wind of each flight.",
)


@command("segment")
@RUNS
@COLUMNS
def segment(context: Context, runs: tuple[Path, ...], columns: Path | None) -> int:
    """Cut recordings into step responses: each accepted, or rejected with its reason."""
    from flighttest.pipeline.identification import fitting as analysis

    with LiveProgress(context.show) as progress:
        result = analysis.segment(runs, columns, progress)
    return context.finish(result)


@command("fit")
@RUNS
@click.option("-o", "--output", type=FILE, metavar="MODEL", help="model.yaml to write.")
@COLUMNS
@click.option("--vehicle", type=FILE, help="vehicle.yaml: nominal voltage and components.")
@click.option("--term", "terms", multiple=True, metavar="ID", help="Terms beside body and linear_drag (see `terms`).")
@click.option(
    "--freeze", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at a value; T_d holds every delay."
)
@click.option("--tie", multiple=True, metavar="A=B", help="Tie a parameter to another (omega_theta=omega_phi).")
@WEATHER
@click.option(
    "--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes for reading recordings."
)
@click.option("--scheduler", metavar="URL", help="An existing Dask cluster, tcp://...")
def fit(
    context: Context,
    runs: tuple[Path, ...],
    output: Path | None,
    columns: Path | None,
    vehicle: Path | None,
    terms: tuple[str, ...],
    freeze: tuple[str, ...],
    tie: tuple[str, ...],
    weather: tuple[str, ...],
    workers: int,
    scheduler: str | None,
) -> int:
    """Estimate the model's parameters from one or several recordings, jointly."""
    from flighttest.pipeline.identification import fitting as analysis

    options = analysis.FitOptions(
        terms=terms, freeze=held(freeze), tie=ties(tie), weather=weather, workers=workers, scheduler=scheduler
    )
    with LiveProgress(context.show) as progress:
        result = analysis.fit(runs, output, columns, vehicle, options, progress)
    return context.finish(result)


@command("diagnose")
@RUNS
@click.option("--model", type=ANY, help="Model to start from; otherwise one is fitted to the recordings.")
@click.option(
    "-o", "--output", type=FOLDER, metavar="DIR", help="Folder for diagnosis.json, model.yaml, report.html, next.yaml."
)
@COLUMNS
@click.option("--vehicle", type=FILE, help="vehicle.yaml: nominal voltage, components, weather.")
@WEATHER
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--accept", is_flag=True, help="Make the improved model the vehicle's (see `accept`).")
@click.option(
    "--against",
    "simulated",
    multiple=True,
    type=ANY,
    metavar="SIMULATED...",
    help="A simulator's recordings of the same vehicle: say what the simulator lacks, or has otherwise.",
)
def diagnose(
    context: Context,
    runs: tuple[Path, ...],
    model: Path | None,
    output: Path | None,
    columns: Path | None,
    vehicle: Path | None,
    weather: tuple[str, ...],
    workers: int,
    accept: bool,
    simulated: tuple[Path, ...],
) -> int:
    """Say where simulation and recordings differ, what physics was left out, and what to fly next."""
    from flighttest.pipeline.diagnosis import against
    from flighttest.pipeline.diagnosis import diagnose as diagnosis
    from flighttest.pipeline.recordings.sources import Reading

    reading = Reading(columns, workers, weather=weather)
    with LiveProgress(context.show) as progress:
        if simulated:
            result = against.against(runs, simulated, model, output, vehicle, reading, progress)
            return context.finish(result)
        result = diagnosis.diagnose(runs, model, output, vehicle, reading, progress, accept)
    return context.finish(result)


@command("report")
@click.argument("folder", type=ANY, metavar="RUN|DIR")
@click.option("-o", "--output", type=FILE, metavar="HTML", help="File to write; otherwise report.html in the folder.")
@click.option("--figures", type=FOLDER, metavar="DIR", help="Also write every picture as SVG with its numbers as CSV.")
def report(context: Context, folder: Path, output: Path | None, figures: Path | None) -> int:
    """Write one self-contained HTML page about a run, or about what `diagnose -o` wrote."""
    from flighttest.pipeline.identification import reporting
    from flighttest.report.render.figure_files import write_figures

    with LiveProgress(context.show) as progress:
        check_writable(figures)
        result = reporting.report(folder, output, progress)
        if figures is not None:
            written = write_figures(result.value, figures)
            progress.stage(f"{len(written) // 2} pictures written to {figures}")
    return context.finish(result)


COMMANDS: tuple[click.Command, ...] = (import_, show, segment, fit, diagnose, report)
