"""The battery behind recordings: its internal resistance, and what a model keeps of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from flighttest.identify.models.model_blocks import BatteryBlock
from flighttest.identify.models.model_file import ModelFile
from flighttest.recording import Recording
from flighttest.validity.battery import resistance


def battery_of(recordings: Sequence[Recording]) -> tuple[float, float] | str:
    """Internal resistance of all recordings that determine it together (weighted by their information), else the reason of the last."""
    reason = "battery resistance: UNTESTABLE, no voltage is recorded"
    known: list[tuple[float, float]] = []
    for recording in recordings:
        series = recording.series.get("battery")
        if series is None or "voltage_v" not in series.columns:
            continue
        current = series.columns.get("current_a")
        found = resistance(
            series.t_s, series.columns["voltage_v"], current if current is not None else np.full(len(series), np.nan)
        )
        if isinstance(found, tuple):
            known.append(found)
        else:
            reason = found
    if not known:
        return reason
    weights = [1.0 / max(std, 1e-6) ** 2 for _, std in known]
    total = sum(weights)
    mean = sum(w * value for w, (value, _) in zip(weights, known, strict=True)) / total
    # Packs differ, and the scatter of few blocks is itself badly known: the scatter between the recordings counts where it is larger.
    between = sum(w * (value - mean) ** 2 for w, (value, _) in zip(weights, known, strict=True)) / max(
        len(known) - 1, 1
    )
    return mean, math.sqrt(max(between, 1.0) / total)


def battery_data(recordings: Sequence[Recording]) -> BatteryBlock | None:
    """What model.yaml keeps of the battery."""
    found = battery_of(recordings)
    return None if isinstance(found, str) else {"resistance_ohm": found[0], "std": found[1]}


def battery_reference(stored: ModelFile) -> tuple[float, float] | None:
    """The resistance kept with a model."""
    kept = stored.fit_quality.get("battery")
    if not isinstance(kept, Mapping):
        return None
    try:
        return float(kept["resistance_ohm"]), float(kept["std"])
    except (KeyError, TypeError, ValueError):
        return None
