"""Every candidate at once: sensitivities at off (shapes on their declared values), what the present model absorbs taken out.

The order of candidates is by an information criterion with the effective sample size. Whether the best of many could be chance is
asked of the data themselves: flipping the sign of whole responses keeps everything about the residual but its consistency with the
candidate, and the largest score among all candidates is compared with its own distribution, so that the false alarm rate holds for
the catalogue as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.bench import Bench
from flighttest.diagnose.chance import plain
from flighttest.diagnose.noise import inflation
from flighttest.diagnose.rows import DISTURBANCE, Rows, State
from flighttest.physics.core import Term
from flighttest.physics.model import Model

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

FLIPS = 1999
FALSE_ALARM_RATE = 0.01  # for the whole catalogue, not per candidate
ABSORBED = 1e-3  # a candidate of which less than this is left beside the present model has no column of its own


@dataclass(frozen=True)
class Variant:
    """A candidate with its shapes fixed. columns: (n, q) whitened sensitivities to `names`, open_columns in the channels' units; a
    secant (one column, no name) where the term has no amplitude: the whole change it makes. raw: the same per part, before any
    local was taken out."""

    term: Term
    shapes: Mapping[str, float]
    names: tuple[str, ...]
    columns: FloatArray
    open_columns: FloatArray
    raw: tuple[FloatArray, ...] = ()

    def on(self, rows: Rows) -> Variant:
        """The same, with the locals and the whitening of other rows."""
        columns, open_columns = rows.of(self.raw)
        return Variant(self.term, self.shapes, self.names, columns, open_columns, self.raw)

    def keeping(self, columns: Sequence[int]) -> Variant:
        """With some of its amplitudes only."""
        at = list(columns)
        names = tuple(self.names[k] for k in at)
        raw = tuple(one[..., at] for one in self.raw)
        return Variant(self.term, self.shapes, names, self.columns[:, at], self.open_columns[:, at], raw)


@dataclass(frozen=True)
class Score:
    """A variant judged on the residual of the present model.

    own: (n, q) what of its columns the present model cannot copy, left: their largest share; estimate, std: (q,); bic: change of the
    information criterion (negative: better); flip: robust score; p_value: that the catalogue's largest score is as high by chance.
    plain: beyond chance without flips (`chance.plain`);
    left_off: amplitudes that did not earn their place, and the standard error they had.
    """

    variant: Variant
    own: FloatArray
    estimate: FloatArray
    std: FloatArray
    left: float
    bic: float
    flip: float
    p_value: float = 1.0
    plain: bool = False
    left_off: Mapping[str, float] = field(default_factory=dict)

    @property
    def beyond_chance(self) -> bool:
        """Not by chance: by the sign flips, or, where an effect lives in too few responses for flips ever to say so, because all of these
        agree on it and it is far above their noise."""
        return self.p_value <= FALSE_ALARM_RATE or self.plain

    @property
    def effect(self) -> FloatArray:
        """(n,) whitened, what it would change beyond what the present model can do."""
        return self.own @ self.estimate


@dataclass(frozen=True)
class Ground:
    """The present model, linearised: rows at its optimum, an orthonormal basis of its own columns, residual orthogonal to it."""

    rows: Rows
    basis: FloatArray
    residual: FloatArray
    inflation: Mapping[int, float]

    @classmethod
    def at(cls, rows: Rows, names: Sequence[str]) -> Ground:
        """names: parameters of the present model."""
        basis = orthonormal(rows.columns(names))
        residual = rows.residual - basis @ (basis.T @ rows.residual)
        return cls(rows, basis, residual, inflation(rows, residual))

    @cached_property
    def of_channels(self) -> list[tuple[tuple[IntArray, float], float]]:
        """Of each channel ((its rows, sum of squares of the residual there), inflation)."""
        return [(self._squares(self.rows.channel == c), tau) for c, tau in self.inflation.items()]

    @cached_property
    def of_disturbances(self) -> tuple[IntArray, float]:
        """The rows that hold responses' own disturbances near zero, and the sum of squares there."""
        return self._squares(self.rows.sample == DISTURBANCE)

    def _squares(self, inside: NDArray[np.bool_]) -> tuple[IntArray, float]:
        at = np.flatnonzero(inside)
        return at, float(self.residual[at] @ self.residual[at])

    @cached_property
    def weight(self) -> FloatArray:
        """(n,): 1 / inflation of the row's channel."""
        table = np.array([1.0 / self.inflation[c] for c in range(len(self.rows.channels))] + [1.0])
        return table[self.rows.channel]


def orthonormal(columns: FloatArray) -> FloatArray:
    """Basis of the column space; columns without length or of almost no length of their own are left out."""
    length = np.sqrt(np.sum(columns**2, axis=0))
    columns = columns[:, length > 0] / length[length > 0]
    if not columns.shape[1]:
        return np.zeros((columns.shape[0], 0))
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, s > 1e-7 * s[0]]


def amplitude_variants(bench: Bench, model: Model, state: State, terms: Sequence[Term], rows: Rows) -> list[Variant]:
    """Candidates without shapes, from one Jacobian of a model that holds them all at off; `rows`: of the model itself."""
    plain = [t for t in terms if t.amplitudes and not t.shapes]
    if not plain:
        return []
    everything = model.with_terms(*(t for t in plain if t.id not in model.terms))
    known = bench.problem(everything).names
    names = [p.name for t in plain for p in t.amplitudes if p.name in known]
    slopes = bench.slopes(everything, bench.moved(everything, state), names)
    found = []
    for term in plain:
        own = tuple(p.name for p in term.amplitudes if p.name in known)
        if own:
            found.append(_variant(term, {}, own, [one[..., [names.index(n) for n in own]] for one in slopes], rows))
    return [v for v in found if np.isfinite(v.columns).all()]


def _variant(
    term: Term, shapes: Mapping[str, float], names: tuple[str, ...], raw: Sequence[FloatArray], rows: Rows
) -> Variant:
    return Variant(term, shapes, names, *rows.of(raw), tuple(raw))


def shape_settings(term: Term) -> list[dict[str, float]]:
    """Declared values of each shape, the others at nominal."""
    nominal = {p.name: p.nominal for p in term.shapes}
    found: list[dict[str, float]] = []
    for p in term.shapes:
        for value in p.screen if len(p.screen) > 1 or len(term.shapes) == 1 else ():
            setting = {**nominal, p.name: value}
            if setting not in found:
                found.append(setting)
    return found or [nominal]


def shape_variants(bench: Bench, model: Model, state: State, terms: Sequence[Term], rows: Rows) -> list[Variant]:
    """Candidates with shapes: each setting by a Jacobian (amplitudes) or as the change it makes (none).

    At their off values candidates do not see each other, so one evaluation serves a setting of every term. `rows`: of the model itself.
    """
    found = []
    for term in (t for t in terms if t.shapes and not t.amplitudes):
        changed = model.with_terms(term)
        for setting in shape_settings(term):
            raw = bench.secant(model, state, changed, bench.moved(changed, state, setting))
            found.append(_variant(term, setting, (), raw, rows))
    scaled = [t for t in terms if t.shapes and t.amplitudes]
    if scaled:
        everything = model.with_terms(*(t for t in scaled if t.id not in model.terms))
        names = [p.name for t in scaled for p in t.amplitudes]
        settings = {t.id: shape_settings(t) for t in scaled}
        for k in range(max(len(s) for s in settings.values())):
            values = {p.name: float(p.off or 0.0) for t in scaled for p in t.amplitudes}
            for t in scaled:
                values |= settings[t.id][k % len(settings[t.id])]
            slopes = bench.slopes(everything, bench.moved(everything, state, values), names)
            for t in (t for t in scaled if k < len(settings[t.id])):
                own = tuple(p.name for p in t.amplitudes)
                raw = [one[..., [names.index(n) for n in own]] for one in slopes]
                found.append(_variant(t, settings[t.id][k], own, raw, rows))
    return [v for v in found if np.isfinite(v.columns).all()]


def score(ground: Ground, variant: Variant) -> Score | None:
    """One variant on the present residual; None where nothing of it is left beside the present model.

    Of several amplitudes those are scored that earn their place (a wind from the side is no wind from below): the rest stay off.
    """
    columns = variant.columns
    own = columns - ground.basis @ (ground.basis.T @ columns)
    length = np.sqrt(np.sum(columns**2, axis=0))
    left = np.sqrt(np.sum(own**2, axis=0)) / np.maximum(length, 1e-300)
    if not np.any(length > 0) or left.max() < ABSORBED:
        return None
    best = _scored(ground, variant, own, float(left.max()))
    while len(best.variant.names) > 1:
        fewer = [
            _scored(ground, best.variant.keeping(keep), best.own[:, keep], best.left)
            for drop in range(len(best.variant.names))
            if (keep := [k for k in range(len(best.variant.names)) if k != drop])
        ]
        next_best = min(fewer, key=lambda s: s.bic)
        if next_best.bic >= best.bic:
            break
        errors = dict(zip(best.variant.names, best.std.tolist(), strict=True))
        off = {n: error for n, error in errors.items() if n not in next_best.variant.names}
        best = replace(next_best, left_off={**best.left_off, **off})
    return best


def _scored(ground: Ground, variant: Variant, own: FloatArray, left: float) -> Score:
    r = ground.residual
    gram = own.T @ own
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-6, hermitian=True) / np.outer(scale, scale)
    estimate = inverse @ (own.T @ r)
    if not variant.names:
        # The change is made in whole or not at all; a refit decides, here its size may adapt.
        estimate = np.clip(estimate, 0.0, 2.0)
    after = r - own @ estimate
    bic, n_total = 0.0, 0.0
    for (at, before_ss), tau in ground.of_channels:
        after_ss = float(after[at] @ after[at])
        n_eff = at.size / tau
        n_total += n_eff
        if before_ss > 0:
            bic += n_eff * float(np.log(max(after_ss, 1e-12) / before_ss))
    # What a constant force explains, responses had to call their own disturbance.
    at, before_ss = ground.of_disturbances
    after_ss = float(after[at] @ after[at])
    if before_ss > 0 and after_ss > 0:
        bic += at.size * float(np.log(after_ss / before_ss))
    bic += ((len(variant.names) or 1) + len(variant.shapes)) * float(np.log(max(n_total, 2.0)))
    spread = inverse @ (own.T @ (own / ground.weight[:, None])) @ inverse
    return Score(variant, own, estimate, np.sqrt(np.maximum(np.diag(spread), 0)), left, bic, 0.0)


def with_chance(ground: Ground, scores: Sequence[Score], seed: int = 0) -> list[Score]:
    """The same scores with the probability that the best of the catalogue would score as high by chance (sign flips of responses)."""
    if not scores:
        return []
    _, which = np.unique(ground.rows.segment, return_inverse=True)
    n_groups = int(which.max()) + 1
    flips = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, n_groups))
    largest = np.zeros(FLIPS)
    values, agreed = [], []
    for s in scores:
        parts = s.own * (ground.residual * ground.weight)[:, None]
        by_group = np.zeros((n_groups, parts.shape[1]))
        np.add.at(by_group, which, parts)
        spread = by_group.T @ by_group
        root = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        inverse = np.linalg.pinv(spread / np.outer(root, root), rcond=1e-8, hermitian=True) / np.outer(root, root)
        agreed.append(plain(by_group @ s.estimate, s.bic))
        total = by_group.sum(axis=0)
        q = parts.shape[1]
        value = float(total @ inverse @ total) / q
        flipped = flips @ by_group
        # Compared as if by one degree of freedom, so that candidates with several do not win by number.
        null = np.einsum("ij,jk,ik->i", flipped, inverse, flipped) / q
        null_scale = np.quantile(null, 0.99)
        values.append(value / max(null_scale, 1e-12))
        largest = np.maximum(largest, null / max(null_scale, 1e-12))
    return [
        replace(s, flip=v, p_value=float((1 + np.sum(largest >= v)) / (FLIPS + 1)), plain=a)
        for s, v, a in zip(scores, values, agreed, strict=True)
    ]


def best_per_term(scores: Sequence[Score]) -> list[Score]:
    """The best variant of each term, best term first."""
    best: dict[str, Score] = {}
    for s in scores:
        kept = best.get(s.variant.term.id)
        if kept is None or s.bic < kept.bic:
            best[s.variant.term.id] = s
    return sorted(best.values(), key=lambda s: s.bic)
