"""`Figure` to one SVG picture, for documents that run no script: lines alone, in the light palette of the pages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from flighttest.report.document import Figure, Panel, Trace
from flighttest.report.render.plotly_figure import LIGHT

WIDTH, PANEL_HEIGHT, TOP = 400, 260, 34  # px: of a panel, and of the row of names above all of them
_LEFT, _RIGHT, _ABOVE, _BELOW = 56, 14, 26, 42  # px: margins of the axes in a panel
_MARGIN = 0.05  # above and below what is drawn, of its height
_DASHED = {"before": "6 3", "limit": "2 3", "reference": "2 3"}
_WIDTHS = {"measured": 2.4, "before": 1.6, "after": 1.6}


def as_svg(figure: Figure) -> str:
    """The panels of a figure side by side, under the names of their traces."""
    width, height = WIDTH * len(figure.panels), TOP + PANEL_HEIGHT
    names = {t.name: t for panel in figure.panels for t in panel.traces}
    parts = [_name(trace, _LEFT + 150 * i) for i, trace in enumerate(names.values())]
    parts += [f'<g transform="translate({WIDTH * i},{TOP})">{_panel(p)}</g>' for i, p in enumerate(figure.panels)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'font-family="sans-serif" font-size="11" fill="{LIGHT["ink"]}"><title>{escape(figure.caption)}</title>'
        f'<rect width="{width}" height="{height}" fill="white"/>{"".join(parts)}</svg>\n'
    )


def _name(trace: Trace, x: float) -> str:
    text = f'<text x="{x + 32}" y="20">{escape(trace.name)}</text>'
    return f'<path d="M{x} 16h26" {_pen(trace)}/>{text}'


def _pen(trace: Trace) -> str:
    dash = f' stroke-dasharray="{_DASHED[trace.role]}"' if trace.role in _DASHED else ""
    return f'fill="none" stroke="{LIGHT[trace.role]}" stroke-width="{_WIDTHS.get(trace.role, 1.2)}"{dash}'


def _panel(panel: Panel) -> str:
    across, up = WIDTH - _LEFT - _RIGHT, PANEL_HEIGHT - _ABOVE - _BELOW
    x, y = (_span([np.asarray(getattr(t, axis), dtype=float) for t in panel.traces]) for axis in "xy")
    y = (y[0] - _MARGIN * (y[1] - y[0]), y[1] + _MARGIN * (y[1] - y[0]))

    def at(a: float, b: float) -> str:
        return f"{_LEFT + across * (a - x[0]) / (x[1] - x[0]):.1f},{_ABOVE + up * (y[1] - b) / (y[1] - y[0]):.1f}"

    parts = [f'<text x="{_LEFT}" y="14" font-size="12">{escape(panel.title)}</text>']
    for value in _ticks(*x):
        (px, py), (_, top) = at(value, y[0]).split(","), at(value, y[1]).split(",")
        parts.append(f'<path d="M{px} {top}V{py}" stroke="{LIGHT["grid"]}"/>')
        parts.append(f'<text x="{px}" y="{float(py) + 15:.1f}" text-anchor="middle">{value:g}</text>')
    for value in _ticks(*y):
        (px, py), (end, _) = at(x[0], value).split(","), at(x[1], value).split(",")
        parts.append(f'<path d="M{px} {py}H{end}" stroke="{LIGHT["grid"]}"/>')
        parts.append(f'<text x="{float(px) - 6:.1f}" y="{float(py) + 4:.1f}" text-anchor="end">{value:g}</text>')
    for trace in panel.traces:
        pairs = zip(np.asarray(trace.x, dtype=float), np.asarray(trace.y, dtype=float), strict=True)
        points = " ".join(at(a, b) for a, b in pairs if math.isfinite(b))
        parts.append(f'<polyline points="{points}" {_pen(trace)}/>')
    middle = _ABOVE + up / 2
    parts.append(
        f'<text x="{_LEFT + across / 2}" y="{PANEL_HEIGHT - 8}" text-anchor="middle">{escape(panel.x_label)}</text>'
    )
    parts.append(
        f'<text transform="translate(14,{middle}) rotate(-90)" text-anchor="middle">{escape(panel.y_label)}</text>'
    )
    return "".join(parts)


def _span(values: Sequence[np.ndarray]) -> tuple[float, float]:
    """Smallest and largest finite value; never of no width."""
    known = np.concatenate([v[np.isfinite(v)] for v in values] or [np.zeros(1)])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between the ends, four to nine of them."""
    step = 10.0 ** math.floor(math.log10((high - low) / 2.0))
    step *= next(f for f in (1.0, 2.0, 5.0, 10.0) if (high - low) / (f * step) <= 8.0)
    return [float(f"{k * step:.6g}") for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
