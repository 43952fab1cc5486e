"""From `SimOptions` to a vehicle that can be flown."""

from __future__ import annotations

from flighttest.sim.autopilot import Autopilot
from flighttest.sim.battery import Battery, charge_at
from flighttest.sim.noise import Noise
from flighttest.sim.options import SimOptions
from flighttest.sim.plant import Plant
from flighttest.sim.plant_paper import PaperParameters, PaperPlant
from flighttest.sim.safety import Boot
from flighttest.sim.sensors import SensorNoise
from flighttest.sim.weather import Air, Gusts

_CELLS = 6


def build_plant(options: SimOptions) -> Plant:
    """The moving vehicle of these options."""
    gusts = Gusts(options.gust_rms_m_s)
    air = Air(gusts, Noise(options.seed, "gusts")) if options.gust_rms_m_s > 0.0 else None
    battery = Battery(cells=_CELLS, capacity_ah=options.capacity_ah or 5.0)
    if options.voltage_v is not None:
        battery.charge = charge_at(options.voltage_v / _CELLS)
        battery.draw(0.0, 0.0)
    return PaperPlant(PaperParameters().changed(options.vehicle), battery, air)


def build_vehicle(options: SimOptions) -> Autopilot:
    """The vehicle of these options, just switched on."""
    return Autopilot(
        build_plant(options),
        seed=options.seed,
        noise=SensorNoise().scaled(options.noise),
        boot=Boot(options.ready_s, options.gps_s, min(6.5, options.ready_s)),
        parameters=options.parameters,
        capacity_ah=options.capacity_ah or 5.0,
    )
