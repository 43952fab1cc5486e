"""From what was found to what the pages show: words and order, and why a fit determines nothing; every number
was computed in `identify`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import isfinite

from flighttest.channels import CHANNELS, WORDS
from flighttest.identify.diagnostics.identifiability import correlated_parameters
from flighttest.identify.fit import Estimate, Fit
from flighttest.identify.response_analysis.comparison import fitted_responses, response_overlays, thrust_points
from flighttest.identify.response_analysis.frequency_response import frequency_responses, residual_correlations
from flighttest.identify.validation.accumulation import accumulations
from flighttest.physics.model import Model
from flighttest.report.document import Bullets, Section
from flighttest.report.fit_views import FitView, ParameterView, QualityView, SegmentView
from flighttest.report.numbers import join, number, percent, unit
from flighttest.report.sections.fit import KIND_WORDS
from flighttest.segments import Metrics, Segment, metrics_of

METRICS = tuple(f.name for f in fields(Metrics) if f.name != "channel")
CORRELATED = 0.9
DETERMINED_R2 = 0.05
MOST_REASONS = 6


def fit_view(found: Fit, segments: Sequence[Segment]) -> FitView:
    """A fit as it is shown. segments: all of them, rejected ones too."""
    parameters = tuple(_parameter(found.model, e) for e in found.estimates.values())
    unknown = [e.name for e in found.estimates.values() if not e.identifiable and e.source != "frozen"]
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
        overlays=response_overlays(found),
        thrust_points=thrust_points(found),
        segments=segment_views(segments, {o.segment: o.sentence for o in found.outliers}),
        correlations=correlated_parameters(found.covariance, CORRELATED),
        correlation_above=CORRELATED,
        quality=quality,
        notes=notes,
        warnings=warnings,
        responses=fitted_responses(found),
        residual_correlations=residual_correlations(found),
        loops=frequency_responses(found),
        trajectories=accumulations(found),
    )


def _warnings(found: Fit) -> tuple[str, ...]:
    """The reasons against each parameter; those with the same reason, in one sentence."""
    blind = [e.name for e in found.estimates.values() if e.std is None and e.source == "assumed" and e.why]
    lines = [f"nothing in these recordings determines {join(blind)}"] if blind else []
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
    """The one number for how good the model is at what it is for: thrust and attitude, as shares explained."""
    # A channel that hardly moved is noise about its mean, of which there is nothing to explain.
    shares = {c: q.r2 for c, q in found.quality.items() if isfinite(q.r2) and q.r2 > DETERMINED_R2}
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


def why_nothing(found: Fit, runs: Sequence[str]) -> Section | None:
    """What was flown, the reasons shared by most parameters, and what to fly. None where any parameter is known."""
    doubtful = [e for e in found.estimates.values() if e.source != "frozen"]
    if any(e.identifiable for e in doubtful) or not doubtful:
        return None
    lines = [_flown(found), *_reasons(doubtful)]
    scripts = list(dict.fromkeys(e.fly for e in doubtful if e.fly))
    if scripts:
        lines.append(
            f"steps that determine them: `flighttest run {' '.join(scripts)}` flies them (with --vehicle and --connect, on this vehicle)"
        )
    lines.append(f"what the model misses: `flighttest diagnose {' '.join(runs)}`")
    return Section("why", "Why nothing is known", (Bullets(tuple(lines)),))


def _flown(found: Fit) -> str:
    segments = found.problem.segments
    counts: dict[str, int] = {}
    for s in segments:
        counts[s.kind] = counts.get(s.kind, 0) + 1
    kinds = [f"{n} x {KIND_WORDS.get(kind, kind)}" for kind, n in sorted(counts.items(), key=lambda row: -row[1])]
    seconds = sum(float(s.t_s[-1] - s.t_s[0]) for s in segments)
    return f"it rests on {number(seconds, 3)} s: {join(kinds)}"


def _reasons(doubtful: Sequence[Estimate]) -> list[str]:
    """Parameters by their reason, the reason of most first; those with a reason of their own by their errors."""
    alike: dict[str, list[Estimate]] = {}
    for e in doubtful:
        alike.setdefault("no segment determines them" if e.source == "assumed" else e.why, []).append(e)
    shared = sorted((row for row in alike.items() if len(row[1]) > 1), key=lambda row: -len(row[1]))
    single = [members[0] for _, members in alike.items() if len(members) == 1]
    wide = [e for e in single if e.std is not None]
    lines = [f"{join([e.name for e in members])}: {why}" for why, members in shared]
    lines += [f"{e.name}: {e.why}" for e in single if e.std is None]
    if wide:
        words = ", ".join(
            f"{e.name} {number(e.value, 2)} ± {number(e.std or 0.0, 2)} {unit(e.unit)}".strip() for e in wide
        )
        lines.insert(min(len(lines), MOST_REASONS - 1), f"too wide or in doubt, each for the reason below: {words}")
    rest = len(lines) - MOST_REASONS
    return lines if rest <= 0 else [*lines[:MOST_REASONS], f"and {rest} more below the table"]
