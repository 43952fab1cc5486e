"""The models under comparison in a validation (paper, Table 4), each run open loop from many starts at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.interpolation import filled
from flighttest.estimation.responses import exogenous, zero_order_hold
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics import body
from flighttest.physics.model import Model
from flighttest.physics.simulate import Grid, Stepper, edge_grid, rk4, rk4_step
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

GROUPS: dict[str, tuple[str, ...]] = {
    "position": ("p_x_m", "p_y_m", "p_z_m"),
    "velocity": ("v_x_m_s", "v_y_m_s", "v_z_m_s"),
    "roll": ("roll_rad",),
    "pitch": ("pitch_rad",),
    "yaw": ("yaw_rad",),
    "roll rate": ("p_rad_s",),
    "yaw rate": ("r_rad_s",),
    "acceleration": ("a_x_m_s2", "a_y_m_s2", "a_z_m_s2"),
}
UNITS = {
    "position": "m", "velocity": "m/s", "roll": "rad", "pitch": "rad", "yaw": "rad", "roll rate": "rad/s",
    "yaw rate": "rad/s", "acceleration": "m/s^2",
}  # fmt: skip
CHANNELS_COMPARED = tuple(c for group in GROUPS.values() for c in group)


class Variation(Enum):
    """The models under comparison; the value is how each is called."""

    FULL = "full model"
    LINEARISED = "linearised about hover"
    NO_DRAG = "no drag"
    NO_BATTERY = "no battery dependency"
    ONLY_DELAY = "only delay"
    HOLD = "hold the last measurement"
    PREVIOUS = "previous model"


@dataclass(frozen=True)
class OpenLoopStart:
    """One run: its segment, first sample, and samples covered."""

    segment: int
    first: int
    last: int


def measured_channels(segment: Segment) -> dict[str, FloatArray]:
    """Channels compared, at the segment's times; NaN where missing; yaw unwrapped."""
    found = {}
    for channel in CHANNELS_COMPARED:
        values = segment.y.get(channel)
        if values is not None and np.isfinite(values).any():
            found[channel] = (
                np.unwrap(values) if channel == "yaw_rad" and np.isfinite(values).all() else np.asarray(values)
            )
    return found


def _start_state(model: Model, values: Mapping[str, float], segment: Segment, k: int) -> FloatArray:
    """States at one sample, from what was measured there; roll and pitch rates from p and q."""
    t, y = segment.t_s, segment.y

    def at(name: str, default: float = 0.0) -> float:
        column = y.get(name)
        return default if column is None else float(filled(t, column, default)[k])

    roll, pitch = at("roll_rad"), at("pitch_rad")
    p, q, r = at("p_rad_s"), at("q_rad_s"), at("r_rad_s")
    roll_rate, pitch_rate = body.euler_rates(roll, pitch, (p, q, r))
    known = {
        "roll_rate_rad_s": roll_rate,
        "pitch_rate_rad_s": pitch_rate,
        "a_t_m_s2": _thrust_at(values, segment, k, model.g_m_s2),
        **model.system.initial,
    }
    return np.array([known[n] if n in known else at(n) for n in model.system.states], dtype=float)


def _thrust_at(values: Mapping[str, float], segment: Segment, k: int, g: float) -> float:
    """a_t at a sample: the mean of neighbouring accelerometer samples, drag along z added back."""
    f = segment.y.get("f_z_m_s2")
    if f is None:
        return g
    near = f[max(k - 1, 0) : k + 2]
    near = near[np.isfinite(near)]
    v_z = segment.y.get("v_z_m_s")
    drag = values.get("d_z", 0.0) * float(v_z[k]) if v_z is not None and np.isfinite(v_z[k]) else 0.0
    return float(near.mean()) + drag if near.size else g


def _grid_of(model: Model, values: Mapping[str, float], segment: Segment) -> Grid:
    system = model.system
    delays = np.asarray(system.delays_s(np.array([values[n] for n in system.params]))).ravel().tolist()
    t = segment.t_s
    voltage = filled(t, segment.y.get("voltage_v"), model.nominal_voltage_v)
    signals = {"voltage_v": (t, voltage)}
    for name in system.inputs:
        if name not in segment.u and name != "voltage_v":
            signals[name] = (t, exogenous(segment, name, model.nominal_voltage_v, 0.0))
    references = {n: segment.u[n] for n in system.input_delay if n in segment.u}
    return edge_grid(system, dict(zip(system.delay_channels, delays, strict=True)), t, references, signals)


Predicted = list[dict[str, FloatArray]]
Runner = Callable[[Sequence[Segment], Sequence[OpenLoopStart], Sequence[Mapping[str, FloatArray]]], Predicted]


def runner(variation: Variation, stored: ModelFile, previous: ModelFile | None) -> Runner | None:
    """A function (segments, starts, measured) to predictions per start, or None where the variation does not apply."""
    model, values = stored.model, dict(stored.values)
    if variation is Variation.HOLD:
        return _hold
    if variation is Variation.PREVIOUS:
        if previous is None:
            return None
        return _at_voltage(previous, _ModelRun(previous.model, dict(previous.values)))
    if variation is Variation.NO_DRAG:
        values |= {n: 0.0 for n in ("d_x", "d_y", "d_z") if n in values}
    if variation is Variation.NO_BATTERY:
        alpha = stored.parameters.get("alpha")
        if alpha is None or alpha.source == "assumed":
            return None  # nothing was found that could be left out
        values["alpha"] = 0.0
    if variation is Variation.LINEARISED:
        return _at_voltage(stored, _ModelRun(model, values, linear=True))
    if variation is Variation.ONLY_DELAY:
        if not model.attitude_loops:
            return None
        return _at_voltage(stored, _OnlyDelay(model, values))
    return _at_voltage(stored, _ModelRun(model, values))


def voltage_for(stored: ModelFile, segment: Segment) -> Segment:
    """A segment with the voltage its model is to see: where none was recorded, that of the model's own flights.

    A model of flights without voltage has its K at whatever that was: an assumed alpha carries it nowhere.
    """
    volts, alpha = stored.valid.get("voltage_v"), stored.parameters.get("alpha")
    known = segment.y.get("voltage_v")
    if volts:
        if known is not None and np.isfinite(known).any():
            return segment
        there = float(np.mean(volts))
    elif alpha is not None and alpha.source == "assumed":
        there = stored.model.nominal_voltage_v
    else:
        return segment
    context = replace(segment.context, voltage_samples=None)
    return replace(segment, y={**segment.y, "voltage_v": np.full(segment.t_s.size, there)}, context=context)


def _at_voltage(stored: ModelFile, run: Runner) -> Runner:
    return lambda segments, starts, measured: run([voltage_for(stored, s) for s in segments], starts, measured)


def _hold(
    segments: Sequence[Segment], starts: Sequence[OpenLoopStart], measured: Sequence[Mapping[str, FloatArray]]
) -> Predicted:
    found = []
    for s in starts:
        t = segments[s.segment].t_s[s.first : s.last + 1]
        y = measured[s.segment]
        made = {c: np.full(t.size, v[s.first]) for c, v in y.items()}
        for position, velocity in zip(GROUPS["position"], GROUPS["velocity"], strict=True):
            if position in made and velocity in y:
                made[position] = made[position] + y[velocity][s.first] * (t - t[0])
        found.append(made)
    return found


class _ModelRun:
    """Open-loop runs of a model, or of its linearisation about hover at the heading of each start."""

    def __init__(
        self, model: Model, values: Mapping[str, float], linear: bool = False, p: FloatArray | None = None
    ) -> None:
        self.model, self.values, self.linear = model, values, linear
        self.p = np.array([values[n] for n in model.system.params]) if p is None else p  # or one row per start

    def __call__(
        self, segments: Sequence[Segment], starts: Sequence[OpenLoopStart], measured: Sequence[Mapping[str, FloatArray]]
    ) -> Predicted:
        system = self.model.system
        grids = [_grid_of(self.model, self.values, s) for s in segments]
        x0 = np.stack([_start_state(self.model, self.values, segments[s.segment], s.first) for s in starts])
        u, dt, samples = _cut(grids, starts)
        u = self._inputs(u, dt, x0, segments, starts)
        if self.linear:
            step, output, p = self._linearised(x0, u)
        else:
            step, output, p = (
                rk4_step(system),
                system.function,
                np.broadcast_to(self.p, (len(starts), len(system.params))),
            )
        states = Stepper(step).run(x0, u, p, dt)
        found = []
        for i, sample in enumerate(samples):
            path = np.concatenate([x0[i][None], states[i]])[sample + 1]
            inputs = u[i][np.clip(sample, 0, None)]
            made = output.map(len(sample))(path.T, inputs.T, np.tile(p[i][:, None], len(sample)))
            y = np.asarray(made[1] if not self.linear else made)
            found.append({c: y[system.outputs.index(c)] for c in CHANNELS_COMPARED})
        return found

    def _inputs(
        self,
        u: FloatArray,
        dt: FloatArray,
        x0: FloatArray,
        segments: Sequence[Segment],
        starts: Sequence[OpenLoopStart],
    ) -> FloatArray:
        return u

    def _linearised(self, x0: FloatArray, u: FloatArray) -> tuple[ca.Function, ca.Function, FloatArray]:
        """x_dot = A dx + B du about hover; the heading and voltage of each start ride along as parameters."""
        system, model = self.model.system, self.model
        x, v = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
        hover = ca.SX.sym("hover", 3)  # yaw, voltage, throttle
        at_x: dict[str, Any] = {"a_t_m_s2": model.g_m_s2, "yaw_rad": hover[0], "p_z_m": 5.0}
        at_u: dict[str, Any] = {"voltage_v": hover[1], "throttle": hover[2], "yaw_rad": hover[0]}
        x_star = ca.vertcat(*(at_x.get(n, 0.0) for n in system.states))
        u_star = ca.vertcat(*(at_u.get(n, 0.0) for n in system.inputs))
        f, y = system.function(x, v, ca.DM(self.p))
        matrices = [ca.jacobian(f, x), ca.jacobian(f, v), f, ca.jacobian(y, x), ca.jacobian(y, v), y]
        a, b, f0, c, d, y0 = ca.substitute(matrices, [x, v], [x_star, u_star])
        dt = ca.SX.sym("dt")
        moved = v - u_star
        after = rk4(lambda at: f0 + a @ (at - x_star) + b @ moved, x, dt)
        step = ca.Function("linear_step", [x, v, hover, dt], [after])
        output = ca.Function("linear_output", [x, v, hover], [y0 + c @ (x - x_star) + d @ moved])
        inputs, states = list(system.inputs), list(system.states)
        yaw = x0[:, states.index("yaw_rad")] if "yaw_rad" in states else u[:, 0, inputs.index("yaw_rad")]
        voltage = u[:, 0, inputs.index("voltage_v")]
        return step, output, np.stack([yaw, voltage, model.hover_throttle(self.values, voltage)], axis=1)


def open_loop(
    model: Model,
    values: Mapping[str, float],
    segments: Sequence[Segment],
    starts: Sequence[OpenLoopStart],
    p: FloatArray | None = None,
) -> Predicted:
    """Predictions of a model per start, as measured; p: (n_starts, n_params) where each start has parameters of its own (`values` then
    gives the delays and the initial thrust alone)."""
    return _ModelRun(model, values, p=p)(segments, starts, ())


class _OnlyDelay(_ModelRun):
    """Attitude and yaw rate are their delayed references (Table 4); thrust, drag and battery as in the full model."""

    def __init__(self, model: Model, values: Mapping[str, float]) -> None:
        loops = replace(model, attitude_loops=False)
        super().__init__(loops, {n: values[n] for n in loops.names})
        self.full, self.full_values = model, values

    def _inputs(
        self,
        u: FloatArray,
        dt: FloatArray,
        x0: FloatArray,
        segments: Sequence[Segment],
        starts: Sequence[OpenLoopStart],
    ) -> FloatArray:
        inputs, system = list(self.model.system.inputs), self.full.system
        delays = np.asarray(system.delays_s(np.array([self.full_values[n] for n in system.params]))).ravel()
        channel = dict(zip(system.delay_channels, delays.tolist(), strict=True))
        u = u.copy()
        for i, s in enumerate(starts):
            segment = segments[s.segment]
            t = segment.t_s[s.first] + np.cumsum(dt[i]) - 0.5 * dt[i]
            for name, reference in (
                ("roll_rad", "roll_ref_rad"),
                ("pitch_rad", "pitch_ref_rad"),
                ("r_rad_s", "yaw_rate_ref_rad_s"),
            ):
                if reference in segment.u:
                    edges, values = segment.u[reference]
                    u[i, :, inputs.index(name)] = zero_order_hold(
                        (edges + channel[system.input_delay[reference]], values), t
                    )
            column = segment.y.get("yaw_rad")
            yaw = float(np.unwrap(filled(segment.t_s, column, 0.0))[s.first]) if column is not None else 0.0
            u[i, :, inputs.index("yaw_rad")] = yaw + np.cumsum(u[i, :, inputs.index("r_rad_s")] * dt[i])
            u[i, :, inputs.index("p_rad_s")] = 0.0
            u[i, :, inputs.index("q_rad_s")] = 0.0
        return u


def _cut(
    grids: Sequence[Grid], starts: Sequence[OpenLoopStart]
) -> tuple[FloatArray, FloatArray, list[NDArray[np.intp]]]:
    """Each start's pieces, padded with pieces of no length, and for each of its samples the piece that ends there."""
    spans = []
    for s in starts:
        sample = grids[s.segment].sample[s.first : s.last + 1]
        spans.append((int(sample[0]) + 1, int(sample[-1]) + 1))
    k = max(b - a for a, b in spans)
    n_u = grids[0].u.shape[1]
    u, dt = np.zeros((len(starts), k, n_u)), np.zeros((len(starts), k))
    samples = []
    for i, (s, (a, b)) in enumerate(zip(starts, spans, strict=True)):
        made = grids[s.segment]
        u[i, : b - a], dt[i, : b - a] = made.u[a:b], made.dt_s[a:b]
        u[i, b - a :] = made.u[b - 1]
        samples.append(made.sample[s.first : s.last + 1] - a)
    return u, dt, samples
