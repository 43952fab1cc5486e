"""Commands that work on fitted models: validate, status, compare, export."""

from __future__ import annotations

from pathlib import Path

import click

from flighttest.cli.base import ANY, FILE, FOLDER, Context, command
from flighttest.cli.live import LiveProgress


@command("validate")
@click.argument("model", type=FILE)
@click.argument("runs", nargs=-1, required=True, type=ANY, metavar="RUN")
@click.option("--previous", type=FILE, metavar="MODEL", help="An earlier model to stand beside.")
@click.option("-o", "--output", type=FILE, metavar="HTML", help="Also write the comparison as an HTML page.")
@click.option("--columns", type=FILE, help="Column map (columns/1) for foreign tables.")
def validate(
    context: Context,
    model: Path,
    runs: tuple[Path, ...],
    previous: Path | None,
    output: Path | None,
    columns: Path | None,
) -> int:
    """Compare the model and its simplifications with a free flight (paper, section 4)."""
    from flighttest.pipeline import validation

    with LiveProgress(context.show) as progress:
        result = validation.validate(model, runs, previous, output, columns, progress)
    return context.finish(result)


@command("status")
@click.argument("runs", nargs=-1, type=ANY, metavar="[RUN...]")
@click.option("--vehicle", type=FILE, help="vehicle.yaml as the vehicle is today.")
@click.option("--model", type=FILE, help="The stored model; otherwise the last one in --out.")
@click.option(
    "--connect", metavar="URL", help="Read the vehicle's firmware and parameters as they are now; nothing is set."
)
@click.option("--out", type=FOLDER, default=Path("runs"), show_default=True, help="Where run folders and models are.")
@click.option("-o", "--output", type=FOLDER, metavar="DIR", help="Folder for status.html and the scripts to fly.")
def status(
    context: Context,
    runs: tuple[Path, ...],
    vehicle: Path | None,
    model: Path | None,
    connect: str | None,
    out: Path,
    output: Path | None,
) -> int:
    """Current, stale or unknown: does the model still hold for this vehicle, and what must be flown again."""
    from flighttest.pipeline import keeping

    with LiveProgress(context.show) as progress:
        result = keeping.status(runs, vehicle, model, out, output, progress, connect)
    return context.finish(result)


@command("compare")
@click.argument("first", type=ANY)
@click.argument("second", type=ANY)
def compare(context: Context, first: Path, second: Path) -> int:
    """Compare two models or two runs: z-scores per parameter, and which differ."""
    from flighttest.pipeline import keeping

    with LiveProgress(context.show) as progress:
        result = keeping.compare(first, second, progress)
    return context.finish(result)


@command("export")
@click.argument("model", type=FILE)
@click.option("--to", "kind", type=click.Choice(["casadi", "c", "json"]), required=True)
@click.option("-o", "--output", type=FOLDER, default=Path("export"), show_default=True, metavar="DIR")
def export(context: Context, model: Path, kind: str, output: Path) -> int:
    """Write the model for other programs: CasADi functions, C99, or a description in JSON."""
    from flighttest.pipeline import keeping

    return context.finish(keeping.export(model, kind, output))


COMMANDS: tuple[click.Command, ...] = (validate, status, compare, export)
