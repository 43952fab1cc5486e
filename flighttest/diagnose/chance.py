"""How sure rows make us: errors and probabilities that hold although samples of one response go together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from flighttest.diagnose.noise import inflation
from flighttest.diagnose.rows import Rows

FloatArray = NDArray[np.float64]


LEAST_LEFT = 0.25  # share of a parameter's information that must remain for the rest to be a check on a part left out
LEAST_TOLD = 0.01  # share that a part must have to be one that is asked
ESTIMABLE = 0.99  # of a direction: less is left to the pseudo-inverse, which then puts nothing for something
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


def consistency(parts: FloatArray, freedom: int) -> float:
    """Probability that an effect would go along with the residual as well as it does if responses had random signs. freedom: parameters
    that were fitted to that residual, which find the direction that goes along best."""
    spread = float(np.sqrt(np.sum(parts**2)))
    if spread <= 0:
        return 1.0
    # Tail of the sign-flip distribution as a normal one: exact enough, and not bounded by the number of flips drawn.
    return float(stats.chi.sf(abs(float(parts.sum())) / spread, freedom))


def standard_errors(rows: Rows, names: tuple[str, ...]) -> FloatArray:
    """(p,) standard errors robust to correlation within responses (sandwich over segments)."""
    a, length, inverse = _scaled(rows.columns(names))
    return np.asarray(_robust(a, rows.residual, rows.segment, inverse) / length)


def estimate_from(rows: Rows, names: tuple[str, ...], some: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """(step, standard errors), both (p,): by some rows (n,) alone, one linear step from the optimum of all. What they cannot tell steps
    nowhere, with an error of zero."""
    a, length, inverse = _scaled(rows.columns(names)[some])
    step = inverse @ (a.T @ rows.residual[some])
    robust = _robust(a, rows.residual[some] - a @ step, rows.segment[some], inverse)
    return step / length, robust / length


def _scaled(a: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Columns of unit length (n, p), their lengths (p,), and the pseudo-inverse of their products (p, p)."""
    length = np.asarray(np.maximum(np.sqrt(np.sum(a**2, axis=0)), 1e-300))
    a = a / length
    return a, length, np.asarray(np.linalg.pinv(a.T @ a, rcond=1e-10, hermitian=True))


def _robust(a: FloatArray, residual: FloatArray, segment: NDArray[np.intp], inverse: FloatArray) -> FloatArray:
    """(p,) sandwich standard errors, clustered by segment."""
    _, which = np.unique(segment, return_inverse=True)
    n = int(which.max()) + 1
    moments = np.zeros((n, a.shape[1]))
    np.add.at(moments, which, a * residual[:, None])
    meat = moments.T @ moments * (n / max(n - 1, 1))
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0.0)))


def standard_errors_of_equations(rows: Rows, names: tuple[str, ...]) -> FloatArray:
    """(p,) standard errors that hold although an equation is only nearly right: by how responses scatter, and by how far it matters
    which part of the recording is believed, beyond what scatter lets expect. Parts: channels, and quarters of the responses.

    An equation that is nearly right bends every response in the same way, so that responses never tell; but it bends the instruments,
    and a response's beginning and end, in different ways. Each part is left out in turn by one linear step (delete-a-group jackknife).
    """
    a, length, inverse = _scaled(rows.columns(names))
    robust = _robust(a, rows.residual, rows.segment, inverse)
    longest = np.zeros(int(rows.segment.max()) + 1, dtype=np.intp)
    np.maximum.at(longest, rows.segment, rows.sample + 1)
    quarter = 4 * rows.sample // np.maximum(longest[rows.segment], 1)
    measured = rows.sample >= 0
    inflation = robust**2 / np.maximum(np.diag(inverse), 1e-300)  # what scatters, over what white noise would
    excess = [_jackknife(a, rows.residual, np.where(measured, part, -1), inflation) for part in (rows.channel, quarter)]
    return np.asarray(np.sqrt(robust**2 + np.max(excess, axis=0)) / length)


def _jackknife(a: FloatArray, residual: FloatArray, part: NDArray[np.intp], inflation: FloatArray) -> FloatArray:
    """(p,) variance by which estimates differ between parts of whitened rows a (n, p) at an optimum, beyond what noise makes of it (white
    noise, times inflation (p,)). Rows of part -1 always stay; a part that tells next to nothing of a parameter, or alone knows it, is no
    judge of it."""
    gram = a.T @ a
    variance = np.diag(np.linalg.pinv(gram, rcond=1e-10, hermitian=True))
    total, judges = np.zeros(a.shape[1]), np.zeros(a.shape[1])
    for one in np.unique(part[part >= 0]):
        own = a[part == one]
        left = gram - own.T @ own
        inverse = np.linalg.pinv(left, rcond=1e-10, hermitian=True)
        without = np.diag(inverse)
        shift = inverse @ (own.T @ residual[part == one])
        share = variance / np.maximum(without, 1e-300)  # of the information that is left
        known = np.diag(inverse @ left) > ESTIMABLE
        judge = known & (share > LEAST_LEFT) & (share < 1.0 - LEAST_TOLD)
        total += np.where(judge, shift**2 - np.maximum(without - variance, 0.0) * inflation, 0.0)
        judges += judge
    return np.asarray(np.maximum(total, 0.0) * np.maximum(judges - 1.0, 1.0) / np.maximum(judges, 2.0))


def effective_size(rows: Rows) -> float:
    """Number of samples that count, correlated ones as fewer."""
    tau = inflation(rows)
    return sum(float(np.sum(rows.channel == c)) / t for c, t in tau.items())
