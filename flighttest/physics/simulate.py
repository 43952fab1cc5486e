"""The chained model stepped through time: many runs at once, references held between edges, delays applied exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.physics.model import Model
from flighttest.physics.system import System

FloatArray = NDArray[np.float64]
Edges = tuple[FloatArray, FloatArray]

MAX_STEP_S = 0.0101
_CHUNK = 64


def rk4_step(system: System) -> ca.Function:
    """x_next = step(x, u, p, dt): one Runge-Kutta step, inputs held."""
    x, u, p, dt = (
        ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs)),
        ca.SX.sym("p", len(system.params)), ca.SX.sym("dt"),
    )  # fmt: skip
    after = rk4(lambda at: system.function(at, u, p)[0], x, dt)
    return ca.Function("step", [x, u, p, dt], [ca.cse(after)], ["x", "u", "p", "dt"], ["x_next"])


def rk4(rate: Any, x: Any, dt: Any) -> Any:
    """The state after one classical Runge-Kutta step of x_dot = rate(x)."""
    k1 = rate(x)
    k2 = rate(x + dt / 2 * k1)
    k3 = rate(x + dt / 2 * k2)
    k4 = rate(x + dt * k3)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@dataclass
class Stepper:
    """Runs a step function x_next = step(x, u, p, dt) over many sequences at once; keeps what it compiles."""

    step: ca.Function
    _built: dict[int, Any] = field(default_factory=dict, repr=False)

    def run(self, x0: FloatArray, u: FloatArray, p: FloatArray, dt: FloatArray) -> FloatArray:
        """x0 (m, n_x), u (m, k, n_u), p (n_p,) or (m, n_p), dt (m, k) to states after each step, (m, k, n_x)."""
        m, k, _ = u.shape
        each = np.broadcast_to(p, (m, p.shape[-1]))
        out = np.empty((m, k, x0.shape[1]))
        x = np.asarray(x0, dtype=float)
        for first in range(0, k, _CHUNK):
            size = min(_CHUNK, k - first)
            u_now = np.zeros((m, _CHUNK, u.shape[2]))
            dt_now = np.zeros((m, _CHUNK))
            u_now[:, :size], dt_now[:, :size] = u[:, first : first + size], dt[:, first : first + size]
            u_now[:, size:] = u[:, -1:]
            made = self._mapped(m)(
                x.T, u_now.reshape(m * _CHUNK, -1).T, np.repeat(each, _CHUNK, axis=0).T, dt_now.reshape(1, -1)
            )
            states = np.asarray(made).T.reshape(m, _CHUNK, -1)
            out[:, first : first + size] = states[:, :size]
            x = states[:, size - 1]
        return out

    def _mapped(self, m: int) -> Any:
        if m not in self._built:
            self._built[m] = self.step.mapaccum(_CHUNK).map(m)
        return self._built[m]


@dataclass(frozen=True)
class Grid:
    """Pieces in which inputs are constant: ends_s, dt_s (k,), u (k, n_inputs); sample: the piece that ends at each asked time."""

    ends_s: FloatArray
    dt_s: FloatArray
    u: FloatArray
    sample: NDArray[np.intp]


def grid(
    system: System,
    delays_s: Mapping[str, float],
    t_s: FloatArray,
    references: Mapping[str, Edges],
    signals: Mapping[str, Edges],
    max_step_s: float = MAX_STEP_S,
) -> Grid:
    """Merge output times and delayed edges.

    t_s: (n,) increasing, the run starts at t_s[0]; references: held inputs, as sent (delays are added here); signals: inputs interpolated
    linearly (voltage_v, attitude where the model has no loops). Inputs named in neither are 0 (voltage_v must be given).
    """
    moved = {n: (e[0] + delays_s.get(system.input_delay.get(n, ""), 0.0), e[1]) for n, e in references.items()}
    inside = [e[0][(e[0] > t_s[0]) & (e[0] < t_s[-1])] for e in moved.values()]
    times = np.unique(np.concatenate([t_s, *inside]))
    pieces = np.maximum(1, np.ceil(np.diff(times) / max_step_s - 1e-9)).astype(int)
    which = np.repeat(np.arange(pieces.size), pieces)
    dt = (np.diff(times) / pieces)[which]
    ends = times[0] + np.cumsum(dt)
    middle = ends - 0.5 * dt
    u = np.zeros((ends.size, len(system.inputs)))
    for i, name in enumerate(system.inputs):
        if name in moved and moved[name][0].size:
            at = np.clip(np.searchsorted(moved[name][0], middle, side="right") - 1, 0, None)
            u[:, i] = moved[name][1][at]
        elif name in signals:
            u[:, i] = np.interp(middle, *signals[name])
        elif name == "time_s":
            u[:, i] = middle
    last = np.cumsum(pieces) - 1
    sample = np.concatenate([[-1], last])[np.searchsorted(times, t_s)]
    return Grid(ends, dt, u, sample.astype(np.intp))


def simulate(
    model: Model,
    values: Mapping[str, float],
    t_s: FloatArray,
    start: Mapping[str, float],
    references: Mapping[str, Edges],
    signals: Mapping[str, Edges],
) -> dict[str, FloatArray]:
    """One run: states and outputs (channel names) at t_s, (n,) each.

    start: initial states by name, 0 where not given (a_t_m_s2: g); references, signals: see `grid`.
    """
    system = model.system
    p = np.array([values[n] for n in system.params])
    delays = dict(zip(system.delay_channels, np.asarray(system.delays_s(p)).ravel().tolist(), strict=True))
    made = grid(system, delays, t_s, references, signals)
    begin = {"a_t_m_s2": model.g_m_s2, **system.initial, **start}
    x0 = np.array([[begin.get(n, 0.0) for n in system.states]])
    states = Stepper(rk4_step(system)).run(x0, made.u[None], p, made.dt_s[None])[0]
    at = np.concatenate([x0, states])[made.sample + 1]
    u_at = made.u[np.clip(made.sample, 0, None)]
    outputs = np.asarray(system.function.map(t_s.size)(at.T, u_at.T, np.tile(p[:, None], t_s.size))[1])
    found = {n: at[:, i] for i, n in enumerate(system.states)}
    found |= {n: outputs[i] for i, n in enumerate(system.outputs)}
    return found
