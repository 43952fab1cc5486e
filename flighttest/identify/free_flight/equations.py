"""The equations of stretches of flight under one model, ready to be evaluated at parameter values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from flighttest.estimation.equation_error import Stream
from flighttest.estimation.estimator import part_of
from flighttest.identify.free_flight.chunks import InitialValues
from flighttest.identify.free_flight.loops import ATTITUDE_MEANS_S, LoopEquations, compared
from flighttest.identify.free_flight.stretches import sampling_period_s
from flighttest.identify.free_flight.translation import TranslationEquations
from flighttest.identify.selection import able
from flighttest.physics.model import Model
from flighttest.segments.model import Segment


@dataclass
class Equations:
    """part: 'translation', 'roll_pitch' or 'yaw' (`estimation.estimator.BLOCKS`)."""

    model: Model
    flown: Sequence[Segment]
    part: str = "translation"
    _made: dict[str, list[TranslationEquations | LoopEquations]] = field(default_factory=dict, repr=False)

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of the recordings."""
        return tuple(dict.fromkeys(s.run for s in self.flown))

    @cached_property
    def period_s(self) -> float:
        """Time between the samples of the residuals."""
        if self.part != "translation":
            return max(sampling_period_s(self.flown), ATTITUDE_MEANS_S)
        every = [np.diff(t) for flight in self.flights for one in self._of(flight) for t in one.times]
        return float(np.median(np.concatenate(every)))

    @cached_property
    def params(self) -> tuple[str, ...]:
        """Names of what the equations depend on."""
        return tuple(dict.fromkeys(n for flight in self.flights for one in self._of(flight) for n in one.params))

    @cached_property
    def at_rest(self) -> InitialValues:
        """Initial values of the states that nothing measured, by the mean of their prior: 0."""
        every = [one.chunks for flight in self.flights for one in self._of(flight)]
        count = sum(chunks.count_initial for chunks in every)
        return {n: np.zeros(count) for chunks in every for n in chunks.unmeasured}

    def streams(
        self,
        values: Mapping[str, float],
        names: Sequence[str],
        per_flight: Sequence[str] = (),
        initial: InitialValues | None = None,
    ) -> tuple[list[Stream], tuple[str, ...]]:
        """Residual and Jacobian of every stretch, by `names`; those of `per_flight` have a column for each flight (`name@flight`). initial:
        of the states that nothing measured (default: `at_rest`)."""
        shared = [n for n in names if n not in per_flight]
        own = [n for n in names if n in per_flight]
        columns = (*shared, *(f"{n}@{flight}" for flight in self.flights for n in own))
        found: list[Stream] = []
        before = 0  # initial states so far
        for g, flight in enumerate(self.flights):
            mine = {n: values.get(f"{n}@{flight}", values[n]) for n in self.model.names}
            left = []
            for equation in self._of(flight):
                after = before + equation.chunks.count_initial
                began = {n: x[before:after] for n, x in (initial or {}).items()}
                made = equation.evaluated(mine, [*shared, *own], began)
                left += [one._replace(initial=one.initial.after(before)) for one in made]
                before = after
            if self.part != "translation":
                left.sort(key=lambda one: one.channel)  # the same order whether a term couples the axes or not
            for channel, residual, slopes, state, states in left:
                placed = np.zeros((residual.size, len(columns)))
                placed[:, : len(shared)] = slopes[:, : len(shared)]
                at = len(shared) + g * len(own)
                placed[:, at : at + len(own)] = slopes[:, len(shared) :]
                found.append(Stream(channel, g, residual, placed, state, states))
        return found, columns

    def _of(self, flight: str) -> list[TranslationEquations | LoopEquations]:
        if flight not in self._made:
            flown = [s for s in self.flown if s.run == flight]
            self._made[flight] = (
                [TranslationEquations(self.model, flown)] if self.part == "translation" else self._loops(flown)
            )
        return self._made[flight]

    def _loops(self, flown: Sequence[Segment]) -> list[TranslationEquations | LoopEquations]:
        """Of the blocks whose references move in a flight."""
        blocks = [b for b in self.model.blocks if part_of(b.name) == self.part and able(flown, b)]
        return [LoopEquations(self.model, b, flown, outputs) for b in blocks if (outputs := compared(b, flown))]
