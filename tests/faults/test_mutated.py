"""A few of the mutated frames and logs; many by `python -m tests.faults.mutated`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.mutated import Log, listen_to_packets, logs, read_logs

LOGS = list(logs())


def test_mutated_frames_crash_nothing(tmp_path: Path) -> None:
    assert listen_to_packets(3000, tmp_path / "run") > 0, "some look like a take-over, a reboot or a landing"


@pytest.mark.parametrize("log", LOGS, ids=[log.suffix for log in LOGS])
def test_damaged_logs_are_read_or_refused(log: Log, tmp_path: Path) -> None:
    read_logs(log, 8, tmp_path)
