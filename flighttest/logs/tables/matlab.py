"""MATLAB files (.mat up to version 7, by scipy.io): vectors, structures of vectors, timeseries and Simulink's logged structures."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.io
import scipy.io.matlab
from numpy.typing import NDArray

from flighttest.channels import CHANNELS
from flighttest.datafiles import MOST_VALUES
from flighttest.errors import RecordingError
from flighttest.logs.opening import LogFile
from flighttest.logs.tables.matlab_elements import check_elements
from flighttest.logs.tables.sheet import TIME, Sheet, joined

FloatArray = NDArray[np.float64]
HDF5 = b"MATLAB 7.3"
TIMES = (
    TIME,
    "t",
    "time",
    "Time",
    "tout",
    "timestamp",
)  # names of a time vector; in seconds, unless a column map states another unit
_SAVE = "save it in MATLAB by save(name, '-v7')"
MatlabTable = tuple[str, FloatArray | None, dict[str, FloatArray]]


def read_matlab(file: LogFile, data: bytes) -> Sheet:
    """The file's vectors as columns, named by their path (`log.roll`); RecordingError where it holds none that belong to a time."""
    if data[:10] == HDF5 or data[:8] == b"\x89HDF\r\n\x1a\n":
        raise RecordingError(f"{file.path}: this is a MATLAB file of version 7.3", _SAVE)
    try:
        check_elements(data)
        content = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    except (
        ValueError,
        TypeError,
        OSError,
        EOFError,
        KeyError,
        IndexError,
        MemoryError,
        struct.error,
        zlib.error,
        NotImplementedError,
        scipy.io.matlab.MatReadError,
    ) as error:
        raise RecordingError(f"{file.path}: this MATLAB file is damaged: {error}", "copy the file anew") from error
    losses = list(file.losses)
    tables = list(_tables("", {k: v for k, v in content.items() if not k.startswith("__")}))
    if sum(v.size for _, _, columns in tables for v in columns.values()) > MOST_VALUES:
        raise RecordingError(
            f"{file.path}: it holds more than {MOST_VALUES} numbers", "keep the signals and times of a flight"
        )
    tables = [(path, t, _bare(columns)) for path, t, columns in tables]
    timed = [(t, columns) for _, t, columns in tables if t is not None and columns]
    unread = _of_other_length("", content, {t.size for t, _ in timed})
    if len(timed) == 1:
        t, columns = timed[0]
        return Sheet(str(file.path), {TIME: t, **columns}, losses, unread=unread)
    if timed:
        return Sheet(str(file.path), joined(timed), losses, unread=unread)
    loose: dict[int, dict[str, FloatArray]] = {}
    for _, _, columns in tables:
        for name, vector in columns.items():
            loose.setdefault(vector.size, {})[name] = vector
    if not loose:
        raise RecordingError(f"{file.path}: it holds no vectors of numbers", "name a file with logged signals")
    chosen = max(loose.values(), key=len)
    unread = _of_other_length("", content, {v.size for v in chosen.values()})
    return Sheet(str(file.path), chosen, losses, unread=unread)


def _bare(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Columns whose last word is a channel under that word alone."""
    ends = [name.rpartition(".")[2] for name in columns]
    return {
        end if end in CHANNELS and ends.count(end) == 1 else name: values
        for (name, values), end in zip(columns.items(), ends, strict=True)
    }


def _tables(path: str, content: dict[str, Any], outer: FloatArray | None = None) -> Iterator[MatlabTable]:
    """Every structure that holds vectors as (path, its time, its columns of the time's length), with those of inner structures that have no
    time of their own, at any depth; inner structures with one after it. outer: time (n,) of the structure around it."""
    if path and isinstance(signal := _timeseries(path, content), tuple):
        yield signal
        return
    vectors = {name: vector for name, value in content.items() if (vector := _numbers(value)) is not None}
    time = next((np.ravel(vectors[n]) for n in TIMES if n in vectors and np.ravel(vectors[n]).size > 1), None)
    lengths = [v.shape[0] for v in vectors.values()]
    if time is None and outer is not None and (not vectors or outer.size in lengths):
        time = outer
    length = time.size if time is not None else max(set(lengths), key=lengths.count, default=0)
    columns: dict[str, FloatArray] = {}
    for name, vector in vectors.items():
        if vector.shape[0] != length or length < 2 or (time is not None and name == TIME):
            continue
        named = f"{path}.{name}" if path else name
        columns |= {named: vector} if vector.ndim == 1 else _cells(named, vector)
    others: list[MatlabTable] = []
    for name, value in content.items():
        for inner, one in _structures(value):
            for table in _tables(f"{path}.{name}{inner}" if path else f"{name}{inner}", one, time):
                if time is not None and table[1] is time:
                    columns |= table[2]
                else:
                    others.append(table)
    if columns or (time is not None and time is not outer):
        yield path, time, columns
    yield from others


def _of_other_length(path: str, content: dict[str, Any], lengths: set[int]) -> dict[str, str]:
    """Every vector that has none of these lengths, by its path, with the reason why it is not read."""
    found: dict[str, str] = {}
    for name, value in content.items():
        named = f"{path}.{name}" if path else name
        if (vector := _numbers(value)) is not None and not set(vector.shape) & lengths:
            rows = " or ".join(str(n) for n in sorted(lengths))
            found[named] = f"it has {vector.shape[0]} values, where the times have {rows}"
        for inner, one in _structures(value):
            found |= _of_other_length(f"{named}{inner}", one, lengths)
    return found


def _timeseries(path: str, content: dict[str, Any]) -> MatlabTable | None:
    """A timeseries saved as a structure (Time, Data), or Simulink's structure with time (time, signals.values)."""
    lower = {name.lower(): value for name, value in content.items()}
    time = _numbers(lower.get("time"))
    if time is None or time.ndim != 1:
        return None
    if (data := _numbers(lower.get("data"))) is not None and data.shape[0] == time.size:
        return path, time, {path: data} if data.ndim == 1 else _cells(path, data)
    columns: dict[str, FloatArray] = {}
    for _, signal in _structures(lower.get("signals")):
        values = _numbers(signal.get("values"))
        if values is not None and values.shape[0] == time.size:
            label = str(signal.get("label") or signal.get("blockName") or "")
            named = f"{path}.{label}" if label and label != "[]" else path
            columns |= {named: values} if values.ndim == 1 else _cells(named, values)
    return (path, time, columns) if columns else None


def _structures(value: Any) -> list[tuple[str, dict[str, Any]]]:
    if isinstance(value, dict):
        return [("", value)]
    if isinstance(value, list | np.ndarray) and len(value) and all(isinstance(one, dict) for one in value):
        return [(f"[{i}]", one) for i, one in enumerate(value)]
    return []


def _numbers(value: Any) -> FloatArray | None:
    """A vector (n,), or a matrix (n, k) of few columns, as floats; None for anything else."""
    if (
        not isinstance(value, np.ndarray)
        or value.dtype.kind not in "fiub"
        or value.ndim not in (1, 2)
        or value.size < 2
    ):
        return None
    if value.ndim == 2 and value.shape[0] < value.shape[1]:
        value = value.T
    return np.asarray(value, dtype=float)


def _cells(name: str, matrix: FloatArray) -> dict[str, FloatArray]:
    return {f"{name}[{i}]": matrix[:, i] for i in range(matrix.shape[1])}
