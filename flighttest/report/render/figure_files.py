"""Every figure of a document as files: SVG for papers and slides, CSV for other programs."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from flighttest.report.document import Choice, Document, Figure
from flighttest.report.render.svg import as_svg


def named_figures(document: Document) -> Iterator[tuple[str, Figure]]:
    """(file name, figure) of every figure; of a choice each with the name it is picked by."""
    for section in document.sections:
        for block in section.blocks:
            if isinstance(block, Figure):
                yield block.id, block
            elif isinstance(block, Choice):
                for name, figure in block.figures:
                    yield f"{block.id}-{re.sub(r'[^A-Za-z0-9.+-]+', '_', name)}", figure


def write_figures(document: Document, folder: Path) -> list[Path]:
    """NAME.svg and NAME.csv of every figure (panel, trace, x, y, z per row); the paths written."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, figure in named_figures(document):
        picture, numbers = folder / f"{name}.svg", folder / f"{name}.csv"
        picture.write_text(as_svg(figure), encoding="utf-8")
        with numbers.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["panel", "x_label", "y_label", "trace", "x", "y", "z"])
            for panel in figure.panels:
                for trace in panel.traces:
                    head = [panel.title, panel.x_label, panel.y_label, trace.name]
                    writer.writerows([*head, *row] for row in _rows(trace.x, trace.y, trace.z, trace.mode == "heat"))
        written += [picture, numbers]
    return written


def _rows(x: Any, y: Any, z: Any, heat: bool) -> Iterator[list[Any]]:
    if heat:
        for row, name in zip(z, y, strict=True):
            for column, value in zip(x, row, strict=True):
                yield [column, name, value]
        return
    deep = z if z is not None else [""] * len(x)
    for a, b, c in zip(x, y, deep, strict=True):
        yield [_plain(a), _plain(b), _plain(c)]


def _plain(value: Any) -> Any:
    return "" if isinstance(value, float | np.floating) and not np.isfinite(value) else value
