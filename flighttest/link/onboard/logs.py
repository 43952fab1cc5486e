"""Onboard logs over MAVLink: what a link loses is asked for again, and a download that was cut off goes on where it stopped."""

from __future__ import annotations

import datetime as dt
import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from flighttest.errors import InputError, LinkError
from flighttest.link.port import Port
from flighttest.link.session import Session
from flighttest.link.transport import URL_FORMS, full_url, open_transport
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, book

SILENCE_S = 20.0  # without progress for so long a download is given up
_WINDOW_BYTES = 90 * 512  # asked for at once; a LOG_DATA message has 90
_TRIES = 4
_LIST_QUIET_S, _DATA_QUIET_S = 2.0, 0.5  # without one of its messages a request is repeated
_LOOK_EVERY_S = 0.02
_OVERLAP_BYTES = 90 * 50
_SCHEMES = {
    "udpin": "udpin",
    "udp": "udpin",
    "udpout": "udpout",
    "tcp": "tcpout",
    "tcpout": "tcpout",
    "serial": "serial",
}


@dataclass(frozen=True)
class OnboardLog:
    """One log on the vehicle. date: as the vehicle states it, empty where it has no clock."""

    number: int
    date: str
    size_bytes: int


def mavsdk_url(url: str) -> str:
    """MAVSDK's form of one of our URLs. InputError for anything else."""
    kind, _, rest = full_url(url).partition(":")
    where, _, last = rest.rpartition(":")
    known = kind in _SCHEMES and bool(where) and last.isdecimal()
    if not known or (kind != "serial" and not 0 < int(last) < 65536):
        raise InputError(f"{url!r} is not a link", f"use {URL_FORMS}")
    return f"{_SCHEMES[kind]}://{rest}"


def fetch(
    url: str,
    target: Path,
    number: int | None = None,
    on_progress: Callable[[float], None] | None = None,
    key: bytes | None = None,
) -> OnboardLog:
    """Download one onboard log (the newest, or the one numbered so) into the file `target`.

    on_progress: called with the share done, 0..1. key: of MAVLink 2 signing. LinkError when nothing answers, the vehicle has no logs, or
    the download stops; what arrived until then stays beside the target, and the next call goes on from there.
    """
    session = Session(Port(open_transport(full_url(url)), key=key))
    try:
        session.connect()
        return LogDownload(session).fetch(target, number, on_progress or (lambda _share: None))
    finally:
        session.port.close()


class LogDownload:
    """Logs of a vehicle by LOG_REQUEST_LIST and LOG_REQUEST_DATA, a window at a time; what a link loses is asked for again."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._system = session.vehicle_system

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
            self._session.send(book.MAVLink_log_request_list_message(self._system, COMPONENT_AUTOPILOT, 0, 0xFFFF))
            self._until(take, _LIST_QUIET_S)
            if found and len(found) >= listed:
                break
        if not listed:
            raise LinkError("the vehicle lists no logs", "it may keep none: see LOG_BACKEND_TYPE")
        found = {n: entry for n, entry in found.items() if entry.size}
        if not found:
            raise LinkError("the vehicle has no log with anything in it", "fly first; the log begins at arming")
        return found

    def fetch(self, target: Path, number: int | None, on_progress: Callable[[float], None]) -> OnboardLog:
        """One log into a file."""
        found = self.entries()
        chosen = max(found) if number is None else number
        if chosen not in found:
            known = ", ".join(str(n) for n in sorted(found)[-8:])
            raise LinkError(f"the vehicle has no log {chosen}", f"it has {known}")
        entry = found[chosen]
        part = target.with_name(f"{target.name}.{chosen}.part")
        target.parent.mkdir(parents=True, exist_ok=True)
        with part.open("a+b") as file:
            if not self._is_part(chosen, int(entry.size), file):
                file.truncate(0)
            self._download(chosen, int(entry.size), file, on_progress)
        part.replace(target)
        date = dt.datetime.fromtimestamp(entry.time_utc, dt.UTC).isoformat() if entry.time_utc else ""
        return OnboardLog(chosen, date, int(entry.size))

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
        """Add to a file what it lacks up to `size`, from `begin` on where it is not the file's own length."""
        have, progress_s = file.seek(0, os.SEEK_END) if begin is None else begin, self._session.now_s()
        ahead: dict[int, bytes] = {}  # what has come, by its place

        def take(message: Message) -> int:
            """Where what it has ends."""
            if message.get_type() != "LOG_DATA" or message.id != number or not message.count:
                return 0
            if have <= message.ofs < size:
                ahead[int(message.ofs)] = bytes(message.data[: message.count])
            return int(message.ofs + message.count)

        while have < size:
            end = min((at for at in ahead if at > have), default=min(have + _WINDOW_BYTES, size))
            request = (self._system, COMPONENT_AUTOPILOT, number, have, end - have)
            self._session.send(book.MAVLink_log_request_data_message(*request))
            self._until(lambda message, end=end: take(message) >= end, _DATA_QUIET_S)  # type: ignore[misc]
            before = have
            while have in ahead:
                data = ahead.pop(have)
                file.write(data)
                have += len(data)
            file.flush()
            if have > before:
                progress_s = self._session.now_s()
                on_progress(min(have / size, 1.0))
            elif self._session.now_s() - progress_s > SILENCE_S:
                raise LinkError(
                    f"the download of log {number} stopped at {100.0 * have / size:.0f} %",
                    "move closer, and give the same command again: it goes on from there",
                )
        self._session.send(book.MAVLink_log_request_end_message(self._system, COMPONENT_AUTOPILOT))

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
