"""ArduPilot's dataflash format, bytes to columns: vectorised by message type, one pass, only the types and fields that are wanted.

A message is A3 95, a type byte and a payload whose layout an FMT message (type 128) declares. Message boundaries are found by comparing
all candidates (A3 95 type) with where their predecessor ends, at once; only where the chain breaks is there a loop. A message counts only
where another header begins right behind it (or the file ends there): what is cut or overwritten is dropped, counted and located.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

HEADER = b"\xa3\x95"
TEXT_HEADER = b"FMT,"  # of a log written out as text
_HEADER_BYTES = 3
_FMT_TYPE = 128
_FMT_BYTES = 89
# ArduPilot's format letters: numpy type, and the divisor that gives the unit of the field (libraries/AP_Logger/LogStructure.h)
_CODES: dict[str, tuple[str, float]] = {
    "a": ("(32,)<i2", 1.0), "b": ("i1", 1.0), "B": ("u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0),
    "I": ("<u4", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0), "g": ("<f2", 1.0), "n": ("S4", 1.0), "N": ("S16", 1.0),
    "Z": ("S64", 1.0), "c": ("<i2", 1e2), "C": ("<u2", 1e2), "e": ("<i4", 1e2), "E": ("<u4", 1e2), "L": ("<i4", 1e7),
    "M": ("i1", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0),
}  # fmt: skip


@dataclass(frozen=True)
class Format:
    """Layout of one message type. dtype covers the whole message, header included; codes holds one letter per field."""

    type: int
    name: str
    length: int
    codes: str
    fields: tuple[str, ...]
    dtype: np.dtype[Any]

    def divisor(self, name: str) -> float:
        """What the stored integer is divided by."""
        return _CODES[self.codes[self.fields.index(name)]][1]


@dataclass(frozen=True)
class Gap:
    """Bytes that belong to no message: where they begin, how many, and how many messages were read before them."""

    offset: int
    size: int


class MessageTable:
    """All messages of one type: raw fields as stored, `at` (n,) int64 their byte offsets in the log."""

    def __init__(self, format: Format, at: NDArray[np.int64], raw: Mapping[str, NDArray[Any]]) -> None:
        self.format = format
        self.at = at
        self.raw = raw

    def __len__(self) -> int:
        return int(self.at.size)

    def __contains__(self, name: str) -> bool:
        return name in self.raw

    def get(self, name: str) -> NDArray[np.float64]:
        """(n,) a numeric field in the unit its format letter implies."""
        values = self.raw[name].astype(np.float64)
        divisor = self.format.divisor(name)
        return values if divisor == 1.0 else values / divisor

    def text(self, name: str) -> list[str]:
        """A text field, cut at its first zero byte; what is not UTF-8 is read as Latin-1."""
        return [_text(bytes(value)) for value in self.raw[name]]

    def where(self, keep: NDArray[np.bool_]) -> MessageTable:
        """The messages that `keep` (n,) selects."""
        return MessageTable(self.format, self.at[keep], {name: values[keep] for name, values in self.raw.items()})


@dataclass(frozen=True)
class Dataflash:
    """What was read: tables by message name, every format declared, gaps, bytes in all, and trouble that is no gap."""

    tables: Mapping[str, MessageTable]
    formats: Mapping[str, Format]
    gaps: tuple[Gap, ...]
    size: int
    notes: tuple[str, ...] = ()


@dataclass
class _Reader:
    wanted: Mapping[str, tuple[str, ...] | None] | None
    formats: dict[int, Format] = field(default_factory=dict)
    columns: dict[int, dict[str, list[NDArray[Any]]]] = field(default_factory=dict)
    at: dict[int, list[NDArray[np.int64]]] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    unknown: dict[int, int] = field(default_factory=dict)
    lengths: NDArray[np.int64] = field(default_factory=lambda: np.zeros(256, dtype=np.int64))

    def __post_init__(self) -> None:
        self.lengths[_FMT_TYPE] = _FMT_BYTES

    def take(self, buffer: NDArray[np.uint8], base: int, final: bool) -> int:
        """Read the messages of a buffer that starts `base` bytes into the log; return how many bytes are done with."""
        hits = np.flatnonzero(buffer[:-2] == HEADER[0])
        hits = hits[buffer[hits + 1] == HEADER[1]]
        types = buffer[hits + 2]
        self._learn(buffer, hits[types == _FMT_TYPE])
        good, done = self._walk(hits, self.lengths[types], types, buffer, base, final)
        hits, types = hits[good], types[good]
        present = np.flatnonzero(np.bincount(types, minlength=256))
        for kind in present:
            format = self.formats.get(int(kind))
            if format is not None and self._needed(format.name):
                self._gather(format, buffer, hits[types == kind], base)
        return done

    def _needed(self, name: str) -> bool:
        return self.wanted is None or name in self.wanted

    def _learn(self, buffer: NDArray[np.uint8], hits: NDArray[np.int64]) -> None:
        for hit in hits:
            message = buffer[hit : hit + _FMT_BYTES].tobytes()
            format = parse_format(message) if len(message) == _FMT_BYTES else None
            if format is None:
                continue
            known = self.formats.get(format.type)
            if known is None:
                self.formats[format.type] = format
                self.lengths[format.type] = format.length
            elif known != format:
                self.notes.append(
                    f"message type {format.type} is declared twice, as {known.name} and as {format.name}; the first is used"
                )

    def _walk(
        self,
        hits: NDArray[np.int64],
        lengths: NDArray[np.int64],
        types: NDArray[np.uint8],
        buffer: NDArray[np.uint8],
        base: int,
        final: bool,
    ) -> tuple[NDArray[np.bool_], int]:
        """Which hits are messages, and the bytes done with. hits: (n,) where A3 95 stands."""
        n, size = hits.size, buffer.size
        good = np.zeros(n, dtype=bool)
        ends = hits + lengths
        follows = np.zeros(n, dtype=bool)
        follows[:-1] = (ends[:-1] == hits[1:]) & (lengths[:-1] > 0)
        breaks = np.flatnonzero(~follows)
        i, position = 0, 0
        while i < n:
            if hits[i] > position:
                self._lose(base + position, int(hits[i]) - position)
                position = int(hits[i])
            b = int(breaks[np.searchsorted(breaks, i)])
            good[i:b] = True
            position = int(hits[b])
            end = int(ends[b])
            if lengths[b] and end + _HEADER_BYTES > size and not final:
                return good, position
            k = int(np.searchsorted(hits, end)) if lengths[b] else b + 1
            confirmed = (k < n and hits[k] == end) or (final and end == size)
            if lengths[b] and confirmed:
                good[b] = True
                i, position = k, end
                continue
            i = b + 1
            following = int(hits[i]) if i < n else size
            if i >= n and not final:
                return good, position
            if not lengths[b]:
                self.unknown[int(types[b])] = self.unknown.get(int(types[b]), 0) + 1
            self._lose(base + position, following - position)
            position = following
        if final and position < size:
            self._lose(base + position, size - position)
            position = size
        if not final:
            # Bytes without a header: keep two, a header may straddle the border.
            keep = max(position, size - 2)
            if keep > position:
                self._lose(base + position, keep - position)
            return good, keep
        return good, position

    def _lose(self, offset: int, size: int) -> None:
        if self.gaps and self.gaps[-1].offset + self.gaps[-1].size == offset:
            self.gaps[-1] = Gap(self.gaps[-1].offset, self.gaps[-1].size + size)
        elif size > 0:
            self.gaps.append(Gap(offset, size))

    def _gather(self, format: Format, buffer: NDArray[np.uint8], hits: NDArray[np.int64], base: int) -> None:
        every = np.ndarray((buffer.size - format.length + 1,), f"V{format.length}", buffer, strides=(1,))
        rows = every[hits].view(format.dtype)
        names = self.wanted[format.name] if self.wanted is not None else None
        columns = self.columns.setdefault(format.type, {})
        for name in format.fields if names is None else names:
            if name in format.fields:
                columns.setdefault(name, []).append(np.ascontiguousarray(rows[name]))
        self.at.setdefault(format.type, []).append(hits + base)

    def table(self, kind: int) -> MessageTable:
        """The columns of one type put together; the pieces are freed."""
        pieces = self.columns.pop(kind)
        raw = {name: np.concatenate(pieces.pop(name)) for name in list(pieces)}
        return MessageTable(self.formats[kind], np.concatenate(self.at.pop(kind)), raw)


def read_dataflash(pieces: Iterable[bytes], wanted: Mapping[str, tuple[str, ...] | None] | None = None) -> Dataflash:
    """Read a log from its bytes.

    pieces: the log in order, cut anywhere. wanted: message name to the fields to keep (None: all of them); None reads everything.
    Never raises on bad bytes: what could not be read is in `gaps` and `notes`.
    """
    reader = _Reader(wanted)
    rest, base = b"", 0
    for piece in pieces:
        buffer = np.frombuffer(rest + piece if rest else piece, dtype=np.uint8)
        if buffer.size < _HEADER_BYTES:
            rest = buffer.tobytes()
            continue
        done = reader.take(buffer, base, final=False)
        rest = buffer[done:].tobytes()
        base += done
    last = np.frombuffer(rest, dtype=np.uint8)
    if last.size >= _HEADER_BYTES:
        reader.take(last, base, final=True)
    elif last.size:
        reader._lose(base, int(last.size))
    for kind, count in sorted(reader.unknown.items()):
        if count > 1:  # one is a chance pattern in lost bytes
            reader.notes.append(f"{count} messages of type {kind} could not be read: no FMT message declares it")
    tables: dict[str, MessageTable] = {}
    for kind in list(reader.columns):
        table = reader.table(kind)
        # Two types may carry one name (a script may declare a name anew); the larger is the one meant.
        if table.format.name not in tables or len(tables[table.format.name]) < len(table):
            tables[table.format.name] = table
    return Dataflash(
        tables=tables,
        formats={f.name: f for f in reader.formats.values()},
        gaps=tuple(reader.gaps),
        size=base + int(last.size),
        notes=tuple(reader.notes),
    )


def stack(table: MessageTable, *names: str) -> NDArray[np.float64]:
    """Several numeric fields side by side: (n, fields)."""
    return np.stack([table.get(name) for name in names], axis=-1)


def parse_format(message: bytes) -> Format | None:
    """The layout an FMT message declares; None where it contradicts itself (damaged, or not an FMT at all)."""
    kind, length = message[3], message[4]
    try:
        name = message[5:9].split(b"\0")[0].decode("ascii")
        codes = message[9:25].split(b"\0")[0].decode("ascii")
        labels = message[25:89].split(b"\0")[0].decode("ascii")
    except UnicodeDecodeError:
        return None
    fields = tuple(labels.split(",")) if labels else ()
    if not name.isalnum() or len(fields) < len(codes) or any(code not in _CODES for code in codes):
        return None
    fields = fields[: len(codes)]  # Copter 3.2 cuts long label lists short; never the other way round
    if len(set(fields)) != len(fields):
        return None
    offsets, position, types = [], _HEADER_BYTES, []
    for code in codes:
        dtype = np.dtype(_CODES[code][0])
        offsets.append(position)
        types.append(dtype)
        position += dtype.itemsize
    if position != length:
        return None
    layout = np.dtype({"names": list(fields), "formats": types, "offsets": offsets, "itemsize": length})
    return Format(kind, name, length, codes, fields, layout)


def _text(value: bytes) -> str:
    value = value.split(b"\0")[0]
    try:
        return value.decode("utf-8")
    except UnicodeDecodeError:
        return value.decode("latin-1")
