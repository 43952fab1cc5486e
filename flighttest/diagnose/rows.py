"""What a `Bench` hands out: fitted states and linearised rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.problem import Noise, Part

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# Residuals below these cannot be told from the resolution of the recording.
RESOLUTION = {
    "roll_rad": 3e-4, "pitch_rad": 3e-4, "r_rad_s": 1e-3, "f_x_m_s2": 5e-3, "f_y_m_s2": 5e-3, "f_z_m_s2": 5e-3,
    "a_x_m_s2": 5e-3, "a_y_m_s2": 5e-3, "a_z_m_s2": 5e-3, "v_x_m_s": 3e-3, "v_y_m_s": 3e-3, "v_z_m_s": 3e-3,
}  # fmt: skip
FIRST_NOISE = {"roll_rad": 0.02, "pitch_rad": 0.02, "r_rad_s": 0.1} | {
    f"{k}_{axis}_{unit}": std
    for k, unit, std in (("f", "m_s2", 0.5), ("a", "m_s2", 0.5), ("v", "m_s", 0.2))
    for axis in "xyz"
}
FIRST_DISTURBANCE = {"roll_d_rad": 0.01, "pitch_d_rad": 0.01, "yaw_rate_d_rad_s": 0.02} | {
    f"a_d_{axis}_m_s2": 0.3 for axis in "xyz"
}
DISTURBANCE = -2
BLIND = 1.0  # whitened sum of squares of a parameter's usual change: less is below one sample's noise in all the data
LEAST_DISTURBANCE = 0.05  # of the first guess: a prior never shrinks to nothing


@dataclass(frozen=True)
class State:
    """A fitted model: parameters, locals by name ((n_segments,), NaN where a segment has none), noise, objective.

    objective: whitened sum of squares, priors of the locals included.
    """

    values: dict[str, float]
    local: dict[str, FloatArray]
    noise: Noise
    objective: float


@dataclass(frozen=True)
class Nuisance:
    """What one part of a problem does not know of its m responses, as `Rows` took it out.

    basis (m, k, n_l), start (m, k, n_f): orthonormal, of all locals and of the initial states alone, over the k - n_l samples (times
    outputs) and the n_l priors; scale (k - n_l,): by which samples were whitened; keep (m, k - n_l): which of them were measured.
    """

    basis: FloatArray
    start: FloatArray
    scale: FloatArray
    keep: NDArray[np.bool_]

    def of(self, raw: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(whitened, open), both (m, k, q), of changes (m, k - n_l, q) of what is measured, in the channels' units."""
        m, n_l, q = raw.shape[0], self.basis.shape[2], raw.shape[2]
        stacked = np.concatenate([raw / self.scale[:, None], np.zeros((m, n_l, q))], axis=1)
        unit = np.concatenate([self.scale, np.zeros(n_l)])[:, None]
        return project(self.basis, stacked), project(self.start, stacked) * unit


def in_order(nuisance: Sequence[Nuisance], values: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Per part (m, k, ...) to rows (n, ...): what was measured first, so that models with other locals have it in the same place."""
    measured = [v[:, : p.keep.shape[1]][p.keep] for p, v in zip(nuisance, values, strict=True)]
    priors = [np.concatenate(v[:, p.keep.shape[1] :]) for p, v in zip(nuisance, values, strict=True)]
    return np.concatenate([*measured, *priors])


@dataclass(frozen=True)
class Rows:
    """Linearised residuals, one row per sample and channel, then one per prior of a local (sample -1, DISTURBANCE for disturbances).

    residual (n,), jacobian (n, p): whitened, locals projected out (a step d of the parameters lowers the residual by jacobian @ d);
    open_residual, open_jacobian: in units of the channel, with only initial states projected out: what the model predicts of a response
    without knowing its disturbance. scale (n,): by which rows were whitened; segment, sample (n,): positions in the bench's segments
    and in their t_s; channel (n,): index into `channels`, -1 for priors. nuisance: by part, to take locals out of other changes.
    freedom: log of the volume that initial states owned by terms could fill within their priors: what such freedom costs.
    """

    residual: FloatArray
    jacobian: FloatArray
    open_residual: FloatArray
    open_jacobian: FloatArray
    scale: FloatArray
    segment: IntArray
    sample: IntArray
    channel: IntArray
    channels: tuple[str, ...]
    names: tuple[str, ...]
    nuisance: tuple[Nuisance, ...] = ()
    freedom: float = 0.0

    def of(self, raw: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """(columns, open columns), both (n, q), of a change given per part, (m, samples times outputs, q) in the channels' units."""
        both = [part.of(one) for part, one in zip(self.nuisance, raw, strict=True)]
        return in_order(self.nuisance, [b[0] for b in both]), in_order(self.nuisance, [b[1] for b in both])

    def columns(self, names: Sequence[str]) -> FloatArray:
        """(n, k) columns by name."""
        return self.jacobian[:, [self.names.index(n) for n in names]]

    def open_columns(self, names: Sequence[str]) -> FloatArray:
        """(n, k) columns of `open_jacobian` by name."""
        return self.open_jacobian[:, [self.names.index(n) for n in names]]


def project(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """(m, n, k) columns without what (m, n, l) orthonormal bases span."""
    return np.asarray(columns - np.matmul(basis, np.matmul(basis.transpose(0, 2, 1), columns)))


def freedom_of(part: Part, stacked: FloatArray, prior: FloatArray) -> float:
    """Sum over responses of log det(I + P J' J P) for initial states that terms own, the other locals taken out first."""
    own = [part.block.free_states.index(n) for n in part.block.spread]
    if not own:
        return 0.0
    others = [k for k in range(stacked.shape[2]) if k not in own]
    r = np.linalg.qr(stacked[..., others + own], mode="r")
    diagonal = np.abs(np.diagonal(r, axis1=1, axis2=2))[:, len(others) :]
    return float(2 * np.sum(np.log(diagonal / prior[:, own])))
