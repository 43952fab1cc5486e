"""Fit one distinct step into the zone: shorten what may be shortened, find its stops and the space it needs.

Everything is predicted at both ends of the battery's range, since a throttle step climbs most on a full battery and a descent
falls most on an empty one; what is found holds for every repeat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flighttest.plan.batched import Request, fly_rows
from flighttest.plan.clearance import GATE_SLACK_M, Clearance, Track, box
from flighttest.plan.model import FloatArray, Predictor
from flighttest.plan.rehearse import GRID_S, GUID_TIMEOUT_S, STOP_SHARES, Rehearsal, Row, sampled_targets
from flighttest.script.profiles import Piece, StepCell

# Six time constants of the paper's thrust lag: less than this after the delay shows nothing.
USEFUL_S = 0.3
SEARCH_STEP_S = 0.04
# The search flies coarse steps; what it calls a fit has this much to spare.
SLACK_M = 0.1
LOSS_EVERY_S = 0.2
ROUNDS = 6
SEARCH_ROUNDS = 4
# How long what comes before a step is held, between its shortest and what was asked for; the finer ones only where none of the first fits.
HOLD_SHARES, FINE_HOLD_SHARES = (1.0, 0.5, 0.0), (0.9, 0.8, 0.7, 0.6, 0.4, 0.3, 0.2, 0.1)
# How long a drift is flown; what is left of it is continued by the rate at which speed falls at its end.
DRIFT_S = 2.5
# A stop takes no longer: at 6 m/s and half of gravity.
STOP_S = 2.2
# Times hover, against climbing and against falling; gentler where the script asks for a height, which may be near the ground.
VERTICAL_STOP, GENTLE_STOP = STOP_SHARES, (0.7, 1.4)


@dataclass(frozen=True)
class Setting:
    """What all cells share: the prior, where the vehicle may be, the battery's ends (V), hover throttle, bounds of throttle and speed."""

    predictor: Predictor
    clearance: Clearance
    voltages_v: tuple[float, ...]
    hover_throttle: float
    throttle: tuple[float, float]
    speed_max_m_s: float

    def stop_throttle(self, cell: StepCell) -> tuple[float, float]:
        """Throttle against climbing and against falling: never zero, which leaves no authority over the attitude."""
        low, high = VERTICAL_STOP if cell.height_m is None else GENTLE_STOP
        return max(self.throttle[0], low * self.hover_throttle), min(self.throttle[1], high * self.hover_throttle)


@dataclass(frozen=True)
class FittedCell:
    """A cell with its durations found: lead pieces, tracks as planned and with the link lost, fastest speed, what is wrong."""

    cell: StepCell
    lead: tuple[Piece, ...]
    nominal: list[Track]
    lost: list[Track]
    speed_m_s: float
    shortened: bool
    complaint: str = ""
    remedy: str = ""


def row_of(cell: StepCell, lead: tuple[Piece, ...], setting: Setting, voltage_v: float) -> Row:
    """The row of a cell at one voltage, from the origin, heading along x."""
    tail = sum(piece.duration_s for piece in cell.tail)
    return Row(lead, cell.stops, cell.counter, tail, voltage_v, setting.stop_throttle(cell))


def fit_cells(cells: Sequence[StepCell], setting: Setting) -> list[FittedCell]:
    """Durations, tracks and complaints of all cells, in order; the predictor is flown few times with many vehicles."""
    leads = [cell.lead for cell in cells]
    adjustable = [i for i, cell in enumerate(cells) if cell.shortest_s]
    if adjustable:
        for i, lead in _search([cells[i] for i in adjustable], setting, adjustable):
            leads[i] = lead
    found = _tracks(cells, leads, setting)
    # The search loses the link at two moments only; where a third one is worse, the record gives way a little more.
    for _ in range(ROUNDS):
        tight = [i for i in adjustable if not _has_start(found[i], setting) and _can_shrink(found[i], setting)]
        if not tight:
            break
        shorter = [_with(found[i].lead, {"step": _step_of(found[i].lead) - 2 * GRID_S}) for i in tight]
        again = _tracks([cells[i] for i in tight], shorter, setting)
        for i, f in zip(tight, again, strict=True):
            found[i] = f
    held = [i for i in adjustable if _has_hold(cells[i]) and not _has_start(found[i], setting)]
    if held:
        searched = _search([cells[i] for i in held], setting, held, FINE_HOLD_SHARES)
        again = _tracks([cells[i] for i in held], [lead for _, lead in searched], setting)
        for i, f in zip(held, again, strict=True):
            if _has_start(f, setting):
                found[i] = f
    return found


def _has_hold(cell: StepCell) -> bool:
    return any(name != "step" for name in cell.shortest_s)


def _step_of(lead: tuple[Piece, ...]) -> float:
    return next((round(piece.duration_s, 3) for piece in lead if piece.name == "step"), 0.0)


def _can_shrink(f: FittedCell, setting: Setting) -> bool:
    return "step" in f.cell.shortest_s and _step_of(f.lead) - 2 * GRID_S >= least_s(f.cell, "step", setting) - 1e-9


def _has_start(f: FittedCell, setting: Setting) -> bool:
    """Whether some height to start from (or the one asked for) keeps every track inside."""
    low, high = (corner[2] for corner in box(f.nominal))
    lost_low, lost_high = (corner[2] for corner in box(f.lost))
    clearance = setting.clearance
    lowest = max(clearance.inner_low[2] - low, clearance.outer_low[2] - lost_low)
    highest = min(clearance.inner_high[2] - high, clearance.outer_high[2] - lost_high)
    reach_low = min(track.reach_m[0] for track in f.nominal)
    reach_high = max(track.reach_m[1] for track in f.nominal)
    lowest = max(lowest, clearance.gate_m[0] + GATE_SLACK_M - reach_low)
    highest = min(highest, clearance.gate_m[1] - GATE_SLACK_M - reach_high)
    start = lowest if f.cell.height_m is None else f.cell.height_m
    return bool(lowest - 1e-9 <= start <= highest + 1e-9)


def least_s(cell: StepCell, name: str, setting: Setting) -> float:
    """The shortest useful length of a piece, s."""
    least = cell.shortest_s[name]
    return setting.predictor.delay_s + USEFUL_S if least is None else least


def _with(lead: tuple[Piece, ...], durations: dict[str, float]) -> tuple[Piece, ...]:
    wanted = [(piece, durations.get(piece.name, piece.duration_s)) for piece in lead]
    return tuple(piece if s == piece.duration_s else replace(piece, duration_s=s) for piece, s in wanted)


@dataclass(frozen=True)
class _Option:
    """A length of what comes before a cell's step, and the lengths its step may have, s."""

    cell: int
    before: dict[str, float]
    shortest_s: float
    longest_s: float


def _search(
    cells: list[StepCell], setting: Setting, indices: list[int], hold_shares: tuple[float, ...] = HOLD_SHARES
) -> list[tuple[int, tuple[Piece, ...]]]:
    """Longest record that fits, for each length of what comes before it; then the longest record wins, then the longest hold."""
    options: list[_Option] = []
    for k, cell in enumerate(cells):
        wanted = {piece.name: piece.duration_s for piece in cell.lead}
        before = [name for name in cell.shortest_s if name != "step"]
        least = {name: min(least_s(cell, name, setting), wanted[name]) for name in cell.shortest_s}
        shares = hold_shares if before else (1.0,)
        for share in shares:
            fixed = {name: round(least[name] + share * (wanted[name] - least[name]), 2) for name in before}
            longest = wanted.get("step", 0.0)
            shortest = least.get("step", longest)
            options.append(_Option(k, fixed, shortest, longest))
    low = np.array([option.shortest_s for option in options])
    high = np.array([option.longest_s for option in options])
    steps = np.maximum(np.round((high - low) / GRID_S), 0).astype(int)
    # Both ends in one flight, then false position: a flight that fits also fits when it is shorter.
    both = _slack(cells, [*options, *options], np.concatenate([low, low + steps * GRID_S]), setting)
    at_good, at_bad = both[: len(options)], both[len(options) :]
    fits = at_good >= 0.0
    good, bad = np.where(at_bad >= 0.0, steps, 0), steps.copy()
    for _ in range(SEARCH_ROUNDS):
        if not bool(np.any(fits & (bad - good > 1))):
            break
        part = at_good / np.maximum(at_good - at_bad, 1e-9)
        middle = np.clip(good + np.floor(part * (bad - good)).astype(int), good + 1, np.maximum(bad - 1, good + 1))
        middle = np.where(fits & (bad - good > 1), middle, good)
        slack = _slack(cells, options, low + middle * GRID_S, setting)
        ok = slack >= 0.0
        at_good, at_bad = np.where(ok, slack, at_good), np.where(ok, at_bad, slack)
        good, bad = np.where(ok, np.maximum(good, middle), good), np.where(ok, bad, np.minimum(bad, middle))
    best: dict[int, tuple[float, float, tuple[Piece, ...]]] = {}
    for j, option in enumerate(options):
        record = float(low[j] + good[j] * GRID_S) if fits[j] else -1.0
        # Where nothing fits, what comes closest: the coarse search may have been too strict.
        score = (round(record, 2), sum(option.before.values()) if fits[j] else float(at_good[j]))
        durations = {**option.before, "step": max(record, float(low[j]))}
        if option.cell not in best or score > best[option.cell][:2]:
            best[option.cell] = (*score, _with(cells[option.cell].lead, durations))
    return [(indices[k], best[k][2]) for k in best]


def _slack(
    cells: list[StepCell],
    options: list[_Option],
    record_s: FloatArray,
    setting: Setting,
) -> FloatArray:
    """What each option's flight has to spare, m (and m/s), at both voltages, as planned and with the link lost; negative: too large."""
    rows = []
    for option, seconds in zip(options, record_s, strict=True):
        cell = cells[option.cell]
        lead = _with(cell.lead, {**option.before, "step": float(seconds)})
        for voltage in setting.voltages_v:
            row = row_of(cell, lead, setting, voltage)
            # The two worst moments: at the end of what comes before the step, and at the end of the record.
            rows += [row, row.losing_link_at(row.lead_s), row.losing_link_at(row.lead_s - float(seconds))]
    flown = fly_rows(Request(rows, SEARCH_STEP_S, STOP_S, lost_heights=True), setting.predictor)
    p = flown.motion.p_m.reshape(len(options), len(setting.voltages_v), 3, -1, 3)
    speed = np.linalg.norm(flown.motion.v_m_s.reshape(p.shape)[:, :, 0], axis=-1).max(axis=(1, 2))
    clearance = setting.clearance
    planned = p[:, :, 0]
    heights, gone = planned[..., 2], p[:, :, 1:, :, 2]
    low, high = heights.min(axis=(1, 2)), heights.max(axis=(1, 2))
    lost_low, lost_high = gone.min(axis=(1, 2, 3)), gone.max(axis=(1, 2, 3))
    reach_low = flown.reach_low_m.reshape(p.shape[:-1])[:, :, 0].min(axis=(1, 2))
    reach_high = flown.reach_high_m.reshape(p.shape[:-1])[:, :, 0].max(axis=(1, 2))
    start_low = np.maximum(clearance.inner_low[2] - low, clearance.outer_low[2] - lost_low) + SLACK_M
    start_high = np.minimum(clearance.inner_high[2] - high, clearance.outer_high[2] - lost_high) - SLACK_M
    start_low = np.maximum(start_low, clearance.gate_m[0] + GATE_SLACK_M - reach_low)
    start_high = np.minimum(start_high, clearance.gate_m[1] - GATE_SLACK_M - reach_high)
    heights = np.array([cells[option.cell].height_m or math.nan for option in options])
    start = np.where(np.isnan(heights), 0.5 * (start_low + start_high), heights)
    tall = np.minimum(start - start_low, start_high - start)
    flat_span = [np.ptp(planned[..., axis], axis=(1, 2)) for axis in (0, 1)]
    spread = np.sort(np.stack(flat_span, axis=1), axis=1)
    flat = (np.sort((clearance.inner_high - clearance.inner_low)[:2]) - spread).min(axis=1)
    return np.asarray(np.minimum(np.minimum(tall, flat), setting.speed_max_m_s - speed))


def _tracks(cells: Sequence[StepCell], leads: list[tuple[Piece, ...]], setting: Setting) -> list[FittedCell]:
    """Tracks of every cell at every voltage, as planned and with the link lost every so often."""
    rows: list[tuple[int, Row]] = []
    for i, cell in enumerate(cells):
        if cell.motors_off or cell.waypoints:
            continue
        for voltage in setting.voltages_v:
            row = row_of(cell, leads[i], setting, voltage)
            rows.append((i, row))
            start = leads[i][0].duration_s if leads[i][0].name == "entry" else 0.0
            moments = [*np.arange(start + LOSS_EVERY_S, row.lead_s, LOSS_EVERY_S), row.lead_s]
            # Into the counter-step and the stop as well: there the last target pushes the other way.
            moments += [row.lead_s + 0.3, row.lead_s + 0.6] if cell.stops else []
            rows += [(i, row.losing_link_at(float(t))) for t in moments]
    nominal: list[list[Track]] = [[] for _ in cells]
    lost: list[list[Track]] = [[] for _ in cells]
    speed = [0.0 for _ in cells]
    flown = (
        fly_rows(
            Request([row for _, row in rows], SEARCH_STEP_S, DRIFT_S + 0.5, GUID_TIMEOUT_S + DRIFT_S), setting.predictor
        )
        if rows
        else None
    )
    for j, (i, row) in enumerate(rows):
        assert flown is not None
        track = track_of(flown, j, row)
        (nominal if math.isinf(row.lost_s) else lost)[i].append(track)
        if math.isinf(row.lost_s):
            speed[i] = max(speed[i], float(np.linalg.norm(track.v_m_s, axis=1).max()))
    return [
        _judge(
            FittedCell(
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
    reach = (0.0, 0.0)
    if math.isinf(row.lost_s):
        low, high = flown.reach_low_m[j, :count].min(), flown.reach_high_m[j, :count].max()
        reach = (float(low - start[2]), float(high - start[2]))
    track = Track(motion.t_s[:count], motion.p_m[j, :count] - start, motion.v_m_s[j, :count], reach)
    return _drifted(track)


def _drifted(track: Track) -> Track:
    """The track with where its drift over ground will end: speed goes on falling at the rate of its last half second."""
    k = int(np.searchsorted(track.t_s, track.t_s[-1] - 0.5))
    now, before = math.hypot(*track.v_m_s[-1, :2].tolist()), math.hypot(*track.v_m_s[k, :2].tolist())
    if now < 0.05 or before <= now:
        return track
    rate = math.log(before / now) / float(track.t_s[-1] - track.t_s[k])
    end = track.p_m[-1] + np.array([*(track.v_m_s[-1, :2] / rate), 0.0])
    return Track(
        np.append(track.t_s, track.t_s[-1] + 3.0 / rate),
        np.vstack([track.p_m, end]),
        np.vstack([track.v_m_s, track.v_m_s[-1]]),
        track.reach_m,
    )


def _length(lead: tuple[Piece, ...]) -> float:
    return sum(piece.duration_s for piece in lead)


def useful_s(fitted: FittedCell, setting: Setting) -> float:
    """How much of the record is left after the delay, s; the whole record of a flight without a step."""
    delay = setting.predictor.delay_s if fitted.cell.kind != "free" else 0.0
    return recorded_s(fitted.lead) - delay


def recorded_s(lead: Sequence[Piece]) -> float:
    """Length of the record, s."""
    return sum(piece.duration_s for piece in lead if piece.record)


def _judge(fitted: FittedCell, setting: Setting) -> FittedCell:
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
    t = np.arange(0.0, _length(fitted.lead), GRID_S)
    hovers = setting.predictor.hover_throttle(np.array(setting.voltages_v)).tolist()
    asked = np.concatenate([sampled_targets(fitted.lead, hover, t)[:, 3] for hover in hovers])
    low, high = setting.throttle
    if asked.size and (asked.min() < low - 1e-9 or asked.max() > high + 1e-9):
        value = asked.min() if asked.min() < low - 1e-9 else asked.max()
        return replace(
            fitted,
            complaint=f"it asks for throttle {value:.2f}, outside the limits {low:g} to {high:g}",
            remedy="change the step or the limit",
        )
    return fitted
