"""`flighttest sign`: give a vehicle a MAVLink 2 signing key, or take it away, and see that it answers with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flighttest.errors import LinkError
from flighttest.flight.preparation.preflight import refuse_other_vehicles
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import open_transport
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT
from flighttest.mavlink.signing import KEY_BYTES, make_key, read_key, setup_message
from flighttest.pipeline.results import SILENT, Progress, Result
from flighttest.report.document import Document

_TIMES = 3  # a lost frame must not leave the vehicle without its key
_SETTLE_S = 1.0


@contextmanager
def _talk(url: str, key: bytes | None, *, any_vehicle: bool = False) -> Iterator[Session]:
    session = Session(MavlinkPort(open_transport(url), key=key))
    try:
        beat = session.connect()
        if not any_vehicle:
            refuse_other_vehicles(beat)
        yield session
    finally:
        session.port.close()


def _send(session: Session, key: bytes) -> None:
    for _ in range(_TIMES):
        session.send(setup_message(session.vehicle_system, COMPONENT_AUTOPILOT, key))
        session.advance(session.now_s() + _SETTLE_S / _TIMES)


def _takes(url: str, key: bytes) -> bool:
    try:
        with _talk(url, key) as session:
            return session.offset is not None
    except LinkError:
        return False


def sign(url: str, path: Path, remove: bool = False, progress: Progress = SILENT) -> Result:
    """Give the vehicle at `url` the key in `path` (made where there is none), or take it away. LinkError where it does not take it, or
    where it is no multirotor: from any vehicle a key is only taken away."""
    known = read_key(path) if remove or path.exists() else None
    if remove and known is not None:
        with _talk(url, known, any_vehicle=True) as session:
            _send(session, bytes(KEY_BYTES))
        with _talk(url, None, any_vehicle=True) as session:
            if session.offset is None:
                raise LinkError("the vehicle still takes signed frames only", "try again over its USB port")
        return _result(f"The vehicle at {url} takes unsigned frames again.", url, path, False)
    if known is not None and _takes(url, known):
        return _result(f"The vehicle at {url} has this key already.", url, path, True)
    with _talk(url, None) as session:
        key = known or make_key(path)
        if known is None:
            progress.stage(f"a new key is in {path}: who has this file can fly the vehicle")
        progress.stage(f"giving the key to the vehicle at {url}; it crosses this link in the clear, so use a cable")
        _send(session, key)
    if not _takes(url, key):
        raise LinkError("the vehicle did not take the key", "disarm it, and try over its USB port")
    return _result(f"The vehicle at {url} signs its frames and answers signed ones.", url, path, True)


def _result(sentence: str, url: str, path: Path, signs: bool) -> Result:
    facts = {"key": str(path), "fly with": f"flighttest run ... --signing-key {path}"} if signs else {}
    return Result(Document("sign", sentence, "good", (), facts), {"connect": url, "key": str(path), "signs": signs})
