"""The fingerprint of the vehicle behind recordings, as model.yaml carries it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flighttest.recording import Recording
from flighttest.vehicle.model import Vehicle


def of_recordings(recordings: Sequence[Recording], vehicle: Vehicle | None) -> dict[str, Any]:
    """From the newest recording that knows each part; the vehicle file's components where a recording has none."""
    return {}
