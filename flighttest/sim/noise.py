"""Seeded normal numbers, drawn in blocks: one call of numpy per number costs more than the number is worth in an inner loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

_BLOCK = 4096


class NoiseStream:
    """A stream of standard normal numbers; streams of one seed with different names are independent. draw: gives the next number."""

    def __init__(self, seed: int, name: str) -> None:
        self.draw: Callable[[], float] = _numbers(np.random.default_rng([seed & 0xFFFFFFFF, *name.encode()])).__next__


def _numbers(rng: np.random.Generator) -> Iterator[float]:
    while True:
        yield from rng.standard_normal(_BLOCK).tolist()
