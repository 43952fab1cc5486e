"""How well a fit describes the data it was made from, and the range it was made in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.problem import Problem
from flighttest.estimation.solver import Solution

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelQuality:
    """rmse, floor: in the channel's unit (floor: what is left of the residual when its slow part is taken away); r2: share of variance
    explained; autocorrelation: of neighbouring residuals; count: samples."""

    rmse: float
    floor: float
    r2: float
    autocorrelation: float
    count: int

    @property
    def missed(self) -> float:
        """Share of variance that is neither explained nor noise."""
        return (1.0 - self.r2) * max(1.0 - (self.floor / self.rmse) ** 2, 0.0) if self.rmse > 0 else 0.0

    @property
    def sentence(self) -> str:
        """Whiteness in words."""
        if self.autocorrelation < 0.2:
            return "the residual looks like noise"
        if self.rmse < 1.5 * self.floor:
            return "the residual changes slowly, but is hardly larger than the noise"
        ratio = self.rmse / max(self.floor, 1e-12)
        return f"the residual changes slowly and is {ratio:.1f} times the noise: slow noise, or something that the model lacks"


@dataclass(frozen=True)
class ValidRange:
    """What the data covered, as in model.yaml; None where it was not measured."""

    tilt_max_rad: float | None
    speed_max_m_s: float | None
    voltage_v: tuple[float, float] | None
    height_m: tuple[float, float] | None
    yaw_rate_max_rad_s: float | None
    throttle: tuple[float, float] | None


def noise_floor(residual: FloatArray) -> float:
    """Std of the fast part of a residual, from second differences (exact for white noise on any straight line)."""
    d = np.diff(residual[np.isfinite(residual)], 2)
    return float(np.sqrt(np.mean(d**2) / 6.0)) if d.size else float("nan")


def channel_quality(problem: Problem, solution: Solution) -> dict[str, ChannelQuality]:
    """Per measured channel, over all responses that feed its block."""
    found: dict[str, ChannelQuality] = {}
    for part, made in zip(problem.parts, solution.evaluations, strict=True):
        for k, channel in enumerate(part.outputs):
            rows = [made.residual[j, part.mask[j, :, k], k] for j in range(len(part.responses))]
            measured = [part.y[j, part.mask[j, :, k], k] for j in range(len(part.responses))]
            rows, measured = [r for r in rows if r.size], [y for y in measured if y.size]
            if not rows:
                continue
            every, y = np.concatenate(rows), np.concatenate(measured)
            squares = float(every @ every)
            floors = [noise_floor(r) for r in rows if r.size > 4]
            pairs = sum(float(r[1:] @ r[:-1]) for r in rows)
            spread = float(((y - y.mean()) ** 2).sum())
            found[channel] = ChannelQuality(
                rmse=float(np.sqrt(squares / every.size)),
                floor=float(np.sqrt(np.mean(np.square(floors)))) if floors else float("nan"),
                r2=1.0 - squares / spread if spread > 0 else float("nan"),
                autocorrelation=pairs / squares if squares > 0 else 0.0,
                count=int(every.size),
            )
    return found


def valid_range(problem: Problem) -> ValidRange:
    """Extremes over the segments used (99.5 % of the samples, so that a spike does not widen it)."""
    used = sorted({r.index for part in problem.parts for r in part.responses})
    segments = [problem.segments[i] for i in used]

    def gather(*names: str) -> FloatArray | None:
        rows = [np.stack([s.y[n] for n in names], axis=1) for s in segments if all(n in s.y for n in names)]
        if not rows:
            return None
        stacked = np.concatenate(rows)
        stacked = stacked[np.isfinite(stacked).all(axis=1)]
        return stacked if stacked.size else None

    def span(values: FloatArray | None) -> tuple[float, float] | None:
        if values is None:
            return None
        low, high = np.percentile(values, [0.25, 99.75])
        return float(low), float(high)

    def top(values: FloatArray | None) -> float | None:
        return None if values is None else float(np.percentile(np.abs(values), 99.5))

    tilt, velocity = gather("roll_rad", "pitch_rad"), gather("v_x_m_s", "v_y_m_s", "v_z_m_s")
    throttle = [s.u["throttle"][1][s.u["throttle"][0] > s.t_s[0] - 0.3] for s in segments if "throttle" in s.u]
    levels = np.concatenate(throttle) if throttle else np.empty(0)
    return ValidRange(
        tilt_max_rad=top(None if tilt is None else np.arccos(np.cos(tilt[:, 0]) * np.cos(tilt[:, 1]))),
        speed_max_m_s=top(None if velocity is None else np.linalg.norm(velocity, axis=1)),
        voltage_v=span(gather("voltage_v")),
        height_m=span(gather("height_m") if any("height_m" in s.y for s in segments) else gather("p_z_m")),
        yaw_rate_max_rad_s=top(gather("r_rad_s")),
        throttle=(float(levels.min()), float(levels.max())) if levels.size else None,
    )
