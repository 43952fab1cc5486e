"""Commands about the tool itself: prove, terms, runs, doctor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

import flighttest as ft
from flighttest.cli import completion
from flighttest.cli.base import FILE, FOLDER, Context, command
from flighttest.cli.live import LiveProgress

if TYPE_CHECKING:
    from flighttest.api.inputs import ProofOptions


@command("prove")
@click.option("--trials", type=click.IntRange(min=1), default=20, show_default=True)
@click.option("--generator", type=click.Choice(["rotor", "sitl", "recorded"]), default="rotor", show_default=True)
@click.option("--kind", type=click.Choice(["clean", "single", "pair", "outside", "natural"]), help="Only such trials.")
@click.option(
    "--clean", type=click.IntRange(min=0), default=0, help="Draw on until so many trials have nothing hidden."
)
@click.option(
    "--recordings",
    type=FILE,
    metavar="FILE",
    help="List of real flights (recordings/1): `recorded` adds effects to them, `rotor` takes the noise of half its trials from them.",
)
@click.option("--data", type=FOLDER, metavar="DIR", help="The folder that the listed files are in.")
@click.option("--seed", type=int, help="First seed; otherwise new ones are drawn and printed.")
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--scheduler", metavar="URL", help="An existing Dask cluster, tcp://...")
@click.option(
    "-o",
    "--output",
    type=FOLDER,
    metavar="DIR",
    help="Folder for the truths and the scoreboard; with its --seed a proof begun there is continued.",
)
def prove(
    context: Context,
    trials: int,
    seed: int | None,
    workers: int,
    output: Path | None,
    **options: Unpack[ProofOptions],
) -> int:
    """Hide effects in simulated flights, or add them to real ones, diagnose them blind, and print the scoreboard."""
    with LiveProgress(context.show) as progress:
        answer = ft.prove(trials, seed=seed, workers=workers, output=output, progress=progress, **options)
    return context.finish(answer)


@command("terms")
@click.argument("ids", nargs=-1, metavar="[ID...]", shell_complete=completion.term)
def terms(context: Context, ids: tuple[str, ...]) -> int:
    """The catalogue of physics: what each term is, what it hides in, and which maneuver shows it."""
    return context.finish(ft.terms.describe(*ids))


@command("runs")
@click.argument("folder", type=FOLDER, default=Path("runs"), metavar="[DIR]")
@click.option(
    "--html", is_flag=True, help="Also write history.html: each parameter over runs, with the changes marked."
)
def runs(context: Context, folder: Path, html: bool) -> int:
    """The runs on this machine: when, which script and vehicle, how they ended, what was fitted."""
    return context.finish(ft.runs(folder, page=html))


@command("doctor")
@click.option("--connect", metavar="URL", help="Also try to reach a vehicle.")
@click.option("--signing-key", type=FILE, metavar="FILE", help="Key of MAVLink 2 signing (see `sign`).")
def doctor(context: Context, connect: str | None, signing_key: Path | None) -> int:
    """What is installed and reachable, and what to do about what is not."""
    return context.finish(ft.doctor(connect, signing_key=signing_key))


COMMANDS: tuple[click.Command, ...] = (prove, terms, runs, doctor)
