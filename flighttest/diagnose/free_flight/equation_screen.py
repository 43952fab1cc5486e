"""Score tests of the catalogue on free flight by prediction errors: every linear coefficient of a part of the model in a few passes.

At the optimum of the base model the whitened equations are linear in a candidate's coefficients. Its columns beside the base's give
the score test (Rao 1948) with a covariance by the step without each block of 1 to 5 s, so that a spectrum that the noise model missed
does not name a term.
A term without a linear coefficient (a limit, a second lag) has what each of its settings changes in the equations for a column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.answer import SideBySide, one_after_the_other
from flighttest.diagnose.selection.candidates import acts_in, grid, null_value, usual_size
from flighttest.diagnose.selection.detectability import missing_channels
from flighttest.estimation.equation_error import Stream, Whitened, block_covariances, block_rows, whiten
from flighttest.estimation.uncertainty.distributions import fisher_beyond
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.free_flight.equations import Equations
from flighttest.identify.free_flight.translation import LATENCY
from flighttest.physics.core import Term
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

WHOLE = "share"  # of the effect of a term without a linear coefficient
LIMITS_AT = (0.5, 0.75, 0.9, 0.97)  # quantiles of the throttle flown, that its limit is screened at
FEWEST_BLOCKS = 8  # beside the parameters: below, a covariance by blocks is none


@dataclass(frozen=True)
class Screened:
    """A candidate's score test. shape: its nonlinear parameters; coefficients: one-step estimates by name, from their null values; p_value;
    size: root mean square of its effect beside the base model, SI units; std: of the coefficients, by blocks; nats: of log likelihood that
    one step gains."""

    term: str
    shape: Mapping[str, float]
    coefficients: Mapping[str, float]
    p_value: float
    size: float
    std: Mapping[str, float] = field(default_factory=dict)
    nats: float = 0.0


ScoreTests = Callable[[Sequence[Segment], FreeFlight, Sequence[Term], int], Iterator[Screened]]


def settings(term: Term, flown: Sequence[Segment]) -> list[dict[str, float]]:
    """Values of the nonlinear parameters that a term is screened at: declared ones; of a limit on the throttle, quantiles of what was
    flown."""
    if not term.shapes:
        return [{}]
    found = grid(term)
    for p in term.shapes:
        if p.limits == "throttle":
            every = np.concatenate([s.u["throttle"][1] for s in flown])
            levels = np.quantile(every[np.isfinite(every)], LIMITS_AT) if np.isfinite(every).any() else np.zeros(0)
            found = [
                {**one, p.name: float(level)} for one in found[:1] for level in levels if p.lower < level < p.upper
            ]
    return found


def screen(
    flown: Sequence[Segment],
    base: FreeFlight,
    pool: Sequence[Term],
    side_by_side: SideBySide = one_after_the_other,
) -> tuple[Screened, ...]:
    """Score tests of the terms that the equations see, most significant first; of each the best of its settings.

    flown: stretches that `base` was estimated from. A term whose columns are not finite is left out.
    """
    terms = [
        t
        for t in pool
        if acts_in(t, base.model, base.part) and t.id not in base.model.terms and not missing_channels(t, tuple(flown))
    ]
    rows = block_rows(sum(float(np.ptp(s.t_s)) for s in flown), base.period_s)
    linear = [t for t in terms if t.amplitudes]
    # A state of unknown start needs a long lead (`motion_equations`), which the others are not to pay for.
    alone = [t for t in linear if has_unknown_initial_state(t)]
    together = [t for t in linear if t not in alone]
    nonlinear = [t for t in terms if not t.amplitudes]
    groups = [(_linear, together), *((_linear, [t]) for t in alone), (_nonlinear, nonlinear)]
    jobs = [(tests, some) for tests, some in groups if some]

    def work(some: Sequence[tuple[ScoreTests, list[Term]]]) -> list[list[Screened]]:
        return [list(tests(flown, base, own, rows)) for tests, own in some]

    signs = {t.id: {p.name: np.sign(usual_size(p)) for p in t.amplitudes if p.one_sided} for t in terms}

    def rank(s: Screened) -> tuple[bool, float]:
        """Settings whose coefficients physics does not allow come last."""
        return any(s.coefficients.get(n, 0.0) * sign < 0.0 for n, sign in signs[s.term].items()), s.p_value

    best: dict[str, Screened] = {}
    for found in chain(*side_by_side(work, jobs, [1.0] * len(jobs))):
        if found.term not in best or rank(found) < rank(best[found.term]):
            best[found.term] = found
    return tuple(sorted(best.values(), key=lambda s: s.p_value))


def has_unknown_initial_state(term: Term) -> bool:
    """Whether a term with linear coefficients has states that no measurement shows as a flight begins."""
    return bool(term.amplitudes) and any(s.free for s in term.states) and term.id != LATENCY


def _linear(flown: Sequence[Segment], base: FreeFlight, terms: Sequence[Term], rows: int) -> Iterator[Screened]:
    """Score tests of terms with linear coefficients, which at their null values do not change each other: one Jacobian for a setting of
    all."""
    equations = Equations(base.model.with_terms(*terms), flown, base.part)
    grids = {t.id: settings(t, flown) for t in terms}
    for k in range(max(len(g) for g in grids.values())):
        asked = [t for t in terms if k < len(grids[t.id])]
        values = dict(equations.model.start()) | {
            n: v for n, v in base.values.items() if n.split("@")[0] in equations.model.names
        }
        values |= {p.name: null_value(p) for t in terms for p in t.amplitudes}
        values |= {n: v for t in terms for n, v in grids[t.id][k % len(grids[t.id])].items()}
        wanted = [*base.estimated, *(p.name for t in asked for p in t.amplitudes)]
        with np.errstate(all="ignore"):
            streams, columns = equations.streams(values, wanted, base.per_flight, base.initial)
            if any(has_unknown_initial_state(t) for t in asked):
                # Where a term is not, its initial states have no effect: its columns, and theirs, are those of its usual size.
                usual = {p.name: p.nominal for t in asked for p in t.amplitudes}
                there, _ = equations.streams(values | usual, wanted, base.per_flight, base.initial)
                streams = [replace(t, residual=s.residual) for s, t in zip(streams, there, strict=True)]
        others = [columns.index(n) for n in base.names if n in columns]
        for t in asked:
            own = [columns.index(p.name) for p in t.amplitudes if p.name in columns]
            only = [replace(s, columns=s.columns[:, [*others, *own]]) for s in streams]
            found = _tested(only, base, t, grids[t.id][k], len(others), rows)
            if found is not None:
                yield found


def _nonlinear(flown: Sequence[Segment], base: FreeFlight, terms: Sequence[Term], rows: int) -> Iterator[Screened]:
    """Score tests of terms without a linear coefficient: what each setting changes in the equations is the column, its whole effect 1.
    A setting whose effect would have to be negative is left out."""
    if not terms:
        return
    with np.errstate(all="ignore"):
        plain, columns = Equations(base.model, flown, base.part).streams(
            base.values, base.estimated, base.per_flight, base.initial
        )
    others = [columns.index(n) for n in base.names]
    for t in terms:
        equations = Equations(base.model.with_terms(t), flown, base.part)
        for setting in settings(t, flown):
            values = {**equations.model.start(), **base.values, **setting}
            with np.errstate(all="ignore"):
                changed, _ = equations.streams(values, [], base.per_flight, base.initial)
            if [s.residual.size for s in changed] != [s.residual.size for s in plain]:
                continue  # not finite somewhere
            only = [
                replace(s, columns=np.column_stack([s.columns[:, others], s.residual - c.residual]))
                for s, c in zip(plain, changed, strict=True)
            ]
            found = _tested(only, base, t, setting, len(others), rows)
            if found is not None and found.coefficients.get(WHOLE, 0.0) > 0.0:
                yield found


def _tested(
    streams: Sequence[Stream],
    base: FreeFlight,
    term: Term,
    shape: Mapping[str, float],
    others: int,
    rows: int,
) -> Screened | None:
    """streams: with the columns of the base, `others`, and behind them the term's own."""
    whitened: Whitened = whiten(streams, dict(base.noise), rows)
    c, b = whitened.columns[:, others:], whitened.columns[:, :others]
    if not np.isfinite(c).all() or not np.any(c):
        return None
    left = c - b @ np.linalg.lstsq(b, c, rcond=None)[0]
    information = left.T @ left
    determined = np.diag(information) > 1e-9 * np.maximum(np.sum(c**2, axis=0), 1e-300)
    if not determined.any():
        return None
    left, information = left[:, determined], information[np.ix_(determined, determined)]
    count = int(whitened.block.max(initial=-1)) + 1
    if count < FEWEST_BLOCKS + others:
        return None
    q = left.shape[1]
    inverse, total = np.linalg.pinv(information), left.T @ whitened.residual
    delta = inverse @ total
    # The scores of blocks at the base hold the term itself, and n of them give no more than t^2 = n: a curved throttle that 16 blocks of 40
    # showed, by 413 nats of log likelihood, had p 0.011.
    every = np.column_stack([b, c[:, determined]])
    step = np.linalg.lstsq(every, whitened.residual, rcond=None)[0]
    blocks = block_covariances(every, whitened.residual - every @ step, whitened.block, every.T @ every)
    covariance = blocks.left_out[-q:, -q:]
    dof = count - others - q + 1
    statistic = float(delta @ np.linalg.pinv(covariance) @ delta) / q
    error = np.sqrt(np.diag(covariance))
    raw = np.concatenate([s.columns for s in streams])
    base_columns, columns = raw[:, :others], raw[:, others:][:, determined]
    beside = columns - base_columns @ np.linalg.lstsq(base_columns, columns, rcond=None)[0]
    size = float(np.sqrt(np.mean((beside @ delta) ** 2) * len(base.rms)))
    named = [n for n, keep in zip([p.name for p in term.amplitudes] or [WHOLE], determined, strict=False) if keep]
    return Screened(
        term.id, dict(shape), dict(zip(named, delta.tolist(), strict=False)), fisher_beyond(statistic, q, dof), size,
        dict(zip(named, error.tolist(), strict=False)), 0.5 * float(total @ inverse @ total),
    )  # fmt: skip
