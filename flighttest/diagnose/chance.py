"""How sure rows make us: errors and probabilities that hold although samples of one response go together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from flighttest.diagnose.noise import inflation
from flighttest.diagnose.rows import Rows

FloatArray = NDArray[np.float64]


LEAST_LEFT = 0.1  # of the information on a parameter, without a group: with less, its value says nothing of the group
AGREEMENT = 0.9  # of the responses' parts in a score, -1 to 1
PLAIN = ((6.0, -50.0), (3.0, -200.0))  # (responses that carry an effect, fall of the criterion that is then asked for)


def plain(parts: FloatArray, bic: float) -> bool:
    """Whether an effect is beyond chance although too few responses carry it for sign flips ever to say so: they agree on it, and the
    criterion falls far, the further the fewer they are. parts: of each response in the score; bic: change of the criterion."""
    size = float(np.abs(parts).sum())
    agreement, carriers = float(parts.sum()) / max(size, 1e-300), size**2 / max(float(parts @ parts), 1e-300)
    return agreement >= AGREEMENT and any(carriers >= fewest and bic < least for fewest, least in PLAIN)


def parts_of(rows: Rows, own: FloatArray) -> FloatArray:
    """(responses,) how far an effect, (measured rows,) in the channels' units, goes along with the residual of each response."""
    _, which = np.unique(rows.segment, return_inverse=True)
    return np.asarray(
        np.bincount(which[: own.size], own / rows.scale[: own.size] * rows.residual[: own.size]), dtype=float
    )


def consistency(parts: FloatArray) -> float:
    """Probability that an effect would go along with the residual as well as it does if responses had random signs."""
    spread = float(np.sqrt(np.sum(parts**2)))
    if spread <= 0:
        return 1.0
    # Normal tail of the sign-flip distribution: exact enough, and not bounded by the number of flips drawn.
    return float(2 * stats.norm.sf(abs(float(parts.sum())) / spread))


def standard_errors(rows: Rows, names: tuple[str, ...]) -> FloatArray:
    """(p,) standard errors robust to correlation within responses (sandwich over segments)."""
    a = rows.columns(names)
    length = np.maximum(np.sqrt(np.sum(a**2, axis=0)), 1e-300)
    a = a / length
    inverse = np.linalg.pinv(a.T @ a, rcond=1e-10, hermitian=True)
    _, which = np.unique(rows.segment, return_inverse=True)
    n = int(which.max()) + 1
    moments = np.zeros((n, a.shape[1]))
    np.add.at(moments, which, a * rows.residual[:, None])
    meat = moments.T @ moments * (n / max(n - 1, 1))
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0.0)) / length)


def disagreement(rows: Rows, names: tuple[str, ...]) -> FloatArray:
    """(p,) how far parameters depend on which part of the recording is believed: the larger of the delete-a-group jackknife's standard
    errors over channels, and over quarters of the responses (one linear step each).

    An equation that is nearly right bends every response in the same way, so that responses never tell; but it bends the instruments,
    and a response's beginning and end, in different ways. A group that alone knows a parameter cannot be left out for it.
    """
    a = rows.columns(names)
    length = np.maximum(np.sqrt(np.sum(a**2, axis=0)), 1e-300)
    a = a / length
    longest = np.zeros(int(rows.segment.max()) + 1, dtype=np.intp)
    np.maximum.at(longest, rows.segment, rows.sample + 1)
    quarter = 4 * rows.sample // np.maximum(longest[rows.segment], 1)
    measured = rows.sample >= 0
    each = [_jackknife(a, rows.residual, np.where(measured, group, -1)) for group in (rows.channel, quarter)]
    return np.asarray(np.max(each, axis=0) / length)


def _jackknife(a: FloatArray, residual: FloatArray, group: NDArray[np.intp]) -> FloatArray:
    """(p,) delete-a-group jackknife standard errors at an optimum of whitened rows a (n, p); rows of group -1 always stay."""
    gram, moment = a.T @ a, a.T @ residual
    variance = np.diag(np.linalg.pinv(gram, rcond=1e-10, hermitian=True))
    shifts, told = [], []
    for one in np.unique(group[group >= 0]):
        own = a[group == one]
        inverse = np.linalg.pinv(gram - own.T @ own, rcond=1e-10, hermitian=True)
        shifts.append(inverse @ (moment - own.T @ residual[group == one]))
        told.append(variance > LEAST_LEFT * np.diag(inverse))
    shift, use = np.array(shifts), np.array(told)
    count = np.maximum(use.sum(axis=0), 1)
    mean = np.sum(shift * use, axis=0) / count
    return np.asarray(np.sqrt((count - 1) / count * np.sum(use * (shift - mean) ** 2, axis=0)))


def effective_size(rows: Rows) -> float:
    """Number of samples that count, correlated ones as fewer."""
    tau = inflation(rows)
    return sum(float(np.sum(rows.channel == c)) / t for c, t in tau.items())
