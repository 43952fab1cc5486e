"""Sections about a fit: parameters, Figure 4 of the paper for these runs, segments, correlations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from flighttest.identify.response_analysis.comparison import ResponseOverlay, ThrustPoint
from flighttest.report.document import (
    Align,
    Bullets,
    Cell,
    Figure,
    PageBlock,
    Panel,
    Paragraph,
    Section,
    Table,
    Trace,
)
from flighttest.report.fit_views import FitView, ParameterView, SegmentView
from flighttest.report.numbers import interval, join, number, to_error, unit
from flighttest.report.packing import coarse
from flighttest.report.sections.responses import response_sections

MAX_CORRELATIONS = 6
MANY_OUTLIERS = 6
FEW_REMARKS = 2  # of a fit, which a terminal shows without being asked
POINTS = 100  # of a trace in a picture of many
TONE = {"known": "good", "weak": "warn", "not identifiable": "bad", "held": "quiet"}
KIND_WORDS = {
    "roll_step": "roll step",
    "pitch_step": "pitch step",
    "yaw_rate_step": "yaw rate step",
    "throttle_step": "throttle step",
    "tilt_throttle": "throttle step while tilted",
    "free": "window of free flight",
}
SHORT_WORDS = {"free": "free flight", "tilt_throttle": "tilted throttle"}  # of a table's column


def cell_words(cell: Mapping[str, float]) -> str:
    """'0.10 to 0.35' for a throttle step, '+0.30 rad' for a tilt step."""
    if "throttle_0" in cell and "throttle_1" in cell:
        return f"{cell['throttle_0']:.2f} to {cell['throttle_1']:.2f}"
    if "amplitude_rad" in cell:
        return f"{cell['amplitude_rad']:+.2f} rad"
    if "rate_rad_s" in cell:
        return f"{cell['rate_rad_s']:+.1f} rad/s"
    return ", ".join(f"{k} {v:g}" for k, v in cell.items())


def parameter_section(view: FitView) -> Section:
    """The parameter table."""
    columns = ("parameter", "value", "unit", "95 % interval", "state", "what it is")
    align: tuple[Align, ...] = ("left", "right", "left", "right", "left", "left")
    rows = tuple(_parameter_row(p) for p in view.parameters)
    blocks: list[PageBlock] = [Table(columns, rows, align, detail=(len(columns) - 1,))]
    remarks: list[str] = []
    strong = [(a, b, c) for a, b, c in view.correlations if abs(c) >= view.correlation_above]
    if strong:
        words = "; ".join(f"{a} and {b} ({c:+.2f})" for a, b, c in strong[:MAX_CORRELATIONS])
        words += f"; and {len(strong) - MAX_CORRELATIONS} more pairs" if len(strong) > MAX_CORRELATIONS else ""
        remarks.append(f"correlated estimates (above {view.correlation_above:g}): {words}")
    remarks += [*view.warnings, *view.notes]
    if remarks:
        # Where nothing is known the reasons are the answer.
        many = len(remarks) > FEW_REMARKS and any(p.known for p in view.parameters)
        blocks.append(Bullets(tuple(remarks), f"{len(remarks)} remarks on them: --all lists them." if many else ""))
    return Section("parameters", "Parameters", tuple(blocks))


def quality(view: FitView) -> Section:
    """The residual of each channel against the noise."""
    rows = tuple(
        (
            q.channel,
            number(q.rmse, 3),
            number(q.floor, 3),
            unit(q.unit),
            f"{q.r2:.4f}",
            Cell("noise" if q.clean else f"{number(q.rmse / q.floor, 2)} x noise", "good" if q.clean else "warn"),
        )
        for q in view.quality
    )
    align: tuple[Align, ...] = ("left", "right", "right", "left", "right", "left")
    table = Table(("channel", "RMSE", "noise", "unit", "R2", "residual"), rows, align)
    blocks: list[PageBlock] = [table]
    if any(not q.clean for q in view.quality):
        blocks.append(
            Paragraph(
                "A residual above the noise is slow noise or physics that the model lacks. `flighttest diagnose` distinguishes them as far "
                "as the recordings allow.",
                "quiet",
            )
        )
    return Section("quality", "Residuals", tuple(blocks), detail=True)


def _parameter_row(p: ParameterView) -> tuple[Cell | str, ...]:
    tone = TONE.get(p.word, "plain")
    return (
        p.name,
        to_error(p.value, p.std),
        unit(p.unit),
        interval(p.low, p.high, p.std),
        Cell(p.word, tone, p.remedy),  # type: ignore[arg-type]
        p.doc,
    )


def figure4(view: FitView) -> Section | None:
    """Roll, pitch, yaw rate and throttle responses, measured against simulated; acceleration over time and over voltage."""
    panels = [
        panel
        for kind, channel, title, label in (
            ("roll_step", "roll_rad", "Roll", "roll, rad"),
            ("pitch_step", "pitch_rad", "Pitch", "pitch, rad"),
            ("yaw_rate_step", "r_rad_s", "Yaw rate", "yaw rate, rad/s"),
            ("throttle_step", "", "Throttle", "vertical acceleration, m/s²"),
        )
        if (panel := _responses(view.overlays, kind, channel, title, label)) is not None
    ]
    if view.thrust_points:
        panels.append(_over_voltage(view.thrust_points))
    free = _responses(view.overlays, "free", "", "Free flight", "vertical acceleration, m/s²")
    if free is not None:
        panels.append(free)
    if not panels:
        return None
    caption = (
        "Recorded responses (thin, dark; of many, a selection) over the fitted model driven by the recorded commands (wide, coloured). "
        "Settled acceleration against battery voltage: one point per response, the model's value joined per throttle pair."
    )
    return Section(
        "responses", "Measured and simulated responses", (Figure("figure4", tuple(panels), caption, 2, 330),)
    )


def _responses(overlays: Sequence[ResponseOverlay], kind: str, channel: str, title: str, label: str) -> Panel | None:
    chosen = [o for o in overlays if o.kind == kind and (not channel or o.channel == channel)]
    if not channel:
        vertical = [o for o in chosen if o.channel in ("a_z_m_s2", "f_z_m_s2")]
        first = vertical[0].channel if vertical else ""
        chosen = [o for o in vertical if o.channel == first]
        if first == "f_z_m_s2":
            label = "specific force up, m/s²"
    if not chosen:
        return None
    # Measured on top and thin: where the two agree, both stay visible.
    traces = [
        Trace(*coarse(o.t_s, o.simulated, POINTS), f"model, {cell_words(o.cell)}", "simulated", group="simulated")
        for o in chosen
    ]
    for o in chosen:
        name = f"{KIND_WORDS.get(o.kind, o.kind)} {cell_words(o.cell)} ({o.segment})"
        traces.append(Trace(*coarse(o.t_s, o.measured, POINTS), name, "measured", group="measured"))
    return Panel(f"{title} ({len(chosen)} responses)", "time since the step, s", label, tuple(traces))


def _over_voltage(points: Sequence[ThrustPoint]) -> Panel:
    cells = sorted({tuple(sorted(p.cell.items())) for p in points})
    traces = []
    for cell in cells:
        mine = sorted((p for p in points if tuple(sorted(p.cell.items())) == cell), key=lambda p: p.voltage_v)
        words = cell_words(dict(cell))
        volts = [p.voltage_v for p in mine]
        traces.append(Trace(volts, [p.measured for p in mine], words, "measured", "markers", group="measured"))
        traces.append(Trace(volts, [p.simulated for p in mine], f"model, {words}", "simulated", group="simulated"))
    return Panel(
        "Acceleration over battery voltage", "battery voltage, V", "settled vertical acceleration, m/s²", tuple(traces)
    )


def segments(views: Sequence[SegmentView]) -> Section:
    """Every segment: accepted, or rejected with its reason. Steps come before windows of free flight, rejected ones first."""
    rejected = [s for s in views if s.flaws]
    used = len(views) - len(rejected)
    counts: dict[str, int] = {}
    for s in views:
        if not s.flaws:
            counts[s.kind] = counts.get(s.kind, 0) + 1
    words = join([f"{n} {_plural(KIND_WORDS.get(kind, kind), n)}" for kind, n in counts.items()])
    lead = f"{used} of {len(views)} responses are used" + (f": {words}." if words else ".")
    metric_names = [
        m
        for m in ("delay_s", "rise_s", "overshoot", "settling_s", "steady_error")
        if any(_metric(s.metrics.get(m)) != "-" for s in views)
    ]
    titles = {
        "delay_s": "delay s",
        "rise_s": "rise s",
        "overshoot": "overshoot",
        "settling_s": "settling s",
        "steady_error": "steady error",
    }
    columns = ("response", "kind", "step", "repeat", *(titles[m] for m in metric_names), "state", "why")
    align = ("left", "left", "left", "right", *("right" for _ in metric_names), "left", "left")
    rows = tuple(
        (
            s.name,
            SHORT_WORDS.get(s.kind, KIND_WORDS.get(s.kind, s.kind).removesuffix(" step")),
            cell_words(s.cell),
            str(s.repeat),
            *(_metric(s.metrics.get(m)) for m in metric_names),
            *_state(s),
        )
        for s in sorted(views, key=lambda s: (s.kind == "free", not s.flaws))
    )
    blocks: list[PageBlock] = []
    reasons: dict[str, int] = {}
    for s in rejected:
        why = _why(s)
        reasons[why] = reasons.get(why, 0) + 1
    if reasons:
        blocks.append(
            Bullets(tuple(f"{n} rejected: {reason}" for reason, n in sorted(reasons.items(), key=lambda r: -r[1])))
        )
    outliers = [s.outlier for s in views if s.outlier]
    if len(outliers) > MANY_OUTLIERS:
        rest = len(outliers) - MANY_OUTLIERS
        outliers = [*outliers[:MANY_OUTLIERS], f"and {rest} more like these (all of them in the table)"]
    if outliers:
        blocks.append(Bullets(tuple(outliers)))
    if rows:
        steady = [4 + i for i, m in enumerate(metric_names) if m in ("overshoot", "settling_s", "steady_error")]
        detail = (3, *steady, len(columns) - 1)
        blocks.append(Table(columns, rows, align, fold=len(rows) > 12, detail=detail))  # type: ignore[arg-type]
    return Section("segments", "Responses", tuple(blocks), lead)


def _plural(words: str, count: int) -> str:
    if count == 1:
        return words
    head, space, tail = words.partition(" of ")
    return f"{head}s{space}{tail}"


def _metric(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else number(value, 3)


def _why(s: SegmentView) -> str:
    return "; ".join((*s.flaws, *s.notes))


def _state(s: SegmentView) -> tuple[Cell, str]:
    """In a word, and why."""
    if s.flaws:
        return Cell("rejected", "bad"), _why(s)
    if s.outlier:
        return Cell("outlying", "warn"), s.outlier
    return Cell("used", "good"), "; ".join(s.notes)


def fit_sections(view: FitView) -> tuple[Section, ...]:
    """All of them."""
    figure = figure4(view)
    found = [figure] if figure is not None else []
    found.append(parameter_section(view))
    if view.quality:
        found.append(quality(view))
    found += response_sections(view)
    if view.segments:
        cut = segments(view.segments)
        brief = "--all and `flighttest segment` list them."
        blocks = (replace(b, brief=brief) if isinstance(b, Table) else b for b in cut.blocks)
        found.append(replace(cut, blocks=tuple(blocks)))
    return tuple(found)
