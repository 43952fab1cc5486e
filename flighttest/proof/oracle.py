"""The oracle: how large a hidden effect is, and what looks like it, from flights alone. Must not share a line with the code it judges.

One vehicle flies the campaign without noise and gusts, once with the effect and once without. The paper's equations, integrated here by
linear filters and fitted by scipy on finite differences, are refitted to each flight; what they leave of the first and not of the second
is what no base parameter copies. It is counted in noise floors: the spread of what they leave of the recorded flight, with its noise,
less what they leave of the same flight without.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from flighttest.frames import G_M_S2
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

STEP_S = 0.02  # responses are compared on this grid
PARTS = 4  # inputs are held for a part of it
LEAST_SAMPLES = 60  # a place (channel and kind of maneuver) needs before its RMS means something
CONFUSABLE = 0.95  # cosine of what two effects leave, above which no diagnosis can be asked to distinguish them
TILTED = ("roll_step", "pitch_step", "tilt_throttle")
# First weights: (std of a sample, std of the disturbance of a response); the flights' own follow.
FIRST = {"roll_rad": 0.003, "pitch_rad": 0.003, "r_rad_s": 0.02} | {
    f"{k}_{axis}_{unit}": std for k, unit, std in (("f", "m_s2", 0.2), ("v", "m_s", 0.03)) for axis in "xyz"
}
FIRST_DISTURBANCE = {"roll_pitch": 0.003, "yaw": 0.01, "translation": 0.05}


@dataclass(frozen=True)
class OracleNoise:
    """std: of a sample, by channel; disturbance: of the constant one of a response, by block (rad, rad/s, m/s^2)."""

    std: dict[str, float]
    disturbance: dict[str, float]

    def of_residual(self, left: Left) -> OracleNoise:
        """The same with samples as far as the base model leaves them: what is noise beside a difference of two flights."""
        return replace(self, std=self.std | {c: float(np.std(x)) for c, x in _pooled(left.residual).items()})


@dataclass(frozen=True)
class Left:
    """What a refitted base leaves of one flight. residual: (response, channel) to (n,) in the channel's unit, from the same time before
    its step on; kinds: response to its kind; disturbance: (response, block) to what was estimated; parameters: block to its theta,
    NaN where the fit ended at a bound."""

    residual: Mapping[tuple[str, str], FloatArray]
    kinds: Mapping[str, str]
    disturbance: Mapping[tuple[str, str], FloatArray]
    parameters: Mapping[str, FloatArray]

    def less(self, other: Left) -> Left:
        """The difference to another flight, where both have a response."""
        both = {}
        for key in self.residual.keys() & other.residual.keys():
            n = min(self.residual[key].size, other.residual[key].size)
            both[key] = self.residual[key][:n] - other.residual[key][:n]
        change = {k: v - other.disturbance[k] for k, v in self.disturbance.items() if k in other.disturbance}
        return replace(self, residual=both, disturbance=change)

    def places(self) -> dict[tuple[str, str], FloatArray]:
        """(channel, kind of maneuver) to all samples, where there are enough."""
        kinds = sorted(set(self.kinds.values()))
        found: dict[tuple[str, str], FloatArray] = {}
        for kind in kinds:
            here = {k: v for k, v in self.residual.items() if self.kinds[k[0]] == kind}
            found |= {(channel, kind): x for channel, x in _pooled(here).items() if x.size >= LEAST_SAMPLES}
        return found


def size_in_floors(effect: Left, noise: OracleNoise) -> float:
    """Largest RMS over a place, in noise floors."""
    sizes = (float(np.sqrt(np.mean(x**2))) / noise.std[channel] for (channel, _), x in effect.places().items())
    return max(sizes, default=0.0)


def force_left(effect: Left) -> float:
    """RMS specific force, m/s^2, all axes."""
    axes = {c: x for c, x in _pooled(effect.residual).items() if c.startswith("f_")}
    return float(np.sqrt(sum(np.mean(x**2) for x in axes.values())))


def _pooled(values: Mapping[tuple[str, str], FloatArray]) -> dict[str, FloatArray]:
    """(response, channel or block) to values: all of one channel or block."""
    found: dict[str, list[FloatArray]] = {}
    for key, value in sorted(values.items()):
        found.setdefault(key[1], []).append(value.ravel())
    return {k: np.concatenate(v) for k, v in found.items()}


def cosine(one: Left, other: Left, noise: OracleNoise) -> float:
    """Between what two effects leave, in noise floors."""
    keys = sorted(one.residual.keys() & other.residual.keys())
    pairs = []
    for key in keys:
        n = min(one.residual[key].size, other.residual[key].size)
        pairs.append((one.residual[key][:n] / noise.std[key[1]], other.residual[key][:n] / noise.std[key[1]]))
    a, b = (np.concatenate([p[k] for p in pairs]) for k in (0, 1))
    return float(abs(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12))


def oracle_noise(recorded: Sequence[Segment], quiet: Sequence[Segment], nominal_voltage_v: float) -> OracleNoise:
    """From a recorded flight and the same without noise and gusts."""
    noise = OracleNoise(FIRST, FIRST_DISTURBANCE)
    for _ in range(2):
        apart = left(recorded, noise, nominal_voltage_v).less(left(quiet, noise, nominal_voltage_v))
        noise = OracleNoise(
            noise.std | {c: float(np.std(x)) for c, x in _pooled(apart.residual).items()},
            noise.disturbance | {b: float(np.sqrt(np.mean(x**2))) for b, x in _pooled(apart.disturbance).items()},
        )
    return noise


def left(
    segments: Sequence[Segment],
    noise: OracleNoise,
    nominal_voltage_v: float,
    free: bool = False,
    near: Left | None = None,
) -> Left:
    """What the base model leaves after a fit of its own to these responses; free: windows of free flight count, too. near: of another
    flight, from whose parameters the fit starts, so that two flights differ by what was flown and not by the optimum reached."""
    usable = [s for s in segments if s.usable and (free or s.kind != "free")]
    residual: dict[tuple[str, str], FloatArray] = {}
    disturbance: dict[tuple[str, str], FloatArray] = {}
    parameters: dict[str, FloatArray] = {}
    for block in (_RollPitch(), _Yaw(), Translation(nominal_voltage_v)):
        fed = [s for s in usable if _feeds(s, block)]
        if not fed:
            continue
        data = _Responses(fed)
        std = np.array([noise.std[c] for c in block.channels])
        whiten = data.mask[:, :, None] * np.stack([data.recorded(c) for c in block.channels], axis=1)[:, None] / std
        spread = noise.disturbance.get(block.name, FIRST_DISTURBANCE[block.name])

        usual = np.array(block.start(data))
        known = None if near is None else near.parameters.get(block.name)
        fitted = least_squares(
            partial(_misfit, block, data, whiten, spread),
            usual if known is None or not np.isfinite(known).all() else known,
            x_scale=np.abs(usual) * 0.1 + 1e-3,
            bounds=block.bounds,
            ftol=1e-7,
            xtol=1e-7,
            max_nfev=30,
        )
        parameters[block.name] = np.where(fitted.active_mask == 0, fitted.x, np.nan)
        rows, constant = _profiled(*block.of(data, fitted.x), whiten, spread)
        for i, s in enumerate(fed):
            disturbance[s.name, block.name] = constant[i]
            there = [(k, c) for k, c in enumerate(block.channels) if data.recorded(c)[i]]
            residual |= {(s.name, c): rows[i, : data.n[i], k] * std[k] for k, c in there}
    return Left(residual, {s.name: s.kind for s in usable}, disturbance, parameters)


def _known(segment: Segment, channel: str) -> bool:
    return channel in segment.y and bool(np.isfinite(segment.y[channel]).sum() > 1)


def _feeds(segment: Segment, block: _Block) -> bool:
    """Whether a response moves what a block describes, its inputs are known and some of its channels were recorded."""
    moved = not block.kinds or segment.kind in (*block.kinds, "free")
    return moved and set(block.inputs) <= set(segment.u) and any(_known(segment, c) for c in block.channels)


def _misfit(block: _Block, data: _Responses, whiten: FloatArray, spread: float, theta: FloatArray) -> FloatArray:
    return _profiled(*block.of(data, theta), whiten, spread)[0].ravel()


def _profiled(
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


class _Responses:
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

    def recorded(self, channel: str) -> NDArray[np.bool_]:
        """(m,) whether a channel was recorded in each."""
        return np.array([_known(s, channel) for s in self._segments])

    def y(self, channel: str, unrecorded: float = 0.0) -> FloatArray:
        """(m, n) what was measured."""
        if channel not in self._sampled:
            self._sampled[channel] = self._on_grid(channel, unrecorded)
        return self._sampled[channel]

    def _on_grid(self, channel: str, unrecorded: float) -> FloatArray:
        rows = []
        for s, since, at in zip(self._segments, self._since, self.t_s, strict=True):
            if _known(s, channel):
                known = np.isfinite(s.y[channel])
                rows.append(np.interp(at, since[known], s.y[channel][known]))
            else:
                rows.append(np.full(at.size, unrecorded))
        return np.array(rows)

    def held(self, channel: str, delay_s: float, own: str = "") -> FloatArray:
        """(m, parts) mean of a delayed input over every part. What is held has an exact integral, smooth in the delay.
        own: a channel of the autopilot that takes the input's place where it was recorded."""
        rows = []
        for s, at in zip(self._segments, self.t_s, strict=True):
            edges, value = s.u[channel]
            if _known(s, own):
                known = np.isfinite(s.y[own])
                edges, value = s.t_s[known], s.y[own][known]
            ends = at[0] + np.arange(PARTS * (at.size - 1) + 1) * (STEP_S / PARTS) - delay_s
            knots = edges - s.t_step_s
            knots = np.concatenate([[min(knots[0], ends[0]) - 1.0], knots[1:], [max(knots[-1], ends[-1]) + 1.0]])
            area = np.concatenate([[0.0], np.cumsum(np.diff(knots) * value)])
            rows.append(np.diff(np.interp(ends, knots, area)) / (STEP_S / PARTS))
        return np.array(rows)


def _answer(numerator: Sequence[float], denominator: Sequence[float], held: FloatArray) -> FloatArray:
    """(..., n) of a linear filter at rest to inputs (..., parts) held over parts."""
    b, a, _ = cont2discrete((numerator, denominator), STEP_S / PARTS)
    after = np.concatenate([held, held[..., -1:]], axis=-1)
    return np.asarray(lfilter(np.ravel(b), a, after)[..., ::PARTS])


class _Block(ABC):
    """Part of the base model, on the kinds of response that feed it (all, where none are named)."""

    name: str
    channels: tuple[str, ...]
    inputs: tuple[str, ...]
    kinds: tuple[str, ...] = ()
    bounds: tuple[Sequence[float], Sequence[float]]

    @abstractmethod
    def start(self, r: _Responses) -> Sequence[float]:
        """Where a fit begins."""

    @abstractmethod
    def of(self, r: _Responses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(m, n, c) residual from rest, (m, n, c, k) what initial states of one add, (m, n, c, j) what disturbances of one add."""


class _RollPitch(_Block):
    """phi'' = omega^2 (phi_ref(t - T) + d - phi) - 2 zeta omega phi', pitch alike; theta: omega, zeta of both, T.
    phi_ref: what the loops follow, the autopilot's own target behind its shaping where that was recorded."""

    name, channels, kinds = "roll_pitch", ("roll_rad", "pitch_rad"), TILTED
    inputs = ("roll_ref_rad", "pitch_ref_rad")
    bounds = ((1.0, 0.02, 1.0, 0.02, 0.0), (120.0, 3.0, 120.0, 3.0, 0.4))

    def start(self, r: _Responses) -> Sequence[float]:
        return 12.0, 0.7, 12.0, 0.7, 0.08

    def of(self, r: _Responses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        m, n = r.t_s.shape
        residual, free, disturbed = np.zeros((m, n, 2)), np.zeros((m, n, 2, 4)), np.zeros((m, n, 2, 2))
        for k, axis in enumerate(("roll", "pitch")):
            omega, zeta = theta[2 * k], theta[2 * k + 1]
            poles = (1.0, 2.0 * zeta * omega, omega**2)
            asked = r.held(f"{axis}_ref_rad", theta[4], f"{axis}_shaped_rad")
            residual[..., k] = r.y(f"{axis}_rad") - _answer((omega**2,), poles, asked)
            disturbed[..., k, k] = step = _answer((omega**2,), poles, np.ones(PARTS * (n - 1)))
            # From an angle of one: what a step asks back; from a rate of one: the answer to a push.
            free[..., k, 2 * k] = 1.0 - step
            free[..., k, 2 * k + 1] = np.gradient(step, STEP_S)
        return residual, free, disturbed


class _Yaw(_Block):
    """r' = sigma (r_ref(t - T) + d - r); theta: sigma, T."""

    name, channels, kinds, inputs = "yaw", ("r_rad_s",), ("yaw_rate_step",), ("yaw_rate_ref_rad_s",)
    bounds = ((0.3, 0.0), (150.0, 0.4))

    def start(self, r: _Responses) -> Sequence[float]:
        return 6.0, 0.08

    def of(self, r: _Responses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        answer = _answer((theta[0],), (1.0, theta[0]), r.held("yaw_rate_ref_rad_s", theta[1]))
        decay = np.exp(-theta[0] * (r.t_s - r.t_s[:, :1]))[..., None, None]
        return (r.y("r_rad_s") - answer)[..., None], decay, 1.0 - decay


class Translation(_Block):
    """a' = sigma (K (U/U_n)^alpha T(t - T_d) - a); f = a e_z - D R'v + R'd; v' = R f - g; theta: sigma, K, alpha, T_d, D (3)."""

    name, inputs = "translation", ("throttle",)
    channels = tuple(f"{k}_{axis}_{unit}" for k, unit in (("f", "m_s2"), ("v", "m_s")) for axis in "xyz")
    bounds = ((0.5, 1.0, -10.0, 0.0, -5.0, -5.0, -5.0), (150.0, 2000.0, 10.0, 0.4, 5.0, 5.0, 5.0))

    def __init__(self, nominal_voltage_v: float) -> None:
        self.nominal_voltage_v = nominal_voltage_v

    def start(self, r: _Responses) -> Sequence[float]:
        """sigma_t, K, alpha, delay and drag to start from."""
        f, throttle = np.mean(r.y("f_z_m_s2"), axis=1), np.mean(r.held("throttle", 0.08), axis=1)
        lifts = np.where(r.recorded("f_z_m_s2"), f, G_M_S2)
        return 12.0, float(np.median(lifts / np.maximum(throttle, 0.01))), 1.5, 0.08, 0.3, 0.3, 0.3

    def of(self, r: _Responses, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `_Block.of`, drag and thrust in body axes and velocity in the world."""
        sigma, gain, alpha, delay, *drag = theta
        m, n = r.t_s.shape
        ratio = r.y("voltage_v", self.nominal_voltage_v) / self.nominal_voltage_v
        voltage = np.repeat(ratio**alpha, PARTS, axis=1)[:, : PARTS * (n - 1)]
        level = ~(r.recorded("roll_rad") & r.recorded("pitch_rad"))[:, None]  # half an attitude is none
        roll, pitch = (np.where(level, 0.0, r.y(f"{axis}_rad")) for axis in ("roll", "pitch"))
        turn = body_to_world(roll, pitch, r.y("yaw_rad"))
        back = turn.transpose(0, 1, 3, 2)
        v = np.stack([r.y(f"v_{axis}_m_s") for axis in "xyz"], axis=2)
        force = -np.asarray(drag) * np.matmul(back, v[..., None])[..., 0]
        force[..., 2] += _answer((sigma,), (1.0, sigma), gain * voltage * r.held("throttle", delay))
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
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
