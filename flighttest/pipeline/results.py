"""What every step of the pipeline gives back: a document for people, data for programs, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol, runtime_checkable

from flighttest.report.document import Document


class Status(Enum):
    """How a step ended. The value is the sentence shown to the reader; `cli` maps it to an exit code."""

    DONE = "done"
    UNUSABLE = "the flight was aborted, or nothing in it can be used"
    BAD_INPUT = "the input cannot be used as it is"
    UNEXPLAINED = "the fit failed, or a mismatch stays unexplained"
    STALE = "the model is stale: fly the named scripts again"


@dataclass(frozen=True)
class Result:
    """The end of one step. document: for people; data: for programs (plain JSON types); value: the typed thing itself."""

    document: Document
    data: Mapping[str, Any]
    status: Status = Status.DONE
    value: Any = field(default=None, repr=False)


@runtime_checkable
class Progress(Protocol):
    """Receives how far it is: `cli` draws it, tests collect it, `SILENT` drops it."""

    def stage(self, text: str) -> None:
        """A new step of the pipeline begins."""

    def part(self, done: float, of: float) -> None:
        """So many pieces of the stage are done."""

    def flight(self, progress: Any) -> None:
        """The flight went on (see `flight` for the type)."""


class _Silent:
    def stage(self, text: str) -> None:
        return None

    def part(self, done: float, of: float) -> None:
        return None

    def flight(self, progress: Any) -> None:
        return None


SILENT: Progress = _Silent()
