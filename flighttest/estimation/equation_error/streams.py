"""Equations over stretches of flight, whitened by the noise of their channels, beside the initial states that they began from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.equation_error.autoregression import Autoregression, autoregression
from flighttest.estimation.equation_error.initial_states import (
    InitialStates,
    PredictedStates,
    WhitenedInitialStates,
    predictions_of,
)

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


def noises(streams: Sequence[Stream]) -> dict[str, Autoregression]:
    """The noise of each channel, of the residuals as they stand."""
    channels = dict.fromkeys(s.channel for s in streams)
    return {c: autoregression([s.residual - s.residual.mean() for s in streams if s.channel == c]) for c in channels}


def whitened_rows(ar: Autoregression, s: Stream) -> tuple[FloatArray, FloatArray]:
    """Residual and columns of a stream; of nine flights with winds of their own most columns of each are nothing."""
    used = s.columns.any(axis=0)
    made = ar.whitened(np.column_stack([s.residual, s.columns[:, used]]))
    columns = np.zeros(s.columns.shape)
    columns[:, used] = made[:, 1:]
    return made[:, 0], columns


def predicted_states(
    streams: Sequence[Stream], noise: Mapping[str, Autoregression], whitened: Sequence[FloatArray]
) -> tuple[PredictedStates, list[list[WhitenedInitialStates]]]:
    """Of the initial states by whitened regressands (n, c) of each stream; and their own whitened derivatives."""
    along = [
        s.initial.whitened(noise[s.channel].whitened, noise[s.channel].order) if s.initial else [] for s in streams
    ]
    return predictions_of([*zip(along, whitened, strict=True)]), along


def misfit_of(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> tuple[float, float]:
    """Whitened sum of squares beside the initial states, with the squares of these; and the log determinant that they add to minus twice
    the log likelihood."""
    made = [noise[s.channel].whitened(s.residual[:, None]) for s in streams]
    states, along = predicted_states(streams, noise, made)
    # With the steps s = (N' N + I)^-1 (N' r - b0), |r - N s|^2 + |b0 + s|^2 = r' r + b0' b0 - (N' r - b0)' s.
    explained = -float(np.sum(states.values * (states.values + states.steps[..., 0])))
    for values, some in zip(made, along, strict=True):
        for one in some:
            explained += float(values[one.rows, 0] @ one.columns @ states.of(one.number)[:, 0])
    return sum(float(np.sum(m**2)) for m in made) - explained, states.log_determinant


def beside_initial_states(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> list[Stream]:
    """Streams with their initial states as predicted from them: residuals and columns without what these explain."""
    if not any(s.initial for s in streams):
        return [*streams]
    made = [np.column_stack(whitened_rows(noise[s.channel], s)) for s in streams]
    states, _ = predicted_states(streams, noise, made)
    found = []
    for s in streams:
        explained = np.einsum("nk,nkc->nc", s.initial.derivatives, states.of(s.initial.number)) if s.initial else 0.0
        left = np.column_stack([s.residual, s.columns]) - explained
        found.append(replace(s, residual=left[:, 0], columns=left[:, 1:], initial=InitialStates()))
    return found


def log_scale(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> float:
    """Minus the log likelihood of the innovations less half their whitened sum of squares, but for a constant: the logarithms of what every
    sample is divided by; and one for every coefficient of the noise (Akaike 1974), since a noise of many imitates what a model lacks.

    All samples count, the first by what is known before them: noises of different orders would else be compared on different samples. On
    tunnel flights one of 40 lags, which left out the first 4 s, had 111 nats more than one of 17 at the same parameters.
    """
    coefficients = sum(noise[c].order for c in {s.channel for s in streams})
    return sum(noise[s.channel].log_scale(s.residual.size) for s in streams) + coefficients
