"""Containers: what a broken one still holds is read, and what is none is named."""

import gzip
import lzma
from pathlib import Path

import pytest

from flighttest.errors import RecordingError
from flighttest.logs import import_log
from flighttest.logs.opening import LogFile, name_of


def noise(count):
    """Bytes that do not compress, so that half a file holds about half of them."""
    state, out = 1, bytearray()
    for _ in range(count):
        state = (state * 1103515245 + 12345) % 2**31
        out.append(state >> 16 & 255)
    return bytes(out)


@pytest.mark.parametrize(("suffix", "compress"), [("gz", gzip.compress), ("xz", lzma.compress)])
def test_what_stands_before_the_break_is_read(tmp_path, suffix, compress):
    data = noise(200_000)
    packed = compress(data)
    path = tmp_path / f"log.tlog.{suffix}"
    path.write_bytes(packed[: len(packed) // 2])
    log = LogFile(path)
    assert log.head(100) == data[:100]
    got = b"".join(log.pieces())
    assert len(got) > 60_000
    assert got == data[: len(got)]
    assert "damaged" in log.losses[0]


@pytest.mark.parametrize(("suffix", "compress"), [("gz", gzip.compress), ("xz", lzma.compress)])
def test_a_whole_file_loses_nothing(tmp_path, suffix, compress):
    data = noise(50_000)
    path = tmp_path / f"log.tlog.{suffix}"
    path.write_bytes(compress(data))
    log = LogFile(path)
    assert b"".join(log.pieces(7_000)) == data
    assert log.losses == []


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("log.tlog.gz", b"no gzip at all", "not compressed"),
        ("log.BIN.xz", b"no xz at all", "not compressed"),
        ("log.tlog.gz", gzip.compress(b"x", mtime=0)[:6], "damaged from its start"),
        ("log.tlog", b"", "is empty"),
    ],
)
def test_a_container_that_holds_nothing_is_named(tmp_path, name, data, said):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=said):
        import_log(path)


def test_a_log_with_one_sample_is_no_flight(tmp_path, dataflash):
    w = dataflash()
    w.format("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    w.write("IMU", 1000, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    path = tmp_path / "short.BIN"
    path.write_bytes(bytes(w.data))
    with pytest.raises(RecordingError, match="no measurement"):
        import_log(path)


@pytest.mark.parametrize(
    ("file", "name"),
    [("a/sitl_4.7dev_steps.BIN", "sitl_4.7dev_steps"), ("b.csv.gz", "b"), ("c.tlog.XZ", "c"), ("d", "d")],
)
def test_a_recording_is_called_by_its_file(file, name):
    assert name_of(Path(file)) == name
