"""The simulated vehicle on a socket: TCP as ArduPilot SITL listens, UDP as ground stations expect. One thread, any number of clients."""

from __future__ import annotations

import selectors
import socket
import time
from contextlib import suppress
from dataclasses import dataclass, field

from flighttest.sim.build import build_vehicle
from flighttest.sim.lockstep import Host, Mail
from flighttest.sim.options import SimOptions

_READ_BYTES = 65536
_PENDING_MAX_BYTES = 32 << 20  # a client that has not read for this long is gone
_DATAGRAM_MAX_BYTES = 1400
_UDP_SILENCE_S = 10.0
_SLICE_S = 0.02  # host time spent ticking before sockets are looked at again
_BEHIND_MAX_S = 0.2  # a host that cannot keep up slips instead of racing after the clock


@dataclass
class _Client:
    mail: Mail
    connection: socket.socket | None = None
    address: tuple[str, int] | None = None
    pending: bytearray = field(default_factory=bytearray)
    heard_s: float = 0.0


class Server:
    """One vehicle, its sockets and its clock.

    tcp: a listening socket, clients connect to it. udp: a bound socket, every sender is answered; udp_peer: an address
    that is sent to from the start. Vehicle time starts with the first client, as ArduPilot SITL's does, unless `udp_peer` is given.
    """

    def __init__(
        self,
        options: SimOptions,
        *,
        tcp: socket.socket | None = None,
        udp: socket.socket | None = None,
        udp_peer: tuple[str, int] | None = None,
        wait_for_client: bool = True,
    ) -> None:
        self.host = Host(build_vehicle(options), lockstep=options.lockstep)
        self.speed = options.speed
        self._paced = options.paced
        self.host.vehicle.store.set("SIM_SPEEDUP", options.speed)
        self._tcp, self._udp = tcp, udp
        self._clients: list[_Client] = []
        self._datagrams: dict[tuple[str, int], _Client] = {}
        self._stop = False
        self._wait = wait_for_client and udp_peer is None
        self._selector = selectors.DefaultSelector()
        for sock in (tcp, udp):
            if sock is not None:
                sock.setblocking(False)
                self._selector.register(sock, selectors.EVENT_READ)
        if udp_peer is not None:
            self._meet(udp_peer)

    def stop(self) -> None:
        """Make `run` return soon; may be called from another thread."""
        self._stop = True

    def watch(self, fileobj: int) -> None:
        """Stop when this file descriptor reports its end: the other end belongs to the process that started this one."""
        self._selector.register(fileobj, selectors.EVENT_READ, "parent")

    def run(self) -> None:
        """Serve until `stop`, or until the watched end closes."""
        origin, start = time.monotonic(), self.host.vehicle.time_s
        host = self.host
        try:
            while not self._stop:
                self._poll(self._patience(origin, start))
                for client in list(self._clients):
                    host.serve(client.mail)
                if host.speed_asked is not None:
                    self.speed, host.speed_asked = host.speed_asked, None
                    origin, start = time.monotonic(), host.vehicle.time_s
                if host.lockstep and self._paced and not self._wait:
                    origin, start = self._hold(origin, start)
                elif host.lockstep or self._wait:
                    # Time spent waiting for the first client is not the vehicle's: its clock starts now.
                    origin, start = time.monotonic(), host.vehicle.time_s
                    self._wait = self._wait and not self._clients
                else:
                    origin, start = self._run_free(origin, start)
                self._flush()
        finally:
            self._close()

    def _hold(self, origin: float, start: float) -> tuple[float, float]:
        """Let the host's clock come up with granted time before the client receives it; a client that is late gains nothing later."""
        ahead_s = (self.host.vehicle.time_s - start) / self.speed - (time.monotonic() - origin)
        if ahead_s < 0.0:
            return time.monotonic(), self.host.vehicle.time_s
        time.sleep(ahead_s)
        return origin, start

    def _patience(self, origin: float, start: float) -> float:
        """How long the sockets may be waited for, s."""
        if self.host.lockstep or self._wait:
            return 0.25
        v = self.host.vehicle
        due = origin + (v.time_s + v.plant.tick_s - start) / self.speed
        return min(max(due - time.monotonic(), 0.0), 0.05)

    def _run_free(self, origin: float, start: float) -> tuple[float, float]:
        """Tick as far as the host's clock has come; a host too slow for the speed lets the clock slip."""
        v, tick = self.host.vehicle, self.host.vehicle.tick
        now = time.monotonic()
        goal, deadline = start + (now - origin) * self.speed, now + _SLICE_S
        tick_s = v.plant.tick_s
        while v.time_s + tick_s <= goal:
            tick()
            if time.monotonic() > deadline:
                break
        now = time.monotonic()
        if start + (now - origin) * self.speed - v.time_s > _BEHIND_MAX_S * self.speed:
            return now, v.time_s
        return origin, start

    # -- sockets -------------------------------------------------------------------------------------------------------------

    def _poll(self, patience_s: float) -> None:
        for key, _ in self._selector.select(patience_s):
            if key.data == "parent":
                self._stop = True
            elif key.fileobj is self._tcp:
                self._accept()
            elif key.fileobj is self._udp:
                self._read_datagrams()
            else:
                self._read(key.data)
        if self.host.lockstep and self._datagrams:
            limit = time.monotonic() - _UDP_SILENCE_S
            for client in self._datagrams.values():
                if client.mail is self.host.owner and client.heard_s < limit:
                    self.host.leave(client.mail)

    def _accept(self) -> None:
        assert self._tcp is not None
        connection, _ = self._tcp.accept()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(Mail(), connection)
        self._flush()
        client.pending += self.host.greet()
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)

    def _meet(self, address: tuple[str, int]) -> _Client:
        client = _Client(Mail(), None, address, heard_s=time.monotonic())
        self._datagrams[address] = client
        self._clients.append(client)
        return client

    def _read(self, client: _Client) -> None:
        assert client.connection is not None
        try:
            data = client.connection.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError:  # reset by the other end: the same as an orderly end
            data = b""
        if data:
            client.mail.feed(data)
        else:
            self._drop(client)

    def _read_datagrams(self) -> None:
        assert self._udp is not None
        while True:
            try:
                data, address = self._udp.recvfrom(_READ_BYTES)
            except BlockingIOError:
                return
            except OSError:  # an ICMP answer to an earlier datagram: the peer is not there (yet)
                continue
            client = self._datagrams.get(address) or self._meet(address)
            client.heard_s = time.monotonic()
            client.mail.feed(data)

    def _flush(self) -> None:
        data = self.host.drain()
        for client in list(self._clients):
            client.pending += data
            if not client.pending:
                continue
            if client.connection is not None:
                self._send_stream(client)
            else:
                self._send_datagrams(client)

    def _send_stream(self, client: _Client) -> None:
        assert client.connection is not None
        try:
            sent = client.connection.send(client.pending)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(client)
            return
        del client.pending[:sent]
        if len(client.pending) > _PENDING_MAX_BYTES:
            self._drop(client)

    def _send_datagrams(self, client: _Client) -> None:
        assert self._udp is not None
        assert client.address is not None
        data, start = bytes(client.pending), 0
        client.pending.clear()
        while start < len(data):
            end = start
            while end < len(data):
                size = data[end + 1] + 12
                if end + size - start > _DATAGRAM_MAX_BYTES and end > start:
                    break
                end += size
            with suppress(OSError):  # no receiver, or the buffer is full: a datagram is lost, as datagrams are
                self._udp.sendto(data[start:end], client.address)
            start = end

    def _drop(self, client: _Client) -> None:
        if client.connection is not None:
            self._selector.unregister(client.connection)
            client.connection.close()
        if client in self._clients:
            self._clients.remove(client)
        self.host.leave(client.mail)

    def _close(self) -> None:
        for client in list(self._clients):
            if client.connection is not None:
                client.connection.close()
        for sock in (self._tcp, self._udp):
            if sock is not None:
                sock.close()
        self._selector.close()
