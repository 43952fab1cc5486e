"""Files of a vehicle by MAVLink FTP: listed, and read in bursts; what a link loses is asked for again.

MAVLink guide, "File Transfer Protocol"; requests, answers and their numbering as ArduPilot's GCS_FTP.cpp handles them. Nothing is written
or removed on the vehicle.
"""

from __future__ import annotations

import enum
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO

from flighttest.errors import LinkError
from flighttest.link.session import Session
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, dialect

DATA_BYTES = 239  # of one answer
SILENCE_S = 20.0  # without progress for so long a download is given up
_HEAD = struct.Struct("<HBBBBBxI")  # number, session, operation, size, operation asked for, burst is over, offset
_ANSWER_S, _TRIES = 0.6, 5
_BURST_QUIET_S = 0.5  # without a packet of a burst, what is missing is asked for again
_LOOK_EVERY_S = 0.02
_GAPS = 4  # asked for at once; ArduPilot queues five requests
_STRIDE = 1000  # between the numbers of two requests: each packet of a burst takes one, ArduPilot sends 500 at most
_CRC_BYTES_PER_S = 250e3  # a slow card, read by the vehicle itself


class Operation(enum.IntEnum):
    """MAVLink FTP's operations that are used here."""

    TERMINATE_SESSION = 1
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15
    ACK = 128
    NAK = 129


class FileError(enum.IntEnum):
    """Why the vehicle refuses (the ones that are decided upon)."""

    OTHER = 0
    END_OF_FILE = 6


@dataclass(frozen=True)
class Packet:
    """One message of the protocol, either way."""

    number: int
    session: int
    operation: int
    asked: int = 0
    offset: int = 0
    data: bytes = b""
    burst_over: bool = False
    size: int | None = None  # of what is asked for, where that is not the length of `data`

    def to_payload(self) -> bytes:
        """As the 251 bytes of a FILE_TRANSFER_PROTOCOL message."""
        size = len(self.data) if self.size is None else self.size
        head = _HEAD.pack(
            self.number, self.session, self.operation, size, self.asked, int(self.burst_over), self.offset
        )
        return (head + self.data).ljust(_HEAD.size + DATA_BYTES, b"\0")

    @classmethod
    def from_payload(cls, payload: bytes) -> Packet:
        """The reverse of `to_payload`."""
        number, session, operation, size, asked, over, offset = _HEAD.unpack(payload[: _HEAD.size])
        return cls(
            number, session, operation, asked, offset, payload[_HEAD.size :][: min(size, DATA_BYTES)], bool(over)
        )

    @property
    def refusal(self) -> FileError | None:
        """Why the vehicle refused, None where it did not."""
        if self.operation != Operation.NAK:
            return None
        return FileError.END_OF_FILE if self.data[:1] == bytes([FileError.END_OF_FILE]) else FileError.OTHER


class VehicleFiles:
    """The files of the vehicle of a session."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._number = 0
        self.offered = False  # whether any question was answered
        self._file_session = session.port.system  # of the one file that may be open; a station beside us takes its own

    def listing(self, folder: str) -> dict[str, int] | None:
        """Size in bytes by name of a folder's files. None where there is no such folder, or the vehicle has no MAVLink FTP."""
        found: dict[str, int] = {}
        seen = 0
        while True:
            answer = self._ask(Operation.LIST_DIRECTORY, folder.encode(), offset=seen)
            if answer is None or answer.refusal is not None:
                over = answer is not None and answer.refusal is FileError.END_OF_FILE
                return found if over else None
            entries = [entry for entry in answer.data.split(b"\0") if entry]
            if not entries:
                return found
            seen += len(entries)
            for entry in entries:
                name, _, size = entry[1:].decode("utf-8", "replace").partition("\t")
                if entry[:1] == b"F" and size.isdecimal():
                    found[name] = int(size)

    def crc32(self, path: str, size: int) -> int | None:
        """The vehicle's own checksum of a file (see `crc32_of`), None where it gives none. size: bytes, for how long it may take."""
        answer = self._ask(Operation.CALC_FILE_CRC32, path.encode(), patience_s=_ANSWER_S + size / _CRC_BYTES_PER_S)
        if answer is None or answer.refusal is not None or len(answer.data) < 4:
            return None
        return int.from_bytes(answer.data[:4], "little")

    def read(
        self,
        path: str,
        begin: int,
        end: int,
        take: Callable[[bytes], object],
        enough: Callable[[], bool] = lambda: False,
    ) -> None:
        """The bytes of a file from `begin` to `end`, in order, in pieces. LinkError where it cannot be opened or stops coming.

        enough: asked between bursts, which a vehicle does not break off: whether to end before `end`.
        """
        self._close()  # what a download that was cut off left open
        answer = self._ask(Operation.OPEN_FILE_RO, path.encode())
        if answer is None or answer.refusal is not None:
            raise LinkError(f"the vehicle does not open {path}", "another station may be reading a file: try again")
        self._file_session = answer.session
        try:
            self._read(path, (begin, end), take, enough)
        finally:
            self._close()

    def _read(
        self, path: str, span: tuple[int, int], take: Callable[[bytes], object], enough: Callable[[], bool]
    ) -> None:
        begin, end = span
        have, progress_s, ahead = begin, self._session.now_s(), dict[int, bytes]()

        def keep(packet: Packet) -> bool:
            """Whether no more comes of what was asked for."""
            if packet.operation == Operation.ACK and have <= packet.offset < end:
                ahead[packet.offset] = packet.data
            return packet.burst_over or packet.operation == Operation.NAK

        while have < end:
            if ahead:
                gaps = _gaps(have, ahead)
                for offset, size in gaps:
                    self._send(Operation.READ_FILE, b"", offset, size)
                wanted = {offset for offset, _ in gaps}
                self._until(Operation.READ_FILE, lambda p, wanted=wanted: keep(p) or wanted <= ahead.keys())  # type: ignore[misc]
            elif enough():
                return
            else:
                self._send(Operation.BURST_READ_FILE, b"", have, DATA_BYTES)
                self._until(Operation.BURST_READ_FILE, keep)
            before = have
            while have in ahead:
                data = ahead.pop(have)[: end - have]
                if not data:
                    break
                take(data)
                have += len(data)
            if have > before:
                progress_s = self._session.now_s()
            elif self._session.now_s() - progress_s > SILENCE_S:
                raise LinkError(f"{path} stopped arriving", "move closer, and give the same command again")

    def _close(self) -> None:
        self._ask(Operation.TERMINATE_SESSION, b"", tries=2)

    def _ask(
        self,
        operation: Operation,
        data: bytes,
        *,
        offset: int = 0,
        patience_s: float = _ANSWER_S,
        tries: int = _TRIES,
    ) -> Packet | None:
        """One question and its answer; None where none comes. A question that is repeated keeps its number: it is answered once."""
        found: list[Packet] = []
        number = self._next()
        for _ in range(tries):
            self._send(operation, data, offset, None, number)
            self._until(operation, lambda p: _kept(p, number, found), patience_s)
            if found:
                self.offered = True
                return found[0]
        return None

    def _next(self) -> int:
        self._number = (self._number + _STRIDE) % 65536
        return self._number

    def _send(
        self, operation: Operation, data: bytes, offset: int, size: int | None, number: int | None = None
    ) -> None:
        number = self._next() if number is None else number
        packet = Packet(number, self._file_session, operation, offset=offset, data=data, size=size)
        system = self._session.vehicle_system
        payload = list(packet.to_payload())
        self._session.send(dialect.MAVLink_file_transfer_protocol_message(0, system, COMPONENT_AUTOPILOT, payload))

    def _until(self, operation: Operation, enough: Callable[[Packet], bool], quiet_s: float = _BURST_QUIET_S) -> None:
        """Take answers to one kind of question in until one is enough, or none has come for quiet_s."""
        session, heard_s, done = self._session, self._session.now_s(), False

        def listen(message: Message, t_s: float) -> None:
            nonlocal heard_s, done
            if message.get_type() != "FILE_TRANSFER_PROTOCOL" or message.target_system not in (0, session.port.system):
                return
            packet = Packet.from_payload(bytes(message.payload))
            reading = operation in (Operation.READ_FILE, Operation.BURST_READ_FILE)
            if packet.asked == operation and (not reading or packet.session == self._file_session):
                heard_s, done = t_s, enough(packet) or done

        session.listen(listen)
        try:
            while not done and 0.0 <= session.now_s() - heard_s < quiet_s:
                session.advance(session.now_s() + _LOOK_EVERY_S)
                session.require_link()
        finally:
            session.forget(listen)


def _kept(packet: Packet, number: int, found: list[Packet]) -> bool:
    """Whether a packet answers the request of this number; it is added then."""
    answers = packet.number == (number + 1) % 65536
    if answers:
        found.append(packet)
    return answers


def _gaps(have: int, ahead: dict[int, bytes]) -> list[tuple[int, int]]:
    """What is missing before what has come: (offset, size) of the first ones."""
    found: list[tuple[int, int]] = []
    at = have
    for offset in sorted(ahead):
        while at < offset and len(found) < _GAPS:
            found.append((at, min(DATA_BYTES, offset - at)))
            at += found[-1][1]
        at = max(at, offset + len(ahead[offset]))
    return found


def crc32_of(file: IO[bytes]) -> int:
    """CRC-32 of a whole file as autopilots compute it: begun at 0, not inverted at the end."""
    file.seek(0)
    crc = 0xFFFFFFFF
    while block := file.read(1 << 20):
        crc = zlib.crc32(block, crc)
    return crc ^ 0xFFFFFFFF
