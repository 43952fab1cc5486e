"""Two fits side by side: what a term adds, and whether it has earned its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.chance import standard_errors
from flighttest.diagnose.judge import held_out, information, places, size_in_floors
from flighttest.diagnose.noise import Floor
from flighttest.diagnose.plausible import does_not_stand_out, impossible, never_reached
from flighttest.diagnose.rows import Rows, State
from flighttest.physics.model import Model
from flighttest.segments import Segment

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

LEAST_BIC = 10.0
LEAST_FLOORS = 0.7
LEAST_GAIN = 0.05


@dataclass(frozen=True)
class Fitted:
    """A model at its optimum on one bench. names: what is estimated; rows: with columns for names; dormant: terms held at off."""

    model: Model
    names: tuple[str, ...]
    state: State
    rows: Rows
    dormant: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Judged:
    """What a term adds: change of the information criterion, size in floors and where, share it takes of the held-out excess (`_gain`).

    effect, own: (measured rows,) what it changes in predictions, and with every response's locals projected out, in the channels' units.
    """

    term: str
    bic: float
    floors: float
    place: tuple[str, str]
    gain: float
    p_value: float
    effect: FloatArray
    own: FloatArray
    reason: str = ""

    @property
    def kept(self) -> bool:
        """Meets the bar."""
        return self.bic < -LEAST_BIC and self.floors >= LEAST_FLOORS and self.gain >= LEAST_GAIN and not self.reason


def explained(base: Fitted, now: Fitted) -> float:
    """How far the information criterion fell from one model to another."""
    return -information(base.rows, base.state, now.rows, now.state, len(now.names) - len(base.names))


def preferred(a: Fitted, b: Fitted) -> bool:
    """Whether a fits better than b by the information criterion, the samples counted as each of the two would have them: the one with
    the whiter residual must not win by counting more."""
    more = len(a.names) - len(b.names)
    to_a, to_b = (
        information(b.rows, b.state, a.rows, a.state, more),
        information(a.rows, a.state, b.rows, b.state, -more),
    )
    return to_a < to_b


def judge(
    term: str,
    before: Fitted,
    after: Fitted,
    p_value: float,
    floor: Floor,
    groups: IntArray,
    segments: Sequence[Segment],
) -> Judged:
    """What `after` gains over `before` by one term, held out by `groups`. p_value: that the screening's score is chance."""
    before_held = held_out(before.rows, before.names, groups)
    after_held = held_out(after.rows, after.names, groups)
    bic = information(before.rows, before.state, after.rows, after.state, len(after.names) - len(before.names))
    effect = _change(after.rows, before.rows.open_residual, after.rows.open_residual)
    floors, place = size_in_floors(after.rows, effect, segments, floor)
    gain = _gain(before_held, after_held, effect, after.rows, segments, floor, place)
    values = after.state.values
    tried = next(t for t in after.model.built_terms if t.id == term)
    reason = (
        impossible(term, after.model, after.names, values, standard_errors(after.rows, after.names))
        or never_reached(tried, values, segments)
        or does_not_stand_out(tried, after.model, after.names, values, after.rows, bic)
    )
    own = _change(after.rows, before.rows.residual * before.rows.scale, after.rows.residual * after.rows.scale)
    return Judged(term, bic, floors, place, gain, p_value, effect, own, reason)


def _gain(
    before_held: FloatArray,
    after_held: FloatArray,
    effect: FloatArray,
    rows: Rows,
    segments: Sequence[Segment],
    floor: Floor,
    largest: tuple[str, str],
) -> float:
    """Share of the held-out excess over the floor that is gone, over all places where the effect would be seen (the largest, if nowhere).

    Not at the largest place alone: a base that leaned on that place to copy the effect may do worse there by chance.
    """
    taken = excess = 0.0
    for place, at in places(rows, segments).items():
        std = floor.of(place[0])
        if place != largest and float(np.sqrt(np.mean(effect[at] ** 2))) < LEAST_FLOORS * std:
            continue
        ss_b, ss_a = float(np.mean(before_held[at] ** 2)), float(np.mean(after_held[at] ** 2))
        taken += at.size * (ss_b - ss_a) / std**2
        excess += at.size * max(ss_b - std**2, LEAST_GAIN * ss_b) / std**2
    return taken / excess if excess > 0 else 0.0


def _change(rows: Rows, first: FloatArray, second: FloatArray) -> FloatArray:
    """First minus second on what was measured, which comes first in the rows of any model."""
    measured = int(np.sum(rows.sample >= 0))
    return first[:measured] - second[:measured]
