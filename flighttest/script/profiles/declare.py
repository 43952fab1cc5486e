"""What a profile declares: its settings (`Field`), and the cells it makes of them (`StepCell`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from flighttest.script.profiles.timeline import Piece

FieldKind = Literal["number", "numbers", "choice", "choices", "duration", "points", "count"]
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Duration:
    """Seconds; `up_to`: may be shortened to what zone, height and speed allow."""

    seconds: float
    up_to: bool = False


@dataclass(frozen=True)
class Field:
    """One setting of a profile. Keys ending in _rad or _rad_s may be written in degrees with _deg or _deg_s.

    default None: must be given. `throttle`: in the script's throttle unit, so its bounds depend on it.
    """

    key: str
    kind: FieldKind
    doc: str
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    default: Any = None
    choices: tuple[str, ...] = ()
    optional: bool = False
    throttle: bool = False


@dataclass(frozen=True)
class StepCell:
    """One distinct step of a script, before it is fitted into a zone.

    lead: the pieces up to the end of the record; `shortest_s` names those that may be shortened, with the least that is
    useful (None: what the delay needs). stops: how the vehicle is brought to rest afterwards, in this order: 'counter'
    (a tilt the other way, `counter`: which) and 'vertical' (a throttle of its own); the planner finds how long. tail: what
    follows. height_m: above the ground at the step, where the script asks for one. by_waypoints: flown by an outer loop.
    """

    label: str
    kind: str
    values: Mapping[str, float]
    lead: tuple[Piece, ...] = ()
    shortest_s: Mapping[str, float | None] = field(default_factory=dict)
    stops: tuple[Literal["counter", "vertical"], ...] = ()
    counter: Piece | None = None
    tail: tuple[Piece, ...] = ()
    height_m: float | None = None
    waypoints: tuple[tuple[float, float, float, float], ...] = ()
    motors_off: bool = False


@dataclass(frozen=True)
class Profile:
    """A kind of maneuver: its name in scripts, its settings and the cells it makes of them.

    cells(settings, throttle_unit): throttle_unit is what one unit of the script's throttle is as a throttle 0..1.
    """

    name: str
    doc: str
    fields: tuple[Field, ...]
    cells: Callable[[Settings, float], list[StepCell]]
    check: Callable[[Settings], str | None] = lambda settings: None


def shortest(**durations: tuple[Duration, float | None]) -> dict[str, float | None]:
    """Of piece name to (duration, least useful), those that may be shortened."""
    return {name: least for name, (value, least) in durations.items() if value.up_to}


def signs(sign: str) -> tuple[int, ...]:
    """+1, -1 or both."""
    return {"both": (1, -1), "positive": (1,), "negative": (-1,)}[sign]


SIGN = Field("sign", "choice", "both, positive or negative", choices=("both", "positive", "negative"), default="both")
ENTRY = Field("entry_s", "number", "level flight before the step", "s", 0.2, 10.0, default=0.5)
COAST = Field("coast_s", "number", "level flight after the vehicle was stopped", "s", 0.0, 20.0, default=1.0)
