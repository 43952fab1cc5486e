"""Two flights of one vehicle in winds that an instrument of its own measured: does a diagnosis of both distinguish these winds?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.diagnose.records import DiagnosisData
from flighttest.identify.free_flight.winds import WIND, WIND_TERM

STANDARD_ERRORS = 2.0
WITHIN_M_S = 1.0  # of a calibration of fans, and of what a fan's stream varies by over a figure of eight
CHANGED = "change"  # what a difference between two flights or campaigns is called among the names
ANOTHER = "another change"  # a difference of winds, of a wrong size or direction

Wind = tuple[float, float]  # north, west, m/s


def agrees(found_m_s: float, known_m_s: float, std_m_s: float) -> bool:
    """Whether an estimate is within two standard errors, or within 1 m/s, of what was measured."""
    return abs(found_m_s - known_m_s) <= max(STANDARD_ERRORS * std_m_s, WITHIN_M_S)


@dataclass(frozen=True)
class WindDifference:
    """Wind of the second of two flights less that of the first, as a diagnosis of both estimates it: (north, west), m/s, and standard
    errors, those of both flights added as if independent."""

    value: Wind
    std: Wind

    def agrees(self, known: Wind) -> bool:
        """Whether the vector that is missing to the known difference is within two standard errors along itself, or shorter than 1 m/s."""
        missing = np.subtract(self.value, known)
        length = float(np.hypot(*missing))
        along = missing / max(length, 1e-9)
        return agrees(length, 0.0, float(np.hypot(*(along * self.std))))


def wind_difference(found: DiagnosisData, flights: Sequence[str]) -> WindDifference | None:
    """Of the winds in diagnosis.json; None where no steady wind is named. flights: names of both, in order."""
    rows = {w["flight"]: w for w in found.get("winds", [])}
    if WIND_TERM not in {f["term"] for f in found["findings"]} or not set(flights) <= rows.keys():
        return None
    first, second = (rows[f] for f in flights)
    return WindDifference(
        (second["w_north"] - first["w_north"], second["w_west"] - first["w_west"]),
        (
            float(np.hypot(first["w_north_std"], second["w_north_std"])),
            float(np.hypot(first["w_west_std"], second["w_west_std"])),
        ),
    )


def named_change(found: WindDifference | None, known: Wind) -> tuple[str, ...]:
    """What a diagnosis says of two winds that differ by `known`: nothing where it names no steady wind or they agree, else a change."""
    if found is None or found.agrees((0.0, 0.0)):
        return ()
    return (CHANGED,) if found.agrees(known) or not any(known) else (ANOTHER,)


def compared_values(
    found: WindDifference | None, known: Wind
) -> dict[str, dict[str, tuple[float, float, float, float]]]:
    """As `Outcome.values`: (true, found, two standard errors below, above) of the difference along each axis; nan where none is named."""
    nothing = (float("nan"),) * 2
    value, std = (found.value, found.std) if found is not None else (nothing, nothing)
    return {
        WIND_TERM: {
            name: (true, v, v - STANDARD_ERRORS * s, v + STANDARD_ERRORS * s)
            for name, true, v, s in zip(WIND, known, value, std, strict=True)
        }
    }
