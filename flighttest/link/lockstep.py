"""Lock-step with the built-in simulator: the client grants time, the simulator runs as far and says so."""

from __future__ import annotations

from collections.abc import Iterator

from flighttest.mavlink.dialect import Message, book

PARAMETER = "SIM_LOCKSTEP"


class Grants:
    """Grants of vehicle time: each a SYSTEM_TIME with the time granted, answered by the simulator's SYSTEM_TIME when it is reached."""

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s
        self._granted_s = now_s

    def upto(self, until_s: float) -> Iterator[Message]:
        """Grants that lead to until_s; send one, then receive until `reached`."""
        while self.now_s < until_s - 1e-6:
            self._granted_s = until_s
            yield book.MAVLink_system_time_message(time_unix_usec=0, time_boot_ms=round(until_s * 1e3))

    @property
    def reached(self) -> bool:
        """Whether the last grant is used up."""
        return self.now_s >= self._granted_s - 1e-6

    def heard(self, message: Message) -> None:
        """Look at a message of the simulator."""
        if message.get_type() == "SYSTEM_TIME":
            self.now_s = max(self.now_s, message.time_boot_ms * 1e-3)
