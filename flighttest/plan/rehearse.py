"""Fly rows of pieces through the predictor: with the stops they need, and with the link lost at a given moment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.plan.model import FloatArray, Motion, Predictor, Snapshot
from flighttest.plan.outer_loop import OuterLoop, along
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

    @property
    def lead_s(self) -> float:
        """End of the record."""
        return sum(piece.duration_s for piece in self.lead)

    def losing_link_at(self, t_s: float) -> Row:
        """The same row with the link lost at t_s."""
        return replace(self, lost_s=t_s)


@dataclass(frozen=True)
class Rehearsal:
    """Motion of all rows, and how long each stop took: counter_s, vertical_s (n,), throttle of the vertical one (n,).

    reach_low_m, reach_high_m: (n, m) heights between which the vehicle stays if the supervisor stops it at that moment.
    """

    motion: Motion
    reach_low_m: FloatArray
    reach_high_m: FloatArray
    counter_s: FloatArray
    vertical_s: FloatArray
    vertical_throttle: FloatArray


def sample(pieces: Sequence[Piece], hover_throttle: float, t_s: FloatArray) -> FloatArray:
    """Targets (m, 4) of a row of pieces at rising times, level flight after the last."""
    return Timeline(tuple(pieces), hover_throttle).table(t_s)


class _Policy:
    """What every row is sent at each moment, and the stops it has found so far."""

    def __init__(self, rows: Sequence[Row], predictor: Predictor, duration_s: float, dt_s: float) -> None:
        n = len(rows)
        self.dt_s = dt_s
        voltage = np.array([row.voltage_v for row in rows])
        self.hover = np.asarray(predictor.hover_throttle(voltage), dtype=float)
        # A step longer than the grid of durations holds the mean of what is asked during it, so that no edge is rounded.
        fine = max(1, round(dt_s / GRID_S))
        t: FloatArray = np.arange((round(duration_s / dt_s) + 1) * fine, dtype=float) * (dt_s / fine)
        hovers: list[float] = self.hover.tolist()
        table = np.stack([sample(row.lead, hover, t) for row, hover in zip(rows, hovers, strict=True)])
        self.table: FloatArray = table.reshape(n, -1, fine, 4).mean(axis=2)
        self.lead_end = np.array([row.lead_s for row in rows])
        self.lost = np.array([row.lost_s for row in rows])
        self.floor = np.array([row.stop_throttle[0] for row in rows])
        self.ceiling = np.array([row.stop_throttle[1] for row in rows])
        has_counter = np.array(["counter" in row.stops and row.counter is not None for row in rows])
        self.counter = np.zeros((n, 2))
        for i, row in enumerate(rows):
            if row.counter is not None:
                self.counter[i] = at(row.counter.roll_rad, 0.0), at(row.counter.pitch_rad, 0.0)
        self.counter_hover = self.hover / np.prod(np.cos(self.counter), axis=1)
        self.counter_open: BoolArray = has_counter
        self.vertical_open: BoolArray = np.array(["vertical" in row.stops for row in rows])
        self.counter_s = np.zeros(n)
        self.vertical_s = np.zeros(n)
        self.vertical_throttle = self.hover.copy()
        self.direction = np.zeros(n)
        # A command that ends now acts for this long, on the mean.
        self.attitude_ahead = predictor.delay_s + predictor.attitude_lag_s
        self.thrust_ahead = predictor.delay_s + predictor.thrust_lag_s
        self.before: FloatArray | None = None
        self.sent: list[FloatArray] = []
        self.last = self.table[:, 0].copy()
        paths: dict[tuple[tuple[float, float, float, float], ...], list[int]] = {}
        for i, row in enumerate(rows):
            if row.waypoints:
                paths.setdefault(row.waypoints, []).append(i)
        self.paths = paths
        self.yaw = np.array([row.yaw_rad for row in rows])
        self.climb_before = np.zeros(n)
        self.speed_before = np.zeros(n)
        self.loop = OuterLoop()

    def __call__(self, now: Snapshot) -> FloatArray:
        k = min(round(now.t_s / self.dt_s), self.table.shape[1] - 1)
        targets: FloatArray = self.table[:, k].copy()
        if self.paths:
            self._steer(now, targets)
        a = np.zeros_like(now.v_m_s) if self.before is None else (now.v_m_s - self.before) / self.dt_s
        self.before = now.v_m_s.copy()
        past = now.t_s > self.lead_end - 1e-9
        active = past & (now.t_s < self.lost - 1e-9)
        if bool(np.any(active)):
            self._stop(now, a, active, targets)
        held = (now.t_s >= self.lost - 1e-9) & (now.t_s < self.lost + GUID_TIMEOUT_S - 1e-9)
        targets[held] = self.last[held]
        level = now.t_s >= self.lost + GUID_TIMEOUT_S - 1e-9
        if bool(np.any(level)):
            wanted = np.clip(-LEVEL_OUT_GAIN_1_S * now.v_m_s[:, 2], -LEVEL_OUT_MAX_M_S2, LEVEL_OUT_MAX_M_S2)
            targets[level] = 0.0
            targets[level, 3] = (self.hover * (1.0 + wanted / 9.81))[level]
        self.last = targets
        self.sent.append(targets[:, 3].copy())
        return targets

    def _steer(self, now: Snapshot, targets: FloatArray) -> None:
        for path, i in self.paths.items():
            goal, goal_v = along(path, now.t_s)
            targets[i] = self.loop.steer(
                now.p_m[i], now.v_m_s[i], now.rpy_rad[i, 2], goal, goal_v, self.yaw[i], self.hover[i]
            )

    def _stop(self, now: Snapshot, a: FloatArray, active: BoolArray, targets: FloatArray) -> None:
        if bool(np.any(self.counter_open)):
            self._counter(now, a, active, targets)
        if not bool(np.any(self.vertical_open)):
            return
        climb = now.v_m_s[:, 2] + a[:, 2] * self.thrust_ahead
        todo = active & self.vertical_open & ~self.counter_open
        fresh = todo & (self.direction == 0.0)
        self.direction[fresh] = np.sign(climb[fresh])
        self.vertical_throttle[fresh] = np.where(climb[fresh] > 0.0, self.floor[fresh], self.ceiling[fresh])
        slow = fresh & (np.abs(climb) < STANDING_M_S)
        turned = todo & ~fresh & (climb * self.direction <= 0.0)
        self.vertical_s -= np.where(turned, self._overdone(self.vertical_s, climb, self.climb_before), 0.0)
        self.climb_before = climb
        self.vertical_open = self.vertical_open & ~slow & ~turned & ~(self.vertical_s > STOP_MAX_S)
        doing = todo & self.vertical_open
        self.vertical_s[doing] += self.dt_s
        targets[doing] = 0.0
        targets[doing, 3] = self.vertical_throttle[doing]

    def _counter(self, now: Snapshot, a: FloatArray, active: BoolArray, targets: FloatArray) -> None:
        # Along the counter's push: pitch pushes forward, roll to the right; the vehicle moves the other way.
        yaw = now.rpy_rad[:, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        forward_left = np.stack([[c, s], [-s, c]])  # (2, 2, n)
        push = np.stack([np.sin(self.counter[:, 1]), -np.sin(self.counter[:, 0])])
        scale = np.maximum(np.abs(push).sum(axis=0), 1e-9)

        def against(vector: FloatArray) -> FloatArray:
            body = np.einsum("ijn,jn->in", forward_left, vector[:, :2].T)
            return np.asarray(-(body * push).sum(axis=0) / scale)

        speed = against(now.v_m_s) + against(a) * self.attitude_ahead
        todo = active & self.counter_open
        moving = speed > 0.0
        self.counter_s -= np.where(todo & ~moving, self._overdone(self.counter_s, speed, self.speed_before), 0.0)
        self.speed_before = speed
        self.counter_open = self.counter_open & ~(todo & ~moving) & ~(self.counter_s > STOP_MAX_S)
        doing = todo & self.counter_open
        self.counter_s[doing] += self.dt_s
        targets[doing] = 0.0
        targets[doing, 0], targets[doing, 1] = self.counter[doing, 0], self.counter[doing, 1]
        targets[doing, 3] = self.counter_hover[doing]

    def _overdone(self, lasted_s: FloatArray, now: FloatArray, before: FloatArray) -> FloatArray:
        """How much of the last step lay beyond the moment the speed passed through zero, s; none of a stop that never began."""
        share = np.clip(np.abs(now) / np.maximum(np.abs(now) + np.abs(before), 1e-9), 0.0, 1.0)
        return np.where(lasted_s > 0.0, np.minimum(lasted_s, self.dt_s * share), 0.0)


def rehearse(rows: Sequence[Row], predictor: Predictor, dt_s: float, after_s: float | None = None) -> Rehearsal:
    """Fly all rows for as long as the longest needs: its stops and tail, or `after_s` beyond its record or loss of link."""
    spare = after_s if after_s is not None else max(row.tail_s for row in rows) + 2.5
    ends = [min(row.lead_s, row.lost_s) for row in rows]
    duration = max(ends) + spare + predictor.delay_s
    duration = math.ceil(duration / dt_s) * dt_s
    policy = _Policy(rows, predictor, duration, dt_s)
    motion = predictor.fly(
        np.array([row.start_m for row in rows], dtype=float),
        np.array([row.yaw_rad for row in rows], dtype=float),
        np.array([row.voltage_v for row in rows], dtype=float),
        policy,
        duration,
        dt_s,
    )
    low, high = _reach(motion, np.stack(policy.sent, axis=1), policy.hover, reaction_s(predictor))
    return Rehearsal(motion, low, high, policy.counter_s, policy.vertical_s, policy.vertical_throttle)


def reaction_s(predictor: Predictor) -> float:
    """From a bad sample to the mean effect of the stop that answers it, s: 0.25 for the paper's vehicle."""
    return round(predictor.delay_s + predictor.thrust_lag_s + REACTION_MARGIN_S, 2)


def _reach(motion: Motion, throttle: FloatArray, hover: FloatArray, reaction: float) -> tuple[FloatArray, FloatArray]:
    """What the gate foresees (see `flight.gate`): this throttle for the reaction time, then the supervisor's stop. (n, m) each."""
    z, v = motion.p_m[:, :, 2], motion.v_m_s[:, :, 2]
    asked = np.column_stack([throttle, throttle[:, -1:]])[:, : z.shape[1]]
    low, high = z, z
    # A step ends between two samples: at each, what was asked until now counts as well as what is asked from now on.
    for throttles in (asked, np.column_stack([asked[:, :1], asked[:, :-1]])):
        push = 9.81 * (throttles / hover[:, None] - 1.0)
        then = v + push * reaction
        h = z + v * reaction + 0.5 * push * reaction**2
        stop_m_s2 = 9.81 * np.where(then > 0.0, 1.0 - STOP_SHARES[0], STOP_SHARES[1] - 1.0)
        end = h + then * np.abs(then) / (2.0 * stop_m_s2)
        low, high = np.minimum(low, np.minimum(h, end)), np.maximum(high, np.maximum(h, end))
    return low, high
