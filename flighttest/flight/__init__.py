"""Flying a plan: preflight, gate, scheduler, resets, supervisor, recorder. Sends no target that did not pass the gate."""

from flighttest.flight.fly import fly, legs_flown
from flighttest.flight.machine import FlightState
from flighttest.flight.outcome import FlightOutcome, FlightProgress, LegOutcome, LegResult
from flighttest.flight.result import FlightResult

__all__ = [
    "FlightOutcome",
    "FlightProgress",
    "FlightResult",
    "FlightState",
    "LegOutcome",
    "LegResult",
    "fly",
    "legs_flown",
]
