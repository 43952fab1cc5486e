"""What the references did: held stretches (plateaus), the edges between them, and the responses those edges begin.

Everything is inferred from the recorded references alone. Marks only name what is found here (see `cut`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import INPUTS
from flighttest.recording import Recording

FloatArray = NDArray[np.float64]

ROLL, PITCH, YAW_RATE, THROTTLE = range(4)
_LEAST = np.array([0.05, 0.05, 0.15, 0.025])  # rad, rad, rad/s, 1: a smaller change is no step
_MEANWHILE = np.array([0.03, 0.03, 0.1, 0.02])  # what the other references may change at an edge
_THROTTLE_WITH_TILT = 0.08  # level flight asks for hover / cos(tilt): throttle may go along with a tilt step
_TILTED = 0.05  # rad
_PAIR_HOLD_S = 1.6  # a throttle held no longer than this before the next throttle step is that step's T_0
_RATE_MAX_HZ = 110.0
_SILENCE_S = 2.0
_SLOWEST_POLL_S = 0.1
_LINE_S = 0.02  # of a line between readings that is one value: half of it is a few percent of a motor's lag


@dataclass(frozen=True)
class Tolerance:
    """How still a reference is while held: bounds per input, the shortest hold, and how long a change may take."""

    still: tuple[float, float, float, float]
    hold_s: float
    change_s: float


EXACT = Tolerance((5e-4, 5e-4, 1e-3, 2e-4), 0.12, 0.0)
"""References that a script sent: held to the last digit. (An outer loop between the steps drifts, if slowly.)"""
IN_PIECE = Tolerance(EXACT.still, 0.015, 0.0)
"""The same where a table's step number marks a step: two samples before it are enough."""
BY_HAND = Tolerance((0.02, 0.02, 0.06, 0.015), 0.35, 0.5)
"""References from sticks, or an autopilot's own shaped target: changes take time."""


@dataclass(frozen=True)
class References:
    """The recorded references on one time base: t_s (n,), values (n, 4) in the order of `channels.INPUTS`, NaN where not
    recorded. period_s: the usual time between targets. streamed: whether targets were repeated, so that silence means loss."""

    t_s: FloatArray
    values: FloatArray
    period_s: float
    streamed: bool


@dataclass(frozen=True)
class Plateau:
    """All references held from start_s until end_s (when the next target came); values (4,)."""

    start_s: float
    end_s: float
    values: FloatArray


@dataclass(frozen=True)
class Edge:
    """One reference changed, the others did not: at t_s, from `before` to `after` (plateau indices).

    by_hand: it took its time, as what sticks or an outer loop ask for does.
    """

    t_s: float
    channel: int
    before: int
    after: int
    by_hand: bool = False


@dataclass(frozen=True)
class FoundStep:
    """One step and how long its record may be: kind and cell as in `Segment`; from start_s to end_s, the step at t_step_s;
    later_edges_s: further edges of the same input inside (counter-step, return); by_hand: as of the edge; between: a
    window between steps, in which the vehicle is brought back."""

    kind: str
    cell: dict[str, float]
    t_step_s: float
    start_s: float
    end_s: float
    later_edges_s: tuple[float, ...] = ()
    by_hand: bool = False
    between: bool = False


def references_of(recording: Recording) -> References | None:
    """The references of a recording, None where there are none."""
    series = recording.series.get("reference")
    if series is None or len(series) < 2:
        return None
    missing = np.full(len(series), np.nan)
    values = np.stack([series.columns.get(name, missing) for name in INPUTS], axis=-1)
    period = float(np.median(np.diff(series.t_s)))
    return References(series.t_s, values, period, period < 0.2)


def reference_moves(references: References | None, response: FoundStep) -> bool:
    """Whether any reference changes by as much as a step in a stretch."""
    if references is None:
        return False
    inside = (references.t_s >= response.start_s) & (references.t_s <= response.end_s)
    values = references.values[inside]
    known = np.isfinite(values).any(axis=0)
    return bool(known.any()) and bool(
        np.any(np.nanmax(values[:, known], 0) - np.nanmin(values[:, known], 0) >= _LEAST[known])
    )


def compressed(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The samples (m,) at which a held signal changed; the first always."""
    if t_s.size == 0:
        return t_s, values
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    keep = np.concatenate([[True], ~same])
    return t_s[keep], values[keep]


def between_polls(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Edges (m,) of a signal that was read off at a logger's times, from its changes (n,) there.

    Where readings further apart than `_LINE_S` differ from one to the next, the signal is on the line between them, in pieces of that
    length with the value in their middle. Else it is held, each change half way to the reading before. Held from reading to reading it
    would be late by half a period on the average, and the delay too small by as much.
    """
    if t_s.size < 2:
        return t_s, values
    gaps = np.diff(t_s)
    period = min(float(np.median(gaps)), _SLOWEST_POLL_S)
    half_way = t_s - 0.5 * np.minimum(np.concatenate([[period], gaps]), period)
    moves = (gaps <= 1.5 * period) & (gaps > 1.5 * _LINE_S)
    if not moves.any():
        return half_way, values
    edges, made = [half_way[:1]], [values[:1]]
    for k in range(gaps.size):
        if not moves[k]:
            edges.append(half_way[k + 1 : k + 2])
            made.append(values[k + 1 : k + 2])
            continue
        bounds = np.linspace(t_s[k], t_s[k + 1], int(np.ceil(gaps[k] / _LINE_S)) + 1)
        edges.append(bounds[:-1])
        made.append(np.interp(0.5 * (bounds[1:] + bounds[:-1]), t_s[k : k + 2], values[k : k + 2]))
        if k + 1 == gaps.size or not moves[k + 1]:  # it rests
            edges.append(t_s[k + 1 : k + 2])
            made.append(values[k + 1 : k + 2])
    return np.concatenate(edges), np.concatenate(made)


def plateaus(references: References, tolerance: Tolerance) -> list[Plateau]:
    """Stretches of at least tolerance.hold_s in which no reference moved."""
    t, values = references.t_s, references.values
    if references.period_s < 1.0 / _RATE_MAX_HZ:
        step = int(np.ceil(1.0 / _RATE_MAX_HZ / references.period_s))
        t, values = t[::step], values[::step]
    known = np.asarray(~np.isnan(values).all(axis=0))
    if not known.any():
        return []
    bounds = np.asarray(tolerance.still)[known].tolist()
    rows = values[:, known].tolist()
    broken = np.asarray(np.isnan(values[:, known]).any(axis=1)).tolist()
    times = [*t.tolist(), float(t[-1]) + references.period_s]
    # A long silence ends what was held, as far as is known; a short one is a flaw of the response it falls into.
    silent = (np.append(np.diff(t), 0.0) > (_SILENCE_S if references.streamed else np.inf)).tolist()
    found: list[Plateau] = []
    begin = 0
    for i in range(1, len(rows) + 1):
        if i < len(rows) and not broken[i] and not broken[begin]:
            anchor, row = rows[begin], rows[i]
            if not silent[i - 1] and all(abs(a - b) <= c for a, b, c in zip(anchor, row, bounds, strict=True)):
                continue
        end = times[i - 1] + references.period_s if silent[i - 1] else times[i]
        if not broken[begin] and end - times[begin] >= tolerance.hold_s and i - begin > 1:
            found.append(Plateau(times[begin], end, np.median(values[begin:i], axis=0)))
        begin = i
    return found


def chains(held: Sequence[Plateau], tolerance: Tolerance, period_s: float) -> list[tuple[list[Plateau], list[Edge]]]:
    """Rows of plateaus that follow each other by edges of one reference at a time (or by changes too small to be steps)."""
    found: list[tuple[list[Plateau], list[Edge]]] = []
    row: list[Plateau] = []
    edges: list[Edge] = []
    for plateau in held:
        link = _link(row[-1], plateau, tolerance, period_s) if row else None
        if link is None:
            if edges:
                found.append((row, edges))
            row, edges = [plateau], []
            continue
        if link >= 0:
            edges.append(Edge(row[-1].end_s, link, len(row) - 1, len(row), tolerance.change_s > 0.0))
        row.append(plateau)
    if edges:
        found.append((row, edges))
    return found


def _link(a: Plateau, b: Plateau, tolerance: Tolerance, period_s: float) -> int | None:
    """The input that changed from a to b, -1 for a change too small to be a step, None where they do not follow each other."""
    if b.start_s - a.end_s > tolerance.change_s + 0.5 * period_s:
        return None
    change = np.nan_to_num(np.abs(b.values - a.values))
    if not np.any(change >= _LEAST):
        return -1
    relative = np.asarray(change / _LEAST)
    channel = int(np.argmax(relative))
    allowed = np.maximum(_MEANWHILE, tolerance.still)
    if channel in (ROLL, PITCH):
        allowed[THROTTLE] = _THROTTLE_WITH_TILT
    elif channel == THROTTLE and change[THROTTLE] <= _THROTTLE_WITH_TILT:
        # The throttle that goes along with a tilt step can outweigh a small tilt.
        tilt = int(np.argmax(change[[ROLL, PITCH]]))
        if change[tilt] >= _LEAST[tilt]:
            channel = tilt
            allowed[THROTTLE] = _THROTTLE_WITH_TILT
    allowed[channel] = np.inf
    return channel if bool(np.all(change <= allowed)) else None


def responses(row: Sequence[Plateau], edges: Sequence[Edge]) -> list[FoundStep]:
    """Cut a chain into responses: tilt and yaw rate steps until they are back and coasted out, throttle steps in pairs."""
    found: list[FoundStep] = []
    k = 0
    while k < len(edges):
        if edges[k].channel == THROTTLE:
            pair = k + 1 < len(edges) and edges[k + 1].channel == THROTTLE
            pair = pair and row[edges[k].after].end_s - row[edges[k].after].start_s <= _PAIR_HOLD_S
            found.append(throttle_response(row, edges, k + 1 if pair else k))
            k += 2 if pair else 1
            continue
        last = _back(row, edges, k)
        found.append(step_response(row, edges, k, last))
        k = last + 1
    return found


def _back(row: Sequence[Plateau], edges: Sequence[Edge], k: int) -> int:
    """The last edge of the response that edge k begins: where its input is back at what it was."""
    channel = edges[k].channel
    base = row[edges[k].before].values[channel]
    for j in range(k + 1, len(edges)):
        if edges[j].channel != channel:
            return j - 1
        if abs(row[edges[j].after].values[channel] - base) < _LEAST[channel]:
            return j
    return len(edges) - 1


def step_response(row: Sequence[Plateau], edges: Sequence[Edge], k: int, last: int, coast_s: float = 2.0) -> FoundStep:
    """The response to the tilt or yaw rate step of edge k, up to coast_s after edge `last`."""
    edge = edges[k]
    channel = edge.channel
    change = float(row[edge.after].values[channel] - row[edge.before].values[channel])
    kind, name = {
        ROLL: ("roll_step", "amplitude_rad"), PITCH: ("pitch_step", "amplitude_rad"), YAW_RATE: ("yaw_rate_step", "rate_rad_s")
    }[channel]  # fmt: skip
    end = _held_until(row, edges, last, edges[last].t_s + coast_s)
    later = tuple(e.t_s for e in edges[k + 1 : last + 1])
    return FoundStep(kind, {name: change}, edge.t_s, max(row[0].start_s, edge.t_s - 0.3), end, later, edge.by_hand)


def throttle_response(row: Sequence[Plateau], edges: Sequence[Edge], k: int) -> FoundStep:
    """The response to the throttle step of edge k: from the onset of T_0, where that was a step too, to the end of T_1."""
    edge = edges[k]
    before, after = row[edge.before].values, row[edge.after].values
    cell = {"throttle_0": float(before[THROTTLE]), "throttle_1": float(after[THROTTLE])}
    tilt = [float(v) for v in after[:2]]
    kind = "throttle_step"
    if float(np.max(np.abs(np.nan_to_num(after[:2])))) >= _TILTED:
        kind = "tilt_throttle"
        axis = int(np.argmax(np.abs(np.nan_to_num(after[:2]))))
        cell["amplitude_rad"], cell["axis"] = tilt[axis], float(axis)
    start = edge.t_s - 0.3
    if k > 0 and edges[k - 1].channel == THROTTLE:
        onset = edges[k - 1].t_s
        start = onset if edge.t_s - onset <= _PAIR_HOLD_S else edge.t_s - _PAIR_HOLD_S
    end = row[edge.after].end_s
    start, end = max(start, row[0].start_s), min(end, edge.t_s + 3.0)
    return FoundStep(kind, cell, edge.t_s, start, end, by_hand=edge.by_hand)


def _held_until(row: Sequence[Plateau], edges: Sequence[Edge], last: int, latest_s: float) -> float:
    """End of the coast after an edge: small changes may follow, the next step ends it."""
    end = row[edges[last].after].end_s
    following = edges[last + 1].before if last + 1 < len(edges) else len(row) - 1
    return min(max(end, row[following].end_s), latest_s)
