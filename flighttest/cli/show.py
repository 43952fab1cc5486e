"""The only module that prints: results, progress and errors, for a person or (with --json) for a program."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any, TextIO, TypedDict

from rich.console import Console, RenderableType
from rich.text import Text
from rich.theme import Theme

from flighttest.errors import FlighttestError, InputError, PreflightError
from flighttest.report.document import Document
from flighttest.report.render.plain import plain
from flighttest.report.render.terminal import render

THEME = Theme(
    {
        "good": "green",
        "warn": "yellow",
        "bad": "bold red",
        "quiet": "dim",
        "lead": "bold",
        "heading": "bold cyan",
        "hint": "cyan",
    }
)


class Show:
    """Where words go.

    as_json: results as one JSON document on `out`, everything else on `err`. width and colour are injected by tests; None
    lets rich find out.
    """

    def __init__(
        self,
        as_json: bool = False,
        out: TextIO | None = None,
        err: TextIO | None = None,
        width: int | None = None,
        colour: bool | None = None,
    ) -> None:
        self.as_json = as_json
        self.everything = False  # tables whole
        self.lines = 0  # sent by `line`
        options: dict[str, Any] = {"theme": THEME, "highlight": False, "soft_wrap": False, "width": width}
        if colour is False:
            options["no_color"] = True
        if colour is True:
            options["force_terminal"] = True
        self.out = Console(file=out or sys.stdout, **options)
        self.err = Console(file=err or sys.stderr, **options)

    @property
    def side(self) -> Console:
        """Where progress goes: the terminal, but never into a JSON document."""
        return self.err if self.as_json else self.out

    @property
    def live(self) -> bool:
        """Whether a live picture may be drawn: on a terminal that can erase it, not in a file or a pipe."""
        return self.side.is_terminal and not self.side.is_dumb_terminal

    def say(self, text: str, style: str = "") -> None:
        """One line of progress or notice; on a terminal folded between words, elsewhere whole."""
        self.side.print(Text(text, style=style), soft_wrap=not self.side.is_terminal)

    def ask(self, text: str) -> bool:
        """Show a text and ask for a yes; anything else is a no."""
        self.err.print(Text(text), soft_wrap=not self.err.is_terminal)
        if self.err.is_terminal:
            self.err.bell()
        self.err.print(Text("Arm and take off? [y/N] ", style="lead"), end="")
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def alarm(self, text: str) -> None:
        """One line that must not be missed, with the terminal's bell."""
        if self.live:
            self.side.bell()
        self.say(text, style="bad")

    def note(self, text: str) -> None:
        """A word beside the result, never into it."""
        self.err.print(Text(text, style="quiet"), soft_wrap=not self.err.is_terminal)

    def draw(self, renderable: RenderableType) -> None:
        """Any rich renderable, beside the results."""
        self.side.print(renderable)

    def result(self, document: Document, data: Mapping[str, object]) -> None:
        """A finished result: the document for a person, or the data for a program."""
        if self.as_json:
            self.json(data)
        else:
            with self.out.capture() as drawn:  # a command that is copied must not end in spaces
                self.out.print(render(document, self.everything), crop=False)
            self.out.file.write("".join(line.rstrip() + "\n" for line in drawn.get().splitlines()))

    def json(self, data: Mapping[str, object]) -> None:
        """One JSON document; numbers that are not finite become null."""
        self.out.file.write(json.dumps(plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n")

    def line(self, data: Mapping[str, object]) -> None:
        """With --json one line, sent at once: what a program needs of something that goes on. Otherwise nothing."""
        if self.as_json:
            self.lines += 1
            self.out.file.write(json.dumps(plain(data), ensure_ascii=False, allow_nan=False) + "\n")
            self.out.file.flush()

    def error(self, error: FlighttestError) -> None:
        """One clear message with its remedy."""
        if self.as_json:
            self.json(error_data(error))
            return
        self.err.print(error_text(error), soft_wrap=not self.err.is_terminal)  # a path in a file or pipe stays whole

    def usage(self, message: str, help_line: str) -> None:
        """A mistake in the command line itself."""
        if self.as_json:
            self.json({"error": {"kind": "usage", "message": message, "hint": help_line, "exit_code": 2}})
            return
        self.err.print(Text.assemble(("error: ", "bad"), message))
        if help_line:
            self.err.print(Text(help_line, style="hint"))

    def raw(self, text: str) -> None:
        """Text as it is (help pages)."""
        self.out.file.write(text)


class ProblemData(TypedDict):
    """One of the problems of a file."""

    file: str
    line: int
    path: str
    what: str
    hint: str


class RefusalData(TypedDict):
    """One of the preflight checks that refuse."""

    what: str
    remedy: str


class ErrorFields(TypedDict, total=False):
    """What is known of an error."""

    kind: str
    message: str
    hint: str
    exit_code: int
    problems: list[ProblemData]
    refusals: list[RefusalData]


class ErrorData(TypedDict):
    """What --json prints of an error."""

    error: ErrorFields


def error_data(error: FlighttestError) -> ErrorData:
    """The error as data: kind, message, hint, exit_code, and all problems or refusals where there are several."""
    data: ErrorFields = {
        "kind": type(error).__name__,
        "message": error.message,
        "hint": error.hint,
        "exit_code": error.exit_code,
    }
    if isinstance(error, InputError) and error.problems:
        data["problems"] = [
            {"file": p.file, "line": p.line, "path": p.path, "what": p.what, "hint": p.hint} for p in error.problems
        ]
    if isinstance(error, PreflightError):
        data["refusals"] = [{"what": what, "remedy": remedy} for what, remedy in error.refusals]
    return {"error": data}


def error_text(error: FlighttestError) -> Text:
    """The error for a person: what and where, then the remedy on a line of its own."""
    text = Text()
    if isinstance(error, PreflightError):
        text.append("not flown\n", style="bad")
        for what, remedy in error.refusals:
            text.append(f"  - {what}\n")
            if remedy:
                text.append(f"    {remedy}\n", style="hint")
        text.right_crop(1)
        return text
    text.append("error: ", style="bad")
    if isinstance(error, InputError) and len(error.problems) > 1:
        text.append(f"{len(error.problems)} problems\n")
        text.append(error.message)
    else:
        text.append(error.message)
    if error.hint:
        text.append(f"\n{error.hint}", style="hint")
    return text
