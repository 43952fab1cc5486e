"""`Figure` to one SVG picture, for documents that run no script: in the light palette of the pages; a path in space is drawn from above."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np

from flighttest.report.document import Figure, Panel, Trace
from flighttest.report.render.plotly_figure import LIGHT

WIDTH, PANEL_HEIGHT, TOP = 400, 260, 34  # px: of a panel, and of a row of names above all of them
NAME_WIDTH = 150  # px, of a name in that row
# By name before the generic family, which a drawing library without the system's font settings does not resolve (PNG had no text).
FONTS = "DejaVu Sans, Liberation Sans, Arial, Helvetica, Noto Sans, sans-serif"
_LEFT, _RIGHT, _ABOVE, _BELOW = 56, 14, 26, 42  # px: margins of the axes in a panel
_MARGIN = 0.05  # above and below what is drawn, of its height
_DASHED = {"before": "6 3", "limit": "2 3", "reference": "2 3"}
_WIDTHS = {"measured": 2.4, "before": 1.6, "after": 1.6, "simulated": 3.2}
_LETTER, _LEAN, _SLOPE = (
    5.6,
    50,
    math.sin(math.radians(50)),
)  # px of a letter; degrees by which names below columns lean
_BAR = 0.8  # of the place of a column, all its bars together
_OVER_SIMULATED = 0.9  # width of what is measured where the model's line is the wide one


@dataclass(frozen=True)
class _Box:
    """Where a panel's axes are, px: from the left edge, across, and up."""

    left: float
    across: float
    up: float


def as_svg(figure: Figure) -> str:
    """The panels of a figure, `columns` of them in a row, under the names of their traces."""
    columns = min(figure.columns, len(figure.panels)) if figure.columns > 0 else len(figure.panels)
    rows = -(-len(figure.panels) // columns)
    names = {
        t.group or t.name: t
        for panel in figure.panels
        for t in panel.traces
        if t.mode != "heat" and (t.group or t.name)
    }
    across = max(1, (WIDTH * columns - _LEFT) // NAME_WIDTH)
    top = TOP * max(1, -(-len(names) // across))
    width, height = WIDTH * columns, top + PANEL_HEIGHT * rows
    parts = [
        f'<g transform="translate(0,{TOP * (i // across)})">{_name(name, trace, _LEFT + NAME_WIDTH * (i % across))}</g>'
        for i, (name, trace) in enumerate(names.items())
    ]
    for i, panel in enumerate(figure.panels):
        parts.append(
            f'<g transform="translate({WIDTH * (i % columns)},{top + PANEL_HEIGHT * (i // columns)})">{_panel(panel)}</g>'
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'font-family="{FONTS}" font-size="11" fill="{LIGHT["ink"]}"><title>{escape(figure.caption)}</title>'
        f'<rect width="{width}" height="{height}" fill="white"/>{"".join(parts)}</svg>\n'
    )


def _name(name: str, trace: Trace, x: float) -> str:
    text = f'<text x="{x + 32}" y="20">{escape(name)}</text>'
    return f'<path d="M{x} 16h26" {_pen(trace)}/>{text}'


def _pen(trace: Trace, over_simulated: bool = False) -> str:
    width = _OVER_SIMULATED if over_simulated and trace.role == "measured" else _WIDTHS.get(trace.role, 1.2)
    dash = f' stroke-dasharray="{_DASHED[trace.role]}"' if trace.role in _DASHED else ""
    return f'fill="none" stroke="{LIGHT[trace.role]}" stroke-width="{width}"{dash}'


def _panel(panel: Panel) -> str:
    heat = next((t for t in panel.traces if t.mode == "heat"), None)
    names = list(dict.fromkeys(str(v) for t in panel.traces for v in t.x if isinstance(v, str)))
    left = _LEFT if heat is None else max(_LEFT, 12 + _LETTER * max((len(str(n)) for n in heat.y), default=0))
    below = _BELOW + round(_LETTER * _SLOPE * max((len(n) for n in names), default=0))
    box = _Box(left, WIDTH - left - _RIGHT, PANEL_HEIGHT - _ABOVE - below)
    if heat is not None:
        return _heat(panel, heat, box)
    places = {name: float(i) for i, name in enumerate(names)}
    log = {axis: axis in panel.log for axis in "xy"}
    values = {
        axis: [_scaled([places.get(v, v) for v in getattr(t, axis)], log[axis]) for t in panel.traces] for axis in "xy"
    }
    axes = _axes(panel, box, values)
    parts = [f'<text x="{box.left}" y="14" font-size="12">{escape(panel.title)}</text>', *_grid(axes, places, log)]
    wide = any(t.role == "simulated" for t in panel.traces)
    bars = [t for t in panel.traces if t.mode == "bars"]
    for trace, xs, ys in zip(panel.traces, values["x"], values["y"], strict=True):
        pairs = [(float(a), float(b)) for a, b in zip(xs, ys, strict=True) if math.isfinite(a) and math.isfinite(b)]
        if trace.mode == "bars":
            parts += _bars(axes, trace, pairs, bars.index(trace), len(bars))
        elif trace.mode in ("markers", "errorbars"):
            parts += _dots(axes, trace, pairs, _spread(trace, xs, ys))
        else:
            parts.append(_line(axes, trace, pairs, _pen(trace, wide)))
    return "".join([*parts, _labels(panel, box)])


@dataclass(frozen=True)
class _Axes:
    """Spans of both axes (of the logarithm where an axis is logarithmic) and the box that they fill."""

    box: _Box
    x: tuple[float, float]
    y: tuple[float, float]

    def at(self, a: float, b: float) -> str:
        """Where (a, b) is drawn, as `across,down`."""
        (low, high), (bottom, top) = self.x, self.y
        across = self.box.left + self.box.across * (a - low) / (high - low)
        return f"{across:.1f},{_ABOVE + self.box.up * (top - b) / (top - bottom):.1f}"


def _axes(panel: Panel, box: _Box, values: Mapping[str, Sequence[np.ndarray]]) -> _Axes:
    """Axes that hold every value, error bars and the feet of bars included. values: of each axis, by trace."""
    ends = [ys + sign * np.asarray(t.spread) for t, ys in zip(panel.traces, values["y"], strict=True)
            if t.spread is not None for sign in (1.0, -1.0)]  # fmt: skip
    x, y = _span(values["x"]), _span([*values["y"], *ends])
    if any(t.mode == "bars" for t in panel.traces):
        x, y = (x[0] - 0.5, x[1] + 0.5), (min(y[0], 0.0), max(y[1], 0.0))
    return _Axes(box, x, (y[0] - _MARGIN * (y[1] - y[0]), y[1] + _MARGIN * (y[1] - y[0])))


def _grid(axes: _Axes, places: Mapping[str, float], log: Mapping[str, bool]) -> list[str]:
    """Lines and numbers of both axes; names in place of numbers across where there are any."""
    x, y, parts = axes.x, axes.y, []
    for value in () if places else _ticks(*x):
        (px, py), (_, top) = axes.at(value, y[0]).split(","), axes.at(value, y[1]).split(",")
        parts.append(f'<path d="M{px} {top}V{py}" stroke="{LIGHT["grid"]}"/>')
        parts.append(f'<text x="{px}" y="{float(py) + 15:.1f}" text-anchor="middle">{_tick(value, log["x"])}</text>')
    parts += [_leaning(name, *map(float, axes.at(place, y[0]).split(","))) for name, place in places.items()]
    for value in _ticks(*y):
        (px, py), (end, _) = axes.at(x[0], value).split(","), axes.at(x[1], value).split(",")
        parts.append(f'<path d="M{px} {py}H{end}" stroke="{LIGHT["grid"]}"/>')
        parts.append(
            f'<text x="{float(px) - 6:.1f}" y="{float(py) + 4:.1f}" text-anchor="end">{_tick(value, log["y"])}</text>'
        )
    return parts


def _bars(axes: _Axes, trace: Trace, pairs: Sequence[tuple[float, float]], index: int, count: int) -> list[str]:
    """Bars from zero, beside those of the panel's other traces."""
    width = _BAR / count
    shift = width * (index - (count - 1) / 2)
    thick = width * axes.box.across / (axes.x[1] - axes.x[0])
    parts = []
    for a, b in pairs:
        (px, foot), (_, end) = axes.at(a + shift, 0.0).split(","), axes.at(a, b).split(",")
        above, high = min(float(foot), float(end)), abs(float(foot) - float(end))
        parts.append(
            f'<rect x="{float(px) - thick / 2:.1f}" y="{above:.1f}" width="{thick:.1f}" height="{high:.1f}" '
            f'fill="{LIGHT[trace.role]}"/>'
        )
    return parts


def _line(axes: _Axes, trace: Trace, pairs: Sequence[tuple[float, float]], pen: str) -> str:
    """A line through the points, or one that holds each value until the next."""
    if trace.mode == "steps":
        pairs = [p for (a, b), (c, _) in pairwise([*pairs, *pairs[-1:]]) for p in ((a, b), (c, b))]
    return f'<polyline points="{" ".join(axes.at(a, b) for a, b in pairs)}" {pen}/>'


def _dots(
    axes: _Axes, trace: Trace, pairs: Sequence[tuple[float, float]], spread: Sequence[tuple[float, float, float]]
) -> list[str]:
    """Points, and their error bars."""
    dots = [axes.at(a, b).split(",") for a, b in pairs]
    parts = [f'<circle cx="{cx}" cy="{cy}" r="2.2" fill="{LIGHT[trace.role]}"/>' for cx, cy in dots]
    for a, b, half in spread:
        (px, top), (_, foot) = axes.at(a, b + half).split(","), axes.at(a, b - half).split(",")
        parts.append(f'<path d="M{px} {top}V{foot}" stroke="{LIGHT[trace.role]}"/>')
    return parts


def _spread(trace: Trace, xs: np.ndarray, ys: np.ndarray) -> list[tuple[float, float, float]]:
    """(x, y, half width) of every error bar."""
    if trace.spread is None:
        return []
    return [
        (float(a), float(b), float(s)) for a, b, s in zip(xs, ys, trace.spread, strict=True) if math.isfinite(a + b + s)
    ]


def _leaning(name: str, x: float, y: float) -> str:
    """The name of a column below it."""
    return f'<text transform="translate({x + 4:.1f},{y + 14:.1f}) rotate(-{_LEAN})" text-anchor="end">{escape(name)}</text>'


def _scaled(values: Any, log: bool) -> np.ndarray:
    array = np.asarray(values, dtype=float)
    if not log:
        return array
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(array > 0.0, np.log10(array), np.nan)


def _tick(value: float, log: bool) -> str:
    return f"{10.0**value:.3g}" if log else f"{value:g}"


def _heat(panel: Panel, heat: Trace, box: _Box) -> str:
    """Cells of a table, darker for larger numbers, with the numbers in them."""
    table = np.asarray(heat.z, dtype=float)
    top = float(np.nanmax(table)) if np.isfinite(table).any() else 1.0
    w, h = box.across / max(table.shape[1], 1), box.up / max(table.shape[0], 1)
    parts = [f'<text x="{box.left}" y="14" font-size="12">{escape(panel.title)}</text>']
    for (row, column), value in np.ndenumerate(table):
        if math.isfinite(value):
            left, above = box.left + column * w, _ABOVE + row * h
            parts.append(
                f'<rect x="{left:.1f}" y="{above:.1f}" width="{w:.1f}" height="{h:.1f}" fill="#f08a4b" fill-opacity="{value / top:.2f}"/>'
            )
            parts.append(
                f'<text x="{left + w / 2:.1f}" y="{above + h / 2 + 4:.1f}" text-anchor="middle">{value:.2g}</text>'
            )
    for i, name in enumerate(heat.y):
        parts.append(
            f'<text x="{box.left - 6}" y="{_ABOVE + (i + 0.5) * h + 4:.1f}" text-anchor="end">{escape(str(name))}</text>'
        )
    parts += [_leaning(str(name), box.left + (i + 0.5) * w, _ABOVE + box.up) for i, name in enumerate(heat.x)]
    return "".join(parts)


def _labels(panel: Panel, box: _Box) -> str:
    return (
        f'<text x="{box.left + box.across / 2}" y="{PANEL_HEIGHT - 8}" text-anchor="middle">{escape(panel.x_label)}</text>'
        f'<text transform="translate(14,{_ABOVE + box.up / 2}) rotate(-90)" text-anchor="middle">{escape(panel.y_label)}</text>'
    )


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
