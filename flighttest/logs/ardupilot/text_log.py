"""Dataflash logs that were written out as text ("FMT, 128, 89, ..."): each line back to the message that it was made from."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator

import numpy as np
from pymavlink.mavutil import mode_mapping_acm

from flighttest.logs.ardupilot.dataflash import HEADER, Format, parse_format

_LINES = 10_000  # that are given at once
_MODES = {name: number for number, name in mode_mapping_acm.items()}


def messages(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """The log in its own format. pieces: of the text, in order, cut anywhere. Lines that are no message of a declared type are left out."""
    formats: dict[str, Format] = {}
    made: list[bytes] = []
    for line in _lines(pieces):
        message = _message(line, formats)
        if message is not None:
            made.append(message)
        if len(made) >= _LINES:
            yield b"".join(made)
            made.clear()
    yield b"".join(made)


def _lines(pieces: Iterable[bytes]) -> Iterator[str]:
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).split(b"\n")
        yield from (line.decode("utf-8", "replace").strip() for line in whole)
    yield rest.decode("utf-8", "replace").strip()


def _message(line: str, formats: dict[str, Format]) -> bytes | None:
    name, *values = line.split(", ")
    if name == "FMT" and len(values) >= 4:
        return _declared(values, formats)
    known = formats.get(name)
    if known is None:
        return None
    count = len(known.fields)
    if len(values) > count and known.dtype[count - 1].kind == "S":  # a comma in the text at the end
        values = [*values[: count - 1], ", ".join(values[count - 1 :])]
    if len(values) != count:
        return None
    try:
        body = b"".join(_packed(field, value, known) for field, value in zip(known.fields, values, strict=True))
    except (ValueError, KeyError, OverflowError):
        return None
    return HEADER + bytes([known.type]) + body


def _declared(values: list[str], formats: dict[str, Format]) -> bytes | None:
    """An FMT line: Type, Length, Name, Format, Columns, which may be divided by any comma."""
    kind, length, name, codes = values[:4]
    labels = ",".join(label.strip() for label in ",".join(values[4:]).split(","))
    try:
        message = HEADER + struct.pack(
            "<BBB4s16s64s", 128, int(kind), int(length), name.encode(), codes.encode(), labels.encode()
        )
    except (ValueError, struct.error):
        return None
    made = parse_format(message)
    if made is None:
        return None
    formats[made.name] = made
    return message


def _packed(field: str, value: str, known: Format) -> bytes:
    """One field as it is stored; text holds what it means."""
    kind, divisor = known.dtype[field], known.divisor(field)
    if kind.kind == "S":
        return value.encode()[: kind.itemsize].ljust(kind.itemsize, b"\0")
    if kind.kind == "f":
        return bytes(np.array(float(value), kind).tobytes())
    if not value.lstrip("+-")[:1].isdigit():
        number = _MODES[value.upper()]
    else:
        number = int(value) if divisor == 1.0 and value.lstrip("+-").isdigit() else round(float(value) * divisor)
    return int(number).to_bytes(kind.itemsize, "little", signed=kind.kind == "i")
