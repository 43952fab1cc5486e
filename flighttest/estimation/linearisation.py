"""`Linearisation`: whitened residuals and Jacobian of a model at an optimum, the nuisance parameters of every response projected out.

With the nuisance parameters l_i of response i (initial state, constant disturbance; Gaussian priors) stacked under the residuals as prior
rows, the projection orthogonal to d(residual, prior)/d l_i turns inner products of rows into those of the generalised least squares
problem in which l_i is marginalised (Schur complement), so that models can be compared by plain linear algebra.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.problem import Noise

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
T = TypeVar("T")
RANK = 1e-12  # relative eigenvalue of a Gram matrix of unit columns below which a direction is rounding error


@dataclass(frozen=True)
class Optimum:
    """A fitted model. values: every parameter; nuisance: name to (n_segments,), NaN where a segment has none; objective: whitened sum of
    squares, priors of the nuisance parameters included; infinite where the simulation is not finite. It compares points of one noise only;
    log_likelihood, with the noise's own normalisation, compares any."""

    values: dict[str, float]
    nuisance: dict[str, FloatArray]
    noise: Noise
    objective: float
    log_likelihood: float = -np.inf

    @property
    def without_correlation(self) -> Optimum:
        """As the start of a fit that learns the correlation of channels anew: what a term explains is in it no longer."""
        return replace(self, noise=replace(self.noise, correlation={}))


@dataclass(frozen=True)
class Projection:
    """The nuisance parameters of one part of a problem with m responses, as `Linearisation` projects them out.

    basis (m, k, n_l), start (m, k, n_f): orthonormal, of all nuisance parameters and of the initial states alone, over the k - n_l samples
    (times outputs) and the n_l priors; scale (k - n_l,): standard deviations that samples were whitened by; keep (m, k - n_l): which of
    them were measured.
    """

    basis: FloatArray
    start: FloatArray
    scale: FloatArray
    keep: NDArray[np.bool_]

    def profiled(self, raw: FloatArray) -> FloatArray:
        """(m, k, q) whitened and profiled changes, of changes (m, k - n_l, q) of the outputs in their units."""
        return project(self.basis, self._whitened(raw))

    def unprofiled(self, raw: FloatArray) -> FloatArray:
        """(m, k, q) the same in units, with only the initial states profiled out."""
        unit = np.concatenate([self.scale, np.zeros(self.basis.shape[2])])[:, None]
        return np.asarray(project(self.start, self._whitened(raw)) * unit)

    def _whitened(self, raw: FloatArray) -> FloatArray:
        """With a row of zeros for each prior."""
        m, n, q = raw.shape
        found = np.zeros((m, n + self.basis.shape[2], q))
        np.divide(raw, self.scale[:, None], out=found[:, :n])
        return found


def in_order(projections: Sequence[Projection], values: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Per part (m, k, ...) to rows (n, ...): measured rows first, so that models with other nuisance parameters have them in one place."""
    measured = [v[:, : p.keep.shape[1]][p.keep] for p, v in zip(projections, values, strict=True)]
    priors = [np.concatenate(v[:, p.keep.shape[1] :]) for p, v in zip(projections, values, strict=True)]
    return np.concatenate([*measured, *priors])


@dataclass(frozen=True)
class Linearisation:
    """Rows of a model at an optimum: one per sample and channel, then one per prior of a nuisance parameter (sample and channel -1).

    residual (n,), jacobian (n, p): whitened and profiled (a step d of the parameters lowers the residual by jacobian @ d);
    unprofiled_residual: in units of the channel, with only initial states projected out: what the model does not predict of a response
    without knowing its disturbance; derivatives: per part (m, samples times outputs, p), in the channels' units, of which
    `unprofiled_jacobian` is made where it is asked for. scale (n,): standard deviations that rows were whitened by;
    segment, sample (n,): positions in the estimator's segments and in their t_s; channel (n,): index into `channels`, -1 for priors;
    stratum (n,): rows that share a variance: the channel, then `disturbances`, -1 for priors of initial states. projections: by part.
    """

    residual: FloatArray
    jacobian: FloatArray
    unprofiled_residual: FloatArray
    derivatives: tuple[FloatArray, ...]
    scale: FloatArray
    segment: IntArray
    sample: IntArray
    stratum: IntArray
    channels: tuple[str, ...]
    disturbances: tuple[str, ...]
    names: tuple[str, ...]
    projections: tuple[Projection, ...] = ()
    _known: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def once(self, key: Any, work: Callable[[], T]) -> T:
        """The result of `work` on these rows, which is done once."""
        if key not in self._known:
            self._known[key] = work()
        found: T = self._known[key]
        return found

    @property
    def channel(self) -> IntArray:
        """(n,) index into `channels`, -1 for priors."""
        return self.once("channel", lambda: np.where(self.sample >= 0, self.stratum, -1))

    @property
    def strata(self) -> tuple[str, ...]:
        """Names of the strata, in the order of their index."""
        return (*self.channels, *self.disturbances)

    @property
    def unprofiled_jacobian(self) -> FloatArray:
        """(n, p) in units of the channel, with only initial states projected out."""
        return self.once("unprofiled", lambda: self.unprofiled(self.derivatives))

    def profiled(self, raw: Sequence[FloatArray]) -> FloatArray:
        """(n, q) columns as in `jacobian`, of a change given per part, (m, samples times outputs, q) in the channels' units."""
        return self._rows([part.profiled(one) for part, one in zip(self.projections, raw, strict=True)])

    def unprofiled(self, raw: Sequence[FloatArray]) -> FloatArray:
        """(n, q) columns as in `unprofiled_jacobian`, of such a change."""
        return self._rows([part.unprofiled(one) for part, one in zip(self.projections, raw, strict=True)])

    def _rows(self, values: Sequence[FloatArray]) -> FloatArray:
        return np.asarray(in_order(self.projections, values), dtype=float)

    def columns(self, names: Sequence[str]) -> FloatArray:
        """(n, k) columns of `jacobian` by name."""
        return self.jacobian[:, [self.names.index(n) for n in names]]

    def unprofiled_columns(self, names: Sequence[str]) -> FloatArray:
        """(n, k) columns of `unprofiled_jacobian` by name."""
        return self.unprofiled_jacobian[:, [self.names.index(n) for n in names]]


def project(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """(m, n, k) columns without what (m, n, l) orthonormal bases span."""
    return np.asarray(columns - np.matmul(basis, np.matmul(basis.transpose(0, 2, 1), columns)))


def orthonormal_each(columns: FloatArray) -> FloatArray:
    """(m, n, l) orthonormal columns, the first k of which span the first k of the given (m, n, l), which are of full rank.

    Cholesky QR, twice (Yamamoto et al. 2015): matrix products only, several times faster than Householder's on many long matrices.
    """
    length = np.sqrt(np.einsum("mnl,mnl->ml", columns, columns))[:, None, :]
    found = columns / np.maximum(length, np.finfo(float).tiny)
    try:
        for _ in range(2):
            factor = np.linalg.cholesky(np.matmul(found.swapaxes(1, 2), found))
            found = np.matmul(found, np.linalg.inv(factor).swapaxes(1, 2))
    except np.linalg.LinAlgError:  # nearly dependent: the product has lost what separates them
        return np.asarray(np.linalg.qr(columns)[0])
    return np.asarray(found)


def orthonormal(columns: FloatArray) -> FloatArray:
    """Orthonormal basis (n, r) of the column space of (n, p), r its numerical rank."""
    length = np.sqrt(np.sum(columns**2, axis=0))
    columns = columns[:, length > 0] / length[length > 0]
    if not columns.shape[1]:
        return np.zeros((columns.shape[0], 0))
    # Through the Gram matrix: the columns are long and few.
    values, vectors = np.linalg.eigh(columns.T @ columns)
    used = values > RANK * values[-1]
    return np.asarray(columns @ (vectors[:, used] / np.sqrt(values[used])))


def inverse_of_gram(gram: FloatArray, rank: float = RANK) -> FloatArray:
    """Pseudo-inverse (p, p) of a Gram matrix, its columns taken at unit length; zero for a column that is zero. rank: relative eigenvalue
    below which a direction is none."""
    length = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), np.inf))
    unit = np.outer(length, length)
    return np.asarray(np.linalg.pinv(gram / unit, rcond=rank, hermitian=True) / unit)
