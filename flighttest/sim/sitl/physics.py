"""A real ArduPilot firmware on the rotor vehicle's physics, or an identified one's: both processes, started and stopped together.

The physics runs in a process of its own (one core), the firmware in another; the ground program has its url and nothing else, so no
truth can reach a recording. What it sends passes through the physics' process (`relay`), so that both can step through time together.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from math import sqrt
from pathlib import Path
from types import TracebackType

from flighttest.errors import InputError
from flighttest.sim.hidden_values import check_values
from flighttest.sim.noise import NoiseStream
from flighttest.sim.options import SimOptions
from flighttest.sim.plants.battery import Battery
from flighttest.sim.plants.plant_motors import MotorPlant
from flighttest.sim.plants.rotor_vehicle import RotorVehicle, random_rotor
from flighttest.sim.plants.weather import Air, Gusts
from flighttest.sim.ports import listen
from flighttest.sim.sensors import SensorNoise
from flighttest.sim.sitl.json_backend import RATE_HZ, JsonBackend, MotorDriven, bind_physics
from flighttest.sim.sitl.launcher import Sitl, SitlOptions, free_ports, launch, sitl_dir
from flighttest.sim.sitl.relay import Relay

_HOST = "127.0.0.1"
_STOP_PATIENCE_S = 3.0
# Full roll of ArduCopter's stock simulated quadrotor makes 404 rad/s^2. About half the default gain: these rotors have a lag, the
# stock ones have none.
_STOCK_ROLL_RAD_S2, _ROLL_P, _ROLL_D = 404.0, 0.07, 0.0015
# A yaw rate loop of this bandwidth rings behind the stock error filter of 2.5 Hz and heading gain of 4.5: a pilot would tune both.
_YAW_BANDWIDTH_1_S, _YAW_FILTER_HZ, _HEADING_P = 10.0, 20.0, 2.0
_GAIN_LIMITS = (0.01, 0.5)


def rotor_vehicle(options: SimOptions) -> RotorVehicle:
    """The vehicle these options mean."""
    if options.airframe != "rotor":
        raise InputError("ArduPilot flies only the rotor airframe", "use --airframe rotor")
    drawn = RotorVehicle() if options.vehicle_seed is None else random_rotor(options.vehicle_seed)
    return drawn.changed(options.vehicle)


def build_motor_plant(options: SimOptions) -> MotorDriven:
    """The plant of these options, motor by motor."""
    air = None
    if options.gust_rms_m_s > 0.0:
        air = Air(Gusts(options.gust_rms_m_s), NoiseStream(options.seed, "gusts"))
    if options.model is not None:
        from flighttest.sim.plant_frame import FramePlant  # only here: CasADi takes its time to load

        pack = Battery(capacity_ah=options.capacity_ah or 5.0, **options.model.get("battery", {}))
        if options.voltage_v is not None:
            pack.replace(options.voltage_v)
        return FramePlant(options.model, pack, air)
    check_values(options.hide)
    vehicle = rotor_vehicle(options)
    battery = Battery(vehicle.cells, options.capacity_ah or vehicle.capacity_ah, vehicle.resistance_ohm)
    if options.voltage_v is not None:
        battery.replace(options.voltage_v)
    return MotorPlant(vehicle, options.hide, battery, air)


def firmware_parameters(options: SimOptions) -> dict[str, float]:
    """What a builder of this vehicle would set: frame, hover throttle, battery, rate gains scaled by its moment over inertia. Of an
    identified model, what its options are."""
    if options.model is not None:
        return {"BATT_CAPACITY": 1000.0 * (options.capacity_ah or 5.0), **options.parameters}
    v = rotor_vehicle(options)
    share = 0.5 / sqrt(2.0) if v.rotors == 4 else 0.25  # moment of full roll as a share of thrust times arm

    def gain(reference: float, moment: float, inertia: float) -> float:
        low, high = _GAIN_LIMITS
        return min(max(reference * _STOCK_ROLL_RAD_S2 * inertia / moment, low), high)

    moment = share * v.thrust_max_n * v.arm_m
    roll, pitch = gain(_ROLL_P, moment, v.inertia_x_kg_m2), gain(_ROLL_P, moment, v.inertia_y_kg_m2)
    yaw = _YAW_BANDWIDTH_1_S * v.inertia_z_kg_m2 / (0.5 * v.thrust_max_n * v.yaw_arm_m)
    d = _ROLL_D / _ROLL_P
    return {
        "FRAME_CLASS": 1.0 if v.rotors == 4 else 2.0,
        "MOT_THST_HOVER": min(max(v.hover_throttle, 0.125), 0.68),
        "BATT_CAPACITY": 1000.0 * (options.capacity_ah or v.capacity_ah),
        "ATC_RAT_RLL_P": roll,
        "ATC_RAT_RLL_I": roll,
        "ATC_RAT_RLL_D": roll * d,
        "ATC_RAT_PIT_P": pitch,
        "ATC_RAT_PIT_I": pitch,
        "ATC_RAT_PIT_D": pitch * d,
        "ATC_RAT_YAW_P": yaw,
        "ATC_RAT_YAW_I": 0.1 * yaw,
        "ATC_RAT_YAW_FLTE": _YAW_FILTER_HZ,
        "ATC_ANG_YAW_P": _HEADING_P,
        **options.parameters,
    }


class PhysicsSitl:
    """A firmware on our physics. url: where a ground program connects; vehicle: the `Sitl`; stopped when the `with` block ends."""

    def __init__(self, vehicle: Sitl, physics: subprocess.Popen[bytes], url: str) -> None:
        self.vehicle, self._physics, self.url = vehicle, physics, url

    @property
    def alive(self) -> bool:
        """Whether both run."""
        return self.vehicle.alive and self._physics.poll() is None

    def wait(self) -> None:
        """Until the firmware ends by itself."""
        self.vehicle.wait()

    def stop(self) -> None:
        """End both; a second call does nothing."""
        self.vehicle.stop()
        stop_physics(self._physics)

    def __enter__(self) -> PhysicsSitl:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()


def launch_on_physics(
    options: SimOptions, *, folder: Path | None = None, wait_s: float = 180.0, binary: Path | None = None, port: int = 0
) -> PhysicsSitl:
    """Start the rotor vehicle of `options` under a real ArduCopter and wait until it can arm. port: of the url, 0 takes a free one.
    LinkError, InputError as `launch`."""
    parameters = firmware_parameters(options)
    listening = listen(_HOST, port)
    sock = bind_physics(_HOST, 0)
    url, physics_port = f"tcp:{_HOST}:{listening.getsockname()[1]}", int(sock.getsockname()[1])
    base = free_ports()
    physics = start_physics(sock, options, (listening, base))
    shipped = sitl_dir()
    try:
        vehicle = launch(
            SitlOptions(
                airframe="rotor",
                speedup=options.speed,
                parameters=parameters,
                physics_port=physics_port,
                rate_hz=RATE_HZ,
                scripts=(shipped / "scripts" / "battery.lua",),
                folder=folder,
                port=base,
            ),
            wait_s=wait_s,
            binary=binary,
        )
    except BaseException:
        stop_physics(physics)
        raise
    return PhysicsSitl(vehicle, physics, url)


def start_physics(
    sock: socket.socket, options: SimOptions, relayed: tuple[socket.socket, int] | None = None
) -> subprocess.Popen[bytes]:
    """The physics in a process of its own, on a bound UDP socket that it takes over. relayed: where ground programs connect, and the port
    of the firmware they are to reach."""
    build_motor_plant(options)  # raise here, with its hint, what the child would only die of
    sockets = [sock, *([relayed[0]] if relayed else [])]
    words = [sys.executable, "-m", "flighttest.sim.sitl.physics", str(sock.fileno()), options.to_json()]
    words += [str(relayed[0].fileno()), str(relayed[1])] if relayed else []
    descriptors = tuple(s.fileno() for s in sockets)
    process = subprocess.Popen(words, stdin=subprocess.PIPE, pass_fds=descriptors, start_new_session=True)
    for one in sockets:
        one.close()
    return process


def stop_physics(process: subprocess.Popen[bytes]) -> None:
    """End it: it watches its standard input."""
    if process.stdin is not None and not process.stdin.closed:
        process.stdin.close()
    try:
        process.wait(_STOP_PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def serve_physics(descriptor: int, options: SimOptions, listening: int | None = None, firmware_port: int = 0) -> None:
    """The child's part: serve until the parent's end of our standard input closes."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM, fileno=descriptor)
    relay = None
    if listening is not None:
        relay = Relay(socket.socket(socket.AF_INET, socket.SOCK_STREAM, fileno=listening), (_HOST, firmware_port))
    noise = SensorNoise(**(options.model.get("noise", {}) if options.model else {})).scaled(options.noise)
    plant = build_motor_plant(options)
    backend = JsonBackend(plant, sock=sock, noise=noise, seed=options.seed, rested_v=options.voltage_v)

    def watch() -> None:
        while os.read(0, 4096):
            pass
        backend.finish()

    threading.Thread(target=watch, daemon=True).start()
    backend.run(relay)


if __name__ == "__main__":
    serve_physics(int(sys.argv[1]), SimOptions.from_json(sys.argv[2]), *map(int, sys.argv[3:]))
