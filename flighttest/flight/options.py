"""What a flight is asked for beside its plan and its vehicle."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from flighttest.flight.execution.response import Replanner
from flighttest.flight.outcome import OnProgress
from flighttest.flight.preparation.changes import LeftParameter
from flighttest.flight.preparation.fence import FenceSet
from flighttest.link.port import OWN_SYSTEM

OnStage = Callable[[str], None]
OnVehicle = Callable[[str, Mapping[str, float]], None]  # firmware, parameters


def _do_nothing(*_words: object) -> None:
    return None


@dataclass(frozen=True)
class FlightSettings:
    """set_params: set what preflight asks for and restore it afterwards (always done on a simulator). waive: names of preflight checks.
    left_behind: parameters that an earlier flight set and could not restore (see `still_left`); fence_behind: its fence that is still on
    the vehicle. extend_fence: add the zone's polygon to a fence that the vehicle keeps. resume: a run that this one goes on with, for
    the manifest; skip: ids of legs that are left out. replanner: plans again for the hover throttle and the age of thrust that are seen
    in flight, where the autopilot holds the position meanwhile. on_vehicle: called with firmware and parameters that will be in force,
    before anything arms. stop_requested: how often the operator asked to stop (1: land, 2: stop sending now). confirm: shown the checklist
    before arming, in a thread of its own. weather: kept with the run. signing_key: with which frames are signed, and without which none is
    taken; system: our own system id.
    """

    set_params: bool = False
    waive: Collection[str] = ()
    left_behind: Mapping[str, LeftParameter] = field(default_factory=dict)
    fence_behind: FenceSet | None = None
    extend_fence: bool = False
    resume: Path | None = None
    skip: Collection[str] = ()
    replanner: Replanner | None = None
    on_progress: OnProgress | None = None
    on_stage: OnStage = _do_nothing
    on_vehicle: OnVehicle = _do_nothing
    stop_requested: Callable[[], int] = lambda: 0
    confirm: Callable[[str], bool] | None = None
    weather: str = ""
    signing_key: bytes | None = None
    system: int = OWN_SYSTEM
