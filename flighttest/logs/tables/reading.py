"""Tables of any origin as named columns of numbers: CSV and similar text, Parquet, MATLAB's files, Crazyflie's µSD log."""

from __future__ import annotations

import io
import re
import struct
import warnings
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet
from numpy.typing import NDArray

from flighttest.datafiles import MOST_VALUES
from flighttest.errors import RecordingError
from flighttest.logs.opening import KINDS, LogFile
from flighttest.logs.tables.sheet import Sheet

CRAZYFLIE_MAGIC = 0xBC
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def read_sheet(file: LogFile) -> Sheet:
    """Read a table; RecordingError where it is none."""
    data = b"".join(file.pieces())
    if data[:4] == b"PAR1":
        return _parquet(file, data)
    if file.suffix == ".mat" or data[:6] == b"MATLAB":
        from flighttest.logs.tables.matlab import read_matlab

        return read_matlab(file, data)
    if data[:1] == bytes([CRAZYFLIE_MAGIC]):
        return _crazyflie(file, data)
    return _text(file, data)


def _parquet(file: LogFile, data: bytes) -> Sheet:
    try:
        parquet = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(data))
        if parquet.metadata.num_rows * parquet.metadata.num_columns > MOST_VALUES:
            raise RecordingError(
                f"{file.path}: its header states {parquet.metadata.num_rows} rows",
                "keep the columns and times of a flight",
            )
        frame = parquet.read().to_pandas(ignore_metadata=True)
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise RecordingError(f"{file.path}: this Parquet file is damaged: {error}", "copy the file anew") from error
    return _sheet(file, frame)


def _text(file: LogFile, data: bytes) -> Sheet:
    try:
        text = data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    text, zeroed = _without_zeros(file, text)
    lines = [line for line in text[:20000].splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 2:
        raise RecordingError(
            f"{file.path}: the table has no rows", "it needs a line of column names and lines of values"
        )
    separator = _separator(lines)
    names = _commented_names(text, lines[0], separator)
    unnamed = names is None and _is_unnamed(lines[0], separator)
    if unnamed:
        names = [f"c{k + 1}" for k in range(len(_cells(lines[0], separator)))]
    # Where commas separate nothing, and no number has a point, they are what others write as a point.
    values = "\n".join(lines if names else lines[1:])
    comma = separator != "," and re.search(r"\d,\d", values) and not re.search(r"\d\.\d", values)
    skipped: list[int] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", pd.errors.ParserWarning)
            frame = pd.read_csv(
                io.StringIO(text), sep=r"\s+" if separator == " " else separator, comment="#", skipinitialspace=True,
                on_bad_lines="warn", low_memory=False, index_col=False, skip_blank_lines=True, decimal="," if comma else ".",
                names=names, header=None if names else 0,
            )  # fmt: skip
        skipped = [int(n) for one in caught for n in re.findall(r"Skipping line (\d+)", str(one.message))]
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError, OverflowError) as error:
        raise RecordingError(
            f"{file.path}: this is not a table: {error}", "see docs/formats.md for plain tables"
        ) from error
    sheet = _sheet(file, frame)
    if unnamed and names:
        sheet.losses.append(f"the table has no line of names: its columns are called c1 to {names[-1]}, in their order")
    if zeroed:
        sheet.losses.append(f"{zeroed} lines hold zero bytes (a card that lost power?) and were left out")
    if skipped:
        sheet.losses.append(
            f"{len(skipped)} lines have too many values and were left out (the first is line {skipped[0]})"
        )
    return sheet


def _separator(lines: Sequence[str]) -> str:
    """What stands between the values of a row; a blank where nothing else does, and two rows have as many words."""
    found = max(",;\t", key=lambda mark: lines[0].count(mark))
    words = [len(line.split()) for line in lines[:2]]
    return " " if found not in lines[0] and words[0] == words[1] > 1 else found


def _cells(line: str, separator: str) -> list[str]:
    return line.split() if separator == " " else [value.strip() for value in line.split(separator)]


def _commented_names(text: str, first: str, separator: str) -> list[str] | None:
    """Column names of a table that has them in the comment above its numbers, as numpy.savetxt writes them; None where it has not."""
    above = [line for line in text[: text.find(first)].splitlines() if line.startswith("#")]
    if not above or not all(_NUMBER.fullmatch(value) for value in _cells(first, separator)):
        return None
    names = _cells(above[-1].lstrip("#"), separator)
    return names if len(names) == len(_cells(first, separator)) > 1 else None


def _is_unnamed(first: str, separator: str) -> bool:
    """Whether the first row is one of values: numbers that do not count the columns, as what writes tables without names does."""
    cells = _cells(first, separator)
    if len(cells) < 2 or not all(_NUMBER.fullmatch(cell) for cell in cells):
        return False
    return not any(cells == [str(k + start) for k in range(len(cells))] for start in (0, 1))


def _without_zeros(file: LogFile, text: str) -> tuple[str, int]:
    """The text without lines that hold zero bytes, and how many; RecordingError where those are most of it."""
    if "\0" not in text:
        return text, 0
    lines = text.splitlines()
    good = [line for line in lines if "\0" not in line]
    if len(good) < 0.5 * len(lines) or "\0" in lines[0]:
        raise RecordingError(
            f"{file.path}: this is not a text table",
            f"give a {KINDS} file",
        )
    return "\n".join(good), len(lines) - len(good)


def _sheet(file: LogFile, frame: pd.DataFrame) -> Sheet:
    frame.columns = [str(name).strip() for name in frame.columns]
    if frame.columns.has_duplicates:
        twice = frame.columns[frame.columns.duplicated()][0]
        raise RecordingError(f"{file.path}: column {twice!r} is there twice", "rename one of them")
    if not len(frame):
        raise RecordingError(
            f"{file.path}: the table has no rows", "it needs a line of column names and lines of values"
        )
    return Sheet(str(file.path), {str(name): frame[name] for name in frame.columns}, list(file.losses))


def _crazyflie(file: LogFile, data: bytes) -> Sheet:
    """Crazyflie's µSD log (cfusdlog, versions 1 and 2): the fixed-frequency block. Column `timestamp` in ms."""
    try:
        return _crazyflie_blocks(file, data)
    except (struct.error, UnicodeDecodeError, IndexError, KeyError, ValueError) as error:
        raise RecordingError(
            f"{file.path}: this Crazyflie log is damaged in its header: {error}", "copy it anew"
        ) from error


_FIXED = 0xFFFF
_CRC_BYTES = 4
_CRAZYFLIE_TYPES = {
    "b": "i1",
    "B": "u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "f": "<f4",
    "d": "<f8",
    "?": "?",
}


def _crazyflie_blocks(file: LogFile, data: bytes) -> Sheet:
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in (1, 2):
        raise ValueError(f"version {version} is not known")
    stamp, stamp_ms = ("<u4", 1.0) if version == 1 else ("<u8", 1e-3)
    at = 5
    layouts: dict[int, np.dtype[Any]] = {}
    for _ in range(count):
        (event,) = struct.unpack_from("<H", data, at)
        end = data.index(b"\0", at + 2)
        (variables,) = struct.unpack_from("<H", data, end + 1)
        at = end + 3
        fields: list[tuple[str, str]] = [("event", "<u2"), ("stamp", stamp)]
        for _ in range(variables):
            end = data.index(b"\0", at)
            name = data[at:end].decode("ascii")
            fields.append((name[:-3], _CRAZYFLIE_TYPES[name[-2]]))
            at = end + 1
        layouts[event] = np.dtype(fields)
    fixed = layouts[_FIXED]
    rows: list[NDArray[Any]] = []
    lost = 0
    while at + 2 <= len(data):
        event = int.from_bytes(data[at : at + 2], "little")
        layout = layouts.get(event)
        if layout is None or at + layout.itemsize > len(data):
            lost = len(data) - at
            break
        if event != _FIXED:
            at += layout.itemsize
            continue
        block = np.frombuffer(data, fixed, (len(data) - at) // fixed.itemsize, at)
        other = np.flatnonzero(block["event"] != _FIXED)
        run = block[: other[0]] if other.size else block
        rows.append(run)
        at += run.size * fixed.itemsize
    if not rows:
        raise ValueError("it holds no samples")
    table = np.concatenate(rows)
    raw: dict[str, Any] = {"timestamp": table["stamp"].astype(float) * stamp_ms}
    raw.update({name: table[name].astype(float) for name in (fixed.names or ())[2:]})
    losses = list(file.losses)
    checked = lost == _CRC_BYTES and zlib.crc32(data[:-_CRC_BYTES]) == int.from_bytes(data[-_CRC_BYTES:], "little")
    if lost == _CRC_BYTES and not checked:
        losses.append("the checksum at the end of the log does not fit: some of its values are damaged")
    elif lost and not checked:
        losses.append(f"the last {lost} of {len(data)} bytes could not be read")
    return Sheet(str(file.path), raw, losses, crazyflie=True)
