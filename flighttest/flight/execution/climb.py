"""The climb to the height of the first step, by the autopilot's take-off or, without a position, by our own throttle."""

from __future__ import annotations

from flighttest.flight.execution import supervisor
from flighttest.flight.execution.control import FlightControl
from flighttest.flight.gate import Refusal, over_tilted, readiness, refusal_sentences
from flighttest.plan import AttitudeTarget

TAKE_OFF_WITHIN_S = 40.0


def by_position(control: FlightControl, height_m: float) -> str:
    """Wait for the autopilot's climb: '' where it reaches the height or the operator asks to stop, else why it is over."""
    if reaches(control, height_m - 0.5, TAKE_OFF_WITHIN_S):
        return ""
    return _not_climbed(control, height_m)


def reaches(control: FlightControl, height_m: float, within_s: float) -> bool:
    """Whether the vehicle is seen at a height in time, or the operator asks to stop before. One that tips over is not waited for."""
    deadline = control.session.now_s() + within_s
    while control.session.now_s() < deadline:
        state = control.cycle()
        if control.stop_asked or (state.height_m is not None and state.height_m >= height_m):
            return True
        if over_tilted(state, control.gate):
            return False
    return False


def by_throttle(control: FlightControl, height_m: float) -> str:
    """Without a position: throttle up gently over level attitude, hold at the height. Answers as `by_position`."""
    control.after()
    began = control.session.now_s()
    while control.session.now_s() < began + TAKE_OFF_WITHIN_S:
        state = control.state
        speed = state.climb_m_s or 0.0
        if control.stop_asked or (state.height_m is not None and state.height_m >= height_m - 0.5):
            return ""
        found = refusal_sentences(readiness(state, control.gate))
        if found:
            supervisor.abort(control, found)
            return f"the climb was ended: {'; '.join(found)}"
        ramp = min((control.session.now_s() - began) / 4.0, 1.0)
        low, high = control.gate.stop_throttle
        throttle = control.hover_throttle * (0.4 + ramp * (0.8 - 0.4 * min(max(speed - 1.0, -0.5), 1.0)))
        throttle = min(max(throttle, low), high)
        yaw = state.attitude_rad[2] if state.attitude_rad else 0.0
        refused = control.steer(AttitudeTarget(0.0, 0.0, 0.0, 0.0, throttle), yaw)
        assert not refused, "level targets around hover always pass"
        control.cycle()
    return _not_climbed(control, height_m)


def _not_climbed(control: FlightControl, height_m: float) -> str:
    state = control.state
    if over_tilted(state, control.gate):
        return f"the climb was ended: {Refusal.MEASURED_TILT.value}"
    known = "its height is not known" if state.height_m is None else f"its height is {state.height_m:.1f} m"
    return f"the vehicle did not climb to {height_m:g} m within {TAKE_OFF_WITHIN_S:.0f} s: {known}"
