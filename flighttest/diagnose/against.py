"""A simulator's recordings against real ones: both fitted in one model, and what the simulator lacks, has too much of, or has otherwise.

The model is the base with every term that the diagnosis of either side accepted. A parameter differs where the difference of its two
estimates is beyond its joint standard error, by Student's t with Welch's degrees of freedom and Holm's correction over all parameters.
A term without an amplitude (a limit, a shaped reference) has no value at which it is absent. Where one diagnosis alone named it, it is in
the model of the other side, too, if that side's recordings are followed better with the term as it was found than without.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from flighttest.diagnose.mass import mass_test
from flighttest.diagnose.model import Diagnosis
from flighttest.diagnose.residuals.prediction import floors_of, prediction_quality
from flighttest.diagnose.selection.held_out import held_out_groups
from flighttest.errors import FitError
from flighttest.estimation.uncertainty.covariance import cluster_covariance, interval_factor
from flighttest.estimation.uncertainty.distributions import beyond, holm, quantile
from flighttest.identify.diagnostics.local_optima import misfit
from flighttest.identify.fit import Fit, fit
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.segments.commands import alike_until_s
from flighttest.segments.model import Segment

NO_LOOPS = "one side has no attitude references"
LEVEL = (
    0.01  # chance that any parameter of two equal vehicles is called different (Holm's correction over the parameters)
)


class Kind(StrEnum):
    """The answer about one parameter. The simulator LACKS its term, has TOO_MUCH of it (reality has none), has it with an OTHER_VALUE, the
    SAME within the error of both, or it is UNTESTED: one of the sides does not determine it."""

    LACKS = "LACKS"
    TOO_MUCH = "TOO_MUCH"
    OTHER_VALUE = "OTHER_VALUE"
    SAME = "SAME"
    UNTESTED = "UNTESTED"


@dataclass(frozen=True)
class Difference:
    """One parameter on both sides. difference: real minus simulated; std, interval_95, p_value: of it, None where it is untested, or where
    its term has no amplitude; why: the reason why it is not tested; detectable: the smallest difference that is found in four of five
    such pairs."""

    name: str
    term: str
    unit: str
    kind: Kind
    real: float | None
    real_std: float | None
    simulated: float | None
    simulated_std: float | None
    difference: float | None = None
    std: float | None = None
    interval_95: tuple[float, float] | None = None
    p_value: float | None = None
    why: str = ""
    detectable: float | None = None

    @property
    def differs(self) -> bool:
        """Whether the simulator has to change here."""
        return self.kind in (Kind.LACKS, Kind.TOO_MUCH, Kind.OTHER_VALUE)


@dataclass(frozen=True)
class Side:
    """One side's model and values; errors: parameter to standard error and degrees of freedom; unseen: term to why its recordings could not
    show it."""

    model: Model
    values: Mapping[str, float]
    errors: Mapping[str, tuple[float, float]]
    unseen: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Prediction:
    """RMS error of one channel on the real responses, in its unit: of the simulator as it is, of the simulator corrected (by parameters
    from other steps than those predicted), of the model fitted to them; floor: their noise."""

    before: float
    after: float
    fitted: float
    floor: float


@dataclass(frozen=True)
class Against:
    """What a comparison found. real, simulated: fits of one model; prediction: by channel; corrected: parameters of the corrected
    simulator; held_out: whether `Prediction.after` is of steps the correction has not seen; notes: cautions for the reader."""

    real: Fit
    simulated: Fit
    differences: tuple[Difference, ...]
    prediction: Mapping[str, Prediction]
    corrected: Mapping[str, float]
    held_out: bool
    notes: tuple[str, ...] = ()

    @property
    def differing(self) -> tuple[Difference, ...]:
        """Those that differ."""
        return tuple(d for d in self.differences if d.differs)


def compare_sides(
    real: Sequence[Segment], simulated: Sequence[Segment], of_real: Diagnosis, of_simulated: Diagnosis
) -> Against:
    """Compare the usable responses of both sides, each already diagnosed from the same base. FitError where either cannot be fitted."""
    terms = {t.id: t for d in (of_real, of_simulated) for t in d.model.built_terms}
    sides = [
        ([s for s in segments if s.usable], found) for segments, found in ((real, of_real), (simulated, of_simulated))
    ]
    fits, models = [], []
    for (segments, found), (_, other) in zip(sides, sides[::-1], strict=True):
        missing = [terms[t] for t in other.accepted if t not in found.accepted and terms[t].amplitudes]
        # The shape of an effect that is not there cannot be determined: it is held as the other side has it.
        shapes = {p.name: other.values[p.name] for t in missing for p in t.shapes}
        models.append(found.model.with_terms(*(t.id for t in missing), *shared_limits(segments, found, other)))
        fits.append(_fitted(segments, models[-1], {**other.values, **found.values}, shapes))
    for i in (0, 1):
        # What one side cannot determine is held at what the other found, so that the rest compares.
        known, unknown = fits[1 - i].covariance.names, fits[i]
        held = {
            n: fits[1 - i].values[n]
            for n in known
            if n in models[i].names and n not in unknown.covariance.names and n not in unknown.solution.at_bound
        }
        if held:
            frozen = {n: unknown.values[n] for n, e in unknown.estimates.items() if e.source == "frozen" and n != "T_d"}
            fits[i] = _fitted(sides[i][0], models[i], unknown.values, frozen | held)
    mine, theirs = fits
    compared = [side_of(f, d) for f, d in ((mine, of_real), (theirs, of_simulated))]
    differences = differences_of(*compared)
    floors = floors_of(mine, of_real)
    prediction, corrected, held_out = _prediction(sides[0][0], mine, theirs, differences, floors)
    return Against(mine, theirs, differences, prediction, corrected, held_out, notes_of(differences, *compared))


def shared_limits(segments: Sequence[Segment], found: Diagnosis, other: Diagnosis) -> tuple[str, ...]:
    """Terms without an amplitude that only the other side's diagnosis named, and with which, as it found them, these responses are followed
    better than without: ids. Neither of the two models has more to fit than the other."""
    shared = []
    alone = {*other.accepted} - {*found.accepted}
    for term in (t for t in other.model.built_terms if t.id in alone and not t.amplitudes):
        without = _fitted(segments, found.model, found.values, {})
        values = {p.name: other.values[p.name] for p in term.params}
        with_it = _fitted(segments, found.model.with_terms(term.id), found.values, values)
        if misfit(with_it.problem, with_it.solution) < misfit(without.problem, without.solution):
            shared.append(term.id)
    return tuple(shared)


def _fitted(segments: Sequence[Segment], model: Model, start: Mapping[str, float], frozen: Mapping[str, float]) -> Fit:
    return fit(segments, model, select="all", start={n: start[n] for n in model.names if n in start}, frozen=frozen)


def errors_of(found: Fit) -> dict[str, tuple[float, float]]:
    """Standard error and degrees of freedom of every estimated parameter, those on a bound included unless nothing depends on them there.

    What the equations get wrong of a cell is alike on both sides of a comparison; what differs is a matter of single responses, of which
    there are more than cells. So clusters are responses here; of both standard errors the larger one counts. The delay of the thrust has
    the error of the specific force's time stamps as well, which is one for all responses of a recording.
    """
    normal, known = found.solution.normal, found.covariance
    felt = {n for n, h in zip(normal.names, np.einsum("sii->i", normal.hessian), strict=True) if h > 0.0}
    bound = [n for n in found.solution.at_bound if n in felt]
    names = (*known.names, *bound)
    single = cluster_covariance(normal, names)
    cells = known if not bound else cluster_covariance(normal.by(found.problem.cells), names)
    by_cell = {n: float(cells.matrix[i, i]) for i, n in enumerate(cells.names)}
    by_cell |= {n: float(known.matrix[i, i]) for i, n in enumerate(known.names)}
    stamps = {"T_d_thrust": stamp_variance(found.problem.segments)}
    return {
        n: (math.sqrt(max(float(single.matrix[i, i]), by_cell[n]) + stamps.get(n, 0.0)), float(single.dof[i]))
        for i, n in enumerate(single.names)
    }


def stamp_variance(segments: Sequence[Segment]) -> float:
    """Variance of the delay of the thrust, s^2, by the error of what specific force was moved by in time (`Compatibility`): a force that is
    moved takes the delay with it. Recordings count by their steps of the throttle, all of their responses where no throttle stepped."""
    stepped = [s for s in segments if s.kind in ("throttle_step", "tilt_throttle")] or list(segments)
    runs = Counter(s.run for s in stepped)
    late = {s.run: s.context.compatibility for s in stepped}
    moved = [
        (count / len(stepped) * made.force_late_std_s) ** 2
        for run, count in runs.items()
        if (made := late[run]) is not None and made.determined
    ]
    return float(sum(moved))


def side_of(found: Fit, diagnosis: Diagnosis) -> Side:
    """A fit and its diagnosis as one side of a comparison."""
    return Side(found.model, found.values, errors_of(found), {u.term: u.why for u in diagnosis.untestable})


def differences_of(real: Side, simulated: Side) -> tuple[Difference, ...]:
    """Every parameter of either side, those that differ first."""
    return (*_limits(real, simulated), *_differences(real, simulated))


def _limits(real: Side, simulated: Side) -> tuple[Difference, ...]:
    """Parameters of terms that are in the model of one side alone."""
    rows = []
    for here, there, kind in ((real, simulated, Kind.LACKS), (simulated, real, Kind.TOO_MUCH)):
        for param in (p for p in here.model.params if p.name not in there.model.names):
            term, value = here.model.term_of(param.name), here.values[param.name]
            std = here.errors[param.name][0] if param.name in here.errors else None
            why = NO_LOOPS if term == "body" else there.unseen.get(term, "")
            row = Difference(
                param.name, term, param.unit, Kind.UNTESTED if why else kind, None, None, None, None, why=why
            )
            mine = {"real": value, "real_std": std} if here is real else {"simulated": value, "simulated_std": std}
            rows.append(replace(row, **mine))  # type: ignore[arg-type]
    return tuple(rows)


def _differences(real: Side, simulated: Side) -> tuple[Difference, ...]:
    model, errors = real.model, (real.errors, simulated.errors)
    rows: list[Difference] = []
    dofs: dict[int, float] = {}
    for param in (p for p in model.params if p.name in simulated.model.names):
        name, term = param.name, model.term_of(param.name)
        a, b = real.values[name], simulated.values[name]
        known = [e.get(name) for e in errors]
        stds = [None if k is None else k[0] for k in known]
        row = Difference(name, term, param.unit, Kind.UNTESTED, a, stds[0], b, stds[1])
        if known[0] is None or known[1] is None:
            which = [side for side, k in zip(("the real", "the simulated"), known, strict=True) if k is None]
            rows.append(replace(row, why=f"{' and '.join(which)} recordings do not determine it"))
            continue
        (s_a, dof_a), (s_b, dof_b) = known[0], known[1]
        std = math.hypot(s_a, s_b)
        dof = std**4 / (s_a**4 / max(dof_a, 1.0) + s_b**4 / max(dof_b, 1.0)) if std > 0 else 1.0
        half = interval_factor(dof) * std
        p = beyond((a - b) / std, dof) if std > 0 else float(a == b)
        dofs[len(rows)] = dof
        rows.append(replace(row, difference=a - b, std=std, interval_95=(a - b - half, a - b + half), p_value=p))
    tested = {i: r.p_value for i, r in enumerate(rows) if r.p_value is not None}
    for i, differs in zip(tested, holm([*tested.values()], LEVEL), strict=True):
        kind = _kind(rows[i], model, errors, len(tested)) if differs else Kind.SAME
        rows[i] = replace(rows[i], kind=kind, detectable=_detectable(rows[i], dofs[i], len(tested)))
    order = list(Kind)
    return tuple(sorted(rows, key=lambda r: (order.index(r.kind), r.p_value if r.p_value is not None else 1.0)))


def _detectable(row: Difference, dof: float, tests: int) -> float:
    """At the level of the strictest of so many tests, with a power of 80 %."""
    return (quantile(1.0 - 0.5 * LEVEL / tests, dof) + quantile(0.8, dof)) * (row.std or 0.0)


def _kind(row: Difference, model: Model, errors: Sequence[Mapping[str, tuple[float, float]]], tests: int) -> Kind:
    """What the difference of a parameter means: a term is there where any of its amplitudes is beyond its error from `off`."""
    term = next((t for t in model.built_terms if t.id == row.term), None)
    if term is None or not term.amplitudes or all(p.name != row.name for p in term.amplitudes):
        return Kind.OTHER_VALUE
    param = model.param[row.name]
    there = []
    for value, known in ((row.real or 0.0, errors[0]), (row.simulated or 0.0, errors[1])):
        std, dof = known[row.name]
        there.append(std <= 0.0 or beyond((value - (param.off or 0.0)) / std, dof) <= LEVEL / tests)
    return {(True, False): Kind.LACKS, (False, True): Kind.TOO_MUCH}.get((there[0], there[1]), Kind.OTHER_VALUE)


def _prediction(
    segments: Sequence[Segment],
    real: Fit,
    simulated: Fit,
    found: Sequence[Difference],
    floors: Mapping[str, float],
) -> tuple[dict[str, Prediction], dict[str, float], bool]:
    """Errors by channel; the corrected simulator: its own parameters, those that differ fitted to the real recordings."""
    model, noise = real.model, real.noise
    keep = {d.name: simulated.values[d.name] for d in found if not d.differs and d.name in simulated.values}
    keep = {n: v for n, v in keep.items() if n in model.names}
    before = prediction_quality(segments, simulated.model, simulated.values, noise)
    fitted, held_out = real.quality, True
    if not any(d.differs for d in found):
        same = {c: Prediction(q.rmse, q.rmse, fitted[c].rmse, floors[c]) for c, q in before.items() if c in fitted}
        return same, dict(simulated.values), True
    corrected = fit(segments, model, select="all", start=real.values, frozen=keep).values
    group = held_out_groups(segments)[0] % 2
    squares: dict[str, list[tuple[float, int]]] = {}
    try:
        for half in (0, 1):
            rest = [s for s, g in zip(segments, group, strict=True) if g != half]
            here = [s for s, g in zip(segments, group, strict=True) if g == half]
            values = fit(rest, model, select="all", start=corrected, frozen=keep).values
            for c, q in prediction_quality(here, model, values, noise).items():
                squares.setdefault(c, []).append((q.rmse**2 * q.count, q.count))
        after = {c: math.sqrt(sum(s for s, _ in both) / sum(n for _, n in both)) for c, both in squares.items()}
    except FitError:  # too little for halves
        held_out = False
        after = {c: q.rmse for c, q in prediction_quality(segments, model, corrected, noise).items()}
    made = {
        c: Prediction(q.rmse, after[c], fitted[c].rmse, floors[c])
        for c, q in before.items()
        if c in after and c in fitted
    }
    return made, dict(corrected), held_out


def notes_of(found: Sequence[Difference], real: Side, simulated: Side) -> tuple[str, ...]:
    """What else the differences may mean."""
    return (*mass_notes(found, real, simulated), *hidden_notes(found, real.model))


def hidden_notes(found: Sequence[Difference], model: Model) -> tuple[str, ...]:
    """Terms that hide in the parameters that differ, too small in these recordings to be named."""
    names = {"T_d" if d.name.startswith("T_d") else d.name for d in found if d.kind is Kind.OTHER_VALUE}
    terms = [t for t in catalogue().values() if t.id not in model.terms and names and names <= set(t.hides_in)]
    if not terms:
        return ()
    rivals = " or ".join(f"{t.id} (fly {t.reveals})" for t in terms)
    return (f"another value of {', '.join(sorted(names))} may stand for {rivals}, too small here to be named",)


def mass_notes(found: Sequence[Difference], real: Side, simulated: Side) -> tuple[str, ...]:
    """Whether a difference of thrust is one of mass."""
    if not any(d.differs and d.name == "K" for d in found):
        return ()
    both = [n for n in real.errors if n in simulated.errors]
    test = mass_test(
        {n: (simulated.values[n], simulated.errors[n][0]) for n in both},
        {n: (real.values[n], real.errors[n][0]) for n in both},
    )
    return (f"from the simulator to reality {test['sentence']}",) if test.get("thrust_changed") else ()


@dataclass(frozen=True)
class StepDifference:
    """One step that both sides flew. rms: of the difference of the mean responses in `channel`; scatter: standard error of that difference
    by the scatter of the repeats, None with one repeat."""

    kind: str
    cell: Mapping[str, float]
    channel: str
    unit: str
    repeats: tuple[int, int]
    rms: float
    scatter: float | None


_STEPPED = {
    "roll_step": ("roll_rad", "rad"),
    "pitch_step": ("pitch_rad", "rad"),
    "yaw_rate_step": ("r_rad_s", "rad/s"),
    "throttle_step": ("f_z_m_s2", "m/s^2"),
    "tilt_throttle": ("f_z_m_s2", "m/s^2"),
}
_GRID_S = 0.02


def step_by_step(real: Sequence[Segment], simulated: Sequence[Segment]) -> tuple[StepDifference, ...]:
    """Mean responses of the steps that both sides flew, the largest difference first, as long as the commands are alike. No model is
    in it; nor is what repeats differ by, as their voltage."""
    sides: list[dict[object, list[Segment]]] = [{}, {}]
    for cells, segments in zip(sides, (real, simulated), strict=True):
        for s in segments:
            if s.usable and s.kind in _STEPPED and _STEPPED[s.kind][0] in s.y:
                cells.setdefault(s.cell_key, []).append(s)
    found = []
    for key in sides[0].keys() & sides[1].keys():
        mine, theirs = sides[0][key], sides[1][key]
        channel, unit = _STEPPED[mine[0].kind]
        end = alike_until_s((*mine, *theirs))
        grid = np.arange(0.0, end, _GRID_S)
        if grid.size < 5:
            continue
        rows = [[np.interp(grid, s.t_s - s.t_step_s, _known(s, channel)) for s in some] for some in (mine, theirs)]
        off = np.mean(rows[0], axis=0) - np.mean(rows[1], axis=0)
        scatter = None
        if min(len(mine), len(theirs)) > 1:
            scatter = math.sqrt(sum(float(np.mean(np.var(r, axis=0, ddof=1))) / len(r) for r in rows))
        cell, repeats = dict(mine[0].cell), (len(mine), len(theirs))
        rms = float(np.sqrt(np.mean(off**2)))
        found.append(StepDifference(mine[0].kind, cell, channel, unit, repeats, rms, scatter))
    return tuple(sorted(found, key=lambda d: -d.rms / (d.scatter or math.inf)))


def _known(segment: Segment, channel: str) -> np.ndarray:
    y = segment.y[channel]
    good = np.isfinite(y)
    return np.asarray(y if good.all() or not good.any() else np.interp(segment.t_s, segment.t_s[good], y[good]))
