"""The paper's equations as the oracle integrates them: linear filters on responses side by side."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from flighttest.frames import G_M_S2
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

STEP_S = 0.02  # responses are compared on this grid
PARTS = 4  # inputs are held for a part of it
TILTED = ("roll_step", "pitch_step", "tilt_throttle")


def recorded_in(segment: Segment, channel: str) -> bool:
    """Whether a segment has a channel."""
    return channel in segment.y and bool(np.isfinite(segment.y[channel]).sum() > 1)


def feeds(segment: Segment, block: OracleBlock) -> bool:
    """Whether a response moves what a block describes, its inputs are known and some of its channels were recorded."""
    moved = not block.kinds or segment.kind in (*block.kinds, "free")
    return moved and set(block.inputs) <= set(segment.u) and any(recorded_in(segment, c) for c in block.channels)


def profiled(
    residual: FloatArray, free: FloatArray, disturbed: FloatArray, whiten: FloatArray, spread: float
) -> tuple[FloatArray, FloatArray]:
    """Of m responses (m, n, c): what is left, whitened, with initial states (m, n, c, k) and disturbances (m, n, c, j) at their likeliest,
    and the disturbances (m, j)."""
    m, k, j = residual.shape[0], free.shape[3], disturbed.shape[3]
    columns = (np.concatenate([free, disturbed], axis=3) * whiten[..., None]).reshape(m, -1, k + j)
    white = (residual * whiten).reshape(m, -1)
    gram = np.matmul(columns.transpose(0, 2, 1), columns)
    gram += np.diag([0.0] * k + [spread**-2] * j) + 1e-9 * np.eye(k + j)
    local = np.linalg.solve(gram, np.einsum("mnk,mn->mk", columns, white)[..., None])
    return (white - np.matmul(columns, local)[..., 0]).reshape(residual.shape), local[:, k:, 0]


class OracleResponses:
    """Responses side by side: t_s (m, n) since the step, n of each, mask (m, n) where they last; channels hold their last value after."""

    def __init__(self, segments: Sequence[Segment]) -> None:
        since = [s.t_s - s.t_step_s for s in segments]
        first = [int(np.ceil(t[0] / STEP_S)) for t in since]
        self.n = [int(np.floor(t[-1] / STEP_S)) + 1 - k for t, k in zip(since, first, strict=True)]
        self.t_s = (np.array(first)[:, None] + np.arange(max(self.n))) * STEP_S
        self.mask = np.arange(max(self.n)) < np.array(self.n)[:, None]
        self.kinds = [s.kind for s in segments]
        self._segments, self._since = segments, since
        self._sampled: dict[str, FloatArray] = {}
        self._held: dict[str, tuple[float, FloatArray]] = {}  # most steps of a fit leave the delay as it is

    def recorded(self, channel: str) -> NDArray[np.bool_]:
        """(m,) whether a channel was recorded in each."""
        return np.array([recorded_in(s, channel) for s in self._segments])

    def y(self, channel: str, unrecorded: float = 0.0) -> FloatArray:
        """(m, n) what was measured."""
        if channel not in self._sampled:
            self._sampled[channel] = self._on_grid(channel, unrecorded)
        return self._sampled[channel]

    @cached_property
    def turn(self) -> FloatArray:
        """(m, n, 3, 3) body to world; level where half an attitude, which is none, was recorded."""
        level = ~(self.recorded("roll_rad") & self.recorded("pitch_rad"))[:, None]
        roll, pitch = (np.where(level, 0.0, self.y(f"{axis}_rad")) for axis in ("roll", "pitch"))
        return body_to_world(roll, pitch, self.y("yaw_rad"))

    def _on_grid(self, channel: str, unrecorded: float) -> FloatArray:
        rows = []
        for s, since, at in zip(self._segments, self._since, self.t_s, strict=True):
            if recorded_in(s, channel):
                known = np.isfinite(s.y[channel])
                rows.append(np.interp(at, since[known], s.y[channel][known]))
            else:
                rows.append(np.full(at.size, unrecorded))
        return np.array(rows)

    def held(self, channel: str, delay_s: float, own: str = "") -> FloatArray:
        """(m, parts) mean of a delayed input over every part. What is held has an exact integral, smooth in the delay.
        own: a channel of the autopilot that takes the input's place where it was recorded."""
        key = own or channel
        if key not in self._held or self._held[key][0] != delay_s:
            self._held[key] = delay_s, self._held_anew(channel, delay_s, own)
        return self._held[key][1]

    def _held_anew(self, channel: str, delay_s: float, own: str) -> FloatArray:
        rows = []
        for s, at in zip(self._segments, self.t_s, strict=True):
            edges, value = s.u[channel]
            if recorded_in(s, own):
                known = np.isfinite(s.y[own])
                edges, value = s.t_s[known], s.y[own][known]
            ends = at[0] + np.arange(PARTS * (at.size - 1) + 1) * (STEP_S / PARTS) - delay_s
            knots = edges - s.t_step_s
            knots = np.concatenate([[min(knots[0], ends[0]) - 1.0], knots[1:], [max(knots[-1], ends[-1]) + 1.0]])
            area = np.concatenate([[0.0], np.cumsum(np.diff(knots) * value)])
            rows.append(np.diff(np.interp(ends, knots, area)) / (STEP_S / PARTS))
        return np.array(rows)


def _answer(numerator: Sequence[float], denominator: Sequence[float], *held: FloatArray) -> list[FloatArray]:
    """(..., n) of a linear filter at rest to each of some inputs (..., parts) held over parts."""
    b, a, _ = cont2discrete((numerator, denominator), STEP_S / PARTS)
    after = (np.concatenate([one, one[..., -1:]], axis=-1) for one in held)
    return [np.asarray(lfilter(np.ravel(b), a, one)[..., ::PARTS]) for one in after]


class OracleBlock(ABC):
    """Part of the base model, on the kinds of response that feed it (all, where none are named)."""

    name: str
    channels: tuple[str, ...]
    inputs: tuple[str, ...]
    kinds: tuple[str, ...] = ()
    bounds: tuple[Sequence[float], Sequence[float]]

    @abstractmethod
    def start(self, r: OracleResponses) -> Sequence[float]:
        """Where a fit begins."""

    @abstractmethod
    def of(self, r: OracleResponses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(m, n, c) residual from rest, (m, n, c, k) what initial states of one add, (m, n, c, j) what disturbances of one add."""


class RollPitchLoops(OracleBlock):
    """phi'' = omega^2 (phi_ref(t - T) + d - phi) - 2 zeta omega phi', pitch alike; theta: omega, zeta of both, T.
    phi_ref: what the loops follow, the autopilot's own target behind its shaping where that was recorded, or the reference itself:
    by_reference. A target as sampled steps up to a sample late, and loops that follow it at once have no delay to make up for that."""

    name, channels, kinds = "roll_pitch", ("roll_rad", "pitch_rad"), TILTED
    inputs = ("roll_ref_rad", "pitch_ref_rad")
    bounds = ((1.0, 0.02, 1.0, 0.02, 0.0), (120.0, 3.0, 120.0, 3.0, 0.4))

    def __init__(self, by_reference: bool = False) -> None:
        self.by_reference = by_reference

    def start(self, r: OracleResponses) -> Sequence[float]:
        """As `OracleBlock.start`."""
        return 12.0, 0.7, 12.0, 0.7, 0.08

    def of(self, r: OracleResponses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `OracleBlock.of`."""
        m, n = r.t_s.shape
        residual, free, disturbed = np.zeros((m, n, 2)), np.zeros((m, n, 2, 4)), np.zeros((m, n, 2, 2))
        for k, axis in enumerate(("roll", "pitch")):
            omega, zeta = theta[2 * k], theta[2 * k + 1]
            poles = (1.0, 2.0 * zeta * omega, omega**2)
            asked = r.held(f"{axis}_ref_rad", theta[4], "" if self.by_reference else f"{axis}_shaped_rad")
            answer, step = _answer((omega**2,), poles, asked, np.ones(PARTS * (n - 1)))
            residual[..., k] = r.y(f"{axis}_rad") - answer
            disturbed[..., k, k] = step
            # From an angle of one: what a step asks back; from a rate of one: the answer to a push.
            free[..., k, 2 * k] = 1.0 - step
            free[..., k, 2 * k + 1] = np.gradient(step, STEP_S)
        return residual, free, disturbed


class YawLoop(OracleBlock):
    """r' = sigma (r_ref(t - T) + d - r); theta: sigma, T."""

    name, channels, kinds, inputs = "yaw", ("r_rad_s",), ("yaw_rate_step",), ("yaw_rate_ref_rad_s",)
    bounds = ((0.3, 0.0), (150.0, 0.4))

    def start(self, r: OracleResponses) -> Sequence[float]:
        """As `OracleBlock.start`."""
        return 6.0, 0.08

    def of(self, r: OracleResponses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `OracleBlock.of`."""
        (answer,) = _answer((theta[0],), (1.0, theta[0]), r.held("yaw_rate_ref_rad_s", theta[1]))
        decay = np.exp(-theta[0] * (r.t_s - r.t_s[:, :1]))[..., None, None]
        return (r.y("r_rad_s") - answer)[..., None], decay, 1.0 - decay


class Translation(OracleBlock):
    """a' = sigma (K (U/U_n)^alpha T(t - T_d) - a); f = a e_z - D R'v + R'd; v' = R f - g; theta: sigma, K, alpha, T_d, D (3)."""

    name, inputs = "translation", ("throttle",)
    channels = tuple(f"{k}_{axis}_{unit}" for k, unit in (("f", "m_s2"), ("v", "m_s")) for axis in "xyz")
    bounds = ((0.5, 1.0, -10.0, 0.0, -5.0, -5.0, -5.0), (150.0, 2000.0, 10.0, 0.4, 5.0, 5.0, 5.0))

    def __init__(self, nominal_voltage_v: float) -> None:
        self.nominal_voltage_v = nominal_voltage_v

    def start(self, r: OracleResponses) -> Sequence[float]:
        """sigma_t, K, alpha, delay and drag to start from."""
        f, throttle = np.mean(r.y("f_z_m_s2"), axis=1), np.mean(r.held("throttle", 0.08), axis=1)
        lifts = np.where(r.recorded("f_z_m_s2"), f, G_M_S2)
        return 12.0, float(np.median(lifts / np.maximum(throttle, 0.01))), 1.5, 0.08, 0.3, 0.3, 0.3

    def of(self, r: OracleResponses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `OracleBlock.of`, drag and thrust in body axes and velocity in the world."""
        sigma, gain, alpha, delay, *drag = theta
        m, n = r.t_s.shape
        ratio = r.y("voltage_v", self.nominal_voltage_v) / self.nominal_voltage_v
        voltage = np.repeat(ratio**alpha, PARTS, axis=1)[:, : PARTS * (n - 1)]
        turn = r.turn
        back = turn.transpose(0, 1, 3, 2)
        v = np.stack([r.y(f"v_{axis}_m_s") for axis in "xyz"], axis=2)
        force = -np.asarray(drag) * np.matmul(back, v[..., None])[..., 0]
        (thrust,) = _answer((sigma,), (1.0, sigma), gain * voltage * r.held("throttle", delay))
        force[..., 2] += thrust
        residual, free, disturbed = np.zeros((m, n, 6)), np.zeros((m, n, 6, 4)), np.zeros((m, n, 6, 3))
        residual[..., :3] = np.stack([r.y(f"f_{axis}_m_s2") for axis in "xyz"], axis=2) - force
        residual[..., 3:] = v - _integral(np.matmul(turn, force[..., None])[..., 0] - (0.0, 0.0, G_M_S2))
        since = r.t_s - r.t_s[:, :1]
        free[..., 2, 3] = decay = np.exp(-sigma * since)
        free[..., 3:, 3] = _integral(turn[..., 2] * decay[..., None])
        free[..., 3:, :3] = np.eye(3)
        disturbed[..., :3, :] = back
        disturbed[..., 3:, :] = since[..., None, None] * np.eye(3)
        return residual, free, disturbed


def _integral(values: FloatArray) -> FloatArray:
    """(m, n, k) by the trapezoidal rule, from zero."""
    mean = (values[:, 1:] + values[:, :-1]) / 2
    return np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(mean, axis=1) * STEP_S], axis=1)


def body_to_world(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
    """(..., 3, 3) body (FLU) to world (NWU), yaw then pitch then roll."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
