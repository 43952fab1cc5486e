"""A clock of the host for tests."""

from __future__ import annotations


class Host:
    """A host clock that only moves when it is set."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now
