"""What a diagnosis asks of each part of the model (roll and pitch, yaw rate, translation), and what it is answered.

Parts share no parameter, so that each is searched by itself: by output error (`output_error`) or by prediction errors (`free_flight`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.model import EXPLAINED_SHARE, Finding, Located, Untestable, channel_words
from flighttest.diagnose.records import (
    ABOVE_FLOOR,
    CandidateRow,
    FloorRow,
    HeldOutRow,
    MapCell,
    Overlay,
    ParameterRow,
    RegimeCurve,
)
from flighttest.diagnose.selection.search import silent
from flighttest.diagnose.step_error import StepError
from flighttest.identify.fit import Fit
from flighttest.identify.free_flight.estimated import HeldEstimate
from flighttest.identify.free_flight.winds import FlightWind
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

SEED = 0  # of sign flips and resampling: the same recordings give the same diagnosis
TOGETHER = ""  # all channels of a part, in `PartAnswer.shares`

A = TypeVar("A")
B = TypeVar("B")
V = TypeVar("V")


class SideBySide(Protocol):
    """A way to run work(items), one result for each item, in more than one process; shares: of the work that each item is, roughly."""

    def __call__(
        self, work: Callable[[Sequence[A]], list[B]], items: Sequence[A], shares: Sequence[float], /
    ) -> list[B]:
        """The results, in order."""


def one_after_the_other(
    work: Callable[[Sequence[A]], list[B]], items: Sequence[A], _shares: Sequence[float], /
) -> list[B]:
    """All the work in this process."""
    return work(items)


@dataclass(frozen=True)
class SearchSupport:
    """What a caller supports a search with. progress: receives a sentence on each stage; side_by_side: divides work over processes."""

    progress: Callable[[str], None] = silent
    side_by_side: SideBySide = one_after_the_other


@dataclass(frozen=True)
class Asked:
    """What every part is asked about: responses, with the velocity at its time (recorded: as it was recorded); base model, candidates; the
    base model's fit by output error, None where no part is estimated by it; which responses are held out together, and in words; weather:
    flight to 'still'."""

    segments: tuple[Segment, ...]
    recorded: tuple[Segment, ...]
    model: Model
    pool: tuple[Term, ...]
    base: Fit | None
    groups: NDArray[np.intp]
    group_name: str
    previous: Mapping[str, tuple[float, float | None]]
    weather: Mapping[str, str]
    support: SearchSupport


@dataclass
class PartAnswer:
    """What was found in one part of the model, for `run` to put together; of this class itself where nothing was: nothing moves it, or an
    interrupt came before.

    accepted: named terms and what they gain, nats; terms: everything that joined the model; tried: ids of the terms that these recordings
    determine something of; floors, cells, curves, overlaid, errors, left: as in `Diagnosis`; shares: channel (short) to what stays of its
    error, or `TOGETHER` to what stays of that of all; error: which error that is, in words; staying: channels whose mismatch stays; held:
    what prediction errors or kinematics showed of the final model; null: coefficients of named terms that are held at these values, since
    their estimates were not the term's effect; winds: of flights.
    """

    complete: bool = True
    notes: list[str] = field(default_factory=list)
    accepted: dict[str, float] = field(default_factory=dict)
    terms: tuple[str, ...] = ()
    tried: frozenset[str] = frozenset()
    located: list[Located] = field(default_factory=list)
    unseen: list[Untestable] = field(default_factory=list)
    levels: dict[str, tuple[float, str]] = field(default_factory=dict)
    before: dict[str, ParameterRow] = field(default_factory=dict)
    heldout: dict[str, dict[str, HeldOutRow]] = field(default_factory=dict)
    floors: dict[str, FloorRow] = field(default_factory=dict)
    cells: list[MapCell] = field(default_factory=list)
    errors: list[StepError] = field(default_factory=list)
    left: list[StepError] = field(default_factory=list)
    curves: list[RegimeCurve] = field(default_factory=list)
    overlaid: list[Overlay] = field(default_factory=list)
    candidates: list[CandidateRow] = field(default_factory=list)
    baselines: dict[str, dict[str, float]] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)
    error: str = ABOVE_FLOOR
    staying: set[str] = field(default_factory=set)
    held: HeldEstimate | None = None
    null: dict[str, float] = field(default_factory=dict)
    winds: tuple[FlightWind, ...] = ()

    @property
    def unexplained(self) -> dict[str, float]:
        """Channel whose mismatch stays to what stays of its error, where that is more than of a mismatch that counts as explained."""
        unknown = 0.0 if self.shares else 1.0  # where none of the error is above the floor, all of it stays
        left = {c: self.shares.get(c, self.shares.get(TOGETHER, unknown)) for c in sorted(self.staying)}
        return {c: share for c, share in left.items() if share > EXPLAINED_SHARE}

    def findings(self, asked: Asked, table: Mapping[str, ParameterRow]) -> list[Finding]:
        """Of every named term. table: parameters of the final model."""
        del asked, table
        return []


def listed(answers: Sequence[PartAnswer], what: str) -> list[Any]:
    """One of the answers' lists (a field of `PartAnswer`), one after the other."""
    return [each for a in answers for each in getattr(a, what)]


def error_left(answers: Sequence[PartAnswer]) -> tuple[float, str]:
    """Share of the error that stays, and which error, in words: mean over the channels of a part that are not explained, of the part where
    it is largest; where every channel is, of all. Channels are of different physics: an attitude or a velocity that is explained makes up
    for no force that is not."""
    shares = [(float(np.mean([*a.unexplained.values()])), a) for a in answers if a.unexplained]
    if shares:
        share, worst = max(shares, key=lambda one: one[0])
        return share, f"{worst.error} in {', '.join(map(channel_words, worst.unexplained))}"
    kinds = {a.error for a in answers if a.shares}
    error = "error" if len(kinds) > 1 else next(iter(kinds), ABOVE_FLOOR)
    return float(np.mean([share for a in answers for share in a.shares.values()] or [0.0])), error


def merged(tables: Iterable[Mapping[str, V]]) -> dict[str, V]:
    """Tables in one; of a key that occurs twice the last."""
    return {key: value for table in tables for key, value in table.items()}
