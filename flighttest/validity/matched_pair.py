"""Matched pairs: a new flight's steps against the same steps of the model's own flights.

What a model gets wrong about a step it gets wrong again when that step is flown again. So a new flight is not asked for its best
parameters, but for those at which the model misses each kind of step as it missed it in its own flights. The scores (slopes of the
fit's cost by the parameters) of like steps are subtracted, and what the model gets wrong goes with them; what the differences
scatter from one kind of step to the next is the doubt (cluster-robust, kinds of step being the clusters).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from flighttest.documents import PlainData
from flighttest.estimation.likelihood_weights import Normal
from flighttest.estimation.problem import Noise, Problem
from flighttest.estimation.uncertainty.covariance import cluster_covariance
from flighttest.identify.fixed_parameters import AtFixedParameters, normal_at
from flighttest.identify.models.model_blocks import StepsBlock
from flighttest.segments import Segment
from flighttest.segments.commands import held_until_s
from flighttest.validity.between_campaigns import prior
from flighttest.validity.compare import Estimates, MatchedPairs
from flighttest.validity.model import FloatArray

MIN_STEPS = 2  # kinds of step that must determine a parameter
MIN_SHARE = 0.02  # of the information on a parameter, for a kind of step to determine it
VAGUE = 0.15  # relative standard error beyond which a parameter is held at the model's: it would only blur the others
DELAY_S = 0.1  # what a delay's error is relative to
SAME_HOLD_S = 0.03  # two targets at 50 Hz: what two flights of one plan differ by is less
SAME_SIZE = 0.03  # relative difference of two steps' sizes within which they are the same
ROUNDS = 6
LARGEST = 0.3  # relative change of a parameter in one round
STILL = 1e-3  # relative change of every parameter at which the comparison has settled
ALPHA_UNKNOWN = 0.6  # standard error of alpha where nothing is known of it: 0 with a battery compensation, 1.7 without


@dataclass(frozen=True)
class StepScore:
    """What a model keeps of one kind of step of its own flights. cell: as `Segment.cell`; score: mean over `responses`, by parameter, at
    the model's estimates; log_voltage: ln(U / U_n), NaN where it was not recorded; seconds: how long after the step the longest of the
    records ends; held_s: how long its command stayed as the step had set it; NaN where they were not kept."""

    kind: str
    cell: Mapping[str, float]
    responses: int
    log_voltage: float
    score: Mapping[str, float]
    seconds: float = math.nan
    held_s: float = math.nan

    def same(self, kind: str, cell: Mapping[str, float]) -> bool:
        """Whether another step is the same one."""
        if kind != self.kind or set(cell) != set(self.cell):
            return False
        return all(abs(cell[k] - v) <= SAME_SIZE * abs(v) + 1e-6 for k, v in self.cell.items())


def steps_flown(normal: Normal, segments: Sequence[Segment], nominal_voltage_v: float) -> tuple[StepScore, ...]:
    """What to keep of a fit. normal: at the solution, clusters as `segments`."""
    found = []
    determined = np.abs(normal.hessian).sum(axis=(1, 2)) > 0.0
    for members in _by_step(segments, determined):
        first, score = segments[members[0]], normal.score[members].mean(axis=0)
        volts = _log_voltage([segments[i] for i in members], nominal_voltage_v)
        kept = dict(zip(normal.names, score.tolist(), strict=True))
        longest = max((segments[i] for i in members), key=lambda s: s.seconds)
        until = longest.seconds, held_until_s(longest)
        found.append(StepScore(first.kind, dict(first.cell), len(members), volts, kept, *until))
    return tuple(found)


def matched_pair_data(steps: Sequence[StepScore]) -> StepsBlock:
    """For model.yaml: parameters in order, and one line per kind of step."""
    order = list(steps[0].score) if steps else []
    rows: list[dict[str, PlainData]] = [
        {
            "kind": s.kind,
            **{k: float(f"{v:.6g}") for k, v in s.cell.items()},
            "responses": s.responses,
            "log_voltage": round(s.log_voltage, 5) if math.isfinite(s.log_voltage) else None,
            "seconds": round(s.seconds, 3) if math.isfinite(s.seconds) else None,
            "held_s": round(s.held_s, 3) if math.isfinite(s.held_s) else None,
            "score": [float(f"{s.score[n]:.6g}") for n in order],
        }
        for s in steps
    ]
    return {"order": order, "flown": rows}


def matched_pairs_from(data: object) -> tuple[StepScore, ...]:
    """What `matched_pair_data` wrote; nothing where a model was written without it or by hand."""
    try:
        order, rows = list(data["order"]), list(data["flown"])  # type: ignore[index]
        return tuple(_step(order, dict(row)) for row in rows)
    except (KeyError, TypeError, ValueError, OverflowError):
        return ()


def _step(order: Sequence[str], row: dict[str, Any]) -> StepScore:
    kind, count, volts, score = (row.pop(k) for k in ("kind", "responses", "log_voltage", "score"))
    seconds, held = row.pop("seconds", None), row.pop("held_s", None)  # older models have none
    cell = {str(k): float(v) for k, v in row.items()}
    kept = {str(n): float(v) for n, v in zip(order, score, strict=True)}
    return StepScore(str(kind), cell, int(count), _known(volts), kept, _known(seconds), _known(held))


def _known(value: Any) -> float:
    return math.nan if value is None else float(value)


def as_long_as(kept: Sequence[StepScore], segments: Sequence[Segment]) -> tuple[Segment, ...]:
    """New responses as far as their command and their record go with those of a model's own flights after the same step, or after any of
    its kind where these did not fly it: of what comes later it is not known how the model misses it. Of a kind that they did not fly: as
    they are."""

    def alike_s(segment: Segment) -> float:
        of_kind = [s for s in kept if s.kind == segment.kind and math.isfinite(s.seconds)]
        same = [s for s in of_kind if s.same(segment.kind, segment.cell)]
        held = held_until_s(segment)
        return max((_alike_s(s, held, segment.seconds) for s in same or of_kind), default=math.inf)

    return tuple(s.until(alike_s(s)) for s in segments)


def _alike_s(kept: StepScore, held_s: float, seconds: float) -> float:
    """How long after the step a kept one is like one whose command is held for so long and whose record ends then, s."""
    first = min(kept.held_s, held_s)
    parts = abs(kept.held_s - held_s) > SAME_HOLD_S and first < min(kept.seconds, seconds)
    return first if parts else kept.seconds


def compare_matched(
    kept: Sequence[StepScore], stored: Estimates, values: Mapping[str, float], noise: Noise, problem: Problem
) -> MatchedPairs | None:
    """The new steps of `problem` against those a model kept; None where too few match.

    stored: the model's estimates, of which alpha's error counts; values: all its parameters; noise: its own, so that both sides
    have the same weights. One flight's voltages do not determine alpha: it is held, and K compared at the voltages flown.
    """
    pairs = _pairs(kept, problem.segments)
    known = {n for s in kept for n in s.score}
    names = [n for n in problem.names if n in known and n != "alpha"]
    if not pairs or not names:
        return None
    held = normal_at(problem, values, names, noise)
    # The responses' own initial states first: the parameters answer to what they leave.
    held = normal_at(problem, values, names, noise, held.after(np.zeros(len(names))))
    names = _determined(_differences(held.normal, pairs), values, held)
    if not names:
        return None
    param, now = problem.model.param, dict(values)
    for _ in range(ROUNDS):
        moved = _only(_differences(held.normal, pairs), names)
        step = _inverse(moved.hessian.sum(axis=0)) @ moved.score.sum(axis=0)
        size = np.array([_size(n, now) for n in names])
        if bool(np.all(np.abs(step) <= STILL * size)):
            break
        taken = np.zeros(len(held.normal.names))
        for n, by in zip(names, np.clip(step, -LARGEST * size, LARGEST * size), strict=True):
            target = float(np.clip(now[n] + by, param[n].lower, param[n].upper))
            taken[held.normal.names.index(n)] = target - now[n]
            now[n] = target
        held = normal_at(problem, now, held.normal.names, noise, held.after(taken))
    moved = _only(_differences(held.normal, pairs), names)
    spread = cluster_covariance(moved, moved.names, partial(held.colored, moved.names))
    # What has not settled by now, or hangs at a bound, was not determined after all.
    rest = np.abs(_inverse(moved.hessian.sum(axis=0)) @ moved.score.sum(axis=0))
    settled = {
        n
        for n, by, std in zip(names, rest, np.sqrt(np.diag(spread.matrix)), strict=True)
        if by <= max(std, STILL * _size(n, now))
    }
    watched = [n for n in stored.names if n in settled]
    if not watched:
        return None
    index = [names.index(n) for n in watched]
    away = _of_voltage(moved, pairs, problem, values)[index]
    covariance = spread.matrix[np.ix_(index, index)] + np.outer(away, away) * _alpha_std(stored) ** 2
    before = Estimates(stored.name, tuple(watched), np.array([values[n] for n in watched]), 0.0 * covariance)
    after = Estimates("new", before.names, np.array([now[n] for n in watched]), covariance, spread.dof[index])
    return MatchedPairs(before, after, len(pairs))


def _alpha_std(stored: Estimates) -> float:
    """How far the model's alpha may be off, and differ from one campaign to the next."""
    if "alpha" not in stored.names:
        return ALPHA_UNKNOWN
    i = stored.names.index("alpha")
    own = math.sqrt(float(stored.covariance[i, i]))
    return min(math.hypot(own, prior("alpha") * float(stored.values[i])), ALPHA_UNKNOWN)


def _size(name: str, values: Mapping[str, float]) -> float:
    """What a parameter's error is relative to."""
    return DELAY_S if name.startswith("T_d") else max(abs(values[name]), 1e-9)


def _log_voltage(segments: Sequence[Segment], nominal_voltage_v: float) -> float:
    known = [v for s in segments if np.isfinite(v := s.y.get("voltage_v", np.full(1, np.nan))).any()]
    return math.log(float(np.mean([np.nanmean(v) for v in known])) / nominal_voltage_v) if known else math.nan


def _by_step(segments: Sequence[Segment], used: Sequence[bool] | FloatArray) -> list[list[int]]:
    found: dict[object, list[int]] = {}
    for i, segment in enumerate(segments):
        if used[i] and segment.cell:
            found.setdefault(segment.cell_key, []).append(i)
    return list(found.values())


def _pairs(kept: Sequence[StepScore], segments: Sequence[Segment]) -> list[tuple[StepScore, list[int]]]:
    """Kept steps with the new responses of the same kind."""
    found = []
    for members in _by_step(segments, [True] * len(segments)):
        first = segments[members[0]]
        match = next((s for s in kept if s.same(first.kind, first.cell)), None)
        if match is not None:
            found.append((match, members))
    return found


def _differences(normal: Normal, pairs: Sequence[tuple[StepScore, list[int]]]) -> Normal:
    """Normal equations of the change, one cluster per kind of step: a difference of two means counts as so many responses."""
    hessian, score = [], []
    for step, members in pairs:
        weight = step.responses * len(members) / (step.responses + len(members))
        hessian.append(weight * normal.hessian[members].mean(axis=0))
        before = np.array([step.score.get(n, 0.0) for n in normal.names])
        determined = np.diag(hessian[-1]) > 0.0
        score.append(weight * np.where(determined, normal.score[members].mean(axis=0) - before, 0.0))
    return Normal(normal.names, np.array(hessian), np.array(score))


def _only(normal: Normal, names: Sequence[str]) -> Normal:
    pick = [normal.names.index(n) for n in names]
    return Normal(tuple(names), normal.hessian[:, pick][:, :, pick], normal.score[:, pick])


def _determined(moved: Normal, values: Mapping[str, float], held: AtFixedParameters) -> list[str]:
    """Parameters that enough kinds of step determine, and agree on."""
    diagonal = np.einsum("sii->si", moved.hessian)
    share = diagonal / np.maximum(diagonal.sum(axis=0), 1e-300)
    names = [n for i, n in enumerate(moved.names) if int((share[:, i] > MIN_SHARE).sum()) >= MIN_STEPS]
    while names:
        spread = cluster_covariance(moved, tuple(names), partial(held.colored, tuple(names)))
        error = np.sqrt(np.diag(spread.matrix))
        vague = error / np.array([_size(n, values) for n in names])
        worst = int(np.argmax(vague))
        if vague[worst] <= VAGUE:
            break
        names.pop(worst)
    return names


def _inverse(total: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    inverse = np.linalg.pinv(total * np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return np.asarray(inverse * np.outer(scale, scale))


def _of_voltage(
    moved: Normal,
    pairs: Sequence[tuple[StepScore, list[int]]],
    problem: Problem,
    values: Mapping[str, float],
) -> FloatArray:
    """(n,) what an error of one in the model's alpha moves each parameter by: the packs of both sides were not as full."""
    pushed = np.zeros(len(moved.names))
    if "K" not in moved.names:
        return pushed
    k = moved.names.index("K")
    for (step, members), hessian in zip(pairs, moved.hessian, strict=True):
        there = _log_voltage([problem.segments[i] for i in members], problem.model.nominal_voltage_v)
        away = there - step.log_voltage
        if math.isfinite(away):
            pushed += hessian[:, k] * values["K"] * away
    return np.asarray(_inverse(moved.hessian.sum(axis=0)) @ pushed)
