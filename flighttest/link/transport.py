"""Bytes to and from a vehicle: UDP, TCP and serial ports by URL. Independent of MAVLink."""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import re
import select
import socket
import time
from collections import deque
from typing import Any, Protocol

from flighttest.errors import InputError, LinkError

URL_FORMS = (
    "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:/dev/ttyX:BAUD, udp:, udp:PORT, /dev/ttyX, COM3 or sim"
)
_USUAL_PORT = 14550
_USB_BAUD, _RADIO_BAUD = 115200, 57600  # a USB port has no baud rate of its own; SiK radios come with 57600
_DEVICE = re.compile(r"(/dev/[^:]+|COM\d+)(?::(\d+))?")
_CHUNK = 65536
_CONNECT_TIMEOUT_S = 5.0
PEER_S = 5.0
_RECONNECT_EVERY_S = 1.0


class Transport(Protocol):
    """One end of a byte link. `receive` returns what has arrived, or b"" after timeout_s (host seconds); it never blocks longer."""

    def send(self, data: bytes) -> None:
        """Hand the bytes over; what cannot be sent now is lost, as on a radio."""

    def receive(self, timeout_s: float) -> bytes:
        """Bytes that have arrived, b"" when none did within timeout_s."""

    def close(self) -> None:
        """Give the port back; harmless when done twice."""


def open_transport(url: str) -> Transport:
    """The transport of a URL (see `URL_FORMS`, with // or without). InputError for a bad URL, LinkError when it cannot be opened."""
    kind, _, rest = full_url(url).partition(":")
    try:
        if kind in ("udpin", "udp", "udpout", "tcp", "tcpout"):
            host, _, port_text = rest.rpartition(":")
            port = int(port_text)
            if not 0 < port < 65536:
                raise InputError(f"{url!r} has port {port}: there are 1 to 65535", f"use {URL_FORMS}")
            if not host:
                raise ValueError(rest)
            if kind in ("tcp", "tcpout"):
                return TcpTransport(host, port)
            return UdpTransport(host, port, listen=kind != "udpout")
        if kind == "serial":
            device, _, baud = rest.rpartition(":")
            if not device:
                raise ValueError(rest)
            return _open_serial(device, int(baud))
    except ValueError:
        pass
    except OSError as error:
        # A serial port's own text repeats its name and the error's number.
        why = os.strerror(error.errno) if error.errno and kind == "serial" else error.strerror or str(error)
        raise LinkError(f"cannot open {url}: {why}", _hint(kind)) from error
    raise InputError(f"{url!r} is not the URL of a link", f"use {URL_FORMS}")


def full_url(url: str) -> str:
    """A URL with all its parts: of `udp:`, `udp:PORT` and the bare name of a device, as of itself."""
    url = url.strip()
    device = _DEVICE.fullmatch(url)
    if device is not None:
        usual = _USB_BAUD if "ACM" in device[1] or "usbmodem" in device[1] else _RADIO_BAUD
        return f"serial:{device[1]}:{device[2] or usual}"
    kind, _, rest = url.partition(":")
    rest = rest.removeprefix("//")
    if kind in ("udp", "udpin") and (rest.isdigit() or (not rest and kind == "udp")):
        return f"udpin:0.0.0.0:{rest or _USUAL_PORT}"
    return f"{kind}:{rest}"


def _hint(kind: str) -> str:
    if kind in ("tcp", "tcpout"):
        return "is the vehicle or simulator running and listening there?"
    if kind == "serial":
        return "check the device name, and that your user may open it (group dialout)"
    return "is the port in use by another program, or the host name wrong?"


Peer = tuple[str, int]


class UdpTransport:
    """UDP. listen: bind and answer every sender (udpin); otherwise send to the address (udpout).

    Every sender of the last seconds is answered, not the last one only: a ground station that sends to the same port must not turn
    targets away from the vehicle. `keep_to` ends that: from then on no other sender is read or answered. sender: who sent what `receive`
    gave last; turned_away: datagrams of others since.
    """

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        # Bursts of a fast simulator must not fall out of the kernel's default buffer.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.sender: Peer | None = None
        self.turned_away = 0
        self._only: Peer | None = None
        self._next: tuple[bytes, Peer] | None = None
        try:
            address = (socket.gethostbyname(host), port)
            self._peers: dict[Peer, float] = {} if listen else {address: math.inf}
            if listen:
                self._socket.bind(address)
        except OSError:
            self._socket.close()
            raise

    def keep_to(self, peer: Peer) -> None:
        """Read and answer this peer alone. Another port of its host takes its place once it sends no more (a restarted router)."""
        self._only = peer
        self._peers = {peer: time.monotonic()}

    def send(self, data: bytes) -> None:
        """Send one datagram; it is lost where no sender is known yet, or a buffer is full."""
        for peer in tuple(self._peers):  # another thread may be receiving
            with contextlib.suppress(OSError):  # unreachable now may be reachable later; loss shows as missing answers
                self._socket.sendto(data, peer)

    def receive(self, timeout_s: float) -> bytes:
        """All datagrams that are waiting, of one sender at a time."""
        chunks: list[bytes] = []
        if self._next is None and not select.select([self._socket], [], [], max(timeout_s, 0.0))[0]:
            return b""
        while True:
            got, self._next = self._next, None
            if got is None:
                try:
                    got = self._socket.recvfrom(_CHUNK)
                except OSError:  # nothing more waits, no receiver, or the network is down
                    break
            data, peer = got
            if not self._welcome(peer):
                self.turned_away += 1
                continue
            if chunks and peer != self.sender:
                self._next = got
                break
            chunks.append(data)
            self.sender = peer
            self._peers[peer] = max(time.monotonic(), self._peers.get(peer, 0.0))
        newest = max(self._peers.values(), default=0.0)
        self._peers = {
            p: t for p, t in self._peers.items() if t == math.inf or t > time.monotonic() - PEER_S or t == newest
        }
        return b"".join(chunks)

    def _welcome(self, peer: Peer) -> bool:
        if self._only is None or peer == self._only:
            return True
        silent = time.monotonic() - self._peers.get(self._only, 0.0) > PEER_S
        if peer[0] != self._only[0] or not silent:
            return False
        self.keep_to(peer)
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpTransport:
    """A TCP client that connects again when the other side went away."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = self._connect(_CONNECT_TIMEOUT_S)
        self._next_try_s = 0.0

    def _connect(self, timeout_s: float) -> socket.socket:
        connected = socket.create_connection(self._address, timeout=timeout_s)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connected.setblocking(False)
        return connected

    def _lose(self, lost: socket.socket | None = None) -> None:
        # One thread may send while another receives: the one that finds the connection closed must not close the next one.
        if lost is not None:
            lost.close()
        if self._socket is lost:
            self._socket = None
            self._next_try_s = time.monotonic() + _RECONNECT_EVERY_S

    def send(self, data: bytes) -> None:
        """Send all of it, or nothing while the other side is away."""
        view = memoryview(data)
        connected = self._socket
        while connected is not None and view:
            try:
                view = view[connected.send(view) :]
            except BlockingIOError:
                # Half a frame would spoil the next one: wait for space, or treat a stuck peer as gone.
                if not select.select([], [connected], [], 0.5)[1]:
                    self._lose(connected)
                    return
            except (OSError, ValueError):  # the latter where the other thread has closed it
                self._lose(connected)
                return

    def receive(self, timeout_s: float) -> bytes:
        """What has arrived; tries to connect again once a second while the other side is away."""
        connected = self._socket
        if connected is None:
            if time.monotonic() < self._next_try_s:
                time.sleep(min(max(timeout_s, 0.0), 0.05))
                return b""
            try:
                connected = self._socket = self._connect(0.5)
            except OSError:
                self._lose()
                return b""
        try:
            if not select.select([connected], [], [], max(timeout_s, 0.0))[0]:
                return b""
            data = connected.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except (OSError, ValueError):
            data = b""
        if not data:
            self._lose(connected)
        return data

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class SerialTransport:
    """A serial port through pyserial; a device that was unplugged gives no bytes until it is back."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def send(self, data: bytes) -> None:
        """Write the bytes; a device that is gone loses them."""
        # pyserial's SerialException is an OSError; the others come where it is opened anew meanwhile
        with contextlib.suppress(OSError, TypeError, ValueError):
            self._port.write(data)

    def receive(self, timeout_s: float) -> bytes:
        """What has arrived within timeout_s."""
        try:
            self._port.timeout = max(timeout_s, 0.0)
            first = self._port.read(1)
            return bytes(first + self._port.read(self._port.in_waiting)) if first else b""
        except OSError:
            time.sleep(min(max(timeout_s, 0.0), 0.05))
            with contextlib.suppress(OSError):
                self._port.close()
                self._port.open()
            return b""

    def close(self) -> None:
        """Close the device."""
        with contextlib.suppress(OSError):
            self._port.close()


def _open_serial(device: str, baud: int) -> SerialTransport:
    try:
        serial = importlib.import_module("serial")
    except ImportError as error:
        raise LinkError("serial ports need the package pyserial", "pip install pyserial") from error
    return SerialTransport(serial.Serial(device, baud, timeout=0, write_timeout=0.5))


# Frames of one sender lost in a row (0.2 s of a full link), or overtaken. As many either way: a frame of another sender that is taken for
# the next one must not make foreign ones of those that follow.
_NEAR = 64
_ALIVE_S = 0.3  # a sender that is silent for longer may have counted on past that
_RECENT = 1024  # frames among which a repeated one is looked for
ENOUGH = 3  # foreign frames: one or two may be a router's or a restarted link's


class Sequence:
    """Follows the sender that was heard first. foreign_frames: frames of another one, since that one went on counting where it was."""

    def __init__(self) -> None:
        self.foreign_frames = 0
        self._last: int | None = None
        self._heard_s = 0.0
        self._apart = 0  # frames that do not follow, since the last one that does
        self._recent: deque[int] = deque(maxlen=_RECENT)
        self._known: set[int] = set()

    def foreign(self, sequence: int, frame: bytes, t_s: float) -> bool:
        """Whether a frame is another sender's, as far as can be determined at t_s."""
        if self._repeated(frame):
            return False
        step = 1 if self._last is None else (sequence - self._last + 128) % 256 - 128
        if 1 <= step <= _NEAR:
            self.foreign_frames += self._apart
        elif -_NEAR <= step <= 0:
            return False  # overtaken on the way
        elif 0.0 <= t_s - self._heard_s <= _ALIVE_S:
            self._apart += 1
            return True
        self._last, self._heard_s, self._apart = sequence, t_s, 0
        return False

    def _repeated(self, frame: bytes) -> bool:
        """Whether the same bytes came before: a link that doubles frames, or two ways to here."""
        key = hash(frame)
        if key in self._known:
            return True
        if len(self._recent) == _RECENT:
            self._known.discard(self._recent[0])
        self._recent.append(key)
        self._known.add(key)
        return False
