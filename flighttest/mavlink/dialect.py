"""The MAVLink dialect of this package: version 2, ArduPilot's. The only module that imports pymavlink's messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

__all__ = [
    "COMPONENT_AUTOPILOT",
    "Message",
    "Parser",
    "dialect",
    "firmware_version",
    "is_armed",
    "is_vehicle",
    "is_warning",
    "parser",
]

Message = Any
"""One decoded MAVLink message, as pymavlink makes them: fields are attributes, `get_type()` names it."""

COMPONENT_AUTOPILOT = 1
# What sends HEARTBEATs and does not fly; some of them name an autopilot all the same.
_NO_VEHICLE = frozenset({
    dialect.MAV_TYPE_GCS, dialect.MAV_TYPE_ANTENNA_TRACKER, dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_TYPE_GIMBAL,
    dialect.MAV_TYPE_ADSB, dialect.MAV_TYPE_CAMERA, dialect.MAV_TYPE_CHARGING_STATION, dialect.MAV_TYPE_FLARM,
})  # fmt: skip


_V2 = 0xFD
_HEADER_BYTES, _CHECKSUM_BYTES = 10, 2
_FRAME_BYTES = _HEADER_BYTES + _CHECKSUM_BYTES


def _crc(data: bytes) -> int:
    return int(dialect.x25crc(data).crc)


_checksum: Callable[[bytes], int] = getattr(dialect, "mcrf4xx", None) or _crc


class _Layout:
    """How one message type without text is read: `fields` of a payload gives the values that pymavlink gives, by name."""

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        self.extra = bytes([kind.crc_extra])
        self.size: int = kind.unpacker.size
        self._unpack: Callable[[bytes], tuple[Any, ...]] = kind.unpacker.unpack
        self._names = tuple(kind.ordered_fieldnames)
        self._lengths = tuple(kind.lengths)
        self._single = sum(self._lengths) == len(self._lengths)
        # Whatever else a message has, as pymavlink makes it.
        made = vars(kind(*[0] * len(kind.fieldnames)))
        self.rest = {name: value for name, value in made.items() if name not in kind.fieldnames}

    def fields(self, payload: bytes) -> dict[str, Any]:
        """Values by field name of a payload of the full size."""
        values = self._unpack(payload)
        if self._single:
            return dict(zip(self._names, values, strict=True))
        found: dict[str, Any] = {}
        at = 0
        for name, length in zip(self._names, self._lengths, strict=True):
            found[name] = values[at] if length == 1 else list(values[at : at + length])
            at += length
        return found


def _layout_of(number: int) -> _Layout | None:
    """Of a message type by its number; None where it is not known, or has text, which pymavlink makes more of."""
    kind = dialect.mavlink_map.get(number)
    return None if kind is None or b"s" in kind.native_format or b"c" in kind.native_format else _Layout(kind)


class Parser(dialect.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's encoder and decoder, with a shorter way to the same messages for what a stream mostly is: whole MAVLink 2 frames without
    a signature, of known types without text, with the right checksum. All else goes through pymavlink. Never raises on bad bytes."""

    buf: bytearray  # pymavlink's: bytes that wait for the rest of a frame, from `buf_index` on
    buf_index: int

    def __init__(self, system: int, component: int) -> None:
        super().__init__(None, srcSystem=system, srcComponent=component)
        self.robust_parsing = True
        self._layouts: dict[int, _Layout | None] = {}

    def parse_buffer(self, s: bytes) -> list[Message] | None:  # pymavlink's name
        """Messages that these bytes complete, None where there are none."""
        found: list[Message] = []
        waiting: bytearray = self.buf
        waiting.extend(s)
        self.total_bytes_received += len(s)
        at: int = self.buf_index
        while at < len(waiting):
            message = None
            if waiting[at] == _V2 and len(waiting) - at >= _FRAME_BYTES:
                end = at + waiting[at + 1] + _FRAME_BYTES
                message = self._short(waiting[at:end])
            if message is not None:
                self.total_packets_received += 1
                at = end
            else:
                self.buf_index = at
                message = self.parse_char(b"")
                waiting, at = self.buf, self.buf_index
                if message is None:
                    break
            found.append(message)
        self.buf_index = at
        if at == len(waiting):
            self.buf, self.buf_index = bytearray(), 0
        return found or None

    def decode(self, msgbuf: bytearray) -> Message:  # pymavlink's name
        """The message of one frame."""
        message = self._short(msgbuf) if len(msgbuf) >= _FRAME_BYTES and msgbuf[0] == _V2 else None
        return super().decode(msgbuf) if message is None else message

    def _short(self, frame: bytearray) -> Message | None:
        """The message of a MAVLink 2 frame; None where it is pymavlink's to look at."""
        length = frame[1]
        if frame[2] or len(frame) != length + _FRAME_BYTES or self.signing.secret_key is not None:
            return None
        number = frame[7] | frame[8] << 8 | frame[9] << 16
        if number not in self._layouts:
            self._layouts[number] = _layout_of(number)
        layout = self._layouts[number]
        if layout is None:
            return None
        crc = frame[-2] | frame[-1] << 8
        if _checksum(bytes(frame[1:-2]) + layout.extra) != crc:
            return None
        size = layout.size
        payload = bytes(frame[_HEADER_BYTES : _HEADER_BYTES + min(length, size)])
        message = layout.kind.__new__(layout.kind)
        state = message.__dict__
        state.update(layout.rest)
        state.update(layout.fields(payload if length >= size else payload.ljust(size, b"\0")))
        state["_msgbuf"] = frame
        state["_payload"] = frame[6:-2]
        state["_crc"] = crc
        state["_header"] = dialect.MAVLink_header(number, 0, frame[3], length, frame[4], frame[5], frame[6])
        return message


def parser(system: int, component: int) -> Parser:
    """A fresh encoder and decoder for one end of a link: it never raises on bad bytes, they come out as BAD_DATA."""
    return Parser(system, component)


def is_vehicle(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT comes from an autopilot, not from a ground station, an antenna tracker, a gimbal or a companion computer."""
    return bool(heartbeat.autopilot != dialect.MAV_AUTOPILOT_INVALID and heartbeat.type not in _NO_VEHICLE)


def is_warning(statustext: Message) -> bool:
    """Whether a STATUSTEXT is a warning, or about a fence or failsafe: a breach of the fence is a notice in ArduCopter."""
    about = statustext.text.lower()
    return statustext.severity <= dialect.MAV_SEVERITY_WARNING or "fence" in about or "failsafe" in about


def is_armed(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT shows that the motors are armed."""
    return bool(heartbeat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)


def firmware_version(version: Message) -> str:
    """AUTOPILOT_VERSION as text, such as `4.7.0-dev (97009754)`."""
    number = int(version.flight_sw_version)
    kinds = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}
    text = f"{number >> 24 & 255}.{number >> 16 & 255}.{number >> 8 & 255}{kinds.get(number & 255, '')}"
    raw = bytes(int(b) & 255 for b in version.flight_custom_version).rstrip(b"\0")
    commit = raw.decode("ascii") if raw and all(48 <= b < 123 for b in raw) else raw.hex()
    return f"{text} ({commit})" if commit else text


def board_id(version: Message) -> str:
    """The board's own number of an AUTOPILOT_VERSION in hexadecimal (its newer field, else the older), '' where it states none."""
    newer = bytes(int(b) & 255 for b in getattr(version, "uid2", ()))
    return newer.hex() if any(newer) else f"{int(version.uid):x}" if version.uid else ""
