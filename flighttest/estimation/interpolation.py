"""Signals between the samples of a log that has few of them: battery voltage as the load has it, attitude as the gyroscope has it.

At 10 Hz the chord between two voltages begins to fall before a throttle step and ends after it, while the battery sags with the load: it
moves K by 0.1 % and the thrust's delay by 0.1 ms. A chord between attitudes has 0.74 of a motion of 3 Hz.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flighttest.frames import G_M_S2, euler_rates_from_body
from flighttest.physics.terms.propulsion import LOAD_POWER

FloatArray = NDArray[np.float64]

SLOW = 2.0  # a monitor at less than this share of the segment's rate is slow
FEWEST = 5
# What is known beforehand, as standard deviations: noise of a sample V, sag at hover V, drain V/s. Over a second of samples drain and
# sag could take one another's place otherwise.
NOISE_V = 0.02
SAG_V = 1.0
DRAIN_V_S = 0.02


def filled(t: FloatArray, values: FloatArray | None, default: float) -> FloatArray:
    """A measured signal without holes: linear across gaps, held at the ends, `default` where nothing was measured."""
    if values is None:
        return np.full(t.shape, default)
    good = np.isfinite(values)
    if good.all():
        return values
    return np.interp(t, t[good], values[good]) if good.any() else np.full(t.shape, default)


def angles_between_samples(t: FloatArray, measured: FloatArray, rates: FloatArray) -> FloatArray:
    """Roll, pitch and yaw, rad, at t (n,), without jumps. measured: (n, 3), NaN between samples, 0 is taken for one that has none; rates:
    (n, 3) p, q, r, rad/s, without holes. What angles and integrated rates differ in, a bias too, is linear between samples."""
    angles = np.stack([filled(t, one, 0.0) for one in measured.T], axis=1)
    angles[:, 2] = np.unwrap(angles[:, 2])
    known = np.isfinite(measured)
    if known.all() or not known.any(axis=0).all() or t.size < 2:
        return angles
    turning = euler_rates_from_body(angles, rates)
    turned = np.zeros_like(angles)
    turned[1:] = np.cumsum(0.5 * (turning[1:] + turning[:-1]) * np.diff(t)[:, None], axis=0)
    beside = np.where(known, angles - turned, np.nan)
    return turned + np.stack([filled(t, one, 0.0) for one in beside.T], axis=1)


def between_samples(
    t_s: FloatArray, chord_v: FloatArray, samples: tuple[FloatArray, FloatArray], force_m_s2: FloatArray, lag_s: float
) -> FloatArray:
    """Voltage at t_s (n,): through the samples, and between them as the load has it; the chord where nothing is gained or known.

    force_m_s2: (n,) specific force along the rotor axis, without holes; lag_s: how late its measurement filter makes it.
    """
    times, volts = samples
    inside = (times >= t_s[0]) & (times <= t_s[-1]) & np.isfinite(volts)
    times, volts = times[inside], volts[inside]
    if times.size < FEWEST or np.median(np.diff(times)) < SLOW * np.median(np.diff(t_s)):
        return chord_v
    middle = 0.5 * (t_s[0] + t_s[-1])
    load = (np.clip(force_m_s2, 0.0, None) / G_M_S2) ** LOAD_POWER

    def basis(at: FloatArray) -> FloatArray:
        return np.stack([np.ones_like(at), np.interp(at + lag_s, t_s, load), at - middle], axis=1)

    prior = np.diag([0.0, NOISE_V / SAG_V, NOISE_V / DRAIN_V_S])[1:]
    rows = np.concatenate([basis(times), prior])
    found = np.linalg.lstsq(rows, np.concatenate([volts, np.zeros(2)]), rcond=None)[0]
    rest = volts - basis(times) @ found
    return np.asarray(basis(t_s) @ found + np.interp(t_s, times, rest))
