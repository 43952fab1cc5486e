"""How a flight, and each leg of it, ended; and how far it is. What a pilot or the weather causes is an outcome, not an error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from flighttest.flight.gate import Refusal


class FlightOutcome(Enum):
    """Why the flight ended. The value is the sentence shown to the reader; how it left the vehicle is a state of `machine`."""

    COMPLETED = "the plan was flown to its end"
    NOTHING_FLOWN = "none of the plan's steps could be flown"
    ABORTED_BY_GATE = (
        "the flight ended early: the gate refused for a reason that remains, or refused several steps in a row"
    )
    BATTERY = "the flight ended early: the battery reached the script's lower limit"
    NOT_SETTLED = "the flight ended early: the vehicle did not settle at the start of several steps in a row"
    TAKE_OVER = (
        "the mode was changed by the pilot, a failsafe, the fence or another station; nothing was sent after that"
    )
    LINK_LOST = "the link was lost: the vehicle was not heard any more"
    UPLINK_LOST = "the link was lost in one direction: the vehicle was heard, but answered nothing any more"
    OPERATOR_STOP = "the operator stopped the flight"
    OPERATOR_ABORT = "the operator stopped the flight at once"
    RECORD_LOST = "the flight ended early: its record could not be written any more"
    SET_UP_ANEW = "the flight ended early: somebody else changed a parameter that it rests on"
    LEFT_TO_PILOT = "the flight ended with the pilot in control; nothing more was sent"
    VEHICLE_REFUSED = "the vehicle refused a command; the flight ended"
    CLIMB_ENDED = "the take-off was broken off"
    ARMED_BY_PILOT = "the vehicle was armed by somebody else before the take-off; nothing was commanded"
    NOT_LANDED = "the vehicle was still armed long after it was asked to land"
    REBOOTED = "the autopilot started anew during the flight"
    DISARMED = "the vehicle was disarmed in flight (by its crash check, the pilot or another station)"

    @property
    def complete(self) -> bool:
        """Whether the flight ended as planned or by agreement."""
        return self in (FlightOutcome.COMPLETED, FlightOutcome.LEFT_TO_PILOT)

    @property
    def orderly(self) -> bool:
        """Whether the flight ended between two steps, so that those which were flown are whole and the others can be flown later."""
        return self.complete or self in (
            FlightOutcome.OPERATOR_STOP,
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
    """One leg as flown. refused: the gate's reasons where it refused; why: sentences for the reader."""

    leg: str
    outcome: LegOutcome
    why: tuple[str, ...] = ()
    refused: tuple[Refusal, ...] = ()


HOW_TO_STOP = "Ctrl-C lands; twice, before LAND, leaves it in its safe mode; the mode switch always takes over"
HOW_TO_STOP_HANDED = "the pilot flies; Ctrl-C ends the flight and leaves the vehicle with the pilot"


@dataclass(frozen=True)
class FlightProgress:
    """What a live view needs, about four times a second.

    leg: number of the leg that flies now, from 1, of `legs`. doing, next: words. time_left_s: of the plan's remaining legs and
    resets, NaN where none is flown any more.
    zone_margin_m: distance to the nearest wall after a stop; voltage_v: 2 s mean; link_loss: share of frames lost; silence_s: since
    the vehicle was last heard, uplink_silence_s: since it last answered;
    rates_hz: message name to received rate; t_s: the vehicle's clock; all None or NaN where unknown. alarm: for the operator at
    once, the latest of `alarms` so far; place_m: (x, y) in the zone, zone_m: its (lowest, highest) x and y.
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
    uplink_silence_s: float = 0.0
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    mode: str = ""
    stopping: bool = False
    alarm: str = ""
    alarms: int = 0
    place_m: tuple[float, float] | None = None
    zone_m: tuple[tuple[float, float], tuple[float, float]] | None = None
    how_to_stop: str = HOW_TO_STOP

    def __str__(self) -> str:
        silent = max(self.silence_s, self.uplink_silence_s)
        link = f"link {100 * (1 - self.link_loss):.0f} %, answered {silent:.1f} s ago"
        margins = f"zone {self.zone_margin_m:.1f} m, {self.voltage_v:.1f} V, {link}"
        left = "-"
        if math.isfinite(self.time_left_s):
            minutes, seconds = divmod(round(self.time_left_s), 60)
            left = f"{minutes}:{seconds:02d}"
        return f"leg {self.leg}/{self.legs} {self.doing} [{self.phase}]; {margins}; {left} left; next {self.next}"


OnProgress = Callable[[FlightProgress], None]


class FlightEnded(Exception):
    """Inside this package only: the flight is over with this outcome; raised where it happens, caught once in `fly`."""

    def __init__(self, outcome: FlightOutcome, why: str = "") -> None:
        super().__init__(outcome.value)
        self.outcome = outcome
        self.why = why
