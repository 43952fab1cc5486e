"""Each response of a fit as it is shown by itself; of all of them, correlations of residuals, frequency responses (Bode) and coherence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS, INPUTS, WORDS
from flighttest.estimation.problem import Part, PartEvaluation
from flighttest.estimation.responses import zero_order_hold
from flighttest.identify.fit import Fit
from flighttest.report.views import ChannelOfResponse, CorrelationView, LoopView, ResponseView
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

MOST_RESPONSES = 24  # shown one by one, spread over all
MOST_LAG_S = 1.0
LEAST_PAIRS = 50  # samples that a correlation rests on
LEAST_RESPONSES = 3  # of which a coherence says something
LEAST_POWER = 1e-3  # of the command's largest: between its harmonics it excites nothing
FREQUENCIES_HZ = np.geomspace(0.3, 12.0, 48)
# What is stepped, what answers it, in which kinds of response.
LOOPS = (
    ("roll loop", "roll_ref_rad", "roll_rad", ("roll_step",)),
    ("pitch loop", "pitch_ref_rad", "pitch_rad", ("pitch_step",)),
    ("yaw rate loop", "yaw_rate_ref_rad_s", "r_rad_s", ("yaw_rate_step",)),
    ("thrust", "throttle", "f_z_m_s2", ("throttle_step", "tilt_throttle")),
)
_Piece = tuple[Segment, Part, FloatArray, FloatArray, FloatArray]


def _pieces(found: Fit) -> Iterator[_Piece]:
    """(segment, part, t_s (n,), measured (n, outputs), simulated (n, outputs)) of every response in every block; NaN where masked."""
    for part, made in zip(found.problem.parts, found.solution.evaluations, strict=True):
        for j, response in enumerate(part.responses):
            measured, residual = _of(part, made, j)
            yield found.problem.segments[response.index], part, response.t_s, measured, measured - residual


def _of(part: Part, made: PartEvaluation, j: int) -> tuple[FloatArray, FloatArray]:
    n = part.responses[j].t_s.size
    mask = part.mask[j, :n]
    return np.where(mask, part.y[j, :n], np.nan), np.where(mask, made.residual[j, :n], np.nan)


def response_views(found: Fit) -> tuple[ResponseView, ...]:
    """Command, measured, model and what is left, of responses spread over all of them."""
    floors = {c: q.floor for c, q in found.quality.items()}
    by_segment: dict[int, list[_Piece]] = {}
    order: dict[int, Segment] = {}
    for piece in _pieces(found):
        order[id(piece[0])] = piece[0]
        by_segment.setdefault(id(piece[0]), []).append(piece)
    chosen = list(order)
    chosen = chosen[:: max(1, -(-len(chosen) // MOST_RESPONSES))]
    views = []
    for key in chosen:
        segment = order[key]
        channels = [
            ChannelOfResponse(c, t - segment.t_step_s, measured[:, k], simulated[:, k], floors.get(c, float("nan")))
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
        views.append(ResponseView(f"{segment.run}: {segment.name}", grid, commands, tuple(channels)))
    return tuple(views)


def correlations(found: Fit) -> tuple[CorrelationView, ...]:
    """Per channel: autocorrelation of its residual and cross-correlation with the command, by lag, over all responses."""
    sums: dict[str, dict[str, FloatArray]] = {}
    step_s = _usual_step(found)
    lags = np.arange(round(MOST_LAG_S / step_s) + 1)
    for segment, part, t, measured, simulated in _pieces(found):
        for k, channel in enumerate(part.outputs):
            grid = np.arange(t[0], t[-1], step_s)
            left = measured[:, k] - simulated[:, k]
            good = np.isfinite(left)
            if good.sum() < 4:
                continue
            e = np.interp(grid, t[good], left[good])
            command = _command_of(channel)
            u = zero_order_hold(segment.u.get(command), grid) if command in segment.u else np.zeros(grid.size)
            u = u - u.mean()
            kept = sums.setdefault(channel, {name: np.zeros(lags.size) for name in ("auto", "cross", "n")})
            for lag in lags[: max(grid.size - 2, 0)]:
                kept["auto"][lag] += float(e[: e.size - lag] @ e[lag:])
                kept["cross"][lag] += float(u[: u.size - lag] @ e[lag:])
                kept["n"][lag] += e.size - lag
            kept["e2"] = kept.get("e2", np.zeros(1)) + float(e @ e)
            kept["u2"] = kept.get("u2", np.zeros(1)) + float(u @ u)
    views = []
    for channel, kept in sums.items():
        energy, driven = float(kept["e2"][0]), float(kept["u2"][0])
        if kept["n"][0] < LEAST_PAIRS or energy <= 0.0:
            continue
        cross = kept["cross"] / np.sqrt(energy * driven) if driven > 0.0 else np.full(lags.size, np.nan)
        band = 1.96 / np.sqrt(kept["n"][0])
        views.append(
            CorrelationView(
                WORDS.get(channel, channel),
                np.asarray(lags * step_s, dtype=float),
                kept["auto"] / energy,
                cross,
                float(band),
            )
        )
    return tuple(views)


def _command_of(channel: str) -> str:
    """The command whose change an output answers first."""
    direct = {"roll_rad": "roll_ref_rad", "pitch_rad": "pitch_ref_rad", "r_rad_s": "yaw_rate_ref_rad_s",
              "v_x_m_s": "pitch_ref_rad", "f_x_m_s2": "pitch_ref_rad", "v_y_m_s": "roll_ref_rad", "f_y_m_s2": "roll_ref_rad"}  # fmt: skip
    return direct.get(channel, "throttle")


def _usual_step(found: Fit) -> float:
    steps = [float(np.median(np.diff(r.t_s))) for part in found.problem.parts for r in part.responses if r.t_s.size > 1]
    return max(float(np.median(steps)), 0.005)


def loops(found: Fit) -> tuple[LoopView, ...]:
    """Frequency response from command to answer, measured and simulated alike (H1 estimate: cross over input spectrum, summed over
    responses), and the coherence of the measured one. Spectra are of the changes, so that steps need no window."""
    pieces = list(_pieces(found))
    views = []
    for title, command, channel, kinds in LOOPS:
        rows = [
            (_spectrum(*_changes(segment, command, t)), _answer(t, measured[:, k]), _answer(t, simulated[:, k]))
            for segment, part, t, measured, simulated in pieces
            if segment.kind in kinds and command in segment.u and channel in part.outputs
            for k in [part.outputs.index(channel)]
            if np.isfinite(measured[:, k]).mean() > 0.9
        ]
        if len(rows) < LEAST_RESPONSES:
            continue
        u, y, m = (np.array(each) for each in zip(*rows, strict=True))
        power = (np.abs(u) ** 2).sum(axis=0)
        moved = power > LEAST_POWER * power.max()
        if moved.sum() < FREQUENCIES_HZ.size / 2:
            continue
        f, u, y, m, power = FREQUENCIES_HZ[moved], u[:, moved], y[:, moved], m[:, moved], power[moved]
        cross, model = (np.conj(u) * y).sum(axis=0), (np.conj(u) * m).sum(axis=0)
        coherence = np.abs(cross) ** 2 / (power * (np.abs(y) ** 2).sum(axis=0))
        views.append(
            LoopView(
                title,
                CHANNELS[command].unit,
                CHANNELS[channel].unit,
                len(rows),
                f,
                cross / power,
                model / power,
                coherence,
            )
        )
    return tuple(views)


def _changes(segment: Segment, command: str, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and sizes of the command's changes within the response."""
    times, values = segment.u[command]
    jumps = np.diff(values)
    inside = (times[1:] >= t[0]) & (times[1:] <= t[-1]) & (jumps != 0.0)
    return times[1:][inside], jumps[inside]


def _answer(t: FloatArray, values: FloatArray) -> NDArray[np.complex128]:
    good = np.isfinite(values)
    return _spectrum(0.5 * (t[good][1:] + t[good][:-1]), np.diff(values[good]))


def _spectrum(times: FloatArray, changes: FloatArray) -> NDArray[np.complex128]:
    """Fourier transform (n_frequencies,) of changes at uneven times."""
    return np.asarray(np.exp(-2j * np.pi * np.outer(FREQUENCIES_HZ, times)) @ changes)


def views_of(found: Fit) -> tuple[Sequence[ResponseView], Sequence[CorrelationView], Sequence[LoopView]]:
    """All three."""
    return response_views(found), correlations(found), loops(found)
