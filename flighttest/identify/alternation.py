"""The paper's own procedure for thrust and drag, kept as a cross-check of the joint estimate.

Pi_3 (sigma_t, K, alpha) on the throttle steps and Pi_4 (d_x, d_y, d_z) on the larger tilt steps in turn, each by least squares on
accelerations (Table 3) from recorded initial states, until neither moves. It has no single objective, hence no covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from flighttest.identify.fit import Fit
from flighttest.identify.problem import Noise, Part, Problem
from flighttest.identify.solve import solve

PI_3 = ("sigma_t", "K", "alpha")
PI_4 = ("d_x", "d_y", "d_z")
ROUNDS = 12
TOLERANCE = 1e-3


@dataclass(frozen=True)
class Alternation:
    """values: Pi_3 and Pi_4 as the alternation ends; rounds; z: distance from the joint estimate in its standard errors."""

    values: Mapping[str, float]
    rounds: int
    settled: bool
    z: Mapping[str, float]
    sentence: str


def alternation(found: Fit) -> Alternation | None:
    """Run it from the joint estimate's delays; None where either half has no responses or the model has no drag."""
    problem = found.problem
    thrust = _only(problem, ("throttle_step",))
    tilt = _only(problem, ("roll_step", "pitch_step"))
    free_3 = tuple(n for n in PI_3 if n in problem.names and n not in found.solution.blind)
    free_4 = tuple(n for n in PI_4 if n in problem.names)
    if thrust is None or tilt is None or not free_3 or not free_4:
        return None
    noise = Noise(found.noise.channel, dict.fromkeys(found.noise.disturbance, 1e-6))
    values = {**found.values, **dict.fromkeys(free_4, 0.0)}
    rounds, settled = 0, False
    while rounds < ROUNDS and not settled:
        rounds += 1
        before = dict(values)
        for half, free in ((thrust, free_3), (tilt, free_4)):
            solved = solve(half, values, free=free, robust=False, noise=noise, estimate_noise=False, max_iterations=15)
            values = {**values, **{n: solved.values[n] for n in free}}
        settled = all(abs(values[n] - before[n]) <= TOLERANCE * max(abs(values[n]), 0.1) for n in (*free_3, *free_4))
    names = (*free_3, *free_4)
    z = {n: (values[n] - found.values[n]) / std for n in names if (std := found.estimates[n].std)}
    far = [f"{n} by {abs(v):.1f} standard errors" for n, v in z.items() if abs(v) > 3]
    word = "agrees with the joint estimate" if not far else f"differs from the joint estimate: {', '.join(far)}"
    ended = f"settled after {rounds} rounds" if settled else f"had not settled after {rounds} rounds"
    return Alternation({n: values[n] for n in names}, rounds, settled, z, f"the paper's alternation {ended} and {word}")


def _only(problem: Problem, kinds: tuple[str, ...]) -> Problem | None:
    """The translation part on these kinds of step, accelerations only, initial states held at their measurement."""
    part = next((p for p in problem.parts if p.block.name == "translation"), None)
    if part is None:
        return None
    rows = [j for j, r in enumerate(part.responses) if problem.segments[r.index].kind in kinds]
    accelerations = np.array([not c.startswith("v_") for c in part.outputs])
    if not rows or not accelerations.any():
        return None
    responses = tuple(part.responses[j] for j in rows)
    held = Part(
        part.block,
        part.outputs,
        responses,
        part.y[rows],
        part.mask[rows] & accelerations,
        part.start[rows],
        np.full_like(part.start_std[rows], 1e-6),
    )
    return replace(problem, parts=(held,))
