"""Flying a plan: preflight, gate, scheduler, resets, supervisor, recorder. Sends no target that did not pass the gate."""

from flighttest.flight.execution.machine import FlightState
from flighttest.flight.fly import fly
from flighttest.flight.options import FlightSettings
from flighttest.flight.outcome import FlightOutcome, FlightProgress, LegOutcome, LegResult
from flighttest.flight.result import FlightResult, legs_flown

__all__ = [
    "FlightOutcome",
    "FlightProgress",
    "FlightResult",
    "FlightSettings",
    "FlightState",
    "LegOutcome",
    "LegResult",
    "fly",
    "legs_flown",
]
