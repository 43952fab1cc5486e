"""The data elements of a MATLAB file (version 5 to 7), walked before scipy.io reads them: its compiled reader follows a damaged tag out of
its tables and ends the whole process (bus error, division by zero).

Source: MathWorks, "MAT-File Format", level 5.
"""

from __future__ import annotations

import math
import struct
import zlib

from flighttest.datafiles import MOST_VALUES
from flighttest.logs.opening import UNPACKED_BYTES, UNPACKED_TIMES

_HEADER_BYTES = 128
_INT8, _UINT8, _INT32, _UINT32, _UTF8, _MATRIX, _COMPRESSED = 1, 2, 5, 6, 16, 14, 15
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
_TEXTS = _NUMBERS | {16, 17, 18}
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_ARRAYS = range(6, 16)
_DIMENSIONS_MAX = 32
_DEPTH_MAX = 40
_COMPLEX = 1 << 11


def check_elements(data: bytes) -> None:
    """Raise ValueError, with the byte, where an element of a version 5 file is not what the format allows."""
    if len(data) < _HEADER_BYTES or 0 in data[:4]:
        return  # version 4, or no MATLAB file: read without compiled code
    order = "<" if data[126:128] == b"IM" else ">"
    at = _HEADER_BYTES
    allowed = max(UNPACKED_BYTES, UNPACKED_TIMES * len(data))
    while at < len(data):
        if len(data) - at < 8:
            raise ValueError(f"it breaks off in the tag at byte {at}")
        kind, size = struct.unpack_from(order + "II", data, at)
        begin, end = at + 8, at + 8 + size
        if size == 0 or end > len(data):
            raise ValueError(f"the element at byte {at} has {size} bytes")
        if kind == _COMPRESSED:
            unpacker = zlib.decompressobj()
            inner = unpacker.decompress(data[begin:end], allowed)
            allowed -= len(inner)
            if unpacker.unconsumed_tail or not unpacker.eof:
                raise ValueError(f"the compressed element at byte {at} is cut off, or too large")
            _Elements(inner, order).matrix(0, len(inner), 0)
        else:
            _Elements(data, order).matrix(at, end, 0)
        at = end


class _Elements:
    """Elements of one piece of data."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data = data
        self._order = order

    def _tag(self, at: int, end: int) -> tuple[int, int, int, int]:
        """Of the element at a byte: its type, where its data begin, how many bytes, and where the next element begins."""
        if end - at < 8:
            raise ValueError(f"an element is missing at byte {at}")
        kind, size = struct.unpack_from(self._order + "II", self._data, at)
        if kind >> 16:
            kind, size, begin, following = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if size > 4:
                raise ValueError(f"the short element at byte {at} has {size} bytes")
        else:
            begin = at + 8
            following = begin + (size + 7) // 8 * 8
        if begin + size > end:
            raise ValueError(f"the element at byte {at} is longer than what it belongs to")
        return kind, begin, size, min(following, end)

    def _expect(self, at: int, end: int, kinds: frozenset[int] | set[int], what: str) -> tuple[int, int, int]:
        kind, begin, size, following = self._tag(at, end)
        if kind not in kinds:
            raise ValueError(f"{what} at byte {at} has the type {kind}")
        return begin, size, following

    def _integers(self, begin: int, size: int) -> tuple[int, ...]:
        return struct.unpack_from(f"{self._order}{size // 4}i", self._data, begin)

    def matrix(self, at: int, end: int, depth: int) -> int:
        """An array with all that is inside it; where the next element begins."""
        begin, size, following = self._expect(at, end, {_MATRIX}, "the array")
        if size == 0:
            return following
        if depth > _DEPTH_MAX:
            raise ValueError(f"arrays inside arrays, {_DEPTH_MAX} deep, at byte {at}")
        end = begin + size
        flags_at, flags_size, inside = self._expect(begin, end, {_UINT32, _INT32}, "the flags of an array")
        if flags_size != 8 or flags_at != begin + 8:
            raise ValueError(f"the flags of the array at byte {at} have {flags_size} bytes")
        (flags,) = struct.unpack_from(self._order + "I", self._data, flags_at)
        form = flags & 0xFF
        if form == _OPAQUE:
            for _ in range(3):
                _, _, inside = self._expect(inside, end, {_INT8, _UINT8, _UTF8}, "a name")
            self.matrix(inside, end, depth + 1)
            return following
        count, inside = self._count(inside, end)
        _, _, inside = self._expect(inside, end, {_INT8, _UINT8, _UTF8}, "the name of an array")
        self._content(form, count, bool(flags & _COMPLEX), inside, end, depth)
        return following

    def _count(self, at: int, end: int) -> tuple[int, int]:
        """How many cells an array has, by its dimensions; where the next element begins."""
        begin, size, following = self._expect(at, end, {_INT32, _UINT32}, "the dimensions of an array")
        dimensions = self._integers(begin, size)
        if size % 4 or not 2 <= len(dimensions) <= _DIMENSIONS_MAX or min(dimensions) < 0:
            raise ValueError(f"the array at byte {at} has the dimensions {dimensions[:4]}")
        count = math.prod(dimensions)
        if count > MOST_VALUES:
            raise ValueError(f"the array at byte {at} has {count} cells, more than {MOST_VALUES}")
        return count, following

    def _content(self, form: int, count: int, complex_values: bool, at: int, end: int, depth: int) -> None:
        """What follows the name of an array."""
        if form in (_CELL, _FUNCTION):
            for _ in range(count if form == _CELL else 1):
                at = self.matrix(at, end, depth + 1)
        elif form in (_STRUCT, _OBJECT):
            if form == _OBJECT:
                _, _, at = self._expect(at, end, {_INT8, _UINT8, _UTF8}, "the name of a class")
            begin, size, at = self._expect(at, end, {_INT32, _UINT32}, "the length of field names")
            (length,) = self._integers(begin, size) if size == 4 else (0,)
            _, size, at = self._expect(at, end, {_INT8, _UINT8, _UTF8}, "the field names")
            if length <= 0 or size % length:
                raise ValueError(f"the field names before byte {at} are {length} long")
            for _ in range(count * (size // length)):
                at = self.matrix(at, end, depth + 1)
        elif form == _CHAR:
            self._expect(at, end, _TEXTS, "text")
        elif form == _SPARSE:
            for _ in range(3 + complex_values):
                _, _, at = self._expect(at, end, _NUMBERS, "a part of a sparse array")
        elif form in _ARRAYS:
            for _ in range(1 + complex_values):
                _, _, at = self._expect(at, end, _NUMBERS, "numbers")
        else:
            raise ValueError(f"an array has the class {form}")
