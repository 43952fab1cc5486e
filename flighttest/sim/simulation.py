"""A simulated vehicle in the background: a process of its own (the default) or a thread.

    with start_simulator(SimOptions(speed=20)) as simulation:
        fly(simulation.url)                     # tcp:127.0.0.1:PORT

The listening socket is bound here and handed to the child, so the port is known and accepts connections from the first moment on.
The child ends when this process does.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from types import TracebackType
from typing import Literal

from flighttest.errors import LinkError
from flighttest.sim.options import SimOptions
from flighttest.sim.ports import bind_datagrams, listen
from flighttest.sim.server import Server

_STOP_PATIENCE_S = 3.0


class Simulation:
    """A running simulated vehicle; a context manager. url: what a ground program connects to."""

    def __init__(
        self, options: SimOptions, url: str, process: subprocess.Popen[bytes] | None, server: Server | None
    ) -> None:
        self.options, self.url = options, url
        self._process, self._server = process, server
        self._thread: threading.Thread | None = None
        if server is not None:
            self._thread = threading.Thread(target=server.run, name="simulated vehicle", daemon=True)
            self._thread.start()

    def __repr__(self) -> str:
        flies = "a model of its own" if self.options.model is not None else self.options.airframe
        return f"<Simulation of {flies} at {self.url}: {'running' if self.alive else 'ended'}>"

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self.url.rsplit(":", 1)[1])

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        if self._process is not None:
            return self._process.poll() is None
        return self._thread is not None and self._thread.is_alive()

    def wait(self) -> None:
        """Until it ends by itself."""
        if self._process is not None:
            self._process.wait()
        elif self._thread is not None:
            self._thread.join()

    def stop(self) -> None:
        """End it; a second call does nothing."""
        if self._server is not None:
            self._server.stop()
        if self._thread is not None:
            self._thread.join(_STOP_PATIENCE_S)
        if self._process is not None and self._process.poll() is None:
            if self._process.stdin is not None:
                self._process.stdin.close()
            try:
                self._process.wait(_STOP_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()


def start_simulator(
    options: SimOptions | None = None,
    *,
    port: int = 0,
    host: str = "127.0.0.1",
    protocol: Literal["tcp", "udp"] = "tcp",
    peer: tuple[str, int] | None = None,
    in_thread: bool = False,
) -> Simulation:
    """Start a simulated vehicle.

    port: 0 takes any free one. tcp: connect to `tcp:HOST:PORT`; udp: send to `udpout:HOST:PORT`, or listen at `peer` (host, port), which
    is then sent to from the start, as ground stations expect on port 14550. in_thread: no process of its own (for tests, and always on
    Windows; half the speed). LinkError when the port is taken, InputError for options that cannot be.
    """
    options = options or SimOptions()
    build_check(options)
    sock = listen(host, port) if protocol == "tcp" else bind_datagrams(host, port)
    number = sock.getsockname()[1]
    url = f"tcp:{host}:{number}" if protocol == "tcp" else f"udpout:{host}:{number}"
    if protocol == "udp" and peer is not None:
        url = f"udpin:{peer[0]}:{peer[1]}"
    if in_thread or os.name == "nt":  # Windows hands no socket on to a child
        return Simulation(options, url, None, _server(protocol, sock, options, peer))
    words = [sys.executable, "-m", "flighttest.sim", protocol, str(sock.fileno()), options.to_json()]
    words += [f"{peer[0]}:{peer[1]}"] if peer is not None else []
    # the child reads its standard input only to notice when we are gone
    process = subprocess.Popen(words, stdin=subprocess.PIPE, pass_fds=(sock.fileno(),), start_new_session=True)
    sock.close()
    return Simulation(options, url, process, None)


def build_check(options: SimOptions) -> None:
    """Raise here, with its hint, what the child would only die of."""
    from flighttest.sim.build import build_plant

    build_plant(options)


def _server(protocol: str, sock: socket.socket, options: SimOptions, peer: tuple[str, int] | None) -> Server:
    return Server(options, tcp=sock) if protocol == "tcp" else Server(options, udp=sock, udp_peer=peer)


def serve_inherited(protocol: str, descriptor: int, options: SimOptions, peer: str = "") -> None:
    """The child's part: serve on an inherited socket until the parent's end of our standard input closes. peer: HOST:PORT."""
    kind = socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM
    try:
        sock = socket.socket(socket.AF_INET, kind, fileno=descriptor)
    except OSError as error:
        raise LinkError(f"descriptor {descriptor} is not a socket: {error.strerror}") from error
    name, _, number = peer.rpartition(":")
    server = _server(protocol, sock, options, (name, int(number)) if peer else None)
    server.watch(sys.stdin.fileno())
    os.set_inheritable(descriptor, False)
    server.run()
