"""Fly rows of pieces through the predictor: with the stops they need, and with the link lost at a given moment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flighttest.frames import G_M_S2
from flighttest.plan.model import FloatArray, PredictedMotion, Predictor, Snapshot
from flighttest.plan.outer_loop import Moving, OuterLoop, all_along
from flighttest.script.profiles import Piece, Timeline
from flighttest.script.profiles.timeline import at

BoolArray = NDArray[np.bool_]

# Durations that are searched for are multiples of this.
GRID_S = 0.02
# Below this the vehicle counts as standing: what is left is the reset's.
STANDING_M_S = 0.3
# What the supervisor stops with, times hover, against climbing and falling.
STOP_SHARES = (0.3, 1.8)
# How much later than thrust follows throttle it acts at most: telemetry's age, and the cycles of gate and supervisor.
REACTION_MARGIN_S = 0.1
# Longest stop that is looked for.
STOP_MAX_S = 4.0
# GUID_TIMEOUT as preflight demands it: how long the autopilot holds the last target once targets stop.
GUID_TIMEOUT_S = 0.2
# How ArduCopter's climb-rate-zero controller stops a climb: chosen so that 0.10 to 0.40 at 24.5 V with the
# link lost tops out 10 m above its start after 0.2 s of holding, 17.5 m after 0.5 s, 90 m after 3 s, as that firmware does.
LEVEL_OUT_GAIN_1_S = 2.0
LEVEL_OUT_MAX_M_S2 = 5.0


@dataclass(frozen=True)
class Row:
    """One vehicle to be flown: the pieces up to the end of the record, how it is stopped, where it starts.

    stops: 'counter' and 'vertical' in order; stop_throttle: (against climbing, against falling). lost_s: when the link is lost.
    """

    lead: tuple[Piece, ...]
    stops: tuple[str, ...]
    counter: Piece | None
    tail_s: float
    voltage_v: float
    stop_throttle: tuple[float, float]
    yaw_rad: float = 0.0
    start_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    waypoints: tuple[tuple[float, float, float, float], ...] = ()
    lost_s: float = math.inf
    of: Row | None = field(default=None, compare=False, repr=False)

    @cached_property
    def lead_s(self) -> float:
        """End of the record."""
        return sum(piece.duration_s for piece in self.lead)

    def losing_link_at(self, t_s: float) -> Row:
        """The same row with the link lost at t_s; `of` is the row it is like until then."""
        return replace(self, lost_s=t_s, of=self.of or self)

    @cached_property
    def straight(self) -> bool:
        """Whether it is only ever asked to go up and down."""
        turns = [(p.roll_rad, p.pitch_rad, p.yaw_rate_rad_s) for p in self.lead]
        return (
            not self.waypoints
            and "counter" not in self.stops
            and not any(wave != 0.0 for turn in turns for wave in turn)
        )


@dataclass(frozen=True)
class Rehearsal:
    """Motion of all rows, and how long each stop took: counter_s, vertical_s (n,), throttle of the vertical one (n,).

    reach_low_m, reach_high_m: (n, m) heights between which the vehicle stays if the supervisor stops it at that moment.
    """

    motion: PredictedMotion
    reach_low_m: FloatArray
    reach_high_m: FloatArray
    counter_s: FloatArray
    vertical_s: FloatArray
    vertical_throttle: FloatArray


def sampled_targets(pieces: Sequence[Piece], hover_throttle: float, t_s: FloatArray) -> FloatArray:
    """Targets (m, 4) of a row of pieces at rising times, level flight after the last."""
    return Timeline(tuple(pieces), hover_throttle).table(t_s)


def sample_all(rows: Sequence[Row], hover_throttle: FloatArray, t_s: FloatArray) -> FloatArray:
    """The same for the leads of n rows, each with its own hover throttle: (m, n, 4). Rows of constant pieces are looked up at once."""
    table = np.empty((t_s.size, len(rows), 4))
    plain: dict[int, list[int]] = {}
    for i, row in enumerate(rows):
        waves = (w for p in row.lead for w in (p.roll_rad, p.pitch_rad, p.yaw_rate_rad_s, p.throttle or 0.0))
        if all(isinstance(wave, (int, float)) for wave in waves):
            plain.setdefault(len(row.lead), []).append(i)
        else:
            table[:, i] = sampled_targets(row.lead, float(hover_throttle[i]), t_s)
    for pieces, members in plain.items():
        leads = [rows[i].lead for i in members]
        ends = np.cumsum([[p.duration_s for p in lead] for lead in leads], axis=1).reshape(len(members), pieces)
        turns = np.array([[(p.roll_rad, p.pitch_rad, p.yaw_rate_rad_s) for p in lead] for lead in leads], dtype=float)
        asked = np.array(
            [[math.nan if p.throttle is None else p.throttle for p in lead] for lead in leads], dtype=float
        )
        hover = hover_throttle[members][:, None]
        values = np.zeros((len(members), pieces + 1, 4))
        values[:, :pieces, :3] = turns.reshape(len(members), pieces, 3)
        values[..., 3] = hover / (np.cos(values[..., 0]) * np.cos(values[..., 1]))
        values[:, :pieces, 3] = np.where(np.isnan(asked), values[:, :pieces, 3], asked)
        index = (ends[None, :, :] <= t_s[:, None, None] + 1e-9).sum(axis=2)
        table[:, members] = values[np.arange(len(members))[None, :], index]
    return table


class StopPolicy:
    """What every row is sent at each moment, and the stops it has found so far.

    Rows may end one after the other, the last ones first: what is known of those that have ended stays as it is.
    """

    def __init__(self, rows: Sequence[Row], predictor: Predictor, steps: int, dt_s: float) -> None:
        n = len(rows)
        self.dt_s = dt_s
        voltage = np.array([row.voltage_v for row in rows])
        self.hover = np.asarray(predictor.hover_throttle(voltage), dtype=float)
        # A step longer than the grid of durations holds the mean of what is asked during it, so that no edge is rounded.
        fine = max(1, round(dt_s / GRID_S))
        longest = min(steps, math.ceil(max(row.lead_s for row in rows) / dt_s) + 1)
        t: FloatArray = np.arange((longest + 1) * fine, dtype=float) * (dt_s / fine)
        self.table: FloatArray = sample_all(rows, self.hover, t).reshape(-1, fine, n, 4).mean(axis=1)
        self.lead_end = np.array([row.lead_s for row in rows])
        self.lost = np.array([row.lost_s for row in rows])
        self.first_stop_s = float(min(self.lead_end.min(), self.lost.min())) - 1e-9
        self.floor = np.array([row.stop_throttle[0] for row in rows])
        self.ceiling = np.array([row.stop_throttle[1] for row in rows])
        self.counter = np.zeros((n, 2))
        for i, row in enumerate(rows):
            if row.counter is not None:
                self.counter[i] = at(row.counter.roll_rad, 0.0), at(row.counter.pitch_rad, 0.0)
        self.counter_hover = self.hover / np.prod(np.cos(self.counter), axis=1)
        self.counter_open: BoolArray = np.array(["counter" in row.stops and row.counter is not None for row in rows])
        self.vertical_open: BoolArray = np.array(["vertical" in row.stops for row in rows])
        self.counter_s = np.zeros(n)
        self.vertical_s = np.zeros(n)
        self.vertical_throttle = self.hover.copy()
        self.direction = np.zeros(n)
        # A command that ends now acts for this long, on the mean.
        self.attitude_ahead = predictor.delay_s + predictor.attitude_lag_s
        self.thrust_ahead = predictor.delay_s + predictor.thrust_lag_s
        self.before: FloatArray | None = None
        self.sent = np.tile(self.hover, (steps, 1))
        self.last = self.table[0].copy()
        self.steered = np.array([i for i, row in enumerate(rows) if row.waypoints], dtype=np.intp)
        # Goals and their speeds: (steps, rows with a path, 3) each.
        times: FloatArray = np.arange(steps, dtype=float) * dt_s
        goals = [all_along(rows[i].waypoints, times) for i in self.steered]
        self.goals = [np.stack(part, axis=1) for part in zip(*goals, strict=True)]
        self.yaw = np.array([row.yaw_rad for row in rows])
        self.climb_before = np.zeros(n)
        self.speed_before = np.zeros(n)
        self.loop = OuterLoop()

    def __call__(self, now: Snapshot) -> FloatArray:
        """Targets (n, 4) of the rows that still fly."""
        k, n = round(now.t_s / self.dt_s), len(now.p_m)
        targets: FloatArray = self.table[min(k, len(self.table) - 1), :n].copy()
        if self.steered.size:
            self._steer(k, now, targets)
        if now.t_s >= self.first_stop_s:
            v_before = now.v_m_s if self.before is None else self.before[:n]
            a = (now.v_m_s - v_before) / self.dt_s
            active = (now.t_s > self.lead_end[:n] - 1e-9) & (now.t_s < self.lost[:n] - 1e-9)
            if active.any():
                self._stop(now, a, active, targets)
            self._lose(now, targets)
        self.before = now.v_m_s
        self.last = targets
        self.sent[k, :n] = targets[:, 3]
        return targets

    def _lose(self, now: Snapshot, targets: FloatArray) -> None:
        n = len(targets)
        gone = now.t_s >= self.lost[:n] - 1e-9
        if gone.any():
            level = now.t_s >= self.lost[:n] + GUID_TIMEOUT_S - 1e-9
            held = gone & ~level
            targets[held] = self.last[:n][held]
            targets[level] = levelled(now.v_m_s[level, 2], self.hover[:n][level])

    def _steer(self, k: int, now: Snapshot, targets: FloatArray) -> None:
        still = int(np.searchsorted(self.steered, len(targets)))
        if still:
            i, (goal, goal_v) = self.steered[:still], (part[k, :still] for part in self.goals)
            targets[i] = self.loop.steer(
                Moving(now.p_m[i], now.v_m_s[i], now.rpy_rad[i, 2]), Moving(goal, goal_v, self.yaw[i]), self.hover[i]
            )

    def _stop(self, now: Snapshot, a: FloatArray, active: BoolArray, targets: FloatArray) -> None:
        n = len(targets)
        counter_open, vertical_open = self.counter_open[:n], self.vertical_open[:n]
        if counter_open.any():
            self._counter(now, a, active, targets)
        if not vertical_open.any():
            return
        vertical_s, direction, throttle = self.vertical_s[:n], self.direction[:n], self.vertical_throttle[:n]
        climb = now.v_m_s[:, 2] + a[:, 2] * self.thrust_ahead
        todo = active & vertical_open & ~counter_open
        fresh = todo & (direction == 0.0)
        if fresh.any():
            direction[fresh] = np.sign(climb[fresh])
            throttle[fresh] = np.where(climb[fresh] > 0.0, self.floor[:n][fresh], self.ceiling[:n][fresh])
        slow = fresh & (np.abs(climb) < STANDING_M_S)
        turned = todo & ~fresh & (climb * direction <= 0.0)
        if turned.any():
            vertical_s[turned] -= self._overdone(vertical_s, climb, self.climb_before[:n])[turned]
        self.climb_before[:n] = climb
        vertical_open &= ~slow & ~turned & ~(vertical_s > STOP_MAX_S)
        doing = todo & vertical_open
        vertical_s[doing] += self.dt_s
        targets[doing] = 0.0
        targets[doing, 3] = throttle[doing]

    def _counter(self, now: Snapshot, a: FloatArray, active: BoolArray, targets: FloatArray) -> None:
        # Along the counter's push: pitch pushes forward, roll to the right; the vehicle moves the other way.
        n = len(targets)
        counter, counter_s, counter_open = self.counter[:n], self.counter_s[:n], self.counter_open[:n]
        yaw = now.rpy_rad[:, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        forward_left = np.stack([[c, s], [-s, c]])  # (2, 2, n)
        push = np.stack([np.sin(counter[:, 1]), -np.sin(counter[:, 0])])
        scale = np.maximum(np.abs(push).sum(axis=0), 1e-9)

        def against(vector: FloatArray) -> FloatArray:
            body = np.einsum("ijn,jn->in", forward_left, vector[:, :2].T)
            return np.asarray(-(body * push).sum(axis=0) / scale)

        speed = against(now.v_m_s) + against(a) * self.attitude_ahead
        todo = active & counter_open
        turned = todo & ~(speed > 0.0)
        if turned.any():
            counter_s[turned] -= self._overdone(counter_s, speed, self.speed_before[:n])[turned]
        self.speed_before[:n] = speed
        counter_open &= ~turned & ~(counter_s > STOP_MAX_S)
        doing = todo & counter_open
        counter_s[doing] += self.dt_s
        targets[doing] = 0.0
        targets[doing, 0], targets[doing, 1] = counter[doing, 0], counter[doing, 1]
        targets[doing, 3] = self.counter_hover[:n][doing]

    def _overdone(self, lasted_s: FloatArray, now: FloatArray, before: FloatArray) -> FloatArray:
        """How much of the last step lay beyond the moment the speed passed through zero, s; none of a stop that never began."""
        share = np.clip(np.abs(now) / np.maximum(np.abs(now) + np.abs(before), 1e-9), 0.0, 1.0)
        return np.where(lasted_s > 0.0, np.minimum(lasted_s, self.dt_s * share), 0.0)


def levelled(climb_m_s: FloatArray, hover_throttle: FloatArray) -> FloatArray:
    """Targets (n, 4) of an autopilot that has given up waiting: level, and no more climbing or falling."""
    wanted = np.clip(-LEVEL_OUT_GAIN_1_S * climb_m_s, -LEVEL_OUT_MAX_M_S2, LEVEL_OUT_MAX_M_S2)
    targets = np.zeros((climb_m_s.size, 4))
    targets[:, 3] = hover_throttle * (1.0 + wanted / G_M_S2)
    return targets


def steps_of(rows: Sequence[Row], predictor: Predictor, dt_s: float, after_s: float | None) -> int:
    """How many steps the row that takes longest needs: its stops and tail, or `after_s` beyond its record or loss of link."""
    spare = after_s if after_s is not None else max(row.tail_s for row in rows) + 2.5
    duration = max(min(row.lead_s, row.lost_s) for row in rows) + spare + predictor.delay_s
    return math.ceil(duration / dt_s)


def rehearse(rows: Sequence[Row], predictor: Predictor, dt_s: float, after_s: float | None = None) -> Rehearsal:
    """Fly all rows for as long as the longest needs (see `steps_of`), each from its start: the plain way. `plan.batched` shares work."""
    steps = steps_of(rows, predictor, dt_s, after_s)
    policy = StopPolicy(rows, predictor, steps, dt_s)
    motion = predictor.fly(
        np.array([row.start_m for row in rows], dtype=float),
        np.array([row.yaw_rad for row in rows], dtype=float),
        np.array([row.voltage_v for row in rows], dtype=float),
        policy,
        steps * dt_s,
        dt_s,
    )
    low, high = reach(motion, policy.sent.T, policy.hover, reaction_s(predictor))
    return Rehearsal(motion, low, high, policy.counter_s, policy.vertical_s, policy.vertical_throttle)


def reaction_s(predictor: Predictor) -> float:
    """From a bad sample to the mean effect of the stop that answers it, s: 0.25 for the paper's vehicle."""
    return round(predictor.delay_s + predictor.thrust_lag_s + REACTION_MARGIN_S, 2)


def reach(
    motion: PredictedMotion, throttle: FloatArray, hover: FloatArray, reaction: float
) -> tuple[FloatArray, FloatArray]:
    """What the gate (`flight.gate`) foresees: this throttle for the reaction time, then the supervisor's stop. (n, m) each."""
    z, v = motion.p_m[:, :, 2], motion.v_m_s[:, :, 2]
    asked = np.column_stack([throttle, throttle[:, -1:]])[:, : z.shape[1]]
    low, high = z, z
    # A step ends between two samples: at each, what was asked until now counts as well as what is asked from now on.
    for throttles in (asked, np.column_stack([asked[:, :1], asked[:, :-1]])):
        push = G_M_S2 * (throttles / hover[:, None] - 1.0)
        then = v + push * reaction
        h = z + v * reaction + 0.5 * push * reaction**2
        stop_m_s2 = G_M_S2 * np.where(then > 0.0, 1.0 - STOP_SHARES[0], STOP_SHARES[1] - 1.0)
        end = h + then * np.abs(then) / (2.0 * stop_m_s2)
        low, high = np.minimum(low, np.minimum(h, end)), np.maximum(high, np.maximum(h, end))
    return low, high
