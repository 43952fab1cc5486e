"""The record survives: kill -9 loses at most half a second, and any MAVLink tool reads what is there."""

import contextlib
import os
import resource
import signal
import struct
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink import mavutil

from flighttest.errors import LinkError
from flighttest.flight.recorder import RESERVE_BYTES, Recorder, mark_id
from flighttest.mavlink.dialect import dialect, parser
from flighttest.recording.store import read_events, read_manifest
from tests.flight.faulty import FaultyLink, fly, make_plan, options


def recorder(run_dir: Path, ground_s=time.time) -> Recorder:
    return Recorder(run_dir, ground_s, {"weather": "calm"}, make_plan())


def attitude(k: int, mav) -> tuple[bytes, object]:
    message = dialect.MAVLink_attitude_message(20 * k, 0.1, 0, 0, 0, 0, 0)
    return bytes(message.pack(mav)), message


def test_other_tools_read_it_and_time_never_goes_back(run_dir: Path) -> None:
    times = iter([100.0, 100.02, 99.0, 100.06])
    made = recorder(run_dir, lambda: next(times))
    mav = parser(1, 1)
    for k in range(4):
        made.tap(*attitude(k, mav))
    made.flush(force=True)
    raw = (run_dir / "raw.tlog").read_bytes()
    assert struct.unpack(">Q", raw[:8])[0] == 100_000_000
    log = mavutil.mavlink_connection(str(run_dir / "raw.tlog"))
    found = [log.recv_match(type="ATTITUDE") for _ in range(4)]
    assert [round(m._timestamp, 2) for m in found] == [100.0, 100.02, 100.02, 100.06]


def test_manifest_script_plan_and_events_are_there_from_the_start(run_dir: Path) -> None:
    made = recorder(run_dir)
    made.event("note", "hello", 1.5, {"x": 1})
    assert read_manifest(run_dir)["weather"] == "calm"
    assert (run_dir / "script.yaml").read_text().startswith("format: maneuver/1")
    assert '"test/roll+0.30/r1"' in (run_dir / "plan.json").read_text()
    assert [m.label for m in read_events(run_dir)[0]] == ["hello"]


def test_marks_fit_into_one_statustext() -> None:
    assert mark_id("thrust/0.05-0.40/r3") == "thrust/0.05-0.40/r3"
    long = mark_id("a very long script name of somebody/0.05-0.40 #2/r13")
    assert len(long) <= 32
    assert long.endswith("#2/r13")
    assert " " not in long


WRITER = """
import sys, time
from pathlib import Path
from tests.flight.test_recorder import attitude, recorder
from flighttest.mavlink.dialect import parser
made, mav = recorder(Path(sys.argv[1])), parser(1, 1)
for k in range(10000):
    made.tap(*attitude(k, mav))
    sys.stdout.write(f"{k}\\n"); sys.stdout.flush()
    time.sleep(0.02)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_kill_9_loses_at_most_half_a_second(run_dir: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(run_dir)], stdout=subprocess.PIPE, text=True, cwd=root
    )
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) == 60:
            os.kill(process.pid, signal.SIGKILL)
            break
    last = max([60, *(int(line) for line in process.stdout if line.strip().isdigit())])
    process.wait()
    log = mavutil.mavlink_connection(str(run_dir / "raw.tlog"))
    kept = 0
    while (message := log.recv_match(type="ATTITUDE")) is not None:
        kept = message.time_boot_ms // 20
    assert last - kept <= 25, f"{(last - kept) * 0.02} s were lost"
    assert kept > 30


@contextlib.contextmanager
def full_from(bytes_: int) -> Iterator[None]:
    """A disk on which no file may grow beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def frames_in(run_dir: Path) -> list[int]:
    log = mavutil.mavlink_connection(str(run_dir / "raw.tlog"))
    found = []
    while (message := log.recv_match(type="ATTITUDE")) is not None:
        found.append(message.time_boot_ms // 20)
    return found


def test_nothing_is_lost_where_a_full_disk_has_space_again(run_dir: Path) -> None:
    made, mav = recorder(run_dir), parser(1, 1)
    for k in range(20):
        made.tap(*attitude(k, mav))
    with full_from(300):
        made.flush(force=True)
        for k in range(20, 60):
            made.tap(*attitude(k, mav))
        made.flush(force=True)
        assert len(frames_in(run_dir)) < 20
    assert made.failure
    made.event("note", "afterwards", 1.0)
    for k in range(60, 100):
        made.tap(*attitude(k, mav))
    made.flush(force=True)
    assert frames_in(run_dir) == list(range(100))
    assert [m.label for m in read_events(run_dir)[0]] == ["afterwards"]


def test_the_space_kept_back_ends_the_record(run_dir: Path) -> None:
    """The disk is full but for what was reserved for it."""
    made, mav = recorder(run_dir), parser(1, 1)
    held = contextlib.ExitStack()
    held.enter_context(full_from(300))
    give_back = made.reserve.give_back

    def freed() -> bool:
        held.close()
        return give_back()

    made.reserve.give_back = freed  # type: ignore[method-assign]
    for k in range(100):
        made.tap(*attitude(k, mav))
    made.flush(force=True)
    assert made.failure, "the flight ends"
    assert frames_in(run_dir) == list(range(100))


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="shows no open files")
def test_a_flight_that_is_refused_leaves_no_file_open(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flighttest.link.session.CONNECT_S", 0.3)
    with pytest.raises(LinkError):
        fly(make_plan(), "sim", run_dir, transport=FaultyLink(options(), mute=lambda _t: True))
    opened = [os.readlink(f) for f in Path("/proc/self/fd").iterdir() if f.is_symlink()]
    assert not [path for path in opened if path.startswith(str(run_dir))]


def test_the_reserve_is_of_its_size_and_leaves_nothing(run_dir: Path) -> None:
    made = recorder(run_dir)
    # Of the file itself: what is free on the disk changes by what others write and remove.
    assert made.reserve._file is not None
    assert os.fstat(made.reserve._file.fileno()).st_blocks * 512 >= RESERVE_BYTES
    assert sorted(p.name for p in run_dir.iterdir()) == [
        "events.jsonl",
        "manifest.yaml",
        "plan.json",
        "raw.tlog",
        "script.yaml",
    ]
    assert made.reserve.give_back()
    assert not made.reserve.give_back()


def test_a_long_flight_takes_no_memory(run_dir: Path) -> None:
    """Ten minutes of 50 Hz took 8 MB a minute when its messages were kept until the end."""
    made, mav = recorder(run_dir), parser(1, 1)
    made.tap(*attitude(0, mav))
    made.flush(force=True)
    tracemalloc.start()
    for k in range(30_000):
        made.tap(*attitude(k, mav))
    made.flush(force=True)
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert grown < 200_000
