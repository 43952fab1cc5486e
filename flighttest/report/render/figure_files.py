"""Every figure of a document as files: SVG and PNG for papers and slides, CSV for other programs."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flighttest.report.document import Choice, Document, Figure
from flighttest.report.render.svg import as_svg

PNG_PIXELS_PER_PX = 2.0  # a picture of 800 px is 1600 pixels wide: sharp on a slide and in print


@dataclass(frozen=True)
class WrittenFigures:
    """What `write_figures` wrote. figures: how many; files: their paths, SVG, PNG (where it could be drawn) and CSV of each in turn."""

    figures: int
    files: tuple[Path, ...]
    without_png: bool = False  # the package that draws PNG (extra `png`) is not installed

    def sentence(self, folder: Path) -> str:
        """How many figures of which formats were written, and what PNG needs where there is none."""
        kinds = "SVG and CSV" if self.without_png else "SVG, PNG and CSV"
        need = "; PNG needs resvg-py: pip install 'flighttest[png]'" if self.without_png else ""
        return f"{self.figures} figures written to {folder} as {kinds}{need}"


def named_figures(document: Document) -> Iterator[tuple[str, Figure]]:
    """(file name, figure) of every figure; of a choice each with the name it is picked by."""
    for section in document.sections:
        for block in section.blocks:
            if isinstance(block, Figure):
                yield block.id, block
            elif isinstance(block, Choice):
                for name, figure in block.figures:
                    yield f"{block.id}-{re.sub(r'[^A-Za-z0-9.+-]+', '_', name)}", figure


def write_figures(document: Document, folder: Path) -> WrittenFigures:
    """NAME.svg, NAME.png and NAME.csv of every figure (CSV: panel, trace, x, y, z per row).

    PNG has PNG_PIXELS_PER_PX pixels per px of the SVG and is left out where resvg-py is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rasterise = _rasteriser()
    written, count = [], 0
    for name, figure in named_figures(document):
        count += 1
        picture, numbers = folder / f"{name}.svg", folder / f"{name}.csv"
        svg = as_svg(figure)
        picture.write_text(svg, encoding="utf-8")
        written.append(picture)
        if rasterise is not None:
            image = folder / f"{name}.png"
            image.write_bytes(rasterise(svg))
            written.append(image)
        with numbers.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["panel", "x_label", "y_label", "trace", "x", "y", "z"])
            for panel in figure.panels:
                for trace in panel.traces:
                    head = [panel.title, panel.x_label, panel.y_label, trace.name]
                    writer.writerows([*head, *row] for row in _rows(trace.x, trace.y, trace.z, trace.mode == "heat"))
        written.append(numbers)
    return WrittenFigures(count, tuple(written), rasterise is None)


def _rasteriser() -> Callable[[str], bytes] | None:
    """SVG text to the bytes of a PNG, by resvg; None where it is not installed."""
    try:
        import resvg_py
    except ImportError:
        return None
    return lambda svg: bytes(resvg_py.svg_to_bytes(svg_string=svg, zoom=PNG_PIXELS_PER_PX))


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
