"""Opening logs: plain, gzip or xz, as a stream of pieces; what a file is, told from its first bytes."""

from __future__ import annotations

import gzip
import hashlib
import lzma
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from flighttest.errors import RecordingError

PIECE_BYTES = 16 << 20
_COMPRESSED = {".gz", ".xz"}


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
            raise RecordingError(f"{path} is a folder, not a log", "name a .BIN, .tlog, .ulg, .csv or .parquet file")

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

    def open(self) -> IO[bytes]:
        """The decompressed bytes as a file object."""
        try:
            with self.path.open("rb") as raw:
                magic = raw.read(6)
            if magic[:2] == b"\x1f\x8b":
                return gzip.open(self.path, "rb")  # type: ignore[return-value]
            if magic == b"\xfd7zXZ\x00":
                return lzma.open(self.path, "rb")
            return self.path.open("rb", buffering=0)
        except OSError as error:
            raise RecordingError(
                f"{self.path}: cannot be read: {error.strerror}", "check the file's permissions"
            ) from error

    def head(self, size: int = 4096) -> bytes:
        """The first bytes, without counting as reading; empty where even they cannot be decompressed."""
        with self.open() as file:
            try:
                return file.read(size)
            except (EOFError, OSError, lzma.LZMAError, zlib.error):
                return b""

    def pieces(self, size: int = PIECE_BYTES) -> Iterator[bytes]:
        """The bytes in pieces of about `size`; a broken compressed stream ends early and says so in `losses`."""
        with self.open() as file:
            while True:
                try:
                    piece = file.read(size)
                except (EOFError, lzma.LZMAError, zlib.error, gzip.BadGzipFile) as error:
                    self.losses.append(
                        f"the compressed file is damaged after {self.bytes_read} bytes of the log ({error}); the rest was not read"
                    )
                    return
                except OSError as error:
                    raise RecordingError(f"{self.path}: reading failed: {error}", "copy the file anew") from error
                if not piece:
                    return
                self.bytes_read += len(piece)
                self._digest.update(piece)
                yield piece
