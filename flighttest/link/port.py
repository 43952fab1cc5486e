"""MAVLink frames over a transport, every one of them handed to the recorder."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from flighttest.link.sender import Sender
from flighttest.link.transport import Peer, Transport, UdpTransport
from flighttest.mavlink.dialect import Message, parser
from flighttest.mavlink.signing import SignedLink

OWN_SYSTEM = 245  # not a ground station's 255, so that FS_GCS_ENABLE does not watch us
OWN_COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER


class Tap(Protocol):
    """Takes a whole frame and its message, sent or received, in the order they passed."""

    def __call__(self, frame: bytes, message: Message, /, ago_s: float = 0.0) -> None:
        """ago_s: how long ago it passed, where a thread of its own has sent it."""


class MavlinkPort:
    """Sends and receives messages. `mute()` is final: after it, nothing leaves. system: our own system id.

    key: with which every frame is signed; what is not signed with it is refused.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        system: int = OWN_SYSTEM,
        component: int = OWN_COMPONENT,
        key: bytes | None = None,
    ) -> None:
        self.system = system
        self._transport = transport
        self._mav: Any = parser(system, component) if key is None else SignedLink(system, component, key)
        self.signs = key is not None
        self._taps: list[Tap] = []
        self.muted = False
        self.frames_sent = 0
        self.frames_received = 0
        self.bad_bytes = 0
        self.frames_lost = 0
        self._sequence: dict[tuple[int, int], int] = {}
        self._peers: dict[tuple[int, int], Peer | None] = {}
        self._lock = threading.Lock()  # of what is sent
        self._sender: Sender | None = None
        self._sent: list[tuple[float, bytes, Message]] = []  # by the sender's thread, not shown yet

    def tap(self, tap: Tap) -> None:
        """Show every frame from now on to `tap` as well."""
        self._taps.append(tap)

    def keep_to(self, system: int, component: int) -> None:
        """From now on receive from and send to the first sender of this system id only: over UDP anybody can use it."""
        peer = self._peers.get((system, component))
        if peer is not None and isinstance(self._transport, UdpTransport):
            self._transport.keep_to(peer)

    @property
    def turned_away(self) -> int:
        """Datagrams that came from others since."""
        return getattr(self._transport, "turned_away", 0)

    @property
    def refused(self) -> int:
        """Frames that were not signed with the key."""
        return self._mav.refused if self.signs else 0

    @property
    def hears_signatures(self) -> bool:
        """Whether the vehicle signs what it sends."""
        return bool(self._mav.signing.sig_count)

    def mute(self) -> None:
        """Never send again: the pilot has the vehicle."""
        self.muted = True
        self.cancel()

    def send(self, message: Message) -> bool:
        """Send one message; False when muted."""
        if self.muted:
            return False
        self._show_sent()
        frame = self._hand_over(message)
        for tap in self._taps:
            tap(frame, message)
        return True

    def _hand_over(self, message: Message) -> bytes:
        with self._lock:
            if self.signs:
                self._mav.now()
            frame = bytes(message.pack(self._mav))
            self._mav.seq = (self._mav.seq + 1) % 256
            self._transport.send(frame)
            self.frames_sent += 1
        return frame

    # -- at a time -----------------------------------------------------------------------------------------------------------

    def send_on_time(self) -> Callable[[], None]:
        """From now on `send_at` has a thread of its own; call what is returned to end that."""
        self._sender = Sender(self._send_waiting)
        return self._end_sender

    def _end_sender(self) -> None:
        if self._sender is not None:
            self._sender.close()
            self._sender = None
            self._show_sent()

    @property
    def on_time(self) -> bool:
        """Whether `send_at` sends at the time that is named."""
        return self._sender is not None

    @property
    def late_s(self) -> float:
        """How late a message left at most that `send_at` took since `forget_late`."""
        return self._sender.late_s if self._sender is not None else 0.0

    def forget_late(self) -> None:
        """Measure `late_s` from now on."""
        if self._sender is not None:
            self._sender.forget_late()

    def send_at(self, in_s: float, message: Message) -> bool:
        """Send a message in in_s host seconds, unless it is cancelled before; at once where there is no thread for it. False when muted."""
        if self._sender is None or self.muted:
            return self.send(message)
        self._sender.at(time.monotonic() + in_s, message)
        return True

    def cancel(self) -> None:
        """Drop what waits for its time: nothing of it leaves after this returns."""
        if self._sender is not None:
            self._sender.cancel()

    def _send_waiting(self, message: Message) -> None:
        if not self.muted:
            frame = self._hand_over(message)
            self._sent.append((time.monotonic(), frame, message))

    def _show_sent(self) -> None:
        """Show the taps what the thread has sent: taps are called in one thread only."""
        while self._sent:
            at_s, frame, message = self._sent.pop(0)
            for tap in self._taps:
                tap(frame, message, ago_s=time.monotonic() - at_s)

    # -- from the vehicle ----------------------------------------------------------------------------------------------------

    def receive(self, timeout_s: float) -> list[Message]:
        """Messages that have arrived, none after timeout_s host seconds. Bytes that are no MAVLink are counted."""
        data = self._transport.receive(timeout_s)
        self._show_sent()
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
        header = message.get_header()
        source = (header.srcSystem, header.srcComponent)
        if source not in self._peers:
            self._peers[source] = getattr(self._transport, "sender", None)
        sequence = header.seq
        last = self._sequence.get(source)
        if last is not None:
            missing = (sequence - last - 1) % 256
            self.frames_lost += (
                missing if missing < 128 else 0
            )  # a datagram that came twice or late is not 255 lost ones
        self._sequence[source] = sequence

    def left_out(self) -> list[str]:
        """What others sent and was not taken in, as sentences."""
        counted = (
            (self.turned_away, "datagrams that others sent to this port"),
            (self.refused, "frames that were not signed with the key"),
        )
        return [f"{count} {what} were left out" for count, what in counted if count]

    @property
    def loss_share(self) -> float:
        """Share of the vehicle's frames that never arrived, 0..1."""
        total = self.frames_received + self.frames_lost
        return self.frames_lost / total if total else 0.0

    def close(self) -> None:
        """Close the transport."""
        self._end_sender()
        self._transport.close()
