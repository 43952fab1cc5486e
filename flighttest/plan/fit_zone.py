"""Fit one distinct step into the zone: shorten what may be shortened, find its stops and the room it takes.

Everything is predicted at both ends of the battery's range, since a throttle step climbs most on a full battery and a descent
falls most on an empty one; what is found holds for every repeat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flighttest.plan.model import FloatArray, Predictor
from flighttest.plan.rehearse import GRID_S, GUID_TIMEOUT_S, Rehearsal, Row, rehearse
from flighttest.plan.room import Room, Track
from flighttest.script.profiles import Cell, Piece

# Six time constants of the paper's thrust lag: less than this after the delay shows nothing.
USEFUL_S = 0.3
SEARCH_STEP_S = 0.04
# The search flies coarse steps; what it calls a fit has this much to spare.
SLACK_M = 0.1
LOSS_EVERY_S = 0.2
# Long enough for the drag of any vehicle to take most of its speed.
DRIFT_S = 6.0
VERTICAL_STOP_LOW, VERTICAL_STOP_HIGH = 0.3, 1.8


@dataclass(frozen=True)
class Setting:
    """What all cells share: the prior, the room, the battery's ends (V), hover throttle, bounds of throttle and speed."""

    predictor: Predictor
    room: Room
    voltages_v: tuple[float, ...]
    hover_throttle: float
    throttle: tuple[float, float]
    speed_max_m_s: float

    @property
    def stop_throttle(self) -> tuple[float, float]:
        """Throttle against climbing and against falling: never zero, which leaves no authority over the attitude."""
        low = max(self.throttle[0], VERTICAL_STOP_LOW * self.hover_throttle)
        return low, min(self.throttle[1], VERTICAL_STOP_HIGH * self.hover_throttle)


@dataclass(frozen=True)
class Fitted:
    """A cell with its durations found: lead pieces, tracks as planned and with the link lost, fastest speed, what is wrong."""

    cell: Cell
    lead: tuple[Piece, ...]
    nominal: list[Track]
    lost: list[Track]
    speed_m_s: float
    shortened: bool
    complaint: str = ""
    remedy: str = ""


def row_of(cell: Cell, lead: tuple[Piece, ...], setting: Setting, voltage_v: float) -> Row:
    """The row of a cell at one voltage, from the origin, heading along x."""
    tail = sum(piece.duration_s for piece in cell.tail)
    return Row(lead, cell.stops, cell.counter, tail, voltage_v, setting.stop_throttle)


def fit_cells(cells: Sequence[Cell], setting: Setting) -> list[Fitted]:
    """Durations, tracks and complaints of all cells, in order; the predictor is flown few times with many vehicles."""
    leads = [cell.lead for cell in cells]
    adjustable = [i for i, cell in enumerate(cells) if cell.shortest_s]
    for i, lead in _search([cells[i] for i in adjustable], setting, adjustable) if adjustable else ():
        leads[i] = lead
    return _tracks(cells, leads, setting)


def least_s(cell: Cell, name: str, setting: Setting) -> float:
    """The shortest useful length of a piece, s."""
    least = cell.shortest_s[name]
    return setting.predictor.delay_s + USEFUL_S if least is None else least


def _with(lead: tuple[Piece, ...], durations: dict[str, float]) -> tuple[Piece, ...]:
    return tuple(replace(piece, duration_s=durations.get(piece.name, piece.duration_s)) for piece in lead)


def _search(cells: list[Cell], setting: Setting, indices: list[int]) -> list[tuple[int, tuple[Piece, ...]]]:
    """Longest record that fits, for each length of what comes before it; then the longest record wins, then the longest hold."""
    options: list[tuple[int, dict[str, float], str, float, float]] = []
    for k, cell in enumerate(cells):
        wanted = {piece.name: piece.duration_s for piece in cell.lead}
        before = [name for name in cell.shortest_s if name != "step"]
        least = {name: min(least_s(cell, name, setting), wanted[name]) for name in cell.shortest_s}
        shares = (1.0, 0.6, 0.3, 0.0) if before else (1.0,)
        for share in shares:
            fixed = {name: round(least[name] + share * (wanted[name] - least[name]), 2) for name in before}
            longest = wanted.get("step", 0.0)
            shortest = least.get("step", longest)
            options.append((k, fixed, "step", shortest, longest))
    low = np.array([option[3] for option in options])
    high = np.array([option[4] for option in options])
    steps = np.maximum(np.round((high - low) / GRID_S), 0).astype(int)
    fits = _fits(cells, options, low, setting)
    # Bisection over multiples of the duration step above the least; a flight that fits also fits when it is shorter.
    good, bad = np.zeros_like(steps), steps.copy()
    whole = _fits(cells, options, low + steps * GRID_S, setting)
    good[whole] = steps[whole]
    while bool(np.any(fits & (bad - good > 1))):
        middle = (good + bad) // 2
        ok = _fits(cells, options, low + middle * GRID_S, setting)
        good, bad = np.where(ok, np.maximum(good, middle), good), np.where(ok, bad, np.minimum(bad, middle))
    best: dict[int, tuple[float, float, tuple[Piece, ...]]] = {}
    for j, (k, fixed, name, _, _) in enumerate(options):
        record = float(low[j] + good[j] * GRID_S) if fits[j] else -1.0
        score = (round(record, 2), sum(fixed.values()))
        durations = {**fixed, name: max(record, float(low[j]))}
        if k not in best or score > best[k][:2]:
            best[k] = (*score, _with(cells[k].lead, durations))
    return [(indices[k], best[k][2]) for k in best]


def _fits(
    cells: list[Cell],
    options: list[tuple[int, dict[str, float], str, float, float]],
    record_s: FloatArray,
    setting: Setting,
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether each option's flight fits the room in size, at both voltages, as planned and with the link lost at its end."""
    rows = []
    for (k, fixed, name, _, _), seconds in zip(options, record_s, strict=True):
        lead = _with(cells[k].lead, {**fixed, name: float(seconds)})
        for voltage in setting.voltages_v:
            row = row_of(cells[k], lead, setting, voltage)
            # The two worst moments: at the end of what comes before the step, and at the end of the record.
            rows += [row, row.losing_link_at(row.lead_s), row.losing_link_at(row.lead_s - float(seconds))]
    flown = rehearse(rows, setting.predictor, SEARCH_STEP_S)
    p = flown.motion.p_m.reshape(len(options), len(setting.voltages_v), 3, -1, 3)
    speed = np.linalg.norm(flown.motion.v_m_s, axis=-1).reshape(p.shape[:-1])[:, :, 0].max(axis=(1, 2))
    room = setting.room
    planned, lost = p[:, :, 0], p[:, :, 1:]
    low, high = planned.min(axis=(1, 2))[:, 2], planned.max(axis=(1, 2))[:, 2]
    lost_low, lost_high = lost.min(axis=(1, 2, 3))[:, 2], lost.max(axis=(1, 2, 3))[:, 2]
    start_low = np.maximum(room.inner_low[2] - low, room.outer_low[2] - lost_low) + SLACK_M
    start_high = np.minimum(room.inner_high[2] - high, room.outer_high[2] - lost_high) - SLACK_M
    heights = np.array([cells[option[0]].height_m or math.nan for option in options])
    free = np.isnan(heights)
    start = np.where(free, start_low, heights)
    tall = (start_low <= start_high) & (start >= start_low - 1e-6) & (start <= start_high + 1e-6)
    spread = np.sort(planned.max(axis=(1, 2))[:, :2] - planned.min(axis=(1, 2))[:, :2], axis=1)
    wide = np.sort((room.inner_high - room.inner_low)[:2])
    flat = np.all(spread <= wide, axis=1)
    return np.asarray(tall & flat & (speed <= setting.speed_max_m_s))


def _tracks(cells: Sequence[Cell], leads: list[tuple[Piece, ...]], setting: Setting) -> list[Fitted]:
    """Tracks of every cell at every voltage, as planned and with the link lost every so often."""
    planned: list[tuple[int, Row]] = []
    losing: list[tuple[int, Row]] = []
    for i, cell in enumerate(cells):
        if cell.motors_off or cell.waypoints:
            continue
        for voltage in setting.voltages_v:
            row = row_of(cell, leads[i], setting, voltage)
            planned.append((i, row))
            start = leads[i][0].duration_s if leads[i][0].name == "entry" else 0.0
            moments = [*np.arange(start + LOSS_EVERY_S, row.lead_s, LOSS_EVERY_S), row.lead_s]
            # Into the counter-step and the stop as well: there the last target pushes the other way.
            moments += [row.lead_s + 0.3, row.lead_s + 0.6] if cell.stops else []
            losing += [(i, row.losing_link_at(float(t))) for t in moments]
    nominal: list[list[Track]] = [[] for _ in cells]
    lost: list[list[Track]] = [[] for _ in cells]
    speed = [0.0 for _ in cells]
    for rows, into, step, after in (
        (planned, nominal, SEARCH_STEP_S / 2, None),
        (losing, lost, SEARCH_STEP_S, DRIFT_S),
    ):
        if not rows:
            continue
        flown = rehearse([row for _, row in rows], setting.predictor, step, after)
        for j, (i, row) in enumerate(rows):
            track = track_of(flown, j, row)
            into[i].append(track)
            if into is nominal:
                speed[i] = max(speed[i], float(np.linalg.norm(track.v_m_s, axis=1).max()))
    return [
        _judge(
            Fitted(
                cell, leads[i], nominal[i], lost[i], speed[i], shortened=_length(leads[i]) < _length(cell.lead) - 1e-6
            ),
            setting,
        )
        for i, cell in enumerate(cells)
    ]


def track_of(flown: Rehearsal, j: int, row: Row) -> Track:
    """The track of one row up to the end of its stops and tail (of its drift, with the link lost), relative to its start."""
    motion = flown.motion
    end = motion.t_s[-1]
    if math.isinf(row.lost_s):
        end = row.lead_s + flown.counter_s[j] + flown.vertical_s[j] + row.tail_s + 0.1
    else:
        end = row.lost_s + GUID_TIMEOUT_S + DRIFT_S
    count = int(np.searchsorted(motion.t_s, end + 1e-9))
    start = motion.p_m[j, 0]
    return Track(motion.t_s[:count], motion.p_m[j, :count] - start, motion.v_m_s[j, :count])


def _length(lead: tuple[Piece, ...]) -> float:
    return sum(piece.duration_s for piece in lead)


def useful_s(fitted: Fitted, setting: Setting) -> float:
    """How much of the record is left after the delay, s; the whole record of a flight without a step."""
    first = next((piece.duration_s for piece in fitted.lead if piece.record), 0.0)
    return first - setting.predictor.delay_s


def _judge(fitted: Fitted, setting: Setting) -> Fitted:
    """Speed, throttle and usefulness: what no start can mend."""
    if fitted.cell.motors_off or fitted.cell.waypoints:
        return fitted
    if fitted.speed_m_s > setting.speed_max_m_s:
        return replace(
            fitted,
            complaint=f"it reaches {fitted.speed_m_s:.1f} m/s, above speed_max_m_s {setting.speed_max_m_s:g}",
            remedy="shorten it, make the step smaller, or raise the limit",
        )
    if fitted.cell.kind.endswith("_step") and useful_s(fitted, setting) < USEFUL_S - 1e-6:
        return replace(
            fitted,
            complaint=f"only {max(useful_s(fitted, setting), 0.0):.2f} s are left after the delay of "
            f"{setting.predictor.delay_s:.2f} s; less than {USEFUL_S} s shows nothing",
            remedy="hold it longer, or make the step smaller so that it fits longer",
        )
    for piece in fitted.lead:
        if isinstance(piece.throttle, float) and not setting.throttle[0] <= piece.throttle <= setting.throttle[1]:
            return replace(
                fitted,
                complaint=f"throttle {piece.throttle:.2f} is outside the limits {setting.throttle[0]:g} to {setting.throttle[1]:g}",
                remedy="change the step or the limit",
            )
    return fitted
