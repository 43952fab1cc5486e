"""`flighttest`: the command line. Turns errors into one clear message and an exit code; a traceback means the fault is ours."""

from __future__ import annotations

import gc
import io
import os
import sys
import warnings
from collections.abc import Sequence

import click

from flighttest.cli import analyse, field, models, tool, twin
from flighttest.cli.base import Context
from flighttest.cli.show import Show
from flighttest.errors import FlighttestError
from flighttest.version import __version__


class InOrder(click.Group):
    """Lists its commands in the order of work, not of the alphabet."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Command names as they were added."""
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Every command with the first paragraph of its help, folded and not cut."""
        rows = [(name, " ".join((c.help or "").split("\n\n")[0].split())) for name, c in self.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


@click.group(cls=InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="flighttest")
def cli() -> None:
    """Fly a multirotor's test maneuvers over MAVLink, identify its dynamics, and name the physics that the model lacks.

    Start with `flighttest run thrust roll_pitch yaw_rate`: it flies the built-in simulated copter.

    \b
    Exit codes: 0 done, 1 flight aborted or unusable, 2 bad input or usage,
    3 fit failed or a mismatch stays unexplained, 4 the model is stale.
    """


for module in (field, analyse, models, twin, tool):
    for command in module.COMMANDS:
        cli.add_command(command)


def call(argv: Sequence[str]) -> int:
    """Run one command line (without the program's name) and give its exit code."""
    show = Show(as_json="--json" in argv)
    try:
        result = cli.main(args=list(argv), prog_name="flighttest", standalone_mode=False, obj=Context(show))
        return int(result) if isinstance(result, int) else 0
    except click.exceptions.NoArgsIsHelpError as error:
        show.raw(error.format_message() + "\n")
        return 0
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        hint = f"see: {context.command_path} --help" if context is not None else ""
        show.usage(error.format_message(), hint)
        return 2
    except (click.Abort, KeyboardInterrupt):
        if show.as_json and not show.lines:
            show.json(
                {"error": {"kind": "stopped", "message": "stopped before it was done", "hint": "", "exit_code": 1}}
            )
        else:
            show.say("stopped", style="warn")
        return 1
    except FlighttestError as error:
        show.error(error)
        return error.exit_code
    except BrokenPipeError:
        # The reader (head, less) went away: not worth a word, but Python would complain again while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        # A file that cannot be read or written is the typist's to mend: name it instead of a traceback.
        what = error.strerror or str(error)
        words = what if error.filename is None else f"{error.filename}: {what}"
        show.error(FlighttestError(words, "check the path, its permissions and the free space"))
        return 2


def main() -> None:
    """Entry point of the `flighttest` program."""
    # Trial steps of a solver may overflow before they are taken back; that is no news to an operator.
    warnings.simplefilter("ignore", RuntimeWarning)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a sign shows another in its place
            stream.reconfigure(errors="replace")
    code = call(sys.argv[1:])
    gc.freeze()  # what is left goes with the process: Python need not search it for cycles on the way out
    sys.exit(code)


if __name__ == "__main__":
    main()
