"""How sure rows make us: errors and probabilities that hold although samples of one response go together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from flighttest.diagnose.noise import inflation
from flighttest.diagnose.rows import Rows

FloatArray = NDArray[np.float64]


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


def effective_size(rows: Rows) -> float:
    """Number of samples that count, correlated ones as fewer."""
    tau = inflation(rows)
    return sum(float(np.sum(rows.channel == c)) / t for c, t in tau.items())
