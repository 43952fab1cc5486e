"""Batched rehearsal: several plans flown at once, and what begins alike flown once.

A plan is compiled by a generator that yields what is to be flown (`Request`) and is sent the `Rehearsal`; nothing in it depends on who else
asks. A row with the link lost is the row it comes from until then: with a predictor that can take a flight up again only the rest is flown.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from flighttest.plan.model import BranchingPredictor, FloatArray, Motion, Predictor, Snapshot, Trail
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

T = TypeVar("T")
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


Work = Generator[Request, Rehearsal, T]


def finish(work: Work[T], predictor: Predictor) -> T:
    """Run one piece of work to its end."""
    return run_batched([work], predictor)[0]


def run_batched(works: Iterable[Work[T]], predictor: Predictor) -> list[T]:
    """Run several to their ends; what they ask for next is flown at once."""
    running = dict(enumerate(works))
    results: dict[int, T] = {}
    answers: dict[int, Rehearsal | None] = dict.fromkeys(running)
    while running:
        asks: dict[int, Request] = {}
        for i, work in list(running.items()):
            answer = answers[i]
            try:
                asks[i] = next(work) if answer is None else work.send(answer)
            except StopIteration as stop:
                results[i] = stop.value
                del running[i]
        answers = dict(zip(asks, flown(list(asks.values()), predictor), strict=True))
    return [results[i] for i in sorted(results)]


def flown(asks: Sequence[Request], predictor: Predictor) -> list[Rehearsal]:
    """What was asked for, in order."""
    if not isinstance(predictor, BranchingPredictor):
        return [rehearse(ask.rows, predictor, ask.dt_s, ask.after_s) for ask in asks]
    found: dict[int, _Filling] = {}
    for dt_s in {ask.dt_s for ask in asks}:
        wanted = [i for i, ask in enumerate(asks) if ask.dt_s == dt_s]
        made = {i: _Filling(asks[i], steps_of(asks[i].rows, predictor, dt_s, asks[i].after_s)) for i in wanted}
        originals = _planned_rows(made)
        # What only goes up and down is flown apart: the predictor may have a shorter way for it.
        for straight in (True, False):
            _fly([m for m in originals if m.row.straight is straight], made, predictor, dt_s)
        found |= made
    return [found[i].rehearsal(ask.dt_s) for i, ask in enumerate(asks)]


@dataclass
class _Planned:
    """A row as planned: whose request, for how many steps, its place in the answer (None: nobody asked for it) and its like that lose
    the link."""

    ask: int
    row: Row
    steps: int
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
        # Nobody who plans asks for the attitude.
        motion = Motion(np.arange(self.steps + 1, dtype=float) * dt_s, self.p, self.v, np.zeros((0, 0, 3)))
        return Rehearsal(motion, self.low, self.high, self.counter_s, self.vertical_s, self.throttle)


def _planned_rows(made: dict[int, _Filling]) -> list[_Planned]:
    found: list[_Planned] = []
    for i, filling in made.items():
        own: dict[int, _Planned] = {}
        for place, row in enumerate(filling.ask.rows):
            original = row.of or row
            if id(original) not in own:
                own[id(original)] = _Planned(i, original, filling.steps, None, [])
            if original is row:
                own[id(original)].place = place
            else:
                own[id(original)].lost.append(place)
        found += own.values()
    return sorted(found, key=lambda original: -original.steps)


def _fly(originals: list[_Planned], made: dict[int, _Filling], predictor: BranchingPredictor, dt_s: float) -> None:
    if not originals:
        return
    rows = [original.row for original in originals]
    policy = StopPolicy(rows, predictor, originals[0].steps, dt_s)
    trail = predictor.fly_each(
        np.array([row.start_m for row in rows], dtype=float),
        np.array([row.yaw_rad for row in rows], dtype=float),
        np.array([row.voltage_v for row in rows], dtype=float),
        policy,
        np.array([original.steps for original in originals], dtype=np.intp),
        dt_s,
    )
    motion = trail.motion
    low, high = reach(motion, policy.sent.T, policy.hover, reaction_s(predictor))
    for j, original in enumerate(originals):
        if original.place is None:
            continue
        into, place, end = made[original.ask], original.place, original.steps + 1
        into.p[place], into.v[place] = motion.p_m[j, :end], motion.v_m_s[j, :end]
        into.low[place], into.high[place] = low[j, :end], high[j, :end]
        into.counter_s[place], into.vertical_s[place] = policy.counter_s[j], policy.vertical_s[j]
        into.throttle[place] = policy.vertical_throttle[j]
    _lose_links(originals, trail, policy, made, predictor, dt_s)


def _lose_links(
    originals: list[_Planned],
    trail: Trail,
    policy: StopPolicy,
    made: dict[int, _Filling],
    predictor: BranchingPredictor,
    dt_s: float,
) -> None:
    branches: list[tuple[int, int, int, int, _Filling, int]] = []  # steps, original, at, held, into, place
    for j, original in enumerate(originals):
        into = made[original.ask]
        for place in original.lost:
            lost_s = into.ask.rows[place].lost_s
            begin = min(math.ceil((lost_s - 1e-9) / dt_s), original.steps)
            wait = math.ceil((lost_s + GUID_TIMEOUT_S - 1e-9) / dt_s) - begin
            left = original.steps - begin
            if into.ask.lost_for_s is not None:
                left = min(left, math.ceil(into.ask.lost_for_s / dt_s) + 1)
            branches.append((left, j, begin, wait, into, place))
    if not branches:
        return
    branches.sort(key=lambda branch: -branch[0])
    steps, of, at, held = np.array([branch[:4] for branch in branches], dtype=np.intp).T
    asked = trail.asked[np.maximum(at - 1, 0), :, of]
    asked[at == 0] = policy.table[0, of[at == 0]]
    rest = predictor.branch(trail, of, at, _Lost(asked, held, policy.hover[of], dt_s), steps, dt_s).motion
    motion = trail.motion
    pairs = ((motion.p_m, rest.p_m), (motion.v_m_s, rest.v_m_s))
    for k, (count, j, begin, _, into, place) in enumerate(branches):
        what = slice(2, 3) if into.ask.lost_heights else slice(None)
        for whole, (before, after) in zip((into.p, into.v)[: 1 if into.ask.lost_heights else 2], pairs, strict=False):
            whole[place, :begin, what] = before[j, :begin, what]
            whole[place, begin : begin + count + 1, what] = after[k, : count + 1, what]
            whole[place, begin + count + 1 :, what] = after[k, count, what]
        into.low[place] = into.high[place] = into.p[place, :, 2]


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
