"""Sections about single responses and about the residuals of all: one response, correlations, frequency responses, trajectories."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS, WORDS
from flighttest.identify.response_analysis.comparison import FittedResponse
from flighttest.identify.response_analysis.frequency_response import FrequencyResponse, ResidualCorrelation
from flighttest.identify.validation.accumulation import Accumulation
from flighttest.report.document import Choice, Figure, Panel, Role, Section, Trace
from flighttest.report.fit_views import FitView
from flighttest.report.numbers import unit
from flighttest.report.packing import coarse
from flighttest.report.sections.show import word

POINTS = 80  # of a trace
MOST_CORRELATED = 9
TRAJECTORY_POINTS = 40
RESIDUAL_ROLES: tuple[Role, ...] = (
    "other", "model", "no_battery", "linearised", "only_delay", "after", "before", "limit", "no_drag",
)  # fmt: skip

FloatArray = NDArray[np.float64]


def one_by_one(view: FitView) -> Section | None:
    """A response picked by its name: command, measured, model and residual together."""
    figures = tuple((r.name, _one(r)) for r in view.responses)
    if not figures:
        return None
    choice = Choice("response", "response", figures)
    lead = "Choose a response: its command, the measured and the modelled channels, and the residuals in units of the noise."
    return Section("one", "One response", (choice,), lead, detail=True)


def _one(r: FittedResponse) -> Figure:
    panels = []
    by_unit: dict[str, list[str]] = {}
    for name in r.commands:
        by_unit.setdefault(CHANNELS[name].unit, []).append(name)
    for names in by_unit.values():
        traces = tuple(Trace(r.t_s, r.commands[n], word(n), "reference", "steps") for n in names)
        what = {"rad": "angle, rad", "rad/s": "rate, rad/s"}.get(CHANNELS[names[0]].unit, word(names[0]))
        panels.append(Panel("Command", "time since the step, s", what, traces))
    left: list[Trace] = []
    for c in r.channels:
        name = WORDS.get(c.channel, c.channel)
        simulated = Trace(*coarse(c.t_s, c.simulated, POINTS), "model", "simulated")
        measured = Trace(*coarse(c.t_s, c.measured, POINTS), "measured", "measured")
        label = f"{name}, {unit(CHANNELS[c.channel].unit)}"
        panels.append(Panel(name.capitalize(), "time since the step, s", label, (simulated, measured)))
        if np.isfinite(c.floor) and c.floor > 0.0:
            role = RESIDUAL_ROLES[len(left) % len(RESIDUAL_ROLES)]
            residual = coarse(c.t_s, (c.measured - c.simulated) / c.floor, POINTS)
            left.append(Trace(*residual, f"residual of {name}", role))
    if left:
        panels.append(Panel("Residuals", "time since the step, s", "residual, noise floors", tuple(left)))
    return Figure("response", tuple(panels), r.name, 2, 240)


def correlation(view: FitView) -> Section | None:
    """Correlations of residuals by lag, within which white noise would stay nineteen times of twenty."""
    chosen = view.residual_correlations[:MOST_CORRELATED]
    if not chosen:
        return None
    panels = [panel for c in chosen for panel in _correlation(c)]
    caption = (
        "Left: autocorrelation of the residual. Right: its cross-correlation with the command. White noise that no command drives stays "
        "between the dashed lines in 95 % of the lags; a constant or slow disturbance of a response does not."
    )
    return Section(
        "correlations",
        "Correlation of the residuals",
        (Figure("correlations", tuple(panels), caption, 2, 230),),
        detail=True,
    )


def _correlation(c: ResidualCorrelation) -> tuple[Panel, ...]:
    ends = [float(c.lag_s[0]), float(c.lag_s[-1])]
    limits = tuple(
        Trace(ends, [s * c.band, s * c.band], "95 % of white noise", "limit", group="white noise") for s in (1.0, -1.0)
    )
    name = WORDS.get(c.channel, c.channel)
    auto = Trace(c.lag_s, c.auto, name, "other", group="correlation")
    panels = [Panel(f"{name}: autocorrelation", "lag, s", "correlation", (auto, *limits))]
    if np.isfinite(c.cross).all():
        cross = Trace(c.lag_s, c.cross, name, "other", group="correlation")
        panels.append(Panel(f"{name}: cross-correlation with the command", "lag, s", "correlation", (cross, *limits)))
    return tuple(panels)


def bode(view: FitView) -> Section | None:
    """Amplitude, phase and coherence of each loop, measured against model."""
    if not view.loops:
        return None
    panels = [panel for loop in view.loops for panel in _bode(loop)]
    caption = (
        "From the command to the response over all steps of a kind, measured and by the model from the same commands. Coherence is the "
        "share of the measured response that the command explains: where it is low, the measured curve is noise."
    )
    return Section("bode", "Frequency responses", (Figure("bode", tuple(panels), caption, 3, 250),), detail=True)


def _bode(loop: FrequencyResponse) -> tuple[Panel, ...]:
    f = loop.frequency_hz
    ratio = (
        f"{unit(CHANNELS[loop.answer].unit)}/{unit(CHANNELS[loop.command].unit)}".replace("rad/s/rad/s", "")
        .replace("rad/rad", "")
        .rstrip("/")
    )
    level = f"amplitude, dB{f' re {ratio}' if ratio else ''}"
    gain, phase = (
        (Trace(f, model, "model", "simulated"), Trace(f, measured, "measured", "measured"))
        for measured, model in (loop.gain_db, loop.phase_deg)
    )
    seen = (Trace(f, loop.coherence, "coherence", "other"),)
    return (
        Panel(
            f"{loop.loop.capitalize()} ({loop.responses} steps)",
            "frequency, Hz",
            level,
            gain,
            log="x",
        ),
        Panel("Phase", "frequency, Hz", "phase, deg", phase, log="x"),
        Panel("Coherence", "frequency, Hz", "coherence", seen, log="x"),
    )


def trajectories(view: FitView) -> Section | None:
    """Every parameter's estimate and 95 % interval as responses are added in the order flown."""
    panels = tuple(_trajectory(t) for t in view.trajectories)
    if not panels:
        return None
    caption = (
        "Estimate and 95 % interval by the responses flown so far, by one linear step from the final estimate (no refit); a curve "
        "begins where the responses determine the parameter. An estimate that leaves its earlier interval, or drifts on while the "
        "interval narrows, means that the vehicle changed in flight or that the model lacks something."
    )
    figure = Figure("trajectories", panels, caption, 3, 220)
    return Section("trajectories", "Estimates as responses are added", (figure,), detail=True)


def _trajectory(t: Accumulation) -> Panel:
    def line(y: FloatArray, name: str, role: Role) -> Trace:
        return Trace(*coarse(t.count.astype(float), y, TRAJECTORY_POINTS), name, role, group=name)

    final = Trace([t.count[0], t.count[-1]], [t.value[-1]] * 2, "final estimate", "reference", group="final estimate")
    low, high = (line(t.value + sign * t.half_width, "95 % interval", "limit") for sign in (-1.0, 1.0))
    value = line(t.value, "estimate", "measured")
    label = f"{t.name}, {unit(t.unit)}" if unit(t.unit) else t.name
    return Panel(t.name, "responses so far", label, (low, high, final, value))


def response_sections(view: FitView) -> tuple[Section, ...]:
    """All of them that there is something to show of."""
    return tuple(s for s in (one_by_one(view), bode(view), correlation(view), trajectories(view)) if s is not None)
