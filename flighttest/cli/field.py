"""Commands that fly, or rehearse flying: check, run, sim, fetch-log."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack

import click

import flighttest as ft
from flighttest.api.flights import flight
from flighttest.cli import completion
from flighttest.cli.base import ANY, FILE, FOLDER, Context, command
from flighttest.cli.live import LiveProgress

if TYPE_CHECKING:
    from flighttest.api.inputs import CampaignOptions, ServeOptions

    class _RunOptions(CampaignOptions):
        connect: str | None
        vehicle: Path | None
        hide: tuple[str, ...]
        seed: int


@command("check")
@click.argument("scripts", nargs=-1, required=True, metavar="SCRIPT...", shell_complete=completion.maneuver)
@click.option("--vehicle", type=FILE, help="vehicle.yaml: flight zone, hover throttle, nominal voltage.")
@click.option("--model", type=ANY, help="Prior model flown through the script; otherwise the vehicle's accepted one.")
@click.option("--out", type=FOLDER, default=Path("runs"), show_default=True, help="Where accepted models are.")
@click.option("-v", "--verbose", is_flag=True, help="Print the phases of every leg.")
def check(
    context: Context, scripts: tuple[str, ...], vehicle: Path | None, model: Path | None, out: Path, verbose: bool
) -> int:
    """Compile scripts without a vehicle: plan, duration, battery, predicted envelope against the zone."""
    return context.finish(ft.plan(*scripts, vehicle=vehicle, model=model, runs=out, phases=verbose))


@command("run")
@click.argument("scripts", nargs=-1, metavar="SCRIPT...", shell_complete=completion.maneuver)
@click.option("--vehicle", type=FILE, help="vehicle.yaml; without it the built-in simulated copter flies.")
@click.option(
    "--connect",
    metavar="URL",
    help="udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:/dev/ttyX:BAUD or sim.",
)
@click.option("--out", type=FOLDER, default=Path("runs"), show_default=True, help="Where run folders go.")
@click.option(
    "--speed", type=click.FloatRange(min=0, min_open=True), help="Speed of the simulated vehicle, times real time."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the built-in vehicle.")
@click.option(
    "--airframe",
    type=click.Choice(["paper", "rotor"]),
    default="paper",
    show_default=True,
    help="The built-in vehicle.",
)
@click.option(
    "--hide",
    multiple=True,
    metavar="ID:key=value",
    shell_complete=completion.term,
    help="Hide an effect in the built-in vehicle.",
)
@click.option("--model", type=ANY, help="Model to compare with; otherwise the vehicle's model in use.")
@click.option("--accept", is_flag=True, help="Make the improved model the vehicle's (see `accept`).")
@click.option("--only", type=click.Choice(["fly", "fit"]), help="Stop after recording, or after the fit.")
@click.option("--resume", type=FOLDER, metavar="RUN", help="Fly what is missing in an interrupted run.")
@click.option("--set-params", is_flag=True, help="Set what the preflight asks for and restore it afterwards.")
@click.option("--waive", multiple=True, metavar="CHECK", help="Waive one preflight check by name.")
@click.option("--extend-fence", is_flag=True, help="Add the zone's polygon to a fence of the vehicle, for the flight.")
@click.option("--weather", default="", metavar="TEXT", help="Kept with the run: wind, temperature, pressure.")
@click.option("--signing-key", type=FILE, metavar="FILE", help="Key of MAVLink 2 signing (see `sign`).")
@click.option("--sysid", type=click.IntRange(1, 255), help="Our own MAVLink system id, where 245 is somebody else's.")
@click.option(
    "--view",
    type=click.Choice(["normal", "large"]),
    default="normal",
    show_default=True,
    help="The live picture; large is read from two metres and in the sun.",
)
@click.option("--yes", is_flag=True, help="Do not ask before arming.")
def run(
    context: Context, scripts: tuple[str, ...], out: Path, view: str, yes: bool, **options: Unpack[_RunOptions]
) -> int:
    """Fly maneuver scripts, record, cut, fit, diagnose and report.

    SCRIPT is a path or the name of a shipped maneuver. Without --vehicle or --connect it flies the built-in simulated
    copter; it never reaches for a real vehicle by default.
    """
    if not scripts and options["resume"] is None:
        raise click.UsageError("nothing to fly: name a SCRIPT, or a run with --resume")
    asked = flight(*scripts, runs=out, **options)
    context.show.say(asked.sentence)
    if not yes and asked.real and not sys.stdin.isatty():
        raise click.UsageError("a real vehicle arms only after a yes: answer at a terminal, or give --yes")
    with LiveProgress(context.show, view=view, keep=True) as progress:
        answer = asked.fly(yes or progress.ask, progress)
    return context.finish(answer)


@command("sim")
@click.option("--airframe", type=click.Choice(["paper", "rotor"]), default="paper", show_default=True)
@click.option("--backend", type=click.Choice(["builtin", "sitl"]), default="builtin", show_default=True)
@click.option("--hide", multiple=True, metavar="ID:key=value", help="Hide an effect, e.g. ground_effect:R2_m2=0.1.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=5760, show_default=True, help="TCP port; 0 takes a free one."
)
@click.option(
    "--speed", type=click.FloatRange(min=0, min_open=True), default=1.0, show_default=True, help="Times real time."
)
@click.option("--lockstep", is_flag=True, help="Wait for the client's clock (deterministic for a seed).")
@click.option("--model", type=ANY, help="Fly this identified model, its twin, instead of an airframe.")
@click.option(
    "--frame", type=FOLDER, metavar="DIR", help="With --backend sitl: fly what `export --to ardupilot` wrote."
)
def sim(context: Context, **options: Unpack[ServeOptions]) -> int:
    """A MAVLink copter on this machine, for any ground station. Ctrl-C stops it."""
    for step in ft.serve(**options):
        if isinstance(step, str):
            context.show.say(step)
            continue
        context.show.line(step.data())
        for sentence in step.sentences:
            context.show.say(sentence)
    return 0


@command("fetch-log")
@click.option("--connect", metavar="URL", required=True, help="The vehicle.")
@click.option(
    "-o", "--output", "output", type=ANY, required=True, metavar="RUN", help="Run folder (or .bin file) to write."
)
@click.option("--log", "log_id", type=int, help="Number of the log; otherwise the newest.")
@click.option("--signing-key", type=FILE, metavar="FILE", help="Key of MAVLink 2 signing (see `sign`).")
def fetch_log(context: Context, connect: str, output: Path, log_id: int | None, signing_key: Path | None) -> int:
    """Download the onboard log over MAVLink into a run folder. Given again after a cut, it goes on where it stopped."""
    with LiveProgress(context.show, keep=True) as progress:
        answer = ft.fetch_log(connect, output, number=log_id, signing_key=signing_key, progress=progress)
    return context.finish(answer)


@command("sign")
@click.argument("key", type=FILE, metavar="KEY")
@click.option("--connect", metavar="URL", required=True, help="The vehicle.")
@click.option("--remove", is_flag=True, help="Take the key away from the vehicle.")
def sign(context: Context, key: Path, connect: str, remove: bool) -> int:
    """Give a vehicle the key in file KEY (made where there is none): from then on it takes only frames signed with it.

    The key crosses the link in the clear: use a cable.
    """
    with LiveProgress(context.show, keep=True) as progress:
        answer = ft.sign(connect, key, remove=remove, progress=progress)
    return context.finish(answer)


@command("demo")
@click.option("--hide", multiple=True, metavar="ID:key=value", help="Conceal another effect; otherwise a slung load.")
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the simulated vehicle.")
@click.option("--airframe", type=click.Choice(["paper", "rotor"]), default="rotor", show_default=True)
@click.option(
    "--out", type=FOLDER, default=Path("demo"), show_default=True, help="New folder for the page and the runs."
)
def demo(context: Context, hide: tuple[str, ...], seed: int, airframe: Literal["paper", "rotor"], out: Path) -> int:
    """A simulated vehicle conceals an effect: find it, model it, and predict a flight that was not used.

    Two minutes, no vehicle needed. What was concealed is shown last.
    """
    with LiveProgress(context.show, keep=True) as progress:
        answer = ft.demo(out, hide=hide, seed=seed, airframe=airframe, progress=progress)
    return context.finish(answer)


COMMANDS: tuple[click.Command, ...] = (demo, check, run, sim, fetch_log, sign)
