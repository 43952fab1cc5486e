"""Onboard logs over a link that loses frames and is cut."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from flighttest.errors import LinkError
from flighttest.link.clock import FollowedClock
from flighttest.link.onboard import LogDownload
from flighttest.link.port import Port
from flighttest.link.session import Session
from flighttest.mavlink.dialect import Message, book, parser

LOG = random.Random(1).randbytes(100_003)


class Keeper:
    """A vehicle with two logs behind a link of 250 frames a second. loss: share of frames lost; cut_at: bytes after which it is silent."""

    def __init__(self, loss: float = 0.0, cut_at: float = 1e9, logs: int = 2) -> None:
        self._loss, self._cut_at, self._logs = loss, cut_at, logs
        self._draw, self._mav, self._ours = random.Random(2), parser(1, 1), parser(1, 1)
        self._out: list[Message] = []
        self.now_s, self.given, self.asked_from = 1000.0, 0, []
        self._beat_s = 0.0

    def send(self, data: bytes) -> None:
        for message in self._ours.parse_buffer(data) or []:
            if self._draw.random() < self._loss:
                continue
            if message.get_type() == "LOG_REQUEST_LIST":
                for n in range(1, self._logs + 1) or (0,):
                    size = len(LOG) if n == 2 else 50
                    self._out.append(book.MAVLink_log_entry_message(n, self._logs, self._logs, 1_700_000_000, size))
            elif message.get_type() == "LOG_REQUEST_DATA":
                self.asked_from.append(message.ofs)
                self._out = []
                for at in range(message.ofs, min(message.ofs + message.count, len(LOG)), 90):
                    data_ = LOG[at : min(at + 90, message.ofs + message.count)]
                    self._out.append(
                        book.MAVLink_log_data_message(message.id, at, len(data_), list(data_.ljust(90, b"\0")))
                    )

    def receive(self, timeout_s: float) -> bytes:
        self.now_s += max(timeout_s, 1e-3)
        if self.given > self._cut_at or timeout_s <= 0.0:
            return b""
        sent = b""
        if self.now_s >= self._beat_s:
            self._beat_s = self.now_s + 1.0
            sent += self._pack(book.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3))
        for message in self._out[:5]:
            if message.get_type() == "LOG_DATA":
                self.given += message.count
            frame = self._pack(message)
            sent += b"" if self._draw.random() < self._loss else frame
        self._out = self._out[5:]
        return sent

    def _pack(self, message: Message) -> bytes:
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def close(self) -> None:
        pass


def download(keeper: Keeper, target: Path, number: int | None = None) -> list[float]:
    session = Session(Port(keeper), FollowedClock(lambda: keeper.now_s, lambda: keeper.now_s))
    session.connect()
    shares: list[float] = []
    log = LogDownload(session).fetch(target, number, shares.append)
    assert log.number == (number or 2)
    return shares


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_a_log_arrives_whole(loss: float, tmp_path: Path) -> None:
    shares = download(Keeper(loss), tmp_path / "a.BIN")
    assert (tmp_path / "a.BIN").read_bytes() == LOG
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert [p.name for p in tmp_path.iterdir()] == ["a.BIN"]


def test_a_download_that_was_cut_goes_on_where_it_stopped(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"stopped at \d+ %|link was lost"):
        download(Keeper(cut_at=60_000), tmp_path / "a.BIN")
    assert not (tmp_path / "a.BIN").exists()
    again = Keeper()
    download(again, tmp_path / "a.BIN")
    assert again.asked_from[0] > 40_000
    assert (tmp_path / "a.BIN").read_bytes() == LOG


def test_a_part_of_another_log_is_begun_anew(tmp_path: Path) -> None:
    (tmp_path / "a.BIN.2.part").write_bytes(bytes(50_000))
    keeper = Keeper()
    download(keeper, tmp_path / "a.BIN")
    assert 0 in keeper.asked_from
    assert (tmp_path / "a.BIN").read_bytes() == LOG


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="has no log 7"):
        download(Keeper(), tmp_path / "a.BIN", 7)
    with pytest.raises(LinkError, match="no log with anything"):
        download(Keeper(logs=0), tmp_path / "a.BIN")
