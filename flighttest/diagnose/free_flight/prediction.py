"""Prediction errors of free flight on groups of flight that were not used, by equation error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from flighttest.diagnose.block import SEED
from flighttest.diagnose.model import short
from flighttest.diagnose.records import HeldOutRow
from flighttest.diagnose.selection.held_out import worse_in_more
from flighttest.estimation.equation_error import Whitened, block_rows, whiten
from flighttest.estimation.linearisation import FloatArray
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.motion_equations import Equations
from flighttest.segments.model import Segment

MEANS_S = 0.5  # residuals are held out as means over this long: shorter ones are noise of differentiated velocity
DRAWS = 200


def sampling_rate(flown: Sequence[Segment]) -> float:
    """Median rate of the samples, Hz."""
    return 1.0 / float(np.median(np.concatenate([np.diff(s.t_s) for s in flown])))


def groups_left_out(found: FreeFlight) -> tuple[int, str]:
    """How many groups are left out in turn, and what they are: flights where there are three or more, else pieces of the flight."""
    many = len(found.flights)
    return (many, "flights") if many >= 3 else (5, "pieces of the flight")


def share_gained(row: HeldOutRow | None) -> float:
    """Of the held-out mean square above the floor, the share that is gone; 0 where nothing is above it."""
    if row is None or not row["rmse_before"] > row["floor"]:
        return 0.0
    return float((row["rmse_before"] ** 2 - row["rmse_after"] ** 2) / (row["rmse_before"] ** 2 - row["floor"] ** 2))


def held_out_table(
    flown: Sequence[Segment], smaller: FreeFlight, larger: FreeFlight
) -> dict[str, dict[str, HeldOutRow]]:
    """Channel (short) to RMS errors of means over half a second, of groups not used, of two models of these flights.

    Parameters without a group by one Gauss-Newton step from the estimate with it; a flight's own wind is taken as estimated.
    """
    errors = [_left_out(flown, one) for one in (smaller, larger)]
    table: dict[str, dict[str, HeldOutRow]] = {}
    rng = np.random.default_rng(SEED)
    for channel in errors[0]:
        (before, group, _), (after, _, inside) = (e[channel] for e in errors)
        n = min(before.size, after.size)
        before, after, group = before[:n], after[:n], group[:n]
        members = [np.flatnonzero(group == g) for g in np.unique(group)]
        sums = np.array([[np.sum(before[m] ** 2), np.sum(after[m] ** 2), m.size] for m in members])
        drawn = sums[rng.integers(0, len(members), (DRAWS, len(members)))].sum(axis=1)
        gains = np.sqrt(drawn[:, 0] / drawn[:, 2]) - np.sqrt(drawn[:, 1] / drawn[:, 2])
        table[short(channel)] = {
            "all": HeldOutRow(
                rmse_before=float(np.sqrt(np.mean(before**2))), rmse_after=float(np.sqrt(np.mean(after**2))),
                floor=float(np.sqrt(np.mean(inside**2))), gain_95=[float(v) for v in np.quantile(gains, [0.025, 0.975])],
            )
        }  # fmt: skip
    return table


def against_larger(table: Mapping[str, Mapping[str, HeldOutRow]]) -> str:
    """As of `worse_in_more`, by the intervals of a table of `held_out_table`."""
    gains = [row["all"]["gain_95"] for row in table.values()]
    return worse_in_more(sum(high < 0.0 for _, high in gains), sum(low > 0.0 for low, _ in gains))


def _left_out(flown: Sequence[Segment], one: FreeFlight) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Channel to (means of the residual as predicted without their group, their group, means of the residual of the whole estimate)."""
    names = list(dict.fromkeys(n.split("@")[0] for n in one.names))
    own = tuple(n for n in names if n not in one.names)
    with np.errstate(all="ignore"):
        streams, columns = Equations(one.model, flown).streams(one.values, names, own)
    place = [columns.index(n) for n in one.names]
    count, kind = groups_left_out(one)
    period = 1.0 / sampling_rate(flown)
    rows = block_rows(one.seconds, period)
    many = max(round(MEANS_S / period), 1)
    parts: list[Whitened] = []
    pieces: list[tuple[str, FloatArray, FloatArray, int]] = []
    for s in streams:
        cut_at = [0, s.residual.size] if kind == "flights" else np.linspace(0, s.residual.size, count + 1).astype(int)
        for k, (a, b) in enumerate(pairwise(cut_at)):
            group = s.group if kind == "flights" else k
            piece = replace(s, residual=s.residual[a:b], columns=s.columns[a:b][:, place], group=group)
            parts.append(whiten([piece], dict(one.noise), rows))
            pieces.append((s.channel, piece.residual, piece.columns, group))
    information = [p.information() for p in parts]
    made: dict[str, list[tuple[FloatArray, FloatArray, FloatArray]]] = {}
    for g in sorted({p[3] for p in pieces}):
        others = [i for i, p in zip(information, pieces, strict=True) if p[3] != g]
        hessian, score = sum(h for h, _ in others), sum(s for _, s in others)
        # What belongs to the group left out alone, its wind, stays as it was estimated.
        determined = np.diag(hessian) > 0.0
        scale = np.sqrt(np.where(determined, np.diag(hessian), 1.0))
        inverse = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-8, hermitian=True)
        delta = np.where(determined, inverse @ (score / scale) / scale, 0.0)
        for channel, residual, jacobian, group in pieces:
            if group != g or residual.size < many:
                continue
            n = residual.size // many * many
            means = [v[:n].reshape(-1, many).mean(axis=1) for v in (residual - jacobian @ delta, residual)]
            made.setdefault(channel, []).append((means[0], np.full(means[0].size, g), means[1]))
    return {
        c: (np.concatenate([m[0] for m in v]), np.concatenate([m[1] for m in v]), np.concatenate([m[2] for m in v]))
        for c, v in made.items()
    }
