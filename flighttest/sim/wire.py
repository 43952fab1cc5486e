"""Frames on the wire, from pymavlink's ArduPilot dialect alone: the vehicle's end shares no codec with the ground's.

Telemetry goes through `Encoder.fields`, which packs the struct that the dialect declares without building a message
object: five times cheaper, which is what a simulation at twenty times real time spends most of its time on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

UNIX_2015_S = 1420070400  # from when on signatures count time


def _crc(data: bytes) -> int:
    return int(dialect.x25crc(data).crc)


_checksum: Callable[[bytes], int] = getattr(dialect, "mcrf4xx", None) or _crc


class Layout:
    """How one message type lies on the wire: `pack(*values)` takes the fields in wire order (`order`)."""

    __slots__ = ("extra", "id_bytes", "order", "pack")

    def __init__(self, message: Any) -> None:
        self.pack: Callable[..., bytes] = message.unpacker.pack
        self.extra = bytes([message.crc_extra])
        self.id_bytes = int(message.id).to_bytes(3, "little")
        self.order = tuple(message.ordered_fieldnames)


class Signing:
    """MAVLink 2 signing as ArduPilot does it: with a key everything that is sent is signed, and only what is signed is taken."""

    def __init__(self, key: bytes = b"") -> None:
        self.key = key
        self.stamp = 0
        self._newest: dict[tuple[int, int, int], int] = {}

    def set(self, key: bytes, stamp: int) -> None:
        """Take a key; all zero takes it away."""
        self.key = key if any(key) else b""
        self.stamp = max(self.stamp, stamp)
        self._newest.clear()

    def seal(self, frame: bytes) -> bytes:
        """A frame as it leaves: signed where there is a key. Frames leave in the order in which they are sealed."""
        if not self.key or frame[2] & 1:
            return frame
        self.stamp += 1
        body = frame[1:2] + b"\x01" + frame[3:-2]
        crc = _checksum(body + bytes([dialect.mavlink_map[int.from_bytes(frame[7:10], "little")].crc_extra]))
        words = b"\xfd" + body + bytes((crc & 0xFF, crc >> 8)) + b"\0" + self.stamp.to_bytes(6, "little")
        return words + hashlib.sha256(self.key + words).digest()[:6]

    def takes(self, message: Any) -> bool:
        """Whether a message may be handled."""
        if not self.key:
            return True
        frame = bytes(message.get_msgbuf())
        if frame[0] != 0xFD or not frame[2] & 1 or hashlib.sha256(self.key + frame[:-6]).digest()[:6] != frame[-6:]:
            return False
        stamp = int.from_bytes(frame[-12:-6], "little")
        sender = (frame[-13], message.get_srcSystem(), message.get_srcComponent())
        if stamp <= self._newest.get(sender, self.stamp - 6_000_000):  # a new sender may be a minute behind
            return False
        self._newest[sender] = stamp
        self.stamp = max(self.stamp, stamp)
        return True


class Encoder:
    """Numbers and packs what one system sends."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self.system, self.component = system, component
        self.signing = Signing()
        self._mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._tail = bytes([system, component])
        self._layouts: dict[Any, Layout] = {}

    def message(self, message: Any) -> bytes:
        """A message object as a frame."""
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) & 0xFF
        return frame

    def fields(self, kind: Any, *values: Any) -> bytes:
        """A frame of the dialect's message class `kind`, its values in wire order."""
        layout = self._layouts.get(kind)
        if layout is None:
            layout = self._layouts[kind] = Layout(kind)
        payload = layout.pack(*values).rstrip(b"\0") or b"\0"
        seq = self._mav.seq
        self._mav.seq = (seq + 1) & 0xFF
        head = bytes((len(payload), 0, 0, seq)) + self._tail + layout.id_bytes
        body = head + payload
        crc = _checksum(body + layout.extra)
        return b"\xfd" + body + bytes((crc & 0xFF, crc >> 8))


class Decoder:
    """Bytes of one connection to messages; damaged frames are dropped, as an autopilot drops them."""

    def __init__(self) -> None:
        self._mav = dialect.MAVLink(None)
        self._mav.robust_parsing = True

    def feed(self, data: bytes) -> list[Any]:
        """Messages completed by these bytes."""
        if not data:
            return []
        found = self._mav.parse_buffer(data) or ()
        return [m for m in found if m.get_type() != "BAD_DATA" and not m.get_type().startswith("UNKNOWN")]
