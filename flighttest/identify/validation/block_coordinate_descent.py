"""The paper's own procedure for thrust and drag, kept as a cross-check of the joint estimate.

Pi_3 (sigma_t, K, alpha) on the throttle steps and Pi_4 (d_x, d_y, d_z) on the larger tilt steps in turn, each by least squares on
accelerations (Table 3) from recorded initial states, until neither moves. It has no single objective, hence no covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from flighttest.estimation.gauss_newton import FitStatus
from flighttest.estimation.problem import Noise, Part, Problem
from flighttest.estimation.solver import Start, solve
from flighttest.estimation.uncertainty.covariance import cluster_covariance, std_of
from flighttest.identify.diagnostics.parameter_diagnostics import DescentBlock
from flighttest.identify.fit import Fit

PI_3 = ("sigma_t", "K", "alpha")
PI_4 = ("d_x", "d_y", "d_z")
ROUNDS = 12
TOLERANCE = 1e-3
# The two estimates differ for a reason when beyond both. The descent takes noisy initial states at their word and errs more.
FAR_STDS, FAR_SHARE = 4.0, 0.05


@dataclass(frozen=True)
class BlockDescent:
    """values: Pi_3 and Pi_4 as the descent ends; rounds; z: distance from the joint estimate in standard errors of both together;
    differs: names that do."""

    values: Mapping[str, float]
    rounds: int
    settled: bool
    z: Mapping[str, float]
    differs: tuple[str, ...]
    sentence: str


def block_coordinate_descent(found: Fit) -> BlockDescent | None:
    """Run it from the joint estimate's delays; None where either half has no responses, the model has no drag, or a half of it
    diverges."""
    problem = found.problem
    thrust = _only(problem, ("throttle_step",))
    tilt = _only(problem, ("roll_step", "pitch_step"))
    free_3 = tuple(n for n in PI_3 if n in problem.names and n not in found.solution.insensitive)
    free_4 = tuple(n for n in PI_4 if n in problem.names)
    if thrust is None or tilt is None or not free_3 or not free_4:
        return None
    noise = Noise(found.noise.channel, dict.fromkeys(found.noise.disturbance, 1e-6))
    values = {**found.values, **dict.fromkeys(free_4, 0.0)}
    rounds, settled = 0, False
    own: dict[str, float] = {}
    while rounds < ROUNDS and not settled:
        rounds += 1
        before = dict(values)
        for half, free in ((thrust, free_3), (tilt, free_4)):
            solved = solve(half, Start(values, noise), free=free, robust=False, estimate_noise=False, max_iterations=15)
            if solved.status is FitStatus.DIVERGED:
                return None
            values = {**values, **{n: solved.values[n] for n in free}}
            sensed = tuple(n for n in free if n not in solved.insensitive)
            scatter = cluster_covariance(solved.normal, sensed)
            own |= {n: std_of(scatter, n) for n in sensed}
        settled = all(abs(values[n] - before[n]) <= TOLERANCE * max(abs(values[n]), 0.1) for n in (*free_3, *free_4))
    names = (*free_3, *free_4)
    z = {
        n: (values[n] - found.values[n]) / float(np.hypot(std, own[n]))
        for n in names
        if n in own and (std := found.estimates[n].scatter)
    }
    far = [
        n
        for n, v in z.items()
        if abs(v) > FAR_STDS and abs(values[n] - found.values[n]) > FAR_SHARE * abs(found.values[n])
    ]
    ended = f"settled after {rounds} rounds" if settled else f"had not settled after {rounds} rounds"
    if far:
        numbers = ", ".join(f"{n} = {values[n]:.3g} (joint {found.values[n]:.3g})" for n in far)
        sentence = (
            f"the paper's block coordinate descent gives {numbers}: throttle steps and tilt steps do not agree on one model, so that it "
            "misses something they do not share; `flighttest diagnose` finds what"
        )
    else:
        sentence = f"the paper's block coordinate descent {ended} and agrees with the joint estimate"
    return BlockDescent({n: values[n] for n in names}, rounds, settled, z, tuple(far), sentence)


def cross_checked(found: Fit) -> Fit:
    """The fit with the descent beside it: in its checks, and in its notes where the two differ."""
    if not found.status.good:
        return found
    check = block_coordinate_descent(found)
    if check is None:
        return found
    data: DescentBlock = {
        "values": dict(check.values),
        "rounds": check.rounds,
        "differs": list(check.differs),
        "sentence": check.sentence,
    }
    notes = (*found.notes, check.sentence) if check.differs else found.notes
    return replace(found, checks={**found.checks, "alternation": data}, notes=notes)


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
