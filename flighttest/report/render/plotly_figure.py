"""Figures of documents as one plotly figure, for notebooks: the same specification as the pages', in the light palette."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from flighttest.report.document import Document, Figure, PageBlock
from flighttest.report.render.figures import specification

if TYPE_CHECKING:
    import plotly.graph_objects as go

# As `light` in figures.js.
LIGHT: dict[str, Any] = {
    "ink": "#24303c", "grid": "#dfe5ea", "measured": "#1f2937", "simulated": "#f2a36b", "reference": "#94a3b8", "before": "#b45309",
    "after": "#0f766e", "model": "#c2410c", "linearised": "#7c3aed", "no_drag": "#0284c7", "no_battery": "#15803d",
    "only_delay": "#be185d", "limit": "#b91c1c", "band": "#cbd5e1", "other": "#2563eb",
    "heat": [[0, "#f6f8fa"], [0.25, "#fde2c4"], [0.6, "#f08a4b"], [1, "#8f1d1d"]],
}  # fmt: skip
MOST_COLUMNS = 3


def figures_of(document: Document) -> dict[str, Figure]:
    """The figures of a document by id, in order."""
    blocks: list[PageBlock] = [block for section in document.sections for block in section.blocks]
    return {block.id: block for block in blocks if isinstance(block, Figure)}


def drawn(figures: Sequence[Figure]) -> go.Figure:
    """All panels of the figures in one grid."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    panels = [(figure, panel) for figure in figures for panel in specification(figure)["panels"]]
    if not panels:
        return go.Figure()
    columns = min(max(figure.columns for figure in figures), MOST_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    made = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[panel["layout"]["title"]["text"] for _, panel in panels],
    )
    listed: set[str] = set()
    for k, (_, panel) in enumerate(panels):
        where = {"row": k // columns + 1, "col": k % columns + 1}
        for trace in panel["data"]:
            group = trace.get("legendgroup", "")
            painted = _painted({**trace, "name": group or trace.get("name", ""), "showlegend": group not in listed})
            if painted["type"] == "heatmap":
                painted = {n: v for n, v in painted.items() if n not in ("showlegend", "colorbar")}
            listed.add(group)
            made.add_trace(painted, **where)
        made.update_xaxes(title_text=panel["layout"]["xaxis"]["title"]["text"], **where)
        made.update_yaxes(title_text=panel["layout"]["yaxis"]["title"]["text"], **where)
    made.update_layout(height=80 + max(figure.height_px for figure in figures) * rows, template="plotly_white")
    return made


def _painted(value: Any) -> Any:
    """The value with every '@role' replaced by its colour."""
    if isinstance(value, str) and value.startswith("@"):
        return LIGHT.get(value[1:], value)
    if isinstance(value, dict):
        return {name: item if name in ("x", "y", "z") else _painted(item) for name, item in value.items()}
    return value
