"""Tails and quantiles of Student's t, Fisher's F and the normal distribution.

From `scipy.special`, which loads in a fifth of the time of `scipy.stats`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from scipy import special

NORMAL_95 = 1.96  # two-sided 95 % quantile of the standard normal distribution


def quantile(p: float, dof: float) -> float:
    """The value that a Student-t variable stays below with probability p."""
    return float(special.stdtrit(dof, p))


def beyond(z: float, dof: float) -> float:
    """Two-sided: the probability that a Student-t variable is farther from zero than z."""
    return float(2.0 * special.stdtr(dof, -abs(z)))


def normal_quantile(p: float) -> float:
    """The value that a standard normal variable stays below with probability p."""
    return float(special.ndtri(p))


def normal_beyond(z: float) -> float:
    """Two-sided: the probability that a standard normal variable is farther from zero than z."""
    return float(2.0 * special.ndtr(-abs(z)))


def fisher_beyond(f: float, dof_above: float, dof_below: float) -> float:
    """The probability that Fisher's F ratio of these degrees of freedom is larger than f."""
    return float(special.fdtrc(dof_above, dof_below, f))


def fisher_quantile(p: float, dof_above: float, dof_below: float) -> float:
    """The value that Fisher's F ratio of these degrees of freedom stays below with probability p."""
    return float(special.fdtri(dof_above, dof_below, p))


def chi2_beyond(value: float, dof: float) -> float:
    """The probability that a chi-squared variable of these degrees of freedom is larger than value."""
    return float(special.chdtrc(dof, value))


def holm(p_values: Sequence[float], level: float) -> list[bool]:
    """Which of several hypotheses are rejected, the chance that any true one is no more than `level` (Holm 1979)."""
    found, still = [False] * len(p_values), True
    for k, i in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        still = still and p_values[i] <= level / (len(p_values) - k)
        found[i] = still
    return found


def expected_excess(ratio: float, dof_above: float, dof_below: float) -> float:
    """Mean of max(0, v - 1) of a variance ratio v known by an F ratio of these degrees of freedom: v is distributed as ratio over F.

        E = ratio b / (b - 2) P(F[a + 2, b - 2] > c (b - 2) a / (b (a + 2))) - P(F[a, b] > c),     c = 1 / ratio,

    a = dof_below, b = dof_above. Infinite for b of 2 or less, where that distribution has no mean.
    """
    a, b = dof_below, dof_above
    if ratio <= 0.0:
        return 0.0
    if b <= 2.0:
        return math.inf
    least = 1.0 / ratio
    mean = ratio * b / (b - 2.0) * fisher_beyond(least * (b - 2.0) * a / (b * (a + 2.0)), a + 2.0, b - 2.0)
    return max(mean - fisher_beyond(least, a, b), 0.0)
