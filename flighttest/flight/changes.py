"""Parameters that are set for a flight: verified when they are set, and put back when it is over."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping

from flighttest.errors import LinkError
from flighttest.flight.preflight import figure
from flighttest.link import parameters as params
from flighttest.link.session import Session

_GONE_S = 5.0  # of silence


class ParameterChanges:
    """Parameters set for this flight, verified, and restored afterwards."""

    def __init__(self, session: Session, known: dict[str, float]) -> None:
        self._session = session
        self._known = known
        self._before: dict[str, float] = {}

    def apply(self, wanted: Mapping[str, float], note: Callable[[str], None]) -> None:
        """Set parameters. LinkError where one does not take."""
        for name, value in wanted.items():
            own = name if name in self._known else (params.other_name(name, 0.0) or (name, 0.0))[0]
            before = self._known.get(own)
            if before is None:
                raise LinkError(f"the vehicle has no parameter {name}", "set it up by hand, or waive its check")
            self._before.setdefault(own, before)
            params.write(self._session, name, value, self._known)
            note(f"{own} set from {figure(before)} to {figure(self._known[own])}; it is restored after the flight")

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
