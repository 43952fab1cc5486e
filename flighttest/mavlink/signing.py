"""MAVLink 2 signing: keys from files, frames signed with them, and frames that are not refused.

A key is 32 bytes; its file holds them as 64 hexadecimal digits (as `flighttest sign` writes it) or plainly.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import time
from pathlib import Path
from typing import Any

from flighttest.datafiles import read_bytes
from flighttest.errors import InputError
from flighttest.mavlink.dialect import Message, dialect

KEY_BYTES = 32
_SIGNATURE_BYTES = 6
_UNIX_2015_S = 1420070400  # the epoch of a signature's time stamps, which count 10 us
_TICKS_PER_S = 100_000
_BEHIND_MAX = 60 * _TICKS_PER_S  # a sender that was not heard before may be a minute behind: MAVLink's own rule


def read_key(path: Path) -> bytes:
    """The key in a file. InputError where there is none."""
    data = read_bytes(path, InputError, "signing key", 1000, "`flighttest sign` makes one").strip()
    if len(data) == KEY_BYTES:
        return data
    try:
        key = bytes.fromhex(data.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES or not any(key):
        raise InputError(
            f"{path}: this is not a signing key", "a key is 64 hexadecimal digits; `flighttest sign` makes one"
        )
    return key


def make_key(path: Path) -> bytes:
    """Write a new key that only the owner may read. InputError where the file is there already or cannot be written."""
    key = secrets.token_bytes(KEY_BYTES)
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(key.hex() + "\n")
    except OSError as error:
        raise InputError(f"{path}: the key cannot be written: {error.strerror}", "choose another place") from error
    return key


def ticks(unix_s: float) -> int:
    """A time as signatures count it."""
    return int((unix_s - _UNIX_2015_S) * _TICKS_PER_S)


def setup_message(system: int, component: int, key: bytes) -> Message:
    """What gives a vehicle its key; all zero takes it away."""
    stamp = ticks(time.time()) if any(key) else 0
    return dialect.MAVLink_setup_signing_message(system, component, list(key), stamp)


class SignedLink(dialect.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """An encoder and decoder that signs what it packs, and takes only what is signed with its key. refused: frames that were not.

    pymavlink itself takes the time stamp of a frame before it looks at the signature: one false frame from the future would shut the
    vehicle out.
    """

    def __init__(self, system: int, component: int, key: bytes) -> None:
        super().__init__(None, srcSystem=system, srcComponent=component)
        self.robust_parsing = True
        self.refused = 0
        self.signing.secret_key = key
        self.signing.sign_outgoing = True
        self.signing.allow_unsigned_callback = self._refuse
        self.now()

    def now(self) -> None:
        """Let time stamps follow the clock of this computer; they never go back."""
        self.signing.timestamp = max(self.signing.timestamp, ticks(time.time()))

    def _refuse(self, _mav: Any, _message_id: int) -> bool:
        self.refused += 1
        return False

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # pymavlink's names
        """Whether a frame is signed with the key, and is newer than those before."""
        right = hashlib.sha256(self.signing.secret_key + bytes(msgbuf[:-_SIGNATURE_BYTES])).digest()[:_SIGNATURE_BYTES]
        if not hmac.compare_digest(right, bytes(msgbuf[-_SIGNATURE_BYTES:])):
            return False
        stamp = int.from_bytes(msgbuf[-12:-6], "little")
        stream = (msgbuf[-13], srcSystem, srcComponent)
        before = self.signing.stream_timestamps.get(stream)
        if stamp <= before if before is not None else stamp + _BEHIND_MAX < self.signing.timestamp:
            return False
        self.signing.stream_timestamps[stream] = stamp
        self.signing.timestamp = max(self.signing.timestamp, stamp)
        return True
