"""Commands that work on recordings: import, show, segment, fit, diagnose, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

import flighttest as ft
from flighttest.cli import completion
from flighttest.cli.base import ANY, FILE, FOLDER, Context, command
from flighttest.cli.live import LiveProgress
from flighttest.cli.words import held, ties, weather_by_part

if TYPE_CHECKING:
    from flighttest.api.inputs import DiagnoseOptions, FitOptions

    class _DiagnoseOptions(DiagnoseOptions):
        columns: Path | None


RUNS = click.argument("runs", nargs=-1, required=True, type=ANY, metavar="RUN...")
COLUMNS = click.option("--columns", type=FILE, help="Column map (columns/1) for foreign tables.")


@command("import")
@click.argument("log", type=ANY)
@COLUMNS
@click.option("-o", "--output", type=FOLDER, required=True, metavar="RUN", help="Run folder to write.")
@click.option("--vehicle", type=FILE, help="vehicle.yaml whose components and zone join the recording.")
def import_(context: Context, log: Path, columns: Path | None, output: Path, vehicle: Path | None) -> int:
    """Bring a log into a run folder: .BIN, .log, .tlog, .ulg, .csv, .parquet, .mat or .mcap."""
    with LiveProgress(context.show) as progress:
        answer = ft.import_log(log, output, columns=columns, vehicle=vehicle, progress=progress)
    return context.finish(answer)


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
    """One page about a log or run before anything is fitted: health, channels, map, and what can be identified from it."""
    with LiveProgress(context.show) as progress:
        answer = ft.show(log, output, columns=columns, progress=progress)
    return context.finish(answer)


WEATHER = click.option(
    "--weather",
    multiple=True,
    metavar="[FLIGHT=]still",
    callback=lambda context, option, words: weather_by_part(words),
    help="Flights in still air: a prior for the wind of each flight.",
)


@command("segment")
@RUNS
@COLUMNS
def segment(context: Context, runs: tuple[Path, ...], columns: Path | None) -> int:
    """Cut recordings into step responses: each accepted, or rejected with its reason."""
    with LiveProgress(context.show) as progress:
        answer = ft.segment(*runs, columns=columns, progress=progress)
    return context.finish(answer)


@command("fit")
@RUNS
@click.option("-o", "--output", type=FILE, metavar="MODEL", help="model.yaml to write.")
@COLUMNS
@click.option("--vehicle", type=FILE, help="vehicle.yaml: nominal voltage and components.")
@click.option(
    "--term",
    "terms",
    multiple=True,
    metavar="ID",
    shell_complete=completion.term,
    help="Terms beside body and linear_drag (see `terms`).",
)
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
    columns: Path | None,
    vehicle: Path | None,
    freeze: tuple[str, ...],
    tie: tuple[str, ...],
    **options: Unpack[FitOptions],
) -> int:
    """Estimate the model's parameters from one or several recordings, jointly."""
    held_at, tied = held(freeze), ties(tie)
    with LiveProgress(context.show) as progress:
        answer = ft.fit(*runs, vehicle=vehicle, freeze=held_at, tie=tied, columns=columns, progress=progress, **options)
    return context.finish(answer)


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
    help="A simulator's recordings of the same vehicle: find what the simulator lacks, or has with another value.",
)
def diagnose(
    context: Context,
    runs: tuple[Path, ...],
    simulated: tuple[Path, ...],
    model: Path | None,
    output: Path | None,
    vehicle: Path | None,
    **options: Unpack[_DiagnoseOptions],
) -> int:
    """Find where simulation and recordings differ, what physics was left out, and what to fly next."""
    with LiveProgress(context.show) as progress:
        answer: ft.Answer
        if simulated:
            answer = ft.against(
                runs, simulated, model=model, vehicle=vehicle, output=output, columns=options["columns"], progress=progress,
                weather=options["weather"], workers=options["workers"],
            )  # fmt: skip
        else:
            answer = ft.diagnose(*runs, model=model, vehicle=vehicle, output=output, progress=progress, **options)
    return context.finish(answer)


@command("report")
@click.argument("folder", type=ANY, metavar="RUN|DIR")
@click.option("-o", "--output", type=FILE, metavar="HTML", help="File to write; otherwise report.html in the folder.")
@click.option(
    "--figures", type=FOLDER, metavar="DIR", help="Also write every figure as SVG, PNG and CSV (its numbers)."
)
def report(context: Context, folder: Path, output: Path | None, figures: Path | None) -> int:
    """Write one self-contained HTML page about a run, or about what `diagnose -o` wrote."""
    with LiveProgress(context.show) as progress:
        answer = ft.report(folder, output, figures=figures, progress=progress)
    return context.finish(answer)


COMMANDS: tuple[click.Command, ...] = (import_, show, segment, fit, diagnose, report)
