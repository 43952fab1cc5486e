"""Autoregressive noise of an equation, and the filter that whitens it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MOST_LAGS = 40  # 0.8 s at 50 Hz: beyond it, gusts of multirotor flights are predicted by their last value
LEAST_STD = 1e-9  # SI units: rounding of double precision; a channel that is stuck is modelled to within it, and its weight would overflow
BATCH = 32  # samples that are whitened together: as quick as 16 within a tenth, quicker than 64 and 128
LEAST_STRETCH = 4  # times as many samples as lags: a shorter stretch is left out


@dataclass(frozen=True)
class Autoregression:
    """A(q) = 1 + a_1 q^-1 + ...: `coefficients` (order + 1,), the first 1; std: of what is left, in the channel's unit. level: standard
    deviation of what the channel is off by for all of a flight, in its unit (`random_effects`)."""

    coefficients: FloatArray
    std: float
    level: float = 0.0

    @property
    def order(self) -> int:
        """Number of lags."""
        return self.coefficients.size - 1

    @cached_property
    def _starting(self) -> tuple[FloatArray, FloatArray]:
        """(order, order) filters of the first samples, by what is known before each, and (order,) their standard deviations: Levinson's
        recursion downwards (Brockwell and Davis 1991, section 5.2)."""
        filters, std = np.eye(self.order), np.full(self.order, self.std)
        a, variance = self.coefficients, self.std**2
        for k in range(self.order - 1, -1, -1):
            left = max(1.0 - a[-1] ** 2, 1e-12)
            a, variance = (a - a[-1] * a[::-1])[:-1] / left, variance / left
            filters[k, : k + 1], std[k] = a[::-1], np.sqrt(variance)
        return filters, std

    @cached_property
    def _batch(self) -> FloatArray:
        """(BATCH, order + BATCH): of so many samples, by these and what is before them."""
        row = np.concatenate([self.coefficients[::-1] / self.std, np.zeros(BATCH)])
        return np.resize(row, (BATCH, self.order + BATCH))  # each row starts one sample later

    def whitened(self, values: FloatArray) -> FloatArray:
        """(n, ...) of (n, ...): filtered along time, of unit variance; the first samples by the lower orders that their past allows."""
        filters, std = self._starting
        flat = values.reshape(len(values), -1)
        first = min(self.order, len(flat))
        out = np.empty(flat.shape)
        out[:first] = (filters[:first, :first] / std[:first, None]) @ flat[:first]
        left = len(flat) - first
        if left:
            # Products of matrices: a third of the time of a sum over lags.
            count, width = -(-left // BATCH), flat.shape[1]
            filled = np.zeros((self.order + count * BATCH, width))
            filled[: self.order + left] = flat[first - self.order :]
            row, column = filled.strides
            shape = (count, self.order + BATCH, width)
            windows: FloatArray = np.ndarray(shape, buffer=filled, strides=(BATCH * row, row, column))
            out[first:] = (self._batch @ windows).reshape(count * BATCH, width)[:left]
        return out.reshape(values.shape)

    def log_scale(self, size: int) -> float:
        """Sum of the logarithms of the standard deviations that `whitened` divides so many samples by."""
        first = self._starting[1][:size]
        return float(np.sum(np.log(first)) + (size - first.size) * np.log(self.std))

    def spectrum(self, frequency_hz: FloatArray, period_s: float) -> FloatArray:
        """One-sided power spectral density at these frequencies, unit^2 per Hz."""
        z = np.exp(-2j * np.pi * np.outer(frequency_hz, np.arange(self.order + 1)) * period_s)
        return np.asarray(2.0 * period_s * self.std**2 / np.abs(z @ self.coefficients) ** 2)


def autoregression(stretches: Sequence[FloatArray], most: int = MOST_LAGS) -> Autoregression:
    """Of a residual, by Burg's recursion over all stretches; order by Akaike's criterion (Luetkepohl 2005, section 4.3).

    Burg's reflection coefficients, unlike those of the autocovariance (Yule and Walker), hold where a spectrum falls by several decades
    below the sampling frequency, as that of an attitude does (de Hoon et al., IEEE Trans. Signal Processing 44, 1996).
    """
    usable = [s for s in stretches if s.size > LEAST_STRETCH]
    total = sum(s.size for s in usable)
    if not total:
        return Autoregression(np.ones(1), 1.0)
    most = max(min(most, max(s.size for s in usable) // LEAST_STRETCH, total // 10), 0)
    variance = power = sum(float(s @ s) for s in usable) / total
    if not variance > LEAST_STD**2:
        return Autoregression(np.ones(1), LEAST_STD)
    forward = np.concatenate(usable)  # all at once; between stretches, where there are no pairs, both are 0
    backward = forward.copy()
    begins = list(accumulate(s.size for s in usable))[:-1]
    scaled = np.empty((2, forward.size))
    a = np.zeros(most + 1)
    a[0] = 1.0
    chosen, std, least = a[:1].copy(), math.sqrt(power), total * np.log(power)
    for order in range(1, most + 1):
        forward, backward = forward[1:], backward[:-1]
        for begin in begins:
            if begin <= forward.size:
                forward[begin - 1] = 0.0
            if begin >= order:
                backward[begin - order] = 0.0
        reflection = -2.0 * float(forward @ backward) / float(forward @ forward + backward @ backward)
        a[: order + 1] = a[: order + 1] + reflection * a[order::-1]
        power *= 1.0 - reflection**2
        if power <= 1e-12 * variance:
            break
        criterion = total * np.log(power) + 2.0 * order
        if criterion < least:
            chosen, std, least = a[: order + 1].copy(), math.sqrt(power), criterion
        to_forward, to_backward = scaled[:, : forward.size]
        np.multiply(backward, reflection, out=to_forward)
        np.multiply(forward, reflection, out=to_backward)
        forward += to_forward
        backward += to_backward
    return Autoregression(chosen, max(std, LEAST_STD))
