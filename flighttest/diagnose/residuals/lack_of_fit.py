"""What cannot be explained by anybody: the noise floor of each channel; and how a model misses each kind of step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.step_error import StepError
from flighttest.estimation.drift import DRIFT
from flighttest.estimation.linearisation import IntArray, Linearisation
from flighttest.estimation.uncertainty.distributions import fisher_quantile
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

BIN_S = 0.1  # responses of one cell are compared in bins of this width after the step
EQUATIONS_PER_COVARIATE = 4
LEAST_RATIO = 1.25
GUESSED_RATIO = 4.0  # where no repeats measure the floor, and it is known to a factor of two
OUTRIGHT = 3.5  # floors: above it, times of one response that differ on their own count as several looks
SIGNIFICANCE = 0.001
# Residuals below these cannot be distinguished from the resolution of the recording.
RESOLUTION = {"roll_rad": 3e-4, "pitch_rad": 3e-4, "r_rad_s": 1e-3} | {
    f"{k}_{axis}_{unit}": std
    for k, unit, std in (("f", "m_s2", 5e-3), ("a", "m_s2", 5e-3), ("v", "m_s", 3e-3))
    for axis in "xyz"
}


@dataclass(frozen=True)
class NoiseFloor:
    """std: channel to the spread (in its unit) no model of the recorded inputs explains; from_repeats: channels whose repeats determine it,
    the others' floor is their high-frequency residual, or what estimators wander (`DRIFT`) where that is more: weaker, since slow
    disturbances are not in it.

    lack_of_fit: channel to (lack of fit, its degrees of freedom, pure error, its degrees) of 0.1 s means, where repeats exist;
    lack_by_kind: (channel, kind of step) to (mean square of what repeats share over the pure error's at the same times since the step,
    number of cells, repeats that measure the pure error, independent times of one response).
    """

    std: Mapping[str, float]
    from_repeats: frozenset[str]
    lack_of_fit: Mapping[str, tuple[float, float, float, float]]
    lack_by_kind: Mapping[tuple[str, str], tuple[float, int, float, float]] = field(default_factory=dict)

    def of(self, channel: str) -> float:
        """The floor of one channel."""
        return self.std[channel]

    def repeated(self, channel: str, kind: str) -> bool:
        """Whether repeats measure the floor of this channel in this kind of maneuver."""
        return (channel, kind) in self.lack_by_kind

    def at(self, channel: str, kind: str, lasts_s: float = 0.0) -> float:
        """The floor of one channel in one kind of maneuver: where none of its steps was repeated, no less than what estimators wander.

        lasts_s: of its responses, where they are compared without a disturbance of their own. A velocity is the integral of an
        accelerometer that drifts by c for so long, its initial value estimated: RMS c lasts_s / sqrt(12).
        """
        if self.repeated(channel, kind):
            return self.std[channel]
        integrated = DRIFT[f"f_{channel[2:]}2"] * lasts_s / np.sqrt(12.0) if channel.startswith("v_") else 0.0
        return max(self.std[channel], float(np.hypot(DRIFT.get(channel, 0.0), integrated)))

    def whole(self, channel: str) -> float:
        """The floor with everything in it that differs between repeats, the bins around jittering edges included."""
        if channel not in self.lack_of_fit:
            return self.std[channel]
        return float(np.sqrt(max(self.std[channel] ** 2, self.lack_of_fit[channel][2])))

    def exceeded(self, channel: str, kind: str, mean_square: float, count: float, lasts_s: float = 0.0) -> bool:
        """Whether `count` independent samples of this mean square lie above the floor: by a quarter in power at least (half the floor in
        amplitude), by four times where no step was repeated, and more than chance would have it (0.1 %, for there are many places to
        look at). Where steps were repeated it is what the repeats share that counts (lack of fit), since a gusty response is no fault of
        the model."""
        ratio = mean_square / self.at(channel, kind, lasts_s) ** 2
        if ratio <= (LEAST_RATIO if self.repeated(channel, kind) else GUESSED_RATIO):
            return False
        if self.repeated(channel, kind):
            lack, cells, repeats, times = self.lack_by_kind[channel, kind]
            # A response whose samples all went astray together is one observation. What stands out by far needs no such caution.
            looks = times if ratio > OUTRIGHT**2 else 1.0
            return bool(lack > fisher_quantile(1 - SIGNIFICANCE, max(cells * looks, 1.0), max(repeats * looks, 1.0)))
        return bool(ratio > fisher_quantile(1 - SIGNIFICANCE, max(count, 1.0), 1e3))


def high_frequency(rows: Linearisation) -> dict[str, float]:
    """Channel to the std of white noise that would give the residual's second differences."""
    raw = rows.unprofiled_residual
    found = {}
    for c, name in enumerate(rows.channels):
        at = np.flatnonzero(rows.channel == c)
        order = at[np.lexsort((rows.sample[at], rows.segment[at]))]
        x, segment = raw[order], rows.segment[order]
        same = segment[2:] == segment[:-2]
        second = (x[2:] - 2 * x[1:-1] + x[:-2])[same]
        # The median keeps the few samples around steps from counting.
        found[name] = 1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0) if second.size else 0.0
    return found


def power_of_noise(x: FloatArray, segment: IntArray) -> float:
    """Std of white noise with the power of the second differences of x (n,), samples in order; segment (n,): the response of each.

    Unlike the median of `high_frequency`, it holds the jumps of an estimator and of a differentiated position. Only where no step was
    flown: around steps it would hold the model's errors.
    """
    same = segment[2:] == segment[:-2]
    second = (x[2:] - 2 * x[1:-1] + x[:-2])[same]
    return float(np.sqrt(np.mean(second**2) / 6.0)) if second.size else 0.0


def covariates(segment: Segment) -> FloatArray:
    """What differs between repeats of one step: ln U, initial velocity, heading, height; 0 where not recorded."""

    def first(name: str) -> float:
        values = np.asarray(segment.y.get(name, np.empty(0)))[:5]
        values = values[np.isfinite(values)]
        return float(values.mean()) if values.size else 0.0

    volts = first("voltage_v")
    heading = first("yaw_rad") if "yaw_rad" in segment.y else 0.0
    return np.array(
        [
            np.log(volts) if volts > 0 else 0.0,
            first("v_x_m_s"),
            first("v_y_m_s"),
            first("v_z_m_s"),
            np.cos(heading),
            np.sin(heading),
            first("height_m"),
        ]
    )


def floor_of(rows: Linearisation, segments: Sequence[Segment], resolution: Mapping[str, float]) -> NoiseFloor:
    """Pure error of repeats, covariates regressed out; the high-frequency residual where there are no repeats. segments: of these rows."""
    return rows.once(("floor", *resolution.items()), lambda: _floor(rows, segments, resolution))


def _floor(rows: Linearisation, segments: Sequence[Segment], resolution: Mapping[str, float]) -> NoiseFloor:
    fast = high_frequency(rows)
    cells: dict[object, list[int]] = {}
    for i, s in enumerate(segments):
        if s.kind != "free":
            cells.setdefault(s.cell_key, []).append(i)
    cells = {k: v for k, v in cells.items() if len(v) >= 2}
    std, repeated, lack = {}, set(), {}
    by_kind: dict[tuple[str, str], tuple[float, int, float, float]] = {}
    for c, name in enumerate(rows.channels):
        pure = _pure_error(rows, segments, cells, c) if cells else None
        if pure is None:
            std[name] = max(fast[name], resolution.get(name, 0.0), DRIFT.get(name, 0.0))
            continue
        pure_ms, pure_dof, lack_ms, lack_dof, kinds, usual_ms = pure
        by_kind |= {(name, kind): value for kind, value in kinds.items()}
        pure_ms += fast[name] ** 2  # what moves within a bin
        std[name] = max(float(np.sqrt(usual_ms + fast[name] ** 2)), resolution.get(name, 0.0))
        repeated.add(name)
        lack[name] = (lack_ms, lack_dof, pure_ms, pure_dof)
    return NoiseFloor(std, frozenset(repeated), lack, by_kind)


def _pure_error(
    rows: Linearisation, segments: Sequence[Segment], cells: Mapping[object, Sequence[int]], c: int
) -> tuple[float, float, float, float, dict[str, tuple[float, int, float, float]], float] | None:
    """Mean squares of 0.1 s means: (pure error, its degrees of freedom, lack of fit, its degrees, kind to (ratio, cells, repeats), usual).

    The usual pure error is the median over times since the step, so that a few bins around jittering edges do not raise the floor of
    all the others.
    """
    kinds: dict[str, list[tuple[int, float]]] = {}
    cells_of: dict[str, int] = {}
    raw = rows.unprofiled_residual
    at = np.flatnonzero(rows.channel == c)
    at = at[np.argsort(rows.segment[at], kind="stable")]
    starts = np.searchsorted(rows.segment[at], np.arange(len(segments) + 1))
    by_segment = {i: at[starts[i] : starts[i + 1]] for members in cells.values() for i in members}
    known = rows.once("covariates", lambda: {i: covariates(segments[i]) for i in by_segment})
    square, dof, lack, lack_dof = 0.0, 0.0, 0.0, 0.0
    bins: dict[tuple[str, int], list[tuple[FloatArray, FloatArray]]] = {}
    apart: dict[str, dict[int, list[tuple[int, float]]]] = {}
    for key, members in cells.items():
        kind = str(key[0])  # type: ignore[index]
        cells_of[kind] = cells_of.get(kind, 0) + 1
        present = [i for i in members if by_segment[i].size]
        if not present:
            continue
        means, first = binned([(segments[i], rows.sample[by_segment[i]], raw[by_segment[i]]) for i in present])
        seen = np.isfinite(means)
        count = seen.sum(axis=0)
        common = np.where(seen, means, 0.0).sum(axis=0) / np.maximum(count, 1)
        z = np.array([known[i] for i in present])
        middle = (seen.T @ z) / np.maximum(count, 1)[:, None]
        between = count * common**2
        repeated = np.flatnonzero(count >= 2)
        for k in repeated:
            who = seen[:, k]
            bins.setdefault((kind, first + int(k)), []).append((z[who] - middle[k], means[who, k] - common[k]))
            lack += between[k]
            kinds.setdefault(kind, []).append((first + int(k), float(between[k])))
        for r, i in enumerate(present):
            own = repeated[seen[r, repeated]]
            apart.setdefault(kind, {}).setdefault(i, []).extend(
                zip((own + first).tolist(), (means[r, own] - common[own]).tolist(), strict=True)
            )
        lack_dof += repeated.size
    each: list[tuple[float, float]] = []
    at_time: dict[int, tuple[float, float]] = {}
    for (_, b), same in bins.items():
        z, d = np.concatenate([e[0] for e in same]), np.concatenate([e[1] for e in same])
        free = float(d.size - len(same))
        moving = z.std(axis=0) > 1e-9
        z = z[:, moving]
        if z.shape[1] and free >= EQUATIONS_PER_COVARIATE * z.shape[1]:
            scaled = z / z.std(axis=0)
            d = d - scaled @ np.linalg.lstsq(scaled, d, rcond=1e-6)[0]
            free -= float(np.linalg.matrix_rank(scaled, tol=1e-6))
        square += float(d @ d)
        dof += max(free, 0.0)
        old = at_time.get(b, (0.0, 0.0))
        at_time[b] = (old[0] + float(d @ d), old[1] + max(free, 0.0))
        if free > 0.5:
            each.append((float(d @ d) / free, free))
    if dof < 3 or not each:
        return None
    each.sort()
    weight = np.cumsum([w for _, w in each])
    usual = each[int(np.searchsorted(weight, 0.5 * weight[-1]))][0]
    shared = {}
    for kind, values in kinds.items():
        ratio, repeats = shared_error(values, at_time)
        several = independent_times(list(apart.get(kind, {}).values()), at_time)
        shared[kind] = ratio, cells_of[kind], repeats, several
    return square / dof, dof, lack / lack_dof, lack_dof, shared, usual


def binned(responses: Sequence[tuple[Segment, IntArray, FloatArray]]) -> tuple[FloatArray, int]:
    """Means (m, bins) over `BIN_S` of time since the step of residuals at samples of m responses, NaN where there are none; the first
    bin."""
    which = [np.floor((s.t_s[sample] - s.t_step_s) / BIN_S).astype(int) for s, sample, _ in responses]
    first, last = min(int(w.min()) for w in which), max(int(w.max()) for w in which)
    made = np.full((len(which), last - first + 1), np.nan)
    for row, w, (_, _, x) in zip(made, which, responses, strict=True):
        count, total = np.bincount(w - first), np.bincount(w - first, x)
        row[: count.size] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return made, first


def shared_error(
    values: Sequence[tuple[int, float]], at_time: Mapping[int, tuple[float, float]]
) -> tuple[float, float]:
    """(what repeats share over their pure error at the same times, repeats that measure that).

    A velocity's error grows while a response lasts, so late times are compared with late times. The repeats are those of one time.
    """
    known = [(v, at_time[b][0] / at_time[b][1], at_time[b][1]) for b, v in values if at_time[b][1] > 0.5]
    pure = sum(p for _, p, _ in known)
    if pure <= 0:
        return 0.0, 1.0
    return sum(v for v, _, _ in known) / pure, sum(p * free for _, p, free in known) / pure


def independent_times(
    curves: Sequence[Sequence[tuple[int, float]]], at_time: Mapping[int, tuple[float, float]]
) -> float:
    """How many independent looks one response gives, 1 or more: few where what differs lasts (a gust moves the whole response), many
    where it comes and goes.

    curves: of each response (time bin, difference from the mean of its repeats). Satterthwaite's degrees of freedom of a sum of
    squares whose terms are correlated: (sum p)^2 / sum rho^2 p p', p the pure error of a time.
    """
    usual = {b: square / free for b, (square, free) in at_time.items() if free > 0.5 and square > 0}
    length = 1 + max(usual, default=0) - min(usual, default=0)
    if length < 2:
        return 1.0
    first = min(usual)
    power = np.zeros(length)
    for b, p in usual.items():
        power[b - first] = p
    product, both = np.zeros(length), np.zeros(length)
    for curve in curves:
        d = np.zeros(length)
        for b, value in curve:
            if b in usual:
                d[b - first] = value / np.sqrt(usual[b])
        seen = (d != 0.0).astype(float)
        product += np.correlate(d, d, "full")[length - 1 :]
        both += np.correlate(seen, seen, "full")[length - 1 :]
    if product[0] <= 0:
        return 1.0
    rho = np.where(both > 0, product / np.maximum(both, 1.0), 0.0) / (product[0] / both[0])
    together = np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
    return max(1.0, float(power.sum() ** 2 / (power @ (np.minimum(rho**2, 1.0)[together] @ power))))


def step_errors(rows: Linearisation, segments: Sequence[Segment]) -> list[StepError]:
    """Of every channel and kind of step that was commanded; none of free flight. segments: of these rows."""
    cells: dict[tuple[str, tuple[tuple[str, float], ...]], list[int]] = {}
    for i, s in enumerate(segments):
        if s.kind != "free":
            cells.setdefault(s.cell_key, []).append(i)
    found = []
    for key, members in cells.items():
        for c, name in enumerate(rows.channels):
            here = (rows.channel == c) & (rows.sample >= 0)
            each = [(i, np.flatnonzero(here & (rows.segment == i))) for i in members]
            known = [(segments[i], rows.sample[at], rows.unprofiled_residual[at]) for i, at in each if at.size]
            if known:
                means, first = binned(known)
                mean, variance = _moments(means)
                found.append(StepError(name, key[0], dict(key[1]), len(known), first, mean, variance))
    return found


def _moments(means: FloatArray) -> tuple[FloatArray, float]:
    """Mean (bins,) of responses (m, bins), and the variance of one about it, mean over bins with two or more; NaN where there are none."""
    seen = np.isfinite(means)
    count = seen.sum(axis=0)
    mean = np.where(count > 0, np.where(seen, means, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    several = count >= 2
    if not several.any():
        return mean, math.nan
    apart = np.where(seen, (means - mean) ** 2, 0.0).sum(axis=0)[several] / (count[several] - 1)
    return mean, float(np.mean(apart))
