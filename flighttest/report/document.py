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


@dataclass(frozen=True)
class Code:
    """Text to be copied as it is: a command, a script."""

    text: str
    caption: str = ""


@dataclass(frozen=True)
class Trace:
    """One line or cloud of points of a panel. x, y (and z for a map or three dimensions): (n,) arrays; role gives its colour."""

    x: NDArray[np.float64] | Sequence[Any]
    y: NDArray[np.float64] | Sequence[Any]
    name: str
    role: Role = "other"
    mode: Literal["lines", "markers", "steps", "heat", "lines3d", "markers3d", "errorbars"] = "lines"
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
    z_label: str = ""


@dataclass(frozen=True)
class Figure:
    """Panels side by side (`columns` per row) with one caption."""

    id: str
    panels: tuple[Panel, ...]
    caption: str
    columns: int = 2
    height_px: int = 320


Block = Paragraph | Bullets | Facts | Table | Code | Figure


@dataclass(frozen=True)
class Section:
    """A headed part of a document."""

    id: str
    title: str
    blocks: tuple[Block, ...]
    lead: str = ""


@dataclass(frozen=True)
class Document:
    """verdict: the one sentence that answers the question asked; tone: how it should feel; sections follow in order."""

    title: str
    verdict: str
    tone: Tone = "plain"
    sections: tuple[Section, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    footer: str = ""
