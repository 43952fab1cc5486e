"""Onboard logs over MAVLink, by MAVSDK's log_files (which repeats what the link loses)."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flighttest.errors import InputError, LinkError
from flighttest.link.transport import URL_FORMS, full_url

CONNECT_S = 10.0
SILENCE_S = 20.0  # without progress for so long a download is given up
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
    url: str, target: Path, number: int | None = None, on_progress: Callable[[float], None] | None = None
) -> OnboardLog:
    """Download one onboard log (the newest, or the one numbered so) into the file `target`.

    on_progress: called with the share done, 0..1. LinkError when nothing answers, the vehicle has no logs, or the download stops;
    what arrived until then is removed.
    """
    from mavsdk import ComponentType, Configuration, Mavsdk  # only here: the library takes its time to load
    from mavsdk.logging import log_subscribe
    from mavsdk.plugins.log_files import LogFiles, LogFilesError

    # The library writes its own log to standard output, where results belong; what matters comes back as an error here.
    log_subscribe(lambda _level, _message, _file, _line: True)
    address = mavsdk_url(url)
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        sdk.add_any_connection(address)
        system = sdk.first_autopilot(CONNECT_S)
        if system is None:
            raise LinkError(f"nothing answers at {url}", "is the vehicle on, and the address right?")
        files = LogFiles(system)
        try:
            entries = files.get_entries()
        except LogFilesError as error:
            hint = "has it been armed since its card was erased? (LOG_BACKEND_TYPE, LOG_DISARMED)"
            raise LinkError(
                f"the vehicle at {url} lists no logs ({error.result.name.lower().replace('_', ' ')})", hint
            ) from error
        chosen = _choose(entries, number)
        _download(files, chosen, target, on_progress)
        return OnboardLog(int(chosen.id), str(chosen.date or ""), int(chosen.size_bytes))
    except LinkError:
        target.unlink(missing_ok=True)
        raise
    finally:
        # MAVSDK complains when a connection is already gone; the process must end cleanly all the same.
        with contextlib.suppress(AttributeError):
            sdk.destroy()


def _choose(entries: list[Any], number: int | None) -> Any:
    listed = sorted((e for e in entries if e.size_bytes), key=lambda e: int(e.id))
    if not listed:
        raise LinkError("the vehicle has no log with anything in it", "fly first; the log begins at arming")
    if number is None:
        return listed[-1]
    for entry in listed:
        if int(entry.id) == number:
            return entry
    known = ", ".join(str(e.id) for e in listed[-8:])
    raise LinkError(f"the vehicle has no log {number}", f"it has {known}")


def _download(files: Any, entry: Any, target: Path, on_progress: Callable[[float], None] | None) -> None:
    from mavsdk.plugins.log_files import LogFilesResult

    events: queue.Queue[tuple[Any, float]] = queue.Queue()
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)  # MAVSDK does not write over a file

    def heard(result: Any, data: Any, _user: Any) -> None:
        events.put((result, float(getattr(data, "progress", 0.0) or 0.0)))

    files.download_log_file_async(entry, str(target), heard)
    while True:
        try:
            result, share = events.get(timeout=SILENCE_S)
        except queue.Empty:
            raise LinkError(f"the download of log {entry.id} stopped", "move closer, or read the card") from None
        if result == LogFilesResult.NEXT:
            if on_progress is not None:
                on_progress(share)
            continue
        if result == LogFilesResult.SUCCESS:
            return
        raise LinkError(
            f"log {entry.id} was not downloaded: {result.name.lower().replace('_', ' ')}", "try again, or read the card"
        )
