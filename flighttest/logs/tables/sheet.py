"""A table of any origin: named columns of numbers, or of vectors whose cells have names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from flighttest.datafiles import parse_json
from flighttest.documents import nearest
from flighttest.errors import RecordingError

FloatArray = NDArray[np.float64]

_OTHER_LENGTH = "save it with the times of its own samples, as a timeseries or in a structure with its time"
TIME = "t_s"  # the column of times, where a table has one in seconds
_CELL = re.compile(r"^(?P<name>.*?)(?P<indices>(\[\d+\])*)$")
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d")


def cell_of(name: str) -> tuple[str, tuple[int, ...]]:
    """Column and indices of `v[0]` or `R[2][1]`; no indices for a plain column."""
    match = _CELL.match(name)
    assert match is not None  # the pattern matches every text
    return match["name"], tuple(int(i) for i in re.findall(r"\[(\d+)\]", match["indices"]))


Column = NDArray[Any] | pd.Series  # as read: numbers, or text


@dataclass
class Sheet:
    """A table: column name to raw values (numbers, or text as read). losses: what could not be read. crazyflie: the columns are
    the log variables of a Crazyflie. unread: what the file holds beside it under these names, and why it is no column."""

    path: str
    raw: Mapping[str, Column]
    losses: list[str] = field(default_factory=list)
    crazyflie: bool = False
    unread: Mapping[str, str] = field(default_factory=dict)
    _cells: dict[str, list[Any]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Column names in the table's order."""
        return tuple(self.raw)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.raw.values()))) if self.raw else 0

    def column(self, name: str) -> FloatArray:
        """(n,) numbers of a column, or of one cell of a vector column as `v[0]`; RecordingError where it is not there."""
        if name in self.raw:
            return self._numbers(name)
        column, indices = cell_of(name)
        if column not in self.raw and column in self.unread:
            raise RecordingError(f"{self.path}: {column!r} is no column: {self.unread[column]}", _OTHER_LENGTH)
        if column not in self.raw or not indices:
            guess = nearest(name, self.raw)
            hint = f"did you mean {guess!r}?" if guess else f"it has {', '.join(list(self.raw)[:30])}"
            raise RecordingError(f"{self.path}: there is no column {name!r}", hint)
        return self._cell(column, indices, name)

    def _numbers(self, name: str) -> FloatArray:
        series = self.raw[name]
        if isinstance(series, np.ndarray):
            return np.asarray(series, dtype=float)
        moments = _moments(series)
        if moments is not None:
            return moments
        numbers = pd.to_numeric(series, errors="coerce")
        bad = int((numbers.isna() & series.notna()).sum())
        if bad == len(series) and bad and str(series.iloc[0]).strip().startswith("["):
            raise RecordingError(
                f"{self.path}: column {name!r} holds vectors", f"name one cell of it, such as {name}[0]"
            )
        if bad and bad == int(series.notna().sum()):
            raise RecordingError(f"{self.path}: column {name!r} holds no numbers, but {str(series.iloc[0])[:30]!r}")
        if bad:
            row = int(np.flatnonzero((numbers.isna() & series.notna()).to_numpy())[0])
            self._lose(
                f"column {name!r}: {bad} of {len(series)} values are no numbers (the first in data row {row + 1})"
            )
        return np.asarray(numbers.to_numpy(dtype=float))

    def _cell(self, column: str, indices: tuple[int, ...], name: str) -> FloatArray:
        if column not in self._cells:
            self._cells[column] = [_vector(v) for v in self.raw[column]]
        out = np.full(self.rows, np.nan)
        bad = 0
        for i, vector in enumerate(self._cells[column]):
            value: Any = vector
            try:
                for index in indices:
                    value = value[index]
                out[i] = float(value)
            except (TypeError, IndexError, ValueError):
                bad += 1
        if bad == self.rows:
            raise RecordingError(f"{self.path}: column {column!r} has no cell {name!r}", "count cells from 0")
        if bad:
            self._lose(f"column {name!r}: {bad} of {self.rows} cells are missing")
        return out

    def _lose(self, sentence: str) -> None:
        if sentence not in self.losses:
            self.losses.append(sentence)


def _moments(series: Any) -> FloatArray | None:
    """Dates, and times as text in ISO 8601, as seconds since the first (n,); None for anything else."""
    if series.dtype.kind == "m":
        return np.asarray(series.dt.total_seconds(), dtype=float)
    if series.dtype.kind != "M":
        known = series.dropna()
        if not len(known) or not _DATE.match(str(known.iloc[0])):
            return None
        series = pd.to_datetime(series, format="ISO8601", errors="coerce", utc=True)
    return np.asarray((series - series.min()).dt.total_seconds(), dtype=float)


def _vector(value: Any) -> Any:
    if isinstance(value, str):
        try:
            return parse_json(value)
        except ValueError:
            words = value.strip().strip("[]()").replace(",", " ").split()
            try:
                return [float(word) for word in words]
            except ValueError:
                return None
    return value


def joined(tables: Sequence[tuple[FloatArray, Mapping[str, FloatArray]]]) -> dict[str, FloatArray]:
    """Columns of all tables, each (t_s (n,), name to (n,)), under `t_s`; times that are not finite are left out."""
    every = np.unique(np.concatenate([t[np.isfinite(t)] for t, _ in tables]))
    raw: dict[str, FloatArray] = {TIME: every}
    for t, columns in tables:
        known = np.isfinite(t)
        at = np.searchsorted(every, t[known])
        for name, values in columns.items():
            column = np.full(every.size, np.nan)
            column[at] = values[known]
            raw[name] = column
    return raw
