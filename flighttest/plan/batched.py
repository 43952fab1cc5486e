"""Batched rehearsal: the rows of a request integrated together, and what begins alike flown once.

A row with the link lost is the row it comes from until then: with a predictor that can take a flight up again only the rest is flown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.plan.model import BranchingPredictor, FloatArray, PredictedMotion, Predictor, Snapshot, Trail
from flighttest.plan.rehearse import (
    GUID_TIMEOUT_S,
    Rehearsal,
    Row,
    StopPolicy,
    levelled,
    reach,
    reaction_s,
    rehearse,
    steps_of,
)

IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class Request:
    """Rows to be flown (see `rehearse`). lost_for_s: how long after the loss of its link a row is of interest; None: as all others;
    lost_heights: only heights are, after the loss and before it: the rest of such rows may be left at zero."""

    rows: Sequence[Row]
    dt_s: float
    after_s: float | None = None
    lost_for_s: float | None = None
    lost_heights: bool = False


def fly_rows(ask: Request, predictor: Predictor) -> Rehearsal:
    """The rows of a request, flown on the prior model, in their order."""
    if not isinstance(predictor, BranchingPredictor):
        return rehearse(ask.rows, predictor, ask.dt_s, ask.after_s)
    made = _Filling(ask, steps_of(ask.rows, predictor, ask.dt_s, ask.after_s))
    originals = _planned_rows(ask.rows)
    # What only goes up and down is flown apart: the predictor may have a shorter way for it.
    for straight in (True, False):
        _fly([original for original in originals if original.row.straight is straight], made, predictor, ask.dt_s)
    return made.rehearsal(ask.dt_s)


@dataclass
class _Planned:
    """A row as planned: its place in the answer (None: it was not asked for) and the places of its like that lose the link."""

    row: Row
    place: int | None
    lost: list[int]


class _Filling:
    """An answer on its way."""

    def __init__(self, ask: Request, steps: int) -> None:
        self.ask, self.steps = ask, steps
        n = len(ask.rows)
        self.p, self.v = (np.zeros((n, 3, steps + 1)).transpose(0, 2, 1) for _ in range(2))
        self.low, self.high = np.empty((n, steps + 1)), np.empty((n, steps + 1))
        self.counter_s, self.vertical_s, self.throttle = np.zeros(n), np.zeros(n), np.zeros(n)

    def rehearsal(self, dt_s: float) -> Rehearsal:
        # Planning does not use the attitude.
        motion = PredictedMotion(np.arange(self.steps + 1, dtype=float) * dt_s, self.p, self.v, np.zeros((0, 0, 3)))
        return Rehearsal(motion, self.low, self.high, self.counter_s, self.vertical_s, self.throttle)


def _planned_rows(rows: Sequence[Row]) -> list[_Planned]:
    own: dict[int, _Planned] = {}
    for place, row in enumerate(rows):
        planned = own.setdefault(id(row.of or row), _Planned(row.of or row, None, []))
        if planned.row is row:
            planned.place = place
        else:
            planned.lost.append(place)
    return list(own.values())


def _fly(originals: list[_Planned], made: _Filling, predictor: BranchingPredictor, dt_s: float) -> None:
    if not originals:
        return
    rows = [original.row for original in originals]
    policy = StopPolicy(rows, predictor, made.steps, dt_s)
    trail = predictor.fly_each(
        np.array([row.start_m for row in rows], dtype=float),
        np.array([row.yaw_rad for row in rows], dtype=float),
        np.array([row.voltage_v for row in rows], dtype=float),
        policy,
        np.full(len(rows), made.steps, dtype=np.intp),
        dt_s,
    )
    motion = trail.motion
    low, high = reach(motion, policy.sent.T, policy.hover, reaction_s(predictor))
    for j, original in enumerate(originals):
        if original.place is None:
            continue
        place = original.place
        made.p[place], made.v[place] = motion.p_m[j], motion.v_m_s[j]
        made.low[place], made.high[place] = low[j], high[j]
        made.counter_s[place], made.vertical_s[place] = policy.counter_s[j], policy.vertical_s[j]
        made.throttle[place] = policy.vertical_throttle[j]
    _lose_links(originals, trail, policy, made, predictor, dt_s)


def _lose_links(
    originals: list[_Planned],
    trail: Trail,
    policy: StopPolicy,
    made: _Filling,
    predictor: BranchingPredictor,
    dt_s: float,
) -> None:
    branches: list[tuple[int, int, int, int, int]] = []  # steps, original, at, held, place
    for j, original in enumerate(originals):
        for place in original.lost:
            lost_s = made.ask.rows[place].lost_s
            begin = min(math.ceil((lost_s - 1e-9) / dt_s), made.steps)
            wait = math.ceil((lost_s + GUID_TIMEOUT_S - 1e-9) / dt_s) - begin
            left = made.steps - begin
            if made.ask.lost_for_s is not None:
                left = min(left, math.ceil(made.ask.lost_for_s / dt_s) + 1)
            branches.append((left, j, begin, wait, place))
    if not branches:
        return
    branches.sort(key=lambda branch: -branch[0])
    steps, of, at, held, _ = np.array(branches, dtype=np.intp).T
    asked = trail.asked[np.maximum(at - 1, 0), :, of]
    asked[at == 0] = policy.table[0, of[at == 0]]
    rest = predictor.branch(trail, of, at, _Lost(asked, held, policy.hover[of], dt_s), steps, dt_s).motion
    motion = trail.motion
    pairs = ((motion.p_m, rest.p_m), (motion.v_m_s, rest.v_m_s))
    for k, (count, j, begin, _, place) in enumerate(branches):
        what = slice(2, 3) if made.ask.lost_heights else slice(None)
        for whole, (before, after) in zip((made.p, made.v)[: 1 if made.ask.lost_heights else 2], pairs, strict=False):
            whole[place, :begin, what] = before[j, :begin, what]
            whole[place, begin : begin + count + 1, what] = after[k, : count + 1, what]
            whole[place, begin + count + 1 :, what] = after[k, count, what]
        made.low[place] = made.high[place] = made.p[place, :, 2]


class _Lost:
    """The last target held for as long as the autopilot waits, then level."""

    def __init__(self, last: FloatArray, held: IntArray, hover_throttle: FloatArray, dt_s: float) -> None:
        self.last, self.held, self.hover, self.dt_s = last, held, hover_throttle, dt_s

    def __call__(self, now: Snapshot) -> FloatArray:
        n = len(now.p_m)
        level = round(now.t_s / self.dt_s) >= self.held[:n]
        if level.all():
            return levelled(now.v_m_s[:, 2], self.hover[:n])
        return np.where(level[:, None], levelled(now.v_m_s[:, 2], self.hover[:n]), self.last[:n])
