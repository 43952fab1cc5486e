"""Commands of an identified multirotor for RotorPy (pypi.org/project/rotorpy): references and throttle to thrust and moments.

    vehicle = Multirotor(quad_params, control_abstraction="cmd_ctbm", initial_state=...)
    commands = Commands(IDENTIFIED)
    state = vehicle.step(state, commands(t, dt, state, roll_ref, pitch_ref, yaw_rate_ref, throttle, voltage), dt)

Delays, thrust lag, battery and the attitude loops are here, as identified; mass, drag and rotors are in quad_params. dt: 2 ms or less,
since RotorPy holds a command for a step. World North-West-Up, body Forward-Left-Up: RotorPy's axes. This file needs numpy alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Commands:
    """identified: omega_phi ... as in model.yaml, delays_s by channel, mass_kg, inertia_kg_m2 (3,), nominal_voltage_v, g; RotorPy's own
    motor lag motor_s and the moment spin_drag (3,), N m s, of its rotors' drag in hover per rate are made up for."""

    def __init__(self, identified: Mapping[str, Any]) -> None:
        self.own = dict(identified)
        self.a_t = float(self.own["g"])
        self._last = np.zeros(2)
        self._sent: list[tuple[float, float, float, float, float]] = []

    def __call__(
        self,
        t: float,
        dt: float,
        state: Mapping[str, FloatArray],
        roll_ref: float,
        pitch_ref: float,
        yaw_rate_ref: float,
        throttle: float,
        voltage: float | None = None,
    ) -> dict[str, Any]:
        """Control of RotorPy's cmd_ctbm for the step from t, s, of dt, s, by references sent now."""
        b = self.own
        self._sent.append((t, roll_ref, pitch_ref, yaw_rate_ref, throttle))
        lead = 0.5 * dt + b["motor_s"]  # the moments act so much later, on the mean
        roll_r, pitch_r = self._due(t + lead, "attitude", 1), self._due(t + lead, "attitude", 2)
        rate_r, late_throttle = self._due(t + lead, "yaw_rate", 3), self._due(t + b["motor_s"], "thrust", 4)
        volts = b["nominal_voltage_v"] if voltage is None else voltage
        asked = b["K"] * (volts / b["nominal_voltage_v"]) ** b["alpha"] * late_throttle
        # the mean of the thrust over the step that the command is held for
        keep = np.exp(-b["sigma_t"] * dt)
        mean = asked + (self.a_t - asked) * (1.0 - keep) / (b["sigma_t"] * dt)
        self.a_t = asked + (self.a_t - asked) * keep
        rates = np.asarray(state["w"], dtype=float)
        roll, pitch = euler(state["q"])
        turn = np.sin(roll) * rates[1] + np.cos(roll) * rates[2]
        roll_d, pitch_d = rates[0] + np.tan(pitch) * turn, np.cos(roll) * rates[1] - np.sin(roll) * rates[2]
        roll, pitch = roll + lead * roll_d, pitch + lead * pitch_d
        roll_d, pitch_d = roll_d + lead * self._last[0], pitch_d + lead * self._last[1]
        roll_dd = b["omega_phi"] ** 2 * (roll_r - roll) - 2 * b["zeta_phi"] * b["omega_phi"] * roll_d
        pitch_dd = b["omega_theta"] ** 2 * (pitch_r - pitch) - 2 * b["zeta_theta"] * b["omega_theta"] * pitch_d
        self._last = np.array([roll_dd, pitch_dd])
        now = np.array([roll, pitch, roll_d, pitch_d, rates[2]])
        change = np.array([roll_d, pitch_d, roll_dd, pitch_dd, b["sigma_r"] * (rate_r - rates[2])])
        wdot = (_body_rates(now + 1e-6 * change) - _body_rates(now - 1e-6 * change)) / 2e-6
        inertia = np.asarray(b["inertia_kg_m2"], dtype=float)
        braked = np.sqrt(max(mean, 0.0) / b["g"]) * np.asarray(b["spin_drag"]) * rates
        return {
            "cmd_thrust": b["mass_kg"] * max(mean, 0.0),
            "cmd_moment": inertia * wdot + np.cross(rates, inertia * rates) + braked,
        }

    def _due(self, t: float, channel: str, column: int) -> float:
        """What was sent a delay ago; the first command before that."""
        late = t - self.own["delays_s"][channel] + 1e-9
        return next((s[column] for s in reversed(self._sent) if s[0] <= late), self._sent[0][column])


def euler(q: FloatArray) -> tuple[float, float]:
    """Roll and pitch, rad, of a quaternion (x, y, z, w), body to world."""
    x, y, z, w = (float(v) for v in q)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return float(roll), float(np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)))


def _body_rates(s: FloatArray) -> FloatArray:
    """p, q, r of (roll, pitch, their rates, r)."""
    roll, pitch, roll_d, pitch_d, r = s
    yaw_d = (r / np.cos(roll) + np.tan(roll) * pitch_d) / np.cos(pitch)
    p = roll_d - np.sin(pitch) * yaw_d
    return np.array([p, np.cos(roll) * pitch_d + np.sin(roll) * np.cos(pitch) * yaw_d, r])
