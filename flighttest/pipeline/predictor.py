"""The prior model as `plan` wants it: many vehicles flown at once through targets that may depend on where they are.

The equations are those of `physics.model`; nothing is written twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.physics.model import Model
from flighttest.physics.vectorised import Vectorised
from flighttest.plan.model import Motion, Policy, Snapshot

FloatArray = NDArray[np.float64]

# What the coarse steps of a rehearsal can follow.
SHORTEST_LAG_S = 0.025

_POSITION = ("p_x_m", "p_y_m", "p_z_m")
_VELOCITY = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_ATTITUDE = ("roll_rad", "pitch_rad", "yaw_rad")
_TARGETS = ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle")
# What stays zero in a flight straight up and down.
_SIDEWAYS = (
    *("roll_rad", "pitch_rad", "roll_rate_rad_s", "pitch_rate_rad_s", "r_rad_s", "v_x_m_s", "v_y_m_s"),
    *_TARGETS[:3],
)
_CHANNEL = {
    "roll_ref_rad": "attitude",
    "pitch_ref_rad": "attitude",
    "yaw_rate_ref_rad_s": "yaw_rate",
    "throttle": "thrust",
}


class ModelPredictor:
    """`plan.Predictor` over a fitted or nominal `Model`. values: parameters by name; the rest at the model's start values."""

    def __init__(self, model: Model | None = None, values: Mapping[str, float] | None = None) -> None:
        self.model = model or Model()
        self.values = self.model.start(values)
        self._p = np.array([self.values[n] for n in self.model.system.params])
        delays = np.asarray(self.model.system.delays_s(self._p)).ravel()
        self._delays_s = dict(zip(self.model.system.delay_channels, delays.tolist(), strict=True))

    @property
    def delay_s(self) -> float:
        """From sending a target to the first effect: the longest of the channels, s."""
        return max(self._delays_s.values(), default=0.0)

    @property
    def attitude_lag_s(self) -> float:
        """Mean age of the attitude behind its delayed reference, s."""
        loops = [("zeta_phi", "omega_phi"), ("zeta_theta", "omega_theta")]
        return max((2.0 * self.values[z] / self.values[w] for z, w in loops if w in self.values), default=0.0)

    @property
    def thrust_lag_s(self) -> float:
        """Mean age of the thrust behind its delayed command, s."""
        return 1.0 / self.values["sigma_t"]

    def hover_throttle(self, voltage_v: FloatArray) -> FloatArray:
        """Throttle (n,) that holds height at these voltages (n,)."""
        ratio = np.asarray(voltage_v, dtype=float) / self.model.nominal_voltage_v
        return np.asarray(self.model.g_m_s2 / (self.values["K"] * ratio ** self.values["alpha"]))

    @property
    def thrust_age_s(self) -> float:
        """From sending a throttle to its mean effect, s."""
        return float(self._delays_s.get("thrust", self.delay_s)) + self.thrust_lag_s

    def corrected(self, hover_throttle: float, voltage_v: float, thrust_age_s: float | None = None) -> ModelPredictor:
        """The same vehicle with the hover throttle seen at a voltage, V, and the mean age of its thrust, s (None: as it was).

        What the age leaves beside the lag is delay, of every channel: they come over one link.
        """
        now = float(self.hover_throttle(np.array([voltage_v]))[0])
        values = {**self.values, "K": self.values["K"] * now / hover_throttle}
        if thrust_age_s is not None:
            lag = min(self.thrust_lag_s, max(thrust_age_s, SHORTEST_LAG_S))
            delay = max(thrust_age_s - lag, 0.0)
            values |= {"sigma_t": 1.0 / lag, **{name: delay for name in values if name.startswith("T_d")}}
        return ModelPredictor(self.model, values)

    @cached_property
    def _rate(self) -> Vectorised:
        return Vectorised(self._rate_of([]))

    @cached_property
    def _level_rate(self) -> Vectorised | None:
        """The same for vehicles that have only been asked to go up and down, where that keeps them level: a quarter of the work."""
        function = self._rate_of([n for n in _SIDEWAYS if n in (*self.model.system.states, *self.model.system.inputs)])
        rates = function(*(ca.SX.sym("z", *function.size_in(i)) for i in range(2)))
        still = all(rates[i].is_zero() for i, n in enumerate(self.model.system.states) if n in _SIDEWAYS)
        return Vectorised(function) if still else None

    def _rate_of(self, zero: list[str]) -> ca.Function:
        """The rate of change of the states, some states and inputs being zero."""
        system = self.model.system
        x, u = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
        at = [
            ca.vertcat(*(0.0 if n in zero else of[i] for i, n in enumerate(ns)))
            for of, ns in ((x, system.states), (u, system.inputs))
        ]
        return ca.Function("rate", [x, u], [ca.cse(ca.simplify(system.function(*at, self._p)[0]))])

    def _step(self, rate: Vectorised, x: FloatArray, u: FloatArray, dt_s: float) -> FloatArray:
        """One RK4 step of n vehicles: states (k, n), inputs (m, n)."""
        k1 = rate(x, u)
        k2 = rate(x + dt_s / 2 * k1, u)
        k3 = rate(x + dt_s / 2 * k2, u)
        k4 = rate(x + dt_s * k3, u)
        return x + dt_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def fly(
        self,
        start_m: FloatArray,
        yaw_rad: FloatArray,
        voltage_v: FloatArray,
        policy: Policy,
        duration_s: float,
        dt_s: float,
    ) -> Motion:
        """Fly n vehicles from rest at start_m (n, 3), yaw_rad (n,), voltage_v (n,), hovering until now, for duration_s."""
        system = self.model.system
        start, yaw, volts = np.atleast_2d(start_m), np.atleast_1d(yaw_rad), np.atleast_1d(voltage_v)
        n, steps = len(start), max(round(duration_s / dt_s), 1)
        states, inputs = list(system.states), list(system.inputs)
        x = np.zeros((len(states), n))
        for name, value in system.initial.items():
            x[states.index(name)] = value
        place = [states.index(s) for s in _POSITION]
        speed = [states.index(s) for s in _VELOCITY]
        angle = [states.index(s) for s in _ATTITUDE]
        x[place] = start.T
        x[angle[2]] = yaw
        x[states.index("a_t_m_s2")] = self.model.g_m_s2
        hover = np.zeros((n, 4))
        hover[:, 3] = self.hover_throttle(volts)
        # A delay between two steps is the mean of both, weighted: what is held is then delayed by it on the mean.
        lag = [divmod(self._delays_s[_CHANNEL[t]] / dt_s + 1e-9, 1.0) for t in _TARGETS]
        u = np.zeros((len(inputs), n))
        u[inputs.index("voltage_v")] = volts
        rows = [inputs.index(t) for t in _TARGETS]
        history: list[FloatArray] = []
        record = np.empty((steps + 1, len(states), n))
        record[0] = x
        turns = rows[:3]
        rate = self._level_rate or self._rate
        for k in range(steps):
            now = Snapshot(k * dt_s, x[place].T, x[speed].T, x[angle].T)
            history.append(np.broadcast_to(np.asarray(policy(now), dtype=float), (n, 4)))
            for column, (row, (whole, part)) in enumerate(zip(rows, lag, strict=True)):
                late = k - int(whole)
                u[row] = (history[late] if late >= 0 else hover)[:, column]
                if part > 1e-6:
                    u[row] += part * ((history[late - 1] if late >= 1 else hover)[:, column] - u[row])
            if "time_s" in inputs:
                u[inputs.index("time_s")] = k * dt_s
            if rate is not self._rate and u[turns].any():
                rate = self._rate
            x = self._step(rate, x, u, dt_s)
            record[k + 1] = x
        flown = record.transpose(2, 0, 1)
        t_s = np.arange(steps + 1, dtype=float) * dt_s
        return Motion(t_s, flown[:, :, place], flown[:, :, speed], flown[:, :, angle])
