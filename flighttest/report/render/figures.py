"""`Figure` to plotly specifications (plain JSON types). Colours are named by role and chosen in the page, light or dark."""

from __future__ import annotations

from typing import Any

import numpy as np

from flighttest.report.document import Figure, Panel, Role, Trace
from flighttest.report.packing import FigureSpec, LegendEntry, PanelSpec
from flighttest.report.render.plain import plain

# "@role" is replaced by the page's palette (see figures.js), so that one file serves light, dark and print.
_DASH: dict[Role, str] = {
    "reference": "dot",
    "before": "dash",
    "limit": "dash",
    "linearised": "dashdot",
    "no_drag": "dash",
    "no_battery": "longdash",
    "only_delay": "dot",
}
_WIDTH: dict[Role, float] = {
    "measured": 0.9,
    "simulated": 2.6,
    "after": 2.0,
    "model": 2.0,
    "reference": 1.0,
    "limit": 1.0,
}
SIGNIFICANT_DIGITS = 5  # more than a screen can show; keeps the file small
FINE_DECADES = 2.5  # up to so many powers of ten a logarithmic axis names 2 and 5 of each, too
LEAST_HEAT = 4.0  # noise floors: the deepest colour means no less, so that noise alone, a quarter of it, is pale


def specification(figure: Figure) -> FigureSpec:
    """The figure as {id, caption, columns, height, legend, panels}; each panel is {data, layout} for Plotly.newPlot."""
    return {
        "id": figure.id,
        "caption": figure.caption,
        "columns": figure.columns,
        "height": figure.height_px,
        "legend": _legend(figure),
        "panels": [_panel(panel, _heat_top(figure)) for panel in figure.panels],
    }


def _heat_top(figure: Figure) -> float | None:
    """The largest value of all heat maps of a figure, so that they share one scale."""
    values = [np.asarray(t.z, dtype=float) for p in figure.panels for t in p.traces if t.mode == "heat"]
    finite = [v[np.isfinite(v)] for v in values]
    top = max((float(v.max()) for v in finite if v.size), default=None)
    return None if top is None else max(top, LEAST_HEAT)


def _legend(figure: Figure) -> list[LegendEntry]:
    entries: dict[str, LegendEntry] = {}
    for panel in figure.panels:
        for trace in panel.traces:
            label = trace.group or trace.name
            if label and trace.mode not in ("heat", "track"):
                entries.setdefault(
                    label,
                    {"name": label, "role": trace.role, "dash": _dash(trace), "shown": trace.shown},
                )
    return list(entries.values())


def _dash(trace: Trace) -> str:
    return "solid" if trace.mode == "bars" else _DASH.get(trace.role, "solid")


def _panel(panel: Panel, heat_top: float | None = None) -> PanelSpec:
    axis = {"gridcolor": "@grid", "linecolor": "@grid", "zerolinecolor": "@grid", "automargin": True}
    layout: dict[str, Any] = {
        "title": {"text": panel.title, "font": {"size": 13}, "x": 0.02, "xanchor": "left", "y": 0.97},
        "margin": {"l": 52, "r": 12, "t": 34, "b": 40},
        "showlegend": False,
        "hovermode": "closest",
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": "@ink", "size": 11},
    }
    layout["xaxis"] = {**axis, "title": {"text": panel.x_label, "standoff": 6}}
    counted = [x for trace in panel.traces for x in trace.x] if panel.x_label == "run" else []
    if counted and max(counted) <= 12:
        layout["xaxis"]["dtick"] = 1  # runs are counted: there is none between two
    layout["yaxis"] = {**axis, "title": {"text": panel.y_label, "standoff": 6}}
    for name in panel.log:
        values = _log_ticks(np.concatenate([np.asarray(getattr(t, name), dtype=float) for t in panel.traces]))
        layout[f"{name}axis"] |= {"type": "log", "tickvals": values, "ticktext": [f"{v:g}" for v in values]}
    if panel.equal:
        layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    if any(trace.mode == "bars" for trace in panel.traces):
        layout["barmode"] = "group" if _side_by_side(panel) else "overlay"
    hover = _hover(panel)
    data = [{**_trace(trace, heat_top), "hovertemplate": hover} for trace in panel.traces]
    return {"data": data, "layout": layout, "title": panel.title}


def _side_by_side(panel: Panel) -> bool:
    """Whether two of the panel's bars stand at one place."""
    places = [
        x
        for t in panel.traces
        if t.mode == "bars"
        for x, y in zip(t.x, np.asarray(t.y, dtype=float), strict=True)
        if np.isfinite(y)
    ]
    return len(set(places)) < len(places)


def _log_ticks(values: np.ndarray) -> list[float]:
    """Where a logarithmic axis has its numbers, written in full: plotly's own show 0.5 and 5 as the same small 5."""
    known = values[np.isfinite(values) & (values > 0.0)]
    if known.size == 0:
        return []
    low, high = np.log10(known.min()), np.log10(known.max())
    digits = (1, 2, 5) if high - low <= FINE_DECADES else (1,)
    powers = range(int(np.floor(low)) - 1, int(np.ceil(high)) + 2)
    return [float(f"{digit}e{power}") for power in powers for digit in digits]


def _hover(panel: Panel) -> str:
    """What a pointer shows: the trace's name, then each variable with its number and unit."""
    if any(trace.mode == "heat" for trace in panel.traces):
        return "%{y}, %{x}<br><b>%{z:.3g}</b> %{fullData.name}<extra></extra>"
    track = next((trace for trace in panel.traces if trace.mode == "track"), None)
    lines = ["<b>%{fullData.name}</b>"] if track is None else []
    for axis, label in (("x", panel.x_label), ("y", panel.y_label)):
        words = any(isinstance(v, str) for trace in panel.traces for v in getattr(trace, axis)[:1])
        lines.append(_named(label, f"%{{{axis}{'' if words else ':.4g'}}}"))
    if track is not None:
        lines.append(_named(track.name, "%{marker.color:.4g}"))
    return "<br>".join(lines) + "<extra></extra>"


def _named(label: str, number: str) -> str:
    """A number between the name and the unit of a label 'name, unit'."""
    name, comma, unit = label.rpartition(", ")
    return f"{name if comma else label} {number}{' ' + unit if comma else ''}".strip()


def _trace(trace: Trace, heat_top: float | None = None) -> dict[str, Any]:
    label = trace.group or trace.name
    spec: dict[str, Any] = {"x": _numbers(trace.x), "y": _numbers(trace.y), "name": trace.name, "legendgroup": label}
    if not trace.shown:
        spec["visible"] = "legendonly"
    colour = f"@{trace.role}"
    line = {"color": colour, "width": _WIDTH.get(trace.role, 1.5), "dash": _DASH.get(trace.role, "solid")}
    if trace.mode == "heat":
        return {
            "type": "heatmap",
            "x": spec["x"],
            "y": spec["y"],
            "z": [_numbers(row) for row in trace.z],
            "colorscale": "@heat",
            "hoverongaps": False,
            "zmin": 0.0,
            "zmax": heat_top,
            "colorbar": {"thickness": 10, "title": {"text": trace.name, "side": "right"}, "outlinewidth": 0},
        }
    if trace.mode == "errorbars":
        spread = _numbers(trace.spread if trace.spread is not None else [])
        return {
            **spec,
            "type": "scatter",
            "mode": "markers",
            "marker": {"color": colour, "size": 7},
            "error_y": {"type": "data", "array": spread, "color": colour, "thickness": 1.2},
        }
    if trace.mode == "track":
        colours = {"color": _numbers(trace.z), "colorscale": "Viridis", "size": 4, "showscale": True}
        colours["colorbar"] = {"thickness": 10, "title": {"text": trace.name, "side": "right"}, "outlinewidth": 0}
        return {
            **spec,
            "type": "scatter",
            "mode": "lines+markers",
            "line": {"color": "@grid", "width": 1},
            "marker": colours,
        }
    if trace.mode == "bars":
        return {**spec, "type": "bar", "marker": {"color": colour}}
    if trace.mode == "markers":
        return {**spec, "type": "scatter", "mode": "markers", "marker": {"color": colour, "size": 4, "opacity": 0.75}}
    if trace.mode == "steps":
        line["shape"] = "hv"
    return {**spec, "type": "scatter", "mode": "lines", "line": line}


def _numbers(values: Any) -> list[Any]:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        return list(plain(list(values)))
    return [None if not np.isfinite(v) else float(f"{v:.{SIGNIFICANT_DIGITS}g}") for v in array.astype(float)]
