"""The equations of stretches of flight under one model, ready to be evaluated at parameter values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from flighttest.estimation.equation_error import Stream
from flighttest.estimation.estimator import part_of
from flighttest.identify.free_flight.chunks import InitialValues
from flighttest.identify.free_flight.loops import ATTITUDE_MEANS_S, LoopEquations, compared
from flighttest.identify.free_flight.stretches import Residual, sampling_period_s
from flighttest.identify.free_flight.translation import TranslationEquations, accelerations
from flighttest.identify.selection import able
from flighttest.physics.blocks import Block
from flighttest.physics.model import Model
from flighttest.segments.model import Segment


@dataclass
class Equations:
    """part: 'translation', 'roll_pitch' or 'yaw' (`estimation.estimator.BLOCKS`)."""

    model: Model
    flown: Sequence[Segment]
    part: str = "translation"

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of the recordings."""
        return tuple(dict.fromkeys(s.run for s in self.flown))

    @cached_property
    def period_s(self) -> float:
        """Time between the samples of the residuals."""
        if self.part != "translation":
            return max(sampling_period_s(self.flown), ATTITUDE_MEANS_S)
        every = [np.diff(t) for one in self._alike for t in one.times]
        return float(np.median(np.concatenate(every)))

    @cached_property
    def params(self) -> tuple[str, ...]:
        """Names of what the equations depend on."""
        return tuple(dict.fromkeys(n for one in self._alike for n in one.params))

    @cached_property
    def at_rest(self) -> InitialValues:
        """Initial values of the states that nothing measured, by the mean of their prior: 0."""
        every = [one.chunks for one in self._alike]
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
        of_flight = {f: {n: values.get(f"{n}@{f}", values[n]) for n in self.model.names} for f in self.flights}
        left: list[tuple[int, Residual]] = []
        before = 0  # initial states so far
        for equation in self._alike:
            after = before + equation.chunks.count_initial
            began = {n: x[before:after] for n, x in (initial or {}).items()}
            mine = [of_flight[s.run] for s in equation.flown]
            for one in equation.evaluated(mine, [*shared, *own], began):
                number = self.flights.index(equation.flown[one.stretch].run)
                left.append((number, one._replace(initial=one.initial.after(before))))
            before = after
        # The same order whether a term couples the axes or not, and whichever flights are alike.
        loops = self.part != "translation"
        left.sort(key=lambda one: (one[0], one[1].channel if loops else ""))
        found: list[Stream] = []
        for g, one in left:
            placed = np.zeros((one.residual.size, len(columns)))
            placed[:, : len(shared)] = one.slopes[:, : len(shared)]
            at = len(shared) + g * len(own)
            placed[:, at : at + len(own)] = one.slopes[:, len(shared) :]
            found.append(Stream(one.channel, g, one.residual, placed, one.state, one.initial))
        return found, columns

    @cached_property
    def _alike(self) -> list[TranslationEquations | LoopEquations]:
        """Flights of which the same outputs are compared, through the same filters, are integrated together."""
        if self.part == "translation":
            return [TranslationEquations(self.model, *some) for some in self._groups(accelerations)]
        found: list[TranslationEquations | LoopEquations] = []
        for block in self.model.blocks:
            if part_of(block.name) == self.part:
                found += [LoopEquations(self.model, block, *some) for some in self._groups(partial(_shown, block))]
        return found

    def _groups(
        self, outputs: Callable[[Sequence[Segment]], tuple[str, ...]]
    ) -> list[tuple[list[Segment], tuple[str, ...]]]:
        """Stretches of the flights with the same outputs and filters; those without any are left out."""
        found: dict[tuple[object, ...], tuple[list[Segment], tuple[str, ...]]] = {}
        for flight in self.flights:
            own = [s for s in self.flown if s.run == flight]
            if shown := outputs(own):
                found.setdefault((shown, *sorted(own[0].context.filters.items())), ([], shown))[0].extend(own)
        return list(found.values())


def _shown(block: Block, flown: Sequence[Segment]) -> tuple[str, ...]:
    """Outputs of a block of the loops that are compared, none where its references do not move."""
    return compared(block, flown) if able(flown, block) else ()
