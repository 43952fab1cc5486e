"""Attitude targets as ArduCopter's guided modes take them: which are accepted, how rates advance them, when they time out.

A target takes effect a channel's delay after its arrival (the paper's T_d); the mode's clock for GUID_TIMEOUT starts at the arrival.
Source: ArduCopter/GCS_MAVLink_Copter.cpp and mode_guided.cpp, 4.7.0-dev.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from flighttest.sim.plants.plant import Delays

MASK_RATES, MASK_ATTITUDE, MASK_THROTTLE = 0b111, 128, 64
_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class AcceptedTarget:
    """An accepted target, NWU/FLU. attitude: (roll, pitch, yaw) rad, None for rates only; rates: (p, q, r) rad/s, None for attitude
    only; thrust as sent.
    """

    attitude: tuple[float, float, float] | None
    rates: tuple[float, float, float] | None
    thrust: float


def accept(
    type_mask: int, q: list[float], rates_frd: tuple[float, float, float], thrust: float
) -> AcceptedTarget | None:
    """SET_ATTITUDE_TARGET's fields as a target, or None where ArduCopter drops it without a word."""
    if type_mask & MASK_THROTTLE:
        return None
    ignored = type_mask & MASK_RATES
    if ignored not in (0, MASK_RATES):
        return None
    attitude = None
    if not type_mask & MASK_ATTITUDE:
        w, x, y, z = q
        norm2 = w * w + x * x + y * y + z * z
        if not abs(norm2 - 1.0) < _UNIT_TOLERANCE:  # also drops NaN
            return None
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        attitude = (roll, -pitch, -yaw)  # FRD in NED to FLU in NWU
    rates = None
    if ignored == 0:
        rates = (rates_frd[0], -rates_frd[1], -rates_frd[2])
    if not all(math.isfinite(v) for v in rates or ()):
        return None
    if not math.isfinite(thrust):
        thrust = 0.5  # flown: what the firmware's limiter makes of a NaN
    return AcceptedTarget(attitude, rates, thrust)


class AngleControl:
    """The angle sub-mode: what holds now, advanced by its rates, and what is still under way to taking effect.

    roll, pitch, yaw: target rad; p, q, r rad/s; thrust as sent. with_rates: the last target brought body rates. chosen: attitude targets
    are flown, in GUIDED where they were the last kind sent.
    """

    def __init__(self, delays: Delays) -> None:
        self.delays = delays
        self.chosen = False
        self.start(0.0, 0.0)

    def start(self, t_s: float, yaw: float) -> None:
        """Entering the mode: level, this heading, nothing pending."""
        self.roll = self.pitch = 0.0
        self.yaw = yaw
        self.p = self.q = self.r = 0.0
        self.with_rates = False
        self.thrust: float | None = None
        self.last_s = t_s
        self.positive_thrust = False
        self._attitude: deque[tuple[float, AcceptedTarget]] = deque()
        self._yaw_rate: deque[tuple[float, AcceptedTarget]] = deque()
        self._thrust: deque[tuple[float, AcceptedTarget]] = deque()

    def receive(self, t_s: float, target: AcceptedTarget) -> None:
        """A target that arrived at t_s, s."""
        self.last_s = t_s
        d = self.delays
        self._attitude.append((t_s + d.attitude_s, target))
        self._yaw_rate.append((t_s + d.yaw_rate_s, target))
        self._thrust.append((t_s + d.thrust_s, target))

    def due(self, t_s: float) -> None:
        """Let everything take effect that is due by t_s, s."""
        late = t_s + 1e-9
        while self._attitude and self._attitude[0][0] <= late:
            target = self._attitude.popleft()[1]
            if target.attitude is not None:
                self.roll, self.pitch, self.yaw = target.attitude
            self.p, self.q = (target.rates or (0.0, 0.0))[:2]
        while self._yaw_rate and self._yaw_rate[0][0] <= late:
            target = self._yaw_rate.popleft()[1]
            self.with_rates = target.rates is not None
            self.r = target.rates[2] if target.rates is not None else 0.0
        while self._thrust and self._thrust[0][0] <= late:
            self.thrust = self._thrust.popleft()[1].thrust
            self.positive_thrust = self.positive_thrust or self.thrust > 0.0

    @property
    def last_thrust(self) -> float | None:
        """The thrust received last, also where it has not taken effect yet; None before the first."""
        return self._thrust[-1][1].thrust if self._thrust else self.thrust

    def next_edge(self, t_s: float) -> float:
        """When the next target takes effect, s, or t_s when none does before it."""
        edge = t_s
        for queue in (self._attitude, self._yaw_rate, self._thrust):
            if queue and queue[0][0] < edge:
                edge = queue[0][0]
        return edge

    def advance(self, dt_s: float) -> None:
        """Turn the target attitude by its body rates for dt_s, s."""
        p, q, r = self.p, self.q, self.r
        if not (p or q or r):
            return
        sr, cr, tp, cp = math.sin(self.roll), math.cos(self.roll), math.tan(self.pitch), math.cos(self.pitch)
        turn = sr * q + cr * r
        self.roll += dt_s * (p + tp * turn)
        self.pitch += dt_s * (cr * q - sr * r)
        self.yaw = math.remainder(self.yaw + dt_s * turn / cp, math.tau)
