"""Data compatibility check: what velocity, attitude and specific force of one log must have in common by kinematics alone, corrected.

A log stamps attitude, accelerometer and velocity estimate in different messages, each at its own place in the autopilot's cycle, and an
estimator that fuses a late position follows the accelerometer by a per cent less. After a tilt step both are off by some 40 mm/s,
more than the noise, and a fit bends drag and thrust to make up for it. With the attitude's clock as the reference, velocity read tau_v
late and (1 + kappa) large, specific force read tau_f late (its known low-pass filter beside it),

    v(t) = v_0 + b t + int (R f - g e_z) dt - tau_v a(t) + tau_f int R df/dt dt + kappa int (a_x, a_y, 0) dt

holds in every stretch, three axes with one triple of unknowns; v_0, b (what attitude and accelerometer are biased by) are each stretch's
own. Linear least squares after one low-pass filter without phase over all terms, with normal priors (`PRIOR_S`, `PRIOR_SCALE`): what little
motion shows of them moves them little. Without tilting only the difference of the offsets is known, and nothing is corrected.
What the stretches' own b have in common in the body's axes is the bias of the accelerometer, by least squares over the stretches.
A velocity that comes out later than a stamp may be has a latency: it is moved by what was found and the equations are stated anew about
there (Gauss-Newton), without a prior on it.
Standard errors cluster by stretch. Klein & Morelli, Aircraft System Identification, chapter 10. No vehicle model is involved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from flighttest.channels import names
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.recording import Series

FloatArray = NDArray[np.float64]

PRIOR_S = 0.01  # one cycle of ArduPilot's EKF (100 Hz), the slowest of what stamps messages
# ArduPilot's EKF against its simulator's truth: 0.2 to 2.2 % in flights of 0.5 rad steps; in ten flights of five starts of the firmware, by
# kinematics, 0.8 to 2.07 % short, RMS 1.4 %.
PRIOR_SCALE = 0.015
# Of a prior: a stamp with a larger error is not data. Flights that tilt have 0.2 to 1.6 ms (the larger of both). In others the attitude's
# own error takes the place of motion: throttle steps have 2.4 to 3.2 ms, and the force 14 ms late where tilting flights of the same
# vehicle have it within 2 ms; hovers and yaw steps 5.2 to 10 ms, and velocity 10 to 22 ms late.
DETERMINED = 0.2
SETTLED_S = 1e-4  # by which the last step moved a latency
STEPS = 30
# Of a step. What is left of the residual sets how much the force's prior counts, and that what is left: whole steps went to and fro between
# 100 and 110 ms where 101 ms had been added, and half of it was reported.
DAMPING = 0.5
LARGEST = 2.0  # priors; more is no matter of stamps but a latency, which is in the catalogue (`velocity_latency`)
_GROUPS = ("attitude", "specific_force", "velocity")
_STRETCH_S = 4.0
_RATE_HZ = 100.0
_CUTOFF_HZ = 5.0  # motion lies below it, most of what shakes an accelerometer above
_SHORTEST = 3  # stretches


@dataclass(frozen=True)
class AccelerometerBias:
    """What the accelerometer measures too much, m/s^2, body FLU (3,), with its covariance (3, 3); errors_m2_s4: of each stretch the square
    of the acceleration by which velocity and accelerometer differ, as recorded and corrected by what the other stretches show."""

    value_m_s2: tuple[float, float, float]
    covariance: tuple[tuple[float, ...], ...]
    errors_m2_s4: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Compatibility:
    """How late velocity and specific force are stamped against the attitude, s (negative: early), and by what share the horizontal velocity
    is too large, each with its standard error. stretches: of 4 s each, behind these numbers; errors_m2_s2: of each stretch the mean square
    of the velocity less what the accelerometer makes of it, as recorded and corrected by what the other stretches show; bias: of the
    accelerometer, with the velocity at its time."""

    velocity_late_s: float
    velocity_late_std_s: float
    force_late_s: float
    force_late_std_s: float
    velocity_scale: float
    velocity_scale_std: float
    stretches: int
    errors_m2_s2: tuple[tuple[float, float], ...] = ()
    bias: AccelerometerBias | None = None

    @property
    def velocity_has_latency(self) -> bool:
        """Whether the velocity is later than a stamp may be: an effect, which is not corrected."""
        return abs(self.velocity_late_s) > LARGEST * PRIOR_S

    @property
    def determined(self) -> bool:
        """Whether the data, and not the prior, have both stamps. In a hover only their difference is known, and a force moved by itself
        takes the delay of the thrust with it."""
        return max(self.velocity_late_std_s, self.force_late_std_s) < DETERMINED * PRIOR_S


def compatibility(
    groups: Mapping[str, Series], flown: Sequence[tuple[float, float]], cutoff_hz: float | None = None
) -> Compatibility | None:
    """Of one recording; None where attitude, specific force or velocity are not recorded or there are too few stretches without gaps.

    groups: of channels, by name; flown: stretches in the air, s. cutoff_hz: of the accelerometer's known second-order low-pass filter.
    """
    series = [groups.get(group) for group in _GROUPS]
    if any(
        s is None or len(s) < 2 or not set(names(g)) <= set(s.columns) for g, s in zip(_GROUPS, series, strict=True)
    ):
        return None
    attitude, force, velocity = (s for s in series if s is not None)
    solved = _solved((attitude, force, velocity), flown, cutoff_hz)
    if solved is None or not solved[0].velocity_has_latency:
        return None if solved is None else solved[0]
    first, recorded = solved
    late_s = 0.0
    for _ in range(STEPS):
        moved = Series(velocity.t_s - late_s, velocity.columns)
        if (solved := _solved((attitude, force, moved), flown, cutoff_hz, late_s)) is None:
            break
        found, corrected_by = solved
        step = DAMPING * (found.velocity_late_s - late_s)
        late_s += step
        if abs(step) < SETTLED_S:
            errors = tuple((recorded[t][0], after) for t, (_, after) in corrected_by.items() if t in recorded)
            return replace(found, errors_m2_s2=errors)
    return first


def _solved(
    series: Sequence[Series],
    flown: Sequence[tuple[float, float]],
    cutoff_hz: float | None,
    late_s: float | None = None,
) -> tuple[Compatibility, dict[float, tuple[float, float]]] | None:
    """What the equations show, and of each stretch, by its start, s, the mean square error as it stands and corrected by the others.
    late_s: by which a velocity that has a latency was moved already; None for stamps, with their priors."""
    made = {}
    for begin, end in flown:
        for start in np.arange(begin, end - _STRETCH_S, _STRETCH_S):
            equations = _equations(series, float(start), cutoff_hz)
            if equations is not None:
                made[float(start)] = equations
    if len(made) < _SHORTEST:
        return None
    stretches = list(made.values())
    gram = np.stack([s.terms.T @ s.terms for s in stretches])
    moment = np.stack([s.terms.T @ s.velocity for s in stretches])
    power = float(np.mean([np.mean(s.velocity**2) for s in stretches])) or 1.0
    weight = 1.0 / (power * _RATE_HZ / _CUTOFF_HZ)  # of samples that count once in so many
    prior = np.diag([PRIOR_S**-2 if late_s is None else 0.0, PRIOR_S**-2, PRIOR_SCALE**-2])  # a latency has none
    whole, target = gram.sum(axis=0) * weight + prior, moment.sum(axis=0) * weight
    inverse = np.linalg.pinv(whole, hermitian=True)
    found = inverse @ target
    scores = (moment - gram @ found) * weight
    spread = inverse @ (scores.T @ scores) @ inverse * len(made) / (len(made) - 2)
    if late_s is not None:  # the stamp of the force is known by its prior alone where little tilts
        spread = spread + inverse @ prior @ inverse
    std = np.sqrt(np.maximum(np.diag(spread), 0.0))
    without = np.linalg.pinv(whole - gram * weight, hermitian=True)  # each stretch
    others = np.einsum("sij,sj->si", without, target - moment * weight)
    errors = {
        start: (float(np.mean(s.velocity**2)), float(np.mean((s.velocity - s.terms @ one) ** 2)))
        for (start, s), one in zip(made.items(), others, strict=True)
    }
    v, f, scale = zip(((late_s or 0.0) - float(found[0]), -float(found[1]), float(found[2])), std.tolist(), strict=True)
    return Compatibility(*v, *f, *scale, len(made), tuple(errors.values()), _bias(stretches, found)), errors


def _bias(stretches: Sequence[_Stretch], found: FloatArray) -> AccelerometerBias | None:
    """Of the trends that are left beside stamps and scale (3,). None of three stretches: their scores add up to zero, and two that are
    independent give no covariance of three biases."""
    turned = np.stack([s.turned for s in stretches])
    if len(stretches) <= turned.shape[-1]:
        return None
    asked = -np.stack([s.trends[0] - found @ s.trends[1:] for s in stretches])
    gram, moment = np.matmul(turned.transpose(0, 2, 1), turned), np.einsum("sij,si->sj", turned, asked)
    whole, target, count = gram.sum(axis=0), moment.sum(axis=0), len(stretches)
    inverse = np.linalg.pinv(whole, hermitian=True)
    value = inverse @ target
    scores = moment - gram @ value
    spread = inverse @ (scores.T @ scores) @ inverse * count / (count - 2)
    if not np.linalg.eigvalsh(spread)[0] > 0.0:
        return None  # sensors that are stuck show no error
    others = np.einsum("sij,sj->si", np.linalg.pinv(whole - gram, hermitian=True), target - moment)
    left = asked - np.einsum("sij,sj->si", turned, others)
    errors = zip(np.sum(asked**2, axis=1).tolist(), np.sum(left**2, axis=1).tolist(), strict=True)
    return AccelerometerBias(tuple(value.tolist()), tuple(map(tuple, spread.tolist())), tuple(errors))


class _Stretch(NamedTuple):
    """terms (3 n, 3): regressors of (-tau_v, -tau_f, kappa); velocity (3 n,): less what the accelerometer makes of it; both without what
    v_0 and b explain. trends (4, 3): slopes of the velocity, m/s^2, and of the terms, which b takes; turned (3, 3): of a bias of one in
    each of the body's axes, by axis of the world."""

    terms: FloatArray
    velocity: FloatArray
    trends: FloatArray
    turned: FloatArray


def _equations(series: Sequence[Series], start_s: float, cutoff_hz: float | None) -> _Stretch | None:
    """Of one stretch; None where anything has a gap in it."""
    t = start_s + np.arange(round(_STRETCH_S * _RATE_HZ)) / _RATE_HZ
    columns = []
    for s, group in zip(series, _GROUPS, strict=True):
        here = slice(max(int(np.searchsorted(s.t_s, t[0])) - 2, 0), int(np.searchsorted(s.t_s, t[-1])) + 2)
        times = s.t_s[here]
        if times.size < t.size // 20 or times[0] > t[0] or times[-1] < t[-1] or np.diff(times).max() > 0.2:
            return None
        columns.append(np.stack([np.interp(t, times, s.columns[n][here]) for n in names(group)], axis=-1))
    attitude, force, velocity = columns
    if not all(np.isfinite(c).all() for c in columns):
        return None
    rotation = rotation_from_euler(attitude)
    force = _unfiltered(force, t, cutoff_hz)
    acceleration = np.einsum("nij,nj->ni", rotation, force) - [0.0, 0.0, G_M_S2]
    jerk = np.einsum("nij,nj->ni", rotation, np.gradient(force, t, axis=0))
    moved = _integral(acceleration, t)
    turned = [_integral(rotation[:, :, k], t) for k in range(3)]
    terms = np.stack([velocity - moved, acceleration, -_integral(jerk, t), moved * [1.0, 1.0, 0.0], *turned])
    halved = np.sqrt(2.0 * np.log(2.0)) / (2.0 * np.pi * _CUTOFF_HZ)  # s: this Gaussian halves the cut-off frequency
    smooth = gaussian_filter1d(terms, halved * _RATE_HZ, axis=1, mode="nearest")
    still = np.linalg.qr(np.stack([np.ones(t.size), t - t[0]], axis=-1))[0]
    inside = slice(20, -20)  # filters settle at the ends
    y, *regressors = ((x - still @ (still.T @ x))[inside].ravel() for x in smooth[:4])
    slope = (t - t.mean()) / np.sum((t - t.mean()) ** 2)
    trends = np.einsum("n,knj->kj", slope, smooth)
    return _Stretch(np.stack(regressors, axis=-1), y, trends[:4], trends[4:].T)


def _unfiltered(force: FloatArray, t_s: FloatArray, cutoff_hz: float | None) -> FloatArray:
    """Specific force before its low-pass filter: the inverse of the second-order Butterworth, 1 + sqrt(2) s / w + s^2 / w^2."""
    if not cutoff_hz:
        return force
    w, rate = 2.0 * np.pi * cutoff_hz, np.gradient(force, t_s, axis=0)
    return np.asarray(force + np.sqrt(2.0) / w * rate + np.gradient(rate, t_s, axis=0) / w**2)


def _integral(x: FloatArray, t_s: FloatArray) -> FloatArray:
    """(n, 3) by the trapezoidal rule, from zero."""
    pieces = (x[1:] + x[:-1]) * np.diff(t_s)[:, None] / 2.0
    return np.concatenate([np.zeros((1, 3)), np.cumsum(pieces, axis=0)])


def corrected(groups: Mapping[str, Series], found: Compatibility) -> dict[str, Series]:
    """The same with velocity, position and specific force on the attitude's clock and the horizontal velocity as large as kinematics has
    it; what is further off than `LARGEST` priors is an effect, not a matter of stamps, and stays as it is, and so does everything where the
    stamps are not `determined`."""
    made = dict(groups)
    if not found.determined:
        return made
    late = {"velocity": found.velocity_late_s, "position": found.velocity_late_s, "specific_force": found.force_late_s}
    for group, late_s in late.items():
        if group in made and abs(late_s) <= LARGEST * PRIOR_S:
            made[group] = Series(made[group].t_s - late_s, made[group].columns)
    if abs(found.velocity_scale) <= LARGEST * PRIOR_SCALE and not found.velocity_has_latency:
        v = made["velocity"]
        scaled = {n: v.columns[n] / (1.0 + found.velocity_scale) for n in names("velocity")[:2]}
        made["velocity"] = Series(v.t_s, {**v.columns, **scaled})
    return made
