"""Does one number do? A parameter of the vehicle is the same in small steps and in large ones; one of a wrong model is not.

At the solution the score of every response gives where it alone would have the parameters. Taken together by the size of their steps,
responses of a wrong model pull apart by far more than like ones scatter: a ramped reference looks slower the larger the step, a boosted
throttle stronger the steeper the tilt. A standard error does not contain it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.problem import Problem
from flighttest.estimation.solver import Solution
from flighttest.estimation.uncertainty.covariance import Covariance, std_of
from flighttest.estimation.uncertainty.distributions import quantile
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

# Distinguished from one another within one response: a lag and its delay, or a single coefficient.
SETS: tuple[tuple[str, ...], ...] = (
    ("omega_phi", "zeta_phi", "omega_theta", "zeta_theta", "T_d_attitude"),
    ("sigma_r", "T_d_yaw_rate"),
    ("sigma_t", "T_d_thrust"),
    ("K", "alpha"),
    ("d_x",),
    ("d_y",),
    ("d_z",),
)
_SIZES = {"roll_step": ("amplitude_rad", "rad"), "pitch_step": ("amplitude_rad", "rad"), "yaw_rate_step": ("rate_rad_s", "rad/s"),
          "throttle_step": ("throttle_1", "throttle"), "tilt_throttle": ("throttle_1", "throttle")}  # fmt: skip
FEW_WINDOWS = 8
SMALLEST_SHARE = 0.01  # of the information on a parameter: groups with less do not determine it
CHANCE = 1e-4  # that a difference between two groups of like steps is taken for one


@dataclass(frozen=True)
class Heterogeneity:
    """A parameter's values that lie furthest apart, and what they were found in ("steps of 0.2 rad", "all together")."""

    low: float
    high: float
    low_in: str
    high_in: str

    @property
    def width(self) -> float:
        """Between the two, in the parameter's unit."""
        return self.high - self.low

    def sentence(self, unit: str) -> str:
        """In words."""
        name = f" {unit}" if unit != "1" else ""
        return f"no single value fits: {self.low:.3g}{name} in {self.low_in}, {self.high:.3g} in {self.high_in}"


def size_heterogeneity(problem: Problem, solution: Solution, covariance: Covariance) -> Mapping[str, Heterogeneity]:
    """Parameters that differ between sizes of steps by more than like steps scatter, by name; one Gauss-Newton step per group."""
    determined = np.abs(solution.normal.hessian).sum(axis=(1, 2)) > 0
    groups: dict[str, list[int]] = {}
    lively = _lively([s for s, t in zip(problem.segments, determined, strict=True) if t])
    for i in np.flatnonzero(determined):
        label = size_of(problem.segments[i]) or lively.get(problem.segments[i].name)
        if label is not None:
            groups.setdefault(label, []).append(int(i))
    groups = {label: members for label, members in groups.items() if len(members) > 1}
    found: dict[str, Heterogeneity] = {}
    for names in SETS:
        wanted = [n for n in names if n in covariance.names]
        found.update(_of_set(wanted, groups, solution, covariance) if wanted else {})
    return found


def size_of(segment: Segment) -> str | None:
    """The size of a response's step in words, by which responses are grouped; None where there is no step."""
    if segment.kind not in _SIZES:
        return None
    name, unit = _SIZES[segment.kind]
    size = abs(float(segment.cell.get(name, np.nan)))
    if not np.isfinite(size):
        return None
    return f"steps to throttle {size:.2f}" if unit == "throttle" else f"steps of {size:.2g} {unit}"


def _lively(segments: Sequence[Segment]) -> dict[str, str]:
    """Windows of free flight by name: whether they tilt more than half of them do; empty where they are few."""
    missing = np.array([np.nan])
    size: dict[str, float] = {}
    for s in segments:
        roll, pitch = s.y.get("roll_rad", missing), s.y.get("pitch_rad", missing)
        if s.kind == "free" and np.isfinite(roll).any() and np.isfinite(pitch).any():
            size[s.name] = float(np.hypot(np.nanstd(roll), np.nanstd(pitch)))
    if len(size) < FEW_WINDOWS:
        return {}
    middle = float(np.median(list(size.values())))
    return {n: "the livelier windows" if v > middle else "the calmer windows" for n, v in size.items()}


def _of_set(
    names: Sequence[str], groups: Mapping[str, Sequence[int]], solution: Solution, covariance: Covariance
) -> dict[str, Heterogeneity]:
    pick = np.array([solution.normal.names.index(n) for n in names])
    hessian, score = solution.normal.hessian[:, pick[:, None], pick], solution.normal.score[:, pick]
    total = np.diag(hessian.sum(axis=0))
    rows: dict[str, list[tuple[float, float, str]]] = {n: [] for n in names}
    moved: list[tuple[str, FloatArray, FloatArray, float]] = []
    scatter, dof = 0.0, 0.0
    for label, members in groups.items():
        information = hessian[members].sum(axis=0)
        if np.any(np.diag(information) < SMALLEST_SHARE * total):
            continue
        inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
        shift = inverse @ score[members].sum(axis=0)
        rest = score[members] - hessian[members] @ shift
        # How many responses carry information, by their leverage; and how they scatter, in units of what the noise model expects.
        leverage = np.einsum("sij,ji->s", hessian[members], inverse)
        count = float(leverage.sum() ** 2 / (leverage**2).sum())
        own = float(np.einsum("si,ij,sj->", rest, inverse, rest)) / len(names) * count
        scatter += own
        dof += count - 1.0
        moved.append((label, shift, np.diag(inverse), own / max(count - 1.0, 1.0)))
    if len(moved) < 2 or dof < 1.0:
        return {}
    factor = -quantile(CHANCE / 2, dof)
    for label, shift, variance, own in moved:
        inflated = max(scatter / dof, own, 1.0)
        for name, by, v in zip(names, shift, variance, strict=True):
            rows[name].append((solution.values[name] + float(by), factor * float(np.sqrt(inflated * v)), label))
    found = {}
    for name, values in rows.items():
        # A value outside all groups' comes of groups that differ in something else, and were flown at other voltages or speeds.
        k = covariance.names.index(name)
        sure = -quantile(CHANCE / 2, float(covariance.dof[k])) * std_of(covariance, name)
        values.append((solution.values[name], sure, "all of them together"))
        low, high = min(values), max(values)
        if high[0] - low[0] > float(np.hypot(low[1], high[1])):
            found[name] = Heterogeneity(low[0], high[0], low[2], high[2])
    return found
