"""Battery voltage between the samples of a slow monitor.

At 10 Hz the chord between two samples begins to fall before a throttle step and ends after it, while the battery sags with the load: it
moves K by 0.1 % and the thrust's delay by 0.1 ms. Between samples the voltage is made to follow the load instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flighttest.frames import G_M_S2
from flighttest.physics.terms.propulsion import LOAD_POWER

FloatArray = NDArray[np.float64]

SLOW = 2.0  # a monitor at less than this share of the segment's rate is slow
FEWEST = 5
# What is known beforehand, as standard deviations: noise of a sample V, sag at hover V, drain V/s. Over a second of samples drain and
# sag could take one another's place otherwise.
NOISE_V = 0.02
SAG_V = 1.0
DRAIN_V_S = 0.02


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
