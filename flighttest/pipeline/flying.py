"""`flighttest run`: compile, connect, preflight, fly, then everything that follows from the recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flighttest.errors import InputError
from flighttest.vehicle.load import load_vehicle

BUILTIN_SPEED = 20.0
BUILTIN = "sim"


@dataclass(frozen=True)
class FlightRequest:
    """What was asked for on the command line."""

    scripts: tuple[str, ...]
    vehicle: Path | None = None
    connect: str | None = None
    out: Path = Path("runs")
    speed: float | None = None
    seed: int = 1
    airframe: str = "paper"
    hide: tuple[str, ...] = ()
    model: Path | None = None
    fly_only: bool = False
    resume: Path | None = None
    set_params: bool = False
    waive: tuple[str, ...] = ()


def target(request: FlightRequest) -> str:
    """The URL that will be flown: --connect, else the vehicle file's, else the built-in vehicle. Never anything by default."""
    if request.connect is not None:
        return request.connect
    if request.vehicle is not None:
        declared = load_vehicle(request.vehicle)
        if declared.connect is None:
            raise InputError(f"{request.vehicle} names no connection", "add `connect:` to it, or give --connect URL")
        return declared.connect
    return BUILTIN
