"""The command about an identified model as a vehicle: twin."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypedDict, Unpack

import click

import flighttest as ft
from flighttest.cli.base import ANY, FILE, FOLDER, Context, command
from flighttest.cli.live import LiveProgress


class _TwinOptions(TypedDict):
    offline: bool
    backend: Literal["builtin", "sitl"]
    seed: int
    columns: Path | None
    output: Path | None


@command("twin")
@click.argument("model", type=ANY)
@click.option(
    "--verify",
    "verified",
    multiple=True,
    type=ANY,
    metavar="RUN...",
    help="Fly the scripts of these runs on the twin and report what still differs.",
)
@click.option(
    "--replay",
    "replayed",
    multiple=True,
    type=ANY,
    metavar="RUN...",
    help="Run the recorded commands on the twin, beside the recording; --set changes its values.",
)
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE...",
    help="With --replay: payload=KG, battery=V (or +V, -V), propeller=RATIO, or a parameter: K=+10%, w_north=3.",
)
@click.option("--offline", is_flag=True, help="With --verify: recorded commands alone, nothing is flown.")
@click.option(
    "--backend",
    type=click.Choice(("builtin", "sitl")),
    default="builtin",
    show_default=True,
    help="With --verify: behind the built-in autopilot, or under the real ArduCopter.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the twin's noise.")
@click.option("--columns", type=FILE, help="Column map (columns/1) for foreign tables.")
@click.option("-o", "--output", type=FOLDER, metavar="DIR", help="Folder for the twin's flights and report.html.")
def twin(
    context: Context,
    model: Path,
    verified: tuple[Path, ...],
    replayed: tuple[Path, ...],
    changes: tuple[str, ...],
    **options: Unpack[_TwinOptions],
) -> int:
    """The twin, an identified model as a vehicle: compare it with recordings, or ask what if.

    `flighttest sim --model MODEL` lets it fly for any ground station.
    """
    if bool(verified) == bool(replayed):
        raise click.UsageError("give either --verify RUN... or --replay RUN...")
    if options["backend"] == "sitl" and replayed:
        raise click.UsageError("--backend works with --verify only: --replay flies nothing")
    if changes and not replayed:
        raise click.UsageError("--set works with --replay only")
    with LiveProgress(context.show) as progress:
        answer: ft.Answer
        if replayed:
            answer = ft.replay(
                model,
                *replayed,
                changes=changes,
                output=options["output"],
                columns=options["columns"],
                progress=progress,
            )
        else:
            answer = ft.twin(model, *verified, progress=progress, **options)
    return context.finish(answer)


COMMANDS: tuple[click.Command, ...] = (twin,)
