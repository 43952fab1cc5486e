"""Over all responses of a fit: correlations of residuals, frequency responses (transfer function estimates, Bode) of measurement and
model, and coherence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import REFERENCE_OF
from flighttest.estimation.responses import zero_order_hold
from flighttest.identify.fit import Fit
from flighttest.identify.response_analysis.comparison import pieces
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

MOST_LAG_S = 1.0
LEAST_PAIRS = 50  # samples that a correlation rests on
LEAST_RESPONSES = 3  # needed for a coherence
LEAST_POWER = 1e-3  # of the command's largest: between its harmonics it excites nothing
FREQUENCIES_HZ = np.geomspace(0.3, 12.0, 48)
# What is stepped, what answers it, in which kinds of response.
LOOPS = (
    ("roll loop", "roll_ref_rad", "roll_rad", ("roll_step",)),
    ("pitch loop", "pitch_ref_rad", "pitch_rad", ("pitch_step",)),
    ("yaw rate loop", "yaw_rate_ref_rad_s", "r_rad_s", ("yaw_rate_step",)),
    ("thrust", "throttle", "f_z_m_s2", ("throttle_step", "tilt_throttle")),
)


@dataclass(frozen=True)
class ResidualCorrelation:
    """Correlation (n,) of a channel's residual with itself and with the command, by lag_s (n,); band: 1.96 standard errors of white
    noise."""

    channel: str
    lag_s: FloatArray
    auto: FloatArray
    cross: FloatArray
    band: float


@dataclass(frozen=True)
class FrequencyResponse:
    """Complex frequency response (n,) of one loop from channel `command` to channel `answer`, measured and by the model, with the
    coherence of the measured one; responses: how many it rests on."""

    loop: str
    command: str
    answer: str
    responses: int
    frequency_hz: FloatArray
    measured: NDArray[np.complex128]
    model: NDArray[np.complex128]
    coherence: FloatArray

    @property
    def gain_db(self) -> tuple[FloatArray, FloatArray]:
        """Amplitude (n,) of measurement and model, dB."""
        return _decibel(self.measured), _decibel(self.model)

    @property
    def phase_deg(self) -> tuple[FloatArray, FloatArray]:
        """Phase (n,) of measurement and model, degrees, without jumps of 360."""
        return _degrees(self.measured), _degrees(self.model)


def _decibel(h: NDArray[np.complex128]) -> FloatArray:
    return np.asarray(20.0 * np.log10(np.abs(h)))


def _degrees(h: NDArray[np.complex128]) -> FloatArray:
    return np.asarray(np.degrees(np.unwrap(np.angle(h))))


def residual_correlations(found: Fit) -> tuple[ResidualCorrelation, ...]:
    """Per channel: autocorrelation of its residual and cross-correlation with the command, by lag, over all responses."""
    sums: dict[str, dict[str, FloatArray]] = {}
    step_s = _usual_step(found)
    lags = np.arange(round(MOST_LAG_S / step_s) + 1)
    for segment, part, t, measured, simulated in pieces(found):
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
            ResidualCorrelation(
                channel,
                np.asarray(lags * step_s, dtype=float),
                kept["auto"] / energy,
                cross,
                float(band),
            )
        )
    return tuple(views)


def _command_of(channel: str) -> str:
    """The command whose change an output answers first."""
    direct = REFERENCE_OF | {
        "v_x_m_s": "pitch_ref_rad", "f_x_m_s2": "pitch_ref_rad", "v_y_m_s": "roll_ref_rad", "f_y_m_s2": "roll_ref_rad",
    }  # fmt: skip
    return direct.get(channel, "throttle")


def _usual_step(found: Fit) -> float:
    steps = [float(np.median(np.diff(r.t_s))) for part in found.problem.parts for r in part.responses if r.t_s.size > 1]
    return max(float(np.median(steps)), 0.005)


def frequency_responses(found: Fit) -> tuple[FrequencyResponse, ...]:
    """Frequency response from command to answer, measured and simulated alike (H1 estimate: cross over input spectrum, summed over
    responses), and the coherence of the measured one. Spectra are of the changes, so that steps need no window."""
    every = list(pieces(found))
    views = []
    for title, command, channel, kinds in LOOPS:
        rows = [
            (_spectrum(*_changes(segment, command, t)), _answer(t, measured[:, k]), _answer(t, simulated[:, k]))
            for segment, part, t, measured, simulated in every
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
            FrequencyResponse(
                title,
                command,
                channel,
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
