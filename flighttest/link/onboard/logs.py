"""Onboard logs over MAVLink: what a link loses is asked for again, and a download that was cut off goes on where it stopped."""

from __future__ import annotations

import datetime as dt
import io
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from flighttest.errors import LinkError
from flighttest.link.onboard.files import DATA_BYTES, SILENCE_S, VehicleFiles, crc32_of
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import full_url, open_transport
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, dialect

LOG_FOLDERS = ("/APM/LOGS", "logs")  # of ArduPilot on a flight controller, and of its SITL
_WINDOW_BYTES = 90 * 512  # asked for at once; a LOG_DATA message has 90
_TRIES = 4
_LIST_QUIET_S, _DATA_QUIET_S = 2.0, 0.5  # without one of its messages a request is repeated
_LOOK_EVERY_S = 0.02
_TRIAL_S = 1.0  # of each way, where there are two
_OVERLAP_BYTES = 18 * DATA_BYTES


@dataclass(frozen=True)
class OnboardLog:
    """One log on the vehicle. date: as the vehicle states it, empty where it has no clock. by: how it was downloaded."""

    number: int
    date: str
    size_bytes: int
    by: str = ""


@dataclass(frozen=True)
class _Download:
    """What is downloaded of a log, up to `size`, and where to."""

    number: int
    size: int
    file: IO[bytes]
    on_progress: Callable[[float], None]


def fetch(
    url: str,
    target: Path,
    number: int | None = None,
    on_progress: Callable[[float], None] | None = None,
    key: bytes | None = None,
    on_connected: Callable[[Session, Message], None] = lambda _session, _beat: None,
) -> OnboardLog:
    """Download one onboard log (the newest, or the one numbered so) into the file `target`.

    on_progress: called with the share done, 0..1. key: of MAVLink 2 signing. on_connected: called with the vehicle's first HEARTBEAT,
    before anything is asked of it. LinkError when nothing answers, the vehicle has no logs, or the download stops; what arrived until
    then stays beside the target, and the next call goes on from there.
    """
    session = Session(MavlinkPort(open_transport(full_url(url)), key=key))
    try:
        on_connected(session, session.connect())
        return LogDownload(session).fetch(target, number, on_progress or (lambda _share: None))
    finally:
        session.port.close()


class LogDownload:
    """Logs of a vehicle, listed by LOG_REQUEST_LIST; downloaded by MAVLink FTP where the vehicle offers the same file by it, else,
    or where it is faster, by LOG_REQUEST_DATA, a window at a time. What a link loses is asked for again."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._system = session.vehicle_system
        self._files = VehicleFiles(session)
        self._path: str | None = None  # by MAVLink FTP
        self.by: list[str] = []  # how it came

    def entries(self) -> dict[int, Message]:
        """LOG_ENTRY by number, of logs with anything in them. LinkError where the vehicle lists none."""
        found: dict[int, Message] = {}
        listed = 0

        def take(message: Message) -> bool:
            nonlocal listed
            if message.get_type() == "LOG_ENTRY":
                listed = max(listed, int(message.num_logs), 1)
                if message.num_logs:
                    found[int(message.id)] = message
            return bool(listed and len(found) >= listed)

        for _ in range(_TRIES):
            self._session.send(dialect.MAVLink_log_request_list_message(self._system, COMPONENT_AUTOPILOT, 0, 0xFFFF))
            self._until(take, _LIST_QUIET_S)
            if found and len(found) >= listed:
                break
        if not listed:
            raise LinkError("the vehicle lists no logs", "it may keep none: see LOG_BACKEND_TYPE")
        found = {n: entry for n, entry in found.items() if entry.size}
        if not found:
            raise LinkError(
                "the vehicle has no log with anything in it",
                "fly first: the log begins at arming (the built-in vehicle keeps none)",
            )
        return found

    def fetch(self, target: Path, number: int | None, on_progress: Callable[[float], None]) -> OnboardLog:
        """One log into a file. LinkError where there is none, it stops coming, or is not what the vehicle has."""
        found = self.entries()
        chosen = max(found) if number is None else number
        if chosen not in found:
            known = ", ".join(str(n) for n in sorted(found)[-8:])
            raise LinkError(f"the vehicle has no log {chosen}", f"it has {known}")
        entry = found[chosen]
        part = target.with_name(f"{target.name}.{chosen}.part")
        target.parent.mkdir(parents=True, exist_ok=True)
        self._path = self._path_of(chosen, {n: int(e.size) for n, e in found.items()})
        with part.open("a+b") as file:
            if not self._is_part(chosen, int(entry.size), file):
                file.truncate(0)
            self.by.clear()
            self._download(chosen, int(entry.size), file, on_progress)
            damaged = self._path is not None and self._differs(self._path, int(entry.size), file)
        if damaged:
            part.unlink()
            raise LinkError(f"log {chosen} is not what the vehicle has: its checksum differs", "download it again")
        part.replace(target)
        date = dt.datetime.fromtimestamp(entry.time_utc, dt.UTC).isoformat() if entry.time_utc else ""
        by = ", then ".join(dict.fromkeys(self.by)) or "LOG_REQUEST_DATA"
        return OnboardLog(chosen, date, int(entry.size), by)

    def _path_of(self, number: int, sizes: dict[int, int]) -> str | None:
        """Where MAVLink FTP has a log: the file of its size, of several that at its place in the order. None where it is not certain."""
        for folder in LOG_FOLDERS:
            listed = self._files.listing(folder)
            if listed is None:
                if not self._files.offered:
                    return None
                continue
            names = sorted(name for name, size in listed.items() if name.upper().endswith(".BIN") and size)
            same = [name for name in names if listed[name] == sizes[number]]
            place = sorted(sizes).index(number)
            if len(same) > 1:  # of files that are alike in size, the one that every other log's size agrees with
                agrees = [listed[name] for name in names] == [sizes[n] for n in sorted(sizes)]
                same = [names[place]] if agrees else []
            if same:
                return f"{folder}/{same[0]}"
        return None

    def _differs(self, path: str, size: int, file: IO[bytes]) -> bool:
        """Whether the vehicle's own checksum is another one; one that has grown since landing has none."""
        theirs = self._files.crc32(path, size)
        folder, _, name = path.rpartition("/")
        if theirs is None or (self._files.listing(folder) or {}).get(name) != size:
            return False
        return theirs != crc32_of(file)

    def _is_part(self, number: int, size: int, file: IO[bytes]) -> bool:
        """Whether what a file holds is the beginning of this log, which may have grown: by its end, asked for again."""
        have = file.seek(0, os.SEEK_END)
        begin = max(have - _OVERLAP_BYTES, 0)
        file.seek(begin)
        known = file.read()
        if not known or have > size:
            return False
        again = io.BytesIO()
        self._download(number, have, again, lambda _share: None, begin)
        return again.getvalue() == known

    def _download(
        self, number: int, size: int, file: IO[bytes], on_progress: Callable[[float], None], begin: int | None = None
    ) -> None:
        """Add to a file what it lacks up to `size`, from `begin` on where it is not the file's own length.

        By MAVLink FTP where the log is a file that it offers, and by LOG_REQUEST_DATA from where that is measured to be faster: ArduPilot
        paces its bursts (flown on its SITL: 42 kB/s against 950 kB/s).
        """
        have, to = file.seek(0, os.SEEK_END) if begin is None else begin, _Download(number, size, file, on_progress)
        if self._path is None:
            self._by_data(to, have)
            return
        rates: list[float] = []  # bytes per second of the one and the other
        for way in (self._by_file, self._by_data):
            before, began_s = have, self._session.now_s()
            have = way(to, have, _TRIAL_S)
            rates.append((have - before) / max(self._session.now_s() - began_s, 1e-3))
            self.by.append("MAVLink FTP" if way == self._by_file else "LOG_REQUEST_DATA")
            if have >= size:
                return
        quicker = self._by_data if rates[1] > rates[0] else self._by_file
        quicker(to, have)

    def _by_data(self, to: _Download, have: int, for_s: float = math.inf) -> int:
        """By LOG_REQUEST_DATA from byte `have` on, for so long: how far it came. LinkError where it stops."""
        number, size = to.number, to.size
        began_s = progress_s = self._session.now_s()
        ahead: dict[int, bytes] = {}  # what has come, by its place

        def take(message: Message) -> int:
            """Where what it has ends."""
            if message.get_type() != "LOG_DATA" or message.id != number or not message.count:
                return 0
            if have <= message.ofs < size:
                ahead[int(message.ofs)] = bytes(message.data[: message.count])
            return int(message.ofs + message.count)

        while have < size and self._session.now_s() - began_s < for_s:
            end = min((at for at in ahead if at > have), default=min(have + _WINDOW_BYTES, size))
            request = (self._system, COMPONENT_AUTOPILOT, number, have, end - have)
            self._session.send(dialect.MAVLink_log_request_data_message(*request))
            self._until(lambda message, end=end: take(message) >= end, _DATA_QUIET_S)  # type: ignore[misc]
            before = have
            while have in ahead:
                data = ahead.pop(have)
                to.file.write(data)
                have += len(data)
            to.file.flush()
            if have > before:
                progress_s = self._session.now_s()
                to.on_progress(min(have / size, 1.0))
            elif self._session.now_s() - progress_s > SILENCE_S:
                raise LinkError(
                    f"the download of log {number} stopped at {100.0 * have / size:.0f} %",
                    "move closer, and give the same command again: it goes on from there",
                )
        self._session.send(dialect.MAVLink_log_request_end_message(self._system, COMPONENT_AUTOPILOT))
        return have

    def _by_file(self, to: _Download, have: int, for_s: float = math.inf) -> int:
        """The same by MAVLink FTP, in whole bursts."""
        path, began_s = self._path or "", self._session.now_s()

        def take(data: bytes) -> None:
            nonlocal have
            to.file.write(data)
            to.file.flush()
            have += len(data)
            to.on_progress(min(have / to.size, 1.0))

        try:
            self._files.read(path, have, to.size, take, lambda: self._session.now_s() - began_s >= for_s)
        except LinkError as error:
            raise LinkError(
                f"the download of {path} stopped at {100.0 * have / to.size:.0f} %: {error.message}",
                "move closer, and give the same command again: it goes on from there",
            ) from error
        return have

    def _until(self, enough: Callable[[Message], bool], quiet_s: float) -> None:
        """Take messages in until one is enough, or for so long none of a log has come."""
        session, heard_s, done = self._session, self._session.now_s(), False

        def listen(message: Message, t_s: float) -> None:
            nonlocal heard_s, done
            if message.get_type() in ("LOG_ENTRY", "LOG_DATA"):
                heard_s, done = t_s, enough(message) or done

        session.listen(listen)
        try:
            while not done and 0.0 <= session.now_s() - heard_s < quiet_s:
                session.advance(session.now_s() + _LOOK_EVERY_S)
        finally:
            session.forget(listen)
