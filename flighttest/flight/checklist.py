"""What the operator reads before a vehicle arms: what was measured, what to look at, and who stops the flight how."""

from __future__ import annotations

import threading
from collections.abc import Callable

from flighttest.flight.execution.control import FlightControl
from flighttest.flight.preparation.preflight import lowest_stick
from flighttest.flight.preparation.situation import Situation
from flighttest.plan import Plan

_LOOK_EVERY_S = 0.1


def asked(control: FlightControl, confirm: Callable[[str], bool], text: str) -> bool:
    """Whether the operator confirms a text; heartbeats are sent and messages read meanwhile, and Ctrl-C is a no."""
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(confirm(text)), daemon=True)
    thread.start()
    while thread.is_alive() and not control.stop_asked:
        control.until(control.session.now_s() + _LOOK_EVERY_S)
    return bool(answers and answers[0]) and not control.stop_asked


def checklist(plan: Plan, seen: Situation, waived: tuple[str, ...]) -> str:
    """The list as lines. waived: names of the preflight checks that were waived."""
    zone, state = plan.vehicle.zone, seen.state
    voltage = "not known" if state.voltage_v is None else f"{state.voltage_v:.1f} V"
    minutes = sum(leg.duration_s for leg in plan.legs) / 60.0
    fence = seen.value("FENCE_ENABLE") == 1.0
    rows = [
        (
            "vehicle",
            f"{plan.vehicle.name or 'without a name'}, {seen.firmware or 'firmware not stated'}, disarmed, props clear",
        ),
        (
            "plan",
            f"{plan.script.name}: {len(plan.legs)} steps, {minutes:.1f} min of them, from {plan.reset.to_m[2]:g} m height",
        ),
        ("zone", f"{_span(zone.x_m)} along, {_span(zone.y_m)} across, {_span(zone.z_m)} up, no people"),
        ("battery", f"{voltage}, lands at {plan.limits.voltage_min_v:.1f} V"),
        ("fence", f"{'on' if fence else 'off'}{_fence(seen, zone.fence) if fence else ''}"),
        ("pilot", f"ready, throttle {_stick(seen)}; transmitter {_heard(seen)}"),
        ("stop", "mode switch takes over; Ctrl-C lands, twice before LAND: safe mode"),
    ]
    if waived:
        rows.append(("waived", ", ".join(waived)))
    return "\n".join(f"  {name:8} {words}" for name, words in rows)


def _stick(seen: Situation) -> str:
    return "at mid" if lowest_stick(seen.parameters) is None else "down until armed, then at mid"


def _heard(seen: Situation) -> str:
    return "not asked for" if seen.simulator else "heard" if seen.rc_live else "NOT heard"


def _span(ends_m: tuple[float, float]) -> str:
    return f"{ends_m[0]:g} to {ends_m[1]:g} m"


def _fence(seen: Situation, kind: str) -> str:
    radius, top = seen.value("FENCE_RADIUS"), seen.value("FENCE_ALT_MAX")
    if kind == "polygon" and top is not None:
        return f", polygon along the zone and {top:g} m high"
    return "" if radius is None or top is None else f", {radius:g} m about home and {top:g} m high"
