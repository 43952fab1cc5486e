"""Errors of sensors, by what velocity, attitude and accelerometer have in common by kinematics alone (`segments.compatibility`): a late
velocity, a biased accelerometer.

No vehicle model is involved, so that its errors hide neither, and neither is taken for thrust or drag; the rest of the diagnosis then sees
what the sensors would have shown without them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from flighttest.diagnose.answer import SEED, Asked, PartAnswer
from flighttest.diagnose.findings import candidate_row, evidence_row, finding_of, parameter_in_words
from flighttest.diagnose.model import Finding, Located
from flighttest.diagnose.records import WITH_GUSTS, CandidateRow, HeldOutRow, ParameterRow
from flighttest.diagnose.selection.comparison import level_of, probability_of
from flighttest.estimation.uncertainty.distributions import fisher_beyond, fisher_quantile
from flighttest.identify.free_flight.estimated import HeldEstimate
from flighttest.physics.blocks import FORCE, VELOCITY
from flighttest.physics.core import Term
from flighttest.physics.terms.sensor import accelerometer_bias, velocity_latency
from flighttest.segments.compatibility import LARGEST, PRIOR_S, AccelerometerBias, Compatibility
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

UNKNOWNS = 3  # of the kinematics of a recording
# Of the mean square error, on stretches not used, what an error of a sensor may leave. By `python -m benchmarks.sensor_errors` on 41 logs
# of pilots five have a latency of 36 to 190 ms as they were recorded, and 85 to 96 % of the error stays: other errors of an estimate look
# like a latency. In four logs whose velocity agrees with the accelerometer 60 to 350 ms added leave 0 to 11 %, 30 ms at most 25 %.
MOST_LEFT = 0.5
DRAWS = 200


@dataclass(frozen=True)
class SensorError:
    """That a sensor errs. held: by how much; ratio: Fisher's F against none; errors (n, 2): of each stretch the mean square of what
    velocity and accelerometer differ by, as recorded and corrected by the others; channel: all three axes; unit: of that root; corrected:
    how, in words; candidates: of the search."""

    term: Term
    held: HeldEstimate
    ratio: float
    errors: FloatArray
    channel: str
    unit: str
    corrected: str
    candidates: int

    @property
    def p_value(self) -> float:
        """Of none."""
        return fisher_beyond(self.ratio, len(self.held.names), self.held.dof)

    @property
    def nats(self) -> float:
        """Log evidence (Schwarz 1978)."""
        return 0.5 * len(self.held.names) * (self.ratio - float(np.log(len(self.errors))))

    @property
    def probability(self) -> float:
        """That it is there, after the search over all candidates."""
        return probability_of(self.nats, self.candidates)

    @property
    def rmse(self) -> tuple[float, float]:
        """As recorded and corrected."""
        before, after = np.sqrt(self.errors.mean(axis=0)).tolist()
        return before, after

    @property
    def floors(self) -> float:
        """How many times what is left it takes away."""
        return self.rmse[0] / max(self.rmse[1], 1e-6)

    def row(self) -> HeldOutRow:
        """What it takes of the error, with the interval of resampled stretches."""
        at = np.random.default_rng(SEED).integers(0, len(self.errors), (DRAWS, len(self.errors)))
        drawn = np.sqrt(self.errors[at].mean(axis=1))
        before, after = self.rmse
        gain = np.quantile(drawn[:, 0] - drawn[:, 1], [0.025, 0.975]).tolist()
        return HeldOutRow(rmse_before=before, rmse_after=after, floor=after, gain_95=gain)

    def candidate(self) -> CandidateRow:
        """Its line among the candidates."""
        why = f"by kinematics, p {self.p_value:.1g}"
        return candidate_row(self.term.id, self.nats, self.probability, self.floors, why, named=True)

    def finding(self, kind: str, table: Mapping[str, ParameterRow]) -> Finding:
        """With its intervals as the final model has them. kind: of the segments that show it."""
        term, (before, after), held = self.term, self.rmse, self.row()
        rows = {name: table[name] for name in self.held.names}
        sentence = (
            f"{term.plain} ({', '.join(parameter_in_words(n, row) for n, row in rows.items())}); by kinematics alone: velocity and "
            f"accelerometer differ by {before:.2g} {self.unit} without it and by {after:.2g} {self.unit} with it"
        )
        gain = 1.0 - (after / before) ** 2
        evidence = evidence_row(self.nats, self.probability, self.floors, (self.channel, kind), gain, self.p_value)
        return finding_of(term, evidence, rows, {self.channel: held}, sentence)


@dataclass
class KinematicsAnswer(PartAnswer):
    """The errors that sensors have."""

    found: tuple[SensorError, ...] = field(kw_only=True)

    def findings(self, asked: Asked, table: Mapping[str, ParameterRow]) -> list[Finding]:
        """Each with its interval as the final model has it."""
        del asked
        return [e.finding(place.kind, table) for e, place in zip(self.found, self.located, strict=True)]

    def corrected(self, segments: Sequence[Segment]) -> tuple[Segment, ...]:
        """Segments as sensors without these errors would have recorded them."""
        for error in self.found:
            by = list(error.held.values.values())
            segments = in_time(segments, *by) if error.term is velocity_latency else unbiased(segments, by)
        return tuple(segments)


def by_kinematics(segments: Sequence[Segment], pool: Sequence[Term]) -> PartAnswer:
    """Whether the velocity of all these recordings is late, and their accelerometer biased, where that is a candidate."""
    every = list({s.run: s.context.compatibility for s in segments}.values())
    known = [c for c in every if c is not None]
    answer = PartAnswer()
    if len(known) < len(every):
        return answer
    found = []
    for term, way in ((velocity_latency, _late_velocity), (accelerometer_bias, _biased_accelerometer)):
        if term in pool:
            one = way(known, len(pool))
            if isinstance(one, SensorError):
                found.append(one)
            if one is not None:
                answer.tried |= {term.id}
            if isinstance(one, float):
                answer.levels[term.id] = one, term.params[-1].name
    if not found:
        return answer
    made = KinematicsAnswer(found=tuple(found), tried=answer.tried, levels=answer.levels)
    made.accepted = {e.term.id: e.nats for e in found}
    made.terms = tuple(made.accepted)
    made.heldout = {e.channel: {"all": e.row()} for e in found}
    made.located = [_place(segments, e) for e in found]
    made.shares = {c: (row["all"]["rmse_after"] / row["all"]["rmse_before"]) ** 2 for c, row in made.heldout.items()}
    made.error = WITH_GUSTS
    made.candidates = [e.candidate() for e in found]
    made.held = _joined([e.held for e in found])
    return made


def _late_velocity(known: Sequence[Compatibility], candidates: int) -> SensorError | float | None:
    """A latency that every recording shows; the smallest, s, where none is later than stamps may be; None where that is not known.

    Its interval holds what a stamp may be off by: an effect is what comes on top of it.
    """
    late = [c for c in known if c.velocity_has_latency]
    if not late and all(c.determined for c in known):
        return LARGEST * PRIOR_S
    if len(late) < len(known):
        return None
    each = [(np.array([c.velocity_late_s]), np.array([[c.velocity_late_std_s**2]])) for c in late]
    value, covariance, dof = _mean(late, each)
    errors = np.array([pair for c in late for pair in c.errors_m2_s2])
    held = _held(velocity_latency, value, covariance + PRIOR_S**2, dof)
    ratio = _ratio(value, covariance)
    words = "velocity", "m/s", "the velocity at its time"
    return _significant(SensorError(velocity_latency, held, ratio, errors, *words, candidates))


def _biased_accelerometer(known: Sequence[Compatibility], candidates: int) -> SensorError | float | None:
    """A bias of all recordings beyond what accelerometers drift by; the smallest, m/s^2, that would have been seen where there is none;
    None where the recordings do not determine it as well as accelerometers stay. Its test and its interval hold that drift."""
    biased: list[AccelerometerBias] = [c.bias for c in known if c.bias is not None]
    if len(biased) < len(known):
        return None
    value, covariance, dof = _mean(known, [(np.array(b.value_m_s2), np.array(b.covariance)) for b in biased])
    errors = np.array([pair for b in biased for pair in b.errors_m2_s4])
    drift = np.diag([p.drift**2 for p in accelerometer_bias.params])
    held = _held(accelerometer_bias, value, covariance + drift, dof)
    ratio = _ratio(value, held.covariance)
    words = "specific force", "m/s^2", "the bias taken out"
    made = SensorError(accelerometer_bias, held, ratio, errors, *words, candidates)
    if significant := _significant(made):
        return significant
    if np.any(np.diag(covariance) > np.diag(drift)) or made.p_value < level_of(candidates):
        return None
    least = value.size * fisher_quantile(1.0 - level_of(candidates), value.size, dof)
    return float(np.sqrt(least * np.diag(held.covariance).max()))


def _held(term: Term, value: FloatArray, covariance: FloatArray, dof: float) -> HeldEstimate:
    names = tuple(p.name for p in term.params)
    return HeldEstimate(names, dict(zip(names, value.tolist(), strict=True)), covariance, dof)


def _significant(found: SensorError) -> SensorError | None:
    """Itself, where it is significant, takes most of the error away and is of a size that its term may have."""
    before, after = found.errors.mean(axis=0)
    possible = all(p.lower < found.held.values[p.name] < p.upper for p in found.term.params)
    return found if possible and found.p_value < level_of(found.candidates) and after <= MOST_LEFT * before else None


def _ratio(value: FloatArray, covariance: FloatArray) -> float:
    """Fisher's F of values (k,) against none."""
    return float(value @ np.linalg.solve(covariance, value)) / value.size


def _mean(
    known: Sequence[Compatibility], each: Sequence[tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray, float]:
    """(mean (k,), covariance (k, k), degrees of freedom) of recordings' values and covariances: weighted by these, with an error that holds
    what the recordings differ by."""
    weight = np.array([np.linalg.inv(covariance) for _, covariance in each])
    values = np.array([value for value, _ in each])
    whole = np.linalg.inv(weight.sum(axis=0))
    mean = whole @ np.einsum("rij,rj->i", weight, values)
    off = values - mean
    apart = float(np.einsum("ri,rij,rj->", off, weight, off)) / max(mean.size * (len(each) - 1), 1)
    dof = float(sum(max(c.stretches - UNKNOWNS, 1) for c in known))
    return mean, whole * max(apart, 1.0), dof


def _joined(held: Sequence[HeldEstimate]) -> HeldEstimate:
    """Estimates that share no parameter as one."""
    names, values = tuple(n for h in held for n in h.names), {n: v for h in held for n, v in h.values.items()}
    return HeldEstimate(names, values, block_diag(*(h.covariance for h in held)), min(h.dof for h in held))


def in_time(segments: Sequence[Segment], late_s: float) -> tuple[Segment, ...]:
    """Segments whose velocity is that of its time; NaN where it came after their end."""

    def earlier(s: Segment, values: FloatArray) -> FloatArray:
        good = np.isfinite(values)
        return np.interp(s.t_s + late_s, s.t_s[good], values[good], left=np.nan, right=np.nan) if good.any() else values

    return tuple(replace(s, y={n: earlier(s, v) if n in VELOCITY else v for n, v in s.y.items()}) for s in segments)


def unbiased(segments: Sequence[Segment], bias_m_s2: Sequence[float]) -> tuple[Segment, ...]:
    """Segments whose specific force is without a bias, body FLU (3,)."""
    of = dict(zip(FORCE, bias_m_s2, strict=True))
    return tuple(replace(s, y={n: v - of[n] if n in of else v for n, v in s.y.items()}) for s in segments)


def _place(segments: Sequence[Segment], found: SensorError) -> Located:
    (kind, _), *_ = Counter(s.kind for s in segments).most_common(1)
    before, after = found.rmse
    of = "accelerometer" if found.channel == "velocity" else "velocity"
    return Located(
        found.channel, next(s.maneuver for s in segments if s.kind == kind), kind, {}, 1.0, 1.0,
        f"{found.channel.capitalize()} against the {of}, by kinematics: {before:.2g} {found.unit} where {after:.2g} is left with "
        f"{found.corrected}",
        before, after, found.unit, before,
    )  # fmt: skip
