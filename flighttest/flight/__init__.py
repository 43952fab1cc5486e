"""Flying a plan: preflight, gate, scheduler, resets, supervisor, recorder. Sends no target that did not pass the gate."""

from flighttest.flight.execution.machine import FlightState
from flighttest.flight.fly import fly
from flighttest.flight.options import FlightOptions
from flighttest.flight.outcome import FlightOutcome, FlightProgress, LegOutcome, LegResult
from flighttest.flight.result import FlightResult, legs_flown

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
