"""The vehicle as it is now, over the link: firmware and parameters. Asks, and never arms, sets or starts anything."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from flighttest.flight.preparation.preflight import THRUST_AS_THRUST, refuse_other_vehicles
from flighttest.link import parameters as params
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session
from flighttest.link.transport import open_transport
from flighttest.mavlink.dialect import dialect
from flighttest.mavlink.signing import read_key
from flighttest.pipeline.results import SILENT, Progress
from flighttest.pipeline.vehicles.simulator import options
from flighttest.sim import start_simulator
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import DEFAULT_VEHICLE

BUILTIN = "sim"
_NAMES = {dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduCopter", dialect.MAV_AUTOPILOT_PX4: "PX4"}


@dataclass(frozen=True)
class LiveVehicle:
    """What a vehicle reports of itself. parameters: all of them, as they will be in force in a flight of ours."""

    url: str
    firmware: str
    parameters: dict[str, float]

    @property
    def sentence(self) -> str:
        """In words."""
        return f"{self.url}: {self.firmware or 'firmware not stated'}, {len(self.parameters)} parameters read"


def read_vehicle(url: str, progress: Progress = SILENT, key: bytes | None = None) -> LiveVehicle:
    """Connect, read, disconnect. `sim` is the built-in vehicle; key: of MAVLink 2 signing. LinkError when nothing answers, or no
    multirotor."""
    with _built_in() if url == BUILTIN else nullcontext(url) as where:
        progress.stage(f"reading the vehicle at {url}; nothing is set, nothing arms")
        session = Session(MavlinkPort(open_transport(where), key=None if url == BUILTIN else key))
        try:
            beat = session.connect()
            refuse_other_vehicles(beat)
            found = params.read_all(session)
            version = ArduPilot(session).firmware()
        finally:
            session.port.close()
    family = _NAMES.get(beat.autopilot, "")
    if beat.autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA and "GUID_OPTIONS" in found:
        # Every flight sets this bit before it arms, and restores it: models are of the vehicle with it.
        found["GUID_OPTIONS"] = float(int(found["GUID_OPTIONS"]) | THRUST_AS_THRUST)
    return LiveVehicle(url, f"{family} {version}".strip() if version else "", found)


def key_for(signing_key: Path | None, vehicle: Path | None) -> bytes | None:
    """The key that frames are signed with: of the file named, else of the one that the vehicle file names."""
    named = signing_key or (load_vehicle(vehicle, to_fly=False).signing_key if vehicle is not None else None)
    return read_key(Path(named)) if named is not None else None


@contextmanager
def _built_in() -> Iterator[str]:
    with start_simulator(options(DEFAULT_VEHICLE.name, (), 1, 10.0)) as simulation:
        yield simulation.url


def hello(url: str, key: bytes | None = None) -> str:
    """What answers at a URL, in words. `sim` is the built-in vehicle, started for it. LinkError when nothing does, or
    no multirotor."""
    with _built_in() if url == BUILTIN else nullcontext(url) as where:
        session = Session(MavlinkPort(open_transport(where), key=None if url == BUILTIN else key))
        try:
            beat = session.connect()
            refuse_other_vehicles(beat)
            return f"{url}: {_NAMES.get(beat.autopilot, 'autopilot')} {ArduPilot(session).firmware()}".strip()
        finally:
            session.port.close()
