"""The built-in vehicle: a MAVLink copter on this machine, for trying everything before anything flies.

`start_simulator(SimOptions(...))` gives a `Simulation` with a `url`; `InProcess` is the same vehicle without a socket. The
shared clock is described in `lockstep`.
"""

from flighttest.sim.inprocess import InProcess
from flighttest.sim.options import AIRFRAMES, SimOptions, parse_hide
from flighttest.sim.simulation import Simulation, start_simulator

__all__ = ["AIRFRAMES", "InProcess", "SimOptions", "Simulation", "parse_hide", "start_simulator"]
