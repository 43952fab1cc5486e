"""What equations get wrong as a function of the state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.equation_error.autoregression import Autoregression
from flighttest.estimation.equation_error.streams import Stream, whitened_rows
from flighttest.estimation.linearisation import orthonormal

FloatArray = NDArray[np.float64]

SHARED = 1e-3  # of a function of the state that is left beside the parameters, below which it is one of them


def second_order(state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, k) the states and (n, k (k + 1) / 2) their squares and products, each about its mean and in its standard deviation."""
    first = _standardised(state)
    i, j = np.triu_indices(state.shape[1])
    return first, _standardised(first[:, i] * first[:, j])


def _standardised(values: FloatArray) -> FloatArray:
    off = values - values.mean(axis=0)
    return np.asarray(off / np.maximum(np.std(off, axis=0), 1e-12))


@dataclass(frozen=True)
class LackOfFit:
    """ratio: F, mean square of the innovations that second-order functions of the state explain beside the parameters, over that of the
    innovations, 1; at least 1. excess (q, q): variance of the parameters' scores beyond their information."""

    ratio: float
    excess: FloatArray


def lack_of_fit(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> dict[str, LackOfFit]:
    """Channel to the lack of fit of its equation (Draper and Smith 1998, section 2.1; functions of the state take the place of repeats, as
    in Ramsey's test, 1969).

    What the equations get wrong recurs with the state and a gust does not. Where F is above 1, that part of the parameters' own columns
    which functions of the state are errs by as much: its variance is F times that of the innovations (Birge 1932). Linear functions, and
    squares, have an F of their own where it is larger than that of both: in the wind of a tunnel the angle that a pitch loop holds was off
    by 6 to 8 % of itself, F 14 of linear functions, 4 of squares, 6 of both. Of 72 couplings of the axes that were added to nine flights
    there, 54 were inside their 95 % intervals by one F, and 61 by two.
    """
    width = streams[0].columns.shape[1] if streams else 0
    found = {c: [_Explained(np.zeros((width, width))) for _ in range(2)] for c in noise}
    for s in streams:
        ar = noise[s.channel]
        residual, columns = whitened_rows(ar, s)
        known, functions = orthonormal(columns), np.zeros((residual.size, 0))
        for order, values in zip(found[s.channel], second_order(s.state), strict=True):
            white = ar.whitened(values)
            own, apart = _beside(white, known), _beside(white, functions)
            known, functions = np.column_stack([known, own]), np.column_stack([functions, apart])
            order.square += float(np.sum((own.T @ residual) ** 2))
            order.count += own.shape[1]
            part = apart.T @ columns
            order.along += part.T @ part
    return {c: _lack(orders) for c, orders in found.items()}


def _beside(values: FloatArray, known: FloatArray) -> FloatArray:
    """Orthonormal basis of what values (n, k) are beside an orthonormal basis (n, r)."""
    left = values - known @ (known.T @ values)
    return orthonormal(left[:, np.sum(left**2, axis=0) > SHARED * np.sum(values**2, axis=0)])


@dataclass
class _Explained:
    """By functions of the state of one order. along: (q, q) squares and products of that part of the parameters' whitened columns which
    they are; square: of the innovations that they explain; count: of functions."""

    along: FloatArray
    square: float = 0.0
    count: int = 0


def _lack(orders: Sequence[_Explained]) -> LackOfFit:
    both = max(sum(o.square for o in orders) / max(sum(o.count for o in orders), 1), 1.0)
    # An order may have few functions beside the parameters, or none: what both have is the least.
    excess = sum((max(o.square / max(o.count, 1), both) - 1.0) * o.along for o in orders)
    return LackOfFit(both, np.asarray(excess))
