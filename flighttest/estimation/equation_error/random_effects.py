"""Equations of motion beside what is random and not estimated: the initial states of a swinging load, and what instruments are off by.

An accelerometer has a bias that stays for all of a flight: a random intercept of each channel and flight (Laird and Ware, Biometrics 38,
1982), here a level, of known standard deviation s (`estimation.drift`). With its whitened column d it is a part of the noise, of
covariance V = I + s^2 d d', and rows r are whitened by it as

    V^-1/2 r = r - d m d' r,    m = s^2 / (q (1 + q)),    q^2 = 1 + s^2 d' d,

for the levels of several channels by the eigenvectors of their Gram matrix. Its best linear unbiased prediction is s^2 d' V^-1 r
(Henderson, Biometrics 31, 1975).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.equation_error.autoregression import Autoregression
from flighttest.estimation.equation_error.initial_states import InitialStates, PredictedStates, predictions_of
from flighttest.estimation.equation_error.streams import Stream, whitened_rows

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class MarginalRows:
    """Whitened residual and columns beside the random effects. rows: (n, 1 + q) of each stream, then (k, 1 + q) of the initial states of
    each number; begins: of each number the stream and the row of it that it begins at; states: predictions of initial states; levels: group
    to those of its levels (channels, 1 + q); log_determinant: what random effects add to minus twice the log likelihood."""

    rows: list[FloatArray]
    begins: Mapping[int, tuple[int, int]]
    states: PredictedStates
    levels: Mapping[int, FloatArray]
    log_determinant: float


def marginal_rows(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> MarginalRows:
    """Of every stream, by its channel's noise."""
    std = {c: one.level for c, one in noise.items() if one.level > 0.0}
    made = [_regressands(noise[s.channel], s, [*std]) for s in streams]
    along = [
        s.initial.whitened(noise[s.channel].whitened, noise[s.channel].order) if s.initial else [] for s in streams
    ]
    states = predictions_of([*zip(along, made, strict=True)])
    begins: dict[int, tuple[int, int]] = {}
    for i, some in enumerate(along):
        for one in some:
            begins.setdefault(one.number, (i, one.rows.start))
            made[i][one.rows] -= one.columns @ states.of(one.number)
    made += [states.rows(number) for number in begins]
    if not std:
        return MarginalRows(made, begins, states, {}, states.log_determinant)
    group = [s.group for s in streams] + [streams[i].group for i, _ in begins.values()]
    rows, levels, log_determinant = _beside_levels(made, group, np.array([*std.values()]))
    width, steps = rows[0].shape[1], states.steps.copy()
    of = dict(zip(begins, group[len(streams) :], strict=True))
    for i, number in enumerate(states.numbers.tolist()):
        steps[i, :, :width] -= steps[i, :, width:] @ levels[of[number]]
    beside = replace(states, steps=steps[..., :width])
    return MarginalRows(rows, begins, beside, levels, states.log_determinant + log_determinant)


def _beside_levels(
    made: Sequence[FloatArray], group: Sequence[int], std: FloatArray
) -> tuple[list[FloatArray], dict[int, FloatArray], float]:
    """Rows of each group (n, 1 + q) by V^-1/2, of regressands and columns of k levels (n, 1 + q + k); predictions of the levels of each
    group (k, 1 + q); log determinant of V."""
    width = made[0].shape[1] - std.size
    rows = [m[:, :width] for m in made]
    levels: dict[int, FloatArray] = {}
    log_determinant = 0.0
    for g in dict.fromkeys(group):
        own = [i for i, one in enumerate(group) if one == g]
        columns = {i: made[i][:, width:] * std for i in own}
        value, vector = np.linalg.eigh(sum(d.T @ d for d in columns.values()))
        along = vector.T @ sum(d.T @ rows[i] for i, d in columns.items())
        square = (1.0 + np.maximum(value, 0.0))[:, None]
        log_determinant += float(np.sum(np.log(square)))
        levels[g] = std[:, None] * (vector @ (along / square))
        part = vector @ (along / (np.sqrt(square) * (1.0 + np.sqrt(square))))
        for i, d in columns.items():
            rows[i] = rows[i] - d @ part
    return rows, levels, log_determinant


def _regressands(ar: Autoregression, s: Stream, channels: Sequence[str]) -> FloatArray:
    """(n, 1 + q + k): whitened residual and columns, and those of k levels, one of which is the stream's own."""
    level = np.zeros((s.residual.size, len(channels)))
    if s.channel in channels:
        level[:, channels.index(s.channel)] = 1.0
    return np.column_stack(whitened_rows(ar, replace(s, columns=np.column_stack([s.columns, level]))))


def misfit_of(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> tuple[float, float]:
    """Whitened sum of squares beside the random effects; and the log determinant that they add to minus twice the log likelihood."""
    made = marginal_rows([replace(s, columns=s.columns[:, :0]) for s in streams], noise)
    return float(sum(np.sum(m**2) for m in made.rows)), made.log_determinant


def beside_random_effects(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> list[Stream]:
    """Residuals and columns without what random effects explain of them, as predicted."""
    channels = [c for c, one in noise.items() if one.level > 0.0]
    if not channels and not any(s.initial for s in streams):
        return [*streams]
    made = marginal_rows(streams, noise)
    found = []
    for s in streams:
        left = np.column_stack([s.residual, s.columns])
        if s.initial:
            left = left - np.einsum("nk,nkc->nc", s.initial.derivatives, made.states.of(s.initial.number))
        if s.channel in channels:
            left = left - made.levels[s.group][channels.index(s.channel)]
        found.append(replace(s, residual=left[:, 0], columns=left[:, 1:], initial=InitialStates()))
    return found


def without_levels(noise: Mapping[str, Autoregression]) -> dict[str, Autoregression]:
    """What varies of it."""
    return {c: replace(one, level=0.0) for c, one in noise.items()}
