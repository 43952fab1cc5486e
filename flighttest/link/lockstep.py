"""Lock-step with the built-in simulator: the client grants time, the simulator runs as far and sends a mark.

The protocol is written down in `flighttest.sim.lockstep`; this is its other end, read from that text alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from flighttest.mavlink.dialect import Message, dialect

PARAMETER = "SIM_LOCKSTEP"
_GRANT_MAX_S = 0.1  # longer waits come in pieces, so that telemetry is looked at and heartbeats are sent on the way


class Grants:
    """Grants of vehicle time: each a SYSTEM_TIME with the time granted, answered by the simulator's SYSTEM_TIME when it is reached."""

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s
        self.marks = 0

    def upto(self, until_s: float) -> Iterator[Message]:
        """Grants that lead to until_s; send one, then receive until `marks` has grown."""
        while self.now_s < until_s - 1e-6:
            granted_ms = math.ceil(min(until_s, self.now_s + _GRANT_MAX_S) * 1e3 - 1e-6)
            yield dialect.MAVLink_system_time_message(time_unix_usec=0, time_boot_ms=granted_ms)

    def heard(self, message: Message) -> bool:
        """Look at a message of the simulator: whether it is an end mark."""
        if message.get_type() == "SYSTEM_TIME" and message.time_unix_usec == 0:
            self.now_s = max(self.now_s, message.time_boot_ms * 1e-3)
            self.marks += 1
            return True
        return False
