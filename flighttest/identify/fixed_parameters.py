"""Responses at parameters that are given, not estimated: scores and information, the responses' own unknowns followed along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.likelihood_weights import LikelihoodWeights, Normal, State, start_noise
from flighttest.estimation.problem import Noise, PartEvaluation, Problem
from flighttest.identify.models.model_blocks import NoiseBlock

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class AtFixedParameters:
    """Normal equations at given parameters, noise and locals, what they are made of, and how the locals follow the parameters."""

    normal: Normal
    made: tuple[PartEvaluation, ...]
    noise: Noise
    local: tuple[FloatArray, ...]
    backs: tuple[tuple[FloatArray, FloatArray], ...]

    def after(self, step: FloatArray) -> tuple[FloatArray, ...]:
        """Locals for parameters moved by `step`, (p,)."""
        pairs = zip(self.local, self.backs, strict=True)
        return tuple(x + back_g - np.einsum("mlp,p->ml", back_h, step) for x, (back_g, back_h) in pairs)


def normal_at(
    problem: Problem,
    values: Mapping[str, float],
    free: Sequence[str],
    noise: Noise,
    local: Sequence[FloatArray] | None = None,
) -> AtFixedParameters:
    """Normal equations by `free` at given parameters and noise. local: measured initial states and no disturbances where None."""
    known = start_noise(problem)
    noise = Noise({**known.channel, **noise.channel}, {**known.disturbance, **noise.disturbance}, noise.correlation)
    at = State(np.zeros(0), [part.start_local() for part in problem.parts] if local is None else list(local), [])
    at.made = problem.evaluate(values, at.local, free)
    normal, backs = LikelihoodWeights.even(problem, noise, robust=True).by_response(at.made).normal_equations(at, free)
    return AtFixedParameters(normal, tuple(at.made), noise, tuple(at.local), tuple(backs))


def stored_noise(stored: NoiseBlock, problem: Problem) -> Noise | None:
    """The noise of a model file, where it has that of everything in `problem`."""
    noise = Noise(stored.get("channels") or {}, stored.get("disturbances") or {}, stored.get("correlations") or {})
    whole = all(
        {*p.outputs} <= {*noise.channel} and {*p.block.disturbances} <= {*noise.disturbance} for p in problem.parts
    )
    return noise if whole else None
