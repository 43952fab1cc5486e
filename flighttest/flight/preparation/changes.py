"""Parameters that are set for a flight: verified when set, put back when it is over; and every
external parameter change meanwhile."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from flighttest.errors import LinkError
from flighttest.flight.preparation.preflight import figure, refuse_armed
from flighttest.link import parameters as params
from flighttest.link.session import Session
from flighttest.recording.manifest import ParametersSet

_GONE_S = 5.0  # of silence, either way
_THEIR_OWN = ("STAT_", "SIM_")  # an autopilot's counters, a simulator's world

# What the flight's safety and the meaning of a target rest on: the flight does not go on when somebody changes one of these.
VITAL = frozenset(
    {
        "GUID_OPTIONS", "GUID_TIMEOUT", "FS_OPTIONS", "FS_THR_ENABLE", "RC_OPTIONS", "FLTMODE_CH", "FLTMODE_GCSBLOCK",
        "FENCE_ENABLE", "FENCE_TYPE", "FENCE_ACTION", "FENCE_ALT_MAX", "FENCE_RADIUS",
    }
)  # fmt: skip

# The only parameters that a flight ever sets on a vehicle, and so the only ones that are put back.
SETS = frozenset(
    {
        "GUID_OPTIONS", "GUID_TIMEOUT", "FLTMODE_GCSBLOCK", "FS_OPTIONS", "LOG_BITMASK",
        "FENCE_ENABLE", "FENCE_TYPE", "FENCE_ACTION", "FENCE_ALT_MAX", "FENCE_RADIUS",
    }
)  # fmt: skip


@dataclass
class ExternalChanges:
    """Parameters that change while a vehicle is flown, not by this program.

    known: as they were when the flight began; changed: a sentence for each change; vital: those of `VITAL`.
    """

    known: dict[str, float]
    changed: list[str] = field(default_factory=list)
    vital: list[str] = field(default_factory=list)

    def look(self, name: str, value: float) -> str:
        """A sentence where the vehicle states a value that it did not have; else ''."""
        before = self.known.get(name)
        if before is None or params.same_single(value, before) or name.startswith(_THEIR_OWN):
            return ""
        self.known[name] = value
        text = f"{name} was changed from {figure(before)} to {figure(value)} during the flight, not by this program"
        self.changed.append(text)
        if name in VITAL:
            self.vital.append(text)
        return text


@dataclass(frozen=True)
class LeftParameter:
    """A parameter that a flight set. value: what it should have again; given: what the flight gave it; hardware: the autopilot it was
    set on, '' where that is not in it."""

    value: float
    given: float
    hardware: str = ""


def record_of(run: str, entries: Mapping[str, LeftParameter]) -> ParametersSet:
    """The manifest's word of what was given to which autopilot in which run: without it no later flight puts anything back."""
    return {
        "run": run,
        "given": {n: e.given for n, e in entries.items()},
        "hardware": {n: e.hardware for n, e in entries.items()},
    }


def changed_values(entries: Mapping[str, LeftParameter]) -> dict[str, float]:
    """Name to the value it should have."""
    return {name: entry.value for name, entry in entries.items()}


def still_left(
    behind: Mapping[str, LeftParameter], known: Mapping[str, float], hardware: str
) -> tuple[dict[str, LeftParameter], list[str]]:
    """What of an earlier flight's record is still to be put back on this vehicle, and a sentence for each entry that is not used.

    A record is a file, and anybody may have written it: it counts for a parameter that a flight sets by itself, on the autopilot it
    was set on, as long as that still has the value it was given.
    """
    left: dict[str, LeftParameter] = {}
    doubted: list[str] = []
    for name, entry in behind.items():
        if name in known and params.same_single(known[name], entry.value):
            continue
        if name not in SETS or not math.isfinite(entry.value):
            why = "no flight sets that by itself"
        elif name not in known:
            continue
        elif entry.hardware != hardware:
            why = "it was set on another autopilot"
        elif not params.same_single(known[name], entry.given):
            why = f"it was set to {figure(entry.given)} and is {figure(known[name])} now"
        else:
            left[name] = entry
            continue
        doubted.append(
            f"by the record of an earlier flight {name} should be {entry.value:g}, but {why}: it is left alone"
        )
    return left, doubted


class ParameterChanges:
    """Parameters set for this flight, verified, and restored afterwards.

    inherited: what an earlier flight set and did not restore. hardware: the autopilot's own number.
    """

    def __init__(
        self, session: Session, known: dict[str, float], inherited: Mapping[str, LeftParameter], hardware: str = ""
    ) -> None:
        self._session = session
        self._known = known
        self._hardware = hardware
        self._before: dict[str, LeftParameter] = dict(inherited)
        self.unconfirmed: set[str] = set()  # sent to be put back, and not confirmed
        self.left_alone: list[str] = []  # a sentence for each that somebody else gave another value meanwhile

    def apply(
        self,
        wanted: Mapping[str, float],
        note: Callable[[str], None],
        keep: Callable[[Mapping[str, LeftParameter]], None],
        armed: Callable[[], bool],
    ) -> None:
        """Set parameters that have another value. LinkError where one does not take, PreflightError once the vehicle is armed: somebody
        else flies it.

        keep: called with what has to be restored before anything is set, so that a program that dies leaves a record of it.
        """
        own: dict[str, tuple[str, float]] = {}  # by the vehicle's name and in its unit
        for name, value in wanted.items():
            own[name] = (name, value) if name in self._known else params.other_name(name, value) or (name, value)
            known = self._known.get(own[name][0])
            if known is None:
                raise LinkError(f"the vehicle has no parameter {name}", "set it up by hand, or waive its check")
            if params.same_single(known, own[name][1]):
                del own[name]
                continue
            before = self._before.get(own[name][0])
            self._before[own[name][0]] = LeftParameter(before.value if before else known, own[name][1], self._hardware)
        keep(self._before)
        for name, value in own.values():
            refuse_armed(armed())
            was = self._known[name]
            params.write_parameter(self._session, name, value, self._known)
            note(f"{name} set from {figure(was)} to {figure(self._known[name])} for the flight")

    @property
    def pending(self) -> dict[str, float]:
        """What still has to be restored: name to value."""
        return changed_values(self._before)

    def restore(self, may: Callable[[], bool]) -> dict[str, float]:
        """Put back, verified, what still has the value it was given; what could not be, with the value it should have, stays pending.

        What somebody else set meanwhile is that person's choice, as it is to `still_left`. may: whether anything may be set on the vehicle
        now, asked before each of them. A link that is still silent after one of them has been tried is not waited for again.
        """
        tried = False
        for name, value in reversed(list(self.pending.items())):
            gone = max(self._session.silence_s, self._session.uplink_silence_s) > _GONE_S
            if not may() or (tried and gone):
                break
            tried = True
            with contextlib.suppress(LinkError):  # it is reported as left
                if self._set_by_others(name):
                    del self._before[name]
                    continue
                if not may():
                    break
                self.unconfirmed.add(name)
                params.write_parameter(self._session, name, value, self._known)
                del self._before[name]
                self.unconfirmed.discard(name)
        return self.pending

    def _set_by_others(self, name: str) -> bool:
        """Whether a parameter has another value now than it was given, read from the vehicle."""
        entry, now = self._before[name], params.read_parameter(self._session, name)
        if now is None or params.same_single(now, entry.given):
            return False
        self._known[name] = now
        if not params.same_single(now, entry.value):
            self.left_alone.append(
                f"{name} is {figure(now)}, set by somebody else during the flight, and was left so: before the flight it was "
                f"{figure(entry.value)}"
            )
        return True
