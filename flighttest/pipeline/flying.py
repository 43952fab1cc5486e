"""`flighttest run`: compile, connect, preflight, fly, then everything that follows from the recording."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from flighttest.errors import InputError
from flighttest.identify import model_file
from flighttest.identify.model_file import ModelFile
from flighttest.pipeline.history import campaigns, vehicle_name
from flighttest.pipeline.simulator import options
from flighttest.sim import start_simulator
from flighttest.vehicle.default import DEFAULT_VEHICLE
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import Vehicle

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


def announce(request: FlightRequest) -> str:
    """The first line of a run: what is about to fly."""
    url = target(request)
    if url == BUILTIN:
        effects = f", hiding {', '.join(request.hide)}" if request.hide else ""
        chosen = "" if request.connect or request.vehicle else "; a real one needs --vehicle or --connect"
        return f"flying the built-in simulated copter ({request.airframe} airframe{effects}){chosen}"
    return f"flying the vehicle at {url}"


def needs_consent(request: FlightRequest) -> bool:
    """A person must say yes before anything real arms."""
    return target(request) != BUILTIN


def declared_vehicle(request: FlightRequest) -> Vehicle:
    """The vehicle file, or the built-in one's."""
    return load_vehicle(request.vehicle) if request.vehicle is not None else DEFAULT_VEHICLE


@contextmanager
def connection(request: FlightRequest) -> Iterator[str]:
    """The URL to fly at; starts the built-in vehicle on a free port of this machine where that is what flies."""
    url = target(request)
    if request.hide and url != BUILTIN:
        raise InputError(
            "--hide is for the built-in vehicle", "leave out --connect and --vehicle, or use --connect sim"
        )
    if url != BUILTIN:
        yield url
        return
    made = options(request.airframe, request.hide, request.seed, request.speed or BUILTIN_SPEED)
    with start_simulator(made) as simulation:
        yield simulation.url


def new_run(out: Path, script: str, now: datetime.datetime) -> Path:
    """A run folder that does not exist yet, named by time and script."""
    base = out / f"{now:%Y-%m-%dT%H-%M-%S}-{script}"
    folder, count = base, 2
    while folder.exists():
        folder, count = base.with_name(f"{base.name}-{count}"), count + 1
    return folder


def previous_model(request: FlightRequest, vehicle: Vehicle) -> ModelFile | None:
    """The model to compare with: the one named, else the last one fitted in the folder of runs for a vehicle of this name."""
    if request.model is not None:
        return model_file.read(request.model)
    known = [c for c in campaigns(request.out) if vehicle_name(c.folder) in ("", vehicle.name)]
    return known[-1].model if known else None
