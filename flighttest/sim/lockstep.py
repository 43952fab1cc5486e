"""Vehicle time on the client's leash: how a client and a simulated vehicle share one clock, with messages every MAVLink tool reads.

At twenty times real time, one millisecond of host latency is twenty milliseconds of T_d. In lock-step no host latency counts at all, and
equal bytes give equal flights. The protocol:

1. The client sends PARAM_SET SIM_LOCKSTEP = 1 and sees it echoed as PARAM_VALUE. A vehicle that has no such parameter keeps silent: it
   runs on its own clock. From the moment the vehicle handles it, its time stands still.
   (`SimOptions.lockstep` starts it so, at t = 0; a HEARTBEAT is sent once to each new connection all the same, so that there is
   something to connect to.)
2. The client sends SYSTEM_TIME with time_unix_usec = 0 and time_boot_ms = X: a grant. It means: I have read what I wanted to read,
   and sent all that is to arrive before vehicle time X; run on to X (whole ms).
3. The vehicle handles the bytes of the client strictly in order: what stands between two grants arrives at the vehicle time at which
   the first of them ended. Having reached X it sends the telemetry of the interval and, last, SYSTEM_TIME with time_unix_usec = 0 and
   time_boot_ms = X: the end mark. A grant that is not in the future is answered at once, with the present time: granting 0 asks what time
   it is.
4. A client keeps both processes busy by one grant ahead: it sends its targets and the grant for X + step when the end mark
   of X - step arrives. The flight stays a function of the bytes; only the reaction comes one step later.
5. PARAM_SET SIM_LOCKSTEP = 0 lets the vehicle run freely again. So does the end of the client's connection (a killed client must
   not stop the clock of a flying vehicle), or, over UDP, ten seconds of the host's time without a byte from it.

Over TCP, clients set TCP_NODELAY: a target and a grant in two small writes would otherwise wait 40 ms for an acknowledgement.
Only the connection that asked for lock-step may grant. Others may listen and send; what they send arrives at the vehicle time of
its handling.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.autopilot.copter import Autopilot
from flighttest.sim.autopilot.telemetry import heartbeat
from flighttest.sim.wire import Decoder

_GRANT_MAX_MS = 60_000  # a longer grant runs this far; its end mark shows it


class Mail:
    """One connection's bytes as messages in order."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self.queue: deque[Any] = deque()

    def feed(self, data: bytes) -> None:
        """Bytes as they came."""
        self.queue.extend(self._decoder.feed(data))


class Host:
    """A vehicle with its connections and its clock, without any socket. `serve` handles mail and granted time; `run_to` is free running."""

    def __init__(self, vehicle: Autopilot, *, lockstep: bool = False) -> None:
        self.vehicle = vehicle
        self.lockstep = lockstep
        self.owner: Mail | None = None
        self.speed_asked: float | None = None
        if lockstep:
            vehicle.store.set("SIM_LOCKSTEP", 1.0)

    def greet(self) -> bytes:
        """What a new connection is sent first."""
        return self.vehicle.encoder.signing.seal(heartbeat(self.vehicle))

    def serve(self, mail: Mail) -> None:
        """Handle everything of one connection that may be handled now; in lock-step this runs the granted time."""
        v, queue = self.vehicle, mail.queue
        while queue:
            message = queue.popleft()
            if message.get_type() == "SYSTEM_TIME":
                if self.lockstep and message.time_unix_usec == 0 and self.owner in (None, mail):
                    self.owner = mail
                    self._grant(message.time_boot_ms)
                continue
            v.receive(message)
            asked, v.mailbox.lockstep_asked = v.mailbox.lockstep_asked, None
            if asked is not None:
                self.lockstep, self.owner = asked, mail if asked else None
            if v.mailbox.speed_asked is not None:
                self.speed_asked, v.mailbox.speed_asked = v.mailbox.speed_asked, None

    def _grant(self, until_ms: int) -> None:
        v = self.vehicle
        until_ms = min(until_ms, int(v.time_s * 1e3) + _GRANT_MAX_MS)
        now_ms = max(until_ms, int(v.time_s * 1e3 + 1e-6))
        self.run_to(until_ms * 1e-3)
        v.outbox.append(v.encoder.message(dialect.MAVLink_system_time_message(0, now_ms & 0xFFFFFFFF)))

    def run_to(self, t_s: float) -> None:
        """Tick up to the last tick that is not after t_s, s."""
        v = self.vehicle
        last = int(t_s / v.plant.tick_s + 1e-6)
        tick = v.tick
        while v.ticks < last:
            tick()

    def leave(self, mail: Mail) -> None:
        """A connection ended: what hung on its leash runs freely."""
        if self.owner is mail:
            self.owner = None
            self.lockstep = False
            self.vehicle.store.set("SIM_LOCKSTEP", 0.0)

    def drain(self) -> bytes:
        """Everything the vehicle has sent since the last call."""
        outbox = self.vehicle.outbox
        signing = self.vehicle.encoder.signing
        data = b"".join(map(signing.seal, outbox) if signing.key else outbox)
        outbox.clear()
        return data
