"""From what was found to what the pages show: the few numbers a picture needs are made here, never in `report`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS, WORDS
from flighttest.estimation.problem import Part, PartEvaluation
from flighttest.frames import G_M_S2
from flighttest.identify.fit import Estimate, Fit
from flighttest.physics.model import Model
from flighttest.pipeline.presenters.response_views import correlations, loops, response_views
from flighttest.report.numbers import join, number, percent
from flighttest.report.views import FitView, Overlay, ParameterView, QualityView, SegmentView, ThrustPoint
from flighttest.segments import Metrics, Segment, metrics_of

FloatArray = NDArray[np.float64]

METRICS = tuple(f.name for f in fields(Metrics) if f.name != "channel")
CORRELATED = 0.9
MAX_OVERLAYS = 40  # per kind: more lines than that are a grey cloud, and megabytes of page
TOLD_R2 = 0.05
SETTLED_SHARE = 0.3  # the last part of a throttle response that counts as settled
_SPECIFIC_FORCE = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")


def fit_view(found: Fit, segments: Sequence[Segment]) -> FitView:
    """A fit as it is shown. segments: all of them, rejected ones too."""
    parameters = tuple(_parameter(found.model, e) for e in found.estimates.values())
    unknown = [p.name for p in parameters if p.word in ("weak", "not identifiable")]
    quality = tuple(
        QualityView(
            WORDS.get(c, c),
            CHANNELS[c].unit,
            q.rmse,
            q.floor,
            q.r2,
            q.autocorrelation < 0.2 or q.rmse < 1.5 * q.floor,
            q.sentence,
        )
        for c, q in found.quality.items()
    )
    warnings = _warnings(found)
    notes = (*found.notes, *(t.sentence for t in found.ties), *(() if found.onset is None else (_onset(found),)))
    return FitView(
        verdict=_verdict(found, unknown),
        good=found.status.good,
        parameters=parameters,
        overlays=overlays(found),
        thrust_points=thrust_points(found),
        segments=segment_views(segments, {o.segment: o.sentence for o in found.outliers}),
        correlations=_correlations(found),
        correlation_above=CORRELATED,
        quality=quality,
        notes=notes,
        warnings=warnings,
        responses=response_views(found),
        residual_correlations=correlations(found),
        loops=loops(found),
    )


def _warnings(found: Fit) -> tuple[str, ...]:
    """What speaks against each parameter; those of which the same is said in one sentence."""
    blind = [e.name for e in found.estimates.values() if e.std is None and e.source == "assumed" and e.why]
    lines = [f"nothing in these recordings tells {join(blind)}"] if blind else []
    alike: dict[str, list[str]] = {}
    for e in found.estimates.values():
        if e.why and e.name not in blind:
            alike.setdefault(e.why, []).append(e.name)
    return (*lines, *(f"{join(names)}: {why}" for why, names in alike.items()))


def _parameter(model: Model, e: Estimate) -> ParameterView:
    param = model.param.get(e.name)
    if e.source == "frozen":
        word = "held"
    elif e.identifiable:
        word = "known"
    else:
        word = "weak" if e.std is not None else "not identifiable"
    low, high = e.interval_95 if e.interval_95 is not None else (None, None)
    remedy = f"fly {e.fly}" if e.fly and word not in ("known", "held") else ""
    doc = param.doc if param is not None else "command to first effect, mean of the channels"
    return ParameterView(e.name, e.unit, e.value, e.std, low, high, e.identifiable, word, remedy, e.source, doc)


def _verdict(found: Fit, unknown: Sequence[str]) -> str:
    used = len(found.problem.segments)
    head = f"{used} response{'s' if used != 1 else ''} fitted"
    if not found.status.good:
        return f"{head}, but {found.status.value}."
    total = len(found.estimates)
    if not unknown:
        return f"{head}; all {total} parameters are known. {_accuracy(found)}".strip()
    if len(unknown) == total:
        return f"{head}; none of the {total} parameters is known. {_accuracy(found)}".strip()
    known = total - len(unknown)
    count = f"{known} of {total} parameters {'is' if known == 1 else 'are'} known"
    if len(unknown) <= 6:
        count += f"; {join(list(unknown))} {'is' if len(unknown) == 1 else 'are'} not"
    return f"{head}: {count}. {_accuracy(found)}".strip()


def _accuracy(found: Fit) -> str:
    """The one number that says how good the model is at what it is for: thrust and attitude, as shares explained."""
    # A channel that hardly moved is noise about its mean, of which there is nothing to explain.
    shares = {c: q.r2 for c, q in found.quality.items() if np.isfinite(q.r2) and q.r2 > TOLD_R2}
    named = [
        (w, shares[c])
        for c, w in (("f_z_m_s2", "thrust"), ("roll_rad", "roll"), ("r_rad_s", "yaw rate"))
        if c in shares
    ]
    if not named:
        return ""
    return "The model explains " + join([f"{percent(r2, 2)} of {w}" for w, r2 in named]) + "."


def _onset(found: Fit) -> str:
    assert found.onset is not None
    onset = found.onset
    return f"the paper's onset estimate of T_d is {number(onset.mean_s * 1000, 3)} ms (biased late); the table has the joint estimate"


def _correlations(found: Fit) -> tuple[tuple[str, str, float], ...]:
    matrix, names = found.covariance.matrix, found.covariance.names
    std = np.sqrt(np.diag(matrix))
    strong = []
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            c = float(matrix[i, j] / (std[i] * std[j])) if std[i] > 0 and std[j] > 0 else 0.0
            if abs(c) >= CORRELATED:
                strong.append((names[i], names[j], c))
    return tuple(sorted(strong, key=lambda s: -abs(s[2])))


def overlays(found: Fit) -> tuple[Overlay, ...]:
    """Measured and simulated responses, at most `MAX_OVERLAYS` per kind, spread over the cells."""
    made: list[Overlay] = []
    for part, evaluation in zip(found.problem.parts, found.solution.evaluations, strict=True):
        for j, response in enumerate(part.responses):
            segment = found.problem.segments[response.index]
            made += _overlays_of(part, evaluation, j, segment)
    return tuple(_thinned(made))


def _overlays_of(part: Part, made: PartEvaluation, j: int, segment: Segment) -> list[Overlay]:
    t = part.responses[j].t_s
    n = t.size
    wanted = {"roll_step": "roll_rad", "pitch_step": "pitch_rad", "yaw_rate_step": "r_rad_s"}.get(segment.kind)
    since = t - segment.t_step_s
    if wanted in part.outputs:
        k = part.outputs.index(wanted)
        measured = np.where(part.mask[j, :n, k], part.y[j, :n, k], np.nan)
        return [
            Overlay(
                segment.name, segment.kind, segment.cell, wanted, since, measured, measured - made.residual[j, :n, k]
            )
        ]
    if segment.kind in ("throttle_step", "tilt_throttle", "free") and all(c in part.outputs for c in _SPECIFIC_FORCE):
        both = _vertical(part, made, j, segment)
        if both is not None:
            return [Overlay(segment.name, segment.kind, segment.cell, "a_z_m_s2", since, *both)]
    return []


def _vertical(part: Part, made: PartEvaluation, j: int, segment: Segment) -> tuple[FloatArray, FloatArray] | None:
    """Measured and simulated world a_z of one response, from the body specific force and the measured attitude."""
    roll, pitch = segment.y.get("roll_rad"), segment.y.get("pitch_rad")
    n = part.responses[j].t_s.size
    if roll is None or pitch is None or roll.size != n:
        return None
    index = [part.outputs.index(c) for c in _SPECIFIC_FORCE]
    up = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    f = np.where(part.mask[j, :n][:, index], part.y[j, :n][:, index], np.nan)
    measured = (up * f).sum(axis=1) - G_M_S2
    simulated = (up * (f - made.residual[j, :n][:, index])).sum(axis=1) - G_M_S2
    return measured, simulated


def _thinned(made: Sequence[Overlay]) -> list[Overlay]:
    kept: list[Overlay] = []
    for kind in dict.fromkeys(o.kind for o in made):
        mine = [o for o in made if o.kind == kind]
        step = max(1, -(-len(mine) // MAX_OVERLAYS))
        kept += mine[::step]
    return kept


def thrust_points(found: Fit) -> tuple[ThrustPoint, ...]:
    """Settled acceleration over voltage, per throttle response."""
    points = []
    for part, made in zip(found.problem.parts, found.solution.evaluations, strict=True):
        if not all(c in part.outputs for c in _SPECIFIC_FORCE):
            continue
        for j, response in enumerate(part.responses):
            segment = found.problem.segments[response.index]
            volts = segment.y.get("voltage_v")
            if segment.kind != "throttle_step" or volts is None:
                continue
            both = _vertical(part, made, j, segment)
            if both is None:
                continue
            late = response.t_s > response.t_s[-1] - SETTLED_SHARE * (response.t_s[-1] - segment.t_step_s)
            late &= np.isfinite(both[0]) & np.isfinite(volts)
            if late.sum() >= 3:
                points.append(
                    ThrustPoint(
                        segment.cell,
                        float(volts[late].mean()),
                        float(both[0][late].mean()),
                        float(both[1][late].mean()),
                    )
                )
    return tuple(points)


def metrics(segment: Segment) -> dict[str, float | None]:
    """Rise, overshoot and the like of a step by name; empty where there is none."""
    found = metrics_of(segment)
    return {} if found is None else {name: getattr(found, name) for name in METRICS}


def segment_views(segments: Sequence[Segment], outliers: Mapping[str, str] | None = None) -> tuple[SegmentView, ...]:
    """Every segment as a row, with its step's metrics."""
    return tuple(
        SegmentView(
            s.name,
            s.run,
            s.kind,
            s.cell,
            s.repeat,
            tuple(f.value for f in s.flaws),
            tuple(s.notes),
            metrics(s),
            (outliers or {}).get(s.name, ""),
        )
        for s in segments
    )
