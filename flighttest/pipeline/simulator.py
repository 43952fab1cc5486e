"""The built-in vehicle, or a real ArduPilot SITL, for whoever wants to connect to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flighttest.errors import InputError
from flighttest.sim import SimOptions, parse_hide, start_simulator
from flighttest.sim.sitl_launcher import Sitl, SitlOptions, launch
from flighttest.sim.sitl_physics import PhysicsSitl, launch_on_physics

_BOOT_S = 45  # until the firmware's position estimate stands


def options(airframe: str, hide: Sequence[str], seed: int, speed: float = 1.0, lockstep: bool = False) -> SimOptions:
    """The words of the command line as `SimOptions`."""
    return SimOptions(airframe=airframe, hide=parse_hide(hide), seed=seed, speed=speed, lockstep=lockstep)  # type: ignore[arg-type]


def serve(
    airframe: str, backend: str, hide: Sequence[str], seed: int, port: int, speed: float, lockstep: bool
) -> Iterator[str]:
    """Serve until interrupted; yields lines for the person at the terminal."""
    if backend == "sitl":
        if lockstep:
            raise InputError("a SITL keeps its own clock: --lockstep is of the built-in vehicle", "leave it out")
        yield from _serve_sitl(airframe, hide, seed, port, speed)
        return
    made = options(airframe, hide, seed, speed, lockstep)
    with start_simulator(made, port=port) as simulation:
        yield f"simulated copter ({airframe} airframe, seed {seed}) at {simulation.url}; Ctrl-C stops it"
        yield f"fly it: flighttest run thrust --connect {simulation.url}"
        simulation.wait()


def _serve_sitl(airframe: str, hide: Sequence[str], seed: int, port: int, speed: float) -> Iterator[str]:
    if hide and airframe != "rotor":
        raise InputError(
            "ArduPilot's own physics hides nothing", "use --airframe rotor, which flies the firmware on our physics"
        )
    yield f"starting ArduPilot SITL, airframe {airframe}; it can arm after {_BOOT_S} s or so of its own time"
    if airframe == "rotor":
        started: Sitl | PhysicsSitl = launch_on_physics(options(airframe, hide, seed, speed), port=port)
    else:
        started = launch(SitlOptions(airframe=airframe, speedup=speed, ground_crew=True, port=port))
    with started as vehicle:
        yield f"ArduPilot SITL, airframe {airframe}, at {vehicle.url}; Ctrl-C stops it"
        yield f"fly it: flighttest run thrust --connect {vehicle.url}"
        vehicle.wait()
