"""Recorded commands on an identified vehicle, as it is and changed: open loop from many starts, with the model's own uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import FitError
from flighttest.identify.models.export import error_covariance
from flighttest.identify.models.model_file import ModelFile
from flighttest.identify.validation.ablations import OpenLoopStart, measured_channels, open_loop, voltage_for
from flighttest.identify.validation.validate import comparable, joined_windows
from flighttest.segments.model import Segment
from flighttest.twin.what_if import WhatIf

FloatArray = NDArray[np.float64]

HORIZON_S = 1.5
MOST_STARTS = 60
DRAWS = 24
SHOWN = 4
Z_95 = 1.96
CHANNELS = (
    "roll_rad", "pitch_rad", "r_rad_s", "v_x_m_s", "v_y_m_s", "v_z_m_s", "p_z_m", "a_x_m_s2", "a_y_m_s2", "a_z_m_s2",
)  # fmt: skip


@dataclass(frozen=True)
class ChangeEffect:
    """One channel, `HORIZON_S` after each start or at the end of the response. error: RMS of twin minus recording; shift: mean of changed
    minus unchanged twin; size: its RMS; uncertainty: RMS 95 % half width of the changed twin by the model's covariance."""

    error: float
    shift: float
    size: float
    uncertainty: float


@dataclass(frozen=True)
class Shown:
    """One stretch: t_s (n,) from its start; by channel (n,): measured, the twin, the changed twin and its 95 % half width."""

    segment: str
    t_s: FloatArray
    measured: Mapping[str, FloatArray]
    twin: Mapping[str, FloatArray]
    changed: Mapping[str, FloatArray]
    half: Mapping[str, FloatArray]


@dataclass(frozen=True)
class Replay:
    """effects: by channel; shown: the stretches where the change shows most; starts: how many."""

    effects: Mapping[str, ChangeEffect]
    shown: tuple[Shown, ...]
    starts: int


def replay(stored: ModelFile, segments: Sequence[Segment], change: WhatIf, seed: int = 0) -> Replay:
    """Run the commands of usable segments on both vehicles. FitError where none can be run."""
    usable = runnable(segments)
    starts = starts_in(usable)
    plain = [voltage_for(stored, s) for s in usable]
    model, names = change.model, change.model.system.params
    twin = open_loop(model, change.base, plain, starts)
    at = {n: i for i, n in enumerate(names)}
    center = np.array([change.base[n] for n in names])
    draws = np.tile(center, (DRAWS, 1))
    known = [n for n in stored.order if n in at]
    if known:
        pick = [stored.order.index(n) for n in known]
        matrix = error_covariance(stored)[np.ix_(pick, pick)]
        made = np.random.default_rng(seed).multivariate_normal(
            np.zeros(len(known)), matrix, DRAWS, check_valid="ignore"
        )
        draws[:, [at[n] for n in known]] += made
        lower, upper = (np.array([getattr(model.param[n], side) for n in names]) for side in ("lower", "upper"))
        draws = np.clip(draws, lower, upper)
    p = np.concatenate([np.array([[change.values[n] for n in names]]), change.drawn(draws, names)])
    with_battery = [change.voltage(s) for s in plain]
    many = open_loop(
        model, change.values, with_battery, [s for s in starts for _ in p], np.tile(p, (len(starts), 1))
    )  # fmt: skip
    stretches = []
    for k, start in enumerate(starts):
        rows = many[k * len(p) : (k + 1) * len(p)]
        segment = usable[start.segment]
        y = measured_channels(segment)
        here = slice(start.first, start.last + 1)
        t = segment.t_s[here] - segment.t_s[start.first]
        channels = [c for c in CHANNELS if c in rows[0]]
        half = {c: Z_95 * np.std([r[c] for r in rows[1:]], axis=0) for c in channels}
        measured = {c: y[c][here] for c in channels if c in y}
        one = {c: twin[k][c] for c in channels}
        stretches.append(Shown(segment.name, t, measured, one, {c: rows[0][c] for c in channels}, half))
    effects = {c: _effect(stretches, c) for c in CHANNELS if any(c in s.measured for s in stretches)}
    lively = sorted(stretches, key=lambda s: -_liveliness(s, effects))
    apart = list({s.segment: s for s in reversed(lively)}.values())[::-1]
    return Replay(effects, tuple(sorted(apart, key=lambda s: -_liveliness(s, effects))[:SHOWN]), len(starts))


def runnable(segments: Sequence[Segment]) -> list[Segment]:
    """Usable segments that can be run open loop, free flight in pieces as long as it was flown. FitError where there is none."""
    usable = [s for s in segments if comparable(s) and not s.between_steps]
    usable = [*(s for s in usable if s.kind != "free"), *joined_windows([s for s in usable if s.kind == "free"])]
    if not usable:
        raise FitError(
            "no recording can be replayed", "give a recording with the throttle recorded and at least 0.6 s long"
        )
    return usable


def starts_in(segments: Sequence[Segment], horizon_s: float = HORIZON_S) -> list[OpenLoopStart]:
    """Starts one horizon apart, at most `MOST_STARTS`, each run to its horizon or the end of its segment."""
    found = []
    for i, s in enumerate(segments):
        t = s.t_s
        for begin in np.arange(t[0], t[-1] - 0.5, horizon_s):
            first = int(np.searchsorted(t, begin))
            last = int(np.searchsorted(t, t[first] + horizon_s + 1e-6, side="right")) - 1
            found.append(OpenLoopStart(i, first, last))
    return found[:: -(-len(found) // MOST_STARTS)]


def _effect(stretches: Sequence[Shown], channel: str) -> ChangeEffect:
    ends = np.array(
        [
            (
                s.twin[channel][-1] - s.measured[channel][-1],
                s.changed[channel][-1] - s.twin[channel][-1],
                s.half[channel][-1],
            )
            for s in stretches
            if channel in s.measured and np.isfinite(s.measured[channel][-1])
        ]
    )
    if not len(ends):
        return ChangeEffect(float("nan"), float("nan"), float("nan"), float("nan"))
    error, size, half = np.sqrt(np.mean(ends**2, axis=0))
    return ChangeEffect(float(error), float(ends[:, 1].mean()), float(size), float(half))


def _liveliness(shown: Shown, effects: Mapping[str, ChangeEffect]) -> float:
    """How much the change shows in a stretch, in errors of the twin; without a change, how much moves."""
    total = 0.0
    for c, e in effects.items():
        if e.error > 0 and c in shown.measured:
            off = shown.changed[c] - shown.twin[c]
            total += float(np.mean(np.abs(off)) + 1e-3 * np.std(shown.twin[c])) / e.error
    return total
