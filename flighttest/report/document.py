"""`Document`: what is shown, as pure data. Every renderer (HTML, terminal) reads the same one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Tone = Literal["plain", "good", "warn", "bad", "quiet"]
Role = Literal[
    "measured",
    "simulated",
    "before",
    "after",
    "reference",
    "model",
    "linearised",
    "no_drag",
    "no_battery",
    "only_delay",
    "limit",
    "band",
    "other",
]
OMITTED = " "  # in place of a block's `brief`: a terminal shows nothing of it unless everything is asked for
Align = Literal["left", "right"]


@dataclass(frozen=True)
class Cell:
    """One cell of a table; `note` is shown smaller below or behind the text."""

    text: str
    tone: Tone = "plain"
    note: str = ""


@dataclass(frozen=True)
class Paragraph:
    """One paragraph of prose."""

    text: str
    tone: Tone = "plain"


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: tuple[str, ...]
    brief: str = ""  # as of a table


@dataclass(frozen=True)
class Facts:
    """Name and value pairs (provenance, settings)."""

    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Table:
    """A table: column headings, rows of cells (strings are plain cells), alignment per column."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell | str, ...], ...]
    align: tuple[Align, ...] = ()
    caption: str = ""
    fold: bool = False  # long: folded away in HTML, shortened on a terminal unless everything is asked for
    detail: tuple[int, ...] = ()  # columns (by position) that a terminal shows only where everything is asked for
    brief: str = ""  # the sentence that stands for it on a terminal unless everything is asked for
    brief_rows: int = 0  # the first rows, all that a terminal shows unless everything is asked for; 0: every row


@dataclass(frozen=True)
class Code:
    """Text to be copied as it is: a command, a script."""

    text: str
    caption: str = ""
    brief: str = ""  # as of a table


@dataclass(frozen=True)
class Trace:
    """One line or cloud of points of a panel. x, y: (n,) arrays; z: colour of a track's points (n,), or cells of a heat map (y, x); role
    gives its colour."""

    x: NDArray[np.float64] | Sequence[Any]
    y: NDArray[np.float64] | Sequence[Any]
    name: str
    role: Role = "other"
    mode: Literal["lines", "markers", "steps", "heat", "errorbars", "track", "bars"] = "lines"
    z: Any = None
    spread: NDArray[np.float64] | None = None  # error bar half width, unit of y
    group: str = ""  # traces of one group are switched together and listed once
    shown: bool = True


@dataclass(frozen=True)
class Panel:
    """One set of axes."""

    title: str
    x_label: str
    y_label: str
    traces: tuple[Trace, ...]
    log: str = ""  # axes with a logarithmic scale: "x", "y" or "xy"
    equal: bool = False  # one metre is as long across as upwards


@dataclass(frozen=True)
class Figure:
    """Panels side by side (`columns` per row) with one caption."""

    id: str
    panels: tuple[Panel, ...]
    caption: str
    columns: int = 2
    height_px: int = 320


@dataclass(frozen=True)
class Mark:
    """A time, or a stretch of time, on a viewer's axis. kind: mode, leg, or anything else that happened."""

    start_s: float
    end_s: float
    label: str
    kind: str


@dataclass(frozen=True)
class Viewer:
    """Any channels over one time axis, chosen and zoomed in the page. groups: name to (t_s (n,), channel to (n,)); words: channel to
    (name for people, unit, held until the next sample, name of the strip it shares with others); shown: the channels drawn at first."""

    id: str
    groups: Mapping[str, tuple[NDArray[np.float64], Mapping[str, NDArray[np.float64]]]]
    words: Mapping[str, tuple[str, str, bool, str]]
    marks: tuple[Mark, ...]
    shown: tuple[str, ...]
    caption: str


@dataclass(frozen=True)
class Choice:
    """Figures of which one is shown: the reader picks it by its name."""

    id: str
    what: str
    figures: tuple[tuple[str, Figure], ...]


PageBlock = Paragraph | Bullets | Facts | Table | Code | Figure | Viewer | Choice


@dataclass(frozen=True)
class Section:
    """A headed part of a document."""

    id: str
    title: str
    blocks: tuple[PageBlock, ...]
    lead: str = ""
    detail: bool = False  # a terminal shows it only where everything is asked for


@dataclass(frozen=True)
class Document:
    """verdict: the one sentence that answers the question asked; tone: how it should feel; sections follow in order."""

    title: str
    verdict: str
    tone: Tone = "plain"
    sections: tuple[Section, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    footer: str = ""
