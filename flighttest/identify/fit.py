"""`fit`: segments in, parameters with intervals and a verdict on each out.

Output error: penalised maximum likelihood of simulated responses.

found = fit(segments)                                  # the paper's model; attitude loops where there are attitude references
found.estimates["K"].interval_95
found = fit(segments, Model(("body", "linear_drag", "ground_effect")), ties={"d_y": "d_x"})
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import FitError, InputError
from flighttest.estimation.gauss_newton import FitStatus
from flighttest.estimation.level import level_notes, level_share
from flighttest.estimation.problem import Noise, Problem
from flighttest.estimation.responses import dead_channels, never_changing
from flighttest.estimation.solver import Solution, Start, finite_or_error, solve
from flighttest.estimation.uncertainty.closed_loop import closed_loop_bias
from flighttest.estimation.uncertainty.covariance import (
    Covariance,
    covariance_of,
    interval_factor,
    scatter_of,
    widened,
)
from flighttest.identify.dead_time import OnsetDelay, onset_delay, start_values
from flighttest.identify.diagnostics.identifiability import (
    Estimated,
    Known,
    ParameterDiagnostics,
    assumed_share,
    drag_without_velocity,
    hopeless,
    judge,
    throttle_varies,
    voltage_notes,
    voltage_spread_at_equal_throttle,
    voltage_varies,
)
from flighttest.identify.diagnostics.local_optima import best_of_starts, local_optima
from flighttest.identify.diagnostics.parameter_diagnostics import (
    FitChecks,
    differing_notes,
    parameter_diagnostics,
    step_sizes,
)
from flighttest.identify.diagnostics.quality import ChannelQuality, ValidRange, channel_quality, valid_range
from flighttest.identify.equality_constraints import TieTest, tie_tests
from flighttest.identify.selection import Select, moves, problem_of
from flighttest.physics.body import DELAY, DELAY_PARAM
from flighttest.physics.model import NOMINAL_VOLTAGE_V, Model, pack_voltage
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

_REPORTED_OUTLIER = 0.7  # responses weighted below this are named


@dataclass(frozen=True)
class Estimate:
    """One parameter, interval_95: its 95 % confidence interval. source: fit, frozen, tied, derived or assumed (nothing here depends on
    it); std and interval None where none was estimated; scatter: the part of std by which two fits of like flights differ, without what
    the equations may err; why and fly: what contradicts it and the maneuver script that would make it known, empty where it is known."""

    name: str
    symbol: str
    unit: str
    value: float
    std: float | None
    interval_95: tuple[float, float] | None
    source: str
    identifiable: bool
    why: str = ""
    fly: str = ""
    scatter: float | None = None


@dataclass(frozen=True)
class Outlier:
    """A response the fit weighted down: weight in 0..1 and the facts."""

    segment: str
    weight: float
    sentence: str


@dataclass(frozen=True)
class Fit:
    """What identification found. estimates: by name, T_d included; covariance over `covariance.names` (those estimated).

    delays_s: per channel (value, std); onset: the paper's estimate; quality: per channel; notes: cautions for the reader;
    checks: plain data of cross-checks made afterwards, for model.yaml's fit_quality.
    """

    model: Model
    status: FitStatus
    estimates: Mapping[str, Estimate]
    covariance: Covariance
    delays_s: Mapping[str, tuple[float, float]]
    onset: OnsetDelay | None
    noise: Noise
    quality: Mapping[str, ChannelQuality]
    valid: ValidRange
    outliers: tuple[Outlier, ...]
    ties: tuple[TieTest, ...]
    notes: tuple[str, ...]
    problem: Problem = field(repr=False)
    solution: Solution = field(repr=False)
    voltage_spread_v: float | None = None
    checks: FitChecks = field(default_factory=FitChecks)

    @property
    def values(self) -> dict[str, float]:
        """Every parameter of the model by name."""
        return dict(self.solution.values)

    @property
    def start(self) -> Start:
        """Where another fit of the same responses begins that is to stay with this one's optimum."""
        return Start(self.values, self.noise, self.problem.by_name(self.solution.local))

    @property
    def runs(self) -> tuple[str, ...]:
        """Names of the recordings used."""
        return tuple(dict.fromkeys(s.run for s in self.problem.segments))


def has_attitude_references(segments: Sequence[Segment]) -> bool:
    """Whether roll and pitch loops can be determined at all."""
    return any("roll_ref_rad" in s.u or "pitch_ref_rad" in s.u for s in segments if s.usable)


def default_model(segments: Sequence[Segment]) -> Model:
    """The model the paper would fit to these segments, at the nominal voltage of their battery."""
    read = [s.y["voltage_v"] for s in segments if s.usable and "voltage_v" in s.y]
    volts = pack_voltage(np.concatenate(read)) if read else None
    return Model(attitude_loops=has_attitude_references(segments), nominal_voltage_v=volts or NOMINAL_VOLTAGE_V)


def fit(
    segments: Sequence[Segment],
    model: Model | None = None,
    *,
    select: Select = "paper",
    start: Mapping[str, float] | Start | None = None,
    frozen: Mapping[str, float] | None = None,
    ties: Mapping[str, str] | None = None,
    robust: bool = True,
) -> Fit:
    """Estimate the model's parameters from usable segments of one or several recordings, jointly.

    start: values to start from, or another fit's `Start`, whose optimum it is to stay with; frozen: held there; ties: name to
    the name it equals (each tie is tested). FitError where nothing can be estimated.
    """
    segments = tuple(s for s in segments if s.usable)
    if not segments:
        raise FitError("no segment can be used", "see `flighttest segment` for why each was rejected")
    model = model or default_model(segments)
    _check_names(model, [*(frozen or {}), *(ties or {}), *(ties or {}).values()])
    onset = onset_delay(segments)
    given = start if isinstance(start, Start) else Start(start or {})
    begin = {**start_values(segments, model, onset), **given.values, **(frozen or {})}
    spread = voltage_spread_at_equal_throttle(segments)

    def stated(held: Sequence[str]) -> Problem:
        return problem_of(segments, model, select=select, values=begin, fixed=(*(frozen or {}), *held), ties=ties)

    def solved(problem: Problem) -> Solution:
        return best_of_starts(problem, robust, model.start(given.values), given)

    problem, solution, free_std = _of_what_is_determined(stated, solved, _not_moved(segments, model))
    solution, others = local_optima(problem, solution, robust)
    moved = closed_loop_bias(problem, solution)
    apart = {n: r.away(solution.values[n]) for n, r in others.items()}
    covariance = covariance_of(problem, solution)
    tilted = {"K": solution.values["K"] * level_share(problem, solution)}
    for extra in (apart, moved, tilted, _missing(covariance, free_std)):
        covariance = widened(covariance, extra)
    quality = channel_quality(problem, solution)
    diagnostics = parameter_diagnostics(problem, solution, covariance, quality, others, moved)
    if "alpha" not in (*covariance.names, *(frozen or {})):
        covariance = widened(covariance, {"K": solution.values["K"] * assumed_share(problem.segments, model)})
    estimates = _estimates(model, problem, solution, covariance, tuple(frozen or {}), spread, diagnostics)
    delays = {
        c: (estimates[n].value, estimates[n].std or float("nan"))
        for c, n in DELAY_PARAM.items()
        if n in estimates and estimates[n].source in ("fit", "frozen")
    }
    return Fit(
        model=model,
        status=solution.status,
        estimates=estimates,
        covariance=covariance,
        delays_s=delays,
        onset=onset,
        noise=solution.noise,
        quality=quality,
        valid=valid_range(problem),
        outliers=_outliers(problem, solution),
        ties=tie_tests(segments, model, select, solution, ties or {}, tuple(frozen or {}), robust),
        notes=(*_notes(problem, solution, model), *differing_notes(estimates, diagnostics, model)),
        problem=problem,
        solution=solution,
        voltage_spread_v=spread,
        checks=step_sizes(diagnostics),
    )


def _not_moved(segments: Sequence[Segment], model: Model) -> tuple[str, ...]:
    """Parameters whose input these responses do not move."""
    held = () if voltage_varies(segments, model.nominal_voltage_v) else ("alpha",)
    if all(s.steered for s in segments):  # what a pilot does about a gust is no sign of how the air drags
        held = (*held, *(n for n in drag_without_velocity(segments) if n in model.names))
    return held if throttle_varies(segments) else (*held, "sigma_t", "T_d_thrust")


def _of_what_is_determined(
    stated: Callable[[Sequence[str]], Problem], solved: Callable[[Problem], Solution], held: tuple[str, ...]
) -> tuple[Problem, Solution, dict[str, float]]:
    """A problem and its solution, with what turns out to be `hopeless` held beside `held`; and the others' standard errors before that: to
    hold one of two that take each other's place determines neither. A drag that grows with the thrust was 0.165 +- 0.003 s/m beside a
    linear drag held at -0.43 1/s, 0.097 +- 0.004 beside one of 0.20, and is 0.069 +- 0.067 with both free."""
    free_std: dict[str, float] = {}
    while True:
        problem = stated(held)
        solution = solved(problem)
        scatter = scatter_of(problem, solution)
        more = hopeless(solution, scatter)
        if not more or len(more) == len(scatter.names):
            return problem, solution, free_std
        # Beside an assumed alpha K is another quantity: the gain at the voltage flown.
        others = [n for n in scatter.names if n not in more and not (n == "K" and "alpha" in more)]
        free_std = {n: s for n, s in covariance_of(problem, solution).std.items() if n in others} | free_std
        held = (*held, *more)


def _missing(covariance: Covariance, std: Mapping[str, float]) -> dict[str, float]:
    """What the standard errors of a covariance lack of some that they are at least, by name."""
    return {n: math.sqrt(max(std[n] ** 2 - s**2, 0.0)) for n, s in covariance.std.items() if n in std}


def _check_names(model: Model, names: Sequence[str]) -> None:
    for name in names:
        if name not in model.names:
            raise InputError(f"the model has no parameter {name!r}", f"it has {', '.join(model.names)}")


def _estimates(
    model: Model,
    problem: Problem,
    solution: Solution,
    covariance: Covariance,
    frozen: tuple[str, ...],
    spread: float | None,
    diagnostics: Mapping[str, ParameterDiagnostics],
) -> dict[str, Estimate]:
    reveals = {p.name: t.reveals for t in model.built_terms for p in t.params}
    found: dict[str, Estimate] = {}
    std = np.sqrt(np.diag(covariance.matrix))
    correlation = covariance.matrix / np.outer(std, std) if std.size else covariance.matrix
    for param in model.params:
        name, value = param.name, solution.values[param.name]
        source_name = problem.ties.get(name, name)
        if name in frozen:
            found[name] = Estimate(
                name, param.symbol, param.unit, value, None, None, "frozen", False, "it was held at this value"
            )
            continue
        known_std, dof, interval, partner, scatter = None, math.inf, None, None, None
        if source_name in covariance.names:
            i = covariance.names.index(source_name)
            known_std, dof = covariance.of(np.eye(std.size)[i])
            half, scatter = interval_factor(dof) * known_std, float(std[i])
            interval = (max(value - half, param.lower), min(value + half, param.upper))
            other = np.abs(correlation[i]) * (np.arange(std.size) != i)
            if std.size > 1:
                j = int(np.argmax(other))
                partner = (covariance.names[j], float(correlation[i, j]))
        insensitive = source_name in solution.insensitive or source_name not in solution.free
        known = judge(
            param, Estimated(value, known_std, dof, insensitive, source_name in solution.at_bound, partner), spread, reveals.get(name, ""),
            diagnostics.get(source_name),
        )  # fmt: skip
        source = "assumed" if insensitive else "tied" if name in problem.ties else "fit"
        found[name] = Estimate(
            name, param.symbol, param.unit, value, known_std, interval, source, known.identifiable, known.why, known.fly,
            scatter,
        )  # fmt: skip
    if "T_d" not in found:
        found["T_d"] = mean_delay(found, covariance)
    return found


def mean_delay(found: Mapping[str, Estimate], covariance: Covariance) -> Estimate:
    """The paper's single delay: the mean of the channels' that were estimated."""
    names = [n for n in DELAY_PARAM.values() if n in found and found[n].source == "fit" and n in covariance.names]
    if not names:
        held = [n for n in DELAY_PARAM.values() if n in found]
        value = float(np.mean([found[n].value for n in held])) if held else DELAY.nominal
        if held and all(found[n].source == "frozen" for n in held):
            return Estimate("T_d", DELAY.symbol, "s", value, None, None, "frozen", False, found[held[0]].why)
        return Estimate(
            "T_d",
            DELAY.symbol,
            "s",
            value,
            None,
            None,
            "assumed",
            False,
            "no channel's delay could be estimated",
            "thrust",
        )
    weights = np.array([1.0 / len(names) if n in names else 0.0 for n in covariance.names])
    std, dof = covariance.of(weights)
    value = float(np.mean([found[n].value for n in names]))
    half = interval_factor(dof) * std
    missing = [n for n in DELAY_PARAM.values() if n in found and n not in names]
    known = judge(DELAY, Estimated(value, std, dof), None, "")
    doubted = [n for n in names if not found[n].identifiable]
    if doubted:
        known = Known(
            False, f"{' and '.join(doubted)} {'is' if len(doubted) == 1 else 'are'} not known", found[doubted[0]].fly
        )
    why = known.why or (f"mean without {', '.join(missing)}" if missing else "")
    return Estimate(
        "T_d",
        DELAY.symbol,
        "s",
        value,
        std,
        (max(value - half, DELAY.lower), min(value + half, DELAY.upper)),
        "derived",
        known.identifiable,
        why,
        known.fly,
        float(np.sqrt(weights @ covariance.matrix @ weights)),
    )


def _outliers(problem: Problem, solution: Solution) -> tuple[Outlier, ...]:
    found = []
    for i in np.flatnonzero(solution.response_weight < _REPORTED_OUTLIER):
        segment, weight = problem.segments[i], float(solution.response_weight[i])
        ratio = 2.5 / np.sqrt(weight)
        sentence = (
            f"{segment.name}: its residual is {ratio:.1f} times that of its like; counted with weight {weight:.2f}"
        )
        found.append(Outlier(segment.name, weight, sentence))
    return tuple(found)


def _notes(problem: Problem, solution: Solution, model: Model) -> tuple[str, ...]:
    notes = []
    if not model.attitude_loops:
        notes.append(
            "no attitude references were recorded: the attitude loops are left out, and the measured attitude drives thrust and drag"
        )
    every = dead_channels(problem.segments)
    dead = tuple(c for c in every if any(c in block.outputs for block in model.blocks))
    if dead:
        notes.append(f"{never_changing(dead)}: taken as not recorded")
    if "alpha" not in solution.free:
        notes += voltage_notes(problem.segments, model, "voltage_v" in every)
    outputs = {c for part in problem.parts for c in part.outputs}
    fed = {part.block.name for part in problem.parts}
    if "translation" in fed:
        if not any(c.startswith("v_") for c in outputs):
            notes.append(
                "velocity was not recorded: drag rests on accelerations alone, and wind cannot be determined from it"
            )
        if not any(c.startswith("f_") for c in outputs):
            notes.append("specific force was not recorded: thrust and drag rest on velocity and its derivative")
        if not any(np.isfinite(s.y.get("voltage_v", np.nan)).any() for s in problem.segments):
            notes.append(
                "battery voltage was not recorded: alpha cannot be identified, and K is the gain at the voltage flown"
            )
    notes += level_notes(problem.segments, level_share(problem, solution))
    for block in model.blocks:
        if block.name not in fed:
            moved = any(moves(s, block) for s in problem.segments)
            why = "the channel that responds to it was not recorded" if moved else "no response has one"
            notes.append(f"{block.name.replace('_', ' ')} command: {why}, and its parameters keep the values assumed")
    return tuple(notes)


def heldout(found: Fit, segments: Sequence[Segment], select: Select = "paper") -> tuple[Problem, Solution]:
    """A fit's parameters on segments it has not seen: only initial states and disturbances are estimated there."""
    problem = problem_of(segments, found.model, select=select, values=found.values)
    noise = Noise(found.noise.channel, found.noise.disturbance)  # samples count alike: each shows how a flight began
    return problem, finite_or_error(solve(problem, Start(noise=noise), free=(), robust=False, estimate_noise=False))
