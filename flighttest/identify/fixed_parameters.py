"""Responses at parameters that are given, not estimated: scores and information, the responses' own unknowns followed along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.likelihood_weights import LikelihoodWeights, Normal, State
from flighttest.estimation.problem import Noise, Problem
from flighttest.estimation.uncertainty.colored_residuals import ColoredResiduals, colored_residuals
from flighttest.identify.models.model_blocks import NoiseBlock

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class AtFixedParameters:
    """Normal equations at given parameters, noise and locals, what they are made of, and how the locals follow the parameters."""

    normal: Normal
    weighing: LikelihoodWeights
    at: State
    backs: tuple[tuple[FloatArray, FloatArray], ...]

    def after(self, step: FloatArray) -> tuple[FloatArray, ...]:
        """Locals for parameters moved by `step`, (p,)."""
        pairs = zip(self.at.local, self.backs, strict=True)
        return tuple(x + back_g - np.einsum("mlp,p->ml", back_h, step) for x, (back_g, back_h) in pairs)

    def colored(self, names: Sequence[str]) -> ColoredResiduals:
        """What the correlation of the residuals in time makes of the variances of estimates of some of the parameters."""
        return colored_residuals(self.weighing, self.at, self.normal, names)


def normal_at(
    problem: Problem,
    values: Mapping[str, float],
    free: Sequence[str],
    noise: Noise,
    local: Sequence[FloatArray] | None = None,
) -> AtFixedParameters:
    """Normal equations by `free` at given parameters and noise. local: measured initial states and no disturbances where None."""
    at = State(np.zeros(0), [part.start_local() for part in problem.parts] if local is None else list(local), [])
    at.made = problem.evaluate(values, at.local, free)
    weighing = LikelihoodWeights.even(problem, noise, robust=True).by_response(at.made)
    normal, backs = weighing.normal_equations(at, free)
    return AtFixedParameters(normal, weighing, at, tuple(backs))


def stored_noise(stored: NoiseBlock, problem: Problem) -> Noise | None:
    """The noise of a model file, where it has that of everything in `problem`."""
    noise = Noise(stored.get("channels") or {}, stored.get("disturbances") or {}, stored.get("correlations") or {})
    whole = all(
        {*p.outputs} <= {*noise.channel} and {*p.block.disturbances} <= {*noise.disturbance} for p in problem.parts
    )
    return noise if whole else None
