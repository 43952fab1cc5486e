"""What the pages about a fit show, as plain values; `pipeline` fills them from whatever computed them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


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
class Overlay:
    """One response, measured and simulated. t_s counts from the step."""

    segment: str
    kind: str
    cell: Mapping[str, float]
    channel: str
    t_s: FloatArray
    measured: FloatArray
    simulated: FloatArray


@dataclass(frozen=True)
class ThrustPoint:
    """The settled vertical acceleration of one throttle response against the battery's voltage."""

    cell: Mapping[str, float]
    voltage_v: float
    measured: float
    simulated: float


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
class ChannelOfResponse:
    """One output of one response: (n,) measured and simulated at t_s since the step; floor: its noise, unit of the channel."""

    channel: str
    t_s: FloatArray
    measured: FloatArray
    simulated: FloatArray
    floor: float


@dataclass(frozen=True)
class ResponseView:
    """One response with its commands (n,) at t_s since the step, and every output."""

    name: str
    t_s: FloatArray
    commands: Mapping[str, FloatArray]
    channels: tuple[ChannelOfResponse, ...]


@dataclass(frozen=True)
class CorrelationView:
    """Correlation (n,) of a channel's residual with itself and with the command, by lag_s (n,); band: 1.96 standard errors of white
    noise."""

    channel: str
    lag_s: FloatArray
    auto: FloatArray
    cross: FloatArray
    band: float


@dataclass(frozen=True)
class LoopView:
    """Complex frequency response (n,) of one loop, measured and by the model, with the coherence of the measured one."""

    title: str
    command_unit: str
    answer_unit: str
    responses: int
    frequency_hz: FloatArray
    measured: NDArray[np.complex128]
    model: NDArray[np.complex128]
    coherence: FloatArray


@dataclass(frozen=True)
class FitView:
    """A fit as it is shown."""

    verdict: str
    good: bool
    parameters: tuple[ParameterView, ...]
    overlays: tuple[Overlay, ...] = ()
    thrust_points: tuple[ThrustPoint, ...] = ()
    segments: tuple[SegmentView, ...] = ()
    correlations: tuple[tuple[str, str, float], ...] = ()
    correlation_above: float = 0.9
    quality: tuple[QualityView, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    responses: tuple[ResponseView, ...] = ()
    residual_correlations: tuple[CorrelationView, ...] = ()
    loops: tuple[LoopView, ...] = ()
