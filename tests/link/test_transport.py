"""Transports over real sockets: bad names, peers that go away and come back, and who is answered."""

from __future__ import annotations

import contextlib
import random
import socket
import threading
import time

import pytest

from flighttest.errors import InputError, LinkError
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import Sequence, open_transport
from flighttest.mavlink.dialect import dialect, parser


def free_port(kind: socket.SocketKind) -> int:
    """A free port of this machine."""
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.mark.parametrize(
    "url", ["", "tcp:", "udpin:0.0.0.0", "tcp:host:99999", "serial:/dev/x", "http://x:1", "udpin::5"]
)
def test_a_bad_url_names_the_good_ones(url: str) -> None:
    with pytest.raises(InputError, match="udpin:HOST:PORT"):
        open_transport(url)


def test_a_port_that_there_is_not_is_named() -> None:
    with pytest.raises(InputError, match="has port 99999: there are 1 to 65535"):
        open_transport("udpin:0.0.0.0:99999")


def test_no_listener() -> None:
    port = free_port(socket.SOCK_STREAM)
    with pytest.raises(LinkError, match=f"cannot open tcp:127.0.0.1:{port}"):
        open_transport(f"tcp:127.0.0.1:{port}")


@pytest.mark.slow
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


def test_udp_answers_every_sender_and_loses_what_has_no_receiver() -> None:
    port = free_port(socket.SOCK_DGRAM)
    listening = open_transport(f"udpin://127.0.0.1:{port}")
    listening.send(b"without a receiver")
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


def beat(system: int, mode: int, armed: bool = True) -> bytes:
    message = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
        dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0,
        mode,
        dialect.MAV_STATE_ACTIVE,
        3,
    )
    return bytes(message.pack(parser(system, 1)))


@pytest.mark.slow
def test_a_connected_vehicle_is_who_first_spoke_as_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another sender that reaches the port can neither act as the vehicle nor receive its targets; a station beside it does no harm."""
    monkeypatch.setattr("flighttest.link.transport.PEER_S", 0.2)
    port = free_port(socket.SOCK_DGRAM)
    session = Session(MavlinkPort(open_transport(f"udpin:127.0.0.1:{port}")))
    with contextlib.ExitStack() as opened:
        vehicle, station, false, again = (
            opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(4)
        )
        for one, host in ((vehicle, "127.0.0.1"), (station, "127.0.0.3"), (false, "127.0.0.2"), (again, "127.0.0.1")):
            one.bind((host, 0))
            one.setblocking(False)
        here = ("127.0.0.1", port)
        station.sendto(bytes(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(parser(255, 190))), here)
        vehicle.sendto(beat(1, 20), here)
        station.sendto(bytes(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(parser(255, 190))), here)
        session.connect(2.0)
        for _ in range(50):
            false.sendto(beat(1, 5, armed=False), here)
        session.advance(session.now_s() + 0.1)
        assert session.latest["HEARTBEAT"].message.custom_mode == 20
        assert session.port.turned_away == 50
        with pytest.raises(BlockingIOError):
            false.recv(1000)
        assert vehicle.recv(1000)
        vehicle.sendto(beat(1, 20), here)
        session.advance(session.now_s() + 0.02)
        again.sendto(beat(1, 5), here)
        session.advance(session.now_s() + 0.05)
        assert session.latest["HEARTBEAT"].message.custom_mode == 20, "as long as the vehicle is heard at its own port"
        time.sleep(0.3)
        again.sendto(beat(1, 5), here)
        session.advance(session.now_s() + 0.05)
        assert session.latest["HEARTBEAT"].message.custom_mode == 5, "a router that was started again"
    session.port.close()


@pytest.mark.parametrize("fault", ["loss", "burst", "double", "late double", "swap"])
def test_one_vehicle_on_a_bad_link_is_one(fault: str) -> None:
    draw = random.Random(4)
    frames = [(n % 256, n) for n in range(6000)]
    if fault == "loss":
        frames = [f for f in frames if draw.random() > 0.3]
    elif fault == "burst":
        frames = [f for f in frames if f[1] // 100 % 7]
    elif fault == "double":
        frames = [f for f in frames for _ in range(2)]
    elif fault == "late double":
        frames = sorted([*frames, *frames], key=lambda f: f[1])
        frames = [
            f for n in range(0, 6000, 200) for f in (*frames[2 * n : 2 * n + 400 : 2], *frames[2 * n : 2 * n + 400 : 2])
        ]
    else:
        for n in range(0, 5990, 10):
            frames[n], frames[n + 3] = frames[n + 3], frames[n]
    sequence, dropped = Sequence(), 0
    for number, (seq, n) in enumerate(frames):
        dropped += sequence.foreign(seq, str(n).encode(), 0.003 * (n if fault == "burst" else number))
    assert sequence.foreign_frames == 0
    assert dropped == 0 or fault == "burst"
