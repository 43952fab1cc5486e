"""Least squares on whitened equations: one step, its covariance by blocks, and what flights differ by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.equation_error.autoregression import Autoregression
from flighttest.estimation.equation_error.initial_states import PredictedStates, predictions_of
from flighttest.estimation.equation_error.random_effects import marginal_rows
from flighttest.estimation.equation_error.streams import Stream
from flighttest.estimation.linearisation import inverse_of_gram

FloatArray = NDArray[np.float64]

FEWEST_GROUPS = 3  # of which a variance between them can be determined
LEAST_POWER = 0.01  # of the most informative group: one with less does not determine a parameter
BLOCK_S = (1.0, 5.0)  # of one block of the robust covariance: what whitening left of correlation ends within a second
WANTED_BLOCKS = 40  # fewer understate errors (Cameron, Gelbach, Miller 2008)
SINGULAR = 1e-10  # of information with a unit diagonal: a direction with less is not determined
LOADING = 0.1  # of such a direction on a parameter that it leaves undetermined


@dataclass(frozen=True)
class Whitened:
    """Streams whitened and stacked: residual (N,), columns (N, q); of every row (N,) its group, its block, about 5 s each, its channel,
    which is empty for predictions of initial states, `states`."""

    residual: FloatArray
    columns: FloatArray
    group: NDArray[np.intp]
    block: NDArray[np.intp]
    channel: NDArray[np.str_]
    states: PredictedStates

    def information(self) -> tuple[FloatArray, FloatArray]:
        """Normal equations: (q, q) and (q,)."""
        return self.columns.T @ self.columns, self.columns.T @ self.residual


def block_rows(seconds: float, period_s: float) -> int:
    """Samples of one block of the robust covariance: the longest of `BLOCK_S` that leaves `WANTED_BLOCKS` in so many seconds."""
    return max(round(float(np.clip(seconds / WANTED_BLOCKS, *BLOCK_S)) / period_s), 10)


def whiten(streams: Sequence[Stream], noise: Mapping[str, Autoregression], rows_per_block: int) -> Whitened:
    """Every stream by its channel's noise, beside its random effects (`random_effects`); predictions of initial states are rows as well.
    Blocks are stretches of rows of one group, for standard errors that do not assume whiteness."""
    used = [s for s in streams if s.residual.size]
    if not used:
        q, none = streams[0].columns.shape[1] if streams else 0, np.zeros(0, dtype=np.intp)
        return Whitened(np.zeros(0), np.zeros((0, q)), none, none, none.astype(np.str_), predictions_of([]))
    blocks = []
    starts: dict[tuple[str, int], int] = {}
    for s in used:
        # The channels of one moment are of one block: a gust moves them all.
        begin = starts.get((s.channel, s.group), 0)
        starts[s.channel, s.group] = begin + s.residual.size
        blocks.append((begin + np.arange(s.residual.size)) // rows_per_block)
    group, channel = [np.full(s.residual.size, s.group) for s in used], [s.channel for s in used]
    made = marginal_rows(used, noise)
    for (i, row), own in zip(made.begins.values(), made.rows[len(used) :], strict=True):
        blocks.append(np.full(len(own), blocks[i][row]))
        group.append(np.full(len(own), used[i].group))
        channel.append("")
    rows, of, at = np.concatenate(made.rows), np.concatenate(group), np.concatenate(blocks)
    many = np.zeros(of.max() + 1, dtype=np.intp)  # blocks of each group
    np.maximum.at(many, of, at + 1)
    at += (np.cumsum(many) - many)[of]
    return Whitened(rows[:, 0], rows[:, 1:], of, at, np.repeat(channel, [len(m) for m in made.rows]), made.states)


@dataclass(frozen=True)
class Step:
    """A Gauss-Newton step: delta (q,); covariance (q, q) by the information alone; robust, by_blocks (q, q) by blocks, as `left_out` and
    `unbiased` of `BlockCovariances`, with what priors add; chi2: the weighted sum of squares before it."""

    delta: FloatArray
    covariance: FloatArray
    robust: FloatArray
    by_blocks: FloatArray
    chi2: float


def step(rows: Whitened, prior_mean: FloatArray, prior_std: FloatArray, inflation: float = 1.0) -> Step:
    """Least squares with a Gaussian prior of the step, prior_std (q,) infinite where there is none. inflation: of the innovations'
    variance, by whose root prior_std is divided.

    robust: not below the information's. A direction that neither data nor prior determine has an infinite variance, as a robust one has
    where that is so without one of the blocks.
    """
    hessian, score = rows.information()
    precision = np.where(np.isfinite(prior_std), 1.0 / np.where(np.isfinite(prior_std), prior_std, 1.0) ** 2, 0.0)
    full, score = hessian + np.diag(precision), score + precision * prior_mean
    root, unknown = _root_of_inverse(full)
    covariance = root @ root.T
    delta = covariance @ score
    found = block_covariances(rows.columns, rows.residual - rows.columns @ delta, rows.block, full)
    # What priors contribute is no estimate of these blocks.
    assumed = inflation * covariance @ np.diag(precision) @ covariance
    robust = found.left_out + assumed
    grow = np.sqrt(np.maximum(np.diag(covariance) / np.maximum(np.diag(robust), 1e-300), 1.0))
    robust = robust * np.outer(grow, grow)
    for matrix, infinite in ((covariance, unknown), (robust, unknown | found.alone)):
        matrix[infinite, infinite] = np.inf
    return Step(delta, covariance, robust, found.unbiased + assumed, float(rows.residual @ rows.residual))


def _root_of_inverse(full: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(q, k) whose product with its transpose is the inverse of an information matrix (q, q), on the k directions that it determines, and
    (q,) which parameters it does not."""
    scale = np.sqrt(np.maximum(np.diag(full), 1e-300))
    value, vector = np.linalg.eigh(full / np.outer(scale, scale))
    known = value > SINGULAR
    unknown = (np.abs(vector[:, ~known]) > LOADING).any(axis=1)
    return vector[:, known] / np.sqrt(value[known]) / scale[:, None], unknown


class BlockCovariances(NamedTuple):
    """Covariances (q, q) of a least squares estimate by its blocks, and alone (q,): parameters that nothing determines without one of them.

    With M the inverse of the information, and of a block X, r its rows, G = X'X and s = X'r at the estimate,

        left_out = (n - 1) / n sum_g (M (I - G M)^-1 s) (..)'        the steps without each block in turn
        unbiased = sum_g (M (I - G M)^-1/2 s) (..)'                  the expected covariance, where the rows are white

    (MacKinnon, Nielsen and Webb, J. Applied Econometrics 38, 2023: CV3; Bell and McCaffrey 2002: CR2.)
    """

    left_out: FloatArray
    unbiased: FloatArray
    alone: NDArray[np.bool_]


def block_covariances(
    columns: FloatArray, left: FloatArray, block: NDArray[np.intp], full: FloatArray
) -> BlockCovariances:
    """columns (N, q): whitened rows; left, block (N,): what they leave at the estimate, and their blocks; full (q, q): the information of
    all blocks, with any prior's.

    What few blocks show is as uncertain as the estimates without each of them differ. Scores at the estimate, which such blocks have made
    fit them, do not say so: a throttle above 0.43 in one second of 35 made a limit of the motors of 0.43 +- 0.03 (p 3e-8), where
    ArduPilot's simulator has none; without that second nothing determines one.
    """
    order = np.argsort(block, kind="stable")
    begins = np.flatnonzero(np.diff(block[order], prepend=-1))[1:]
    root, _ = _root_of_inverse(full)
    pieces = zip(np.split(columns[order] @ root, begins), np.split(left[order], begins), strict=True)
    own = [(x.T @ x, x.T @ r) for x, r in pieces]
    share, axes = np.linalg.eigh(np.stack([h for h, _ in own]))  # of the information that is a block's
    along = np.einsum("nij,ni->nj", axes, np.stack([g for _, g in own]))
    rest = 1.0 - share
    known = rest > SINGULAR
    rest, n = np.where(known, rest, np.inf), len(own)
    directions = np.einsum("qi,nij->nqj", root, axes)
    apart, expected = (np.einsum("nqj,nj->nq", directions, along / by) for by in (rest, np.sqrt(rest)))
    lost = np.abs(directions) * np.sqrt(np.diag(full))[:, None]
    lost = lost > LOADING * np.linalg.norm(lost, axis=1, keepdims=True)
    alone = (lost & ~known[:, None, :]).any(axis=(0, 2))
    return BlockCovariances(apart.T @ apart * (n - 1) / n, expected.T @ expected, alone)


def heterogeneity(rows: Whitened, own: NDArray[np.bool_], prior_std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What groups differ by in shared parameters: (q,) standard deviation of each, 0 where errors account for it, and (q, q) what it adds
    to the covariance.

    own (q,): columns that belong to one group. Every group's one-step estimate of all parameters is one value of each shared one with its
    error; the variance between groups is DerSimonian and Laird's (1986). It moves a group's own parameters by what they make up for it,
    and the shared value by its mean over the groups.
    """
    q = own.size
    spread, extra = np.zeros(q), np.zeros((q, q))
    groups = np.unique(rows.group)
    if groups.size < FEWEST_GROUPS:
        return spread, extra
    known = 1.0 / prior_std**2  # zero where there is no prior
    parts = []
    for g in groups:
        some = rows.columns[rows.group == g]
        hessian, score = some.T @ some, some.T @ rows.residual[rows.group == g]
        mine = own & (np.diag(hessian) > 0.0)
        precision = 1.0 / prior_std[mine] ** 2 if mine.any() else np.zeros(0)
        back = np.linalg.pinv(hessian[np.ix_(mine, mine)] + np.diag(precision)) if mine.any() else np.zeros((0, 0))
        follow = -back @ hessian[mine]  # how own parameters answer to the shared ones
        inverse = inverse_of_gram(hessian + np.diag(known), 1e-10)  # a column of another group is nothing here
        parts.append((inverse @ score, np.diag(inverse), mine, follow, np.diag(hessian) > 0.0))
    for k in np.flatnonzero(~own):
        power = np.array([1.0 / v[k] if seen[k] and v[k] > 0.0 else 0.0 for _, v, _, _, seen in parts])
        informative = power > power.max() * LEAST_POWER if power.max() > 0.0 else np.zeros(power.size, dtype=bool)
        if informative.sum() < FEWEST_GROUPS:
            continue
        value = np.array([one[k] for one, *_ in parts])[informative]
        w = power[informative]
        mean = float(np.sum(w * value) / w.sum())
        chance = float(np.sum(w * (value - mean) ** 2)) - (w.size - 1)
        variance = max(chance, 0.0) / float(w.sum() - np.sum(w**2) / w.sum())
        if variance == 0.0:
            continue
        spread[k] = np.sqrt(variance)
        extra[k, k] += variance / w.size
        for _, _, mine, follow, _ in parts:
            answer = follow[:, k]
            extra[np.ix_(mine, mine)] += variance * np.outer(answer, answer)
    return spread, extra
