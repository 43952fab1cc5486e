"""What the pages about a fit show, as plain values; `pipeline` fills them from whatever computed them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from flighttest.identify.response_analysis.comparison import FittedResponse, ResponseOverlay, ThrustPoint
from flighttest.identify.response_analysis.frequency_response import FrequencyResponse, ResidualCorrelation
from flighttest.identify.validation.accumulation import Accumulation


@dataclass(frozen=True)
class ParameterView:
    """One parameter. known: identifiable; word: 'known', 'weak', 'not identifiable', 'held'; remedy: what would make it known."""

    name: str
    unit: str
    value: float
    std: float | None
    low: float | None
    high: float | None
    known: bool
    word: str
    remedy: str = ""
    source: str = "fit"
    doc: str = ""


@dataclass(frozen=True)
class SegmentView:
    """One row of the segment table."""

    name: str
    run: str
    kind: str
    cell: Mapping[str, float]
    repeat: int
    flaws: tuple[str, ...]
    notes: tuple[str, ...]
    metrics: Mapping[str, float | None] = field(default_factory=dict)
    outlier: str = ""


@dataclass(frozen=True)
class QualityView:
    """How well one channel is described: RMSE and noise floor in its unit, share of variance explained, in words."""

    channel: str
    unit: str
    rmse: float
    floor: float
    r2: float
    clean: bool
    sentence: str


@dataclass(frozen=True)
class FitView:
    """A fit as it is shown."""

    verdict: str
    good: bool
    parameters: tuple[ParameterView, ...]
    overlays: tuple[ResponseOverlay, ...] = ()
    thrust_points: tuple[ThrustPoint, ...] = ()
    segments: tuple[SegmentView, ...] = ()
    correlations: tuple[tuple[str, str, float], ...] = ()
    correlation_above: float = 0.9
    quality: tuple[QualityView, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    responses: tuple[FittedResponse, ...] = ()
    residual_correlations: tuple[ResidualCorrelation, ...] = ()
    loops: tuple[FrequencyResponse, ...] = ()
    trajectories: tuple[Accumulation, ...] = ()
