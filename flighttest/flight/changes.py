"""Parameters that are set for a flight: verified when set, put back when it is over; and those that somebody else sets meanwhile."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from flighttest.errors import LinkError
from flighttest.flight.preflight import figure
from flighttest.link import parameters as params
from flighttest.link.session import Session

_GONE_S = 5.0  # of silence
_THEIR_OWN = ("STAT_", "SIM_")  # an autopilot's counters, a simulator's world

# What the flight's safety and the meaning of a target rest on: the flight does not go on when somebody changes one of these.
VITAL = frozenset(
    {
        "GUID_OPTIONS", "GUID_TIMEOUT", "FS_OPTIONS", "FS_THR_ENABLE", "RC_OPTIONS", "FLTMODE_CH", "FLTMODE_GCSBLOCK",
        "FENCE_ENABLE", "FENCE_TYPE", "FENCE_ACTION", "FENCE_ALT_MAX", "FENCE_RADIUS",
    }
)  # fmt: skip


@dataclass
class Meddling:
    """Parameters that change while a vehicle is flown, which nobody here has asked for.

    known: as they were when the flight began; changed: a sentence for each change; vital: those of `VITAL`.
    """

    known: dict[str, float]
    changed: list[str] = field(default_factory=list)
    vital: list[str] = field(default_factory=list)

    def look(self, name: str, value: float) -> str:
        """A sentence where the vehicle states a value that it did not have; else ''."""
        before = self.known.get(name)
        if before is None or params.same(value, before) or name.startswith(_THEIR_OWN):
            return ""
        self.known[name] = value
        text = f"{name} was changed from {figure(before)} to {figure(value)} during the flight, not by this program"
        self.changed.append(text)
        if name in VITAL:
            self.vital.append(text)
        return text


class ParameterChanges:
    """Parameters set for this flight, verified, and restored afterwards.

    inherited: what an earlier flight set and did not restore, name to the value it should have.
    """

    def __init__(self, session: Session, known: dict[str, float], inherited: Mapping[str, float]) -> None:
        self._session = session
        self._known = known
        self._before: dict[str, float] = dict(inherited)

    def apply(
        self, wanted: Mapping[str, float], note: Callable[[str], None], keep: Callable[[dict[str, float]], None]
    ) -> None:
        """Set parameters. keep: told what has to be restored before anything is set, so that a program that dies leaves word of it.

        LinkError where one does not take.
        """
        own = {n: n if n in self._known else (params.other_name(n, 0.0) or (n, 0.0))[0] for n in wanted}
        for name in wanted:
            if own[name] not in self._known:
                raise LinkError(f"the vehicle has no parameter {name}", "set it up by hand, or waive its check")
            self._before.setdefault(own[name], self._known[own[name]])
        keep(self.pending)
        for name, value in wanted.items():
            before = self._known[own[name]]
            params.write(self._session, name, value, self._known)
            note(
                f"{own[name]} set from {figure(before)} to {figure(self._known[own[name]])}; it is restored after the flight"
            )

    @property
    def pending(self) -> dict[str, float]:
        """What still has to be restored: name to value."""
        return dict(self._before)

    def restore(self, airborne: bool = False) -> dict[str, float]:
        """Put everything back, verified; what could not be, with the value it should have, stays pending.

        airborne: the fence stays as it is: nobody takes it from a vehicle that is left in the air. A link that is still silent after
        one of them has been tried is not waited for again.
        """
        tried = False
        for name, value in reversed(list(self._before.items())):
            if self._session.port.muted or (tried and self._session.silence_s > _GONE_S):
                break
            if airborne and name.startswith("FENCE_"):
                continue
            tried = True
            with contextlib.suppress(LinkError):  # it is told as left
                params.write(self._session, name, value, self._known)
                del self._before[name]
        return self.pending
