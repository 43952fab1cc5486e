"""Noise and disturbance of real flights on a simulated one: blocks of what a base model leaves of recordings, in random order.

The oracle (scipy, no line of the code that is judged) fits the base model to every window of the recorded flights. What it leaves there,
with the window's disturbance less its mean over all windows, is a block. Blocks are drawn with replacement and overlap (block bootstrap,
Kunsch 1989, Annals of Statistics 17, 1217). A block is a whole window: the oracle has removed its initial state, and longer ones do not
exist. In free flight they last 2.5 s; what is left of the public recordings correlates over 0.04 to 0.7 s. All channels of a block stay
together.

A simulated flight without noise of its own gets

    angles' = angles + e,   v' = v + e_v + u,   f' = f + b - D R'^T u,   u' = (R' - R) f + R' b - D u - k u

e: left of the angles; b: left of the specific force, with the disturbance (body axes: rotors and drag push along them); R, R': attitude
without and with e, since a vehicle that the air has tilted is pushed by its thrust; u: what that and b make of the velocity, so that
force and velocity belong together, against the drag D, in a step, in which no controller answers, with k = 0, between steps with one
that brings the vehicle back; e_v: left of the velocity beyond the integral of b.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend, resample, savgol_filter

from flighttest.errors import InputError
from flighttest.frames import G_M_S2
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.recordings.sources import Reading, open_recordings
from flighttest.proof import oracle
from flighttest.proof.cases import Case, NoiseSource
from flighttest.proof.recorded.sets import RecordedSet
from flighttest.recording.model import Recording, Series
from flighttest.segments import Segment, cut

FloatArray = NDArray[np.float64]

SHARE = 0.5  # of trials
MOST_FILES = 3  # of a set: three minutes and more of noise
LEAST_S = 1.5  # of a block: two overlaps and a middle
FADE_S = 0.5  # overlap of two blocks
FINER = 4  # the blocks' rate, 50 Hz, times this: recordings of 100 Hz are read between samples without loss
ANSWER_1_S = 4.0  # of what brings the vehicle back between steps, within the second that scripts settle for
MARGIN_S = 0.5  # before a step its commands hold already
SMOOTH_S = 0.2  # window over which velocity is differentiated (as `recorded.injection.SMOOTH_S`), and above whose rates a gyro is noise
_ALWAYS = ("roll_rad", "pitch_rad", "r_rad_s", "roll_ref_rad", "pitch_ref_rad", "throttle")
_LOST_M_S2 = 0.5 * G_M_S2  # a force that no model of flight leaves (RMS of a window): the vehicle has hit something
_CHANNELS = ("roll_rad", "pitch_rad", "r_rad_s", "f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "v_x_m_s", "v_y_m_s", "v_z_m_s")
_FORCES = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
_VELOCITIES = ("v_x_m_s", "v_y_m_s", "v_z_m_s")
# Columns of a block (n, 11).
_B, _V, _ANGLES, _R, _GYRO = slice(0, 3), slice(3, 6), slice(6, 8), 8, slice(9, 11)


def with_real_noise(cases: Sequence[Case], sets: Sequence[RecordedSet], data: Path) -> list[Case]:
    """The same cases, half of them with noise of a set of real recordings in place of synthetic noise and gusts. The source is drawn first,
    then a set of it. InputError where no recording has what it takes: both angles with their references, throttle, yaw rate, and three axes
    of the accelerometer or of the velocity."""
    here = [one for one in sets if (found := one.found(data)) and _suffices(found[0], one.columns)]
    if not here:
        raise InputError(
            f"{data}: none of the recordings that are listed has angles, their references, throttle, yaw rate and forces or velocities",
            "name their folder with --data DIR",
        )
    return [_drawn(case, here, data) for case in cases]


def _suffices(file: Path, columns: Path | None) -> bool:
    first = open_recordings([file], Reading(columns))[0]
    return first.has(*_ALWAYS) and (first.has(*_FORCES) or first.has(*_VELOCITIES))


def _drawn(case: Case, here: Sequence[RecordedSet], data: Path) -> Case:
    # A stream of its own: with or without real noise a seed's vehicles, flights and effects are the same.
    rng = np.random.default_rng([case.seed, case.index, 1])
    if rng.random() >= SHARE:
        return case
    source = str(rng.choice(sorted({one.source for one in here})))
    sets = [one for one in here if one.source == source]
    one = sets[int(rng.integers(len(sets)))]
    files = sorted(str(f) for f in rng.permutation([str(f.relative_to(data)) for f in one.found(data)])[:MOST_FILES])
    noise = NoiseSource(one.name, tuple(files), str(one.columns) if one.columns else None, str(data))
    return replace(case, noise=0.0, gust_rms_m_s=0.0, noise_from=noise)


def blocks_of(source: NoiseSource) -> tuple[FloatArray, ...]:
    """Blocks (n, 11) at `oracle.STEP_S` of the recordings: left of specific force (body), velocity (world), roll, pitch, yaw rate, fast
    part of p and q; SI. InputError where no window is long enough."""
    files = [Path(source.data) / f for f in source.files]
    found = residual_blocks(open_recordings(files, Reading(Path(source.columns) if source.columns else None)))
    if not found:
        raise InputError(f"{source.name}: no window of {LEAST_S} s can be used", "list longer flights")
    return found


def residual_blocks(recordings: tuple[Recording, ...]) -> tuple[FloatArray, ...]:
    """Of recordings, as `blocks_of`."""
    # As free flight every window shows all that there is: angles, yaw rate and translation.
    windows = [
        replace(s, name=f"{r.name}/{k}", kind="free")
        for r in recordings
        for k, s in enumerate(cut(r))
        if s.usable and s.t_s[-1] - s.t_s[0] >= LEAST_S
    ]
    if not windows:
        return ()
    noise = oracle.OracleNoise(oracle.FIRST, oracle.FIRST_DISTURBANCE)
    voltage = base_model(recordings, None).nominal_voltage_v
    left = oracle.left(windows, noise, voltage, free=True)
    for _ in range(2):
        windows = [s for s in windows if _flies(s, left)]
        noise = replace(noise.of_residual(left), disturbance=noise.disturbance | _spread(left))
        left = oracle.left(windows, noise, voltage, free=True, near=left)
    wind = np.mean([left.disturbance[s.name, "translation"] for s in windows], axis=0)
    every = [block for s in windows if (block := _block(s, left, wind)) is not None]
    trim = np.mean(np.concatenate(every), axis=0)  # what all windows have in common is no noise
    return tuple(block - trim for block in every)


def _spread(left: oracle.Left) -> dict[str, float]:
    """RMS of the disturbances, by block: a steady wind is no drift."""
    found: dict[str, list[FloatArray]] = {}
    for (_, block), value in left.disturbance.items():
        found.setdefault(block, []).append(value)
    return {block: float(np.sqrt(np.mean(np.square(values)))) for block, values in found.items()}


def _flies(s: Segment, left: oracle.Left) -> bool:
    squares = [np.mean(left.residual[s.name, c] ** 2) for c in _FORCES if (s.name, c) in left.residual]
    return float(np.sqrt(np.sum(squares) + np.sum(left.disturbance[s.name, "translation"] ** 2))) < _LOST_M_S2


def _block(s: Segment, left: oracle.Left, wind: FloatArray) -> FloatArray | None:
    residual = {c: left.residual[s.name, c] for c in _CHANNELS if (s.name, c) in left.residual}
    forces, flown = set(_FORCES) <= residual.keys(), set(_VELOCITIES) <= residual.keys()
    if "roll_rad" not in residual or "pitch_rad" not in residual or not (forces or flown):
        return None
    n = residual["roll_rad"].size
    t = s.t_step_s + (np.ceil((s.t_s[0] - s.t_step_s) / oracle.STEP_S) + np.arange(n)) * oracle.STEP_S
    measured = {
        c: np.interp(t, s.t_s[known], values[known])
        for c, values in s.y.items()
        if (known := np.isfinite(values)).sum() > 1
    }
    turn = oracle.body_to_world(measured["roll_rad"], measured["pitch_rad"], measured.get("yaw_rad", np.zeros(n)))
    block = np.zeros((n, 11))
    if forces:
        block[:, _B] = np.stack([residual[c] for c in _FORCES], axis=1)
    else:  # by the velocity, as far as it is no noise
        slopes = _smooth(np.stack([residual[c] for c in _VELOCITIES], axis=1), oracle.STEP_S, 1)
        block[:, _B] = np.einsum("nji,nj->ni", turn, slopes)
    block[:, _B] -= block[:, _B].mean(axis=0)
    moved = np.cumsum(np.einsum("nij,nj->ni", turn, block[:, _B]), axis=0) * oracle.STEP_S
    for k, c in enumerate(_VELOCITIES):
        if c in residual:
            block[:, 3 + k] = detrend(residual[c] - moved[:, k])
    block[:, _B] += np.einsum("nji,j->ni", turn, left.disturbance[s.name, "translation"] - wind)
    block[:, _ANGLES] = np.stack([residual["roll_rad"], residual["pitch_rad"]], axis=1)
    block[:, _ANGLES] += left.disturbance[s.name, "roll_pitch"]
    if "r_rad_s" in residual:
        block[:, _R] = residual["r_rad_s"] + left.disturbance[s.name, "yaw"][0]
    elif "r_rad_s" in measured:  # no turn is known to have been asked for
        block[:, _R] = measured["r_rad_s"] - measured["r_rad_s"].mean()
    for k, c in enumerate(("p_rad_s", "q_rad_s")):
        if c in measured:
            block[:, 9 + k] = measured[c] - _smooth(measured[c], oracle.STEP_S, 0)
    return block


def _smooth(x: FloatArray, step_s: float, derivative: int) -> FloatArray:
    """(n,) or (n, k), along the first axis, by a local parabola."""
    window = round(SMOOTH_S / step_s) | 1
    return np.asarray(savgol_filter(x, window, 2, deriv=derivative, delta=step_s, axis=0))


def joined_blocks(blocks: Sequence[FloatArray], samples: int, rng: np.random.Generator) -> FloatArray:
    """(samples, 11) of drawn blocks that overlap."""
    overlap = round(FADE_S / oracle.STEP_S)
    # Squares of both weights of an overlap add up to one, and no weight has a kink (the Vorbis window).
    up = np.sin(np.pi / 2.0 * np.sin(np.pi / 2.0 * (np.arange(overlap) + 0.5) / overlap) ** 2)
    total = np.zeros((samples + 2 * overlap + max(map(len, blocks)), 11))
    begin = 0
    while begin < samples + overlap:
        block = blocks[int(rng.integers(len(blocks)))]
        weight = np.ones(len(block))
        weight[:overlap], weight[-overlap:] = up, up[::-1]
        total[begin : begin + len(block)] += weight[:, None] * block
        begin += len(block) - overlap
    return total[overlap : overlap + samples]


@dataclass(frozen=True)
class RealNoise:
    """What a simulated flight gets. blocks: as `blocks_of`; drag_1_s (3,): of the vehicle, forward, left, up; seed: of the order."""

    blocks: tuple[FloatArray, ...]
    drag_1_s: tuple[float, float, float]
    seed: int

    def on(self, flown: Recording) -> Recording:
        """A recording without noise as it would have been with it; every channel keeps its own times."""
        begin, end = flown.t_span_s
        samples = round((end - begin) / oracle.STEP_S) + 2
        noise = np.asarray(
            resample(joined_blocks(self.blocks, samples, np.random.default_rng(self.seed)), FINER * samples)
        )
        step_s = oracle.STEP_S / FINER
        t: FloatArray = begin + step_s * np.arange(FINER * samples, dtype=float)
        leak = np.full(t.size, ANSWER_1_S)
        for s in cut(flown):
            if s.usable and s.kind != "free":
                leak[(t >= s.t_s[0] - MARGIN_S) & (t <= s.t_s[-1])] = 0.0
        added = dict(self._added(flown, t, noise, leak))
        series = {}
        for group, one in flown.series.items():
            columns = {c: x + np.interp(one.t_s, t, added[c]) if c in added else x for c, x in one.columns.items()}
            series[group] = Series(one.t_s, columns)
        return replace(flown, series=series)

    def _added(
        self, flown: Recording, t: FloatArray, noise: FloatArray, leak: FloatArray
    ) -> Iterator[tuple[str, FloatArray]]:
        """Channel to (n,)."""
        step_s = float(t[1] - t[0])
        angles = np.column_stack([noise[:, _ANGLES], _settling(noise[:, [_R]], leak[:, None], step_s)])
        attitude = (flown.channel(f"{axis}_rad") for axis in ("roll", "pitch", "yaw"))
        flat = [np.interp(t, at, np.unwrap(angle)) for at, angle in attitude]
        force = np.stack([np.interp(t, *flown.channel(c)) for c in _FORCES], axis=1)
        turn = oracle.body_to_world(flat[0], flat[1], flat[2])
        after = oracle.body_to_world(*(flat[k] + angles[:, k] for k in range(3)))
        drag = np.array([sum(self.drag_1_s[:2]) / 2.0] * 2 + [self.drag_1_s[2]])
        push = np.einsum("nij,nj->ni", after - turn, force) + np.einsum("nij,nj->ni", after, noise[:, _B])
        pushed = _settling(push, drag + leak[:, None], step_s)
        more = noise[:, _B] - np.einsum("nji,nj->ni", after, drag * pushed)
        velocity = noise[:, _V] + pushed
        rates = _smooth(angles[:, :2], step_s, 1) + noise[:, _GYRO]
        higher = _settling(velocity, leak[:, None], step_s)
        yield from zip(_FORCES, more.T, strict=True)
        yield from zip(_VELOCITIES, velocity.T, strict=True)
        yield from zip(("roll_rad", "pitch_rad", "yaw_rad"), angles.T, strict=True)
        yield from zip(("p_rad_s", "q_rad_s", "r_rad_s"), (*rates.T, noise[:, _R]), strict=True)
        yield from zip(("p_x_m", "p_y_m", "p_z_m", "height_m"), (*higher.T, higher[:, 2]), strict=True)


def _settling(rate: FloatArray, leak: FloatArray, step_s: float) -> FloatArray:
    """(n, k) integral x' = rate - leak x from zero."""
    keep = np.broadcast_to(np.exp(-leak * step_s), rate.shape)
    x, rows = np.zeros(rate.shape[1]), np.empty_like(rate)
    for k in range(len(rate)):
        rows[k] = x
        x = keep[k] * x + step_s * rate[k]
    return rows
