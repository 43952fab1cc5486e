"""The attitude loops in free flight: their angles as the references alone make them, simulated over whole stretches.

What is left is the loops' answer to everything that no reference asked for, torques of gusts above all, and is coloured by the loops
themselves. With an autoregressive noise, the innovations of this output error are those of a Box-Jenkins model (Ljung, System
Identification, 2nd ed., section 4.2): its estimates stay consistent where a pilot or a position loop answers the gusts, as long as
references act after a delay. Output error by itself took an answer to a gust for the gust's cause: on a pilot's flight of an ArduCopter it
found no delay at all, where the innovations have 57 ms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from flighttest.channels import REFERENCE_OF
from flighttest.identify.free_flight.chunks import Chunks, InitialValues
from flighttest.identify.free_flight.stretches import FloatArray, Residual, unbroken
from flighttest.identify.selection import changes
from flighttest.physics.blocks import AXES, Block
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

# Attitudes are compared as means over this long. What they do faster, at four times the bandwidth of the loops and more, is filters, motors
# and the sampling of references, which the equations do not have: the innovations of 50 Hz, whose noise is least there, are mostly these.
ATTITUDE_MEANS_S = 0.1


def compared(block: Block, flown: Sequence[Segment]) -> tuple[str, ...]:
    """Outputs of a block that move as their own references do, so that models with and without a coupling of the axes leave the same
    residuals."""
    return tuple(
        n
        for n in block.outputs
        if changes(flown, REFERENCE_OF[n])
        and all(np.isfinite(s.y.get(n, np.nan)).any() for s in flown)
        and any(np.nanmax(s.y[n]) > np.nanmin(s.y[n]) for s in flown)  # else the sensor is stuck
    )


class LoopEquations:
    """One block of the attitude loops over stretches of one flight or several: the outputs that are `compared`. state: the simulated
    outputs and their rates, functions of the references alone."""

    def __init__(self, model: Model, block: Block, flown: Sequence[Segment], outputs: tuple[str, ...]) -> None:
        self.block, self.outputs, self.flown = block, outputs, flown
        own = {name for _, names in AXES for name in names}
        self.chunks = Chunks(flown, block, outputs, model, long_memory=bool(set(block.free_states) - own))
        seen = (np.array([s.y[n] for n in outputs]).T for s in flown)
        self.measured = [self.chunks.along(k, one) for k, one in enumerate(seen)]
        self.times = [self.chunks.along(k, s.t_s) for k, s in enumerate(flown)]
        # A log may have written attitudes less often than rates: their samples are a series of their own.
        self._seen = [[np.flatnonzero(np.isfinite(one)) for one in measured.T] for measured in self.measured]

    @property
    def params(self) -> tuple[str, ...]:
        """Names of what the loops depend on."""
        return self.block.params

    def evaluated(
        self, values: Sequence[Mapping[str, float]], names: Sequence[str], initial: InitialValues
    ) -> Iterator[Residual]:
        """Of every stretch without gaps, with values of its own, without its mean: trim is no dynamics."""
        for k, (predicted, slopes) in enumerate(self.chunks.simulated(values, names, initial)):
            t = self.times[k]
            residual = self.measured[k] - predicted
            state = np.concatenate([predicted, np.gradient(predicted, t, axis=0)], axis=1)
            for c, channel in enumerate(self.outputs):
                seen = self._seen[k][c]
                good = np.isfinite(residual[seen, c]) & np.isfinite(slopes[seen, c]).all(axis=1)
                many = max(round(ATTITUDE_MEANS_S / float(np.median(np.diff(t[seen])))), 1) if seen.size > 1 else 1
                for a, b in unbroken(t[seen], good):
                    own, along, of = (_means(one[seen[a:b]], many) for one in (residual[:, c], slopes[:, c], state))
                    if len(own):
                        along, first = along - along.mean(axis=0), seen[a:b][: len(own) * many : many]
                        began = self.chunks.initial_states(k, along[:, len(names) :], first, initial)
                        yield Residual(k, channel, own - own.mean(), along[:, : len(names)], of, began)


def _means(values: FloatArray, many: int) -> FloatArray:
    """(n // many, ...) means of so many samples (n, ...) each."""
    n = len(values) // many
    return np.asarray(values[: n * many].reshape(n, many, *values.shape[1:]).mean(axis=1))
