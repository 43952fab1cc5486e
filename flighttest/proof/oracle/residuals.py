"""What the base model, refitted, leaves of flights: how large a hidden effect is, and what looks like it.

One vehicle flies the campaign without noise and gusts, once with the effect and once without. The paper's equations are refitted to each
flight on finite differences; what they leave of the first and not of the second is what no base parameter copies. It is counted in noise
floors: the spread of what they leave of the recorded flight, with its noise, less what they leave of the same flight without.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from flighttest.proof.oracle.blocks import (
    OracleBlock,
    OracleResponses,
    RollPitchLoops,
    Translation,
    YawLoop,
    feeds,
    profiled,
)
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]

LEAST_SAMPLES = 60  # a place (channel and kind of maneuver) needs before its RMS means something
CONFUSABLE = 0.95  # cosine of what two effects leave, above which no diagnosis can be asked to distinguish them
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
    for forms in (
        (RollPitchLoops(), RollPitchLoops(by_reference=True)),
        (YawLoop(),),
        (Translation(nominal_voltage_v),),
    ):
        kind = forms[0]  # its forms have the same name, channels and inputs
        fed = [s for s in usable if feeds(s, kind)]
        if not fed:
            continue
        data = OracleResponses(fed)
        std = np.array([noise.std[c] for c in kind.channels])
        whiten = data.mask[:, :, None] * np.stack([data.recorded(c) for c in kind.channels], axis=1)[:, None] / std
        spread = noise.disturbance.get(kind.name, FIRST_DISTURBANCE[kind.name])
        known = None if near is None else near.parameters.get(kind.name)
        fits = [(block, _fitted(block, data, whiten, spread, known)) for block in forms]
        block, fitted = min(fits, key=lambda fit: float(fit[1].cost))
        parameters[block.name] = np.where(fitted.active_mask == 0, fitted.x, np.nan)
        rows, constant = profiled(*block.of(data, fitted.x), whiten, spread)
        for i, s in enumerate(fed):
            disturbance[s.name, block.name] = constant[i]
            there = [(k, c) for k, c in enumerate(block.channels) if data.recorded(c)[i]]
            residual |= {(s.name, c): rows[i, : data.n[i], k] * std[k] for k, c in there}
    return Left(residual, {s.name: s.kind for s in usable}, disturbance, parameters)


def _fitted(
    block: OracleBlock, data: OracleResponses, whiten: FloatArray, spread: float, known: FloatArray | None
) -> OptimizeResult:
    """A block's parameters, from those known of another flight where none of them is at a bound."""
    usual = np.array(block.start(data))
    return least_squares(
        partial(_misfit, block, data, whiten, spread),
        usual if known is None or not np.isfinite(known).all() else known,
        x_scale=np.abs(usual) * 0.1 + 1e-3,
        bounds=block.bounds,
        ftol=1e-7,
        xtol=1e-7,
        max_nfev=30,
    )


def _misfit(
    block: OracleBlock, data: OracleResponses, whiten: FloatArray, spread: float, theta: FloatArray
) -> FloatArray:
    return profiled(*block.of(data, theta), whiten, spread)[0].ravel()
