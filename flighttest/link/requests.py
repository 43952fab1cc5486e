"""Mode requests that the vehicle may still carry out: a change of mode that answers one of them is not a pilot's."""

from __future__ import annotations

REORDER_S = 0.3  # a link does not reorder over longer, so what was sent before is handled before


class ModeRequests:
    """Modes asked for and neither carried out nor refused as far as is known.

    MAVLink's acknowledgement of a mode change does not name the mode, and may be lost. A request is closed by a round trip: a TIMESYNC
    question sent `REORDER_S` after it was answered, so the request was handled or lost before, and a HEARTBEAT that came `REORDER_S`
    after that answer has shown which mode resulted.
    """

    def __init__(self) -> None:
        self._sent_s: dict[int, float] = {}
        self._handled: tuple[float, float] | None = None  # requests sent before [0] were handled, known since [1]

    def sent(self, mode: int, t_s: float) -> None:
        """A request for this mode leaves at t_s."""
        self._sent_s[int(mode)] = t_s

    def answered(self, asked_s: float, t_s: float) -> None:
        """An answer to a question that left at asked_s has come at t_s."""
        if self._handled is None:
            self._handled = (asked_s, t_s)

    def shows(self, mode: int, t_s: float) -> bool:
        """Whether the mode of a HEARTBEAT heard at t_s was asked for and may only now have been entered. Closes what it answers."""
        ours = int(mode) in self._sent_s
        if self._handled is not None and t_s >= self._handled[1] + REORDER_S:
            handled_s = self._handled[0] - REORDER_S
            self._sent_s = {m: sent for m, sent in self._sent_s.items() if sent > handled_s}
            self._handled = None
        return ours

    @property
    def open(self) -> frozenset[int]:
        """The modes whose requests are open."""
        return frozenset(self._sent_s)
