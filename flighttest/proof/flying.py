"""One campaign flown and cut: on the built-in copter in this process, without a socket, or on a real firmware with our rotors and air."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from flighttest.flight import FlightSettings, fly
from flighttest.frames import G_M_S2
from flighttest.physics.model import Model
from flighttest.pipeline.planning.predictor import ModelPredictor
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.plan import Plan, compile_plan
from flighttest.proof.cases import Case, Generator
from flighttest.recording.model import Recording
from flighttest.script.load import parse_script
from flighttest.segments import Segment, cut
from flighttest.sim import InProcess, SimOptions
from flighttest.sim.plants.rotor_vehicle import random_rotor
from flighttest.sim.sitl.physics import launch_on_physics
from flighttest.vehicle.model import Vehicle, Zone

# Six minutes and less: every kind of step that some entry of the catalogue needs, twice, under changing headings.
CAMPAIGN = """
format: maneuver/1
name: proof
doc: a short form of the paper's campaign with tilted throttle steps and steps near the ground
identifies: []
mode: GUIDED_NOGPS
rate_hz: 50
throttle_unit: hover
limits: {tilt_target_max_deg: 35, tilt_abort_deg: 60, throttle: [0.0, 0.98], height_m: [0.4, 14], floor_m: 0.3, speed_max_m_s: 12}
reset: {to: [0, 0, 5], heading_deg: [0, 90, 180, 270], by: guided, settle_s: 1}
steps:
  - attitude_step: {axis: [roll, pitch], amplitude_rad: [0.2, 0.5], sign: both, hold_s: 1.0, coast_s: 1.5}
  - yaw_rate_step: {rate_rad_s: [1, 2], sign: both, hold_s: 0.8, coast_s: 1.5}
  - throttle_pair: {throttle_0: [0.4, 0.8], throttle_1: [1.2, 1.6, 2.0], hold_0_s: {up_to: 0.5}, record_1_s: {up_to: 1.2}}
  - throttle_pair: {throttle_0: [1.2, 1.5], throttle_1: 0.5, hold_0_s: {up_to: 0.7}, record_1_s: {up_to: 1.0}}
  - tilt_throttle:
      {axis: pitch, tilt_rad: 0.35, sign: both, throttle_0: [0.8, 1.3], throttle_1: [0.8, 1.3],
       hold_0_s: {up_to: 0.6}, record_1_s: {up_to: 0.7}}
  - throttle_pair: {throttle_0: 1.0, throttle_1: [1.15, 1.3], hold_0_s: 0.3, record_1_s: {up_to: 0.8}, height_m: 0.7}
repeat: {each: 2, order: interleaved}
"""
# A wide field, so that no draw of a vehicle finds a step too long for the zone.
ZONE = Zone(x_m=(-60.0, 60.0), y_m=(-60.0, 60.0), z_m=(0.3, 40.0), margin_m=1.0)


# Vehicle seconds per second that are not exceeded: firmware and physics step through time together, at the speed that the machine reaches.
FIRMWARE_SPEED = 20.0


class InProcessTransport:
    """A `link.transport.Transport` whose other end is a vehicle in this process."""

    def __init__(self, options: SimOptions) -> None:
        self.io = InProcess(options)

    def send(self, data: bytes) -> None:
        """To the vehicle."""
        self.io.send(data)

    def receive(self, timeout_s: float) -> bytes:
        """What the vehicle has sent; time does not advance while the client grants none."""
        return self.io.receive()

    def close(self) -> None:
        """Nothing to close."""


def case_options(case: Case, without: str = "", quiet: bool = False) -> SimOptions:
    """The sealed vehicle of a case, or its twin without one of its effects, or without noise and gusts."""
    return SimOptions(
        airframe="rotor",
        hide={k: dict(v) for k, v in case.hide.items() if k != without},
        seed=case.flight_seed,
        vehicle_seed=case.vehicle_seed,
        noise=0.0 if quiet else case.noise,
        drift=0.0 if quiet else case.drift,
        gust_rms_m_s=0.0 if quiet else case.gust_rms_m_s,
    )


def sealed_vehicle(vehicle_seed: int) -> Vehicle:
    """What is declared of a random vehicle."""
    frame = random_rotor(vehicle_seed)
    return Vehicle(
        name="sealed", connect="sim", firmware="ardupilot", nominal_voltage_v=frame.nominal_voltage_v,
        hover_throttle=frame.hover_throttle, zone=ZONE, mass_kg=frame.mass_kg,
    )  # fmt: skip


def fly_campaign(
    options: SimOptions,
    folder: Path,
    generator: Generator = "rotor",
    script: str = CAMPAIGN,
    changed: Callable[[Recording], Recording] = lambda recording: recording,
) -> tuple[Segment, ...]:
    """Fly the campaign and give what was cut from the raw log, the firmware's own where there is one; changed: before it is cut.

    FlighttestError when it could not be flown, or where no firmware is found.
    """
    frame, vehicle = random_rotor(options.vehicle_seed or 0), sealed_vehicle(options.vehicle_seed or 0)
    prior = ModelPredictor(
        Model(nominal_voltage_v=frame.nominal_voltage_v),
        {
            "K": G_M_S2 / frame.hover_throttle,
            "omega_phi": 12.0,
            "omega_theta": 12.0,
            "zeta_phi": 0.7,
            "zeta_theta": 0.7,
        },
    )
    plan = compile_plan(parse_script(script), vehicle, prior)
    recordings = _fly_firmware(plan, options, folder) if generator == "sitl" else _fly_built_in(plan, options, folder)
    return tuple(s for recording in recordings for s in cut(changed(recording)))


def _fly_built_in(plan: Plan, options: SimOptions, folder: Path) -> tuple[Recording, ...]:
    fly(plan, "sim", folder, transport=InProcessTransport(replace(options, lockstep=True)))
    return open_recordings([folder])


def _fly_firmware(plan: Plan, options: SimOptions, folder: Path) -> tuple[Recording, ...]:
    with launch_on_physics(replace(options, speed=FIRMWARE_SPEED), folder=folder / "firmware") as firmware:
        fly(plan, firmware.url, folder / "run", FlightSettings(set_params=True))
        logs = firmware.vehicle.onboard_logs
    return open_recordings(logs)
