"""Score tests of the catalogue on free flight by equation error: every linear coefficient of the translation in a few passes.

At the optimum of the base model the whitened equations are linear in a candidate's coefficients. Its columns beside the base's give
the score test (Rao 1948) with a covariance by blocks of 1 to 5 s, so that a spectrum that the noise model missed does not name a term.
Terms whose states have unknown initial values (slung load, latency of the velocity) and those without a linear coefficient are not
seen here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.selection.candidates import grid, null_value
from flighttest.diagnose.selection.detectability import missing_channels
from flighttest.estimation.equation_error import Stream, Whitened, block_rows, whiten
from flighttest.estimation.uncertainty.distributions import fisher_beyond
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.motion_equations import Equations
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

FEWEST_BLOCKS = 8  # beside the parameters: below, a covariance by blocks is none


@dataclass(frozen=True)
class Screened:
    """A candidate's score test. shape: its nonlinear parameters; coefficients: one-step estimates by name, from their null values; p_value;
    size: root mean square of its effect beside the base model, m/s^2; std: of the coefficients, by blocks."""

    term: str
    shape: Mapping[str, float]
    coefficients: Mapping[str, float]
    p_value: float
    size: float
    std: Mapping[str, float] = field(default_factory=dict)


def seen_by_equations(term: Term) -> bool:
    """Whether a term has a linear coefficient in the translation and no state of unknown initial value."""
    return block_of(term) == "translation" and bool(term.amplitudes) and not any(s.free for s in term.states)


def screen(flown: Sequence[Segment], base: FreeFlight, pool: Sequence[Term]) -> tuple[Screened, ...]:
    """Score tests of the terms that the equations see, most significant first; of each the best of its declared shapes.

    flown: stretches that `base` was estimated from. A term whose columns are not finite is left out.
    """
    terms = [
        t
        for t in pool
        if seen_by_equations(t) and t.id not in base.model.terms and not missing_channels(t, tuple(flown))
    ]
    if not terms:
        return ()
    equations = Equations(base.model.with_terms(*terms), flown)
    own_of_flights = tuple(dict.fromkeys(n.split("@")[0] for n in base.names if "@" in n))
    names = [*(n for n in base.names if "@" not in n), *own_of_flights]
    period = float(np.median(np.concatenate([np.diff(s.t_s) for s in flown])))
    rows = block_rows(sum(float(np.ptp(s.t_s)) for s in flown), period)
    grids: dict[str, list[dict[str, float]]] = {t.id: grid(t) if t.shapes else [{}] for t in terms}
    best: dict[str, Screened] = {}
    for k in range(max(len(g) for g in grids.values())):
        asked = [t for t in terms if k < len(grids[t.id])]
        values = dict(equations.model.start()) | {
            n: v for n, v in base.values.items() if n.split("@")[0] in equations.model.names
        }
        values |= {p.name: null_value(p) for t in terms for p in t.amplitudes}
        values |= {n: v for t in terms for n, v in grids[t.id][k % len(grids[t.id])].items()}
        wanted = [*names, *(p.name for t in asked for p in t.amplitudes)]
        with np.errstate(all="ignore"):
            streams, columns = equations.streams(values, wanted, own_of_flights)
        others = [columns.index(n) for n in base.names if n in columns]
        for t in asked:
            own = [columns.index(p.name) for p in t.amplitudes if p.name in columns]
            found = _tested(streams, base, t, grids[t.id][k], own, others, rows)
            if found is not None and (t.id not in best or found.p_value < best[t.id].p_value):
                best[t.id] = found
    return tuple(sorted(best.values(), key=lambda s: s.p_value))


def _tested(
    streams: Sequence[Stream],
    base: FreeFlight,
    term: Term,
    shape: Mapping[str, float],
    own: list[int],
    others: list[int],
    rows: int,
) -> Screened | None:
    only = [Stream(s.channel, s.group, s.residual, s.columns[:, [*others, *own]]) for s in streams]
    whitened: Whitened = whiten(only, dict(base.noise), rows)
    c, b = whitened.columns[:, len(others) :], whitened.columns[:, : len(others)]
    if not np.isfinite(c).all() or not np.any(c):
        return None
    left = c - b @ np.linalg.lstsq(b, c, rcond=None)[0]
    information = left.T @ left
    told = np.diag(information) > 1e-9 * np.maximum(np.sum(c**2, axis=0), 1e-300)
    if not told.any():
        return None
    left, information = left[:, told], information[np.ix_(told, told)]
    count = int(whitened.block.max(initial=-1)) + 1
    if count < FEWEST_BLOCKS + len(others):
        return None
    scores = np.zeros((count, left.shape[1]))
    np.add.at(scores, whitened.block, left * whitened.residual[:, None])
    total = scores.sum(axis=0)
    meat = scores.T @ scores * (count / (count - 1))
    q = left.shape[1]
    dof = count - len(others) - q + 1
    statistic = float(total @ np.linalg.pinv(meat) @ total) * dof / (q * count)
    inverse = np.linalg.pinv(information)
    delta, error = inverse @ total, np.sqrt(np.diag(inverse @ meat @ inverse))
    raw = np.concatenate([s.columns for s in only])
    base_columns, columns = raw[:, : len(others)], raw[:, len(others) :][:, told]
    beside = columns - base_columns @ np.linalg.lstsq(base_columns, columns, rcond=None)[0]
    size = float(np.sqrt(np.mean((beside @ delta) ** 2) * len(base.rms)))
    named = [p.name for p, keep in zip(term.amplitudes, told, strict=False) if keep]
    return Screened(
        term.id, dict(shape), dict(zip(named, delta.tolist(), strict=False)), fisher_beyond(statistic, q, dof), size,
        dict(zip(named, error.tolist(), strict=False)),
    )  # fmt: skip
