"""Equations over stretches of flight, whitened by the noise of their channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.equation_error.autoregression import Autoregression, autoregression
from flighttest.estimation.equation_error.initial_states import InitialStates

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Stream:
    """One equation over one stretch without gaps. residual: (n,) measured minus modelled; columns: (n, q) derivatives of the modelled
    by the parameters; group: what is left out together and judged as one sample (its flight); channel: what shares one noise; state (n, k):
    what the equations may be wrong as a function of (`lack_of_fit`); initial: by the initial states that it began from, where they are
    unknown."""

    channel: str
    group: int
    residual: FloatArray
    columns: FloatArray
    state: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    initial: InitialStates = field(default_factory=InitialStates)


def noises(streams: Sequence[Stream], levels: Mapping[str, float] | None = None) -> dict[str, Autoregression]:
    """The noise of each channel: of what its residuals differ by from their mean in each group. levels: channel to the standard deviation
    of that mean (`Autoregression.level`); 0 where it is part of no noise.

    An autoregression of the residuals with their means has a root at 1, in which winds, offsets and all that stays disappear. One without
    has no place for what stays, if it has no level: on a log of ArduPilot's simulator, where 0.1 m/s^2 stayed and 0.01 m/s^2 did not, the
    likelihood of the estimate then fell by 600 at every second step, for ever.
    """
    found: dict[str, Autoregression] = {}
    for channel in dict.fromkeys(s.channel for s in streams):
        own = [s for s in streams if s.channel == channel]
        mean = {g: np.concatenate([s.residual for s in own if s.group == g]).mean() for g in {s.group for s in own}}
        varying = autoregression([s.residual - mean[s.group] for s in own])
        found[channel] = replace(varying, level=(levels or {}).get(channel, 0.0))
    return found


def whitened_rows(ar: Autoregression, s: Stream) -> tuple[FloatArray, FloatArray]:
    """Residual and columns of a stream; of nine flights with winds of their own most columns of each are nothing."""
    used = s.columns.any(axis=0)
    made = ar.whitened(np.column_stack([s.residual, s.columns[:, used]]))
    columns = np.zeros(s.columns.shape)
    columns[:, used] = made[:, 1:]
    return made[:, 0], columns


def log_scale(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> float:
    """Minus the log likelihood of the innovations less half their whitened sum of squares, but for a constant: the logarithms of what every
    sample is divided by; and one for every coefficient of the noise (Akaike 1974), since a noise of many imitates what a model lacks.

    All samples count, the first by what is known before them: noises of different orders would else be compared on different samples. On
    tunnel flights one of 40 lags, which left out the first 4 s, had 111 nats more than one of 17 at the same parameters.
    """
    coefficients = sum(noise[c].order for c in {s.channel for s in streams})
    return sum(noise[s.channel].log_scale(s.residual.size) for s in streams) + coefficients
