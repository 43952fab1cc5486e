"""Segments as a table: one row each, for `flighttest segment` and segments.parquet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flighttest.segments.metrics import metrics_of
from flighttest.segments.model import Segment

if TYPE_CHECKING:
    import pandas as pd

_STATE = ("voltage_v", "height_m", "v_x_m_s", "v_y_m_s", "v_z_m_s")
COLUMNS = (
    "run", "name", "kind", "maneuver", "cell", "repeat", "usable", "reason", "notes", "t_step_s", "start_s", "end_s", "samples", "rate_hz",
    "heading_rad", "time_since_takeoff_s", *_STATE, "channel", "change", "delay_s", "rise_s", "overshoot", "settling_s", "steady_error",
)  # fmt: skip


def segment_table(segments: Sequence[Segment]) -> pd.DataFrame:
    """One row per segment: what it is, whether it may be fitted and why not, its state at the step, its metrics (NaN: undefined)."""
    import pandas as pd  # here: it takes as long to load as all else together, and most commands make no table

    return pd.DataFrame([_row(segment) for segment in segments], columns=list(COLUMNS))


def _row(segment: Segment) -> dict[str, object]:
    t = segment.t_s
    row: dict[str, object] = {
        "run": segment.run,
        "name": segment.name,
        "kind": segment.kind,
        "maneuver": segment.maneuver,
        "cell": " ".join(f"{name}={value:g}" for name, value in segment.cell.items()),
        "repeat": segment.repeat,
        "usable": segment.usable,
        "reason": "; ".join(flaw.value for flaw in segment.flaws),
        "notes": "; ".join(segment.notes),
        "t_step_s": segment.t_step_s,
        "start_s": float(t[0]) if t.size else np.nan,
        "end_s": float(t[-1]) if t.size else np.nan,
        "samples": int(t.size),
        "rate_hz": float(1.0 / np.median(np.diff(t))) if t.size > 1 else np.nan,
        "heading_rad": segment.heading_rad,
        "time_since_takeoff_s": segment.time_since_takeoff_s,
    }
    for name in _STATE:
        row[name] = _at_step(segment, name)
    found = metrics_of(segment)
    for name in ("channel", "change", "delay_s", "rise_s", "overshoot", "settling_s", "steady_error"):
        row[name] = getattr(found, name) if found is not None else None
    for name in ("change", "delay_s", "rise_s", "overshoot", "settling_s", "steady_error"):
        row[name] = np.nan if row[name] is None else row[name]
    return row


def _at_step(segment: Segment, name: str) -> float:
    if name not in segment.y:
        return float("nan")
    good = np.isfinite(segment.y[name])
    if not good.any():
        return float("nan")
    return float(np.interp(segment.t_step_s, segment.t_s[good], segment.y[name][good]))
