"""Onboard logs over a link that loses frames and is cut."""

from __future__ import annotations

import io
import random
import zlib
from pathlib import Path

import pytest

from flighttest.errors import LinkError
from flighttest.link.clock import FollowedClock
from flighttest.link.onboard import LogDownload
from flighttest.link.onboard.files import DATA_BYTES, Operation, Packet, crc32_of
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.mavlink.dialect import Message, dialect, parser

LOG = random.Random(1).randbytes(100_003)


class Keeper:
    """A vehicle with two logs behind a link of 250 frames a second. loss: share of frames lost; cut_at: bytes after which it is silent."""

    def __init__(self, loss: float = 0.0, cut_at: float = 1e9, logs: int = 2) -> None:
        self._loss, self._cut_at, self._logs = loss, cut_at, logs
        self._draw, self._mav, self._ours = random.Random(2), parser(1, 1), parser(1, 1)
        self._out: list[Message] = []
        self.now_s, self.given, self.asked_from = 1000.0, 0, []
        self._beat_s = 0.0
        self.log, self.at_once = LOG, {"LOG_DATA": 5, "FILE_TRANSFER_PROTOCOL": 5}

    def send(self, data: bytes) -> None:
        for message in self._ours.parse_buffer(data) or []:
            if self._draw.random() < self._loss:
                continue
            if message.get_type() == "LOG_REQUEST_LIST":
                for n in range(1, self._logs + 1) or (0,):
                    size = len(self.log) if n == 2 else 50
                    self._out.append(dialect.MAVLink_log_entry_message(n, self._logs, self._logs, 1_700_000_000, size))
            elif message.get_type() == "FILE_TRANSFER_PROTOCOL":
                self.transfer(Packet.from_payload(bytes(message.payload)))
            elif message.get_type() == "LOG_REQUEST_DATA":
                self.asked_from.append(message.ofs)
                self._out = []
                for at in range(message.ofs, min(message.ofs + message.count, len(self.log)), 90):
                    data_ = self.log[at : min(at + 90, message.ofs + message.count)]
                    self._out.append(
                        dialect.MAVLink_log_data_message(message.id, at, len(data_), list(data_.ljust(90, b"\0")))
                    )

    def transfer(self, _asked: Packet) -> None:
        """MAVLink FTP: none."""

    def receive(self, timeout_s: float) -> bytes:
        self.now_s += max(timeout_s, 1e-3)
        if self.given > self._cut_at or timeout_s <= 0.0:
            return b""
        sent = b""
        if self.now_s >= self._beat_s:
            self._beat_s = self.now_s + 1.0
            sent += self._pack(dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3))
        count = self.at_once.get(self._out[0].get_type(), 5) if self._out else 0
        for message in self._out[:count]:
            if message.get_type() == "LOG_DATA":
                self.given += message.count
            elif message.get_type() == "FILE_TRANSFER_PROTOCOL":
                self.given += message.payload[4]
            frame = self._pack(message)
            sent += b"" if self._draw.random() < self._loss else frame
        self._out = self._out[count:]
        return sent

    def _pack(self, message: Message) -> bytes:
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def close(self) -> None:
        pass


class FileKeeper(Keeper):
    """The same with MAVLink FTP, as ArduPilot's GCS_FTP.cpp answers: one open file per session, bursts of 500 packets, an answer given
    again to a request of the same number. damaged: one byte that is not the file's."""

    def __init__(
        self, loss: float = 0.0, cut_at: float = 1e9, damaged: bool = False, at_once: dict[str, int] | None = None
    ) -> None:
        super().__init__(loss, cut_at)
        if at_once is not None:
            self.log, self.at_once = 8 * LOG, at_once
        self.files = {"00000001.BIN": bytes(50), "00000002.BIN": self.log, "LASTLOG.TXT": b"2"}
        self.open: tuple[int, bytes] | None = None
        self.bursts: list[int] = []
        self._damaged, self._last = damaged, Packet(0, 0, 0)

    def transfer(self, asked: Packet) -> None:
        """Answer one request."""
        if self._last.operation and (asked.number + 1) % 65536 == self._last.number:
            self._put(self._last)
            return
        number, name = (asked.number + 1) % 65536, asked.data.rstrip(b"\0").decode("latin-1")
        content = self.files.get(name.rpartition("/")[2]) if name.startswith("logs/") else None
        answer, code, data = Operation.ACK, asked.operation, b""
        if code == Operation.LIST_DIRECTORY:
            entries = [f"F{n}\t{len(c)}\0".encode() for n, c in self.files.items()][asked.offset :][:2]
            answer, data = (Operation.ACK, b"\0".join(entries)) if entries else (Operation.NAK, b"\x06")
            if name != "logs":
                answer, data = Operation.NAK, b"\x0a"
        elif code == Operation.OPEN_FILE_RO:
            if content is None or self.open is not None:
                answer, data = Operation.NAK, b"\x01"
            else:
                self.open, data = (asked.session, content), len(content).to_bytes(4, "little")
        elif code == Operation.CALC_FILE_CRC32 and content is not None:
            data = (zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF).to_bytes(4, "little")
        elif code == Operation.TERMINATE_SESSION:
            if self.open is not None and self.open[0] == asked.session:
                self.open = None
        elif code in (Operation.READ_FILE, Operation.BURST_READ_FILE):
            assert self.open is not None
            assert self.open[0] == asked.session
            self._out = [m for m in self._out if m.get_type() != "FILE_TRANSFER_PROTOCOL"]
            self._read(asked, number, self.open[1], 500 if code == Operation.BURST_READ_FILE else 1)
            return
        self._put(Packet(number, asked.session, answer, code, asked.offset, data))

    def _read(self, asked: Packet, number: int, content: bytes, most: int) -> None:
        if most > 1:
            self.bursts.append(asked.offset)
        for k in range(most):
            at = asked.offset + k * DATA_BYTES
            data = content[at : at + DATA_BYTES]
            if self._damaged and at <= 50_000 < at + DATA_BYTES:
                data = bytes([data[0] ^ 1]) + data[1:]
            over = not data or len(data) < DATA_BYTES or k == most - 1
            kind = Operation.ACK if data else Operation.NAK
            self._put(Packet((number + k) % 65536, asked.session, kind, asked.operation, at, data or b"\x06", over))
            if over:
                return

    def _put(self, packet: Packet) -> None:
        self._last = packet
        self._out.append(dialect.MAVLink_file_transfer_protocol_message(0, 0, 0, list(packet.to_payload())))


def download(keeper: Keeper, target: Path, number: int | None = None) -> list[float]:
    session = Session(MavlinkPort(keeper), FollowedClock(lambda: keeper.now_s, lambda: keeper.now_s))
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


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_a_log_comes_by_mavlink_ftp_where_the_vehicle_offers_it(loss: float, tmp_path: Path) -> None:
    keeper = FileKeeper(loss)
    shares = download(keeper, tmp_path / "a.BIN")
    assert (tmp_path / "a.BIN").read_bytes() == LOG
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert loss or not keeper.asked_from, "LOG_REQUEST_DATA was used"
    assert keeper.open is None, "the file was left open"


def test_a_file_that_was_cut_goes_on_where_it_stopped(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"stopped at \d+ %|link was lost"):
        download(FileKeeper(cut_at=60_000), tmp_path / "a.BIN")
    again = FileKeeper()
    download(again, tmp_path / "a.BIN")
    assert min(again.bursts) > 40_000
    assert (tmp_path / "a.BIN").read_bytes() == LOG


@pytest.mark.parametrize(
    ("at_once", "by_data"),
    [({"FILE_TRANSFER_PROTOCOL": 1, "LOG_DATA": 20}, True), ({"FILE_TRANSFER_PROTOCOL": 5, "LOG_DATA": 1}, False)],
)
def test_the_faster_of_two_ways_is_measured_and_taken(at_once: dict[str, int], by_data: bool, tmp_path: Path) -> None:
    """One packet of 239 bytes at a time against twenty of 90, and five against one. Both ways give parts of one file."""
    keeper = FileKeeper(at_once=at_once)
    shares = download(keeper, tmp_path / "a.BIN")
    assert (tmp_path / "a.BIN").read_bytes() == keeper.log
    assert shares == sorted(shares)
    assert keeper.asked_from, "it was not tried"
    assert (max(keeper.asked_from) > max(keeper.bursts)) is by_data
    assert keeper.open is None


def test_a_file_that_is_not_what_the_vehicle_has_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="checksum differs"):
        download(FileKeeper(damaged=True), tmp_path / "a.BIN")
    assert not list(tmp_path.iterdir())


def test_a_log_without_a_file_of_its_size_comes_by_log_request_data(tmp_path: Path) -> None:
    keeper = FileKeeper()
    keeper.files["00000002.BIN"] = LOG + b"1"
    download(keeper, tmp_path / "a.BIN")
    assert (tmp_path / "a.BIN").read_bytes() == LOG
    assert keeper.asked_from


def test_the_checksum_is_the_one_of_autopilots() -> None:
    """ArduPilot's crc_crc32 from 0, worked out bit by bit."""
    crc = 0
    for byte in b"log":
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    assert crc32_of(io.BytesIO(b"log")) == crc
