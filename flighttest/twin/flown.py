"""Steps that a vehicle and its twin both flew, as flown: no model is in the comparison.

With x_i the recorded responses of one step, m in number, and y the mean of the twin's n: RMS of x_i - y, against what the repeats of the
recording by themselves would give, s sqrt(1 + 1/n) with s^2 the variance between the repeats. Each response counts from its own state
before the step, and moved in time to where it fits y best: a link delivers one command earlier than another by milliseconds, which on the
slope of a step is more than all else that repeats differ by. The mean of these moves is given apart, as a delay. Compared is what was
commanded alike: the stop after a step is planned with the model of that time, and the twin's plan has a better one. For the same reason
what was held before a step is held longer by one of them, and only the last of it counts as the state before the step. Repeats of throttle
steps are flown at other voltages; their specific force counts as at the nominal one, by the identified exponent, or the floor would be the
battery's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from flighttest.identify.models.model_blocks import FlownStepBlock
from flighttest.segments.commands import alike_until_s, held_until_s
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]
Curve = Callable[[FloatArray], FloatArray]

# Channels that a step drives; others answer to the estimator and to gusts.
DRIVEN: Mapping[str, tuple[str, ...]] = {
    "roll_step": ("roll_rad",), "pitch_step": ("pitch_rad",), "yaw_rate_step": ("r_rad_s",), "throttle_step": ("f_z_m_s2",),
}  # fmt: skip
# Steps of roll, pitch and yaw by what sets their size.
ATTITUDE_STEPS: Mapping[str, tuple[str, str, str]] = {
    "roll": ("roll_step", "amplitude_rad", "roll_rad"), "pitch": ("pitch_step", "amplitude_rad", "pitch_rad"),
    "yaw": ("yaw_rate_step", "rate_rad_s", "r_rad_s"),
}  # fmt: skip
LONGEST_S = 1.2  # of a mean response: the loops have settled, and a counter-step follows
GRID_S = 0.02
MOVE_S = 0.1  # most that a link's delay is taken to differ by
BEFORE_S = 0.1  # of the state before a step: thrust has a lag of 0.07 s, and holds begin 0.28 to 0.8 s before the step
_COARSE_S, _MOVES_S = 0.01, 0.001
_WITHIN = (-0.4, -0.2, 0.0, 0.2, 0.4)
_FEWEST = 5  # samples of a response


def flown_errors(
    real: Sequence[Segment], twin: Sequence[Segment], alpha: float = 0.0, nominal_voltage_v: float = 1.0
) -> dict[str, dict[str, float]]:
    """By channel, SI: rmse of the twin's mean response, floor (what repeats would give), ratio of the two; later_s: by which the recorded
    responses come later than the twin's, later_std_s its standard error by their scatter and the search; steps: number of cells compared.
    Cells that the recording did not repeat have no floor and do not count. alpha: exponent of the voltage in the thrust."""
    sides = [_cells([_at_voltage(s, nominal_voltage_v, alpha) for s in side]) for side in (real, twin)]
    rows: dict[str, list[tuple[float, float]]] = {}
    moves: dict[str, list[FloatArray]] = {}
    for key in sides[0].keys() & sides[1].keys():
        mine, theirs = sides[0][key], sides[1][key]
        if len(mine) < 2:
            continue
        for channel in DRIVEN[mine[0].kind]:
            if not all(channel in s.y and np.isfinite(s.y[channel]).sum() >= _FEWEST for s in (*mine, *theirs)):
                continue
            end = alike_until_s((*mine, *theirs)) - MOVE_S
            grid = np.arange(0.0, end, GRID_S)
            if grid.size < _FEWEST:
                continue
            x, y, late = _in_step(mine, theirs, channel, grid)
            spread = float(np.mean(np.var(x, axis=0, ddof=1))) * (1.0 + 1.0 / len(theirs))
            rows.setdefault(channel, []).append((float(np.mean((x - y) ** 2)), spread))
            moves.setdefault(channel, []).append(late)
    found = {}
    for channel, squares in rows.items():
        rmse, floor = (math.sqrt(sum(r[i] for r in squares) / len(squares)) for i in (0, 1))
        late = np.concatenate(moves[channel])
        if floor > 0.0:
            found[channel] = {
                "rmse": rmse, "floor": floor, "ratio": rmse / floor, "later_s": float(late.mean()),
                "later_std_s": math.hypot(float(late.std(ddof=1)) / math.sqrt(late.size), _MOVES_S / math.sqrt(12.0)),
                "steps": len(squares),
            }  # fmt: skip
    return dict(sorted(found.items()))


def mean_steps(segments: Sequence[Segment]) -> dict[str, list[FlownStepBlock]]:
    """Mean responses of roll, pitch and yaw rate by size of step, both signs taken as one; each moved in time to fit the others, and the
    mean of the moves put back, so that the link's jitter blurs nothing. An axis without steps is not in it."""
    found: dict[str, list[FlownStepBlock]] = {}
    for axis, (kind, size, channel) in ATTITUDE_STEPS.items():
        sizes: dict[float, list[tuple[Curve, float, float]]] = {}
        for cell in _cells([s for s in segments if s.kind == kind and channel in s.y]).values():
            for s in (s for s in cell if np.isfinite(s.y[channel]).sum() >= _FEWEST):
                curve, sign = _since_the_step(s, channel, exact=True), math.copysign(1.0, s.cell[size])
                row = (_scaled(curve, sign), min(map(held_until_s, cell)) - MOVE_S, _mean_voltage(s))
                sizes.setdefault(abs(round(s.cell[size], 4)), []).append(row)
        for step, rows in sorted(sizes.items()):
            grid = np.arange(0.0, min(LONGEST_S, *(end for _, end, _ in rows)), GRID_S)
            if step == 0.0 or grid.size < _FEWEST:
                continue
            curves = [curve for curve, _, _ in rows]
            y = curves[0](grid)
            for _ in range(2):
                moves = [_best_move(curve, y, grid) for curve in curves]
                y = np.mean(
                    [_moved(c, m - float(np.mean(moves)), grid) for c, m in zip(curves, moves, strict=True)], axis=0
                )
            volts = float(np.mean([v for _, _, v in rows]))
            block: FlownStepBlock = {
                "size": step, "responses": len(rows), "voltage_v": round(volts, 3) if math.isfinite(volts) else None,
                "period_s": GRID_S, "answer": [round(float(v), 5) for v in y],
            }  # fmt: skip
            found.setdefault(axis, []).append(block)
    return found


def _scaled(curve: Curve, factor: float) -> Curve:
    return lambda at: factor * curve(at)


def _mean_voltage(segment: Segment) -> float:
    volts = segment.y.get("voltage_v")
    return float(np.nanmean(volts)) if volts is not None and np.isfinite(volts).any() else math.nan


def _in_step(
    mine: Sequence[Segment], theirs: Sequence[Segment], channel: str, grid: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Recorded responses (m, len(grid)) moved to the twin's mean, that mean, and by how much they came later than it, s (m,)."""
    first = _since_the_step(theirs[0], channel)
    y = np.mean(
        [
            _moved(_since_the_step(s, channel), _best_move(_since_the_step(s, channel), first(grid), grid), grid)
            for s in theirs
        ],
        axis=0,
    )
    curves = [_since_the_step(s, channel) for s in mine]
    late = np.array([_best_move(c, y, grid) for c in curves])
    base = np.mean([_best_move(_since_the_step(s, channel), y, grid) for s in theirs])
    return np.array([_moved(c, m, grid) for c, m in zip(curves, late, strict=True)]), y, late - base


def _at_voltage(segment: Segment, volts: float, alpha: float) -> Segment:
    """A throttle step with its specific force as at another voltage, V: it is thrust but for the drag."""
    ratio = _mean_voltage(segment) / volts
    if segment.kind != "throttle_step" or "f_z_m_s2" not in segment.y or not ratio > 0.0:
        return segment
    return replace(segment, y={**segment.y, "f_z_m_s2": segment.y["f_z_m_s2"] * ratio**-alpha})


def _cells(segments: Sequence[Segment]) -> dict[object, list[Segment]]:
    cells: dict[object, list[Segment]] = {}
    for s in segments:
        if s.usable and s.kind in DRIVEN:
            cells.setdefault(s.cell_key, []).append(s)
    return cells


def _since_the_step(segment: Segment, channel: str, exact: bool = False) -> Curve:
    """The response as a function of the time since the step, less its mean in the last BEFORE_S before it. exact: read at that very
    time."""
    t, y = segment.t_s - segment.t_step_s, segment.y[channel]
    good = np.isfinite(y)
    t, y = t[good], y[good]
    before = y[(t <= 0.0) & (t > -BEFORE_S)]
    y = y - (before.mean() if before.size else y[0])
    if exact:
        return CubicSpline(t, y, extrapolate=False) if t.size > 3 else lambda at: np.interp(at, t, y)
    # Over one sample, so that the noise is much the same wherever between two samples the response is read.
    return lambda at: np.asarray(np.mean([np.interp(at + d * GRID_S, t, y) for d in _WITHIN], axis=0))


def _moved(curve: Curve, late_s: float, grid: FloatArray) -> FloatArray:
    return curve(grid + late_s)


def _best_move(curve: Curve, y: FloatArray, grid: FloatArray) -> float:
    """How much later than y this response comes, s, within MOVE_S: least squares."""
    best, reach = 0.0, MOVE_S
    for step in (_COARSE_S, _MOVES_S):
        tried = best + step * np.arange(-round(reach / step), round(reach / step) + 1)
        tried = tried[np.abs(tried) <= MOVE_S + 1e-9]
        best = float(min(tried, key=lambda m: float(np.sum((_moved(curve, m, grid) - y) ** 2))))
        reach = _COARSE_S
    return best
