"""A predictor for tests: paper Eq. 4 with Table 2, written out in numpy as a witness independent of the package's physics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flighttest.plan import compile_plan
from flighttest.plan.model import PredictedMotion, Snapshot
from flighttest.script.load import load_script, parse_script
from flighttest.script.shipped import resolve
from flighttest.vehicle.model import DEFAULT_VEHICLE

W = np.array([25.43, 23.40])
Z = np.array([0.44, 0.39])
SIGMA_R, SIGMA_T, ALPHA = 21.54, 20.36, 1.71
D = np.array([0.39, 0.39, 0.51])
G, U_N, T_D = 9.81, 22.2, 0.1


class PaperPredictor:
    """Eq. 4, RK4 at the policy's own rate, K from the vehicle's hover throttle (54.5 for 0.18)."""

    delay_s = T_D
    attitude_lag_s = 0.5 * (2 * 0.44 / 25.43 + 2 * 0.39 / 23.40)
    thrust_lag_s = 1.0 / SIGMA_T

    def __init__(self, hover_throttle=0.18, nominal_voltage_v=U_N):
        self.hover, self.u_n = hover_throttle, nominal_voltage_v
        self.k = G / hover_throttle

    def hover_throttle(self, voltage_v):
        return self.hover * (self.u_n / np.asarray(voltage_v)) ** ALPHA

    def fly(self, start_m, yaw_rad, voltage_v, policy, duration_s, dt_s):
        n, m = len(yaw_rad), round(duration_s / dt_s)
        gain = self.k * (np.asarray(voltage_v) / self.u_n) ** ALPHA
        x = np.zeros((12, n))  # p, v, roll, pitch, roll', pitch', r, yaw -> a_t is row 12
        x = np.vstack([x, np.full((1, n), G)])
        x[0:3], x[11] = start_m.T, yaw_rad
        hover = np.zeros((n, 4))
        hover[:, 3] = G / gain
        lag = T_D / dt_s
        whole, part = math.floor(lag + 1e-9), lag - math.floor(lag + 1e-9)
        past = [hover] * (whole + 2)
        history = [x]
        for k in range(m):
            now = Snapshot(k * dt_s, x[0:3].T, x[3:6].T, np.stack([x[6], x[7], x[11]], axis=1))
            past = [np.array(policy(now)), *past[: whole + 1]]
            u = ((1 - part) * past[whole] + part * past[whole + 1]).T
            k1 = self._rate(x, u, gain)
            k2 = self._rate(x + 0.5 * dt_s * k1, u, gain)
            k3 = self._rate(x + 0.5 * dt_s * k2, u, gain)
            k4 = self._rate(x + dt_s * k3, u, gain)
            x = x + dt_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            history.append(x)
        h = np.stack(history, axis=-1)  # (13, n, m + 1)
        return PredictedMotion(
            np.arange(m + 1) * dt_s,
            np.moveaxis(h[0:3], 0, -1),
            np.moveaxis(h[3:6], 0, -1),
            np.moveaxis(h[[6, 7, 11]], 0, -1),
        )

    @staticmethod
    def _rate(x, u, gain):
        phi, theta, psi, a_t = x[6], x[7], x[11], x[12]
        sp, cp, st, ct, ss, cs = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta), np.sin(psi), np.cos(psi)
        ex = np.stack([cs * ct, ss * ct, -st])
        ey = np.stack([cs * st * sp - ss * cp, ss * st * sp + cs * cp, ct * sp])
        ez = np.stack([cs * st * cp + ss * sp, ss * st * cp - cs * sp, ct * cp])
        v = x[3:6]
        drag = sum(d * e * (e * v).sum(axis=0) for d, e in zip(D, (ex, ey, ez), strict=True))
        dx = np.empty_like(x)
        dx[0:3] = v
        dx[3:6] = ez * a_t - drag
        dx[5] -= G
        dx[6], dx[7] = x[8], x[9]
        dx[8] = W[0] ** 2 * (u[0] - phi) - 2 * Z[0] * W[0] * x[8]
        dx[9] = W[1] ** 2 * (u[1] - theta) - 2 * Z[1] * W[1] * x[9]
        dx[10] = SIGMA_R * (u[2] - x[10])
        dx[11] = (x[10] / cp + np.tan(phi) * x[9]) / ct
        dx[12] = SIGMA_T * (gain * u[3] - a_t)
        return dx


@pytest.fixture(scope="session")
def predictor():
    return PaperPredictor()


@pytest.fixture(scope="session")
def planned(predictor):
    """Plans of shipped scripts for the default vehicle, compiled once."""
    plans = {}

    def of(name):
        if name not in plans:
            plans[name] = compile_plan(load_script(resolve(name)), DEFAULT_VEHICLE, predictor)
        return plans[name]

    return of


@pytest.fixture
def plan_of(predictor):
    """A plan of one step, given as YAML, for the default vehicle or another."""

    def of(step, vehicle=DEFAULT_VEHICLE, head="", repeat="repeat: {each: 1}"):
        text = f"format: maneuver/1\nname: t\n{head}\nsteps:\n  - {step}\n{repeat}\n"
        return compile_plan(parse_script(text), vehicle, predictor)

    return of
