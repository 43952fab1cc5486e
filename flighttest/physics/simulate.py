"""The chained model stepped through time: many runs at once, references held between edges (zero-order hold), delays applied exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.physics.system import System
from flighttest.physics.vectorised import MappedColumns, Vectorised

FloatArray = NDArray[np.float64]
Edges = tuple[FloatArray, FloatArray]

MAX_STEP_S = 0.0101
_CHUNK = 64
FEW = 96  # columns up to which CasADi is faster than numpy
TOGETHER = 16  # runs from which on numpy, over all of them, overtakes CasADi, one after the other


class Simulable(Protocol):
    """What is simulated: `physics.model.Model`, as far as a simulation reads of it."""

    @property
    def g_m_s2(self) -> float:
        """Gravity, m/s^2: the specific thrust that a run begins with where nothing is given."""

    @property
    def system(self) -> System:
        """Everything chained, without the delays."""


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
    return rk4_stages(lambda at, _: rate(at), x, dt, (None, None, None))[0]


def rk4_stages(rate: Any, x: Any, dt: Any, e: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
    """The same for x_dot = rate(x, e), e given at the start, middle and end of the step; with the rates at its start and end."""
    k1 = rate(x, e[0])
    k2 = rate(x + dt / 2 * k1, e[1])
    k3 = rate(x + dt / 2 * k2, e[1])
    k4 = rate(x + dt * k3, e[2])
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4), k1, k4


class RungeKuttaStep:
    """One RK4 step of x_dot = rate(x, u), inputs held, for many columns at once: x (k, n), u (m, n), dt a number or (n,), s."""

    def __init__(self, rate: ca.Function) -> None:
        self._rate = rate
        self._few: dict[int, MappedColumns] = {}

    def __call__(self, x: FloatArray, u: FloatArray, dt: float | FloatArray) -> FloatArray:
        """The states after the step (k, n)."""
        n = x.shape[1]
        if n > FEW:
            return np.asarray(rk4(lambda at: self.rate(at, u), x, dt))
        if n not in self._few:
            self._few[n] = MappedColumns(self._step, n)
        return self._few[n](x, u, np.asarray(dt))

    @cached_property
    def rate(self) -> Vectorised:
        """x_dot (k, n) of x (k, n), u (m, n)."""
        return Vectorised(self._rate)

    @cached_property
    def _step(self) -> ca.Function:
        x, u, dt = ca.SX.sym("x", self._rate.size1_in(0)), ca.SX.sym("u", self._rate.size1_in(1)), ca.SX.sym("dt")
        return ca.Function("step", [x, u, dt], [ca.densify(ca.cse(rk4(lambda at: self._rate(at, u), x, dt)))])


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


def edge_grid(
    system: System,
    delays_s: Mapping[str, float],
    t_s: FloatArray,
    references: Mapping[str, Edges],
    signals: Mapping[str, Edges],
    max_step_s: float = MAX_STEP_S,
) -> Grid:
    """Merge output times and delayed edges.

    t_s: (n,) increasing, the run starts at t_s[0]; references: held inputs, as sent (delays are added here); signals: inputs interpolated
    linearly (voltage_v, attitude where the model has no loops). Inputs named in neither are 0 (voltage_v must be given), time_s is t_s.
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


@dataclass(frozen=True)
class Run:
    """One run to be simulated. t_s: output times (n,); start: states by name, 0 where not given (a_t_m_s2: g); the rest: see
    `edge_grid`."""

    t_s: FloatArray
    start: Mapping[str, float]
    references: Mapping[str, Edges]
    signals: Mapping[str, Edges]


def simulate(
    model: Simulable,
    values: Mapping[str, float],
    t_s: FloatArray,
    start: Mapping[str, float],
    references: Mapping[str, Edges],
    signals: Mapping[str, Edges],
) -> dict[str, FloatArray]:
    """One run: states and outputs (channel names) at t_s, (n,) each. See `Run`."""
    return simulate_many(model, values, [Run(t_s, start, references, signals)])[0]


def simulate_many(
    model: Simulable, values: Mapping[str, float], runs: Sequence[Run], max_step_s: float = MAX_STEP_S
) -> list[dict[str, FloatArray]]:
    """The same for many runs at once."""
    if not runs:
        return []
    system = model.system
    p = np.array([values[n] for n in system.params])
    delays = dict(zip(system.delay_channels, np.asarray(system.delays_s(p)).ravel().tolist(), strict=True))
    made = [edge_grid(system, delays, run.t_s, run.references, run.signals, max_step_s) for run in runs]
    begun = np.array([[_begin(model, run).get(n, 0.0) for n in system.states] for run in runs])
    flown = _together(system, p, begun, made) if len(runs) >= TOGETHER else _one_by_one(system, p, begun, made)
    at = [np.concatenate([x0[None], states])[g.sample + 1] for x0, states, g in zip(begun, flown, made, strict=True)]
    every, inputs = np.concatenate(at), np.concatenate([g.u[np.clip(g.sample, 0, None)] for g in made])
    x, u = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
    outputs = Vectorised(ca.Function("y", [x, u], [ca.densify(ca.cse(system.function(x, u, p)[1]))]))(every.T, inputs.T)
    ends = np.cumsum([run.t_s.size for run in runs])
    found = []
    for states_of, outputs_of in zip(np.split(every, ends[:-1]), np.split(outputs, ends[:-1], axis=1), strict=True):
        one = {n: states_of[:, i] for i, n in enumerate(system.states)}
        found.append(one | {n: outputs_of[i] for i, n in enumerate(system.outputs)})
    return found


def _one_by_one(system: System, p: FloatArray, begun: FloatArray, made: Sequence[Grid]) -> list[FloatArray]:
    """States after each piece of each run (k, n_x), by CasADi: for few runs."""
    stepper = Stepper(rk4_step(system))
    found: list[FloatArray] = [np.zeros((0, 0))] * len(made)
    for group in _alike([g.dt_s.size for g in made]):
        k = max(made[i].dt_s.size for i in group)
        # What is shorter stands still at its end.
        u = np.stack([np.pad(made[i].u, ((0, k - made[i].dt_s.size), (0, 0)), mode="edge") for i in group])
        dt = np.stack([np.pad(made[i].dt_s, (0, k - made[i].dt_s.size)) for i in group])
        states = stepper.run(begun[group], u, p, dt)
        for row, i in enumerate(group):
            found[i] = states[row, : made[i].dt_s.size]
    return found


def _together(system: System, p: FloatArray, begun: FloatArray, made: Sequence[Grid]) -> list[FloatArray]:
    """The same, a piece of every run at a time: for many runs."""
    x, u = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
    step = RungeKuttaStep(ca.Function("rate", [x, u], [ca.densify(ca.cse(ca.simplify(system.function(x, u, p)[0])))]))
    order = sorted(range(len(made)), key=lambda i: -made[i].dt_s.size)
    sizes = np.array([made[i].dt_s.size for i in order])
    k = int(sizes[0])
    inputs, dt = np.zeros((k, len(system.inputs), len(made))), np.zeros((k, len(made)))
    for row, i in enumerate(order):
        inputs[: sizes[row], :, row], dt[: sizes[row], row] = made[i].u, made[i].dt_s
    states = np.zeros((k, len(system.states), len(made)))
    now = begun[order].T
    for piece in range(k):
        flying = int(np.searchsorted(-sizes, -piece, side="left"))
        now = step(now[:, :flying], inputs[piece, :, :flying], dt[piece, :flying])
        states[piece, :, :flying] = now
    found: list[FloatArray] = [np.zeros((0, 0))] * len(made)
    for row, i in enumerate(order):
        found[i] = states[: sizes[row], :, row]
    return found


def _begin(model: Simulable, run: Run) -> dict[str, float]:
    return {"a_t_m_s2": model.g_m_s2, **model.system.initial, **run.start}


def _alike(sizes: Sequence[int]) -> list[list[int]]:
    """Indices in groups whose sizes differ by no more than a half."""
    groups: list[list[int]] = []
    for i in sorted(range(len(sizes)), key=lambda i: sizes[i]):
        if groups and sizes[i] <= 1.5 * sizes[groups[-1][0]]:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups
