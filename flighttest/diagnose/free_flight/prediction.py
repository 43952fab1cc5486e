"""Prediction errors of free flight on groups of flight that were not used, by equation error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from flighttest.diagnose.answer import SEED
from flighttest.diagnose.model import short
from flighttest.diagnose.records import HeldOutRow
from flighttest.estimation.equation_error import (
    Autoregression,
    Whitened,
    beside_random_effects,
    block_rows,
    whiten,
    without_levels,
)
from flighttest.estimation.linearisation import FloatArray, inverse_of_gram
from flighttest.identify.free_flight import FreeFlight
from flighttest.identify.free_flight.equations import Equations
from flighttest.segments.model import Segment

MEANS_S = 0.5  # residuals are held out as means over this long: shorter ones are noise of differentiated velocity
DRAWS = 200


def groups_left_out(found: FreeFlight) -> tuple[int, str]:
    """How many groups are left out in turn, and what they are: flights where there are three or more, else pieces of the flight."""
    many = len(found.flights)
    return (many, "flights") if many >= 3 else (5, "pieces of the flight")


def held_out_table(
    flown: Sequence[Segment], smaller: FreeFlight, larger: FreeFlight, *, means: bool = True
) -> dict[str, dict[str, HeldOutRow]]:
    """Channel (short) to RMS errors, of groups not used, of two models of these flights: of means over half a second; of attitude loops one
    sample ahead, by the noise of the smaller model, since what gusts do to an attitude lasts.

    Parameters without a group by one Gauss-Newton step from the estimate with it; a flight's own wind is taken as estimated. Floor:
    what the better of the two leaves of what it was estimated from. means: False takes the mean of each group away, as the noise has none
    (`equation_error.noises`).
    """
    errors = [_left_out(flown, one, smaller.noise) for one in (smaller, larger)]
    table: dict[str, dict[str, HeldOutRow]] = {}
    rng = np.random.default_rng(SEED)
    for channel in errors[0]:
        (before, group, of_smaller), (after, _, of_larger) = (e[channel] for e in errors)
        n = min(before.size, after.size)
        before, after, group = before[:n], after[:n], group[:n]
        members = [np.flatnonzero(group == g) for g in np.unique(group)]
        if not means:
            for one in (before, after):
                for m in members:
                    one[m] -= one[m].mean()
        sums = np.array([[np.sum(before[m] ** 2), np.sum(after[m] ** 2), m.size] for m in members])
        drawn = sums[rng.integers(0, len(members), (DRAWS, len(members)))].sum(axis=1)
        gains = np.sqrt(drawn[:, 0] / drawn[:, 2]) - np.sqrt(drawn[:, 1] / drawn[:, 2])
        table[short(channel)] = {
            "all": HeldOutRow(
                rmse_before=float(np.sqrt(np.mean(before**2))), rmse_after=float(np.sqrt(np.mean(after**2))),
                floor=min(float(np.sqrt(np.mean(one**2))) for one in (of_smaller, of_larger)),
                gain_95=[float(v) for v in np.quantile(gains, [0.025, 0.975])],
            )
        }  # fmt: skip
    return table


def against_larger(table: Mapping[str, Mapping[str, HeldOutRow]]) -> str:
    """Why the larger model of a table of `held_out_table` is not taken: of the errors that surely change, the geometric mean grows; empty
    where it does not. (By counting channels, one 25 % better let pass another 68 % worse.)"""
    rows = [row["all"] for row in table.values()]
    surely = [r for r in rows if r["gain_95"][0] > 0.0 or r["gain_95"][1] < 0.0]
    grown = float(np.exp(np.mean([np.log(r["rmse_after"] / r["rmse_before"]) for r in surely]))) if surely else 1.0
    return (
        f"of what was not used, errors that surely change grow by {100.0 * (grown - 1.0):.0f} %" if grown > 1.0 else ""
    )


def _errors(values: FloatArray, noise: Autoregression, of: FreeFlight) -> FloatArray:
    """What is compared of a residual (n,): means over `MEANS_S`, or one-step prediction errors."""
    if of.part != "translation":
        return noise.whitened(values) * noise.std
    many = max(round(MEANS_S / of.period_s), 1)
    return np.asarray(values[: values.size // many * many].reshape(-1, many).mean(axis=1))


def _left_out(
    flown: Sequence[Segment], one: FreeFlight, noise: Mapping[str, Autoregression]
) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Channel to (errors as predicted without their group, their group, errors of the whole estimate); noise: of one-step predictions."""
    with np.errstate(all="ignore"):
        streams, columns = Equations(one.model, flown, one.part).streams(
            one.values, one.estimated, one.per_flight, one.initial
        )
    varying = without_levels(one.noise)
    streams = beside_random_effects(streams, varying)
    place = [columns.index(n) for n in one.names]
    count, kind = groups_left_out(one)
    rows = block_rows(one.seconds, one.period_s)
    parts: list[Whitened] = []
    pieces: list[tuple[str, FloatArray, FloatArray, int]] = []
    for s in streams:
        cut_at = [0, s.residual.size] if kind == "flights" else np.linspace(0, s.residual.size, count + 1).astype(int)
        for k, (a, b) in enumerate(pairwise(cut_at)):
            group = s.group if kind == "flights" else k
            piece = replace(s, residual=s.residual[a:b], columns=s.columns[a:b][:, place], group=group)
            parts.append(whiten([piece], varying, rows))
            pieces.append((s.channel, piece.residual, piece.columns, group))
    information = [p.information() for p in parts]
    made: dict[str, list[tuple[FloatArray, FloatArray, FloatArray]]] = {}
    for g in sorted({p[3] for p in pieces}):
        others = [i for i, p in zip(information, pieces, strict=True) if p[3] != g]
        hessian, score = sum(h for h, _ in others), sum(s for _, s in others)
        # What belongs to the group left out alone, its wind, stays as it was estimated.
        determined = np.diag(hessian) > 0.0
        delta = np.where(determined, inverse_of_gram(np.asarray(hessian), 1e-8) @ score, 0.0)
        for channel, residual, jacobian, group in pieces:
            if group != g:
                continue
            without, whole = (_errors(v, noise[channel], one) for v in (residual - jacobian @ delta, residual))
            if without.size:
                made.setdefault(channel, []).append((without, np.full(without.size, g), whole))
    return {
        c: (np.concatenate([m[0] for m in v]), np.concatenate([m[1] for m in v]), np.concatenate([m[2] for m in v]))
        for c, v in made.items()
    }
