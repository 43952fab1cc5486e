"""Flying a plan: preflight, gate, scheduler, resets, supervisor, recorder. Sends no target that did not pass the gate."""

from flighttest.flight.fly import fly, legs_flown
from flighttest.flight.outcome import FlightOutcome, FlightProgress, FlightResult, LegOutcome, LegResult

__all__ = ["FlightOutcome", "FlightProgress", "FlightResult", "LegOutcome", "LegResult", "fly", "legs_flown"]
