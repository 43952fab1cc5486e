"""The translation in free flight as equations of motion (equation error): residuals and Jacobians at the measured velocity.

The velocity in the model is predicted from the samples before each: what is smoothed with its own sample or later ones holds the very
disturbance that the equation is to leave as its error, and in gusts drag came out at half.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.interpolation import filled
from flighttest.estimation.responses import attitude_angles, rotation_at, zero_order_hold
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.identify.free_flight.chunks import LEAST_SAMPLES, Chunks, InitialValues
from flighttest.identify.free_flight.stretches import Residual, recorded, unbroken
from flighttest.physics.blocks import ACCELERATION, FORCE, MEASURED_FORCE, VELOCITY
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

LATENCY, LEVER_ARM = "velocity_latency", "imu_lever_arm"
ARMS = ("arm_x", "arm_y", "arm_z")
# Terms of instruments, which act behind the filters of what is integrated, and their parameters.
BEHIND_FILTERS = {LATENCY: (LATENCY,), LEVER_ARM: ARMS}
BLEND_S = 0.5  # of the complementary filter of velocity and accelerometer
# Of a velocity that nothing measured: for so long it is what the accelerometer adds up to. Its drag is assumed, and where it is another
# one, intervals are wider by that velocity (`lack_of_fit`): of 36 estimates with drag of 0.5 1/s, assumed 0, 0.5 and 1, they hold the lag
# in 35; without it in 24, with 0.5 s in 32.
INTEGRATED_S = 2.0
TURNED_BY = ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s")
# Knots of the response of an angular acceleration to its reference, s. An arm of 0.03 m that was added to a log of 25 Hz cost it 4,300 of
# 13,050 nats where the response was held over 0.04 s, and the accelerometer's filter followed; it costs 3,600.
RESPONSE_KNOTS_S = (0.0, *np.geomspace(0.01, 0.6, 16))
LINE_S = 0.25  # of velocity alone: drag of what is quicker is below 1 % of its acceleration


def predicted(t: FloatArray, values: FloatArray, slope: FloatArray | None, blend_s: float = BLEND_S) -> FloatArray:
    """A measured velocity (n,) at each sample as it was to be expected from the samples before it.

    With its measured slope (n,), a complementary filter of `blend_s`; else the straight line of the last `LINE_S`.
    """
    good = np.isfinite(values)
    if good.sum() < 3:
        return values
    whole = values if good.all() else np.interp(t, t[good], values[good])
    period = float(np.median(np.diff(t)))
    if slope is not None:
        drive = np.diff(t) * np.where(np.isfinite(slope), slope, 0.0)[:-1]
        gain = min(period / blend_s, 1.0)
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


def _measured(s: Segment) -> dict[str, FloatArray]:
    """Of a stretch, world: the three velocities, each predicted from the past, with the accelerometer where all of it was recorded, and by
    it alone where nothing measured the velocity; and the specific force, from the accelerometer, else from the velocities."""
    slopes: dict[str, FloatArray] = {}
    if recorded(s, FORCE):
        force = np.einsum(
            "nij,nj->ni", rotation_from_euler(attitude_angles(s)), np.stack([s.y[n] for n in FORCE], axis=1)
        )
        slopes = dict(zip(VELOCITY, (force - [0.0, 0.0, G_M_S2]).T, strict=True))
    else:
        force = np.stack([np.gradient(filled(s.t_s, s.y[n], 0.0), s.t_s) for n in VELOCITY], axis=1)
        force[:, 2] += G_M_S2
    velocity = {
        n: predicted(s.t_s, s.y[n], slopes.get(n))
        if recorded(s, (n,))
        # What it shows all the time is its bias: no flight accelerates for ever.
        else predicted(s.t_s, np.zeros(s.t_s.size), slopes[n] - np.nanmean(slopes[n]), INTEGRATED_S)
        for n in VELOCITY
    }
    return velocity | dict(zip(MEASURED_FORCE, force.T, strict=True))


def _by_arms(s: Segment) -> FloatArray:
    """(n, 3, 3) that make of a lever arm, m, the specific force of the rotation, m/s^2, as the accelerometer shows it: w_dot x, w x (w x.

    It does not pass the integration, which takes what was measured along a line from sample to sample: behind the accelerometer's filter
    (20 Hz, 11 ms) that is a mean of neighbours, and arms of 0.011 to 0.037 m were found 8 to 12 % too long at 25 samples/s.
    """
    rates, accelerations = (
        np.stack([rotation_at(s, f"{axis}_{what}", "specific_force") for axis in "pqr"], axis=1)
        for what in ("rad_s", "dot_rad_s2")
    )
    spun = _crossed(rates)
    return _crossed(_asked(s, accelerations)) + spun @ spun


def _crossed(vectors: FloatArray) -> FloatArray:
    """(n, 3, 3) of the cross product of each (n, 3) with something."""
    x, y, z = vectors.T
    none = np.zeros_like(x)
    return np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3)


def _asked(s: Segment, accelerations: FloatArray) -> FloatArray:
    """Angular accelerations (n, 3) of a stretch as far as references explain them; as they are where none was recorded.

    A gust pushes the vehicle and turns it: what it turns is no cause of the force at the same moment, and an accelerometer in the centre
    of a vehicle that hovered in gusts seemed to be 0.25 to 0.32 m below it. References are the instruments (two-stage least squares: Theil
    1953); the response to a step of one is a line from knot to knot (`RESPONSE_KNOTS_S`), which begins at 0: motors have a lag.
    """
    names = [n for n in TURNED_BY if n in s.u]
    if not names:
        return accelerations
    means = [_mean(s.u[n], s.t_s - begin, end - begin) for n in names for begin, end in pairwise(RESPONSE_KNOTS_S)]
    asked = np.column_stack([np.ones(s.t_s.size), *means])
    return np.asarray(asked @ np.linalg.lstsq(asked, accelerations, rcond=None)[0])


def _mean(edges: tuple[FloatArray, FloatArray], t: FloatArray, over_s: float) -> FloatArray:
    """Of a reference that is held from edge to edge, the mean (n,) of the time before each `t`."""
    times, values = edges
    ends = np.append(times, max(times[-1], t[-1]) + over_s)
    whole = np.concatenate([[0.0], np.cumsum(np.diff(ends) * (values - values[0]))])
    return np.asarray(values[0] + (np.interp(t, ends, whole) - np.interp(t - over_s, ends, whole)) / over_s)


def _state(s: Segment, velocity: Mapping[str, FloatArray]) -> FloatArray:
    """(n, 4): velocity along the body's axes, m/s, and throttle, of a stretch with such velocities, world."""
    along = np.einsum(
        "nji,nj->ni", rotation_from_euler(attitude_angles(s)), np.stack([velocity[n] for n in VELOCITY], axis=1)
    )
    return np.column_stack([along, zero_order_hold(s.u["throttle"], s.t_s)])


def accelerations(flown: Sequence[Segment]) -> tuple[str, ...]:
    """Outputs of the equations of motion of a flight: the axes of its accelerometer, else the increments of velocity."""
    return tuple(n for n in FORCE if all(np.isfinite(s.y.get(n, np.nan)).any() for s in flown)) or ACCELERATION


class TranslationEquations:
    """The equations of motion of stretches at the measured velocity, of flights that have the same `outputs`. state: velocity along the
    body's axes, m/s, and throttle."""

    def __init__(self, model: Model, flown: Sequence[Segment], outputs: tuple[str, ...]) -> None:
        self.model, self.flown, self.outputs = model, flown, outputs
        self._instruments = [n for n in BEHIND_FILTERS if n in model.terms]
        self.block = model.without_terms(*self._instruments).measured_velocity
        measured = [s.once("measured", partial(_measured, s)) for s in flown]
        swings = any(n != "a_t_m_s2" for n in self.block.free_states)
        self.chunks = Chunks(flown, self.block, self.outputs, model, long_memory=swings, changed=measured)
        shown = VELOCITY if outputs == ACCELERATION else outputs
        rows = (np.stack([s.y.get(n, np.full(s.t_s.size, np.nan)) for n in shown], axis=1) for s in flown)
        along = [self.chunks.along(k, one) for k, one in enumerate(rows)]
        # A log may have written accelerations less often than attitudes: their samples are a series of their own.
        self.seen = [np.flatnonzero(np.isfinite(one).all(axis=1)) for one in along]
        self.measured = [one[at] for one, at in zip(along, self.seen, strict=True)]
        states = (s.once("state", partial(_state, s, v)) for s, v in zip(flown, measured, strict=True))
        self.states = [self.chunks.along(k, one)[self.seen[k]] for k, one in enumerate(states)]
        self.times = [self.chunks.along(k, s.t_s)[self.seen[k]] for k, s in enumerate(flown)]
        # Of the axes that are compared; an increment of a velocity shows no arm.
        axes = [FORCE.index(n) for n in outputs if n in FORCE] if LEVER_ARM in self._instruments else []
        arms = (s.once("arms", partial(_by_arms, s))[:, axes] for s in (flown if axes else ()))
        self._arms = [self.chunks.along(k, one)[self.seen[k]] for k, one in enumerate(arms)]

    @property
    def params(self) -> tuple[str, ...]:
        """Names of what the equations depend on: those of `block`, and of the instruments where the model has them. With a latency
        increments of velocity are those of the modelled acceleration so much earlier."""
        return (*self.block.params, *(p for n in self._instruments for p in BEHIND_FILTERS[n]))

    def evaluated(
        self, values: Sequence[Mapping[str, float]], names: Sequence[str], initial: InitialValues
    ) -> Iterator[Residual]:
        """Of every stretch without gaps, with values of its own."""
        for k, (predicted, slopes) in enumerate(self.chunks.simulated(values, names, initial)):
            t, at, seen, state = self.times[k], self.seen[k], self.measured[k], self.states[k]
            if t.size < LEAST_SAMPLES:
                continue
            predicted, slopes = predicted[at], slopes[at]
            if self._arms:
                predicted = predicted + self._arms[k] @ [values[k][n] for n in ARMS]
                for axis, n in enumerate(ARMS):
                    if n in names:
                        slopes[..., names.index(n)] = self._arms[k][..., axis]
            shift = int(self.outputs == ACCELERATION)  # an increment belongs to the sample at its end
            if self.outputs == ACCELERATION and LATENCY in values[k]:
                column = names.index(LATENCY) if LATENCY in names else None
                predicted, slopes = _late(t, predicted, slopes, values[k][LATENCY], column)
            if self.outputs == ACCELERATION:
                h = np.diff(t)[:, None]
                seen = np.diff(seen, axis=0) / h
                predicted, slopes, state = (0.5 * (one[1:] + one[:-1]) for one in (predicted, slopes, state))
                t = t[1:]
            residual = seen - predicted
            for c, channel in enumerate(self.outputs):
                good = np.isfinite(residual[:, c]) & np.isfinite(slopes[:, c]).all(axis=1)
                for a, b in unbroken(t, good):
                    began = self.chunks.initial_states(
                        k, slopes[a:b, c, len(names) :], at[a + shift : b + shift], initial
                    )
                    yield Residual(k, channel, residual[a:b, c], slopes[a:b, c, : len(names)], state[a:b], began)


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
