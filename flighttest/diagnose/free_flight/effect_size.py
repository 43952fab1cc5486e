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
        sizes, floors = {}, {}
        for channel in dict.fromkeys(s.channel for s in beside):
            flights: dict[int, list[FloatArray]] = {}
            for a, b in zip(without, beside, strict=True):
                if b.channel == channel:
                    n = min(a.residual.size, b.residual.size)
                    flights.setdefault(b.group, []).append(np.stack([a.residual[:n] - b.residual[:n], b.residual[:n]]))
            each = [np.concatenate(some, axis=1) for some in flights.values()]
            sizes[channel] = float(np.sqrt(np.mean(np.concatenate(each, axis=1)[0] ** 2)))
            varies, left = np.sqrt(
                np.mean(np.concatenate([e - e.mean(axis=1, keepdims=True) for e in each], axis=1) ** 2, axis=1)
            )
            floors[channel] = float(varies / left) if left > 0.0 else np.inf
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
