"""Every error this package raises on purpose. Each states what, where, and what to do.

    FlighttestError
    +-- InputError            something a person typed or a file a person wrote
    |   +-- ScriptError       a maneuver script; lists all problems at once
    |   +-- VehicleError      vehicle.yaml or a components file
    |   +-- ModelError        model.yaml
    |   +-- RecordingError    a run folder, log or table that cannot be used
    +-- LinkError             the vehicle cannot be reached, or stopped answering
    +-- PreflightError        the vehicle is reachable, but must not fly this script now
    +-- FitError              no parameters can be estimated from this data

What a pilot or the weather causes is not an error but an outcome (see `flight.FlightOutcome`); what we caused is a traceback.
Only `cli` turns errors into exit codes: `exit_code` is the number it uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class FlighttestError(Exception):
    """An error with a remedy.

    Parameters: message (what is wrong, and where), hint (what to do about it; may be empty).
    """

    exit_code = 2

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message}; {self.hint}" if self.hint else self.message


@dataclass(frozen=True)
class FileProblem:
    """One thing wrong in a text file: where (file, line, path inside the document), what, and the remedy."""

    file: str
    line: int
    path: str
    what: str
    hint: str = ""

    def __str__(self) -> str:
        tail = f"; {self.hint}" if self.hint else ""
        where = f"{self.path}: " if self.path else ""
        return f"{self.file}:{self.line}: {where}{self.what}{tail}"


class InputError(FlighttestError):
    """A file or an argument a person wrote cannot be used; `problems` lists everything wrong with it."""

    def __init__(self, message: str, hint: str = "", problems: Sequence[FileProblem] = ()) -> None:
        super().__init__(message, hint)
        self.problems = tuple(problems)

    @classmethod
    def of(cls, problems: Sequence[FileProblem]) -> InputError:
        """Build the error from all problems found in one pass over a file."""
        return cls("\n".join(str(p) for p in problems), problems=problems)


class ScriptError(InputError):
    """A maneuver script that cannot be flown."""


class VehicleError(InputError):
    """A vehicle description that cannot be used."""


class ModelError(InputError):
    """A model file that cannot be used."""


class RecordingError(InputError):
    """A run folder, log or table that cannot be used."""


class LinkError(FlighttestError):
    """The vehicle cannot be reached, or stopped answering."""

    exit_code = 1


class PreflightError(FlighttestError):
    """The vehicle must not fly this script now; `refusals` are (what, remedy) pairs."""

    exit_code = 1

    def __init__(self, refusals: Sequence[tuple[str, str]]) -> None:
        super().__init__("\n".join(f"{what}; {remedy}" for what, remedy in refusals))
        self.refusals = tuple(refusals)


class FitError(FlighttestError):
    """No parameters can be estimated from this data."""

    exit_code = 3
