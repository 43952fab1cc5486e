"""Opening logs: plain, gzip or xz, as a stream of pieces; what a file is, recognised by its first bytes."""

from __future__ import annotations

import gzip
import hashlib
import lzma
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from flighttest.errors import RecordingError

KINDS = ".BIN, .log, .tlog, .ulg, .csv, .parquet, .mat or .mcap"  # in messages
PIECE_BYTES = 16 << 20
# A log takes a third to a thirtieth of its size when compressed; what unpacks to more than this is made to fill a memory.
UNPACKED_TIMES, UNPACKED_BYTES = 100, 64 << 20
_COMPRESSED = {".gz", ".xz"}
_GZIP, _XZ = b"\x1f\x8b", b"\xfd7zXZ\x00"


def name_of(path: Path) -> str:
    """What a recording of this file is called: the file's name without its suffix, which is not all after the first dot."""
    plain = path.with_suffix("") if path.suffix.lower() in _COMPRESSED else path
    return plain.stem


class LogFile:
    """A log on disk. `pieces` streams its (decompressed) bytes; `sha256` of them is complete once the stream was read to its end.

    losses: what reading the container lost (a compressed file that breaks off).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[str] = []
        self.bytes_read = 0
        self._digest = hashlib.sha256()
        if not path.exists():
            raise RecordingError(f"{path}: no such file", "check the path")
        if path.is_dir():
            raise RecordingError(f"{path} is a folder, not a log", f"name a {KINDS} file")

    @property
    def suffix(self) -> str:
        """The log's own suffix in lower case, without .gz or .xz."""
        suffixes = [s.lower() for s in self.path.suffixes]
        if suffixes and suffixes[-1] in _COMPRESSED:
            suffixes = suffixes[:-1]
        return suffixes[-1] if suffixes else ""

    @property
    def sha256(self) -> str:
        """Of all bytes streamed so far."""
        return self._digest.hexdigest()

    @property
    def compressed(self) -> bool:
        """Whether its first bytes are those of a gzip or xz file, whatever it is called."""
        with self.path.open("rb") as raw:
            return raw.read(6).startswith((_GZIP, _XZ))

    def open(self) -> IO[bytes]:
        """The decompressed bytes as a file object."""
        try:
            with self.path.open("rb") as raw:
                magic = raw.read(6)
            if magic.startswith(_GZIP):
                return gzip.open(self.path, "rb")  # type: ignore[return-value]
            if magic == _XZ:
                return lzma.open(self.path, "rb")
            return self.path.open("rb", buffering=0)
        except OSError as error:
            raise RecordingError(
                f"{self.path}: cannot be read: {error.strerror}", "check the file's permissions"
            ) from error

    def head(self, size: int = 4096) -> bytes:
        """The first bytes, without counting as reading; RecordingError where not even one can be decompressed."""
        with self.open() as file:
            piece, broken = _read_all(file, size)
        if broken is not None and not piece:
            raise RecordingError(
                f"{self.path}: the compressed file is damaged from its start ({broken})", "copy or download it anew"
            )
        return piece

    def pieces(self, size: int = PIECE_BYTES) -> Iterator[bytes]:
        """The bytes in pieces of about `size`; a broken compressed stream ends early, which is noted in `losses`."""
        most = max(UNPACKED_TIMES * self.path.stat().st_size, UNPACKED_BYTES) if self.compressed else None
        with self.open() as file:
            broken: Exception | None = None
            while broken is None:
                try:
                    piece, broken = _read_all(file, size)
                except OSError as error:
                    raise RecordingError(f"{self.path}: reading failed: {error}", "copy the file anew") from error
                if piece:
                    self.bytes_read += len(piece)
                    if most is not None and self.bytes_read > most:
                        raise RecordingError(
                            f"{self.path}: unpacks to more than {UNPACKED_TIMES} times its size",
                            "unpack it by another program and look at what it holds",
                        )
                    self._digest.update(piece)
                    yield piece
                elif broken is None:
                    return
            self.losses.append(
                f"the compressed file is damaged after {self.bytes_read} bytes of the log ({broken}); the rest was not read"
            )


def _read_all(file: IO[bytes], size: int) -> tuple[bytes, Exception | None]:
    """Up to `size` bytes, and what broke the compressed stream: a plain `read` would lose the good bytes before the break."""
    read = getattr(file, "read1", file.read)
    parts: list[bytes] = []
    missing = size
    while missing > 0:
        try:
            part = read(missing)
        except (EOFError, lzma.LZMAError, zlib.error, gzip.BadGzipFile) as error:
            return b"".join(parts), error
        if not part:
            break
        parts.append(part)
        missing -= len(part)
    return b"".join(parts), None
