"""Commands that work on fitted models: validate, accept, models, status, compare, export."""

from __future__ import annotations

from pathlib import Path
from typing import TypedDict, Unpack

import click

import flighttest as ft
from flighttest.cli.base import ANY, FILE, FOLDER, Context, command
from flighttest.cli.live import LiveProgress
from flighttest.cli.words import seconds


class _StatusOptions(TypedDict):
    vehicle: Path | None
    model: Path | None
    connect: str | None
    columns: Path | None
    output: Path | None


@command("validate")
@click.argument("paths", nargs=-1, required=True, type=ANY, metavar="[MODEL] RUN...")
@click.option("--previous", type=ANY, metavar="MODEL", help="An earlier model to stand beside.")
@click.option("-o", "--output", type=FILE, metavar="HTML", help="Also write the comparison as an HTML page.")
@click.option("--columns", type=FILE, help="Column map (columns/1) for foreign tables.")
@click.option(
    "--horizons",
    metavar="S,S,...",
    help="Seconds after each start at which errors are taken (0.01,0.1,0.5,1); --json has them all.",
)
@click.option(
    "--out", type=FOLDER, help="Where the vehicle's model is.  [default: the folder of the first RUN, else runs]"
)
def validate(
    context: Context,
    paths: tuple[Path, ...],
    previous: Path | None,
    output: Path | None,
    columns: Path | None,
    horizons: str | None,
    out: Path | None,
) -> int:
    """Compare the model and its simplifications with a free flight (paper, section 4).

    MODEL is a model file, or the first of several folders where it holds a model. Without one the model in use of the recorded vehicle is
    taken.
    """
    with LiveProgress(context.show) as progress:
        answer = ft.validate(
            None,
            *paths,
            previous=previous,
            horizons_s=seconds(horizons),
            output=output,
            columns=columns,
            runs=out,
            progress=progress,
        )
    return context.finish(answer)


@command("accept")
@click.argument("folder", type=ANY, metavar="DIR")
@click.option("--vehicle", type=FILE, help="vehicle.yaml, where the model holds no name of its vehicle.")
@click.option("--out", type=FOLDER, default=Path("runs"), show_default=True, help="Where accepted models are kept.")
def accept(context: Context, folder: Path, vehicle: Path | None, out: Path) -> int:
    """Make the model of a run or diagnosis folder, or a model file, its vehicle's model in use."""
    return context.finish(ft.accept(folder, vehicle=vehicle, runs=out))


@command("models")
@click.argument("folder", type=FOLDER, default=Path("runs"), metavar="[DIR]")
def models(context: Context, folder: Path) -> int:
    """The vehicles' models: which flights, which terms joined when, which change ended each."""
    return context.finish(ft.models(folder))


@command("status")
@click.argument("runs", nargs=-1, type=ANY, metavar="[RUN...]")
@click.option("--vehicle", type=FILE, help="vehicle.yaml as the vehicle is today.")
@click.option("--model", type=ANY, help="The stored model; otherwise the vehicle's model in use.")
@click.option(
    "--connect", metavar="URL", help="Read the vehicle's firmware and parameters as they are now; nothing is set."
)
@click.option("--columns", type=FILE, help="Column map (columns/1) for foreign tables.")
@click.option("--out", type=FOLDER, default=Path("runs"), show_default=True, help="Where run folders and models are.")
@click.option("-o", "--output", type=FOLDER, metavar="DIR", help="Folder for status.html and the scripts to fly.")
def status(context: Context, runs: tuple[Path, ...], out: Path, **options: Unpack[_StatusOptions]) -> int:
    """Current, stale or unknown: whether the model is still valid for this vehicle, and what to fly again."""
    with LiveProgress(context.show) as progress:
        answer = ft.check_validity(*runs, runs=out, progress=progress, **options)
    return context.finish(answer)


@command("compare")
@click.argument("first", type=ANY)
@click.argument("second", type=ANY)
def compare(context: Context, first: Path, second: Path) -> int:
    """Compare two models or two runs: z-scores per parameter, and which differ."""
    with LiveProgress(context.show) as progress:
        answer = ft.compare(first, second, progress=progress)
    return context.finish(answer)


@command("export")
@click.argument("model", type=ANY, required=False)
@click.option("--to", "kind", type=click.Choice(["casadi", "c", "json", "fmu", "rotorpy", "ardupilot"]), required=True)
@click.option("-o", "--output", type=FOLDER, default=Path("export"), show_default=True, metavar="DIR")
@click.option("--vehicle", type=FILE, help="vehicle.yaml of the vehicle whose model in use is meant.")
@click.option("--out", type=FOLDER, default=Path("runs"), show_default=True, help="Where the vehicle's model is.")
def export(context: Context, model: Path | None, kind: str, output: Path, vehicle: Path | None, out: Path) -> int:
    """Write the model for other programs: CasADi functions, C99, a description in JSON, an FMU (FMI 2.0), RotorPy, or
    ArduPilot's SITL (frame and parameters).

    MODEL is a model file or a folder that holds one; without it the vehicle's model in use is taken.
    """
    return context.finish(ft.export(model, kind, output, vehicle=vehicle, runs=out))


COMMANDS: tuple[click.Command, ...] = (validate, accept, models, status, compare, export)
