"""The end of a flight as it is handed back: why it ended, and how it left the vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from flighttest.flight.execution.machine import FlightState
from flighttest.flight.outcome import FlightOutcome, LegOutcome, LegResult
from flighttest.mavlink import CopterMode
from flighttest.recording.store import read_events


@dataclass(frozen=True)
class FlightResult:
    """The end of a flight. left: the state in which the vehicle was left, mode: its last one heard; parameters_left: parameters that
    could not be restored (name to the value they should have); incomplete: what its record lacks because it could not be written, ''
    where it is whole."""

    outcome: FlightOutcome
    run_dir: Path
    legs: tuple[LegResult, ...] = ()
    notes: tuple[str, ...] = ()
    parameters_left: Mapping[str, float] = field(default_factory=dict)
    left: FlightState = FlightState.NOT_ARMED
    mode: str = ""
    incomplete: str = ""

    @property
    def sentence(self) -> str:
        """Why the flight ended and how it left the vehicle."""
        return f"{self.outcome.value}; {self.how_left}"

    @property
    def how_left(self) -> str:
        """How the flight left the vehicle."""
        words = self.left.value.format(mode=self.mode or "no mode")
        # ArduCopter's fence and its failsafes choose BRAKE, in which the sticks do nothing.
        holds = self.left is FlightState.WITH_PILOT and self.mode == CopterMode.BRAKE.name
        return f"{words}, which holds it in the air until the mode switch is moved" if holds else words

    @property
    def as_planned(self) -> bool:
        """Whether the flight was flown to its end and left the vehicle on the ground, or with the pilot."""
        return self.outcome.complete and self.left.is_safe and any(r.outcome is LegOutcome.FLOWN for r in self.legs)


def legs_flown(run_dir: Path) -> frozenset[str]:
    """Ids of the legs that were flown to their end in a run folder."""
    markers, _ = read_events(run_dir)
    return frozenset(str(m.data["leg"]) for m in markers if m.data.get("outcome") == "FLOWN" and "leg" in m.data)
