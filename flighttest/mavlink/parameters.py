"""Which of a parameter's values was in force while the vehicle flew."""

from __future__ import annotations

import math
from collections.abc import Iterable


def in_force(changes: Iterable[tuple[float, str, float]], until_s: float = math.inf) -> dict[str, float]:
    """Parameter name to its last value at or before `until_s`, the last moment the vehicle was armed.

    changes: (time s, name, value) in the order reported. A value that is first heard of later counts as well: a parameter is usually
    read at leisure. What is set or restored after landing does not describe the flight, though.
    """
    found: dict[str, float] = {}
    for t_s, name, value in changes:
        if name and math.isfinite(value) and (t_s <= until_s or name not in found):
            found[name] = float(value)
    return found
