"""What a planned script would make known: expected standard errors from the prior model's Fisher information.

Each leg is flown by the prior model; the sensitivities of what would be measured give the information each response carries, with its own
initial state and disturbance unknown, as in the fit; the inverse of the summed information matrix is a lower bound of the
covariance (Cramér-Rao, or Cramer-Rao). The numbers rest on the noise assumed (`ASSUMED`) and on the prior parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import INPUTS
from flighttest.estimation.likelihood_weights import LikelihoodWeights, State
from flighttest.estimation.linearisation import inverse_of_gram
from flighttest.estimation.problem import Noise, Problem
from flighttest.identify.diagnostics.parameter_diagnostics import responses_informing
from flighttest.identify.selection import able, problem_of, segments_for
from flighttest.physics.body import DELAY_PARAM
from flighttest.physics.model import PAPER_TERMS, Model
from flighttest.physics.simulate import Run, simulate_many
from flighttest.physics.stepping import RESOLVED
from flighttest.plan.model import AttitudeTarget, Leg, Plan
from flighttest.script.profiles import Timeline
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

BEFORE_S = 0.4
# Steps in which a planned response is flown: what it would measure need not be known to a hair.
PLANNED_STEP_S = 0.0201
AFTER_S = 0.4
# Noise of a usual outdoor vehicle: samples, and what is constant over a response (gusts).
ASSUMED = Noise(
    {
        "roll_rad": 0.004, "pitch_rad": 0.004, "r_rad_s": 0.02, "f_x_m_s2": 0.3, "f_y_m_s2": 0.3, "f_z_m_s2": 0.3,
        "v_x_m_s": 0.08, "v_y_m_s": 0.08, "v_z_m_s": 0.08, "a_x_m_s2": 0.3, "a_y_m_s2": 0.3, "a_z_m_s2": 0.3,
    },
    {
        "roll_d_rad": 0.003, "pitch_d_rad": 0.003, "yaw_rate_d_rad_s": 0.01,
        "a_d_x_m_s2": 0.15, "a_d_y_m_s2": 0.15, "a_d_z_m_s2": 0.15,
    },
)  # fmt: skip


@dataclass(frozen=True)
class Expected:
    """One parameter: expected standard error, the same with twice the repeats, and the steps with most information on it.

    std is None where the script contains no information on it; best: (cell in words, share of the information), best first;
    responses: how many hold information on it (`responses_informing`).
    """

    name: str
    unit: str
    value: float
    std: float | None
    std_twice: float | None
    best: tuple[tuple[str, float], ...]
    sentence: str
    responses: int = 0


@dataclass(frozen=True)
class PlannedInformation:
    """The information of the responses of one plan, each in terms of the free parameters of all plans.

    steps: their segments, without samples (n,); able: block name to the positions of those in which its references move; information:
    block name to Fisher information (n, p, p) by `model.names`, zero for a response that feeds the block in no company.
    """

    steps: tuple[Segment, ...]
    able: Mapping[str, Sequence[int]]
    information: Mapping[str, FloatArray]


def planned_information(
    plans: Sequence[Plan], model: Model, values: Mapping[str, float], noise: Noise = ASSUMED
) -> list[PlannedInformation]:
    """The information of each plan: every flight is flown and differentiated once (see `_planned`). Legs without a profile (waypoints,
    motors off) are left out."""
    groups, flights = _planned(plans, model, values)
    every = [segment for group in groups for segment in group]
    starts = np.cumsum([0, *(len(group) for group in groups)]).tolist()
    of_flight = dict(zip(flights, every, strict=True))
    can = [{b.name: able(group, b) for b in model.blocks} for group in groups]
    fed: dict[str, set[int]] = {b.name: set() for b in model.blocks}
    for start, group, of in zip(starts, groups, can, strict=False):
        for block in model.blocks:
            # In more company a response feeds what it feeds here, or less; but free flight is called in where there are few steps.
            free = [i for i in of[block.name] if group[i].kind == "free"]
            fed[block.name] |= {
                flights[start + i] for i in (*segments_for(group, block, "paper", of[block.name]), *free)
            }
    p = len(model.names)
    information = {b.name: np.zeros((len(every), p, p)) for b in model.blocks}
    if every:
        # In a flight that only hovers nothing changes, and yet it would be measured.
        problem = Problem.build([of_flight[i] for i in range(len(of_flight))], model, values=values, fed=fed, dead=())
        at = [model.names.index(n) for n in problem.names]
        for name, of_block in _information(problem, noise).items():
            information[name][:, np.array(at)[:, None], at] = of_block[flights]
    return [
        PlannedInformation(
            tuple(replace(s, t_s=s.t_s[:0], y={}, u={}) for s in group),
            of,
            {name: each[start : start + len(group)] for name, each in information.items()},
        )
        for start, group, of in zip(starts, groups, can, strict=False)
    ]


def expected_of_information(
    planned: Sequence[PlannedInformation], model: Model, values: Mapping[str, float]
) -> tuple[Expected, ...]:
    """Expected standard error of every parameter from plans flown together; empty where nothing in them can be predicted.

    Information adds up; which steps feed which part of the model depends on what else there is.
    """
    steps = [step for one in planned for step in one.steps]
    starts = np.cumsum([0, *(len(one.steps) for one in planned)]).tolist()
    hessian = np.zeros((len(steps), len(model.names), len(model.names)))
    for block in model.blocks if steps else ():
        can = [start + i for start, one in zip(starts, planned, strict=False) for i in one.able[block.name]]
        members = np.array(sorted(segments_for(steps, block, "paper", can)), dtype=np.intp)
        hessian[members] += np.concatenate([one.information[block.name] for one in planned])[members]
    return _expected(model.names, hessian, steps, model, values)


def _information(problem: Problem, noise: Noise) -> dict[str, FloatArray]:
    """Fisher information of each segment by the problem's names, (n_segments, p, p), apart for each block it feeds."""
    found = {
        part.block.name: np.zeros((len(problem.segments), len(problem.names), len(problem.names)))
        for part in problem.parts
    }
    theta = np.array([problem.values[n] for n in problem.names])
    for part in problem.parts:
        for alike in part.by_length():
            one = replace(problem, parts=(alike,))
            local = [alike.start_local()]
            at = State(theta, local, one.evaluate(problem.values, local, problem.names))
            normal, _ = LikelihoodWeights.even(one, noise, robust=False).normal_equations(at, problem.names)
            found[part.block.name] += normal.hessian
    return found


def expected_of(
    segments: Sequence[Segment], model: Model, values: Mapping[str, float], noise: Noise = ASSUMED
) -> tuple[Expected, ...]:
    """The same for responses given as segments (measured or simulated)."""
    problem = problem_of(segments, model, values=values)
    hessian = np.sum(list(_information(problem, noise).values()), axis=0)
    return _expected(problem.names, hessian, problem.segments, model, values)


def _expected(
    names: tuple[str, ...],
    hessian: FloatArray,
    segments: Sequence[Segment],
    model: Model,
    values: Mapping[str, float],
) -> tuple[Expected, ...]:
    if not segments:
        return ()
    covariance, usable = _inverse(hessian)
    responses = responses_informing(hessian)
    twice, _ = _inverse(2.0 * hessian)
    found = []
    for param in model.params:
        name = param.name
        if name not in names or not usable[names.index(name)]:
            sentence = f"{name}: this script contains no information on it"
            found.append(Expected(name, param.unit, values[name], None, None, (), sentence))
            continue
        i = names.index(name)
        std, more = float(np.sqrt(covariance[i, i])), float(np.sqrt(twice[i, i]))
        best = _best(hessian, covariance, i, segments)
        sentence = _sentence(name, param.unit, values[name], std)
        found.append(Expected(name, param.unit, values[name], std, more, best, sentence, int(responses[i])))
    delays = [names.index(n) for n in DELAY_PARAM.values() if n in names]
    delays = [i for i in delays if usable[i]]
    if delays and model.channel_delays:
        weight = np.zeros(len(names))
        weight[delays] = 1.0 / len(delays)
        std = float(np.sqrt(weight @ covariance @ weight))
        value = float(np.mean([values[names[i]] for i in delays]))
        fewest = int(responses[delays].min())
        found.append(
            Expected("T_d", "s", value, std, std / np.sqrt(2.0), (), _sentence("T_d", "s", value, std), fewest)
        )
    return tuple(found)


def _sentence(name: str, unit: str, value: float, std: float) -> str:
    share = f" ({100 * std / abs(value):.1f} %)" if value else ""
    return f"{name}: {value:.4g} +- {std:.2g} {unit}{share}; twice the repeats: +- {std / np.sqrt(2):.2g}"


def _inverse(hessian: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Covariance with insensitive parameters left out (their rows are zero), and which are not insensitive."""
    total = hessian.sum(axis=0)
    usable = np.diag(total) > 1e-9
    return inverse_of_gram(np.where(np.outer(usable, usable), total, 0.0)), usable


def _best(
    hessian: FloatArray, covariance: FloatArray, i: int, segments: Sequence[Segment]
) -> tuple[tuple[str, float], ...]:
    """Share of each cell in the information about one parameter, the others being estimated too."""
    direction = covariance[i] / covariance[i, i]
    each = np.einsum("i,sij,j->s", direction, hessian, direction)
    cells: dict[str, float] = {}
    for segment, value in zip(segments, each, strict=True):
        label = _step_words(segment)
        cells[label] = cells.get(label, 0.0) + float(value)
    total = sum(cells.values()) or 1.0
    # Steps to the left and to the right contain the same information: what differs by rounding only stays in the order of the script.
    ranked = sorted(((c, v / total) for c, v in cells.items()), key=lambda pair: -round(pair[1], 6))
    return tuple(pair for pair in ranked[:3] if pair[1] > 0.01)


def _step_words(segment: Segment) -> str:
    """A step as a person would call it: 'throttle 0.05 to 0.40', 'roll +0.3 rad', 'yaw rate -2 rad/s'."""
    if segment.kind == "free":  # chirps and doublets: the label names the axis, the cell does not
        return segment.name.split("/")[1] if "/" in segment.name else "free flight"
    kind, cell = segment.kind.removesuffix("_step").replace("_", " "), segment.cell
    if "throttle_0" in cell and "throttle_1" in cell:
        return f"{kind} {cell['throttle_0']:.2f} to {cell['throttle_1']:.2f}"
    if "amplitude_rad" in cell:
        return f"{kind} {cell['amplitude_rad']:+g} rad"
    if "rate_rad_s" in cell:
        return f"{kind} {cell['rate_rad_s']:+g} rad/s"
    return " ".join([kind, *(f"{k} {v:g}" for k, v in sorted(cell.items()))])


def _planned(plans: Sequence[Plan], model: Model, values: Mapping[str, float]) -> tuple[list[list[Segment]], list[int]]:
    """Each plan's responses as the model would fly them; and, plan after plan, the number of the flight each is taken from.

    Repeats under the same voltage are the same flight: hardly anything is asked for once only.
    """
    wanted = [
        (k, leg, run)
        for k, plan in enumerate(plans)
        for leg in plan.legs
        if (run := _run(plan, leg, model, values)) is not None
    ]
    groups: list[list[Segment]] = [[] for _ in plans]
    if not wanted:
        return groups, []
    numbers: dict[Hashable, int] = {}
    flights = [numbers.setdefault(_flight(leg, run, model), len(numbers)) for _, leg, run in wanted]
    runs = {number: run for number, (*_, run) in zip(flights, wanted, strict=True)}
    fastest = max(values.get(name, 0.0) for name in ("sigma_t", "sigma_r", "omega_phi", "omega_theta"))
    step_s = min(PLANNED_STEP_S, RESOLVED / max(fastest, 1.0))
    flown = simulate_many(model, values, [runs[i] for i in range(len(runs))], step_s)
    for number, (k, leg, run) in zip(flights, wanted, strict=True):
        groups[k].append(_segment(leg, run, flown[number]))
    return groups, flights


def _flight(leg: Leg, run: Run, model: Model) -> Hashable:
    """What makes a flight. The paper's model has neither heading nor height; terms may."""
    start = () if set(model.terms) == set(PAPER_TERMS) else tuple(run.start.items())
    asked = tuple((n, t.tobytes(), v.tobytes()) for n, (t, v) in (*run.references.items(), *run.signals.items()))
    return _recorded_from_s(leg), run.t_s.tobytes(), start, asked


def _recorded_from_s(leg: Leg) -> float:
    recorded = [p for p in leg.phases if p.record] or list(leg.phases)
    return max(min(leg.t_step_s, recorded[0].start_s) - BEFORE_S, 0.0)


def _run(plan: Plan, leg: Leg, model: Model, values: Mapping[str, float]) -> Run | None:
    """What is recorded of a leg, as it would be flown on the prior model from hovering at its voltage."""
    if leg.profile is None or leg.motors_off:
        return None
    recorded = [p for p in leg.phases if p.record] or list(leg.phases)
    if not recorded:
        return None
    t = np.arange(0.0, min(recorded[-1].end_s + AFTER_S, leg.duration_s), 1.0 / plan.rate_hz)
    if t.size < 12:
        return None
    voltage = leg.voltage_v or plan.vehicle.nominal_voltage_v
    level = leg.flown_with(float(model.hover_throttle(values, voltage)), angle_boost=False)
    columns = dict(zip(INPUTS, _targets(level.profile or leg.profile, t).T, strict=True))
    u = {n: _edges(t, v) for n, v in columns.items()}
    began = {"p_z_m": leg.start_m[2], "yaw_rad": leg.heading_rad}
    return Run(t, began, u, {"voltage_v": (t[:1], np.array([voltage]))})


def _targets(profile: Callable[[float], AttitudeTarget], t: FloatArray) -> FloatArray:
    """(n, 4) in the order of `INPUTS`."""
    if isinstance(profile, Timeline):
        return profile.table(t)
    asked = [profile(float(x)) for x in t]
    return np.array([(a.roll_rad, a.pitch_rad, a.yaw_rate_rad_s, a.throttle) for a in asked])


def _segment(leg: Leg, run: Run, flown: Mapping[str, FloatArray]) -> Segment:
    keep = run.t_s >= _recorded_from_s(leg)
    measured = ("roll_rad", "pitch_rad", "yaw_rad", "p_rad_s", "q_rad_s", "r_rad_s", "p_z_m",
                "f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "v_x_m_s", "v_y_m_s", "v_z_m_s")  # fmt: skip
    y = {c: flown[c][keep] for c in measured}
    y["voltage_v"] = np.full(int(keep.sum()), run.signals["voltage_v"][1][0])
    u = dict(run.references)
    return Segment(
        leg.id, "plan", leg.kind, leg.cell, leg.repeat, leg.t_step_s, run.t_s[keep], y, u, maneuver=leg.maneuver
    )


def _edges(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    keep = np.concatenate([[True], np.diff(values) != 0.0])
    times = t[keep].copy()
    times[0] -= 9.0
    return times, values[keep]
