"""Segments made ready for a block: measured signals filled in, references as edges, nodes merged for a given delay."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS, HELD_GROUPS
from flighttest.estimation.interpolation import angles_between_samples, between_samples, filled
from flighttest.physics.blocks import TRIMMED, Block
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Longer pieces are split. The step resolves the fastest pole of the block: RK4 then errs by less than 3e-5 in any parameter,
# which is a tenth of the standard error of the best known one (a damping ratio in a full campaign).
MAX_STEP_S = 0.0251
STEP_OF_POLE = {"translation": 1.0, "attitude": 0.25}  # step x pole (1/s), at most
# Numbers of nodes are rounded up to one of these, so that responses of like length are integrated together.
_BUCKETS = (32, 48, 64, 96, 128, 160, 208, 256, 320, 416, 512, 640, 832, 1024)
NO_GROUND_M = 1e3  # height where none was recorded: no ground effect
_ATTITUDE = frozenset({"roll_rad", "pitch_rad", "target_roll_rad", "target_pitch_rad"})
_TURNING = frozenset(f"{axis}{unit}" for axis in "pqr" for unit in ("_rad_s", "_dot_rad_s2"))
_ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
HORIZONTAL = frozenset({"f_x_m_s2", "f_y_m_s2", "v_x_m_s", "v_y_m_s", "a_x_m_s2", "a_y_m_s2"})
# How far an initial state may lie from its measurement, and from zero where it is not measured.
_START_STD = {
    "v_x_m_s": (0.5, 3.0), "v_y_m_s": (0.5, 3.0), "v_z_m_s": (0.5, 3.0), "a_t_m_s2": (5.0, 10.0), "roll_rad": (0.1, 0.3),
    "pitch_rad": (0.1, 0.3), "roll_rate_rad_s": (1.0, 1.0), "pitch_rate_rad_s": (1.0, 1.0), "r_rad_s": (0.5, 1.0),
}  # fmt: skip


@dataclass(frozen=True)
class Response:
    """One segment as one block sees it.

    index: position in the problem's segments; t_s: (n,); y: (n, n_outputs), NaN where not measured; edges_s: (m,) times of
    changes, values: (m, n_inputs) from each edge on; e: (n, n_exogenous); start, start_std: of the free initial states.
    """

    index: int
    t_s: FloatArray
    y: FloatArray
    edges_s: FloatArray
    values: FloatArray
    e: FloatArray
    start: FloatArray
    start_std: FloatArray


def attitude_is_known(segment: Segment) -> bool:
    """Whether roll and pitch were measured."""
    return all(np.isfinite(segment.y.get(name, np.nan)).any() for name in ("roll_rad", "pitch_rad"))


def zero_order_hold(edges: tuple[FloatArray, FloatArray] | None, t: FloatArray, default: float = 0.0) -> FloatArray:
    """A reference at times `t`; its first value before its first edge."""
    if edges is None or not len(edges[0]):
        return np.full(t.shape, default)
    times, values = edges
    at = np.clip(np.searchsorted(times, t, side="right") - 1, 0, None)
    return np.asarray(values[at], dtype=float)


def dead_channels(segments: Sequence[Segment]) -> tuple[str, ...]:
    """Channels recorded with one and the same value throughout: a column that somebody filled in, not a measurement."""
    found = []
    commands = {name for name, channel in CHANNELS.items() if channel.group in HELD_GROUPS}
    measured = {c for s in segments for c in s.y if not c.startswith("a_")} - commands
    for name in sorted(measured):
        every = np.concatenate([s.y[name][np.isfinite(s.y[name])] for s in segments if name in s.y])
        if every.size > 1 and not np.ptp(every):
            found.append(name)
    return tuple(found)


def never_changing(channels: Sequence[str]) -> str:
    """Dead channels in words."""
    shown = ", ".join(channels[:6]) + (f" and {len(channels) - 6} more" if len(channels) > 6 else "")
    return f"{shown} never change{'s' if len(channels) == 1 else ''} in any sample, as no measurement does"


def outputs_of(
    segments: Sequence[Segment], members: Sequence[int], block: Block, dead: Sequence[str]
) -> tuple[str, ...]:
    """Channels of the block measured in any of its segments; world acceleration only where there is no accelerometer."""
    alive = [c for c in block.outputs if c not in dead]
    if {"f_x_m_s2", "f_y_m_s2", "f_z_m_s2"} <= set(dead):
        alive = [c for c in alive if not c.startswith("a_")]
    seen = {c for i in members for c in alive if c in segments[i].y and np.isfinite(segments[i].y[c]).any()}
    if members and all(any(c in segments[i].y for c in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")) for i in members):
        seen = {c for c in seen if not c.startswith("a_")}
    return tuple(c for c in block.outputs if c in seen)


def exogenous(segment: Segment, name: str, nominal_voltage_v: float, attitude_delay_s: float) -> FloatArray:
    """One measured signal (`physics.blocks.EXOGENOUS`) at the segment's times; angles unwrapped."""
    key = (
        name,
        nominal_voltage_v if name == "voltage_v" else 0.0,
        attitude_delay_s if name.startswith("target_") else 0.0,
    )
    return segment.once(key, lambda: _exogenous(segment, name, nominal_voltage_v, attitude_delay_s))


def _exogenous(segment: Segment, name: str, nominal_voltage_v: float, attitude_delay_s: float) -> FloatArray:
    t, y = segment.t_s, segment.y
    if name == "voltage_v":
        return _voltage(segment, nominal_voltage_v)
    if name == "height_m":
        return filled(t, y.get("height_m", y.get("p_z_m")), NO_GROUND_M)
    if name == "time_s":
        return segment.since_takeoff_s
    if name == "relative_thrust":
        return relative_thrust(segment)
    if name in TRIMMED:
        return np.full(t.shape, segment.context.trimmed_m_s[TRIMMED.index(name)])
    if name.startswith("target_"):
        axis = name.split("_")[1]
        shaped = y.get(f"{axis}_shaped_rad")
        if shaped is not None and np.isfinite(shaped).any():
            return filled(t, shaped, 0.0)
        if f"{axis}_ref_rad" in segment.u:
            return zero_order_hold(segment.u[f"{axis}_ref_rad"], t - attitude_delay_s)
        return exogenous(segment, f"{axis}_rad", nominal_voltage_v, attitude_delay_s)
    if name in _TURNING:
        return rotation_at(segment, name)
    if name in _ANGLES:
        return attitude_angles(segment)[:, _ANGLES.index(name)]
    return filled(t, y.get(name), 0.0)


def attitude_angles(segment: Segment) -> FloatArray:
    """(n, 3) roll, pitch, yaw, rad, at every sample; 0 where one was not measured, yaw without jumps."""
    return segment.once("attitude", lambda: _attitude(segment))


def _attitude(segment: Segment) -> FloatArray:
    y, missing = segment.y, np.full(segment.t_s.shape, np.nan)
    rates = np.stack([exogenous(segment, f"{axis}_rad_s", 0.0, 0.0) for axis in "pqr"], axis=1)
    return angles_between_samples(segment.t_s, np.stack([y.get(n, missing) for n in _ANGLES], axis=1), rates)


def rotation_at(segment: Segment, name: str, seen_by: str = "") -> FloatArray:
    """An angular velocity, rad/s, or acceleration, rad/s^2 (n,), at its time, which a known filter of the gyroscope makes late; seen_by: as
    late as the known filter of this channel group makes it.

    Left late, a rotation would have the accelerometer's filter beside the gyroscope's. An IMU 0.1 m above the centre, added to three parts
    of a log with filters of 20 and 40 Hz, was found 0.095 to 0.101 m above, +- 0.003 to 0.011, and is 0.097 to 0.103, +- 0.001 to 0.006.
    """
    order = int(name.endswith("_dot_rad_s2"))
    t, rate = segment.t_s, filled(segment.t_s, segment.y.get(name.replace("_dot_rad_s2", "_rad_s")), 0.0)
    if t.size < 2:
        return np.zeros_like(t) if order else rate
    from scipy.interpolate import CubicSpline  # a fifth of a second, which what only plans need not wait for

    # A spline: differences of neighbours blur an angular acceleration that jumps, as after a step, by several percent.
    late_s = _lag_s(segment, "rates") - _lag_s(segment, seen_by)
    return np.asarray(CubicSpline(t, rate)(np.clip(t + late_s, t[0], t[-1]), order))


def _lag_s(segment: Segment, group: str) -> float:
    """Of the known second-order low-pass filter of a channel group, s; 0 where none is known."""
    cutoff = float(segment.context.filters.get(group, 0.0))
    return math.sqrt(2.0) / (2.0 * math.pi * cutoff) if cutoff > 0 else 0.0


def relative_thrust(segment: Segment) -> FloatArray:
    """(n,) throttle over that of hover: thrust over weight of a thrust curve that is a line; 1 where either is not known."""
    hover = segment.context.hover_throttle
    if not hover or "throttle" not in segment.u:
        return np.ones(segment.t_s.size)
    return zero_order_hold(segment.u["throttle"], segment.t_s) / hover


def _voltage(segment: Segment, nominal_voltage_v: float) -> FloatArray:
    """Battery voltage (n,), V: as measured, and between the samples of a slow monitor as the load has it."""
    t, y = segment.t_s, segment.y
    chord = filled(t, y.get("voltage_v"), nominal_voltage_v)
    samples, force = segment.context.voltage_samples, y.get("f_z_m_s2")
    if samples is None or force is None or not np.isfinite(force).any():
        return chord
    return between_samples(t, chord, samples, filled(t, force, 0.0), _lag_s(segment, "specific_force"))


def merged_edges(segment: Segment, inputs: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Times at which any of the inputs changes (m,), and all inputs from then on (m, n)."""
    return segment.once(("edges", tuple(inputs)), lambda: _merged_edges(segment, inputs))


def _merged_edges(segment: Segment, inputs: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    parts = [segment.u[n][0] for n in inputs if n in segment.u]
    times = np.unique(np.concatenate(parts)) if parts else np.array([segment.t_s[0] - 1.0])
    values = (
        np.stack([zero_order_hold(segment.u.get(n), times) for n in inputs], axis=1)
        if inputs
        else np.empty((times.size, 0))
    )
    keep = np.ones(times.size, dtype=bool)
    keep[1:] = np.any(np.diff(values, axis=0) != 0.0, axis=1)
    return times[keep], values[keep]


def prepare(
    segment: Segment,
    index: int,
    block: Block,
    outputs: Sequence[str],
    nominal_voltage_v: float,
    attitude_delay_s: float,
    hover_throttle_gain: float,
) -> Response:
    """One segment for one block. hover_throttle_gain: m/s^2 per throttle, for a_t(0) where f_z was not measured."""
    t, n = segment.t_s, segment.t_s.size
    missing = np.full(n, np.nan)
    y = np.stack([segment.y.get(name, missing) for name in outputs], axis=1).astype(float)
    has_force = any(np.isfinite(segment.y.get(c, missing)).any() for c in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"))
    for i, name in enumerate(outputs):
        if has_force and name.startswith("a_"):  # world acceleration is derived from f: the same sample twice
            y[:, i] = np.nan
    level = block.name == "translation" and not attitude_is_known(segment)
    if level:
        y[:, [i for i, name in enumerate(outputs) if name in HORIZONTAL]] = np.nan
    start, std = _start(segment, block, hover_throttle_gain)
    edges_s, values = merged_edges(segment, block.inputs)
    e = np.stack([exogenous(segment, name, nominal_voltage_v, attitude_delay_s) for name in block.exogenous], axis=1) \
        if block.exogenous else np.empty((n, 0))  # fmt: skip
    if level:
        # Half an attitude would turn horizontal motion, which is not compared, into a vertical one that anything can be explained by.
        e[:, [i for i, name in enumerate(block.exogenous) if name in _ATTITUDE]] = 0.0
    return Response(index, t, y, edges_s, values, e, start, std)


def _start(segment: Segment, block: Block, gain: float) -> tuple[FloatArray, FloatArray]:
    """Measured initial states and how far the truth may lie from them."""
    start, std = np.zeros(len(block.free_states)), np.zeros(len(block.free_states))
    for i, name in enumerate(block.free_states):
        channel = "f_z_m_s2" if name == "a_t_m_s2" else name
        first = segment.y.get(channel, np.empty(0))[:4]
        first = first[np.isfinite(first)]
        own = block.spread.get(name, 1.0)
        known, unknown = _START_STD.get(name, (own, own))
        if first.size:
            start[i], std[i] = float(first.mean()), known
        elif name == "a_t_m_s2":
            start[i], std[i] = gain * float(zero_order_hold(segment.u.get("throttle"), segment.t_s[:1])[0]), unknown
        else:
            start[i], std[i] = 0.0, unknown
    return start, std


def max_step_s(block: Block, values: Mapping[str, float]) -> float:
    """The longest step that resolves a block's lags at these parameters: 25 ms or a whole fraction of it."""
    if block.name == "translation":
        pole = values.get("sigma_t", 20.0) / STEP_OF_POLE["translation"]
    else:
        poles = [values[n] for n in ("omega_phi", "omega_theta", "sigma_r") if n in block.params]
        pole = max(poles, default=20.0) / STEP_OF_POLE["attitude"]
    return MAX_STEP_S / float(min(max(np.ceil(MAX_STEP_S * pole), 1.0), 8.0))


@dataclass(frozen=True)
class Nodes:
    """Nodes of m responses, one response after the other.

    rows (N, n_data): [h, u, e start, e end]; first (m + 1,): where each response begins; sample (n_samples,): node of each sample;
    first_sample (m + 1,): where the samples of each response begin.
    """

    rows: FloatArray
    first: IndexArray
    sample: IndexArray
    first_sample: IndexArray

    @cached_property
    def target(self) -> IndexArray:
        """(N,) sample of its response that a node is, -1 for none."""
        found = np.full(len(self.rows), -1)
        found[self.sample] = _within(self.first_sample)
        return found

    @cached_property
    def padded(self) -> list[tuple[IndexArray, FloatArray, list[IndexArray]]]:
        """Responses of like length together: (which (k,), nodes (k, n, n_data), node of each sample of each). A shorter one stays where it
        ends."""
        lengths = np.diff(self.first)
        buckets = np.array([node_bucket(int(n)) for n in lengths])
        found = []
        for bucket in dict.fromkeys(buckets.tolist()):
            which = np.flatnonzero(buckets == bucket)
            at = np.minimum(np.arange(bucket), lengths[which, None] - 1)
            stacked = self.rows[self.first[which, None] + at]
            stacked[np.arange(bucket) >= lengths[which, None], 0] = 0.0
            stacked.flags.writeable = False
            ends = zip(self.first_sample[which], self.first_sample[which + 1], self.first[which], strict=True)
            found.append((which, stacked, [self.sample[a:b] - begin for a, b, begin in ends]))
        return found


@dataclass(frozen=True)
class Stacked:
    """The samples and edges of m responses, one response after the other, of which nodes are made."""

    t_s: FloatArray
    e: FloatArray
    edges_s: FloatArray
    values: FloatArray
    first_sample: IndexArray
    first_edge: IndexArray

    @classmethod
    def of(cls, responses: Sequence[Response]) -> Stacked:
        """Of one block."""
        t, e, edges, values = ([getattr(r, k) for r in responses] for k in ("t_s", "e", "edges_s", "values"))
        samples, changes = (np.cumsum([0, *(len(one) for one in some)]) for some in (t, edges))
        joined = [np.concatenate(some) for some in (t, e, edges, values)]
        return cls(joined[0], joined[1], joined[2], joined[3], samples, changes)

    def nodes(self, delay_s: float, step_s: float = MAX_STEP_S) -> Nodes:
        """For a delay. The piece of a row ends at its node."""
        of_sample, of_edge = (
            np.repeat(np.arange(first.size - 1), np.diff(first)) for first in (self.first_sample, self.first_edge)
        )
        moved = self.edges_s + delay_s
        begins, ends = self.t_s[self.first_sample[:-1]], self.t_s[self.first_sample[1:] - 1]
        inside = (moved > begins[of_edge]) & (moved < ends[of_edge])
        times, of = np.concatenate([self.t_s, moved[inside]]), np.concatenate([of_sample, of_edge[inside]])
        order = np.lexsort((times, of))
        times, of = times[order], of[order]
        is_edge = order >= self.t_s.size
        sample = np.flatnonzero(~is_edge)
        begin = sample[self.first_sample[:-1]]

        h = np.diff(times, prepend=times[0])
        h[begin] = 0.0
        e = self._interpolated(times, is_edge)
        # Counted, not looked up: an edge that falls on a sample time still parts an old input from a new one.
        earlier = np.bincount(of_edge[moved <= begins[of_edge]], minlength=begin.size)
        passed: IndexArray = np.cumsum(is_edge) - is_edge
        passed -= passed[begin][of]
        last = np.diff(self.first_edge) - 1
        at = self.first_edge[of] + np.clip(earlier[of] - 1 + passed, 0, last[of])
        before = np.maximum(np.arange(times.size) - 1, begin[of])
        pieces = np.maximum(1, np.ceil(h / step_s - 1e-6)).astype(int)
        if pieces.max(initial=1) > 1:
            which, after = np.repeat(np.arange(times.size), pieces), np.cumsum(pieces)
            share = (np.arange(which.size) - (after - pieces)[which])[:, None]
            a, b = share / pieces[which, None], (share + 1) / pieces[which, None]
            old, new = e[before][which], e[which]
            e0, e1 = old * (1 - a) + new * a, old * (1 - b) + new * b
            h, at = (h / pieces)[which], at[which]
            sample, begin = after[sample] - 1, after[begin] - 1
        else:
            e0, e1 = e[before], e
        rows = np.concatenate([h[:, None], self.values[at], e0, e1], axis=1)
        return Nodes(rows, np.append(begin, len(rows)), sample, self.first_sample)

    def _interpolated(self, times: FloatArray, is_edge: NDArray[np.bool_]) -> FloatArray:
        """Measured signals at samples and, linear between them, at edges."""
        if not is_edge.any():
            return self.e
        found = np.empty((times.size, self.e.shape[1]))
        found[~is_edge] = self.e
        left = (np.cumsum(~is_edge) - 1)[is_edge]
        share = ((times[is_edge] - self.t_s[left]) / (self.t_s[left + 1] - self.t_s[left]))[:, None]
        found[is_edge] = self.e[left] * (1 - share) + self.e[left + 1] * share
        return found


def node_bucket(k: int) -> int:
    """The number of nodes a response of k nodes is padded to."""
    return next((b for b in _BUCKETS if b >= k), -(-k // 512) * 512)


def _within(first: IndexArray) -> IndexArray:
    """(first[-1],) position of each element in its own group."""
    return np.arange(first[-1]) - np.repeat(first[:-1], np.diff(first))
