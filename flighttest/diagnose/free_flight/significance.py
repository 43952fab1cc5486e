"""Wald tests of the linear coefficients of a term, as estimated from free flight, against their null values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.selection.admissible import unit_suffix
from flighttest.diagnose.selection.candidates import null_value
from flighttest.estimation.uncertainty.distributions import fisher_beyond
from flighttest.identify.free_flight import FreeFlight
from flighttest.physics.core import Term

FloatArray = NDArray[np.float64]

# p-value of a null value at the edge of the intervals that are printed, of 95 %. Inside them a term is not named, and no longer named when
# further terms join.
EDGE_OF_INTERVAL = 0.05


def coefficients_of(found: FreeFlight, term: Term) -> list[int]:
    """Positions of a term's linear coefficients, of its nonlinear parameters where it has none, in an estimate."""
    own = {p.name for p in (term.amplitudes or term.params)}
    return [i for i, n in enumerate(found.names) if n.split("@")[0] in own]


def wald(found: FreeFlight, term: Term, covariance: FloatArray) -> float:
    """p-value of a term's linear coefficients against their null values, with a covariance (q, q) in the order of the estimate's names; 1
    where it has none, or where that is infinite."""
    at = coefficients_of(found, term) if term.amplitudes else []
    own = covariance[np.ix_(at, at)]
    if not at or not np.isfinite(own).all():
        return 1.0
    null = {p.name: null_value(p) for p in term.amplitudes}
    off = np.array([found.values[found.names[i]] - null[found.names[i].split("@")[0]] for i in at])
    dof = float(max(found.blocks - len(found.names), 2))
    return fisher_beyond(float(off @ np.linalg.pinv(own) @ off) / len(at), len(at), dof)


def null_inside_interval(found: FreeFlight, term: Term) -> str:
    """That the null values of a term's linear coefficients are inside the printed intervals, all together, in words; empty where not.

    `covariance_at` says whether the term is present, this whether its value is known at all: third poles with a share of 1.0 +- 2.2 and
    +- 6.2 and a vortex ring of 0.30 +- 0.31 were surely present in three flights of a tunnel that have neither. What flights differ by
    makes a value uncertain and not its presence.
    """
    if not term.amplitudes or (p_value := wald(found, term, found.covariance - found.between)) <= EDGE_OF_INTERVAL:
        return ""
    half = found.factor()
    words = (
        f"{p.name} is {found.values[p.name]:.2g} +- {half * found.std[p.name]:.1g}{unit_suffix(p)}"
        for p in term.amplitudes
        if p.name in found.names
    )
    return f"{', '.join(words)}, which may be nothing (p {p_value:.2g}, asked {EDGE_OF_INTERVAL:g})"
