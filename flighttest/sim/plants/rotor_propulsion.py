"""From throttle to the common thrust of the rotors: ESC input, static map, ramp, voltage, heat."""

from __future__ import annotations

import math
from math import cos, exp, sqrt

from flighttest.sim.plants.rotor_vehicle import RotorVehicle


class Propulsion:
    """The ESCs and motors as one channel. The state `ramp` is the static thrust they have come to, as a share of full
    throttle; drop_logged: V that the voltage sensor shows of the pack's extra sag."""

    def __init__(self, vehicle: RotorVehicle, on: dict[str, dict[str, float]]) -> None:
        self._v = vehicle
        self._boost = on.get("angle_boost", {}).get("boost", 0.0)
        self._filter = on.get("thrust_extra_lag", {}).get("thrust_extra_tau", 0.0)
        self._curve = on.get("throttle_curve", {}).get("curvature", 0.0)
        self._start = on.get("throttle_offset", {}).get("T_min", 0.0)
        self._top = on.get("motor_saturation", {}).get("T_max", math.inf)
        self._band = on.get("sticking_esc", {}).get("band", 0.0)
        ratio = on.get("thrust_asymmetry", {}).get("ln_sigma_ratio", 0.0)
        self._up, self._down = vehicle.ramp_1_s * exp(0.5 * ratio), vehicle.ramp_1_s * exp(-0.5 * ratio)
        self._blend = on.get("rotor_speed_lag", {}).get("rotor_lag", 0.0)
        self._resistance = on.get("back_emf", {}).get("resistance", 0.0)
        self._fade, self._sag, self._ring = on.get("thrust_fade"), on.get("voltage_sag"), on.get("resonance")
        self._filtered = self._stuck = self.ramp = 0.0
        self._heat = self._drop = self.drop_logged = 0.0
        self._bend = self._bend_rate = 0.0

    def cool(self) -> None:
        """New battery, cold motors."""
        self._heat = 0.0

    def voltage_gain(self, sensed_v: float) -> float:
        """Static thrust at the voltage that acts, as a multiple of that at nominal voltage."""
        v = self._v
        ratio = (sensed_v - self._drop) / v.nominal_voltage_v
        gain: float = ratio**v.alpha if not self._resistance else self._ungoverned(ratio)
        if self._fade:
            gain *= 1.0 - self._fade["fade_depth"] * self._heat
        return gain

    def _ungoverned(self, ratio: float) -> float:
        """The same for motors that only see a duty of the battery's voltage: speed solves w + a w^2 = (1 + a) duty U / U_n."""
        a, x = self._resistance, max(self.ramp, 1e-4)
        speed = sqrt(x)
        drive = (speed + a * x) * ratio  # the duty that gives this thrust at nominal voltage, at this voltage
        found = (sqrt(1.0 + 4.0 * a * drive) - 1.0) / (2.0 * a)
        return found * found / x

    def common(self, h: float, throttle: float, roll: float, pitch: float, gain: float, spinning: bool) -> float:
        """Static thrust of all rotors, N, one step on. roll, pitch: the attitude target, rad."""
        t = throttle
        if self._boost:
            t *= 1.0 + self._boost * (1.0 / max(cos(roll) * cos(pitch), 0.5) - 1.0)
        if self._band:
            if abs(t - self._stuck) > self._band or t <= 0.0:
                self._stuck = t
            t = self._stuck
        if self._filter > 0.0:
            self._filtered += (1.0 - exp(-h / self._filter)) * (t - self._filtered)
            t = self._filtered
        t = min(max(t, 0.0), 1.0, self._top)
        t = max(t * (1.0 + self._curve * (t / self._v.hover_throttle - 1.0)) - self._start, 0.0)
        self._advance_ramp(h, t)
        self._advance_slow(h, spinning)
        out = self.ramp
        if self._ring:
            out += self._ringing(h, t)
        return max(out, 0.0) * gain * self._v.thrust_max_n

    def _advance_ramp(self, h: float, t: float) -> None:
        x = self.ramp
        rate = self._up if t > x else self._down
        if not self._blend:
            self.ramp = t + (x - t) * exp(-rate * h)
            return
        root, goal, keep = sqrt(max(x, 0.0)), sqrt(t), exp(-rate * h)
        fast = goal + (root - goal) * keep
        self.ramp = self._blend * fast * fast + (1.0 - self._blend) * (t + (x - t) * keep)

    def _advance_slow(self, h: float, spinning: bool) -> None:
        if self._sag:
            # the pack gives way at once, the reading follows late
            self._drop = self._sag["sag_v"] * self.ramp * sqrt(max(self.ramp, 0.0))
            self.drop_logged += (1.0 - exp(-h / self._sag["sag_tau"])) * (self._drop - self.drop_logged)
        if self._fade and spinning:
            self._heat += h / self._fade["fade_tau"] * (1.0 - self._heat)

    def _ringing(self, h: float, t: float) -> float:
        """A frame that rings: a lightly damped mode driven by the thrust's distance from where it goes."""
        assert self._ring is not None
        w = math.tau * self._ring["hz"]
        push = w * w * (t - self.ramp - self._bend) - 2.0 * self._ring["damping"] * w * self._bend_rate
        self._bend_rate += h * push
        self._bend += h * self._bend_rate
        return self._ring["gain"] * self._bend
