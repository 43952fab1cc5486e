"""The next flight, one that would decide: shipped maneuvers are rehearsed with the fitted model, and the one whose data would separate
the rivals best, or show best what could not be seen, is written as a script.

Nothing in the recordings prefers either answer now (else there were no question): odds of 1 to 1. The expected odds are those of the
information the rehearsed data would carry: half the squared length of what of the effect no rival and no base parameter can copy, in noise
standard deviations, correlation taken into account, as odds to one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import yaml

from flighttest.diagnose.model import brief
from flighttest.diagnose.records import NextReason
from flighttest.diagnose.selection.candidates import null_value
from flighttest.diagnose.selection.comparison import Fitted
from flighttest.diagnose.selection.search import Search
from flighttest.documents import write_text
from flighttest.errors import FlighttestError
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.likelihood_weights import start_noise
from flighttest.estimation.linearisation import Optimum, orthonormal
from flighttest.estimation.problem import Noise, Problem
from flighttest.identify.selection import able
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.physics.simulate import Edges, Run, simulate_many
from flighttest.script.load import parse_script
from flighttest.script.model import Script, ScriptData
from flighttest.script.profiles import PROFILES, Piece, StepCell, Timeline
from flighttest.script.shipped import resolve, shipped_names
from flighttest.segments.model import Segment

RATE_HZ = 50.0
MOST_CELLS = 12
MOST_REPEATS = 4
MOST_TRIED = 3  # maneuvers rehearsed per question: those that the terms name, then the general ones
SURE = 1000.0  # odds above it are given as such: what a rehearsal leaves out weighs more
STOP_S = 0.4
UNRECORDED = 1e9  # standard deviation of a channel, SI, without information
CORRELATED = 10.0  # real residuals are correlated over several samples; rehearsed ones are not
TRIED = ("headings", "speed_dash", "two_heights", "tilt_throttle", "lateral_stop", "thrust_hover", "roll_pitch")


# A script's data, the model and its values to the script as it can be flown and its size (share of the shipped one), None where it cannot.
Flyable = Callable[[ScriptData, Model, Mapping[str, float]], tuple[ScriptData, float] | None]


@dataclass(frozen=True)
class Question:
    """What the next flight is for: a term, and the rival it must be distinguished from (None: to see the term at all)."""

    term: Term
    rival: Term | None
    size: Mapping[str, float]


def as_shipped(script: ScriptData, _model: Model, _values: Mapping[str, float]) -> tuple[ScriptData, float] | None:
    """Where no zone is known: any script, as it is."""
    return script, 1.0


def propose(
    search: Search,
    questions: Sequence[Question],
    values: Mapping[str, float],
    fits: Callable[[ScriptData], tuple[ScriptData, float] | None],
    *,
    inside: bool = True,
) -> tuple[NextReason, ScriptData] | None:
    """The maneuver with the best odds for the first question that any can answer: why, and the script. None when none can. fits: as
    `Flyable`, of the whole model: a search has that of one block. inside: only of those that can be flown in the vehicle's zone; else also
    of the others, for a larger zone."""
    assert search.now is not None
    for question in questions:
        names = dict.fromkeys([question.term.reveals, *([question.rival.reveals] if question.rival else []), *TRIED])
        best: tuple[bool, float, str, ScriptData, float] | None = None
        for name in [n for n in names if n in shipped_names()][:MOST_TRIED]:
            try:
                shipped = yaml.safe_load(resolve(name).read_text(encoding="utf-8"))
                fitted = fits(shipped)
                if fitted is None and inside:
                    continue
                made, size = fitted or (shipped, 1.0)
                segments = rehearsed(
                    parse_script(write_text(made), name), search.now.model, values, search.estimator.segments
                )
                odds = log_odds(segments, search.now, search.estimator.block, question)
            except (FlighttestError, np.linalg.LinAlgError):
                continue  # a maneuver this model cannot rehearse is no proposal
            if odds > 1.0 and (best is None or (fitted is not None, odds) > best[:2]):
                best = fitted is not None, odds, name, made, size
        if best is not None:
            return _proposal(question, best[2], best[1], best[3], best[4])
    return None


def _proposal(
    question: Question, name: str, odds: float, made: ScriptData, size: float
) -> tuple[NextReason, ScriptData]:
    rival = question.rival.id if question.rival else None
    aim = f"to separate {question.term.id} from {rival}" if rival else f"to see whether there is {question.term.id}"
    to_one = math.exp(min(odds, 23.0))
    worth = f"{brief(to_one)} to 1" if to_one < SURE else f"more than {SURE:.0f} to 1"
    how = name if size == 1.0 else f"{name} at {100 * size:.0f} % of its size, to fit the zone"
    script: ScriptData = {**made, "name": "next", "doc": f"{how}, {aim}; odds now 1 to 1, expected after it {worth}"}
    reason: NextReason = {
        "maneuver": name,
        "separates": [question.term.id, *([rival] if rival else [])],
        "size": size,
        "odds_now": 1.0,
        "expected_odds": to_one,
        "sentence": f"Fly {how}, {aim}: odds now 1 to 1, expected after it {worth}.",
    }
    return reason, script


def distinct_cells(script: Script, throttle_unit: float) -> list[StepCell]:
    """Distinct steps of a script, at most a dozen, spread over it."""
    found = [
        c
        for m in script.steps
        for c in PROFILES[m.profile].cells(m.settings, throttle_unit)
        if c.lead and not c.waypoints
    ]
    found = [c for c in found if not c.motors_off]
    if len(found) <= MOST_CELLS:
        return found
    return [found[int(i)] for i in np.linspace(0, len(found) - 1, MOST_CELLS)]


def rehearsed(
    script: Script, model: Model, values: Mapping[str, float], flown: Sequence[Segment]
) -> tuple[Segment, ...]:
    """What the script's steps would record, as the model has it; voltage as in the segments already flown."""
    hover = float(model.hover_throttle(values, model.nominal_voltage_v))
    volts = [float(np.nanmean(s.y["voltage_v"])) for s in flown if "voltage_v" in s.y] or [model.nominal_voltage_v]
    headings = script.reset.heading_rad or (0.0,)
    unit = hover if script.throttle_unit == "hover" else 1.0
    planned = []
    for repeat in range(min(script.repeat.each, MOST_REPEATS)):
        for k, cell in enumerate(distinct_cells(script, unit)):
            voltage = float(np.quantile(volts, (repeat + 0.5) / max(script.repeat.each, 1)))
            step = _Step(script, cell, k, repeat, headings[repeat % len(headings)], voltage)
            planned.append(_planned(step, model, values))
    runs = [Run(s.t_s, start, s.u, signals) for s, start, signals in planned]
    return tuple(
        replace(s, y={**y, **s.y, "height_m": y["p_z_m"]})
        for (s, _, _), y in zip(planned, simulate_many(model, values, runs), strict=True)
    )


@dataclass(frozen=True)
class _Step:
    """One planned step: the k-th cell of a script, in one of its repeats, at a heading (rad) and a battery voltage (V)."""

    script: Script
    cell: StepCell
    k: int
    repeat: int
    heading_rad: float
    voltage_v: float


def _planned(
    planned: _Step, model: Model, values: Mapping[str, float]
) -> tuple[Segment, dict[str, float], dict[str, Edges]]:
    """One step as it would be recorded, but for what the vehicle does; where it starts, and the signals besides the references."""
    script, cell, k, repeat = planned.script, planned.cell, planned.k, planned.repeat
    heading, voltage = planned.heading_rad, planned.voltage_v
    level = float(model.hover_throttle(values, voltage))
    pieces: list[Piece] = list(cell.lead)
    if cell.counter is not None:
        c = cell.counter
        pieces.append(Piece(c.name, STOP_S, c.roll_rad, c.pitch_rad, c.yaw_rate_rad_s, c.throttle))
    pieces += [p for p in cell.tail if p.duration_s > 0]
    line = Timeline(tuple(pieces), level, "angle_boost" in model.terms)
    t = np.arange(0.0, max(line.duration_s, 0.6), 1.0 / RATE_HZ)
    targets = [line(float(x)) for x in t]
    table = {
        "roll_ref_rad": [x.roll_rad for x in targets], "pitch_ref_rad": [x.pitch_rad for x in targets],
        "yaw_rate_ref_rad_s": [x.yaw_rate_rad_s for x in targets], "throttle": [x.throttle for x in targets],
    }  # fmt: skip
    begin = np.concatenate([[-1.0], t])
    u = {n: (begin, np.array([v[0], *v])) for n, v in table.items()}
    height = cell.height_m if cell.height_m is not None else script.reset.to_m[2]
    start = {"p_z_m": height, "yaw_rad": heading, "a_t_m_s2": model.g_m_s2 * targets[0].throttle / level}
    step = float(next((sum(q.duration_s for q in pieces[:i]) for i, q in enumerate(pieces) if q.record), 0.0))
    at_step, ends = 30.0 + 8.0 * k + 120.0 * repeat, t[[0, -1]]
    signals = {"voltage_v": (ends, np.full(2, voltage)), "time_s": (ends, at_step + ends - step)}
    segment = Segment(
        name=f"{script.name}-{k}-{repeat}", run="rehearsal", kind=cell.kind, cell=cell.values, repeat=repeat, t_step_s=step, t_s=t,
        y={"voltage_v": np.full(t.size, voltage)}, u=u, maneuver=script.name, heading_rad=heading, time_since_takeoff_s=at_step,
    )  # fmt: skip
    return segment, start, signals


def with_unrecorded(noise: Noise, problem: Problem) -> Noise:
    """The noise, and of channels that no sensor there was recorded one so large that they contain no information."""
    usual = start_noise(problem)
    unrecorded = {c: UNRECORDED for c in usual.channel if c not in noise.channel}
    return Noise({**unrecorded, **noise.channel}, {**usual.disturbance, **noise.disturbance})


def log_odds(segments: tuple[Segment, ...], now: Fitted, block: str, question: Question) -> float:
    """Information in nats about the question that this data would carry, recorded with the sensors there were."""
    noise = now.at.noise.channel
    recorded = [{c: v for c, v in s.y.items() if c in noise or c[:2] not in ("f_", "a_", "v_")} for s in segments]
    segments = tuple(replace(s, y=y) for s, y in zip(segments, recorded, strict=True))
    estimator = Estimator(segments, block, able)
    rivals = [t for t in (question.rival,) if t is not None and t.id not in now.model.terms]
    model = now.model.with_terms(*([question.term] if question.term.id not in now.model.terms else []), *rivals)
    if not estimator.problem(model).parts:
        return 0.0
    at = Optimum(
        {**model.start(), **now.at.values}, {}, with_unrecorded(now.at.noise, estimator.problem(model)), np.inf
    )
    null = {p.name: null_value(p) for t in (question.term, *rivals) for p in t.amplitudes}
    size = {**null, **dict(question.size)}
    known = estimator.problem(model).names
    own = [p.name for p in question.term.params if p.name in known]
    others = [n for n in known if n not in own]
    there = estimator.moved(model, at, size)
    rows = estimator.linearise(model, there, tuple(known))
    if question.term.amplitudes:
        coefficients = [p for p in question.term.amplitudes if p.name in known]
        effect = rows.columns([p.name for p in coefficients]) @ np.array(
            [size[p.name] - null_value(p) for p in coefficients]
        )
    else:
        without = model.without_terms(question.term.id)
        effect = -rows.profiled(next(estimator.differences(model, there, [(without, None)])))[:, 0]
    basis = orthonormal(rows.columns(others))
    left = effect - basis @ (basis.T @ effect)
    return 0.5 * float(left @ left) / CORRELATED
