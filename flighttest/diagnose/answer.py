"""What a diagnosis asks of each part of the model (roll and pitch, yaw rate, translation), and what it is answered.

Parts share no parameter, so that each is searched by itself: by output error (`output_error`) or by prediction errors (`free_flight`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

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
from flighttest.diagnose.step_error import StepError
from flighttest.identify.fit import Fit
from flighttest.identify.free_flight.estimated import HeldEstimate
from flighttest.identify.free_flight.winds import FlightWind
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

SEED = 0  # of sign flips and resampling: the same recordings give the same diagnosis

V = TypeVar("V")


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
    tell: Callable[[str], None]


@dataclass
class PartAnswer:
    """What was found in one part of the model, for `run` to put together; of this class itself where nothing was: nothing moves it, or an
    interrupt came before.

    accepted: named terms and what they gain, nats; terms: everything that joined the model; tried: ids of the terms that these recordings
    determine something of; floors, cells, curves, overlaid, errors, left: as in `Diagnosis`; shares: what stays of each channel's error,
    or of that of all; error: which error that is, in words; staying: channels (short) whose mismatch stays; held: what prediction errors or
    kinematics showed of the final model; winds: of flights.
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
    shares: list[float] = field(default_factory=list)
    error: str = ABOVE_FLOOR
    staying: set[str] = field(default_factory=set)
    held: HeldEstimate | None = None
    winds: tuple[FlightWind, ...] = ()

    @property
    def share(self) -> float:
        """What stays of its error: the mean over channels, which count alike, whatever their floors."""
        return float(np.mean(self.shares)) if self.shares else float(bool(self.staying))

    def findings(self, asked: Asked, table: Mapping[str, ParameterRow]) -> list[Finding]:
        """Of every named term. table: parameters of the final model."""
        del asked, table
        return []


def listed(answers: Sequence[PartAnswer], what: str) -> list[Any]:
    """One of the answers' lists (a field of `PartAnswer`), one after the other."""
    return [each for a in answers for each in getattr(a, what)]


def error_left(answers: Sequence[PartAnswer]) -> tuple[float, str]:
    """Share of the error that stays, and which error, in words: of the part with the largest share among those with a mismatch that stays;
    where that counts as explained, of all. Parts share no parameter: an attitude that is explained makes up for no vertical motion that
    is not."""
    worst = max((a for a in answers if a.staying), key=lambda a: a.share, default=None)
    if worst is not None and worst.share > EXPLAINED_SHARE:
        return worst.share, f"{worst.error} in {', '.join(channel_words(c) for c in sorted(worst.staying))}"
    kinds = {a.error for a in answers if a.shares}
    error = "error" if len(kinds) > 1 else next(iter(kinds), ABOVE_FLOOR)
    return float(np.mean(listed(answers, "shares") or [0.0])), error


def merged(tables: Iterable[Mapping[str, V]]) -> dict[str, V]:
    """Tables in one; of a key that occurs twice the last."""
    return {key: value for table in tables for key, value in table.items()}
