"""The simulated vehicle without a socket, for hundreds of flights in one process: same bytes, same codec, no waiting."""

from __future__ import annotations

from flighttest.sim.build import build_vehicle
from flighttest.sim.lockstep import Host, Mail
from flighttest.sim.options import SimOptions


class InProcess:
    """A vehicle at the end of two byte strings.

    `send` hands it MAVLink bytes, which arrive at the present vehicle time; `advance` lets time pass; `receive` returns what it has
    sent since.
    Grants of the lock-step protocol (`lockstep`) work too: a SYSTEM_TIME that is sent runs the time it grants.
    """

    def __init__(self, options: SimOptions | None = None) -> None:
        self.options = options or SimOptions()
        self.vehicle = build_vehicle(self.options)
        self._host = Host(self.vehicle, lockstep=self.options.lockstep)
        self._mail = Mail()
        self.vehicle.outbox.append(self._host.greet())

    @property
    def time_s(self) -> float:
        """Vehicle time, s since boot."""
        return self.vehicle.time_s

    def send(self, data: bytes) -> None:
        """MAVLink bytes to the vehicle."""
        self._mail.feed(data)
        self._host.serve(self._mail)

    def receive(self) -> bytes:
        """MAVLink bytes from the vehicle since the last call."""
        return self._host.drain()

    def advance(self, dt_s: float) -> None:
        """Let dt_s, s, of vehicle time pass (to the last whole tick)."""
        self._host.run_to(self.vehicle.time_s + dt_s)
