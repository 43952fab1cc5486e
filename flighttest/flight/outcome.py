"""How a flight, and each leg of it, ended; and how far it is. What a pilot or the weather causes is an outcome, not an error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path


class FlightOutcome(Enum):
    """How the flight ended. The value is the sentence shown to the reader."""

    COMPLETED = "the plan was flown to its end and the vehicle landed"
    ABORTED_BY_GATE = "the flight was aborted: too many targets were refused by the gate"
    BATTERY = "the flight ended early: the battery reached the script's lower limit"
    NOT_SETTLED = "the flight ended early: the vehicle did not settle at the start of several steps in a row; it landed"
    TAKE_OVER = "the pilot (or a failsafe) changed the mode; nothing was sent after that"
    LINK_LOST = "the link to the vehicle was lost and did not come back"
    OPERATOR_STOP = "the operator stopped the flight; the vehicle landed"
    OPERATOR_ABORT = "the operator stopped the flight at once; the vehicle was left in its abort mode"
    RECORD_LOST = "the flight ended early: its record could not be written any more; the vehicle landed"
    SET_UP_ANEW = "the flight ended early: somebody else changed a parameter that it rests on; the vehicle landed"
    LEFT_TO_PILOT = "the flight ended while the pilot had the vehicle, by agreement: it is the pilot's to land; nothing more was sent"
    VEHICLE_REFUSED = "the vehicle refused a command; the flight ended"
    DISARMED = "the vehicle disarmed by itself during the flight"

    @property
    def usable(self) -> bool:
        """Whether what was flown is complete: the flight ended as planned, between two steps, or by agreement."""
        return self in (
            FlightOutcome.COMPLETED,
            FlightOutcome.OPERATOR_STOP,
            FlightOutcome.LEFT_TO_PILOT,
            FlightOutcome.BATTERY,
            FlightOutcome.NOT_SETTLED,
            FlightOutcome.SET_UP_ANEW,
        )


class LegOutcome(Enum):
    """How one leg ended."""

    FLOWN = "flown"
    REFUSED = "aborted: the gate refused a target"
    LINK_LOST = "aborted: the link was lost"
    NOT_SETTLED = "not begun: the vehicle did not settle at the start"
    TAKE_OVER = "ended by a change of mode"
    STOPPED = "ended with the flight"
    LEFT_OUT = "left out: the gate had refused this step twice"
    UNFIT = "left out: planned again for the thrust seen in flight, it does not fit the flight zone"


@dataclass(frozen=True)
class LegResult:
    """One leg as flown. why: the gate's sentences where it refused."""

    leg: str
    outcome: LegOutcome
    why: tuple[str, ...] = ()


@dataclass(frozen=True)
class FlightProgress:
    """What a live view needs, about four times a second.

    leg: number of the leg that flies now, from 1, of `legs`. doing, next: words. time_left_s: of the plan's remaining legs and
    resets. zone_margin_m: room to the nearest wall after a stop; voltage_v: 2 s mean; link_loss: share of frames lost; silence_s: since
    the vehicle was last heard; rates_hz: message name to received rate; t_s: the vehicle's clock; all None or NaN where unknown.
    """

    leg: int
    legs: int
    doing: str
    next: str
    phase: str
    time_left_s: float
    t_s: float
    zone_margin_m: float = math.nan
    height_m: float = math.nan
    speed_m_s: float = math.nan
    voltage_v: float = math.nan
    voltage_min_v: float = math.nan
    link_loss: float = 0.0
    silence_s: float = 0.0
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    mode: str = ""
    stopping: bool = False
    how_to_stop: str = "Ctrl-C lands; Ctrl-C twice lets go at once; the pilot's mode switch always wins"

    def __str__(self) -> str:
        margins = f"zone {self.zone_margin_m:.1f} m, {self.voltage_v:.1f} V, link {100 * (1 - self.link_loss):.0f} %"
        minutes, seconds = divmod(round(self.time_left_s), 60)
        return f"leg {self.leg}/{self.legs} {self.doing} [{self.phase}]; {margins}; {minutes}:{seconds:02d} left; next {self.next}"


OnProgress = Callable[[FlightProgress], None]


@dataclass(frozen=True)
class FlightResult:
    """The end of a flight. parameters_left: parameters that could not be restored (name to the value they should have). incomplete: what
    its record lacks because it could not be written, '' where it is whole."""

    outcome: FlightOutcome
    run_dir: Path
    legs: tuple[LegResult, ...] = ()
    notes: tuple[str, ...] = ()
    parameters_left: Mapping[str, float] = field(default_factory=dict)
    incomplete: str = ""


class FlightEnded(Exception):
    """Inside this room only: the flight is over with this outcome; raised where it happens, caught once in `fly`."""

    def __init__(self, outcome: FlightOutcome, why: str = "") -> None:
        super().__init__(outcome.value)
        self.outcome = outcome
        self.why = why
