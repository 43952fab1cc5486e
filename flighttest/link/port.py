"""MAVLink frames over a transport, every one of them shown to whoever records."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flighttest.link.transport import Peer, Transport, UdpTransport
from flighttest.mavlink.dialect import Message, parser

OWN_SYSTEM = 245  # not a ground station's 255, so that FS_GCS_ENABLE does not watch us
OWN_COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER

Tap = Callable[[bytes, Message], None]
"""Takes a whole frame and its message, sent or received, in the order they passed."""


class Port:
    """Sends and receives messages. `mute()` is final: after it, nothing leaves. system: our own system id."""

    def __init__(self, transport: Transport, *, system: int = OWN_SYSTEM, component: int = OWN_COMPONENT) -> None:
        self.system = system
        self._transport = transport
        self._mav: Any = parser(system, component)
        self._taps: list[Tap] = []
        self.muted = False
        self.frames_sent = 0
        self.frames_received = 0
        self.bad_bytes = 0
        self.frames_lost = 0
        self._sequence: dict[tuple[int, int], int] = {}
        self._peers: dict[tuple[int, int], Peer | None] = {}

    def tap(self, tap: Tap) -> None:
        """Show every frame from now on to `tap` as well."""
        self._taps.append(tap)

    def keep_to(self, system: int, component: int) -> None:
        """Hear and answer from now on only who first spoke as this one: over UDP anybody can say that he is the vehicle."""
        peer = self._peers.get((system, component))
        if peer is not None and isinstance(self._transport, UdpTransport):
            self._transport.keep_to(peer)

    @property
    def turned_away(self) -> int:
        """Datagrams that came from others since."""
        return getattr(self._transport, "turned_away", 0)

    def mute(self) -> None:
        """Never send again: the pilot has the vehicle."""
        self.muted = True

    def send(self, message: Message) -> bool:
        """Send one message; False when muted."""
        if self.muted:
            return False
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        self._transport.send(frame)
        self.frames_sent += 1
        for tap in self._taps:
            tap(frame, message)
        return True

    def receive(self, timeout_s: float) -> list[Message]:
        """Messages that have arrived, none after timeout_s host seconds. Bytes that are no MAVLink are counted."""
        data = self._transport.receive(timeout_s)
        if not data:
            return []
        messages: list[Message] = []
        for message in self._mav.parse_buffer(data) or []:
            if message.get_type() == "BAD_DATA":
                self.bad_bytes += len(message.get_msgbuf())
                continue
            self.frames_received += 1
            self._count_lost(message)
            for tap in self._taps:
                tap(bytes(message.get_msgbuf()), message)
            messages.append(message)
        return messages

    def _count_lost(self, message: Message) -> None:
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source not in self._peers:
            self._peers[source] = getattr(self._transport, "sender", None)
        sequence = message.get_seq()
        last = self._sequence.get(source)
        if last is not None:
            missing = (sequence - last - 1) % 256
            self.frames_lost += (
                missing if missing < 128 else 0
            )  # a datagram that came twice or late is not 255 lost ones
        self._sequence[source] = sequence

    @property
    def loss_share(self) -> float:
        """Share of the vehicle's frames that never arrived, 0..1."""
        total = self.frames_received + self.frames_lost
        return self.frames_lost / total if total else 0.0

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()
