"""Column maps (columns/1): how the columns of a foreign table become channels. Read from YAML, all problems at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

from flighttest.channels import CHANNELS, GROUPS
from flighttest.datafiles import read_text
from flighttest.documents import Form, Node, YamlDocument, nearest, read_form
from flighttest.errors import RecordingError
from flighttest.logs.tables.input_table import InputTable, parse_table
from flighttest.logs.tables.sheet import TIME

World = Literal["NWU", "NED", "ENU"]
Body = Literal["FLU", "FRD"]

_DEG = 0.017453292519943295
# Unit of the channel to the units people write, and their size in it.
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "deg": _DEG, "mrad": 1e-3, "cdeg": 0.01 * _DEG},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3},
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0, "g": 9.80665, "mg": 9.80665e-3, "cm/s^2": 0.01},
    "m/s": {"m/s": 1.0, "cm/s": 0.01, "mm/s": 1e-3, "km/h": 1 / 3.6, "kn": 1852.0 / 3600.0, "ft/s": 0.3048},
    "m": {"m": 1.0, "cm": 0.01, "mm": 1e-3, "ft": 0.3048},
    "V": {"V": 1.0, "mV": 1e-3, "cV": 0.01},
    "A": {"A": 1.0, "mA": 1e-3, "cA": 0.01},
    "1": {"1": 1.0, "%": 0.01},
}  # fmt: skip
STEP = "step"
_QUATERNIONS = ("attitude", "reference")
_ENTRY = ("from", "unit", "mean", "power", "table", "scale", "offset", "quaternion")
_KEYS = ("format", "doc", "frame", "rate_hz", "columns", "constants", "filters_hz")


@dataclass(frozen=True)
class ColumnSource:
    """Where one channel comes from: the mean of `columns`, each to the `power` and through the `table` first, times scale, plus offset.
    A column may be a cell of a vector column, as `v[0]`."""

    columns: tuple[str, ...]
    scale: float = 1.0
    offset: float = 0.0
    power: float = 1.0
    table: InputTable | None = None


@dataclass(frozen=True)
class ColumnMap:
    """Channel name (or t_s, step) to its source; quaternions (attitude, reference) to four columns in the order w, x, y, z;
    frames of the table; constants and filters (channel group to Hz) as given. `file` names the map in messages."""

    columns: Mapping[str, ColumnSource]
    quaternions: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    world: World = "NWU"
    body: Body = "FLU"
    rate_hz: float | None = None
    constants: Mapping[str, float] = field(default_factory=dict)
    filters_hz: Mapping[str, float] = field(default_factory=dict)
    file: str = ""


def load_columns(path: Path | str) -> ColumnMap:
    """Read a column map. RecordingError lists everything wrong with it."""
    path = Path(path)
    return parse_columns(read_text(path, RecordingError, "column map"), str(path))


def parse_columns(text: str, file: str = "columns.yaml") -> ColumnMap:
    """`load_columns` for text."""
    return read_form(text, file, Form("columns", _KEYS, RecordingError), _column_map)


def _column_map(document: YamlDocument, fields: Mapping[str, Node]) -> ColumnMap:
    columns, quaternions = _columns(document, fields["columns"]) if "columns" in fields else ({}, {})
    if not columns and not quaternions and not document.problems:
        document.problem(
            document.line, "columns", "the map names no column", "add `columns:` with channel: {from: ...}"
        )
    world, body = _frame(document, fields)
    rate = document.number(fields["rate_hz"], 0.1, 1e5, "Hz") if "rate_hz" in fields else None
    constants = _numbers(document, fields.get("constants"), tuple(CHANNELS))
    filters = _numbers(document, fields.get("filters_hz"), GROUPS, 0.1)
    for name in sorted(constants.keys() & columns.keys()):
        document.problem(
            fields["constants"].line, f"constants.{name}", "the channel has a column already", "take one of the two out"
        )
    return ColumnMap(
        columns, quaternions, cast(World, world), cast(Body, body), rate, constants, filters, document.file
    )


def plain_map(names: tuple[str, ...]) -> ColumnMap:
    """The map of a table whose columns already carry the channels' names; what has no such name is left out."""
    known = [n for n in names if n in CHANNELS or n in (TIME, STEP)]
    return ColumnMap({name: ColumnSource((name,)) for name in known})


def _frame(document: YamlDocument, fields: Mapping[str, Node]) -> tuple[str, str]:
    if "frame" not in fields:
        return "NWU", "FLU"
    frame = document.mapping(fields["frame"], ("world", "body"))
    world = document.choice(frame["world"], ("NWU", "NED", "ENU")) if "world" in frame else "NWU"
    body = document.choice(frame["body"], ("FLU", "FRD")) if "body" in frame else "FLU"
    return world or "NWU", body or "FLU"


def _columns(document: YamlDocument, node: Node) -> tuple[dict[str, ColumnSource], dict[str, tuple[str, ...]]]:
    sources: dict[str, ColumnSource] = {}
    quaternions: dict[str, tuple[str, ...]] = {}
    names = (TIME, STEP, *CHANNELS, *_QUATERNIONS)
    for name, entry in document.mapping(node, names, "channel").items():
        if isinstance(entry.value, str):  # the short form, `roll_rad: roll`
            sources[name] = ColumnSource((entry.value,))
            continue
        keys = document.mapping(entry, _ENTRY)
        if not keys:
            if isinstance(entry.value, dict) and not entry.value:
                document.wrong(entry, "the entry is empty", "write {from: column}")
            continue
        if name in _QUATERNIONS:
            quaternion = _quaternion(document, entry, keys)
            if quaternion is not None:
                quaternions[name] = quaternion
            continue
        source = _source(document, name, entry, keys)
        if source is not None:
            sources[name] = source
    return sources, quaternions


def _quaternion(document: YamlDocument, entry: Node, keys: Mapping[str, Node]) -> tuple[str, ...] | None:
    if set(keys) != {"quaternion"}:
        document.wrong(
            entry, "attitude and reference are given as a quaternion", "write {quaternion: [qw, qx, qy, qz]}"
        )
        return None
    names = [document.text(n, 200) for n in document.items(keys["quaternion"], "columns")]
    if len(names) != 4:
        document.wrong(keys["quaternion"], f"expected four columns in the order w, x, y, z, found {len(names)}")
        return None
    return tuple(n for n in names if n is not None)


def _source(document: YamlDocument, name: str, entry: Node, keys: Mapping[str, Node]) -> ColumnSource | None:
    if "quaternion" in keys:
        document.wrong(keys["quaternion"], f"{name} is not a quaternion", "use the channel `attitude` or `reference`")
        return None
    if ("from" in keys) == ("mean" in keys):
        document.wrong(entry, "give either `from: column` or `mean: [columns]`")
        return None
    if "from" in keys:
        one = document.text(keys["from"], 200)
        columns = [one] if one is not None else []
    else:
        columns = [c for c in (document.text(n, 200) for n in document.items(keys["mean"], "columns")) if c is not None]
    scale = document.number(keys["scale"], -1e12, 1e12) if "scale" in keys else 1.0
    if scale == 0.0:
        hint = "write the factor from the table's unit to the channel's; what does not change goes into `constants:`"
        document.wrong(keys["scale"], f"scale 0 makes every value of {name} the same", hint)
    offset = document.number(keys["offset"], -1e12, 1e12) if "offset" in keys else 0.0
    unit = CHANNELS[name].unit if name in CHANNELS else ("s" if name == TIME else "1")
    factor: float | None = 1.0
    if "unit" in keys:
        known = UNITS[unit]
        written = document.text(keys["unit"], 20)
        factor = known.get(written or "")
        if factor is None:
            guess = nearest(written or "", known)
            hint = f"did you mean `{guess}`?" if guess else f"known: {', '.join(known)}"
            document.wrong(keys["unit"], f"{written!r} is not a unit of {name} ({unit})", hint)
    if not columns or scale is None or offset is None or factor is None:
        return None
    power = document.number(keys["power"], 0.1, 4.0) if "power" in keys else 1.0
    table = parse_table(document, keys["table"], document.file) if "table" in keys else None
    return ColumnSource(tuple(columns), scale * factor, offset, 1.0 if power is None else power, table)


def _numbers(document: YamlDocument, node: Node | None, known: tuple[str, ...], low: float = -1e9) -> dict[str, float]:
    if node is None:
        return {}
    found = {name: document.number(child, low, 1e9) for name, child in document.mapping(node, known, "name").items()}
    return {name: value for name, value in found.items() if value is not None}
