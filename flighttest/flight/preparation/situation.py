"""What a preflight looks at, and what it finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from flighttest.flight.state import VehicleState
from flighttest.link import parameters as params
from flighttest.plan import Plan


@dataclass(frozen=True)
class Check:
    """One finding. name: what `--waive` takes. what and remedy: for the reader. set: parameters that would mend it."""

    name: str
    what: str
    remedy: str
    set: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Situation:
    """All that the checks look at. parameters by the vehicle's names; rates_hz as measured; pace: vehicle seconds per second;
    others: system ids of further autopilots on the link."""

    plan: Plan
    parameters: dict[str, float]
    state: VehicleState
    rates_hz: Mapping[str, float]
    firmware: str
    vehicle_type: int
    simulator: bool
    rc_live: bool
    pace: float = 1.0
    others: frozenset[int] = frozenset()

    def value(self, name: str) -> float | None:
        """A parameter by either name."""
        return params.by_either_name(self.parameters, name)
