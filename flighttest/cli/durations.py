"""How long a stage of work takes: remembered from the last time on this machine, per piece where its name counts pieces."""

from __future__ import annotations

import json
import os
import re
from contextlib import suppress
from pathlib import Path

from flighttest.datafiles import write_whole

MOST_STAGES = 200
_COUNT = re.compile(r"\b(\d+)\b")


def default_path() -> Path:
    """Where durations are kept: the user's cache."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "flighttest" / "durations.json"


class Durations:
    """Seconds by stage. A cache: what cannot be read or written is no error."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seconds: dict[str, float] = {}
        with suppress(OSError, ValueError, AttributeError, TypeError):
            read = json.loads(path.read_text(encoding="utf-8"))
            self._seconds = {str(k): float(v) for k, v in read.items()}

    def expected_s(self, stage: str) -> float | None:
        """Seconds that the stage took last time, by the number of pieces where it names one; None where it was never timed."""
        key, pieces = _key(stage)
        known = self._seconds.get(key)
        return None if known is None else known * pieces

    def took(self, stage: str, seconds: float) -> None:
        """Remember it."""
        key, pieces = _key(stage)
        self._seconds.pop(key, None)
        self._seconds[key] = round(seconds / pieces, 4)
        while len(self._seconds) > MOST_STAGES:
            self._seconds.pop(next(iter(self._seconds)))
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self._path, json.dumps(self._seconds))


def _key(stage: str) -> tuple[str, float]:
    """The stage without its paths and numbers, and the first of those numbers."""
    words = " ".join("PATH" if "/" in word else word for word in stage.split())
    count = _COUNT.search(words)
    return _COUNT.sub("#", words), max(float(count[1]), 1.0) if count else 1.0
