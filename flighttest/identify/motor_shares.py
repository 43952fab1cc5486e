"""How the load is shared by the motors: each motor's command over the mean of all, in flight.

A damaged propeller gives less thrust at its command. The collective makes up for a quarter of it, and is lost among battery, weight and
weather; the torque that the loss leaves is made up for by that motor alone. The shares are the mixer's trim: they hold the vehicle's own
asymmetries, too, so that flights are compared with each other, not with one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

MOTORS = ("motor_1", "motor_2", "motor_3", "motor_4")
IDLE = 0.05  # mean command below which nothing is carried
# Standard deviation of a share between flights of one undamaged vehicle: 12 flights of two Crazyflies over several batteries (CrazyPAD),
# 0.007 to 0.028 by motor and vehicle.
REPEATS = 0.025
SHOWS = 3.0  # standard deviations from the other flights: one motor of a hundred flights of four by chance
FEWEST = 2  # flights that can be compared


@dataclass(frozen=True)
class MotorShares:
    """Of one flight. shares (4,): command over the mean of all, about 1; std (4,) of the mean over its windows; apart: motors, from 1, that
    work otherwise than in the other flights."""

    flight: str
    shares: FloatArray
    std: FloatArray
    apart: tuple[int, ...] = ()


def motor_shares(segments: Sequence[Segment]) -> tuple[MotorShares, ...]:
    """Of every flight in which all four commands were recorded."""
    windows: dict[str, list[FloatArray]] = {}
    for s in segments:
        if not s.usable or not all(m in s.y for m in MOTORS):
            continue
        commands = np.stack([s.y[m] for m in MOTORS], axis=1)
        commands = commands[np.isfinite(commands).all(axis=1)]
        if len(commands) and commands.mean() > IDLE:
            mean = commands.mean(axis=0)
            windows.setdefault(s.run, []).append(mean / mean.mean())
    found = []
    for flight, rows in windows.items():
        values = np.stack(rows)
        std = values.std(axis=0, ddof=1) / np.sqrt(len(rows)) if len(rows) > 1 else np.full(4, REPEATS)
        found.append(MotorShares(flight, values.mean(axis=0), std))
    return tuple(MotorShares(f.flight, f.shares, f.std, _apart(f, found)) for f in found)


def _apart(one: MotorShares, every: Sequence[MotorShares]) -> tuple[int, ...]:
    """Motors whose share lies further from the median of the other flights than undamaged vehicles repeat it."""
    others = [f.shares for f in every if f.flight != one.flight]
    if len(others) + 1 < FEWEST:
        return ()
    off = one.shares - np.median(np.stack(others), axis=0)
    shown = off > np.hypot(least_shift(len(every)), SHOWS * one.std)
    if len(others) == 1:
        # Shares are about their mean: what one motor does more in this flight the others do more in the other one, each by a third.
        shown &= off == np.max(np.abs(off))
    return tuple(int(k) + 1 for k in np.flatnonzero(shown))


def least_shift(flights: int) -> float:
    """By how much more a motor's share of one flight must be than the median of the others, of so many flights in all: both repeat."""
    return SHOWS * REPEATS * float(np.sqrt(1.0 + 1.0 / (flights - 1)))
