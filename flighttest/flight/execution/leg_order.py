"""Which leg is flown next: those still to fly, those put off or left out, and how many in a row did not succeed."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from typing import TypeAlias

from flighttest.flight.gate import SHOWN, Refusal
from flighttest.flight.outcome import LegOutcome, LegResult
from flighttest.plan import Leg

REFUSED_CELL_MAX = 2
# What a gust or a slow moment of the host can cause: such a leg is tried once more at the end.
_PASSING = frozenset({Refusal.HEIGHT, Refusal.ZONE, Refusal.SPEED}) | SHOWN
CellKey: TypeAlias = tuple[str, str, tuple[tuple[str, float], ...]]


class LegOrder:
    """The legs of one flight in their order. refused_in_a_row, unsettled_in_a_row: the latest legs that were refused, or not begun;
    unfit: ids of legs that the present plan does not have, since they do not fit the zone."""

    def __init__(self, legs: Iterable[Leg], planned: Iterable[Leg]) -> None:
        self._todo = deque(leg.id for leg in legs)
        self._planned = {leg.id: leg for leg in planned}
        self._refused: Counter[CellKey] = Counter()
        self._again: set[str] = set()
        self.unfit: list[str] = []
        self.refused_in_a_row = self.unsettled_in_a_row = 0

    def next(self) -> Leg | None:
        """The leg to fly now, which stays first until `drop`; None at the end."""
        while self._todo and self._todo[0] not in self._planned:
            self.unfit.append(self._todo.popleft())
        return self._planned[self._todo[0]] if self._todo else None

    @property
    def remaining(self) -> list[Leg]:
        """The legs still to fly, the next one first."""
        return [self._planned[name] for name in self._todo if name in self._planned]

    def drop(self) -> str:
        """Take the first leg out of the order; its id."""
        return self._todo.popleft()

    def refused_too_often(self, leg: Leg) -> bool:
        """Whether legs like this one were refused so often that the next would be, too."""
        return self._refused[_cell(leg)] >= REFUSED_CELL_MAX

    def plan_again(self, planned: Iterable[Leg]) -> None:
        """Go on with another plan's legs: refusals of the one before do not count for them."""
        self._planned = {leg.id: leg for leg in planned}
        self._todo.extendleft(reversed([name for name in self.unfit if name in self._planned]))
        self.unfit = [name for name in self.unfit if name not in self._planned]
        self._refused.clear()
        self.refused_in_a_row = 0

    def count(self, leg: Leg, result: LegResult) -> None:
        """Take in how a leg ended."""
        self.unsettled_in_a_row = self.unsettled_in_a_row + 1 if result.outcome is LegOutcome.NOT_SETTLED else 0
        if result.outcome is not LegOutcome.REFUSED:
            self.refused_in_a_row = 0
            return
        self.refused_in_a_row += 1
        if not result.refused or not SHOWN.issuperset(result.refused):
            self._refused[_cell(leg)] += 1

    def try_again(self, leg: Leg, result: LegResult, *, at_once: bool) -> None:
        """Put a refused leg into the order again: first where it is planned again, else last where its cause may pass, and once only."""
        if at_once:
            self._todo.appendleft(leg.id)
        elif leg.id not in self._again and _PASSING & set(result.refused):
            self._todo.append(leg.id)
        self._again.add(leg.id)


def _cell(leg: Leg) -> CellKey:
    return leg.maneuver, leg.kind, tuple(sorted(leg.cell.items()))
