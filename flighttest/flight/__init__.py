"""Flying a plan: preflight, gate, scheduler, resets, supervisor, recorder. Sends no target that did not pass the gate."""

from flighttest.flight.execution.machine import FlightState
from flighttest.flight.fly import fly
from flighttest.flight.given_and_returned import FlightOptions, FlightResult, legs_flown
from flighttest.flight.outcome import FlightOutcome, FlightProgress, LegOutcome, LegResult

__all__ = [
    "FlightOptions",
    "FlightOutcome",
    "FlightProgress",
    "FlightResult",
    "FlightState",
    "LegOutcome",
    "LegResult",
    "fly",
    "legs_flown",
]
