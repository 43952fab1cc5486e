"""What every command shares: `--all`, `--csv`, `--parquet`, `--json`, the printer, and how a result becomes words and an exit code."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from flighttest import Answer, Status
from flighttest.cli.show import Show
from flighttest.errors import FlighttestError
from flighttest.report.tables import KINDS, write_tables

EXIT = {Status.DONE: 0, Status.UNUSABLE: 1, Status.BAD_INPUT: 2, Status.UNEXPLAINED: 3, Status.STALE: 4}


class _Place(click.Path):
    """A path that may turn out to be none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """As any path; one that no system takes is a usage error."""
        try:
            return super().convert(value, param, ctx)
        except ValueError as error:  # a zero byte in it
            self.fail(f"{value!r} is not a path: {error}", param, ctx)


FILE = _Place(path_type=Path, dir_okay=False)
FOLDER = _Place(path_type=Path, file_okay=False)
ANY = _Place(path_type=Path)


@dataclass
class Context:
    """Passed to every command as `obj`."""

    show: Show
    tables: tuple[tuple[str, Path], ...] = ()  # kind of file, and the folder for the tables of the answer

    def check_writable(self) -> None:
        """InputError before any work where the tables could not be written after it."""
        for _, folder in self.tables:
            from flighttest.datafiles import check_writable  # a third of the time of what needs no YAML

            check_writable(folder)

    def finish(self, result: Answer) -> int:
        """Show an answer, write its tables where they were asked for, and give its exit code."""
        self.show.result(result.document, result.data)
        for kind, folder in self.tables:
            written = write_tables(result.document, folder, kind)
            count = f"{len(written)} table{'' if len(written) == 1 else 's'}"
            self.show.note(f"{count} written to {folder}" if written else "this answer holds no table")
        return EXIT[result.status]


class _Lists(click.Command):
    """A command whose options that may be given several times also take several values at once: `--against A B`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """With such an option repeated before each of its values, up to the next option."""
        names = {o for p in self.params if isinstance(p, click.Option) and _is_list(p) for o in p.opts}
        spread: list[str] = []
        now, values = "", 0
        for word in args:
            if word.startswith("-") and word != "-":
                now, values = (word if word in names else ""), 0
            elif now:
                spread += [now] if values else []
                values += 1
            spread.append(word)
        return super().parse_args(ctx, spread)


def _is_list(option: click.Option) -> bool:
    return option.multiple and isinstance(option.metavar, str) and option.metavar.endswith("...")


def command(name: str) -> Callable[[Callable[..., int]], click.Command]:
    """A click command called `name` whose function gets the `Context` first. It has the options of every command: `--all` (`-v`), `--csv`,
    `--parquet` and `--json`; one that may be given several times and whose metavar ends in dots takes several values at once, too."""

    def wrap(function: Callable[..., int]) -> click.Command:
        def body(context: Context, **options: Any) -> int:
            options.pop("json")
            context.show.everything = options.pop("everything")
            asked = {kind: options.pop(kind) for kind in KINDS}
            context.tables = tuple((kind, folder) for kind, folder in asked.items() if folder is not None)
            try:
                context.check_writable()
                return function(context, **options)
            except FlighttestError as error:
                error.hint = _as_typed(error.hint, options)
                raise

        body.__doc__ = function.__doc__
        body.__click_params__ = getattr(function, "__click_params__", [])  # type: ignore[attr-defined]
        body.__name__ = function.__name__
        made = click.command(name, cls=_Lists)(click.pass_obj(body))
        made.help = (function.__doc__ or "").strip()
        short = () if any("-v" in p.opts for p in made.params) else ("-v",)
        made.params += [
            click.Option([*short, "--all", "everything"], is_flag=True, help="Everything: rows, columns, stages."),
            click.Option(["--csv"], type=FOLDER, metavar="DIR", help="Write every table of the answer as CSV."),
            click.Option(["--parquet"], type=FOLDER, metavar="DIR", help="The same as Parquet."),
            click.Option(["--json"], is_flag=True, help="Print the result as JSON."),
        ]
        return made

    return wrap


def _as_typed(hint: str, options: Mapping[str, Any]) -> str:
    """A hint whose commands work as printed: `flighttest segment` with the recordings and the column map of this call."""
    words = [str(run) for run in options.get("runs") or ()]
    if options.get("columns") is not None:
        words += ["--columns", str(options["columns"])]
    return hint.replace("`flighttest segment`", f"`flighttest segment {shlex.join(words)}`") if words else hint
