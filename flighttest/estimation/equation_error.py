"""Equation error with autoregressive noise: least squares on whitened equations of motion, in time linear in the samples.

An equation of motion, evaluated at what was measured, leaves a residual r_k = e_k of coloured noise: gusts, vibration, noise of the
sensors. With A(q) e_k = white (A autoregressive, of the residual itself), least squares on A(q) r_k is the prediction error method
(Ljung, System Identification, 2nd ed., sections 7.2 and 13.4): where what flies the vehicle answers disturbances, it stays
consistent as long as A describes the noise and commands act after a delay, since A(q) r_k is then what could not be predicted from the past
that the commands answer. Ordinary least squares, A = 1, is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.linearisation import inverse_of_gram, orthonormal

FloatArray = NDArray[np.float64]

MOST_LAGS = 40  # 0.8 s at 50 Hz: beyond it, gusts of multirotor flights are predicted by their last value
FEWEST_GROUPS = 3  # of which a variance between them can be determined
LEAST_POWER = 0.01  # of the most informative group: one with less does not determine a parameter
BLOCK_S = (1.0, 5.0)  # of one cluster of the sandwich: what whitening left of correlation ends within a second
WANTED_BLOCKS = 40  # a sandwich over fewer understates errors (Cameron, Gelbach, Miller 2008)
SHARED = 1e-3  # of a function of the state that is left beside the parameters, below which it is one of them
LEAST_STD = 1e-9  # SI units: rounding of double precision; a channel that is stuck is modelled to within it, and its weight would overflow
BATCH = 32  # samples that are whitened together: as quick as 16 within a tenth, quicker than 64 and 128
LEAST_STRETCH = 4  # times as many samples as lags: a shorter stretch is left out


@dataclass(frozen=True)
class Stream:
    """One equation over one stretch without gaps. residual: (n,) measured minus modelled; columns: (n, q) derivatives of the modelled
    by the parameters; group: what is left out together and judged as one sample (its flight); channel: what shares one noise; state (n, k):
    what the equations may be wrong as a function of (`lack_of_fit`)."""

    channel: str
    group: int
    residual: FloatArray
    columns: FloatArray
    state: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class Autoregression:
    """A(q) = 1 + a_1 q^-1 + ...: `coefficients` (order + 1,), the first 1; std: of what is left, in the channel's unit."""

    coefficients: FloatArray
    std: float

    @property
    def order(self) -> int:
        """Number of lags."""
        return self.coefficients.size - 1

    @cached_property
    def _starting(self) -> tuple[FloatArray, FloatArray]:
        """(order, order) filters of the first samples, by what is known before each, and (order,) their standard deviations: Levinson's
        recursion downwards (Brockwell and Davis 1991, section 5.2)."""
        filters, std = np.eye(self.order), np.full(self.order, self.std)
        a, variance = self.coefficients, self.std**2
        for k in range(self.order - 1, -1, -1):
            left = max(1.0 - a[-1] ** 2, 1e-12)
            a, variance = (a - a[-1] * a[::-1])[:-1] / left, variance / left
            filters[k, : k + 1], std[k] = a[::-1], np.sqrt(variance)
        return filters, std

    @cached_property
    def _batch(self) -> FloatArray:
        """(BATCH, order + BATCH): of so many samples, by these and what is before them."""
        row = np.concatenate([self.coefficients[::-1] / self.std, np.zeros(BATCH)])
        return np.resize(row, (BATCH, self.order + BATCH))  # each row starts one sample later

    def whitened(self, values: FloatArray) -> FloatArray:
        """(n, ...) of (n, ...): filtered along time, of unit variance; the first samples by the lower orders that their past allows."""
        filters, std = self._starting
        flat = values.reshape(len(values), -1)
        first = min(self.order, len(flat))
        out = np.empty(flat.shape)
        out[:first] = (filters[:first, :first] / std[:first, None]) @ flat[:first]
        left = len(flat) - first
        if left:
            # Products of matrices: a third of the time of a sum over lags.
            count, width = -(-left // BATCH), flat.shape[1]
            filled = np.zeros((self.order + count * BATCH, width))
            filled[: self.order + left] = flat[first - self.order :]
            row, column = filled.strides
            shape = (count, self.order + BATCH, width)
            windows: FloatArray = np.ndarray(shape, buffer=filled, strides=(BATCH * row, row, column))
            out[first:] = (self._batch @ windows).reshape(count * BATCH, width)[:left]
        return out.reshape(values.shape)

    def log_scale(self, size: int) -> float:
        """Sum of the logarithms of the standard deviations that `whitened` divides so many samples by."""
        first = self._starting[1][:size]
        return float(np.sum(np.log(first)) + (size - first.size) * np.log(self.std))

    def spectrum(self, frequency_hz: FloatArray, period_s: float) -> FloatArray:
        """One-sided power spectral density at these frequencies, unit^2 per Hz."""
        z = np.exp(-2j * np.pi * np.outer(frequency_hz, np.arange(self.order + 1)) * period_s)
        return np.asarray(2.0 * period_s * self.std**2 / np.abs(z @ self.coefficients) ** 2)


def autoregression(stretches: Sequence[FloatArray], most: int = MOST_LAGS) -> Autoregression:
    """Of a residual, by Burg's recursion over all stretches; order by Akaike's criterion (Luetkepohl 2005, section 4.3).

    Burg's reflection coefficients, unlike those of the autocovariance (Yule and Walker), hold where a spectrum falls by several decades
    below the sampling frequency, as that of an attitude does (de Hoon et al., IEEE Trans. Signal Processing 44, 1996).
    """
    usable = [s for s in stretches if s.size > LEAST_STRETCH]
    total = sum(s.size for s in usable)
    if not total:
        return Autoregression(np.ones(1), 1.0)
    most = max(min(most, max(s.size for s in usable) // LEAST_STRETCH, total // 10), 0)
    variance = power = sum(float(s @ s) for s in usable) / total
    if not variance > LEAST_STD**2:
        return Autoregression(np.ones(1), LEAST_STD)
    forward = np.concatenate(usable)  # all at once; between stretches, where there are no pairs, both are 0
    backward = forward.copy()
    begins = np.cumsum([s.size for s in usable])[:-1]
    a = np.ones(1)
    best, least = (a, power), total * np.log(power)
    for order in range(1, most + 1):
        forward, backward = forward[1:], backward[:-1]
        for one, at in ((forward, begins - 1), (backward, begins - order)):
            one[at[(at >= 0) & (at < one.size)]] = 0.0
        reflection = -2.0 * float(forward @ backward) / float(forward @ forward + backward @ backward)
        a = np.append(a, 0.0)
        a = a + reflection * a[::-1]
        power *= 1.0 - reflection**2
        if power <= 1e-12 * variance:
            break
        criterion = total * np.log(power) + 2.0 * order
        if criterion < least:
            best, least = (a, power), criterion
        forward, backward = forward + reflection * backward, backward + reflection * forward
    return Autoregression(best[0], max(float(np.sqrt(best[1])), LEAST_STD))


@dataclass(frozen=True)
class Whitened:
    """Streams whitened and stacked: residual (N,), columns (N, q); of every row (N,) its group, its block, about 5 s each, its channel."""

    residual: FloatArray
    columns: FloatArray
    group: NDArray[np.intp]
    block: NDArray[np.intp]
    channel: NDArray[np.str_]

    def information(self) -> tuple[FloatArray, FloatArray]:
        """Normal equations: (q, q) and (q,)."""
        return self.columns.T @ self.columns, self.columns.T @ self.residual


def block_rows(seconds: float, period_s: float) -> int:
    """Samples of one block of the sandwich: the longest of `BLOCK_S` that leaves `WANTED_BLOCKS` in so many seconds."""
    return max(round(float(np.clip(seconds / WANTED_BLOCKS, *BLOCK_S)) / period_s), 10)


def noises(streams: Sequence[Stream]) -> dict[str, Autoregression]:
    """The noise of each channel, of the residuals as they stand."""
    channels = dict.fromkeys(s.channel for s in streams)
    return {c: autoregression([s.residual - s.residual.mean() for s in streams if s.channel == c]) for c in channels}


def whiten(streams: Sequence[Stream], noise: dict[str, Autoregression], rows_per_block: int) -> Whitened:
    """Every stream by its channel's noise. Blocks are stretches of rows of one group, for standard errors that do not assume whiteness."""
    residual, columns, group, block, channel = [], [], [], [], []
    starts: dict[tuple[str, int], int] = {}
    for s in streams:
        ar = noise[s.channel]
        if not s.residual.size:
            continue
        r, along = _whitened(ar, s)
        residual.append(r)
        columns.append(along)
        group.append(np.full(r.size, s.group))
        channel.append(np.full(r.size, s.channel))
        # The channels of one moment are of one block: a gust moves them all.
        begin = starts.get((s.channel, s.group), 0)
        starts[s.channel, s.group] = begin + s.residual.size
        block.append((begin + np.arange(r.size)) // rows_per_block)
    if not residual:
        q = streams[0].columns.shape[1] if streams else 0
        none = np.zeros(0, dtype=np.intp)
        return Whitened(np.zeros(0), np.zeros((0, q)), none, none, none.astype(np.str_))
    of, at = np.concatenate(group), np.concatenate(block)
    many = np.zeros(of.max() + 1, dtype=np.intp)  # blocks of each group
    np.maximum.at(many, of, at + 1)
    at += (np.cumsum(many) - many)[of]
    return Whitened(np.concatenate(residual), np.concatenate(columns), of, at, np.concatenate(channel))


def _whitened(ar: Autoregression, s: Stream) -> tuple[FloatArray, FloatArray]:
    """Residual and columns of a stream; of nine flights with winds of their own most columns of each are nothing."""
    used = s.columns.any(axis=0)
    made = ar.whitened(np.column_stack([s.residual, s.columns[:, used]]))
    columns = np.zeros(s.columns.shape)
    columns[:, used] = made[:, 1:]
    return made[:, 0], columns


def log_scale(streams: Sequence[Stream], noise: Mapping[str, Autoregression]) -> float:
    """Minus the log likelihood of the innovations less half their whitened sum of squares, but for a constant: the logarithms of what every
    sample is divided by; and one for every coefficient of the noise (Akaike 1974), since a noise of many imitates what a model lacks.

    All samples count, the first by what is known before them: noises of different orders would else be compared on different samples. On
    tunnel flights one of 40 lags, which left out the first 4 s, had 111 nats more than one of 17 at the same parameters.
    """
    coefficients = sum(noise[c].order for c in {s.channel for s in streams})
    return sum(noise[s.channel].log_scale(s.residual.size) for s in streams) + coefficients


@dataclass(frozen=True)
class Step:
    """A Gauss-Newton step: delta (q,); covariance (q, q) by the information alone, robust (q, q) by blocks; chi2: the weighted sum of
    squares before it."""

    delta: FloatArray
    covariance: FloatArray
    robust: FloatArray
    chi2: float


def step(rows: Whitened, prior_mean: FloatArray, prior_std: FloatArray) -> Step:
    """Least squares with a Gaussian prior of the step, prior_std (q,) infinite where there is none.

    robust: the sandwich over blocks (Liang and Zeger 1986), with the few-cluster factor n / (n - 1); not below the information's. A
    direction that neither data nor prior determine has an infinite variance.
    """
    hessian, score = rows.information()
    precision = np.where(np.isfinite(prior_std), 1.0 / np.where(np.isfinite(prior_std), prior_std, 1.0) ** 2, 0.0)
    full = hessian + np.diag(precision)
    scale = np.sqrt(np.maximum(np.diag(full), 1e-300))
    scaled = full / np.outer(scale, scale)
    value, vector = np.linalg.eigh(0.5 * (scaled + scaled.T))
    known = value > 1e-10 * max(float(value.max(initial=0.0)), 1e-300)
    inverse = (vector[:, known] / value[known]) @ vector[:, known].T
    covariance = inverse / np.outer(scale, scale)
    delta = covariance @ (score + precision * prior_mean)
    left = rows.residual - rows.columns @ delta
    n = int(rows.block.max(initial=-1)) + 1
    scores = np.zeros((n, hessian.shape[0]))
    np.add.at(scores, rows.block, rows.columns * left[:, None])
    meat = scores.T @ scores * (n / max(n - 1, 1))
    # What priors contribute is no estimate of these blocks.
    robust = covariance @ (meat + np.diag(precision)) @ covariance
    unknown = vector[:, ~known] / scale[:, None]
    lost = np.einsum("ij,ij->i", unknown, unknown) > 0.0
    at = np.arange(len(delta))
    below = np.diag(robust) < np.diag(covariance)
    grow = np.where(below, np.sqrt(np.diag(covariance) / np.maximum(np.diag(robust), 1e-300)), 1.0)
    robust = robust * np.outer(grow, grow)
    if lost.any():
        strong = np.abs(unknown * scale[:, None]).max(axis=1, initial=0.0) > 0.1
        covariance[at[strong], at[strong]] = np.inf
        robust[at[strong], at[strong]] = np.inf
    return Step(delta, covariance, robust, float(rows.residual @ rows.residual))


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
        residual, columns = _whitened(ar, s)
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
