"""How a model misses each kind of step, so that a later flight's misses can be compared with it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.identify.models.model_blocks import LeftRow

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class StepError:
    """The error of one channel in one kind of step. cell: as `Segment.cell`; responses: how many; mean (bins,): over these, in
    the channel's unit, in bins of `lack_of_fit.BIN_S` since the step, the first of which is `first`, NaN where there is no sample;
    variance: of one response about it, mean over the bins, NaN where none was repeated."""

    channel: str
    kind: str
    cell: Mapping[str, float]
    responses: int
    first: int
    mean: FloatArray
    variance: float

    @property
    def power(self) -> float:
        """Mean square of what repeats share: without the part of the mean that they differ by, where that is known."""
        own = 0.0 if math.isnan(self.variance) else self.variance / self.responses
        return float(np.nanmean(self.mean**2)) - own


def between(now: StepError, before: StepError) -> float:
    """Mean square of what one error differs by from another at the same times, in the unit squared, beside what single responses differ by.

    before: of a step that was repeated, whose variance stands for that of one that was not. Chance may make it negative; NaN where they
    have no time in common.
    """
    first, last = max(now.first, before.first), min(now.first + now.mean.size, before.first + before.mean.size)
    apart = now.mean[first - now.first : last - now.first] - before.mean[first - before.first : last - before.first]
    if not np.isfinite(apart).any():
        return math.nan
    of_now = before.variance if math.isnan(now.variance) else now.variance
    return float(np.nanmean(apart**2)) - of_now / now.responses - before.variance / before.responses


def rows_of(errors: Iterable[StepError]) -> list[LeftRow]:
    """For model.yaml: of every channel in every kind of maneuver in which repeats share more than chance makes of it."""
    places: dict[tuple[str, str], list[StepError]] = {}
    for e in errors:
        if math.isfinite(e.variance):
            places.setdefault((e.channel, e.kind), []).append(e)
    return [_row(e) for same in places.values() if sum(e.power for e in same) > 0.0 for e in same]


def _row(e: StepError) -> LeftRow:
    return {
        "channel": e.channel,
        "kind": e.kind,
        "cell": {k: float(f"{v:.6g}") for k, v in e.cell.items()},
        "responses": e.responses,
        "first": e.first,
        "variance": float(f"{e.variance:.3g}"),
        "mean": [float(f"{v:.2g}") if math.isfinite(v) else None for v in e.mean],
    }


def errors_from(rows: object) -> tuple[StepError, ...]:
    """What `rows_of` wrote; nothing where a model was written without it."""
    return tuple(_error(row) for row in rows) if isinstance(rows, Sequence) else ()


def _error(row: Mapping[str, Any]) -> StepError:
    mean = np.array([math.nan if v is None else float(v) for v in row["mean"] or ()])
    cell = {str(k): float(v) for k, v in (row["cell"] or {}).items()}
    count, first, variance = int(row["responses"]), int(row["first"]), float(row["variance"])
    return StepError(str(row["channel"]), str(row["kind"]), cell, count, first, mean, variance)
