"""Model discrepancy: how much of a residual repeats have in common, and how far that reduces the information of its samples.

Statistical model of one stratum k (a channel, or the constant disturbances of one axis), whitened residual of repeat r of cell c:

    r_cr(t) = J_cr(t) d_theta + g_c(t) + e_cr(t),      var(e) = s_e^2,  var(g) = s_g^2

e: noise, from differences between repeats; g: lack of fit, common to the repeats of a cell. Method of moments (which is REML for balanced
repeats): s_g^2 = mean square - s_e^2 where the lack of fit is significant, else 0. The share of the discrepancy is
f = s_g^2 / (s_g^2 + s_e^2). Of e, samples correlated over tau count once per tau (integrated autocorrelation time); of g, whose shape in a
cell is unknown, a cell counts once. The variance inflation of an average over n samples of C cells is therefore

    psi = (1 - f) tau + f n / C

and an estimate weighs a stratum by 1 / ((s_g^2 + s_e^2) psi). Where a model is judged whose equations may err alike in all cells of a
kind of maneuver, C counts kinds. More repeats reduce the part of the noise only, more cells that of the discrepancy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.residuals.lack_of_fit import SIGNIFICANCE, NoiseFloor
from flighttest.estimation.autocorrelation import UNCORRELATED, lagged_products
from flighttest.estimation.linearisation import FloatArray, IntArray, Linearisation
from flighttest.estimation.problem import cells_of
from flighttest.estimation.uncertainty.distributions import chi2_beyond
from flighttest.segments.model import Segment

BIN_S = 0.05  # residuals are averaged over it before they are correlated
LONGEST_S = 300.0  # from the step: later samples of a response count as if they were this late
FEWEST_PAIRS = 20


@dataclass(frozen=True)
class Discrepancy:
    """Per stratum (index as in `Linearisation.stratum`), (n_strata,): variance of whitened rows, share f of the discrepancy in it, variance
    inflation psi, number of rows; of initial states' priors nothing is estimated (variance 1, inflation 1)."""

    variance: FloatArray
    share: FloatArray
    inflation: FloatArray
    count: FloatArray

    def weights(self, rows: Linearisation) -> FloatArray:
        """(n,) of each row: 1 / (variance inflation)."""
        weight = np.append(1.0 / (self.variance * self.inflation), 1.0)
        return np.asarray(weight[rows.stratum])  # -1 is the last


def discrepancy_of(
    rows: Linearisation,
    residual: FloatArray,
    segments: Sequence[Segment],
    floor: NoiseFloor,
    clusters: IntArray | None = None,
) -> Discrepancy:
    """residual (n,): whitened, what the model's own columns explain taken out. floor: of the present model. clusters (n_segments,): within
    which the discrepancy is one; None: cells."""
    cells = cells_of(segments) if clusters is None else clusters
    strata = len(rows.strata)
    variance, share, inflation, count = np.ones(strata), np.zeros(strata), np.ones(strata), np.zeros(strata)
    tau = correlation_times(rows, residual, segments)
    names, kind_of = np.unique([s.kind for s in segments], return_inverse=True)
    kinds = kind_of[rows.segment]
    for k, name in enumerate(rows.strata):
        at = np.flatnonzero(rows.stratum == k)
        if not at.size:
            continue
        n_cells = np.unique(cells[rows.segment[at]]).size
        variance[k] = max(float(np.mean(residual[at] ** 2)), 1e-12)
        count[k] = at.size
        if name in rows.channels:
            raw = rows.unprofiled_residual
            mean_square = float(np.mean(raw[at] ** 2))
            lacking = any(
                floor.exceeded(name, str(kind), float(np.mean(raw[some] ** 2)), some.size / tau[k])
                for number, kind in enumerate(names)
                if (some := at[kinds[at] == number]).size >= 2 * FEWEST_PAIRS
            )
            share[k] = max(0.0, 1.0 - floor.whole(name) ** 2 / mean_square) if lacking else 0.0
        else:
            # Whitened by the variance between repeats: above one is what repeats have in common.
            lacking = chi2_beyond(variance[k] * at.size, at.size) < SIGNIFICANCE
            share[k] = max(0.0, 1.0 - 1.0 / variance[k]) if lacking else 0.0
            variance[k] = max(variance[k], 1.0)
        inflation[k] = (1.0 - share[k]) * tau[k] + share[k] * max(at.size / n_cells, tau[k])
    return Discrepancy(variance, share, inflation, count)


def correlation_times(rows: Linearisation, residual: FloatArray, segments: Sequence[Segment]) -> FloatArray:
    """(n_strata,) integrated autocorrelation of a residual in samples, correlation between the repeats of a cell included; 1 for
    disturbances."""
    cells = cells_of(segments)
    zero = np.array([s.t_step_s if s.kind != "free" else s.t_s[0] for s in segments])
    longest = max(s.t_s.size for s in segments)
    times = np.zeros((len(segments), longest))
    for i, s in enumerate(segments):
        times[i, : s.t_s.size] = s.t_s - zero[i]
    found = np.ones(len(rows.strata))
    for k in range(len(rows.channels)):
        at = np.flatnonzero(rows.stratum == k)
        if at.size:
            since = times[rows.segment[at], rows.sample[at]]
            bins = np.floor(np.clip(since, -LONGEST_S, LONGEST_S) / BIN_S).astype(np.intp)
            found[k] = _integrated(residual[at], rows.segment[at], bins - bins.min(), cells)
    return found


def _integrated(x: FloatArray, segment: NDArray[np.intp], bins: NDArray[np.intp], cells: NDArray[np.intp]) -> float:
    """Integrated autocorrelation time of samples x (n,), in samples."""
    length, n = int(bins.max()) + 1, cells.size
    total, count = np.zeros((n, length)), np.zeros((n, length))
    np.add.at(total, (segment, bins), x)
    np.add.at(count, (segment, bins), 1.0)
    seen = (count > 0).astype(float)
    mean = total / np.maximum(count, 1.0)
    per_bin, power = float(count.sum() / seen.sum()), float((mean**2).sum() / seen.sum())
    variance = float(x @ x) / x.size
    if power <= 0.0 or variance <= 0.0:
        return 1.0

    by_cell = np.zeros((int(cells.max()) + 1, length))
    np.add.at(by_cell, cells, mean)
    own, pairs, together = (lagged_products(some) for some in (mean, seen, by_cell))
    sum_of = 0.0
    for lag in range(length):
        if pairs[lag] < FEWEST_PAIRS or (lag and own[lag] / pairs[lag] < UNCORRELATED * power):
            break
        sum_of += (2.0 if lag else 1.0) * max(together[lag] / (seen.sum() * power), 0.0)
    return max(1.0, power / variance * per_bin * max(sum_of, 1.0))
