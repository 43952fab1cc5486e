"""A late velocity, by what velocity, attitude and accelerometer have in common by kinematics alone (`segments.compatibility`).

No vehicle model is involved, so that its errors hide no latency; the rest of the diagnosis then sees the velocity at its time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.answer import SEED, Asked, PartAnswer
from flighttest.diagnose.findings import parameter_in_words, with_owner
from flighttest.diagnose.model import Finding, Located, TermVerdict
from flighttest.diagnose.records import CandidateRow, HeldOutRow, ParameterRow
from flighttest.diagnose.selection.comparison import level_of, probability_of
from flighttest.estimation.uncertainty.distributions import fisher_beyond
from flighttest.identify.free_flight.estimate import HeldEstimate
from flighttest.physics.blocks import VELOCITY
from flighttest.physics.core import Term
from flighttest.physics.terms.sensor import velocity_latency
from flighttest.segments.compatibility import LARGEST, PRIOR_S, Compatibility
from flighttest.segments.model import Segment

CHANNEL = "velocity"  # all three together
UNKNOWNS = 3  # of the kinematics of a recording
# Of the mean square error of the velocity, on stretches not used, what a latency may leave. By `python -m benchmarks.late_velocity` on 41
# logs of pilots five have one of 36 to 190 ms as they were recorded, and 85 to 96 % of the error stays: other errors of an estimate look
# like a latency. In four logs whose velocity agrees with the accelerometer 60 to 350 ms added leave 0 to 11 %, 30 ms at most 25 %.
MOST_LEFT = 0.5
DRAWS = 200


@dataclass
class KinematicsAnswer(PartAnswer):
    """That the velocity is late. p_value: of no latency; probability: that it is there, after the search over all candidates."""

    p_value: float = field(kw_only=True)
    probability: float = field(kw_only=True)

    @property
    def late_s(self) -> float:
        """The latency."""
        assert self.held is not None
        return self.held.values[velocity_latency.id]

    def findings(self, asked: Asked, table: Mapping[str, ParameterRow]) -> list[Finding]:
        """The latency, with its interval as the final model has it."""
        del asked
        row, term = table[velocity_latency.id], velocity_latency
        held = self.heldout[CHANNEL]["all"]
        sentence = (
            f"{term.plain} ({parameter_in_words(term.id, row)}); by kinematics alone: velocity and accelerometer differ by "
            f"{held['rmse_before']:.2g} m/s without it and by {held['rmse_after']:.2g} m/s with it"
        )
        nats = self.accepted[term.id]
        return [
            Finding(
                term=term.id, title=term.title, family=term.family, verdict=TermVerdict.SUPPORTED, equation=term.equation,
                plain=term.plain, parameters={term.id: row}, heldout={CHANNEL: held}, rivals=(),
                evidence={
                    "delta_bic": -2.0 * nats, "log_evidence": nats, "probability": self.probability,
                    "floors": held["rmse_before"] / max(held["rmse_after"], 1e-6),
                    "where": {"channel": CHANNEL, "kind": self.located[0].kind},
                    "heldout_gain": 1.0 - (held["rmse_after"] / held["rmse_before"]) ** 2, "p_value": self.p_value,
                    "rms_force_m_s2": None, "rms_force_left_m_s2": None,
                },
                sentence=with_owner(term, sentence), source=term.source, doubt=term.doubt,
            )
        ]  # fmt: skip


def by_kinematics(segments: Sequence[Segment], pool: Sequence[Term]) -> PartAnswer:
    """Whether the velocity of all these recordings is late, where that is a candidate.

    Of several recordings the mean, weighted by their variances, with an error that holds what they differ by, and what a stamp may be off
    by: an effect is what comes on top of it.
    """
    every = list({s.run: s.context.compatibility for s in segments}.values())
    known = [c for c in every if c is not None]
    if velocity_latency not in pool or len(known) < len(every):
        return PartAnswer()
    late = [c for c in known if c.velocity_has_latency]
    name = velocity_latency.id
    if not late and all(c.determined for c in known):
        return PartAnswer(tried=frozenset({name}), levels={name: (LARGEST * PRIOR_S, name)})
    if len(late) < len(known):
        return PartAnswer()
    value, std, dof = _mean(late)
    p_value = fisher_beyond((value / std) ** 2, 1, dof)
    errors = np.array([pair for c in late for pair in c.errors_m2_s2])
    before, after = errors.mean(axis=0)
    if p_value >= level_of(len(pool)) or after > MOST_LEFT * before:
        return PartAnswer()
    nats = 0.5 * (value / std) ** 2 - 0.5 * float(np.log(len(errors)))
    made = KinematicsAnswer(p_value=p_value, probability=probability_of(nats, len(pool)))
    made.accepted, made.terms, made.tried = {name: nats}, (name,), frozenset({name})
    drawn = errors[np.random.default_rng(SEED).integers(0, len(errors), (DRAWS, len(errors)))].mean(axis=1)
    gains = np.sqrt(drawn[:, 0]) - np.sqrt(drawn[:, 1])
    rmse_before, rmse_after = float(np.sqrt(before)), float(np.sqrt(after))
    row = HeldOutRow(
        rmse_before=rmse_before,
        rmse_after=rmse_after,
        floor=rmse_after,
        gain_95=np.quantile(gains, [0.025, 0.975]).tolist(),
    )
    made.heldout = {CHANNEL: {"all": row}}
    made.located = [_place(segments, rmse_before, rmse_after)]
    made.shares = [0.0]
    made.candidates = [
        CandidateRow(
            term=name, verdict=TermVerdict.SUPPORTED, delta_bic=-2.0 * nats, probability=made.probability,
            floors=rmse_before / max(rmse_after, 1e-6), why=f"by kinematics, p {p_value:.1g}",
        )
    ]  # fmt: skip
    made.held = HeldEstimate((name,), {name: value}, np.array([[std**2 + PRIOR_S**2]]), dof)
    return made


def in_time(segments: Sequence[Segment], late_s: float) -> tuple[Segment, ...]:
    """Segments whose velocity is that of its time; NaN where it came after their end."""

    def earlier(s: Segment, values: NDArray[np.float64]) -> NDArray[np.float64]:
        good = np.isfinite(values)
        return np.interp(s.t_s + late_s, s.t_s[good], values[good], left=np.nan, right=np.nan) if good.any() else values

    return tuple(replace(s, y={n: earlier(s, v) if n in VELOCITY else v for n, v in s.y.items()}) for s in segments)


def _mean(found: Sequence[Compatibility]) -> tuple[float, float, float]:
    """(latency, standard error, degrees of freedom)."""
    values = np.array([c.velocity_late_s for c in found])
    weight = np.array([c.velocity_late_std_s for c in found]) ** -2.0
    mean = float(weight @ values / weight.sum())
    apart = float(weight @ (values - mean) ** 2) / max(len(found) - 1, 1)
    dof = float(sum(max(c.stretches - UNKNOWNS, 1) for c in found))
    return mean, float(np.sqrt(max(apart, 1.0) / weight.sum())), dof


def _place(segments: Sequence[Segment], rmse: float, floor: float) -> Located:
    (kind, _), *_ = Counter(s.kind for s in segments).most_common(1)
    return Located(
        CHANNEL, next(s.maneuver for s in segments if s.kind == kind), kind, {}, 1.0, 1.0,
        f"Velocity against the accelerometer, by kinematics: {rmse:.2g} m/s where {floor:.2g} is left with the velocity at its time",
        rmse, floor, "m/s", rmse,
    )  # fmt: skip
