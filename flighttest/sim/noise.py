"""Seeded normal numbers, drawn in blocks: one call per number costs more than the number is worth in an inner loop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

_BLOCK = 4096


class NoiseStream:
    """A stream of standard normal numbers; streams of one seed with different names are independent."""

    def __init__(self, seed: int, name: str) -> None:
        self._rng = np.random.default_rng([seed & 0xFFFFFFFF, *name.encode()])
        self._values: Iterator[float] = iter(())

    def draw(self) -> float:
        """The next number."""
        for value in self._values:
            return value
        self._values = iter(self._rng.standard_normal(_BLOCK).tolist())
        return next(self._values)
