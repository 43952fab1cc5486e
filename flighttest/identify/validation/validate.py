"""Paper section 4: how well inputs alone predict a flight that was not fitted, by the model and by simplifications of it.

From many starts the model runs open loop on the recorded references and voltage; its errors after 0.1 to 3 s are compared with
those of the linearisation about hover, no drag, no battery dependency, only delay (Table 4), of holding the last measurement, and of a
previous model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import WORDS
from flighttest.errors import FitError
from flighttest.estimation.solver import solve
from flighttest.identify.diagnostics.residuals import ResidualTest, residual_tests
from flighttest.identify.models.model_file import ModelFile
from flighttest.identify.selection import problem_of
from flighttest.identify.validation.ablations import (
    GROUPS,
    UNITS,
    OpenLoopStart,
    Predicted,
    Variation,
    measured_channels,
    runner,
    voltage_for,
)
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

HORIZONS_S = (0.1, 0.5, 1.0, 1.5, 3.0)
START_EVERY_S = 0.25
MAX_STARTS = 400
FIGURE_S = 1.5
ENOUGH_STRETCHES = 5  # an RMS of five independent errors is known to a third
_SHORTEST_S = 0.6


@dataclass(frozen=True)
class HorizonError:
    """Error of one group of channels (vector norm) after a horizon, over `count` starts, in `UNITS[group]`: root mean square, and mean as
    papers on learned dynamics print it. stretches: how many of those do not overlap, and so are independent."""

    variation: Variation
    group: str
    horizon_s: float
    rmse: float
    count: int
    stretches: int
    mean: float = float("nan")

    @property
    def few(self) -> str:
        """The caution on an error measured on few stretches of flight; empty where there are enough."""
        if self.stretches >= ENOUGH_STRETCHES:
            return ""
        starts = f"{self.count} start{'s' if self.count != 1 else ''}"
        apart = f", in {self.stretches} separate stretch{'es' if self.stretches != 1 else ''} of flight"
        return f"from {starts} only{apart if self.stretches < self.count else ''}"


@dataclass(frozen=True)
class Figure5:
    """One stretch of flight: t_s (n,) from its start; measured: channel to (n,); simulated: variation to channel to (n,)."""

    segment: str
    t_s: FloatArray
    measured: Mapping[str, FloatArray]
    simulated: Mapping[Variation, Mapping[str, FloatArray]]


@dataclass(frozen=True)
class Validation:
    """errors: the table; figure: Figure 5 for this flight; starts: how many; sentences: what it means; residuals: of the flight in
    windows with free initial states: are they noise, and do they follow the commands?"""

    errors: tuple[HorizonError, ...]
    figure: Figure5
    starts: int
    segments: tuple[str, ...]
    sentences: tuple[str, ...]
    residuals: tuple[ResidualTest, ...] = ()

    def rmse(self, variation: Variation, group: str, horizon_s: float) -> float | None:
        """One entry of the table, None where it was not measured."""
        for e in self.errors:
            if e.variation is variation and e.group == group and abs(e.horizon_s - horizon_s) < 1e-9:
                return e.rmse
        return None


def comparable(segment: Segment) -> bool:
    """Whether a segment can be run open loop: not rejected, with the throttle recorded, and long enough for half a second."""
    return segment.usable and "throttle" in segment.u and bool(segment.t_s[-1] - segment.t_s[0] > _SHORTEST_S)


def validate(
    stored: ModelFile,
    segments: Sequence[Segment],
    previous: ModelFile | None = None,
    horizons_s: Sequence[float] = HORIZONS_S,
) -> Validation:
    """Compare on usable segments: free flight where there is any, else whatever is given. Steps beside free flight are a comparison
    of their own, for the caller to ask for. horizons_s: increasing; one that lies between samples is left out.

    FitError where none lasts half a second with throttle recorded.
    """
    usable = [s for s in segments if comparable(s)]
    chosen = joined_windows([s for s in usable if s.kind == "free"]) or usable
    if not chosen:
        raise FitError(
            "no recording can be simulated", "give a flight with the throttle recorded and at least 0.6 s long"
        )
    starts = _starts(chosen, horizons_s[-1])
    measured = [measured_channels(s) for s in chosen]
    shown = _most_lively(starts, measured, chosen)
    errors: list[HorizonError] = []
    figures: dict[Variation, dict[str, FloatArray]] = {}
    sentences: list[str] = []
    for variation in Variation:
        run = runner(variation, stored, previous)
        if run is None:
            continue
        predicted = run(chosen, starts, measured)
        errors += _errors(variation, predicted, starts, measured, chosen, horizons_s)
        figures[variation] = {
            c: v[: _samples(chosen[starts[shown].segment], starts[shown])] for c, v in predicted[shown].items()
        }
    at = starts[shown]
    segment = chosen[at.segment]
    n = _samples(segment, at)
    figure = Figure5(
        segment.name,
        segment.t_s[at.first : at.first + n] - segment.t_s[at.first],
        {c: v[at.first : at.first + n] for c, v in measured[at.segment].items()},
        figures,
    )
    sentences += _verdicts(errors)
    residuals = _residuals(stored, usable)
    sentences += [f"{WORDS.get(t.channel, t.channel)}: {t.sentence}" for t in residuals if t.follows]
    return Validation(tuple(errors), figure, len(starts), tuple(s.name for s in chosen), tuple(sentences), residuals)


def _residuals(stored: ModelFile, segments: Sequence[Segment]) -> tuple[ResidualTest, ...]:
    """Residual tests with the model's parameters, each segment's initial state and disturbance estimated on it."""
    windows = [voltage_for(stored, s) for s in [s for s in segments if s.kind == "free"] or segments]
    try:
        problem = problem_of(windows, stored.model, select="all", values=stored.values)
    except FitError:  # nothing moves any reference: there is nothing to be independent of
        return ()
    return residual_tests(problem, solve(problem, free=(), robust=False))


def joined_windows(windows: Sequence[Segment]) -> list[Segment]:
    """Neighbouring windows of one free flight as one segment each, so that long horizons fit."""
    found: list[list[Segment]] = []
    for s in sorted(windows, key=lambda s: (s.run, float(s.t_s[0]))):
        last = found[-1][-1] if found else None
        step = float(np.median(np.diff(s.t_s)))
        if (
            last is not None
            and last.run == s.run
            and 0.0 < s.t_s[0] - last.t_s[-1] < 2.5 * step
            and last.y.keys() == s.y.keys()
        ):
            found[-1].append(s)
        else:
            found.append([s])
    return [_joined(group) for group in found]


def _joined(group: Sequence[Segment]) -> Segment:
    if len(group) == 1:
        return group[0]
    u = {}
    for name in group[0].u:
        times = np.concatenate([s.u[name][0] for s in group if name in s.u])
        values = np.concatenate([s.u[name][1] for s in group if name in s.u])
        times, first = np.unique(times, return_index=True)
        u[name] = (times, values[first])
    y = {c: np.concatenate([s.y[c] for s in group]) for c in group[0].y}
    return replace(group[0], t_s=np.concatenate([s.t_s for s in group]), y=y, u=u)


def _samples(segment: Segment, start: OpenLoopStart) -> int:
    t = segment.t_s
    return int(np.searchsorted(t, t[start.first] + FIGURE_S + 1e-9)) - start.first


def _starts(segments: Sequence[Segment], longest_s: float) -> list[OpenLoopStart]:
    found = []
    for i, s in enumerate(segments):
        t = s.t_s
        for at in np.arange(t[0], t[-1] - 0.5, START_EVERY_S):
            first = int(np.searchsorted(t, at))
            last = int(np.searchsorted(t, t[first] + max(longest_s, FIGURE_S) + 1e-6, side="right")) - 1
            found.append(OpenLoopStart(i, first, last))
    stride = -(-len(found) // MAX_STARTS)
    return found[::stride]


def _errors(
    variation: Variation,
    predicted: Predicted,
    starts: Sequence[OpenLoopStart],
    measured: Sequence[Mapping[str, FloatArray]],
    segments: Sequence[Segment],
    horizons_s: Sequence[float],
) -> list[HorizonError]:
    found = []
    for group, channels in GROUPS.items():
        for horizon in horizons_s:
            squares = []
            stretches, ended = 0, (-1, 0.0)
            for s, made in zip(starts, predicted, strict=True):
                y = measured[s.segment]
                if not all(c in y and c in made for c in channels):
                    continue
                t = segments[s.segment].t_s[s.first : s.last + 1]
                k = int(np.argmin(np.abs(t - t[0] - horizon)))
                if abs(t[k] - t[0] - horizon) > min(0.06, 0.25 * horizon):
                    continue
                # Position is compared from where each run starts, since the start is taken from the measurement anyway.
                off = np.array([made[c][k] - y[c][s.first + k] for c in channels])
                if np.isfinite(off).all():
                    squares.append(float(off @ off))
                    if s.segment != ended[0] or t[0] >= ended[1]:
                        stretches, ended = stretches + 1, (s.segment, float(t[k]))
            if squares:
                rmse = float(np.sqrt(np.mean(squares)))
                mean = float(np.mean(np.sqrt(squares)))
                found.append(HorizonError(variation, group, horizon, rmse, len(squares), stretches, mean))
    return found


def _most_lively(
    starts: Sequence[OpenLoopStart], measured: Sequence[Mapping[str, FloatArray]], segments: Sequence[Segment]
) -> int:
    """The start whose first 1.5 s show most motion."""
    best, found = -1.0, 0
    for i, s in enumerate(starts):
        n = _samples(segments[s.segment], s)
        y = measured[s.segment]
        size = sum(float(np.nanstd(y[c][s.first : s.first + n])) for c in ("roll_rad", "pitch_rad") if c in y)
        if segments[s.segment].t_s[-1] - segments[s.segment].t_s[s.first] >= FIGURE_S and size > best:
            best, found = size, i
    return found


def _verdicts(errors: Sequence[HorizonError]) -> list[str]:
    """What the table shows, against each simplification, at the longest horizon measured."""
    sentences = []
    table = {(e.variation, e.group, e.horizon_s): e.rmse for e in errors}
    few = {(e.group, e.horizon_s): e.few for e in errors if e.variation is Variation.FULL}
    for group in ("position", "velocity"):
        horizons = sorted(h for v, g, h in table if v is Variation.FULL and g == group)
        if not horizons:
            continue
        h = horizons[-1]
        full = table[Variation.FULL, group, h]
        little = f", {few[group, h]}: uncertain, as are the ratios below" if few[group, h] else ""
        sentences.append(
            f"after {h:g} s the {group} error of the full model is {full:.2f} {UNITS[group]} (RMS){little}"
        )
        for variation in Variation:
            other = table.get((variation, group, h))
            if variation is Variation.FULL or other is None:
                continue
            ratio = other / full if full > 0 else float("inf")
            size = "as large" if 0.95 < ratio < 1.05 else f"{ratio:.{1 if ratio > 1.0 else 2}f} times as large"
            sentences.append(f"{variation.value}: {group} error {size} after {h:g} s")
        break
    return sentences
