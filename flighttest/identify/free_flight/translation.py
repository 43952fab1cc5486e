"""The translation in free flight as equations of motion (equation error): residuals and Jacobians at the measured velocity.

The velocity in the model is predicted from the samples before each: what is smoothed with its own sample or later ones holds the very
disturbance that the equation is to leave as its error, and in gusts drag came out at half.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.interpolation import filled
from flighttest.estimation.responses import attitude_angles, exogenous, zero_order_hold
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.identify.free_flight.chunks import LEAST_SAMPLES, Chunks, InitialValues
from flighttest.identify.free_flight.stretches import Residual, recorded, unbroken
from flighttest.physics.blocks import ACCELERATION, FORCE, MEASURED_FORCE, VELOCITY
from flighttest.physics.model import Model
from flighttest.physics.system import ACCELERATIONS
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

LATENCY = "velocity_latency"  # a term and its parameter
BLEND_S = 0.5  # of the complementary filter of velocity and accelerometer
# Of a velocity that nothing measured: for so long it is what the accelerometer adds up to. Its drag is assumed, and where it is another
# one, intervals are wider by that velocity (`lack_of_fit`): of 36 estimates with drag of 0.5 1/s, assumed 0, 0.5 and 1, they hold the lag
# in 35; without it in 24, with 0.5 s in 32.
INTEGRATED_S = 2.0
TURNED_BY = ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s")
ANSWER_S, ANSWER_STEP_S = 0.6, 0.02  # of an attitude loop to its reference, and what of it is resolved
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
    return velocity | dict(zip(MEASURED_FORCE, force.T, strict=True)) | _asked_turning(s)


def _asked_turning(s: Segment) -> dict[str, FloatArray]:
    """Angular accelerations of a stretch as far as references explain them, of the axes whose references were recorded.

    A gust pushes the vehicle and turns it: what it turns is no cause of the force at the same moment, and an accelerometer in the centre
    of a vehicle that hovered in gusts seemed to be 0.25 to 0.32 m below it. References are the instruments (two-stage least squares: Theil
    1953), by finite impulse responses of `ANSWER_S`.
    """
    names = [n for n in TURNED_BY if n in s.u]
    lags = np.arange(0.0, ANSWER_S, max(float(np.median(np.diff(s.t_s))), ANSWER_STEP_S))
    asked = np.column_stack(
        [np.ones(s.t_s.size), *(zero_order_hold(s.u[n], s.t_s - lag) for n in names for lag in lags)]
    )
    found = {}
    for name in ACCELERATIONS:
        measured = exogenous(s, name, 0.0, 0.0)
        if names and np.any(measured):
            found[name] = asked @ np.linalg.lstsq(asked, measured, rcond=None)[0]
    return found


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
        self.block = (model.without_terms(LATENCY) if LATENCY in model.terms else model).measured_velocity
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

    @property
    def params(self) -> tuple[str, ...]:
        """Names of what the equations depend on: those of `block`, and the latency of the velocity where the model has it, since increments
        of velocity are then those of the modelled acceleration so much earlier."""
        return (*self.block.params, LATENCY) if LATENCY in self.model.terms else self.block.params

    def evaluated(
        self, values: Sequence[Mapping[str, float]], names: Sequence[str], initial: InitialValues
    ) -> Iterator[Residual]:
        """Of every stretch without gaps, with values of its own."""
        for k, (predicted, slopes) in enumerate(self.chunks.simulated(values, names, initial)):
            t, at, seen, state = self.times[k], self.seen[k], self.measured[k], self.states[k]
            if t.size < LEAST_SAMPLES:
                continue
            predicted, slopes = predicted[at], slopes[at]
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
