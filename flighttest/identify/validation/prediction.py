"""Coverage of a fit's own prediction intervals: the share of held-out samples inside their 95 % interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.estimation.uncertainty.distributions import normal_quantile
from flighttest.identify.fit import Fit, heldout
from flighttest.identify.selection import Select
from flighttest.segments.model import Segment


@dataclass(frozen=True)
class Coverage:
    """share: of `count` samples inside mean +- 1.96 std; rmse and the mean predicted std in the channel's unit."""

    channel: str
    share: float
    rmse: float
    std: float
    count: int


def coverage(found: Fit, segments: Sequence[Segment], select: Select = "paper") -> tuple[Coverage, ...]:
    """Predict segments with the fit's parameters (initial states and disturbances estimated on them) and count.

    A sample's variance: the channel's residual noise in the fit, misfit included, and what the parameters' covariance makes of
    it. FitError where no segment can be predicted.
    """
    problem, solution = heldout(found, segments, select)
    names = found.covariance.names
    made = problem.evaluate(solution.values, solution.local, names)
    inside: dict[str, list[np.ndarray]] = {}
    errors: dict[str, list[np.ndarray]] = {}
    stds: dict[str, list[np.ndarray]] = {}
    z = normal_quantile(0.975)
    for part, evaluation in zip(problem.parts, made, strict=True):
        derivatives = evaluation.jacobian_by(names).reshape(*evaluation.residual.shape, -1)
        for k, channel in enumerate(part.outputs):
            slopes = derivatives[:, :, k]
            variance = (
                np.einsum("mni,ij,mnj->mn", slopes, found.covariance.matrix, slopes)
                + solution.noise.channel[channel] ** 2
            )
            mask = part.mask[..., k]
            residual, std = evaluation.residual[..., k][mask], np.sqrt(variance[mask])
            inside.setdefault(channel, []).append(np.abs(residual) <= z * std)
            errors.setdefault(channel, []).append(residual)
            stds.setdefault(channel, []).append(std)
    return tuple(
        Coverage(
            channel,
            float(np.concatenate(inside[channel]).mean()),
            float(np.sqrt(np.mean(np.concatenate(errors[channel]) ** 2))),
            float(np.concatenate(stds[channel]).mean()),
            int(sum(r.size for r in errors[channel])),
        )
        for channel in inside
    )
