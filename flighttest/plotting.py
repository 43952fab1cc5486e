"""Channels over time as a plotly figure, one panel per group: what `.plot()` of recordings and simulations draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS, HELD_GROUPS

if TYPE_CHECKING:
    import plotly.graph_objects as go

FloatArray = NDArray[np.float64]
PANEL_HEIGHT_PX = 190
GAP = 0.25  # between panels, of a panel's height


def over_time(groups: Mapping[str, tuple[FloatArray, Mapping[str, FloatArray]]], title: str = "") -> go.Figure:
    """One panel per group under a common time axis. groups: name to (t_s (n,), channel to (n,)); held channels are drawn as steps."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=max(len(groups), 1),
        cols=1,
        shared_xaxes=True,
        subplot_titles=list(groups),
        vertical_spacing=GAP / max(len(groups), 1),
    )
    for row, (t_s, columns) in enumerate(groups.values(), 1):
        for name, values in columns.items():
            known = CHANNELS.get(name)
            line = {"shape": "hv"} if known is not None and known.group in HELD_GROUPS else {}
            figure.add_trace(go.Scatter(x=t_s, y=values, name=name, mode="lines", line=line), row=row, col=1)
        units = dict.fromkeys(CHANNELS[n].unit for n in columns if n in CHANNELS)
        figure.update_yaxes(title_text=", ".join(units), row=row, col=1)
    figure.update_xaxes(title_text="t, s", row=max(len(groups), 1), col=1)
    figure.update_layout(title=title, template="plotly_white", height=90 + PANEL_HEIGHT_PX * max(len(groups), 1))
    return figure


def by_group(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> dict[str, tuple[FloatArray, dict[str, FloatArray]]]:
    """Columns (n,) on one time base in the groups of the channel table, in its order; other names under 'other'."""
    found: dict[str, dict[str, FloatArray]] = {}
    for name in (*(n for n in CHANNELS if n in columns), *(n for n in columns if n not in CHANNELS)):
        group = CHANNELS[name].group if name in CHANNELS else "other"
        found.setdefault(group, {})[name] = columns[name]
    return {group: (t_s, members) for group, members in found.items()}
