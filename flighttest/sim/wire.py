"""Frames on the wire, from pymavlink's ArduPilot dialect alone: the vehicle's end shares no codec with the ground's.

Telemetry goes through `Encoder.fields`, which packs the struct that the dialect declares without building a message
object: five times cheaper, which is what a simulation at twenty times real time spends most of its time on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as book


def _crc(data: bytes) -> int:
    return int(book.x25crc(data).crc)


_checksum: Callable[[bytes], int] = getattr(book, "mcrf4xx", None) or _crc


class Layout:
    """How one message type lies on the wire: `pack(*values)` takes the fields in wire order (`order`)."""

    __slots__ = ("extra", "id_bytes", "order", "pack")

    def __init__(self, message: Any) -> None:
        self.pack: Callable[..., bytes] = message.unpacker.pack
        self.extra = bytes([message.crc_extra])
        self.id_bytes = int(message.id).to_bytes(3, "little")
        self.order = tuple(message.ordered_fieldnames)


class Encoder:
    """Numbers and packs what one system sends."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self.system, self.component = system, component
        self._mav = book.MAVLink(None, srcSystem=system, srcComponent=component)
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
        self._mav = book.MAVLink(None)
        self._mav.robust_parsing = True

    def feed(self, data: bytes) -> list[Any]:
        """Messages completed by these bytes."""
        if not data:
            return []
        found = self._mav.parse_buffer(data) or ()
        return [m for m in found if m.get_type() != "BAD_DATA" and not m.get_type().startswith("UNKNOWN")]
