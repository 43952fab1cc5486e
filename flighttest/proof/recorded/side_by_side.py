"""Parts of a vehicle side by side: as it flew, and with effects in it. Each gives the difference of the two.

Propulsion and loops are simulated twice, for the recorded commands, and for the commands with what a controller asks for beside them;
air, ground and heat act on the thrust of the second. World NWU, body FLU.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import copysign, exp, inf, sqrt

import numpy as np
from numpy.typing import NDArray

from flighttest.frames import G_M_S2
from flighttest.sim.plants.rotor_loops import square_root_rate

FloatArray = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float]]

STEP_S = 0.01
DAMPING = 0.9  # of the position loop that answers
MOST_PHASE_RAD = 0.55  # at its crossover, that a lag may take of it


@dataclass(frozen=True)
class OracleVehicle:
    """What the difference of two flights needs of a vehicle. gain_m_s2: thrust over mass at full throttle and nominal voltage; alpha: its
    power of the voltage; ramp_1_s, delay_s: thrust lag; drag_1_s (3,): body; omega_1_s, zeta (2,): roll and pitch loop, attitude_delay_s
    behind; yaw_1_s, yaw_delay_s: yaw rate loop; answer_1_s: bandwidth of the position loop between steps."""

    nominal_voltage_v: float = 1.0
    gain_m_s2: float = 20.0
    alpha: float = 1.5
    ramp_1_s: float = 15.0
    delay_s: float = 0.0
    drag_1_s: tuple[float, float, float] = (0.3, 0.3, 0.3)
    omega_1_s: tuple[float, float] = (12.0, 12.0)
    zeta: tuple[float, float] = (0.7, 0.7)
    attitude_delay_s: float = 0.0
    yaw_1_s: float = 6.0
    yaw_delay_s: float = 0.0
    answer_1_s: float = 1.0

    @classmethod
    def fitted(cls, parameters: Mapping[str, FloatArray], nominal_voltage_v: float, answer_1_s: float) -> OracleVehicle:
        """Of the oracle's own fit of the base model (`oracle.Left.parameters`); what it could not fit keeps its default."""
        made = cls(nominal_voltage_v=nominal_voltage_v, answer_1_s=answer_1_s)

        def known(block: str, *defaults: float) -> list[float]:
            fitted = parameters.get(block, np.array(defaults))
            return [float(x) if np.isfinite(x) else default for x, default in zip(fitted, defaults, strict=True)]

        ramp, gain, alpha, delay, *drag = known(
            "translation", made.ramp_1_s, made.gain_m_s2, made.alpha, made.delay_s, *made.drag_1_s
        )
        x, y, z = (max(d, 0.0) for d in drag)
        (w1, w2), (z1, z2) = made.omega_1_s, made.zeta
        w1, z1, w2, z2, late = known("roll_pitch", w1, z1, w2, z2, made.attitude_delay_s)
        rate, yaw_delay = known("yaw", made.yaw_1_s, made.yaw_delay_s)
        return replace(
            made, ramp_1_s=ramp, gain_m_s2=gain, alpha=alpha, delay_s=delay, drag_1_s=(x, y, z), omega_1_s=(w1, w2),
            zeta=(z1, z2), attitude_delay_s=late, yaw_1_s=rate, yaw_delay_s=yaw_delay,
        )  # fmt: skip

    @property
    def bandwidth_1_s(self) -> float:
        """Of the position loop: `answer_1_s`, or what its slowest actuator (thrust, roll, pitch) lets it have with a phase margin of 40
        degrees. A loop w^2, 2 (0.9) w on a double integrator crosses over near 1.8 w with 73
        degrees; a lag and delay of T take 1.8 w T rad."""
        thrust = 1.0 / self.ramp_1_s + self.delay_s
        tilt = max(2.0 * z / w for w, z in zip(self.omega_1_s, self.zeta, strict=True)) + self.attitude_delay_s
        return min(self.answer_1_s, MOST_PHASE_RAD / (2.0 * DAMPING * max(thrust, tilt)))


class _Delayed:
    """What was asked for some time ago: a delay line of the grid's steps."""

    def __init__(self, delay_s: float) -> None:
        self._line = deque([0.0] * (round(delay_s / STEP_S) + 1))

    def advance(self, value: float) -> float:
        self._line.append(value)
        return self._line.popleft()


class Thrust:
    """Thrust of the same base model for the recorded commands, and for those that are asked for, with the propulsion's effects."""

    def __init__(self, vehicle: OracleVehicle, effects: Effects, throttle: FloatArray, voltage: FloatArray) -> None:
        delay = round(vehicle.delay_s / STEP_S)
        self._throttle = np.concatenate([np.full(delay, throttle[0]), throttle[: throttle.size - delay]])
        self._gain, self._vehicle, self._asked = vehicle.gain_m_s2 * voltage, vehicle, _Delayed(vehicle.delay_s)
        self._filter = effects.get("thrust_extra_lag", {}).get("thrust_extra_tau", 0.0)
        self._curve = effects.get("throttle_curve", {}).get("curvature", 0.0)
        self._start = effects.get("throttle_offset", {}).get("T_min", 0.0)
        self._top = effects.get("motor_saturation", {}).get("T_max", inf)
        ratio = effects.get("thrust_asymmetry", {}).get("ln_sigma_ratio", 0.0)
        self._up, self._down = vehicle.ramp_1_s * exp(0.5 * ratio), vehicle.ramp_1_s * exp(-0.5 * ratio)
        self._hover = G_M_S2 / vehicle.gain_m_s2
        self._before = self._filtered = float(self._throttle[0])
        self._after = self._static(self._filtered)

    def _static(self, t: float) -> float:
        t = min(t, self._top)
        return max(t * (1.0 + self._curve * (t / self._hover - 1.0)) - self._start, 0.0)

    def advance(self, k: int, asked: float) -> float:
        """m/s^2 more than as recorded, with `asked` more throttle."""
        recorded = float(self._throttle[k])
        t = min(max(recorded + self._asked.advance(asked), 0.0), 1.0)
        self._before += (1.0 - exp(-self._vehicle.ramp_1_s * STEP_S)) * (recorded - self._before)
        self._filtered += (
            (1.0 - exp(-STEP_S / self._filter)) * (t - self._filtered) if self._filter else t - self._filtered
        )
        wanted = self._static(self._filtered)
        rate = self._up if wanted > self._after else self._down
        self._after += (1.0 - exp(-rate * STEP_S)) * (wanted - self._after)
        return float(self._gain[k]) * (self._after - self._before)


class _Axis:
    """A second-order loop, with whatever the autopilot adds to it."""

    def __init__(
        self,
        omega: float,
        zeta: float,
        limit: float = inf,
        pole_s: float = 0.0,
        shaping: Mapping[str, float] | None = None,
    ) -> None:
        self._angle_gain, self._rate_gain, self._limit, self._pole_s = (
            omega / (2.0 * zeta),
            2.0 * zeta * omega,
            limit,
            pole_s,
        )
        self._shaping = shaping
        self.angle = self.rate = self._push = self._target = self._target_rate = 0.0

    def advance(self, wanted: float) -> None:
        if self._shaping:
            accel, h = self._shaping["shaping_accel"], STEP_S
            goal = square_root_rate(wanted - self._target, 1.0 / max(self._shaping["shaping_tc"], 0.01), accel)
            self._target_rate += min(max(goal - self._target_rate, -accel * h), accel * h)
            self._target += self._target_rate * h
            wanted = self._target
        for _ in range(4):  # fast loops on the grid's step
            h = STEP_S / 4
            ask = self._angle_gain * (wanted - self.angle)
            push = self._rate_gain * (copysign(min(abs(ask), self._limit), ask) - self.rate)
            self._push += (1.0 - exp(-h / self._pole_s)) * (push - self._push) if self._pole_s else push - self._push
            self.rate += h * self._push
            self.angle += h * self.rate


class AttitudeLoops:
    """Roll and pitch loops and yaw rate for the recorded targets, and for those that are asked for, with the autopilot's effects."""

    def __init__(
        self, vehicle: OracleVehicle, effects: Effects, roll: FloatArray, pitch: FloatArray, yaw_rate: FloatArray
    ) -> None:
        delay, late = round(vehicle.attitude_delay_s / STEP_S), round(vehicle.yaw_delay_s / STEP_S)
        self._refs = [np.concatenate([np.zeros(delay), r[: r.size - delay]]) for r in (roll, pitch)]
        self._yaw_rate = np.concatenate([np.zeros(late), yaw_rate[: yaw_rate.size - late]])
        self._asked = [_Delayed(vehicle.attitude_delay_s) for _ in range(2)]
        limit = effects.get("rate_limit", {}).get("rate_max", inf)
        pole = effects.get("attitude_extra_pole", {}).get("attitude_pole_tau", 0.0)
        coupling = effects.get("roll_pitch_coupling", {})
        self._turn = coupling.get("pitch_to_roll", 0.0), coupling.get("roll_to_pitch", 0.0)
        both = list(zip(vehicle.omega_1_s, vehicle.zeta, strict=True))
        self._before = [_Axis(w, z) for w, z in both]
        self._after = [_Axis(w, z, limit, pole, effects.get("reference_shaping")) for w, z in both]
        self._sigma, self._yaw_accel = (
            vehicle.yaw_1_s,
            effects.get("yaw_rate_shaping", {}).get("shaping_yaw_accel", inf),
        )
        self._r_before = self._r_after = self._shaped = self._yaw = 0.0
        # Loops that nothing changes need no simulation; where none were fitted, targets that are asked for are all there is.
        self._alike = limit == inf and not pole and not any(self._turn) and "reference_shaping" not in effects

    def advance(self, k: int, roll: float, pitch: float) -> tuple[FloatArray, tuple[float, float, float]]:
        """(roll, pitch, yaw) rad and their rates, rad/s, more than as recorded."""
        ask = [line.advance(a) for line, a in zip(self._asked, (roll, pitch), strict=True)]
        refs = [0.0, 0.0] if self._alike else [float(r[k]) for r in self._refs]
        wanted = [refs[0] + ask[0], refs[1] + ask[1]]
        crossed = [wanted[0] + self._turn[0] * wanted[1], wanted[1] + self._turn[1] * wanted[0]]
        for axis, goal in zip((*self._before, *self._after), (*refs, *crossed), strict=True):
            axis.advance(goal)
        yaw_rate = float(self._yaw_rate[k])
        step = self._yaw_accel * STEP_S
        self._shaped += min(max(yaw_rate - self._shaped, -step), step)
        share = 1.0 - exp(-self._sigma * STEP_S)
        self._r_before += share * (yaw_rate - self._r_before)
        self._r_after += share * (self._shaped - self._r_after)
        self._yaw += STEP_S * (self._r_after - self._r_before)
        angles = [b.angle - a.angle for a, b in zip(self._before, self._after, strict=True)]
        rates = [b.rate - a.rate for a, b in zip(self._before, self._after, strict=True)]
        return np.array([*angles, self._yaw]), (rates[0], rates[1], self._r_after - self._r_before)


class AirEffects:
    """What air, ground and heat do to the thrust of the flight with the effects, and to the body."""

    def __init__(self, effects: Effects, height_m: FloatArray, since_s: FloatArray) -> None:
        square = effects.get("quadratic_drag", {})
        self._square = np.array([square.get(f"k_{a}", 0.0) for a in "xyz"])
        self._h_force = effects.get("thrust_scaled_drag", {}).get("c_h", 0.0)
        self._lift = effects.get("translational_lift", {}).get("k_lift", 0.0)
        self._inflow = effects.get("axial_inflow", {}).get("k_inflow", 0.0)
        self._ground, self._height_m = effects.get("ground_effect", {}).get("R2_m2", 0.0) / 16.0, height_m
        fade = effects.get("thrust_fade", {})
        self._fade = fade.get("fade_depth", 0.0) * (1.0 - np.exp(-since_s / fade.get("fade_tau", 1.0)))

    def force(self, k: int, body: FloatArray, lift: float, higher_m: float) -> FloatArray:
        """(3,) m/s^2, body. body (3,): velocity through still air, m/s; lift: thrust over mass, m/s^2; higher_m: than as recorded."""
        found = -self._square * np.abs(body) * body
        gain = (1.0 + self._lift * float(body[0] ** 2 + body[1] ** 2)) * (1.0 - float(self._fade[k]))
        if self._ground:
            z = max(float(self._height_m[k]) + higher_m, sqrt(self._ground))
            gain /= 1.0 - min(self._ground / (z * z), 0.6)
        found[:2] -= self._h_force * lift * body[:2]
        found[2] += lift * (gain - 1.0) - self._inflow * sqrt(max(lift * gain, 0.0) * G_M_S2) * float(body[2])
        return np.asarray(found)
