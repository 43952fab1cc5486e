"""The built-in vehicle, or a real ArduPilot SITL, for any client."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypedDict, cast

from flighttest.errors import InputError
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.report.numbers import join
from flighttest.sim import SimOptions, parse_hide, start_simulator
from flighttest.sim.sitl.launcher import Sitl, SitlOptions, find_arducopter, launch
from flighttest.sim.sitl.physics import PhysicsSitl, launch_on_physics
from flighttest.twin import firmware
from flighttest.twin.vehicle import assumed, simulator_options

_BOOT_S = 45  # until the firmware's position estimate stands
SYSTEM_ID = 1  # of the built-in vehicle and of ArduPilot alike


class ServingData(TypedDict):
    """What a program needs to connect, as `flighttest sim --json` prints it."""

    url: str
    airframe: str
    backend: str
    seed: int
    speed: float
    lockstep: bool
    hide: tuple[str, ...]
    model: str
    port: int
    system_id: int


@dataclass(frozen=True)
class Serving:
    """A vehicle that can be connected to, as a program needs it. hide: as typed; speed: times real time."""

    url: str
    airframe: str
    backend: str
    seed: int
    speed: float
    lockstep: bool
    hide: tuple[str, ...]
    model: str = ""

    def data(self) -> ServingData:
        """Its fields, with the port and the MAVLink system id."""
        found = asdict(self) | {"port": int(self.url.rsplit(":", 1)[1]), "system_id": SYSTEM_ID}
        return cast(ServingData, found)

    @property
    def sentences(self) -> tuple[str, str]:
        """What it is, and how to fly it."""
        if self.backend == "sitl":
            flown = f"the vehicle of {self.model}" if self.model else f"airframe {self.airframe}"
            what = f"ArduPilot SITL, {flown}, at {self.url}"
        elif self.model:
            what = f"the vehicle of {self.model} (seed {self.seed}) at {self.url}"
        else:
            what = f"simulated copter ({self.airframe} airframe, seed {self.seed}) at {self.url}"
        thrust = "thrust_hover" if self.model else "thrust"  # throttles of a model's vehicle go by its hover throttle
        return f"{what}; Ctrl-C stops it", f"fly it: flighttest run {thrust} roll_pitch yaw_rate --connect {self.url}"


def options(airframe: str, hide: Sequence[str], seed: int, speed: float = 1.0, lockstep: bool = False) -> SimOptions:
    """The built-in vehicle as `SimOptions`. hide: id:key=value words."""
    return SimOptions(airframe=airframe, hide=parse_hide(hide), seed=seed, speed=speed, lockstep=lockstep)  # type: ignore[arg-type]


def of_model(
    stored: ModelFile, hide: Sequence[str], seed: int, speed: float = 1.0, lockstep: bool = False
) -> SimOptions:
    """The vehicle of a model as `SimOptions`."""
    return simulator_options(stored, parse_hide(hide), seed=seed, speed=speed, lockstep=lockstep)


@dataclass(frozen=True)
class Served:
    """A vehicle to serve. hide: id:key=value words; model: flies instead of an airframe; frame: folder of an exported ArduPilot
    vehicle; port: 0 takes a free one."""

    airframe: str = "paper"
    backend: str = "builtin"
    hide: Sequence[str] = ()
    seed: int = 1
    port: int = 0
    speed: float = 1.0
    lockstep: bool = False
    model: Path | None = None
    frame: Path | None = None


def serve(asked: Served) -> Iterator[str | Serving]:
    """Serve until interrupted; yields what is going on, and once it can be connected to, where."""
    airframe, backend, hide, seed = asked.airframe, asked.backend, asked.hide, asked.seed
    port, speed, lockstep, model, frame = asked.port, asked.speed, asked.lockstep, asked.model, asked.frame
    if frame is not None and (backend != "sitl" or model is not None):
        raise InputError(
            "--frame works with ArduPilot's own physics only", "give --frame DIR with --backend sitl, without --model"
        )
    if frame is not None and not (frame / "vehicle.json").is_file():
        raise InputError(
            f"{frame} holds no vehicle.json", f"write one: flighttest export MODEL --to ardupilot -o {frame}"
        )
    if backend == "sitl":
        if lockstep:
            raise InputError(
                "--lockstep works with the built-in vehicle only: a SITL has its own clock", "leave it out"
            )
        yield from _serve_sitl(airframe, hide, seed, port, speed, model, frame)
        return
    made = options(airframe, hide, seed, speed, lockstep)
    if model is not None:
        stored = model_file.read(model, whole=True)
        made = of_model(stored, hide, seed, speed, lockstep)
        if assumed(stored):
            yield f"no flight of the model determined {join(assumed(stored))}: assumed"
    with start_simulator(made, port=port) as simulation:
        yield Serving(
            simulation.url, airframe, backend, seed, speed, lockstep, tuple(hide), str(model) if model else ""
        )
        simulation.wait()


def _serve_sitl(
    airframe: str, hide: Sequence[str], seed: int, port: int, speed: float, model: Path | None, frame: Path | None
) -> Iterator[str | Serving]:
    if hide and (airframe != "rotor" or model is not None or frame is not None):
        raise InputError(
            "ArduPilot's own physics conceals no effects"
            if model is None
            else "a model under the real firmware flies without further effects",
            "use --airframe rotor, which flies the firmware on our physics",
        )
    physics = None
    if model is not None:
        find_arducopter()
        physics, fitted = firmware.firmware_options(model_file.read(model, whole=True), seed=seed, speed=speed)
        yield from fitted.sentences
    elif airframe == "rotor" and frame is None:
        physics = options(airframe, hide, seed, speed)
    flown = model or frame
    what = f"airframe {airframe}" if flown is None else f"the vehicle of {flown}"
    yield f"starting ArduPilot SITL, {what}; it can arm after {_BOOT_S} s or so of its own time"
    if physics is not None:
        started: Sitl | PhysicsSitl = launch_on_physics(physics, port=port)
    else:
        started = launch(SitlOptions(airframe=airframe, speedup=speed, ground_crew=True, port=port, frame=frame))
    with started as vehicle:
        yield Serving(vehicle.url, airframe, "sitl", seed, speed, False, tuple(hide), str(flown) if flown else "")
        vehicle.wait()
