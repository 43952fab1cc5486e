"""Measured and simulated responses of a fit: each by itself, laid over each other by kind, and settled thrust over voltage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import INPUTS
from flighttest.estimation.problem import Part
from flighttest.estimation.responses import zero_order_hold
from flighttest.frames import G_M_S2
from flighttest.identify.fit import Fit
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

MOST_RESPONSES = 24  # given one by one, spread over all
MAX_OVERLAYS = 40  # per kind: more lines than that are a grey cloud, and megabytes of page
SETTLED_SHARE = 0.3  # the last part of a throttle response that counts as settled
_SPECIFIC_FORCE = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
ResponsePiece = tuple[Segment, Part, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class FittedChannel:
    """One output of one response: (n,) measured and simulated at t_s since the step; floor: its noise, unit of the channel."""

    channel: str
    t_s: FloatArray
    measured: FloatArray
    simulated: FloatArray
    floor: float


@dataclass(frozen=True)
class FittedResponse:
    """One response with its commands (n,) at t_s since the step, and every output."""

    name: str
    t_s: FloatArray
    commands: Mapping[str, FloatArray]
    channels: tuple[FittedChannel, ...]


@dataclass(frozen=True)
class ResponseOverlay:
    """The stepped channel of one response, (n,) measured and simulated, or the world's vertical acceleration. t_s counts from the step."""

    segment: str
    kind: str
    cell: Mapping[str, float]
    channel: str
    t_s: FloatArray
    measured: FloatArray
    simulated: FloatArray


@dataclass(frozen=True)
class ThrustPoint:
    """The settled vertical acceleration, m/s^2, of one throttle response against the battery's voltage."""

    cell: Mapping[str, float]
    voltage_v: float
    measured: float
    simulated: float


def pieces(found: Fit) -> Iterator[ResponsePiece]:
    """(segment, part, t_s (n,), measured (n, outputs), simulated (n, outputs)) of every response in every block; NaN where masked."""
    for part, made in zip(found.problem.parts, found.solution.evaluations, strict=True):
        for j, response in enumerate(part.responses):
            n, mask = response.t_s.size, part.mask[j, : response.t_s.size]
            measured = np.where(mask, part.y[j, :n], np.nan)
            yield found.problem.segments[response.index], part, response.t_s, measured, measured - made.residual[j, :n]


def fitted_responses(found: Fit) -> tuple[FittedResponse, ...]:
    """Command, measured, model and what is left, of responses spread over all of them."""
    floors = {c: q.floor for c, q in found.quality.items()}
    by_segment: dict[int, list[ResponsePiece]] = {}
    order: dict[int, Segment] = {}
    for piece in pieces(found):
        order[id(piece[0])] = piece[0]
        by_segment.setdefault(id(piece[0]), []).append(piece)
    chosen = list(order)
    chosen = chosen[:: max(1, -(-len(chosen) // MOST_RESPONSES))]
    views = []
    for key in chosen:
        segment = order[key]
        channels = [
            FittedChannel(c, t - segment.t_step_s, measured[:, k], simulated[:, k], floors.get(c, float("nan")))
            for _, part, t, measured, simulated in by_segment[key]
            for k, c in enumerate(part.outputs)
            if np.isfinite(measured[:, k]).any()
        ]
        grid = segment.t_s - segment.t_step_s
        commands = {}
        for name in (n for n in INPUTS if n in segment.u):
            values = zero_order_hold(segment.u[name], segment.t_s)
            if np.ptp(values) > 0.0 or name == "throttle":
                commands[name] = values
        views.append(FittedResponse(f"{segment.run}: {segment.name}", grid, commands, tuple(channels)))
    return tuple(views)


def response_overlays(found: Fit) -> tuple[ResponseOverlay, ...]:
    """Measured and simulated responses, at most `MAX_OVERLAYS` per kind, spread over the cells."""
    return tuple(_thinned([one for piece in pieces(found) if (one := _overlay_of(*piece)) is not None]))


def _overlay_of(
    segment: Segment, part: Part, t: FloatArray, measured: FloatArray, simulated: FloatArray
) -> ResponseOverlay | None:
    wanted = {"roll_step": "roll_rad", "pitch_step": "pitch_rad", "yaw_rate_step": "r_rad_s"}.get(segment.kind)
    both: tuple[FloatArray, FloatArray] | None = None
    if wanted in part.outputs:
        k = part.outputs.index(wanted)
        channel, both = wanted, (measured[:, k], simulated[:, k])
    elif segment.kind in ("throttle_step", "tilt_throttle", "free"):
        channel, both = "a_z_m_s2", _vertical(segment, part, measured, simulated)
    if both is None:
        return None
    return ResponseOverlay(segment.name, segment.kind, segment.cell, channel, t - segment.t_step_s, *both)


def _vertical(
    segment: Segment, part: Part, measured: FloatArray, simulated: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Measured and simulated world a_z of one response, from the body specific force and the measured attitude."""
    roll, pitch = segment.y.get("roll_rad"), segment.y.get("pitch_rad")
    if roll is None or pitch is None or roll.size != len(measured) or not set(_SPECIFIC_FORCE) <= set(part.outputs):
        return None
    index = [part.outputs.index(c) for c in _SPECIFIC_FORCE]
    up = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    return (up * measured[:, index]).sum(axis=1) - G_M_S2, (up * simulated[:, index]).sum(axis=1) - G_M_S2


def _thinned(made: Sequence[ResponseOverlay]) -> list[ResponseOverlay]:
    kept: list[ResponseOverlay] = []
    for kind in dict.fromkeys(o.kind for o in made):
        mine = [o for o in made if o.kind == kind]
        step = max(1, -(-len(mine) // MAX_OVERLAYS))
        kept += mine[::step]
    return kept


def thrust_points(found: Fit) -> tuple[ThrustPoint, ...]:
    """Settled acceleration over voltage, per throttle response."""
    points = []
    for segment, part, t, measured, simulated in pieces(found):
        volts = segment.y.get("voltage_v")
        if segment.kind != "throttle_step" or volts is None:
            continue
        if (both := _vertical(segment, part, measured, simulated)) is None:
            continue
        late = t > t[-1] - SETTLED_SHARE * (t[-1] - segment.t_step_s)
        late &= np.isfinite(both[0]) & np.isfinite(volts)
        if late.sum() >= 3:
            settled = [float(one[late].mean()) for one in (volts, *both)]
            points.append(ThrustPoint(segment.cell, settled[0], settled[1], settled[2]))
    return tuple(points)
