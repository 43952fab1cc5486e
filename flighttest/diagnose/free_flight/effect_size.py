"""How large what a term changes in free flight is, beside what instruments err by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.channels import CHANNELS
from flighttest.diagnose.selection.comparison import LEAST_FLOORS
from flighttest.estimation.drift import DRIFT
from flighttest.estimation.equation_error import Stream
from flighttest.estimation.linearisation import FloatArray


@dataclass(frozen=True)
class EffectSize:
    """What the residuals of two models differ by. sizes: channel to its root mean square, in the channel's unit; floors: the same about the
    mean of each flight, over that of the residuals of the model with the term."""

    sizes: Mapping[str, float]
    floors: Mapping[str, float]

    @staticmethod
    def of(without: Sequence[Stream], beside: Sequence[Stream]) -> EffectSize:
        """Of a term, by the residuals of the models without it and with it."""
        flights: dict[str, dict[int, list[FloatArray]]] = {}
        for a, b in zip(without, beside, strict=True):
            n = min(a.residual.size, b.residual.size)
            pair = np.stack([a.residual[:n] - b.residual[:n], b.residual[:n]])
            flights.setdefault(b.channel, {}).setdefault(b.group, []).append(pair)
        sizes, floors = {}, {}
        for channel, some in flights.items():
            each = [np.concatenate(pairs, axis=1) for pairs in some.values()]
            size, _ = _rms(each)
            varies, left = _rms([pair - pair.mean(axis=1, keepdims=True) for pair in each])
            sizes[channel] = size
            floors[channel] = varies / left if left > 0.0 else np.inf
        return EffectSize(sizes, floors)

    def too_small(self) -> str:
        """Why a term that joins a model has no name; empty where it has.

        Its effect is at least what estimates drift by, which no single flight shows; or what of it changes in a flight is at least 0.7 of
        all the noise that this flight has, the changes of its instruments' drift included (N2).
        """
        if any(size >= DRIFT.get(c, 0.0) or self.floors[c] >= LEAST_FLOORS for c, size in self.sizes.items()):
            return ""
        channel, size = max(self.sizes.items(), key=lambda kv: kv[1])
        return (
            f"its effect, {size:.2g} {CHANNELS[channel].unit} RMS, is below what estimates drift by, and changes by "
            f"{self.floors[channel]:.2g} of the noise of these flights"
        )


def _rms(each: Sequence[FloatArray]) -> list[float]:
    """Root mean square of each row of arrays (2, n), one after the other."""
    found: list[float] = np.sqrt(np.mean(np.concatenate(each, axis=1) ** 2, axis=1)).tolist()
    return found
