"""The gate: may this target leave, and if not, why. Pure; it drops, it never clamps.

Level attitude with a stopping or hover throttle always passes (a release target): giving up control is never refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from flighttest.flight.state import VehicleState
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.mavlink import CopterMode
from flighttest.plan import AttitudeTarget, Plan
from flighttest.plan.clearance import BRAKE_M_S2
from flighttest.script.model import Limits
from flighttest.vehicle.model import Zone

EPSILON = 1e-6  # a target exactly on a limit passes, also after the rounding of degrees


class Refusal(Enum):
    """Why a target may not leave. The value is the sentence shown to the reader."""

    NOT_A_NUMBER = "the target is not a number"
    TARGET_TILT = "the target tilts more than the script allows"
    TARGET_THROTTLE = "the target's throttle is outside the script's limits"
    TARGET_YAW_RATE = "the target's yaw rate is above the limit"
    MODE = "the autopilot is not in the maneuver's mode"
    DISARMED = "the vehicle is not armed"
    LINK = "nothing was heard from the vehicle for too long"
    UPLINK = "the vehicle has not answered for too long: what is sent may not arrive"
    HELD_UP = "a target left too late: the ground was held up"
    TELEMETRY_OLD = "attitude telemetry is missing or too old"
    POSITION_OLD = "position telemetry is missing or too old"
    EKF = "the autopilot's state estimate is not healthy"
    MEASURED_TILT = "the vehicle tilts more than the abort limit"
    HEIGHT = "the vehicle is outside the height limits, or could not stop before them"
    ZONE = "the vehicle is outside the flight zone, or could not stop before its limits"
    SPEED = "the vehicle is faster than the speed limit"
    BATTERY = "the battery's 2 s mean voltage is below the limit"
    VOLTAGE_UNKNOWN = "no battery voltage is known, though the script limits it"
    ON_GROUND = "the vehicle is on the ground, or nearer to it than to the lowest height allowed"


LINK = frozenset({Refusal.LINK, Refusal.UPLINK, Refusal.HELD_UP, Refusal.TELEMETRY_OLD, Refusal.POSITION_OLD})
"""What comes of the link, not of the vehicle: such a step is tried once more."""
SHOWN = frozenset({Refusal.MODE, Refusal.DISARMED})
"""What one HEARTBEAT shows, which may be another vehicle's or damaged: two of them end the flight, one refuses a target."""
LOST_CONTROL = frozenset({Refusal.MEASURED_TILT, Refusal.ON_GROUND})
"""What no further step mends: a vehicle whose tilt is not controlled, or that lies on the ground. It is landed, never flown to a start.
Two messages in a row show it, as two HEARTBEATs a take-over: one alone may be damaged. (ArduCopter's crash check waits
2 s before it stops the motors. LAND stops none, and at 50 degrees a vehicle is 23 m away after 2 s.)"""


@dataclass(frozen=True)
class GateLimits:
    """What the gate judges by.

    zone: without its margin: the plan keeps the margin, the gate keeps the wall. reaction_s: from the last good target until a
    stop acts (delay, lag, telemetry age). brake_m_s2: horizontal deceleration of the abort mode. stop_throttle: what the
    supervisor sends to stop (a climb, a descent). needs_position: without it (no satellite fix) zone and speed cannot be
    judged and are left to the height limits and the fence. zone_placed: whether it is known where the zone is, so that a step is judged
    by it wherever the vehicle has a position. mode_age_max_s: of the last HEARTBEAT: without one a pilot's take-over is not seen.
    uplink_silence_max_s: six unanswered questions in a row, which a link that loses a fifth each way has once in 500 questions.
    held_up_max_s: between two targets of a step, which a real vehicle follows no longer than GUID_TIMEOUT: half of that, and a period.
    """

    limits: Limits
    zone: Zone
    hover_throttle: float
    stop_throttle: tuple[float, float]
    mode: int = int(CopterMode.GUIDED_NOGPS)
    needs_position: bool = True
    zone_placed: bool = False
    reaction_s: float = 0.25
    brake_m_s2: float = BRAKE_M_S2
    attitude_age_max_s: float = 0.3
    position_age_max_s: float = 0.5
    silence_max_s: float = 0.5
    uplink_silence_max_s: float = 1.5
    mode_age_max_s: float = 2.5
    held_up_max_s: float = 0.5

    @classmethod
    def of(cls, plan: Plan, pace: float, held_up_max_s: float) -> GateLimits:
        """Of a plan. pace: vehicle seconds per second of the host, by which ages are longer."""
        hover = plan.vehicle.hover_throttle
        return cls(
            plan.limits,
            plan.vehicle.zone,
            hover,
            stop_throttles(plan.limits, hover),
            needs_position=plan.reset.by == "guided",
            reaction_s=plan.reaction_s,
            attitude_age_max_s=0.3 * pace,
            position_age_max_s=0.5 * pace,
            silence_max_s=0.5 * pace,
            uplink_silence_max_s=1.5 * pace,
            mode_age_max_s=2.5 * pace,
            held_up_max_s=held_up_max_s,
        )


def stop_throttles(limits: Limits, hover_throttle: float) -> tuple[float, float]:
    """Throttle that stops a climb, and one that stops a descent: as the plan foresees them, never zero (attitude needs some)."""
    low, high = limits.throttle
    climb = min(max(low, 0.3 * hover_throttle), hover_throttle)
    return climb, max(min(high, 1.8 * hover_throttle), hover_throttle)


def releases(target: AttitudeTarget, gate: GateLimits) -> bool:
    """Whether a target is a release target: level, no yaw rate, a throttle between the stopping ones."""
    low, high = gate.stop_throttle
    level = target.roll_rad == 0.0 and target.pitch_rad == 0.0 and target.yaw_rate_rad_s == 0.0
    return level and low - EPSILON <= target.throttle <= high + EPSILON


def refusals(
    target: AttitudeTarget, state: VehicleState, gate: GateLimits, *, step: bool = False
) -> tuple[Refusal, ...]:
    """Every reason why this target may not leave now; empty when it may.

    step: the target is a maneuver's: it is judged in full, also where its throttle over level attitude is that of a release target. Most
    steps of throttle are such targets, and hold for longer than a stop would.
    """
    if not step and releases(target, gate):
        return ()
    found = _target(target, gate.limits)
    if Refusal.NOT_A_NUMBER in found:
        return tuple(found)
    return (*found, *readiness(state, gate), *_motion(target, state, gate, step))


def _target(target: AttitudeTarget, limits: Limits) -> list[Refusal]:
    parts = (target.roll_rad, target.pitch_rad, target.yaw_rate_rad_s, target.throttle)
    if not all(math.isfinite(part) for part in parts):
        return [Refusal.NOT_A_NUMBER]
    found = []
    tilt = math.acos(math.cos(target.roll_rad) * math.cos(target.pitch_rad))
    if max(tilt, abs(target.roll_rad), abs(target.pitch_rad)) > limits.tilt_target_max_rad + EPSILON:
        found.append(Refusal.TARGET_TILT)
    if not limits.throttle[0] - EPSILON <= target.throttle <= limits.throttle[1] + EPSILON:
        found.append(Refusal.TARGET_THROTTLE)
    if abs(target.yaw_rate_rad_s) > limits.yaw_rate_max_rad_s + EPSILON:
        found.append(Refusal.TARGET_YAW_RATE)
    return found


def readiness(state: VehicleState, gate: GateLimits) -> tuple[Refusal, ...]:
    """Every reason why nothing but a release target may be sent to a vehicle in this state, wherever it is."""
    found = []
    if state.mode != gate.mode:
        found.append(Refusal.MODE)
    if not state.armed:
        found.append(Refusal.DISARMED)
    if not (state.silence_s <= gate.silence_max_s and state.mode_age_s <= gate.mode_age_max_s):
        found.append(Refusal.LINK)
    if not state.uplink_silence_s <= gate.uplink_silence_max_s:
        found.append(Refusal.UPLINK)
    if state.attitude_rad is None or not state.attitude_age_s <= gate.attitude_age_max_s:
        found.append(Refusal.TELEMETRY_OLD)
    lost = state.position_m is None or not state.position_age_s <= gate.position_age_max_s
    if state.height_m is None or (gate.needs_position and lost):
        found.append(Refusal.POSITION_OLD)
    if not state.ekf_ok or (gate.needs_position and not state.position_ok):
        found.append(Refusal.EKF)
    if gate.limits.voltage_min_v > 0:
        if state.voltage_v is None:
            found.append(Refusal.VOLTAGE_UNKNOWN)
        elif not state.voltage_v >= gate.limits.voltage_min_v:
            found.append(Refusal.BATTERY)
    if over_tilted(state, gate):
        found.append(Refusal.MEASURED_TILT)
    return tuple(found)


def refusal_sentences(found: Sequence[Refusal]) -> tuple[str, ...]:
    """The refusals as their sentences."""
    return tuple(r.value for r in found)


def over_tilted(state: VehicleState, gate: GateLimits) -> bool:
    """Whether the vehicle is seen to tilt more than the abort limit, by the two latest messages."""
    limit = gate.limits.tilt_abort_rad + EPSILON
    tilt, before = state.tilt_rad, state.tilt_before_rad
    return tilt is not None and not tilt <= limit and (before is None or not before <= limit)


def on_ground(state: VehicleState, gate: GateLimits) -> bool:
    """Whether a vehicle that has taken off is seen nearer to the ground than to the lowest height at which it may be, by the two latest
    messages."""
    height, before = state.height_m, state.height_before_m
    limit = 0.5 * lowest_m(gate)
    return height is not None and height < limit and (before is None or before < limit)


def lost_control(state: VehicleState, gate: GateLimits) -> tuple[Refusal, ...]:
    """Which of `LOST_CONTROL` hold for a vehicle that has taken off, in any mode."""
    seen = {Refusal.MEASURED_TILT: over_tilted(state, gate), Refusal.ON_GROUND: on_ground(state, gate)}
    return tuple(refusal for refusal, holds in seen.items() if holds)


def lowest_m(gate: GateLimits) -> float:
    """The lowest height that script and zone allow, m."""
    return max(gate.limits.height_m[0], gate.zone.z_m[0])


def _motion(target: AttitudeTarget, state: VehicleState, gate: GateLimits, step: bool) -> list[Refusal]:
    found = []
    fresh = state.position_ok and state.position_age_s <= gate.position_age_max_s
    blind = step and (state.climb_m_s is None or not math.isfinite(state.climb_m_s))
    if state.height_m is not None and (blind or not height_inside(target, state, gate)):
        found.append(Refusal.HEIGHT)
    judged = gate.needs_position or (step and gate.zone_placed and fresh)
    if judged and state.position_m is not None and state.velocity_m_s is not None:
        if not zone_inside(state, gate):
            found.append(Refusal.ZONE)
        if not math.hypot(*state.velocity_m_s) <= gate.limits.speed_max_m_s + EPSILON:
            found.append(Refusal.SPEED)
    return found


def height_inside(target: AttitudeTarget, state: VehicleState, gate: GateLimits) -> bool:
    """Whether the vehicle, stopped from now on as hard as the supervisor would, stays inside the height limits and the zone's."""
    low = lowest_m(gate)
    high = min(gate.limits.height_m[1], gate.zone.z_m[1])
    assert state.height_m is not None
    bottom, top = stopping_heights(target.throttle, state.height_m, state.climb_m_s or 0.0, gate)
    return low - EPSILON <= bottom and top <= high + EPSILON


def stopping_heights(throttle: float, height_m: float, climb_m_s: float, gate: GateLimits) -> tuple[float, float]:
    """Lowest and highest height, m, of a vehicle that takes this throttle for the reaction time and is stopped then."""
    push = G_M_S2 * (throttle / gate.hover_throttle - 1.0)
    then = climb_m_s + push * gate.reaction_s
    h = height_m + climb_m_s * gate.reaction_s + 0.5 * push * gate.reaction_s**2
    climb_stop, descent_stop = (abs(G_M_S2 * (t / gate.hover_throttle - 1.0)) for t in gate.stop_throttle)
    end = h + then * abs(then) / (2.0 * max(climb_stop if then > 0 else descent_stop, 0.5))
    return min(height_m, h, end), max(height_m, h, end)


def zone_inside(state: VehicleState, gate: GateLimits) -> bool:
    """Whether the vehicle, braked after the reaction time, stays between the zone's walls."""
    return zone_clearance_m(state, gate) >= -EPSILON


def zone_clearance_m(state: VehicleState, gate: GateLimits) -> float:
    """Least distance, m, between a wall and any place on the way to a stop; negative outside. An old position has moved on since."""
    assert state.position_m is not None
    assert state.velocity_m_s is not None
    here = gate.zone.over_ground(state.position_m[0], state.position_m[1])
    age = state.position_age_s if math.isfinite(state.position_age_s) else 0.0
    # Until the stop acts it goes on as it leans now.
    wait, pushes = gate.reaction_s, _push(state.attitude_rad)
    later = [v * (age + wait) + 0.5 * push * wait**2 for v, push in zip(state.velocity_m_s[:2], pushes, strict=True)]
    then = [v + push * wait for v, push in zip(state.velocity_m_s[:2], pushes, strict=True)]
    speed = math.hypot(*then)
    stopped = [at + v * speed / (2.0 * gate.brake_m_s2) for at, v in zip(later, then, strict=True)]
    gaps = []
    for moved in (gate.zone.over_ground(*later), gate.zone.over_ground(*stopped), (0.0, 0.0)):
        for start, way, (low, high) in zip(here, moved, (gate.zone.x_m, gate.zone.y_m), strict=True):
            gaps += [start + way - low, high - (start + way)]
    return math.nan if any(map(math.isnan, gaps)) else min(gaps)  # NaN where a place is not a number: none


def _push(attitude_rad: tuple[float, float, float] | None) -> tuple[float, float]:
    """Horizontal acceleration, m/s^2, NWU, of a vehicle that holds its height at this roll, pitch and yaw; none where not known."""
    if attitude_rad is None:
        return 0.0, 0.0
    x, y, z = rotation_from_euler(attitude_rad)[:, 2].tolist()
    return G_M_S2 * x / max(z, 0.5), G_M_S2 * y / max(z, 0.5)
