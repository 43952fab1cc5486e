"""Transports over real sockets: bad names, peers that go away and come back, and who is answered."""

from __future__ import annotations

import socket
import threading
import time

import pytest

from flighttest.errors import InputError, LinkError
from flighttest.link.transport import open_transport


def free_port(kind: socket.SocketKind) -> int:
    """A port of this machine that nobody has."""
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.mark.parametrize(
    "url", ["", "tcp:", "udpin:0.0.0.0", "tcp:host:99999", "serial:/dev/x", "http://x:1", "udpin::5"]
)
def test_a_bad_url_names_the_good_ones(url: str) -> None:
    with pytest.raises(InputError, match="udpin:HOST:PORT"):
        open_transport(url)


def test_nobody_listens() -> None:
    port = free_port(socket.SOCK_STREAM)
    with pytest.raises(LinkError, match=f"cannot open tcp:127.0.0.1:{port}"):
        open_transport(f"tcp:127.0.0.1:{port}")


def test_tcp_connects_again_when_the_other_side_comes_back() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    port = server.getsockname()[1]
    transport = open_transport(f"tcp:127.0.0.1:{port}")
    first, _ = server.accept()
    first.sendall(b"one")
    assert transport.receive(1.0) == b"one"
    first.close()
    assert transport.receive(0.2) == b""
    transport.send(b"lost while away")
    accepted: list[socket.socket] = []
    thread = threading.Thread(target=lambda: accepted.append(server.accept()[0]))
    thread.start()
    deadline = time.monotonic() + 5.0
    while not accepted and time.monotonic() < deadline:
        transport.receive(0.05)
    thread.join()
    accepted[0].sendall(b"two")
    assert transport.receive(1.0) == b"two"
    transport.send(b"back")
    assert accepted[0].recv(100) == b"back"
    transport.close()
    accepted[0].close()
    server.close()


def test_udp_answers_whoever_sent_and_loses_what_nobody_asked_for() -> None:
    port = free_port(socket.SOCK_DGRAM)
    listening = open_transport(f"udpin://127.0.0.1:{port}")
    listening.send(b"to nobody")
    assert listening.receive(0.01) == b""
    other = open_transport(f"udpout:127.0.0.1:{port}")
    other.send(b"a")
    other.send(b"b")
    time.sleep(0.05)
    assert listening.receive(1.0) == b"ab"
    listening.send(b"back")
    assert other.receive(1.0) == b"back"
    listening.close()
    other.close()


def test_udp_goes_on_sending_to_the_vehicle_when_another_sends_too() -> None:
    port = free_port(socket.SOCK_DGRAM)
    listening = open_transport(f"udpin:127.0.0.1:{port}")
    vehicle, ground = (open_transport(f"udpout:127.0.0.1:{port}") for _ in range(2))
    for sender in (vehicle, ground):
        sender.send(b"x")
        assert listening.receive(1.0) == b"x"
    listening.send(b"target")
    assert vehicle.receive(1.0) == b"target"
    for transport in (listening, vehicle, ground):
        transport.close()
