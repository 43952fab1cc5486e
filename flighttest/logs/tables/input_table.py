"""Static input maps of a column map: what a motor command gives, as pairs or as a thrust stand's measurements.

    throttle: {mean: [m1, m2, m3, m4], table: [[0, 0], [20000, 0.2], [65535, 1]]}
    throttle: {mean: [m1, m2, m3, m4], table: {file: stand.csv, input: "ESC signal (us)", output: "Thrust (N)"}}

Thrusts add up over the motors, and are no linear function of their commands: each column is mapped before the mean is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flighttest.documents import Node, YamlDocument
from flighttest.errors import FlighttestError

FloatArray = NDArray[np.float64]

LEVELS = 40  # of a stand's measurements: a map of more follows their noise
_FILE_KEYS = ("file", "input", "output")


@dataclass(frozen=True)
class InputTable:
    """Pairs of input, increasing, and output; linear between them, held beyond them."""

    inputs: tuple[float, ...]
    outputs: tuple[float, ...]

    def of(self, values: FloatArray) -> FloatArray:
        """Outputs of inputs (n,)."""
        found = np.interp(values, self.inputs, self.outputs)
        return np.asarray(np.where(np.isfinite(values), found, np.nan))


def parse_table(document: YamlDocument, node: Node, file: str) -> InputTable | None:
    """A table as it stands in a column map; None with its problems noted."""
    if isinstance(node.value, dict):
        return _from_file(document, node, Path(file).parent)
    pairs = [document.vector(pair, 2, -1e12, 1e12) for pair in document.items(node, "pairs [input, output]")]
    if any(p is None for p in pairs):
        return None
    known = [p for p in pairs if p is not None]
    if len(known) < 2 or any(b[0] <= a[0] for a, b in pairwise(known)):
        document.wrong(node, "a table needs two pairs or more, their inputs increasing", "write [[input, output], ...]")
        return None
    return InputTable(tuple(p[0] for p in known), tuple(p[1] for p in known))


def _from_file(document: YamlDocument, node: Node, folder: Path) -> InputTable | None:
    from flighttest.logs.opening import LogFile
    from flighttest.logs.tables.reading import read_sheet

    fields: Mapping[str, Node] = document.mapping(node, _FILE_KEYS)
    missing = [k for k in _FILE_KEYS if k not in fields]
    if missing:
        document.wrong(
            node, f"{', '.join(missing)} is missing", "write {file: stand.csv, input: column, output: column}"
        )
        return None
    name, first, second = (document.text(fields[k], 300) for k in _FILE_KEYS)
    if name is None or first is None or second is None:
        return None
    try:
        sheet = read_sheet(LogFile(folder / name))
        measured = np.stack([sheet.column(first), sheet.column(second)], axis=1)
    except FlighttestError as error:
        document.wrong(node, error.message, error.hint)
        return None
    made = levels(measured)
    if made is None:
        document.wrong(node, f"{first} takes fewer than two values", "name the column of commands as input")
    return made


def levels(measured: FloatArray) -> InputTable | None:
    """Means of measurements (n, 2), input and output, over `LEVELS` quantiles of the input; None where the input takes one value."""
    known = measured[np.isfinite(measured).all(axis=1)]
    if not len(known):
        return None
    known = known[np.argsort(known[:, 0], kind="stable")]
    bounds = np.unique(np.quantile(known[:, 0], np.linspace(0.0, 1.0, LEVELS + 1)))
    which = np.clip(np.searchsorted(bounds, known[:, 0], side="right") - 1, 0, max(bounds.size - 1, 0))
    count = np.bincount(which)
    determined = count > 0
    inputs, outputs = (np.bincount(which, known[:, k])[determined] / count[determined] for k in (0, 1))
    return InputTable(tuple(inputs.tolist()), tuple(outputs.tolist())) if inputs.size > 1 else None
