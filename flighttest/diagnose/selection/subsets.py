"""Best subsets of the candidates by marginal likelihood, on Gram matrices.

The base model's columns B are projected out (generalised least squares, weights of `discrepancy`). Of a subset S with columns A, prior
N(m, P) of its linear coefficients x (half-normal where physics allows one side only) and per stratum k residual sum of squares Q_k(x):

    log p(y | S) = - 1/2 sum_k [ n_k log v_k + Q_k / v_k ] - 1/2 (x - m)' P^-1 (x - m)
                   - 1/2 log det(I + P^1/2 A'WA P^1/2) + sum log 2 Phi(z)

at the maximum x, v_k the residual variance under S, no less than the pure error (Laplace approximation; n_k, Q_k in effective samples).
Prior of a subset: each term is missing with odds of one to the number of candidate terms, so that one is expected, and its grid values
are alike. The sum over k leaves out what contains no information on a member (`candidates.redundant`), so that an instrument is found
first and a force beside it. All subsets of up to three terms are scored, larger ones step by step (`search`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from flighttest.diagnose.residuals.discrepancy import Discrepancy
from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor
from flighttest.diagnose.selection.candidates import Candidate, redundant
from flighttest.estimation.linearisation import FloatArray, Linearisation, inverse_of_gram

LARGEST = 3  # terms in the exhaustive search
SETTINGS = 2  # grid values of a term that go into subsets of three
ABSORBED = 1e-3  # a candidate of which less than this is left beside the present model has no column of its own
CHUNK = 4096


@dataclass(frozen=True)
class Scored:
    """A subset. members: positions of its candidates; log_odds: against the present model, prior odds included; coefficients: of its
    members' columns, one after the other."""

    members: tuple[int, ...]
    log_odds: float
    coefficients: FloatArray


@dataclass
class Subsets:
    """Gram matrices of candidates beside the present model. gram (K, p, p), moment (K, p), square (K,), size (K,) effective samples: per
    stratum, the last that of priors of initial states, whose variance is known; least (K,): variance of the pure error; left (c,): of each
    candidate's column lengths what the base cannot copy; counts (K, c): whether a stratum contains information on a candidate."""

    candidates: Sequence[Candidate]
    gram: FloatArray
    moment: FloatArray
    square: FloatArray
    size: FloatArray
    least: FloatArray
    now: FloatArray
    left: FloatArray
    first: FloatArray
    counts: NDArray[np.bool_]
    settings: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def at(
        cls,
        rows: Linearisation,
        names: Sequence[str],
        candidates: Sequence[Candidate],
        discrepancy: Discrepancy,
        floor: NoiseFloor,
    ) -> Subsets:
        """names: parameters of the present model."""
        # Weights by inflation alone: variances are free in the likelihood.
        root = 1.0 / np.sqrt(np.append(discrepancy.inflation * discrepancy.variance, 1.0)[rows.stratum])
        stacked = np.concatenate(
            [rows.columns(names), *(c.columns for c in candidates), rows.residual[:, None]], axis=1
        )
        p = len(names)
        strata = [rows.stratum == k for k in range(len(rows.strata))] + [rows.stratum < 0]
        products = []
        for at in strata:
            own = stacked[at] * root[at, None]
            products.append(own.T @ own)
        total = np.sum(products, axis=0)
        # What the base explains of every column and of the residual is taken away; it need not be of full rank.
        explained = np.zeros_like(total)
        explained[:p, p:] = inverse_of_gram(total[:p, :p]) @ total[:p, p:]
        rest = np.eye(len(total)) - explained
        products = [(rest.T @ one @ rest)[p:, p:] for one in products]
        left = np.sqrt(np.maximum(np.diag(np.sum(products, axis=0)) / np.maximum(np.diag(total)[p:], 1e-300), 0.0))
        noise = np.array([_floor_variance(rows, floor, k) for k in range(len(rows.strata))])
        size = np.append(discrepancy.count / discrepancy.inflation, 0.0)
        square = np.array([one[-1, -1] for one in products])
        # In units of the present variance of the stratum.
        least = np.append(noise / discrepancy.variance, 1.0)
        first = np.cumsum([0, *(c.columns.shape[1] for c in candidates)])
        settings: dict[str, int] = {}
        for c in candidates:
            settings[c.term.id] = settings.get(c.term.id, 0) + 1
        aside = [redundant(c.term, rows.strata) for c in candidates]
        return cls(
            candidates=candidates,
            gram=np.array([one[:-1, :-1] for one in products]),
            moment=np.array([one[:-1, -1] for one in products]),
            square=square,
            size=size,
            least=least,
            now=np.where(size > 0, np.maximum(square / np.maximum(size, 1e-9), least), 1.0),
            left=np.array([left[first[j] : first[j + 1]].max(initial=0.0) for j in range(len(candidates))]),
            first=first,
            counts=np.array([[name not in one for one in aside] for name in (*rows.strata, "")]),
            settings=settings,
        )

    def ranked(self, largest: int = LARGEST) -> list[Scored]:
        """Subsets of one to `largest` candidates of different terms, best first, one per set of terms."""
        usable = [j for j in range(len(self.candidates)) if self.left[j] > ABSORBED]
        found = self.score([(j,) for j in usable])
        if largest >= 2:
            found += self.score([s for s in combinations(usable, 2) if self._different(s)])
        if largest >= 3:
            best: dict[int, float] = {}
            for s in found:
                for j in s.members:
                    best[j] = max(best.get(j, -np.inf), s.log_odds)
            kept = []
            for term in self.settings:
                own = [j for j in usable if self.candidates[j].term.id == term]
                kept += sorted(own, key=lambda j: -best[j])[:SETTINGS]
            found += self.score([s for s in combinations(sorted(kept), 3) if self._different(s)])
        ordered, seen = [], set()
        for s in sorted(found, key=lambda s: -s.log_odds):
            terms = self.terms(s)
            if terms not in seen:
                seen.add(terms)
                ordered.append(s)
        return ordered

    def terms(self, scored: Scored) -> frozenset[str]:
        """Ids of a subset's terms."""
        return frozenset(self.candidates[j].term.id for j in scored.members)

    def score(self, subsets: Sequence[tuple[int, ...]]) -> list[Scored]:
        """Log odds of each, all with the same number of columns at once."""
        by_width: dict[int, list[tuple[tuple[int, ...], list[int]]]] = {}
        for members in subsets:
            at = [int(k) for j in members for k in range(self.first[j], self.first[j + 1])]
            by_width.setdefault(len(at), []).append((members, at))
        found = []
        for items in by_width.values():
            for begin in range(0, len(items), CHUNK):
                some = items[begin : begin + CHUNK]
                values, x = self._laplace([m for m, _ in some], np.array([at for _, at in some]))
                found += [Scored(m, float(v), own) for (m, _), v, own in zip(some, values, x, strict=True)]
        return found

    def _laplace(self, members: Sequence[tuple[int, ...]], at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """(log odds (n,), coefficients (n, q)) of subsets with columns at (n, q)."""
        mean, std, side = (
            np.concatenate([getattr(c, k) for c in self.candidates])[at] for k in ("prior_mean", "prior_std", "side")
        )
        gram, moment = self.gram[:, at[:, :, None], at[:, None, :]], self.moment[:, at]
        size, least = self.size[:, None], self.least[:, None]
        variance = np.broadcast_to(self.now[:, None], (self.size.size, len(members)))
        eye = np.eye(at.shape[1])
        for _ in range(3):
            h = np.einsum("kn,knij->nij", 1 / variance, gram) * std[:, :, None] * std[:, None, :] + eye
            g = np.einsum("kn,kni->ni", 1 / variance, moment) * std + mean / std
            x = np.linalg.solve(h, g[..., None])[..., 0] * std
            square = self.square[:, None] - 2 * np.einsum("ni,kni->kn", x, moment)
            square = np.maximum(square + np.einsum("ni,knij,nj->kn", x, gram, x), 0.0)
            variance = np.where(size > 0, np.maximum(square / np.maximum(size, 1e-9), least), 1.0)
        before = self.now[:, None]
        gain = size * np.log(before / variance) + self.square[:, None] / before - square / variance
        counts = np.array([self.counts[:, list(m)].all(axis=1) for m in members]).T
        value = 0.5 * np.sum(gain, axis=0, where=counts) - 0.5 * np.sum(((x - mean) / std) ** 2, axis=1)
        value -= 0.5 * np.linalg.slogdet(h)[1]
        error = np.sqrt(np.einsum("nii->ni", np.linalg.inv(h))) * std
        value += np.sum(np.where(side != 0, np.log(2.0) + log_ndtr(x * side / error), 0.0), axis=1)
        names = [[self.candidates[j].term.id for j in s] for s in members]
        prior = [sum(np.log(len(self.settings) * self.settings[t]) for t in s) for s in names]
        return value - np.array(prior), x

    def _different(self, members: Sequence[int]) -> bool:
        return len({self.candidates[j].term.id for j in members}) == len(members)


def _floor_variance(rows: Linearisation, floor: NoiseFloor, stratum: int) -> float:
    """Pure error of a stratum in units of the variance that rows were whitened by."""
    name = rows.strata[stratum]
    if name in rows.disturbances:
        return 1.0
    at = np.flatnonzero(rows.stratum == stratum)
    return float((floor.of(name) / rows.scale[at[0]]) ** 2) if at.size else 1.0
