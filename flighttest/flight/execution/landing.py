"""The landing: LAND until the vehicle disarms by itself. One that lies on the ground and does not is said: its motors may run."""

from __future__ import annotations

import math

from flighttest.flight.execution import supervisor
from flighttest.flight.execution.control import FlightControl
from flighttest.flight.execution.machine import Event, FlightState
from flighttest.flight.gate import on_ground
from flighttest.flight.state import VehicleState
from flighttest.mavlink import CopterMode

LAND_S = 120.0
RESTS_M_S = 0.15  # half of the slowest descent that ArduCopter's LAND can be set to (LAND_SPEED 30 cm/s)
DISARMS_WITHIN_S = 4.0  # twice what LAND takes from the touch-down to disarming (1.5 to 1.9 s, flown)
ARMED_ON_GROUND = "on the ground and still armed: keep away, its motors may run; PILOT, disarm it with the transmitter"


def land(control: FlightControl) -> None:
    """LAND where it is; it disarms by itself. FlightEnded where it was not seen to.

    A vehicle that crashed may not: ArduCopter's crash check disarms only what leans, 30 degrees from its target, and LAND only once the
    motors are at their lowest. A quadrotor with a dead motor lay level on the ground and stayed armed (flown).
    """
    control.show(doing="landing", next="", phase="", time_left_s=math.nan)
    deadline, resting_s = 0.0, math.inf
    while not control.machine.state.is_end:
        if control.machine.state is not FlightState.LANDING:  # or not any more: an earlier request came late
            supervisor.ask_until_shown(control, (CopterMode.LAND,), lambda: level(control))
        now = control.session.now_s()
        deadline = deadline or now + LAND_S
        if now > deadline:
            control.on(Event.NOT_DOWN)
        resting_s = min(resting_s, now) if rests_on_ground(control.state, control) else math.inf
        if now - resting_s > DISARMS_WITHIN_S:
            control.alarm(ARMED_ON_GROUND)
        control.cycle()
    control.recorder.event("note", "landed", control.session.now_s())


def level(control: FlightControl) -> None:
    """A release target where the vehicle is still in the maneuver's mode."""
    if control.state.mode == CopterMode.GUIDED_NOGPS:
        control.release()


def rests_on_ground(state: VehicleState, control: FlightControl) -> bool:
    """Whether a vehicle that was flown is seen on the ground, and neither rises nor sinks."""
    return on_ground(state, control.gate) and state.climb_m_s is not None and abs(state.climb_m_s) < RESTS_M_S
