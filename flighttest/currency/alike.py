"""Like with like: a new flight's steps against the same steps of the model's own flights.

What a model gets wrong about a step it gets wrong again when the step is flown again. So the responses of a new flight are not asked
where they would have the parameters, but at which parameters the model leaves of each kind of step what it left of it in its own
flights. The scores (slopes of the fit's cost) of like steps are subtracted, the model's misfit with them, and what the differences
scatter from step to step is the doubt. Steps are the units: cluster-robust, as everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.currency.compare import Estimates
from flighttest.currency.model import FloatArray
from flighttest.identify.covariance import cluster_covariance
from flighttest.identify.problem import Noise, Problem
from flighttest.identify.solve import Normal, normal_at
from flighttest.segments import Segment

MIN_STEPS = 2  # kinds of step that must tell of a parameter on both sides
MIN_SHARE = 0.02  # of the information on a parameter, for a kind of step to tell of it
VAGUE = 0.15  # relative standard error beyond which a parameter is held: its change would only blur the others
SAME_SIZE = 0.03  # relative difference of two steps' sizes within which they are the same
ROUNDS = 6
STILL = 1e-3  # relative change of a parameter at which the comparison has settled
HELD = ("alpha",)  # one flight's voltages do not tell it; K is compared where the flight was


@dataclass(frozen=True)
class Step:
    """What a model keeps of one kind of step of its own flights. cell: as `Segment.cell`; score: mean over `responses`, by parameter, at
    the model's estimates; log_voltage: ln(U / U_n), NaN where it was not recorded."""

    kind: str
    cell: Mapping[str, float]
    responses: int
    log_voltage: float
    score: Mapping[str, float]

    def same(self, kind: str, cell: Mapping[str, float]) -> bool:
        """Whether another step is the same one."""
        if kind != self.kind or set(cell) != set(self.cell):
            return False
        return all(abs(cell[k] - v) <= SAME_SIZE * abs(v) + 1e-6 for k, v in self.cell.items())


def steps_kept(normal: Normal, segments: Sequence[Segment], nominal_voltage_v: float) -> tuple[Step, ...]:
    """What to keep of a fit. normal: at the solution, clusters as `segments`."""
    found = []
    for members in _by_step(segments, _telling(normal)).values():
        first = segments[members[0]]
        mean = normal.score[members].mean(axis=0)
        told = np.abs(normal.hessian[members]).sum(axis=(0, 1)) > 0.0
        score = {n: float(v) for n, v, t in zip(normal.names, mean, told, strict=True) if t}
        volts = log_voltage([segments[i] for i in members], nominal_voltage_v)
        found.append(Step(first.kind, dict(first.cell), len(members), volts, score))
    return tuple(found)


def compare(
    kept: Sequence[Step], stored: Estimates, values: Mapping[str, float], noise: Noise, problem: Problem
) -> tuple[Estimates, Estimates] | None:
    """The model's estimates and those at which it would leave of the new steps what it left of its own: what `subset_tests` takes.

    stored: the model's; values: all its parameters; noise: its own, so that both sides are weighed alike. The second covariance is
    that of the difference, the first one is zero. None where no steps are alike.
    """
    names = [n for n in problem.names if n not in HELD and any(n in s.score for s in kept)]
    pairs = _pairs(kept, problem.segments)
    now, moved = dict(values), Normal((), np.zeros((0, 0, 0)), np.zeros((0, 0)))
    for _ in range(ROUNDS):
        if not pairs or not names:
            return None
        normal = normal_at(problem, now, (*names, "K") if "K" not in names else names, noise)
        moved = _differences(normal, pairs, kept, names)
        free = _told(moved, now)
        if set(free) != set(names):
            # What the new steps do not tell stays as the model has it.
            now = {**now, **{n: values[n] for n in names if n not in free}}
            names = free
            continue
        step = _solved(moved)
        for n, by in zip(names, step, strict=True):
            now[n] += float(np.clip(by, -0.5 * abs(now[n]), abs(now[n])))
        if all(abs(by) <= STILL * abs(now[n]) for n, by in zip(names, step, strict=True)):
            break
    if not names:
        return None
    spread = cluster_covariance(moved, tuple(names))
    watched = [n for n in stored.names if n in names]
    index = [names.index(n) for n in watched]
    covariance = spread.matrix[np.ix_(index, index)]
    away = _of_voltage(moved, pairs, kept, problem, names, values)[index]
    before = stored.select(watched)
    alpha = stored.names.index("alpha") if "alpha" in stored.names else None
    doubt = ALPHA_UNKNOWN if alpha is None else min(math.sqrt(float(stored.covariance[alpha, alpha])), ALPHA_UNKNOWN)
    covariance = covariance + np.outer(away, away) * doubt**2
    nothing = Estimates(before.name, before.names, np.array([values[n] for n in watched]), 0.0 * covariance)
    after = Estimates("new", before.names, np.array([now[n] for n in watched]), covariance, spread.dof[index])
    return nothing, after


ALPHA_UNKNOWN = 0.6  # standard error of alpha where nothing is known of it: 0 with a battery compensation, 1.7 without


def log_voltage(segments: Sequence[Segment], nominal_voltage_v: float) -> float:
    """Mean ln(U / U_n); NaN where no voltage was recorded."""
    known = [v for s in segments if np.isfinite(v := s.y.get("voltage_v", np.full(1, np.nan))).any()]
    return math.log(float(np.mean([np.nanmean(v) for v in known])) / nominal_voltage_v) if known else math.nan


def _telling(normal: Normal) -> list[int]:
    return [int(i) for i in np.flatnonzero(np.abs(normal.hessian).sum(axis=(1, 2)) > 0.0)]


def _by_step(segments: Sequence[Segment], members: Sequence[int]) -> dict[object, list[int]]:
    found: dict[object, list[int]] = {}
    for i in members:
        if segments[i].cell:
            found.setdefault(segments[i].cell_key, []).append(i)
    return found


def _pairs(kept: Sequence[Step], segments: Sequence[Segment]) -> list[tuple[int, list[int]]]:
    """Kept steps with the new responses of the same kind."""
    found = []
    for members in _by_step(segments, range(len(segments))).values():
        first = segments[members[0]]
        match = next((k for k, s in enumerate(kept) if s.same(first.kind, first.cell)), None)
        if match is not None:
            found.append((match, members))
    return found


def _weight(step: Step, count: int) -> float:
    """Responses that a difference of two means is worth."""
    return step.responses * count / (step.responses + count)


def _differences(
    normal: Normal, pairs: Sequence[tuple[int, list[int]]], kept: Sequence[Step], names: Sequence[str]
) -> Normal:
    """Normal equations of the change, one cluster per kind of step."""
    pick = np.array([normal.names.index(n) for n in names])
    hessian, score = [], []
    for k, members in pairs:
        weight = _weight(kept[k], len(members))
        before = np.array([kept[k].score.get(n, 0.0) for n in names])
        hessian.append(weight * normal.hessian[members].mean(axis=0)[np.ix_(pick, pick)])
        told = np.diag(hessian[-1]) > 0.0
        score.append(weight * np.where(told, normal.score[members].mean(axis=0)[pick] - before, 0.0))
    return Normal(tuple(names), np.array(hessian), np.array(score))


def _told(moved: Normal, values: Mapping[str, float]) -> list[str]:
    """Parameters that enough kinds of step tell of, well enough."""
    names = list(moved.names)
    diagonal = np.einsum("sii->si", moved.hessian)
    share = diagonal / np.maximum(diagonal.sum(axis=0), 1e-300)
    names = [n for i, n in enumerate(names) if int((share[:, i] > MIN_SHARE).sum()) >= MIN_STEPS]
    while names:
        pick = [moved.names.index(n) for n in names]
        inverse = _inverse(moved.hessian[:, pick][:, :, pick].sum(axis=0))
        vague = np.sqrt(np.diag(inverse)) / np.abs([values[n] for n in names])
        worst = int(np.argmax(vague))
        if vague[worst] <= VAGUE:
            break
        names.pop(worst)
    return names


def _inverse(total: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    inverse = np.linalg.pinv(total * np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return np.asarray(inverse * np.outer(scale, scale))


def _solved(moved: Normal) -> FloatArray:
    return np.asarray(_inverse(moved.hessian.sum(axis=0)) @ moved.score.sum(axis=0))


def _of_voltage(
    moved: Normal,
    pairs: Sequence[tuple[int, list[int]]],
    kept: Sequence[Step],
    problem: Problem,
    names: Sequence[str],
    values: Mapping[str, float],
) -> FloatArray:
    """(n,) what an error of one in the model's alpha moves each parameter by: the packs of both sides were not the same."""
    if "K" not in names:
        return np.zeros(len(names))
    k = list(names).index("K")
    pushed = np.zeros(len(names))
    for (match, members), hessian in zip(pairs, moved.hessian, strict=True):
        there = log_voltage([problem.segments[i] for i in members], problem.model.nominal_voltage_v)
        away = there - kept[match].log_voltage
        if math.isfinite(away):
            pushed += hessian[:, k] * values["K"] * away
    return np.asarray(_inverse(moved.hessian.sum(axis=0)) @ pushed)
