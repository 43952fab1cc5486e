"""What a flight set on the vehicle, at its end: put back where the vehicle is seen on the ground, else left, and said."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Mapping

from flighttest.errors import FlighttestError
from flighttest.flight.execution.control import FlightControl
from flighttest.flight.execution.machine import FlightState
from flighttest.flight.execution.supervisor import UNSEEN_S
from flighttest.flight.gate import on_ground
from flighttest.flight.outcome import FlightEnded
from flighttest.flight.preparation.changes import LeftParameter, changed_values, record_of
from flighttest.flight.preparation.fence import FenceSet, fence_data
from flighttest.flight.preparation.preflight import figure
from flighttest.link.ardupilot import ArduPilot
from flighttest.recording.manifest import Manifest

_FALL_S = 5.0  # from 120 m
_DOWN = frozenset({FlightState.GROUND, FlightState.ARMING, FlightState.NOT_ARMED, FlightState.LANDED})


def record_fall(control: FlightControl | None) -> str:
    """Record how a vehicle that was disarmed in flight comes down, until a second after it is seen near the ground; where it was last seen,
    '' for any other vehicle. Nothing is sent that moves it, and nothing is raised."""
    if control is None or control.machine.state is not FlightState.DISARMED:
        return ""
    session = control.session
    began = session.now_s()
    down = False
    with contextlib.suppress(FlighttestError, FlightEnded):
        while not (down or control.stop_now) and 0.0 <= session.now_s() - began < _FALL_S:
            down = on_ground(control.state, control.gate)
            control.until(session.now_s() + (1.0 if down else 0.1))
    return f"disarmed in flight, and {'' if down else 'not '}seen to come down: {_last_seen(control)}"


def _last_seen(control: FlightControl) -> str:
    """Where the vehicle was by the latest messages, for who looks for it."""
    state, fix = control.state, control.session.latest.get("GLOBAL_POSITION_INT")
    parts = [
        f"last {state.height_m:.1f} m above home" if state.height_m is not None else "at a height that is not known"
    ]
    if state.position_m is not None:
        north_m, west_m = state.position_m[:2]
        bearing_deg = math.degrees(math.atan2(-west_m, north_m)) % 360.0
        parts.append(f"{math.hypot(north_m, west_m):.1f} m from the zone's origin towards {bearing_deg:.0f} deg")
    if fix is not None and (fix.message.lat or fix.message.lon):
        parts.append(f"at latitude {fix.message.lat * 1e-7:.6f}, longitude {fix.message.lon * 1e-7:.6f}")
    return ", ".join(parts)


def may_restore(vehicle: ArduPilot, control: FlightControl | None) -> bool:
    """Whether something may be set on the vehicle now: it is heard, disarmed, and came down as far as this flight saw. On one that is in
    the air, or may be, a pilot may rely on what is set. control: None before there was one."""
    session = vehicle.session
    beat = session.latest.get("HEARTBEAT")
    unseen_s = UNSEEN_S * max(session.clock.pace, 1.0)
    if beat is None or session.now_s() - beat.t_s > unseen_s or vehicle.armed or session.port.muted:
        return False
    if control is None or control.machine.state in _DOWN:
        return True
    return control.machine.state is FlightState.DISARMED and on_ground(control.state, control.gate)


def records_behind(run: str, left: Mapping[str, LeftParameter], fence: FenceSet | None) -> Manifest:
    """What an earlier flight left, for the manifest with which a run begins: whatever ends the run, the next one finds it there."""
    found: Manifest = {"parameters_changed": changed_values(left), "parameters_set": record_of(run, left)}
    if fence is not None:
        found["fence_set"] = fence_data(run, fence, left=True)
    return found


def left_words(left: Mapping[str, float], unconfirmed: Collection[str]) -> str:
    """What was not put back, with the value it should have, and what follows from that. unconfirmed: names that were sent."""
    sent = dict.fromkeys(unconfirmed, ", which was sent but not confirmed")
    values = "; ".join(f"{name} {figure(value)}{sent.get(name, '')}" for name, value in left.items())
    fence = (
        "; the fence of this flight (height, radius) is still on" if any(n.startswith("FENCE_") for n in left) else ""
    )
    return f"not restored: {values}. Set it by hand, or let the next run with --set-params restore it{fence}"
