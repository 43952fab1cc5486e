"""`import_log`: one entrance for all kinds of logs."""

from __future__ import annotations

from pathlib import Path

from flighttest.errors import RecordingError
from flighttest.logs.opening import LogFile
from flighttest.recording import Recording

_TABLES = {".csv", ".parquet", ".txt", ".tsv"}


def import_log(path: Path | str, columns: Path | str | None = None) -> Recording:
    """Read a log of any known kind, plain or compressed (.gz, .xz).

    path: .BIN, .tlog, .ulg, .csv or .parquet; what it is, is told from its first bytes, then from its name. columns: a column map
    (columns/1) for foreign tables. RecordingError says what cannot be used, where, and what to do.
    """
    path = Path(path)
    file = LogFile(path)
    head = file.head()
    if not head:
        raise RecordingError(f"{path} is empty", "was the log downloaded completely?")
    suffix = file.suffix
    if head[:3] == b"\xa3\x95\x80" or (suffix == ".bin" and b"\xa3\x95" in head):
        from flighttest.logs.ardupilot_bin import import_ardupilot_bin

        return import_ardupilot_bin(path)
    if suffix == ".tlog":
        from flighttest.logs.tlog import import_tlog

        return import_tlog(path)
    if suffix == ".ulg" or head[:4] == b"ULog":
        from flighttest.logs.ulog import import_ulog

        return import_ulog(path)
    if suffix in _TABLES or head[:4] == b"PAR1" or head[:1] == b"\xbc" or columns is not None:
        from flighttest.logs.table import import_table

        return import_table(path, columns)
    raise RecordingError(f"{path}: this is no kind of log I know", "give a .BIN, .tlog, .ulg, .csv or .parquet file")
