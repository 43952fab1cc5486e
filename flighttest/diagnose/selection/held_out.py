"""Prediction of groups of responses that were not used: residuals, mean squares with bootstrap intervals over groups, horizons, sizes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from flighttest.diagnose.records import HeldOutRow
from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor
from flighttest.estimation.linearisation import Linearisation
from flighttest.identify.validation.validate import HORIZONS_S
from flighttest.physics.core import Param
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

FOLDS = 5
BOOTSTRAPS = 400
RIDGE = 1e-9  # of unit columns: rounding
FEWEST_GROUPS = 6  # that a test at 2.5 % may be over: all of n alike have probability 2^-n by chance (sign test)
LEAST_ROWS = 60  # samples a place (channel and kind of maneuver) needs before its RMS means something


def held_out_groups(segments: Sequence[Segment]) -> tuple[IntArray, str]:
    """(n_segments,) group of each segment, and what a group is: never random samples.

    Cells where steps were flown, so that a model is asked for steps it has not seen; flights where several were flown freely;
    else contiguous pieces of the one flight.
    """
    if all(s.kind == "free" for s in segments):
        runs = list(dict.fromkeys(s.run for s in segments))
        if len(runs) >= 3:
            return np.array([runs.index(s.run) for s in segments]), "flights"
        pieces = min(10, max(2, len(segments) // 2))
        group = np.zeros(len(segments), dtype=np.intp)
        for at, i in enumerate(
            sorted(range(len(segments)), key=lambda i: (runs.index(segments[i].run), segments[i].t_s[0]))
        ):
            group[i] = at * pieces // max(len(segments), 1)
        return group, "pieces of the flight"
    keys = [s.cell_key if s.kind != "free" else ("free", (("piece", float(s.t_s[0] // 10)),)) for s in segments]
    names = sorted(set(keys), key=str)
    if len(names) < 4:
        return np.arange(len(segments)), "responses"
    return np.array([names.index(k) for k in keys]), "steps"


def folds_of(groups: IntArray) -> IntArray:
    """Group to one of at most five folds, neighbouring groups apart."""
    return groups % min(FOLDS, int(groups.max()) + 1) if groups.size else groups


@dataclass(frozen=True)
class ParameterPrior:
    """What is known of parameters before any data, from their optimum, in their own units: least (p,) <= 0 and most (p,) >= 0, how far they
    may move before they reach their bounds; std (p,) of a normal prior, which counts where a fold's training data do not."""

    least: FloatArray
    most: FloatArray
    std: FloatArray

    @classmethod
    def of(cls, params: Sequence[Param], values: Mapping[str, float]) -> ParameterPrior:
        """params: those that are estimated, in the order of the columns."""
        least = np.array([min(p.lower - values[p.name], 0.0) for p in params])
        most = np.array([max(p.upper - values[p.name], 0.0) for p in params])
        return cls(least, most, np.array([p.prior_std for p in params]))

    def without_each_fold(self, columns: FloatArray, residual: FloatArray, fold_of_row: IntArray) -> Iterator[Fold]:
        """What the rows of all other folds say of the parameters, fold by fold.

        columns (n, p), residual (n,): whitened. Least squares inside the bounds, as every estimate is.
        """
        length = np.hypot(np.linalg.norm(columns, axis=0), 1.0 / self.std)  # of a column and its prior: none is zero
        a, least, most = columns / length, self.least * length, self.most * length
        prior = np.diag(1.0 / (self.std * length) ** 2)
        gram, moment = a.T @ a, a.T @ residual
        for fold in np.unique(fold_of_row):
            inside = fold_of_row == fold
            own = a[inside]
            h = gram - own.T @ own + prior + RIDGE * np.eye(gram.shape[0])
            step = _bounded(h, moment - own.T @ residual[inside], least, most)
            yield Fold(inside, step / length, np.linalg.inv(h) / np.outer(length, length))


@dataclass(frozen=True)
class Fold:
    """inside: its rows (n,); step (p,) of the parameters from the optimum by the rows of all other folds, covariance (p, p) of it."""

    inside: NDArray[np.bool_]
    step: FloatArray
    covariance: FloatArray


def _bounded(h: FloatArray, g: FloatArray, least: FloatArray, most: FloatArray) -> FloatArray:
    """(p,) minimiser of x'hx / 2 - g'x with least <= x <= most."""
    x = np.asarray(np.linalg.lstsq(h, g, rcond=RIDGE)[0])
    if np.all((x >= least) & (x <= most)):
        return x
    power, axes = np.linalg.eigh(h)
    root = np.sqrt(np.maximum(power, RIDGE))
    return np.asarray(lsq_linear(root[:, None] * axes.T, (axes.T @ g) / root, (least, most), method="bvls").x)


def held_out(rows: Linearisation, names: Sequence[str], groups: IntArray, prior: ParameterPrior) -> FloatArray:
    """(n,) residual in the channel's unit of every response as predicted by parameters from the other folds.

    rows: at an optimum; linear in the parameters about it. A response keeps its own initial state, its disturbance is unknown.
    """
    fold_of_row, unprofiled = folds_of(groups)[rows.segment], rows.unprofiled_columns(names)
    out = rows.unprofiled_residual.copy()
    for fold in prior.without_each_fold(rows.columns(names), rows.residual, fold_of_row):
        out[fold.inside] -= unprofiled[fold.inside] @ fold.step
    return out


def cross_validated(
    rows: Linearisation, names: Sequence[str], groups: IntArray, weights: FloatArray, prior: ParameterPrior
) -> FloatArray:
    """(n,) minus twice the log density of whitened rows as predicted from the other folds, nuisance parameters marginalised, but for a
    constant that models of one weighting share.

        r ~ N(A step, I + A P A'),      P the covariance of the step

    Of u = (I + A P A')^(-1/2) (r - A step) and L = log(I + A P A') a row's share is u_i^2 + L_ii; they sum to that of the fold. What the
    others leave unknown of the parameters is in the density: a fold that alone determines one is not foreseen by any model, and says
    nothing of the others.

    rows: at an optimum; linear in the parameters about it. weights (n,): of each row, from the model's discrepancy.
    """
    root = np.sqrt(weights)
    a, r = rows.columns(names) * root[:, None], rows.residual * root
    out = r**2
    for fold in prior.without_each_fold(a, r, folds_of(groups)[rows.segment]):
        own = a[fold.inside]
        left = r[fold.inside] - own @ fold.step
        axes, spread = _of_prediction(own, fold.covariance)
        along = axes.T @ left
        out[fold.inside] = (left + axes @ ((1.0 / np.sqrt(1.0 + spread) - 1.0) * along)) ** 2 + axes**2 @ np.log1p(
            spread
        )
    return np.asarray(out)


def _of_prediction(columns: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Orthonormal axes (n, q) and variances (q,) of A P A', of columns A (n, p) and covariance P (p, p) of what they multiply."""
    power, vectors = np.linalg.eigh(covariance)
    moved = columns @ (vectors * np.sqrt(np.maximum(power, 0.0)))
    axes, size, _ = np.linalg.svd(moved, full_matrices=False)
    return axes, size**2


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of a model in groups that were not used (`held_out`), each response by its own initial state alone. residual: of each row of
    the model (n,), in the channel's unit."""

    rows: Linearisation
    residual: FloatArray

    def of(self, channel: str) -> tuple[IntArray, FloatArray]:
        """Segment and error of the samples of one channel, (m,) each."""
        at = self.rows.channel == self.rows.channels.index(channel)
        return self.rows.segment[at], self.residual[at]

    def squares(self, channel: str, groups: IntArray) -> tuple[FloatArray, FloatArray]:
        """Sum of squares and number of samples of one channel per group."""
        (segment, error), n = self.of(channel), int(groups.max()) + 1
        count = np.bincount(groups[segment], minlength=n).astype(float)
        return np.asarray(np.bincount(groups[segment], error**2, minlength=n), dtype=float), count


@dataclass(frozen=True)
class CrossValidation:
    """Rows of a model with minus twice their log predictive density (n,), as of `cross_validated`."""

    rows: Linearisation
    deviance: FloatArray

    def by_stratum(self) -> dict[str, float]:
        """Its sum in each stratum; '' for priors of initial states."""
        names = ("", *self.rows.strata)  # -1, of initial states, comes first
        return dict(zip(names, np.bincount(self.rows.stratum + 1, self.deviance, len(names)).tolist(), strict=True))

    def by_group(self, stratum: str, groups: IntArray) -> tuple[FloatArray, IntArray]:
        """(n_groups,) its sum and the number of rows in each group."""
        at = self.rows.stratum == self.rows.strata.index(stratum)
        group, n = groups[self.rows.segment[at]], int(groups.max()) + 1
        return np.asarray(np.bincount(group, self.deviance[at], n), dtype=float), np.bincount(group, minlength=n)


def stratum_gains(
    before: CrossValidation, after: CrossValidation, groups: IntArray, seed: int = 0
) -> dict[str, tuple[float, float]]:
    """Stratum to an interval of the gain in log predictive density, nats: 95 % percentile bootstrap (groups resampled) of strata recorded
    in `FEWEST_GROUPS` or more; where none is, over which no such interval decides anything, the least and the most that is left without
    any one of the groups.

    A response is predicted by parameters from other groups and by its own nuisance parameters, which are strata of their own. So the
    constant disturbance of a response does not hide whether the rest of it is predicted better.
    """
    gains = {}
    for name in before.rows.strata:
        (old, count), (new, _) = before.by_group(name, groups), after.by_group(name, groups)
        gains[name] = 0.5 * (old - new)[count > 0]
    most = max((gain.size for gain in gains.values()), default=0)
    found = {}
    for name, gain in gains.items():
        if most >= FEWEST_GROUPS <= gain.size:
            low, high = np.quantile(_resampled(np.arange(gain.size), seed) @ gain, [0.025, 0.975])
            found[name] = float(low), float(high)
        elif gain.size >= 2 and most < FEWEST_GROUPS:
            found[name] = float(gain.sum() - gain.max()), float(gain.sum() - gain.min())
    return found


def worse_in_more(worse: int, better: int) -> str:
    """Why a name goes with which so many channels of what was not used are surely predicted worse, so many better; empty where it stays."""
    counts = f"{worse} and {better}"
    return (
        f"of what was not used, more channels are predicted worse with it than better ({counts})"
        if worse > better
        else ""
    )


def gains_held_out(
    before: PredictionErrors, after: PredictionErrors, groups: IntArray, floor: NoiseFloor, seed: int = 0
) -> dict[str, HeldOutRow]:
    """Both models on the same samples; gain_95: 95 % interval of the drop in RMSE (bootstrap over groups)."""
    draws = _resampled(groups, seed)
    found = {}
    for name in (c for c in before.rows.channels if c in after.rows.channels):
        (ss_b, n_b), (ss_a, n_a) = before.squares(name, groups), after.squares(name, groups)
        if not n_b.any():  # masked in every response, as horizontal channels are where no attitude was recorded
            continue

        def rmse(ss: FloatArray, count: FloatArray) -> float:
            return float(np.sqrt(ss.sum() / max(count.sum(), 1.0)))

        drops = np.sqrt((draws @ ss_b) / np.maximum(draws @ n_b, 1e-9)) - np.sqrt(
            (draws @ ss_a) / np.maximum(draws @ n_a, 1e-9)
        )
        gain = np.quantile(drops[draws @ n_b > 0], [0.025, 0.975]).tolist()
        found[name] = HeldOutRow(
            rmse_before=rmse(ss_b, n_b), rmse_after=rmse(ss_a, n_a), floor=floor.of(name), gain_95=gain
        )
    return found


def _resampled(groups: IntArray, seed: int) -> FloatArray:
    """(draws, groups) how often each group is in a bootstrap sample."""
    n = int(groups.max()) + 1
    return np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), size=BOOTSTRAPS).astype(float)


def places(rows: Linearisation, segments: Sequence[Segment]) -> dict[tuple[str, str], IntArray]:
    """(channel, kind of maneuver) to its rows, where there are enough of them. segments: of these rows."""
    return rows.once("places", lambda: _places(rows, segments))


def _places(rows: Linearisation, segments: Sequence[Segment]) -> dict[tuple[str, str], IntArray]:
    names, code = np.unique([s.kind for s in segments], return_inverse=True)
    kinds = code[rows.segment]
    found = {}
    for c, name in enumerate(rows.channels):
        mine = np.flatnonzero(rows.channel == c)
        for k in np.unique(kinds[mine]):
            at = mine[kinds[mine] == k]
            if at.size >= LEAST_ROWS:
                found[name, str(names[k])] = at
    return found


def size_in_floors(
    rows: Linearisation,
    effect: FloatArray,
    segments: Sequence[Segment],
    floor: NoiseFloor,
) -> tuple[float, tuple[str, str]]:
    """Largest RMS of an effect ((n,), in the channel's unit) over a place, in noise floors, and the place."""
    best, where = 0.0, ("", "")
    for place, at in places(rows, segments).items():
        size = float(np.sqrt(np.mean(effect[at] ** 2))) / floor.of(place[0])
        if size > best:
            best, where = size, place
    return best, where


def horizon_rmse(errors: PredictionErrors, segments: Sequence[Segment]) -> dict[str, dict[str, float]]:
    """Channel to horizon (s since the response's first sample, as text) to RMSE of what lies within it."""
    rows = errors.rows
    since = np.array(
        [segments[i].t_s[max(k, 0)] - segments[i].t_s[0] for i, k in zip(rows.segment, rows.sample, strict=True)]
    )
    longest = float(since.max(initial=0.0))
    found: dict[str, dict[str, float]] = {}
    for c, name in enumerate(rows.channels):
        for horizon in HORIZONS_S:
            at = (rows.channel == c) & (since <= horizon)
            if at.any() and horizon <= longest + 0.5:
                found.setdefault(name, {})[f"{horizon:g}"] = float(np.sqrt(np.mean(errors.residual[at] ** 2)))
    return found


def excess(rows: Linearisation, floor: NoiseFloor) -> dict[str, float]:
    """Channel to what of its mean square lies above the floor, in the channel's unit squared."""
    raw = rows.unprofiled_residual
    found = {}
    for c, name in enumerate(rows.channels):
        at = rows.channel == c
        found[name] = max(float(np.mean(raw[at] ** 2)) - floor.whole(name) ** 2, 0.0) if at.any() else 0.0
    return found


def share_left(first: Linearisation, last: Linearisation, floor: NoiseFloor) -> float:
    """Of the mean square above the floor that one model leaves (`excess`), the share that another leaves: mean over the channels in which
    it is as large as the floor's; 0 where there are none."""
    left = excess(last, floor)
    shares = [min(left[n] / v, 1.0) for n, v in excess(first, floor).items() if v >= floor.whole(n) ** 2]
    return float(np.mean(shares)) if shares else 0.0
