"""`import_log`: a log of any kind to a Recording, by its content."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from flighttest.channels import CHANNELS
from flighttest.errors import RecordingError
from flighttest.logs.ardupilot.dataflash import TEXT_HEADER
from flighttest.logs.opening import KINDS, LogFile
from flighttest.logs.tables.ros_bag import MAGIC, SQLITE
from flighttest.recording import Recording, Series

# Far beyond any multirotor, far below what a flipped bit in a float makes; by unit.
_IMPOSSIBLE = {
    "rad": 1e4, "rad/s": 300.0, "m/s^2": 3e3, "m/s": 1e3, "m": 1e7, "V": 2e3, "A": 1e4, "1": 1e6,
}  # fmt: skip
_LFS_POINTER = b"version https://git-lfs"
_TABLES = {".csv", ".parquet", ".txt", ".tsv", ".mat", ".mcap"}


def import_log(path: Path | str, columns: Path | str | None = None) -> Recording:
    """Read a log of any known kind, plain or compressed (.gz, .xz).

    path: .BIN (or its text, .log), .tlog, .ulg, .csv, .parquet, .mat or .mcap; what it is, is recognised by its first bytes, then from its
    name. columns: a column map (columns/1) for foreign tables. RecordingError: what cannot be used, where, and what to do.
    """
    # A damaged float may be a signalling NaN or overflow where it is cast: it becomes NaN, or is found impossible.
    with np.errstate(invalid="ignore", over="ignore"):
        recording = possible(_read(Path(path), columns))
    if not any(len(series) > 1 for series in recording.series.values()):
        raise RecordingError(
            f"{path}: it holds no measurement of a flight", "was it downloaded completely, and does it cover a flight?"
        )
    return recording


def possible(recording: Recording) -> Recording:
    """The same without values no vehicle can have (damaged bytes that still read as numbers): they become NaN, which is noted."""
    series = dict(recording.series)
    losses: list[str] = []
    for group, one in recording.series.items():
        columns = dict(one.columns)
        for name, values in one.columns.items():
            with np.errstate(invalid="ignore"):
                bad = np.abs(values) > _IMPOSSIBLE[CHANNELS[name].unit]
            if bad.any():
                columns[name] = np.where(bad, np.nan, values)
                first = float(one.t_s[np.flatnonzero(bad)[0]])
                losses.append(
                    f"{name}: {int(np.count_nonzero(bad))} values are impossible and were dropped (first at {first:.3f} s)"
                )
        if losses:
            series[group] = Series(one.t_s, columns)
    if not losses:
        return recording
    provenance = replace(recording.provenance, losses=(*recording.provenance.losses, *losses))
    return replace(recording, series=series, provenance=provenance)


def _read(path: Path, columns: Path | str | None) -> Recording:
    file = LogFile(path)
    head = file.head()
    if not head:
        raise RecordingError(f"{path} is empty", "was the log downloaded completely?")
    if head.startswith(_LFS_POINTER):
        raise RecordingError(f"{path}: a pointer of Git LFS, not the log itself", "fetch the log: git lfs pull")
    suffix = file.suffix
    claimed = path.suffix.lower()
    if claimed in {".gz", ".xz"} and not file.compressed:
        raise RecordingError(
            f"{path}: named {claimed}, but its content is not compressed that way",
            "rename it, or copy or download it anew",
        )
    if head[:3] == b"\xa3\x95\x80" or head.startswith(TEXT_HEADER) or (suffix == ".bin" and b"\xa3\x95" in head):
        from flighttest.logs.ardupilot.importer import import_ardupilot_bin

        return import_ardupilot_bin(path)
    if suffix == ".tlog":
        from flighttest.logs.tlog import import_tlog

        return import_tlog(path)
    if suffix == ".ulg" or head[:4] == b"ULog":
        from flighttest.logs.ulog import import_ulog

        return import_ulog(path)
    if suffix in _TABLES or head[:4] == b"PAR1" or head[:1] == b"\xbc" or head.startswith(MAGIC) or columns is not None:
        from flighttest.logs.tables.table import import_table

        return import_table(path, columns)
    if head.startswith(SQLITE):
        raise RecordingError(
            f"{path}: a database; of ROS 2 bags those in MCAP are read",
            "convert it: ros2 bag convert -i BAG -o out.yaml, with storage_id: mcap in out.yaml",
        )
    if suffix == ".log":
        raise RecordingError(
            f"{path}: named .log, but no dataflash log of ArduPilot as text",
            "if it is a table, write its rows into a .csv file and describe their columns with --columns map.yaml (docs/formats.md)",
        )
    if suffix in {".yaml", ".yml"}:
        raise RecordingError(
            f"{path}: this is not a recording",
            "a model is given with --model, a vehicle with --vehicle, a column map with --columns",
        )
    raise RecordingError(
        f"{path} is not a kind of log that can be read",
        f"give a {KINDS} file",
    )
