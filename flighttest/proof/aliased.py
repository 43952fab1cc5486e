"""Effects that no diagnosis can be asked to tell apart in the proof's campaign: what a base refit leaves of them is alike."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

# Cosine above `oracle.CONFUSABLE`, as `python -m benchmarks.aliased` finds it on quiet flights of one vehicle, every effect of usual size.
ALIASED: Mapping[str, tuple[str, ...]] = MappingProxyType({})
