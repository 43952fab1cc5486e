"""How the motors share the load, against the model's own flights: a damaged propeller shows in its motor before it shows in the thrust."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.estimation.uncertainty.distributions import beyond, quantile
from flighttest.identify.motor_shares import MOTORS, REPEATS, motor_shares
from flighttest.segments import Segment
from flighttest.validity.between_campaigns import PRIOR_WEIGHT
from flighttest.validity.model import FloatArray, SubsetTest

SUBSET = "motors"
FREE = len(MOTORS) - 1  # shares are about their mean


@dataclass(frozen=True)
class MotorLoad:
    """Of one or several flights. shares (4,): mean over the flights of each motor's command over the mean of all; spread: standard
    deviation of one flight's share about the vehicle's, all motors alike, with its degrees of freedom dof; flights: how many."""

    shares: FloatArray
    spread: float
    dof: float
    flights: int


def motor_load(segments: Sequence[Segment]) -> MotorLoad | None:
    """From the commands of four motors; None where they were not recorded.

    What the flights scatter is pulled towards what other undamaged vehicles did (`REPEATS`), which counts as `PRIOR_WEIGHT` flights.
    """
    found = motor_shares(segments)
    if not found:
        return None
    rows = np.stack([f.shares for f in found])
    weight = PRIOR_WEIGHT + len(rows) - 1
    apart = float(np.sum((rows - rows.mean(axis=0)) ** 2)) / len(MOTORS)
    return MotorLoad(
        rows.mean(axis=0), math.sqrt((PRIOR_WEIGHT * REPEATS**2 + apart) / weight), FREE * weight, len(rows)
    )


def culprit(test: SubsetTest) -> str:
    """What may have changed where the motors' test raised the alarm, in words."""
    motor = max(test.shifts, key=lambda m: abs(test.shifts[m][1])).replace("_", " ")
    return f"the propeller of {motor}, the motor itself, or a load near it"


def motor_load_test(stored: MotorLoad, new: MotorLoad, level: float) -> SubsetTest:
    """The motor whose share changed most. A campaign counts as one flight: flights of one session repeat each other, sessions do not."""
    change = new.shares - stored.shares
    error = stored.spread * math.sqrt(1.0 + 1.0 / stored.flights)
    z = change / error
    worst = int(np.argmax(np.abs(z)))
    p_value = min(1.0, len(MOTORS) * beyond(float(z[worst]), stored.dof))
    alarm = p_value < level
    relative = change / stored.shares
    verb = "rose" if change[worst] > 0 else "fell"
    half = -quantile(0.025, stored.dof) * error / stored.shares[worst]
    words = f"the command of motor {worst + 1} beside the others {verb} {abs(relative[worst]) * 100:.1f} ± {half * 100:.1f} %"
    sentence = f"{words} (chance of this without a change: {p_value:.1g})" if alarm else f"{words}: no more than usual"
    least = -quantile(level / (2.0 * len(MOTORS)), stored.dof) * error
    return SubsetTest(
        SUBSET,
        float(z[worst] ** 2),
        1,
        p_value,
        level,
        alarm,
        {m: (float(r), float(by)) for m, r, by in zip(MOTORS, relative, z, strict=True)},
        sentence,
        {m: least / float(share) for m, share in zip(MOTORS, stored.shares, strict=True)},
    )
