"""Free flight as equations of motion (equation error): stretches without gaps, their residuals and Jacobians at the measured velocity.

The velocity in the model is predicted from the samples before each: what is smoothed with its own sample or later ones holds the very
disturbance that the equation is to leave as its error, and in gusts drag came out at half.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS
from flighttest.estimation.equation_error import Stream
from flighttest.estimation.integration.kernel import Kernel
from flighttest.estimation.responses import Stacked, attitude_is_known, max_step_s, prepare, zero_order_hold
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.physics.blocks import ACCELERATION, FORCE, VELOCITY, Block
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

JOIN_PERIODS = 2.5  # windows this near to each other are one stretch
SHORTEST_S = 4.0
CHUNK_S = 10.0  # of a stretch, integrated side by side
LEAD_S = 1.0  # before each, in which the initial thrust is forgotten: five time constants of slow motors
# The same where a term has states of unknown start, a swinging load: 95 % of a swing with a damping ratio of 0.05 on a cable of 1 m.
MEMORY_S, MEMORY_CHUNK_S = 20.0, 40.0
LATENCY = "velocity_latency"  # a term and its parameter
BLEND_S = 0.5  # of the complementary filter of velocity and accelerometer
LINE_S = 0.25  # of velocity alone: drag of what is quicker is below 1 % of its acceleration


def stretches(segments: Sequence[Segment]) -> list[Segment]:
    """Usable windows of free flight of each recording with attitude, velocity and throttle, those that adjoin joined."""
    fit = [s for s in segments if s.usable and s.kind == "free" and s.t_s.size > 2 and _can(s)]
    groups: list[list[Segment]] = []
    for s in sorted(fit, key=lambda s: (s.run, s.t_s[0])):
        if groups:
            before = groups[-1][-1]
            period = float(np.median(np.diff(before.t_s)))
            if before.run == s.run and abs(s.t_s[0] - before.t_s[-1]) <= JOIN_PERIODS * period:
                groups[-1].append(s)
                continue
        groups.append([s])
    return [one for one in (_joined(g) for g in groups) if one.t_s[-1] - one.t_s[0] >= SHORTEST_S]


def _can(s: Segment) -> bool:
    velocity = all(np.isfinite(s.y.get(n, np.nan)).any() for n in VELOCITY)
    heading = bool(np.isfinite(s.y.get("yaw_rad", np.nan)).any())
    return velocity and heading and "throttle" in s.u and attitude_is_known(s)


def _joined(windows: Sequence[Segment]) -> Segment:
    """One segment of windows in order."""
    t = np.concatenate([w.t_s for w in windows])
    t, first = np.unique(t, return_index=True)
    names = dict.fromkeys(n for w in windows for n in w.y)
    y = {n: np.concatenate([w.y.get(n, np.full(w.t_s.size, np.nan)) for w in windows])[first] for n in names}
    if "yaw_rad" in y:
        good = np.isfinite(y["yaw_rad"])
        y["yaw_rad"][good] = np.unwrap(y["yaw_rad"][good])
    u: dict[str, tuple[FloatArray, FloatArray]] = {}
    for w in windows:
        for name, (times, values) in w.u.items():
            if name not in u:
                u[name] = times, values
                continue
            new = times > u[name][0][-1]
            u[name] = np.append(u[name][0], times[new]), np.append(u[name][1], values[new])
    head = windows[0]
    context = replace(head.context, voltage_samples=None)
    return replace(head, name=f"{head.run} {t[0]:.0f} s", t_s=t, y=y, u=u, context=context)


def predicted(t: FloatArray, values: FloatArray, slope: FloatArray | None) -> FloatArray:
    """A measured velocity (n,) at each sample as it was to be expected from the samples before it.

    With its measured slope (n,), a complementary filter of `BLEND_S`; else the straight line of the last `LINE_S`.
    """
    good = np.isfinite(values)
    if good.sum() < 3:
        return values
    whole = values if good.all() else np.interp(t, t[good], values[good])
    period = float(np.median(np.diff(t)))
    if slope is not None:
        drive = np.diff(t) * np.where(np.isfinite(slope), slope, 0.0)[:-1]
        gain = min(period / BLEND_S, 1.0)
        # x_k = (1 - gain) x_(k-1) + gain v_(k-1) + drive_(k-1)
        x, made = float(whole[0]), [float(whole[0])]
        for u in (gain * whole[:-1] + drive).tolist():
            x += u - gain * x
            made.append(x)
        return np.array(made)
    width = max(min(round(LINE_S / period), values.size - 1), 2)
    before = -np.arange(width, dtype=float)
    off = before - before.mean()
    weight = 1.0 / width + (1.0 - before.mean()) * off / np.sum(off**2)
    found = np.concatenate([whole[:1], np.convolve(whole, weight)[: whole.size - 1]])
    found[: width + 1] = whole[: width + 1]
    return np.asarray(found)


def _velocity(s: Segment) -> dict[str, FloatArray]:
    """The three velocities of a stretch, world, each predicted from the past; with the accelerometer where all of it was recorded."""
    slopes: dict[str, FloatArray] = {}
    if all(n in s.y and np.isfinite(s.y[n]).any() for n in FORCE):
        angles = np.stack([s.y[n] for n in ("roll_rad", "pitch_rad", "yaw_rad")], axis=1)
        a = np.einsum("nij,nj->ni", rotation_from_euler(angles), np.stack([s.y[n] for n in FORCE], axis=1))
        slopes = dict(zip(VELOCITY, (a - [0.0, 0.0, G_M_S2]).T, strict=True))
    return {n: predicted(s.t_s, s.y[n], slopes.get(n)) for n in VELOCITY}


def _state(s: Segment, velocity: Mapping[str, FloatArray]) -> FloatArray:
    """(n, 4): velocity along the body's axes, m/s, and throttle, of a stretch with such velocities, world."""
    angles = np.stack([s.y[n] for n in ("roll_rad", "pitch_rad", "yaw_rad")], axis=1)
    along = np.einsum("nji,nj->ni", rotation_from_euler(angles), np.stack([velocity[n] for n in VELOCITY], axis=1))
    return np.column_stack([along, zero_order_hold(s.u["throttle"], s.t_s)])


@dataclass
class Equations:
    """The equations of stretches of flight under one model, ready to be evaluated at parameter values."""

    model: Model
    flown: Sequence[Segment]
    _made: dict[str, _Prepared] = field(default_factory=dict, repr=False)

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of the recordings."""
        return tuple(dict.fromkeys(s.run for s in self.flown))

    @property
    def block(self) -> Block:
        """The equations of motion at the measured velocity, without the latency of that (`params`)."""
        model = self.model.without_terms(LATENCY) if LATENCY in self.model.terms else self.model
        return model.measured_velocity

    @property
    def params(self) -> tuple[str, ...]:
        """Names of what the equations depend on: those of `block`, and the latency of the velocity where the model has it, since increments
        of velocity are then those of the modelled acceleration so much earlier."""
        return (*self.block.params, LATENCY) if LATENCY in self.model.terms else self.block.params

    def streams(
        self, values: Mapping[str, float], names: Sequence[str], per_flight: Sequence[str] = ()
    ) -> tuple[list[Stream], tuple[str, ...]]:
        """Residual and Jacobian of every stretch, by `names`; those of `per_flight` have a column for each flight (`name@flight`)."""
        shared = [n for n in names if n not in per_flight]
        own = [n for n in names if n in per_flight]
        columns = (*shared, *(f"{n}@{flight}" for flight in self.flights for n in own))
        found: list[Stream] = []
        for g, flight in enumerate(self.flights):
            mine = {n: values.get(f"{n}@{flight}", values[n]) for n in self.params}
            for channel, residual, jacobian, state in self._of(flight).evaluated(self, mine, [*shared, *own]):
                placed = np.zeros((residual.size, len(columns)))
                placed[:, : len(shared)] = jacobian[:, : len(shared)]
                at = len(shared) + g * len(own)
                placed[:, at : at + len(own)] = jacobian[:, len(shared) :]
                found.append(Stream(channel, g, residual, placed, state))
        return found, columns

    def _of(self, flight: str) -> _Prepared:
        if flight not in self._made:
            self._made[flight] = _Prepared.of([s for s in self.flown if s.run == flight], self.block, self.model)
        return self._made[flight]


@dataclass
class _Prepared:
    """Chunks of the stretches of one flight. kept: per chunk the slice of its samples behind the lead; stretch: which it is of; states: per
    chunk (n, 4), velocity along the body's axes, m/s, and throttle."""

    chunks: list[Segment]
    kept: list[slice]
    stretch: list[int]
    outputs: tuple[str, ...]
    measured: list[FloatArray]
    states: list[FloatArray]
    times: list[FloatArray]
    kernels: dict[tuple[str, ...], Kernel] = field(default_factory=dict)

    @classmethod
    def of(cls, flown: Sequence[Segment], block: Block, model: Model) -> _Prepared:
        force = tuple(n for n in FORCE if all(np.isfinite(s.y.get(n, np.nan)).any() for s in flown))
        chunks, kept, stretch = [], [], []
        measured, states, times = [], [], []
        swings = any(n != "a_t_m_s2" for n in block.free_states)
        lead_s, length_s = (MEMORY_S, MEMORY_CHUNK_S) if swings else (LEAD_S, CHUNK_S)
        for k, s in enumerate(flown):
            period = float(np.median(np.diff(s.t_s)))
            smooth = _velocity(s)
            state = _state(s, smooth)
            starts = np.arange(s.t_s[0] + LEAD_S, s.t_s[-1], length_s)
            for start, end in pairwise([*starts, s.t_s[-1] + period]):
                a = int(np.searchsorted(s.t_s, start - lead_s - 1e-9))
                first, b = int(np.searchsorted(s.t_s, start - 1e-9)), int(np.searchsorted(s.t_s, end - 1e-9))
                if b - first < 3:
                    continue
                chunks.append(chunk(s, smooth, a, b))
                kept.append(slice(first - a, b - a))
                stretch.append(k)
                measured.append(np.stack([s.y[n][first:b] for n in (force or VELOCITY)], axis=1))
                states.append(state[first:b])
                times.append(s.t_s[first:b])
        return cls(chunks, kept, stretch, force or ACCELERATION, measured, states, times)

    def evaluated(
        self, equations: Equations, values: Mapping[str, float], names: Sequence[str]
    ) -> list[tuple[str, FloatArray, FloatArray, FloatArray]]:
        """(channel, residual (n,), Jacobian (n, len(names)), state (n, 4)) of every stretch without gaps."""
        block, model = equations.block, equations.model
        free = tuple(n for n in block.params if n in names)
        p = np.array([values[n] for n in block.params])
        made = [
            prepare(s, i, block, self.outputs, model.nominal_voltage_v, 0.0, values["K"])
            for i, s in enumerate(self.chunks)
        ]
        if not made:
            return []
        nodes = Stacked.of(made).nodes(float(block.delay_s(p)), max_step_s(block, values))
        longest = max(r.t_s.size for r in made)
        mask = np.zeros((len(made), longest, len(self.outputs)), dtype=bool)
        for j, r in enumerate(made):
            mask[j, : r.t_s.size] = True
        filters = {c: hz for c in self.outputs if (hz := self._filter(c)) > 0.0}
        kernel = self.kernels.setdefault(free, Kernel(block, self.outputs, free, filters))
        local = np.stack([r.start for r in made])
        y, dy = kernel.at_samples(p, local, nodes, mask, True)
        found: list[tuple[str, FloatArray, FloatArray, FloatArray]] = []
        for k in dict.fromkeys(self.stretch):
            here = [j for j, of in enumerate(self.stretch) if of == k]
            t = np.concatenate([self.times[j] for j in here])
            seen, state = (np.concatenate([some[j] for j in here]) for some in (self.measured, self.states))
            predicted = np.concatenate([y[j, self.kept[j]] for j in here])
            slopes = np.zeros((*predicted.shape, len(names)))
            slopes[..., [list(names).index(n) for n in free]] = np.concatenate(
                [dy[j, self.kept[j], :, : len(free)] for j in here]
            )
            if self.outputs == ACCELERATION and LATENCY in values:
                predicted, slopes = _late(
                    t, predicted, slopes, values[LATENCY], names.index(LATENCY) if LATENCY in names else None
                )
            if self.outputs == ACCELERATION:
                h = np.diff(t)[:, None]
                seen = np.diff(seen, axis=0) / h
                predicted, slopes, state = (0.5 * (one[1:] + one[:-1]) for one in (predicted, slopes, state))
                t = t[1:]
            residual = seen - predicted
            for c, channel in enumerate(self.outputs):
                good = np.isfinite(residual[:, c]) & np.isfinite(slopes[:, c]).all(axis=1)
                for a, b in _runs(t, good):
                    found.append((channel, residual[a:b, c], slopes[a:b, c], state[a:b]))
        return found

    def _filter(self, channel: str) -> float:
        known = self.chunks[0].context.filters if self.chunks else {}
        return float(known.get(CHANNELS[channel].group, 0.0))


def _late(
    t: FloatArray, predicted: FloatArray, slopes: FloatArray, latency_s: float, column: int | None
) -> tuple[FloatArray, FloatArray]:
    """Values (n, c) and derivatives (n, c, q) of a latency ago; `column` becomes the derivative by the latency.

    The velocity that drag acts on stays the one of then, of a latency before: of the effect of a latency, drag's share of it, d over the
    frequency of the motion, is left out.
    """
    then = t - latency_s

    def earlier(values: FloatArray) -> FloatArray:
        flat = values.reshape(t.size, -1)
        return (
            np.stack([np.interp(then, t, one) for one in flat.T], axis=1).reshape(values.shape) if flat.size else values
        )

    rate = -np.gradient(predicted, t, axis=0) if t.size > 2 else np.zeros_like(predicted)
    made = earlier(slopes) if latency_s else slopes.copy()
    if column is not None:
        made[..., column] = earlier(rate)
    return (earlier(predicted) if latency_s else predicted), made


def chunk(s: Segment, smooth: Mapping[str, FloatArray], a: int, b: int) -> Segment:
    """Samples a to b of a stretch, with the edges that reach into them."""
    y = {n: v[a:b] for n, v in {**s.y, **smooth}.items()}
    u = {}
    for name, (times, values) in s.u.items():
        first = max(int(np.searchsorted(times, s.t_s[a] - 1.0)) - 1, 0)
        last = max(int(np.searchsorted(times, s.t_s[b - 1])), first + 1)
        u[name] = times[first:last], values[first:last]
    return replace(s, t_s=s.t_s[a:b], y=y, u=u)


def _runs(t: FloatArray, good: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Index ranges without holes: samples that are good and follow each other."""
    if t.size < 3:
        return []
    period = float(np.median(np.diff(t)))
    breaks = np.flatnonzero(~good[1:] | ~good[:-1] | (np.diff(t) > JOIN_PERIODS * period)) + 1
    bounds = [0, *breaks.tolist(), t.size]
    return [(a, b) for a, b in pairwise(bounds) if b - a >= 3 and good[a:b].all()]
