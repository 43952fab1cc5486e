"""Which subsets are refitted: those with odds in their favour whose terms would all be large enough for a name.

How much each term of a subset would change predictions, by one Gauss-Newton step:

    change_j = (E_j - E_o (C_o + P_o^-1)^-1 C_oj) x_j,  E = U - U_0 B^+ A,  C = A'A - A'B B^+ A

B, U_0: columns of what the present model estimates, whitened and in units; A, U: of the candidates; x: coefficients of `subsets`; o: the
others of the subset, with the variance P of their priors, which take back what they can. A subset of which a term is too small is left
out, since `comparison` would refuse that term, and the subset without it is proposed, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor
from flighttest.diagnose.selection.candidates import Candidate
from flighttest.diagnose.selection.comparison import LEAST_FLOORS
from flighttest.diagnose.selection.held_out import places
from flighttest.diagnose.selection.subsets import CHUNK, Scored
from flighttest.estimation.linearisation import RANK, FloatArray, IntArray, Linearisation
from flighttest.segments.model import Segment

# Of the least size with a name: what is predicted below it turns out below that size (`benchmarks.predicted_sizes`).
SURELY = 0.75
LEAST_PREDICTED = SURELY * LEAST_FLOORS


@dataclass(frozen=True)
class PredictedSizes:
    """rows, names: of the present model and what is estimated of it; floor: of the base model, in which sizes are counted."""

    rows: Linearisation
    names: tuple[str, ...]
    candidates: Sequence[Candidate]
    segments: Sequence[Segment]
    floor: NoiseFloor

    def least(self, subsets: Sequence[Scored]) -> FloatArray:
        """(n,) of each subset the size of its smallest term: largest RMS over a place of what it changes beside the others, in noise
        floors."""
        by_widths: dict[tuple[int, ...], list[int]] = {}
        for k, s in enumerate(subsets):
            by_widths.setdefault(tuple(self._first[j + 1] - self._first[j] for j in s.members), []).append(k)
        found = np.zeros(len(subsets))
        for widths, some in by_widths.items():
            for begin in range(0, len(some), CHUNK):
                chunk = some[begin : begin + CHUNK]
                found[chunk] = self._least([subsets[k] for k in chunk], np.repeat(np.arange(len(widths)), widths))
        return found

    def of_units(self, candidate: Candidate) -> FloatArray:
        """(q,) of a coefficient of one of each of its columns, alone, in noise floors."""
        j = next(j for j, one in enumerate(self.candidates) if one is candidate)
        squares = np.diagonal(self._matrices[1], axis1=1, axis2=2).max(axis=0, initial=0.0)
        return np.asarray(np.sqrt(squares[self._first[j] : self._first[j + 1]]))

    def _least(self, subsets: Sequence[Scored], member: IntArray) -> FloatArray:
        """Of subsets whose members have the same numbers of columns. member (q,): of each column."""
        at = np.array([[k for j in s.members for k in range(self._first[j], self._first[j + 1])] for s in subsets])
        pairs = at[:, :, None], at[:, None, :]
        common, products = self._matrices[0][pairs], self._matrices[1][:, *pairs]
        information = common + self._precision[at][:, :, None] * np.eye(member.size)
        x, least = np.array([s.coefficients for s in subsets]), np.full(len(subsets), np.inf)
        for one in range(int(member[-1]) + 1):
            own, others = np.flatnonzero(member == one), np.flatnonzero(member != one)
            change = np.where(member == one, x, 0.0)
            pushed = np.einsum("nij,nj->ni", common[:, others[:, None], own], x[:, own])
            change[:, others] = -np.linalg.solve(information[:, others[:, None], others], pushed[..., None])[..., 0]
            square = np.einsum("pnij,ni,nj->pn", products, change, change, optimize=True).max(axis=0, initial=0.0)
            least = np.minimum(least, np.sqrt(square))
        return least

    @cached_property
    def _first(self) -> IntArray:
        """Position of each candidate's first column, and the number of all."""
        return np.cumsum([0, *(c.columns.shape[1] for c in self.candidates)])

    @cached_property
    def _precision(self) -> FloatArray:
        """(q,) of the coefficients' priors."""
        return np.concatenate([c.prior_std for c in self.candidates]) ** -2.0

    @cached_property
    def _matrices(self) -> tuple[FloatArray, FloatArray]:
        """C (q, q), and per place the mean products of the changes E (places, q, q), in noise floors squared."""
        base, columns = self.rows.columns(self.names), np.concatenate([c.columns for c in self.candidates], axis=1)
        shared, whole = base.T @ columns, columns.T @ columns
        taken_back = np.linalg.pinv(base.T @ base, rcond=RANK, hermitian=True) @ shared
        common = whole - shared.T @ taken_back + RANK * np.diag(np.diag(whole))  # no less than what was rounded away
        change = np.concatenate([c.unprofiled() for c in self.candidates], axis=1)
        change -= self.rows.unprofiled_columns(self.names) @ taken_back
        products = [
            change[at].T @ change[at] / (at.size * self.floor.of(channel) ** 2)
            for (channel, _), at in places(self.rows, self.segments).items()
        ]
        return common, np.array(products).reshape(-1, *common.shape)


def proposals(
    scored: Sequence[Scored], sizes: PredictedSizes, whatever_its_score: Callable[[Candidate], bool]
) -> list[Scored]:
    """Subsets to refit, best first: those with odds in their favour, then alone every candidate that is asked for whatever its score."""
    found = [s for s in scored if s.log_odds > 0.0]
    found = [s for s, size in zip(found, sizes.least(found), strict=True) if size >= LEAST_PREDICTED]
    proposed = {s.members for s in found}
    alone = [s for s in scored if len(s.members) == 1 and s.members not in proposed]
    return found + [s for s in alone if whatever_its_score(sizes.candidates[s.members[0]])]
