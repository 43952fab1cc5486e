"""Residual analysis: whiteness, and correlation with the commands. In words an operator understands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.estimation.problem import Problem
from flighttest.estimation.responses import Response, zero_order_hold
from flighttest.estimation.solver import Solution
from flighttest.identify.diagnostics.quality import channel_quality

FloatArray = NDArray[np.float64]

LAGS_S = np.linspace(0.0, 0.5, 6)
LEVEL = 0.02  # chance of calling an independent residual dependent
LARGE = 0.02  # and this share of the residual must be explained, since long records make trifles significant
FLIPS = 999
_REFERENCE = {
    "roll_rad": ("roll_ref_rad", "roll command"),
    "pitch_rad": ("pitch_ref_rad", "pitch command"),
    "r_rad_s": ("yaw_rate_ref_rad_s", "yaw rate command"),
    "f_z_m_s2": ("throttle", "throttle"),
    "a_z_m_s2": ("throttle", "throttle"),
}


@dataclass(frozen=True)
class ResidualTest:
    """One channel. whiteness: autocorrelation of neighbours; share: of the residual that its lagged reference explains.

    p_value: of that share when the sign of each response's residual is drawn at random; both None where there is no reference, or too
    few responses to decide.
    """

    channel: str
    whiteness: float
    share: float | None
    p_value: float | None
    follows: bool
    sentence: str


def residual_tests(problem: Problem, solution: Solution) -> tuple[ResidualTest, ...]:
    """Whiteness of every channel, and independence of the external reference that drives it."""
    quality = channel_quality(problem, solution)
    found = []
    for part, made in zip(problem.parts, solution.evaluations, strict=True):
        for k, channel in enumerate(part.outputs):
            if channel not in quality:
                continue
            white = quality[channel].autocorrelation
            reference, words = _REFERENCE.get(channel, ("", ""))
            share, p = _dependence(problem, part.responses, made.residual[..., k], part.mask[..., k], reference)
            follows = share is not None and p is not None and share > LARGE and p <= LEVEL
            sentence = quality[channel].sentence
            if follows:
                sentence += f"; {100 * (share or 0.0):.0f} % of it follows the {words}"
            elif p is not None:
                sentence += f"; it does not follow the {words}"
            found.append(ResidualTest(channel, white, share, p, follows, sentence))
    return tuple(found)


def _dependence(
    problem: Problem, responses: Sequence[Response], residual: FloatArray, mask: NDArray[np.bool_], reference: str
) -> tuple[float | None, float | None]:
    """Share of the residual explained by the lagged reference, and how often sign flips of whole responses reach it."""
    gram, each, squares = np.zeros((LAGS_S.size, LAGS_S.size)), [], 0.0
    for j, response in enumerate(responses):
        segment = problem.segments[response.index]
        good = mask[j, : segment.t_s.size]
        if reference not in segment.u or good.sum() < 10:
            continue
        r = residual[j, : segment.t_s.size][good]
        x = np.stack([zero_order_hold(segment.u[reference], segment.t_s[good] - lag) for lag in LAGS_S], axis=1)
        x, r = x - x.mean(axis=0), r - r.mean()
        gram += x.T @ x
        each.append(x.T @ r)
        squares += float(r @ r)
    if len(each) < 8 or squares <= 0.0 or not np.any(gram):
        return None, None
    inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    rows = np.array(each)
    flips = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, len(each)))
    sums = np.concatenate([rows.sum(axis=0)[None], flips @ rows])
    explained = np.einsum("fi,ij,fj->f", sums, inverse, sums)
    return float(explained[0] / squares), float(np.mean(explained >= explained[0]))
