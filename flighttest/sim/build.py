"""From `SimOptions` to a vehicle that can be flown."""

from __future__ import annotations

import time
from dataclasses import replace

from flighttest.sim.autopilot.copter import Autopilot
from flighttest.sim.autopilot.safety import MODE_SWITCH_S, Boot
from flighttest.sim.hidden_values import check_values
from flighttest.sim.noise import NoiseStream
from flighttest.sim.options import SimOptions
from flighttest.sim.plants.battery import Battery
from flighttest.sim.plants.plant import IdentifiedVehicle, Plant
from flighttest.sim.plants.plant_paper import PaperParameters, PaperPlant
from flighttest.sim.plants.plant_rotor import RotorPlant
from flighttest.sim.plants.rotor_vehicle import RotorVehicle, random_rotor
from flighttest.sim.plants.weather import Air, Gusts
from flighttest.sim.sensors import SensorNoise
from flighttest.sim.wire import UNIX_2015_S

# Standard deviation of an accelerometer's bias, the same for all of a flight, a few degrees from where it was calibrated (data sheets of
# MEMS accelerometers: 0.5 to 1 mg per degree). Intervals hold as much (`estimation.drift`).
ACCEL_DRIFT_M_S2 = 0.05


def build_plant(options: SimOptions) -> Plant:
    """The moving vehicle of these options. InputError for concealed effects that it does not have, or values that nothing has."""
    check_values(options.hide)
    gusts = Gusts(options.gust_rms_m_s)
    air = Air(gusts, NoiseStream(options.seed, "gusts")) if options.gust_rms_m_s > 0.0 else None
    if options.airframe == "rotor":
        drawn = RotorVehicle() if options.vehicle_seed is None else random_rotor(options.vehicle_seed)
        rotor = drawn.changed(options.vehicle)
        capacity = options.capacity_ah or rotor.capacity_ah
        battery = _battery(options, Battery(rotor.cells, capacity, rotor.resistance_ohm))
        return RotorPlant(rotor, options.hide, battery, air)
    if options.model is not None:
        return _identified(options, options.model, air)
    battery = _battery(options, Battery(capacity_ah=options.capacity_ah or 5.0))
    drag = options.hide.get("linear_drag", {})
    parameters = PaperParameters().changed({**options.vehicle, **drag})
    beyond = {name: values for name, values in options.hide.items() if name != "linear_drag"}
    if not beyond:
        return PaperPlant(parameters, battery, air)
    from flighttest.sim.plants import plant_terms

    return plant_terms.TermsPlant(*plant_terms.concealing(*plant_terms.of_paper(parameters), beyond), battery, air)


def _identified(options: SimOptions, described: IdentifiedVehicle, air: Air | None) -> Plant:
    """An identified model, with whatever is hidden in it besides."""
    from flighttest.sim.plants import plant_terms

    battery = Battery(capacity_ah=options.capacity_ah or 5.0, **described.get("battery", {}))
    model, values = plant_terms.concealing(*plant_terms.of_description(described), options.hide)
    return plant_terms.TermsPlant(model, values, _battery(options, battery), air)


def _battery(options: SimOptions, battery: Battery) -> Battery:
    """The battery at the voltage that is asked for."""
    if options.voltage_v is not None:
        battery.replace(options.voltage_v)
    return battery


def build_vehicle(options: SimOptions) -> Autopilot:
    """The vehicle of these options, just switched on."""
    plant = build_plant(options)
    vehicle = Autopilot(
        plant,
        seed=options.seed,
        noise=replace(
            SensorNoise(**(options.model.get("noise", {}) if options.model else {})).scaled(options.noise),
            accel_stays_m_s2=options.drift * ACCEL_DRIFT_M_S2,
        ),
        boot=Boot(options.ready_s, options.gps_s, min(MODE_SWITCH_S, options.ready_s)),
        parameters=options.parameters,
        capacity_ah=plant.battery.capacity_ah,
    )
    # As one that has had the time from satellites; nothing else of the vehicle holds the date.
    vehicle.encoder.signing.set(bytes.fromhex(options.signing_key), int((time.time() - UNIX_2015_S) * 1e5))
    return vehicle
