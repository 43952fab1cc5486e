"""Is a term needed? Cross-validated log predictive density of the model with and without it, over groups of responses.

Both models are fitted to everything; each group (cell, heading, flight) is then predicted from the other groups by one linear step of its
own model (`held_out`), in the weights of the larger model's discrepancy. Their difference is the log evidence of the term. It is named
where its probability, prior odds included, is above `PROBABILITY`, its effect has a size, and its parameters are admissible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flighttest.diagnose.residuals.discrepancy import discrepancy_of
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, NoiseFloor, floor_of
from flighttest.diagnose.selection.admissible import EstimatedModel, outside_prior
from flighttest.diagnose.selection.candidates import null_value, redundant
from flighttest.diagnose.selection.held_out import (
    CrossValidation,
    ParameterPrior,
    PredictionErrors,
    cross_validated,
    held_out,
    places,
    size_in_floors,
    stratum_gains,
    worse_in_more,
)
from flighttest.estimation.estimator import Estimator, finite
from flighttest.estimation.linearisation import (
    FloatArray,
    IntArray,
    Linearisation,
    Optimum,
    inverse_of_gram,
    orthonormal,
)
from flighttest.estimation.problem import Noise, kinds_of
from flighttest.estimation.uncertainty.distributions import NORMAL_95
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments import Segment

PROBABILITY = 0.99  # a name is given above it; reliability is measured on the frozen bench (docs/proof.md)
LEAST_FLOORS = 0.7  # noise floors: half their power. Below it a vehicle counts as clean (design of the sealed trials)


@dataclass(frozen=True)
class Fitted:
    """A model at its optimum. names: what is estimated; rows: with columns for names, whitened in `noise`, the optimum's own where None;
    inactive: terms fixed at their null values."""

    model: Model
    names: tuple[str, ...]
    at: Optimum
    rows: Linearisation
    inactive: frozenset[str] = frozenset()
    noise: Noise | None = None

    def residual(self) -> FloatArray:
        """(n,) whitened, without what the model's own columns explain."""
        basis = orthonormal(self.rows.columns(self.names))
        return np.asarray(self.rows.residual - basis @ (basis.T @ self.rows.residual))

    @property
    def prior(self) -> ParameterPrior:
        """Of what is estimated."""
        return ParameterPrior.of([self.model.param[n] for n in self.names], self.at.values)

    @property
    def finite(self) -> bool:
        """Whether the simulation and its derivatives are numbers."""
        rows = self.rows
        return bool(np.isfinite(self.at.objective)) and finite((rows.residual, rows.jacobian))


@dataclass(frozen=True)
class Evidence:
    """What a term adds. nats: difference of the log predictive densities; probability: that it is needed, against its absence; floors: its
    effect in noise floors at `place` (channel, kind of maneuver), where it is largest; effect, profiled (measured rows,): what it changes
    in predictions, in the channels' units, the second with the nuisance parameters of every response profiled out; inadmissible: why its
    estimates cannot be what its name means, empty where they can; without: the model fitted without it; improved, worsened: strata
    (channels, disturbances) of groups that were not used, predicted better or worse with it (`stratum_gains`),
    worse by what would decide alone; nothing: the estimates, where a term's absence is not excluded; withdrawn: which other term it leaves
    for, and why."""

    term: str
    nats: float
    probability: float
    floors: float
    place: tuple[str, str]
    effect: FloatArray
    profiled: FloatArray
    inadmissible: str
    without: Fitted
    improved: tuple[str, ...]
    worsened: tuple[str, ...] = ()
    nothing: str = ""
    withdrawn: str = ""

    @property
    def nameless(self) -> str:
        """Why it has no name however much it explains, empty where it may have one: its estimates, or its size."""
        if self.inadmissible or self.floors >= LEAST_FLOORS:
            return self.inadmissible
        # Nor where it is not a number.
        return f"its effect is {self.floors:.2g} noise floors, too small to be distinguished from a clean vehicle"

    @property
    def why_not(self) -> str:
        """Why it is not named, empty where it is."""
        if why := self.withdrawn or self.nameless:
            return why
        if not self.improved:
            return "no channel of what was not used is predicted better with it"
        if why := worse_in_more(len(self.worsened), len(self.improved)):
            return why
        if not self.probability >= PROBABILITY:
            return f"cross-validated evidence of {self.nats:.1f} nats: the probability that it is needed is {self.probability:.3g}"
        return self.nothing


def probability_of(nats: float, candidates: int) -> float:
    """Posterior probability of a term from its log evidence; prior odds one to the number of candidates."""
    return 1.0 / (1.0 + math.exp(-min(max(nats - math.log(max(candidates, 1)), -700.0), 700.0)))


def level_of(candidates: int) -> float:
    """p-value below which a term is significant: 1 - `PROBABILITY` for all candidates of a search together (Bonferroni)."""
    return (1.0 - PROBABILITY) / max(candidates, 1)


def weights_of(
    fitted: Fitted, segments: Sequence[Segment], floor: NoiseFloor | None = None
) -> Callable[[Linearisation], FloatArray]:
    """Weights (n,) of rows in the noise and discrepancy of a fitted model.

    What such a model leaves unexplained may be alike in all cells of a kind of maneuver, and a wrong term that takes some of it away is
    then right in all of them: kinds are the clusters, one level above the cells of the search.
    """
    known = floor or floor_of(fitted.rows, segments, RESOLUTION)
    return discrepancy_of(fitted.rows, fitted.residual(), segments, known, kinds_of(segments)).weights


def standard_errors(fitted: Fitted, segments: Sequence[Segment]) -> dict[str, float]:
    """Name to the generalised least squares standard error of every parameter, in the model's own noise and discrepancy."""
    variances = np.diag(_covariance(fitted, segments))
    return dict(zip(fitted.names, np.sqrt(np.maximum(variances, 0.0)).tolist(), strict=True))


def _covariance(fitted: Fitted, segments: Sequence[Segment]) -> FloatArray:
    """(p, p) of generalised least squares, p as `fitted.names`."""
    a = fitted.rows.columns(fitted.names) * np.sqrt(weights_of(fitted, segments)(fitted.rows))[:, None]
    return inverse_of_gram(a.T @ a)


def least_needed_first(
    terms: Sequence[Term], fitted: Fitted, segments: Sequence[Segment], candidates: int
) -> list[Term]:
    """Terms of a fitted model by what its log likelihood would lose without each, to first order (Wald 1943: the square of the
    coefficients over their covariance); those whose estimates are inadmissible last."""
    if len(terms) < 2:
        return list(terms)
    covariance = _covariance(fitted, segments)

    def loss(term: Term) -> float:
        own = [p for p in term.amplitudes if p.name in fitted.names]
        at = [fitted.names.index(p.name) for p in own]
        size = np.array([fitted.at.values[p.name] - null_value(p) for p in own])
        return float(size @ np.linalg.pinv(covariance[np.ix_(at, at)], hermitian=True) @ size) if own else 0.0

    return sorted(terms, key=lambda t: (bool(inadmissible(t, fitted, segments, candidates)), loss(t)))


def rows_in_noise_of(larger: Fitted, smaller: Fitted, estimator: Estimator) -> Linearisation:
    """Rows of the smaller model, whitened in the noise of the larger."""
    at = replace(smaller.at, noise=larger.at.noise)
    known = at.noise == (smaller.noise or smaller.at.noise)
    return smaller.rows if known else estimator.linearise(smaller.model, at, smaller.names)


def held_out_errors(
    smaller: Fitted, larger: Fitted, estimator: Estimator, groups: IntArray
) -> tuple[PredictionErrors, PredictionErrors]:
    """Of the smaller and of the larger model on groups not used, in the noise of the larger: initial states are estimated by it, and two
    noises would make two predictions of one model."""

    def of(fitted: Fitted, rows: Linearisation) -> PredictionErrors:
        return PredictionErrors(rows, held_out(rows, fitted.names, groups, fitted.prior))

    after = of(larger, larger.rows)
    return after if larger is smaller else of(smaller, rows_in_noise_of(larger, smaller, estimator)), after


def cross_validations(
    larger: Fitted, smaller: Fitted, estimator: Estimator, groups: IntArray, floor: NoiseFloor
) -> tuple[CrossValidation, CrossValidation]:
    """Of the larger and of the smaller model over groups, in the noise and discrepancy of the larger."""
    weights = weights_of(larger, estimator.segments, floor)

    def of(fitted: Fitted, rows: Linearisation) -> CrossValidation:
        return CrossValidation(rows, cross_validated(rows, fitted.names, groups, weights(rows), fitted.prior))

    return of(larger, larger.rows), of(smaller, rows_in_noise_of(larger, smaller, estimator))


def log_evidence(
    larger: Fitted, smaller: Fitted, estimator: Estimator, groups: IntArray, floor: NoiseFloor
) -> dict[str, float]:
    """Stratum (channel, disturbance; '' for initial states) to the difference of cross-validated log predictive densities, nats; their sum
    is the log evidence."""
    return _difference(*cross_validations(larger, smaller, estimator, groups, floor))


def _difference(larger: CrossValidation, smaller: CrossValidation) -> dict[str, float]:
    after = larger.by_stratum()
    return {name: 0.5 * (before - after[name]) for name, before in smaller.by_stratum().items()}


def evidence_of(
    term: Term,
    fitted: Fitted,
    without: Fitted,
    estimator: Estimator,
    groups: IntArray,
    floor: NoiseFloor,
    candidates: int,
) -> Evidence:
    """One term of a fitted model against the model without it. floor: of the base model, in which sizes are counted."""
    segments = estimator.segments
    after, before = cross_validations(fitted, without, estimator, groups, floor_of(fitted.rows, segments, RESOLUTION))
    by_stratum = _difference(after, before)
    aside = redundant(term, by_stratum)
    nats = sum(value for stratum, value in by_stratum.items() if stratum not in aside)
    effect = _change(fitted.rows, without.rows.unprofiled_residual, fitted.rows.unprofiled_residual)
    floors, place = size_in_floors(fitted.rows, effect, segments, floor)
    profiled = _change(
        fitted.rows, without.rows.residual * without.rows.scale, fitted.rows.residual * fitted.rows.scale
    )
    change = change_by_stratum(after.rows, before.rows)
    intervals = {
        name: interval
        for name, interval in stratum_gains(before, after, groups).items()
        if name not in aside and visible(change.get(name))
    }
    return Evidence(
        term=term.id,
        nats=nats,
        probability=probability_of(nats, candidates),
        floors=floors,
        place=place,
        effect=effect,
        profiled=profiled,
        inadmissible=inadmissible(term, fitted, segments, candidates, repeated=floor.repeated(*place)),
        without=without,
        improved=tuple(name for name, (low, _) in intervals.items() if low > 0.0),
        worsened=tuple(
            name for name, (_, high) in intervals.items() if high < 0.0 and by_stratum[name] < -log_odds_asked(1)
        ),
    )


def visible(change: FloatArray | None) -> bool:
    """Whether a filter matched to a change of a stratum's rows, in standard deviations of their noise, would have a signal-to-noise ratio
    above 1.96. Else it cannot be distinguished from nothing at a level of 5 %, and what is predicted better there is so because the base
    was estimated anew. None: nothing to compare with."""
    return change is None or float(change @ change) > NORMAL_95**2


def change_by_stratum(larger: Linearisation, smaller: Linearisation) -> dict[str, FloatArray]:
    """Stratum to what differs in its rows between two models whose rows are whitened by the same noise, where they have the same rows."""
    found = {}
    for name in {*larger.strata} & {*smaller.strata}:
        one, other = (rows.residual[rows.stratum == rows.strata.index(name)] for rows in (larger, smaller))
        if one.size == other.size:
            found[name] = one - other
    return found


def log_odds_asked(candidates: int) -> float:
    """Log evidence, nats, at which a term's posterior probability is `PROBABILITY`."""
    return math.log(PROBABILITY / (1.0 - PROBABILITY)) + math.log(max(candidates, 1))


def inadmissible(
    term: Term, fitted: Fitted, segments: Sequence[Segment], candidates: int, *, repeated: bool = False
) -> str:
    """As of `outside_prior`, of a fitted model. candidates: terms of the search."""
    found = EstimatedModel(fitted.names, fitted.at.values, lambda: standard_errors(fitted, segments), segments)
    return outside_prior(term, found, math.sqrt(2.0 * log_odds_asked(candidates)), repeated=repeated)


def _change(rows: Linearisation, first: FloatArray, second: FloatArray) -> FloatArray:
    """First minus second on what was measured, which comes first in the rows of any model."""
    measured = int(np.sum(rows.sample >= 0))
    return first[:measured] - second[:measured]


__all__ = ["Evidence", "Fitted", "evidence_of", "inadmissible", "log_evidence", "places", "probability_of"]
