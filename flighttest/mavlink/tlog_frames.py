"""A telemetry log's bytes to MAVLink frames, and frames of one type to columns, all at once.

A record is 8 bytes of big-endian microseconds and a frame of MAVLink 1 or 2. A frame counts only where another record begins behind it
(or the log ends) and its checksum is right; what is skipped is counted and located.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.mavlink.decode import WANTED, StreamDecoder
from flighttest.mavlink.dialect import dialect, parser

_STAMP_BYTES = 8
_V1, _V2 = 0xFE, 0xFD
_SIGNATURE_BYTES = 13
_INCOMPATIBLE_SIGNED = 1
# Messages that hold text, or that come seldom: they are read one by one, the others as columns.
_ONE_BY_ONE = {
    "HEARTBEAT", "STATUSTEXT", "TIMESYNC", "PARAM_VALUE", "AUTOPILOT_VERSION", "GPS_GLOBAL_ORIGIN", "HOME_POSITION",
}  # fmt: skip


@dataclass(frozen=True)
class Frames:
    """Frames of a log in order: at (n,) offset of the record, stamp_us (n,), start of payload (n,), payload length (n,), message id
    (n,), system (n,), component (n,), sequence number (n,). lost: (offset, size) of bytes that are no frame."""

    data: NDArray[np.uint8]
    at: NDArray[np.int64]
    stamp_us: NDArray[np.int64]
    payload: NDArray[np.int64]
    length: NDArray[np.int64]
    kind: NDArray[np.int64]
    system: NDArray[np.uint8]
    component: NDArray[np.uint8]
    sequence: NDArray[np.uint8]
    lost: tuple[tuple[int, int], ...]

    def where(self, keep: NDArray[Any]) -> Frames:
        """The frames that `keep` selects."""
        return Frames(
            data=self.data,
            at=self.at[keep],
            stamp_us=self.stamp_us[keep],
            payload=self.payload[keep],
            length=self.length[keep],
            kind=self.kind[keep],
            system=self.system[keep],
            component=self.component[keep],
            sequence=self.sequence[keep],
            lost=self.lost,
        )

    @property
    def sender(self) -> NDArray[np.int64]:
        """Who sent it (n,): 256 times the system id plus the component id."""
        return np.asarray(self.system.astype(np.int64) * 256 + self.component)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Ground time (n,), s since 1970."""
        return np.asarray(self.stamp_us, dtype=np.float64) * 1e-6

    def bytes_of(self, i: int) -> bytes:
        """Frame i from its magic byte to its checksum, or its signature."""
        start = int(self.at[i]) + _STAMP_BYTES
        end = int(self.payload[i] + self.length[i]) + 2
        signed = self.data[start] == _V2 and self.data[start + 2] & _INCOMPATIBLE_SIGNED
        return self.data[start : end + (_SIGNATURE_BYTES if signed else 0)].tobytes()


def split(data: bytes) -> Frames:
    """Find all frames of a log."""
    starts, lost = _walk(data)
    buffer = np.frombuffer(data, dtype=np.uint8)
    at = np.asarray(starts, dtype=np.int64)
    begin = at + _STAMP_BYTES
    second = buffer[begin] == _V2
    header = np.where(second, 10, 6)

    def column(v1: int, v2: int) -> NDArray[np.uint8]:
        return buffer[begin + np.where(second, v2, v1)]

    kind = column(5, 7).astype(np.int64)
    # Message ids of MAVLink 2 have three bytes.
    two = np.flatnonzero(second)
    kind[two] += buffer[begin[two] + 8].astype(np.int64) << 8
    kind[two] += buffer[begin[two] + 9].astype(np.int64) << 16
    stamps = np.ndarray((max(buffer.size - 7, 0),), ">u8", buffer, strides=(1,))[at] if at.size else np.zeros(0)
    return Frames(
        data=buffer,
        at=at,
        stamp_us=stamps.astype(np.int64),
        payload=begin + header,
        length=buffer[begin + 1].astype(np.int64),
        kind=kind,
        system=column(3, 5),
        component=column(4, 6),
        sequence=column(2, 4),
        lost=tuple(lost),
    )


def _walk(data: bytes) -> tuple[list[int], list[tuple[int, int]]]:
    starts: list[int] = []
    lost: list[tuple[int, int]] = []
    size = len(data)
    at = 0
    add = starts.append
    while at < size:
        following = _after(data, at, size)
        if following == size or (
            following and following + _STAMP_BYTES < size and data[following + _STAMP_BYTES] in (_V1, _V2)
        ):
            add(at)
            at = following
            continue
        # Not a frame, or not one that another follows: look for the next place where two in a row begin.
        begin = at
        at = _resume(data, at + 1, size)
        if lost and lost[-1][0] + lost[-1][1] == begin:
            lost[-1] = (lost[-1][0], at - lost[-1][0])
        else:
            lost.append((begin, at - begin))
    return starts, lost


def _after(data: bytes, at: int, size: int) -> int:
    """Where the record at `at` ends, 0 where none begins there or it is cut off."""
    start = at + _STAMP_BYTES
    if start + 8 > size:
        return 0
    magic = data[start]
    if magic == _V2:
        end = start + data[start + 1] + 12
        if data[start + 2] & _INCOMPATIBLE_SIGNED:
            end += _SIGNATURE_BYTES
    elif magic == _V1:
        end = start + data[start + 1] + 8
    else:
        return 0
    return end if end <= size else 0


def _resume(data: bytes, at: int, size: int) -> int:
    while True:
        places = [p for p in (data.find(_V1, at + _STAMP_BYTES), data.find(_V2, at + _STAMP_BYTES)) if p >= 0]
        if not places:
            return size
        at = min(places) - _STAMP_BYTES
        following = _after(data, at, size)
        if following == size or (
            following and following + _STAMP_BYTES < size and data[following + _STAMP_BYTES] in (_V1, _V2)
        ):
            return at
        at += 1


def good_checksums(frames: Frames, kind: int) -> NDArray[np.bool_]:
    """Which of frames of one message type carry the right checksum (CRC-16/MCRF4XX over header, payload and the type's seed)."""
    seed = np.uint8(dialect.mavlink_map[kind].crc_extra)
    good = np.zeros(frames.at.size, dtype=bool)
    first = frames.at + _STAMP_BYTES + 1  # the checksum leaves out the magic byte
    count = frames.payload + frames.length - first
    for size in np.unique(count):
        group = np.flatnonzero(count == size)
        begin = first[group]
        crc = np.full(group.size, 0xFFFF, dtype=np.uint16)
        for k in range(int(size)):
            crc = _crc_step(crc, frames.data[begin + k])
        crc = _crc_step(crc, np.full(group.size, seed))
        sent = frames.data[begin + size].astype(np.uint16) | (frames.data[begin + size + 1].astype(np.uint16) << 8)
        good[group] = crc == sent
    return good


def _crc_step(crc: NDArray[np.uint16], byte: NDArray[np.uint8]) -> NDArray[np.uint16]:
    return np.asarray((crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF], dtype=np.uint16)


def _crc_table() -> NDArray[np.uint16]:
    table = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint16(0x8408), table >> 1).astype(np.uint16)
    return table


_TABLE = _crc_table()


def fields_of(frames: Frames, kind: int) -> Mapping[str, NDArray[Any]]:
    """Fields (n,) or (n, k) of frames of one message type; payloads are filled up with zeros, as MAVLink 2 cuts them."""
    message = dialect.mavlink_map[kind]
    layout = _layout(kind)
    rows = np.zeros((frames.at.size, layout.itemsize), dtype=np.uint8)
    for size in np.unique(frames.length):
        group = np.flatnonzero(frames.length == size)
        width = min(int(size), layout.itemsize)
        if width:
            every = np.ndarray((frames.data.size - width + 1,), f"V{width}", frames.data, strides=(1,))
            rows[group, :width] = every[frames.payload[group]].view(np.uint8).reshape(group.size, width)
    table = rows.view(layout)[:, 0]
    return {name: table[name] for name in message.ordered_fieldnames}


_CODES = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8", "f": "<f4", "d": "<f8",
}  # fmt: skip


def _layout(kind: int) -> np.dtype[Any]:
    message = dialect.mavlink_map[kind]
    letters = message.native_format.decode()[1:]
    fields: list[Any] = []
    for name, letter, count in zip(message.ordered_fieldnames, letters, message.array_lengths, strict=True):
        if letter == "c":
            fields.append((name, f"S{max(count, 1)}"))
        else:
            fields.append((name, _CODES[letter], (count,)) if count else (name, _CODES[letter]))
    return np.dtype(fields)


def decoder_of(frames: Frames) -> StreamDecoder:
    """A decoder that has taken in all frames, which are known to be sound."""
    decoder = StreamDecoder()
    mav = parser(0, 0)
    late: list[tuple[int, Any]] = []
    for kind in np.unique(frames.kind):
        message = dialect.mavlink_map.get(int(kind))
        if message is None or message.msgname not in WANTED:
            continue
        chosen = np.flatnonzero(frames.kind == kind)
        if message.msgname in _ONE_BY_ONE:
            late += [(int(i), mav.decode(bytearray(frames.bytes_of(int(i))))) for i in chosen]
            continue
        senders = frames.sender[chosen]
        for sender in np.unique(senders):
            order = chosen[senders == sender]
            mine = frames.where(order)
            source = (int(sender) // 256, int(sender) % 256)
            decoder.add_columns(source, message.msgname, mine.time_s, order, fields_of(mine, int(kind)))
    for i, message in sorted(late, key=lambda pair: pair[0]):
        decoder.add(float(frames.stamp_us[i]) * 1e-6, message, i)
    return decoder
