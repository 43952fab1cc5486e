"""Import of a dataflash log against pymavlink's DFReader, in one run: `python benchmarks/import_speed.py LOG.BIN [--megabytes 500]`.

The log is repeated with its clock running on until it has the wanted size; pymavlink reads the log once (it would take minutes else),
both read the same message types. Peak memory is the importing process's own, less what it held before.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from flighttest.logs.ardupilot.dataflash import read_dataflash
from flighttest.logs.ardupilot.importer import WANTED
from flighttest.logs.opening import LogFile

IMPORT = """
import resource, sys, time
from pathlib import Path
from flighttest.logs import import_log
from flighttest.logs.ardupilot.importer import import_ardupilot_bin
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
begin = time.perf_counter()
recording = import_log(Path(sys.argv[1]))
seconds = time.perf_counter() - begin
kept = sum(s.t_s.nbytes + sum(c.nbytes for c in s.columns.values()) for s in recording.series.values())
print(seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024, kept)
"""


def repeated(data: bytes, megabytes: float, path: Path) -> None:
    """The log over and over, each time with later time stamps."""
    tables = read_dataflash([data]).tables
    stamped = {name: t for name, t in tables.items() if "TimeUS" in t and name != "FMT"}
    at = np.sort(np.concatenate([t.at for t in stamped.values()]))
    last = max(int(t.raw["TimeUS"].max()) for t in stamped.values())
    first = min(int(t.raw["TimeUS"].min()) for t in stamped.values())
    buffer = np.frombuffer(data, dtype=np.uint8).copy()
    stamps = np.ndarray((buffer.size - 7,), "<u8", buffer, strides=(1,))
    with path.open("wb") as out:
        for _ in range(max(1, round(megabytes * 1e6 / len(data)))):
            out.write(buffer.tobytes())
            stamps[at + 3] = stamps[at + 3] + np.uint64(last - first + 2500)


def theirs_s(path: Path) -> float:
    """Seconds pymavlink takes to give the same message types."""
    from pymavlink import DFReader

    begin = time.perf_counter()
    reader = DFReader.DFReader_binary(str(path))
    wanted = list(WANTED)
    while reader.recv_match(type=wanted) is not None:
        pass
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--megabytes", type=float, default=500.0)
    options = parser.parse_args()
    data = b"".join(LogFile(options.log).pieces())
    with tempfile.TemporaryDirectory() as folder:
        once, big = Path(folder) / "once.BIN", Path(folder) / "big.BIN"
        once.write_bytes(data)
        repeated(data, options.megabytes, big)
        size = big.stat().st_size / 1e6
        out = subprocess.run(
            [sys.executable, "-c", IMPORT, str(big)], check=True, capture_output=True, text=True
        ).stdout
        seconds, peak, kept = (float(word) for word in out.split())
        pymavlink = theirs_s(once)
    ours, other = size / seconds, len(data) / 1e6 / pymavlink
    print(f"flighttest import  {size:7.1f} MB in {seconds:6.2f} s  {ours:7.1f} MB/s")
    print(f"pymavlink DFReader {len(data) / 1e6:7.1f} MB in {pymavlink:6.2f} s  {other:7.1f} MB/s")
    print(
        f"ratio {ours / other:.1f}; peak memory {peak / 1e6:.0f} MB, {peak / kept:.2f} times the {kept / 1e6:.0f} MB of columns kept"
    )
    print(f"(user time of this process {resource.getrusage(resource.RUSAGE_SELF).ru_utime:.0f} s)")


if __name__ == "__main__":
    main()
