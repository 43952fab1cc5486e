"""Slow drift over runs: a self-starting two-sided CUSUM per parameter.

Each run's estimate is standardised against the pooled estimate of the model and all earlier runs, so that the scores of an
unchanged vehicle are independent standard normal numbers although they share one reference (Hawkins 1987). Run lengths: Siegmund 1985.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from flighttest.validity.between_campaigns import prior
from flighttest.validity.compare import Estimates
from flighttest.validity.model import Drift

SLACK = 0.5  # half the shift, in standard deviations, that is to be found fastest
FALSE_ALARM_EVERY = 200.0  # unchanged runs between false alarms of all parameters together


def mean_run_length(slack: float = SLACK, limit: float = 5.0) -> float:
    """Unchanged runs between false alarms of the two-sided CUSUM (Siegmund's approximation)."""
    b = limit + 1.166
    return (math.exp(2.0 * slack * b) - 2.0 * slack * b - 1.0) / (2.0 * slack**2) / 2.0


def limit_for(parameters: int, slack: float = SLACK) -> float:
    """The limit at which so many parameters together raise one false alarm in `FALSE_ALARM_EVERY` unchanged runs."""
    from scipy.optimize import brentq

    wanted = FALSE_ALARM_EVERY * max(parameters, 1)
    return float(brentq(lambda limit: mean_run_length(slack, limit) - wanted, 0.1, 50.0))


def drifts(
    stored: Estimates,
    runs: Sequence[Estimates],
    spread: Mapping[str, float] | None = None,
    slack: float = SLACK,
    limit: float | None = None,
) -> tuple[Drift, ...]:
    """One `Drift` per parameter of the stored model that at least one run has; `runs` in time order. limit: None for `limit_for`."""
    stored, runs = stored.known, [run.known for run in runs]
    limit = limit_for(len(stored.names), slack) if limit is None else limit
    found = []
    for i, name in enumerate(stored.names):
        series = [
            (
                run.name,
                float(run.values[run.names.index(name)]),
                float(run.covariance[run.names.index(name), run.names.index(name)]),
            )
            for run in runs
            if name in run.names
        ]
        if not series:
            continue
        floor = ((spread or {}).get(name, prior(name)) * float(stored.values[i])) ** 2
        mean, variance = float(stored.values[i]), float(stored.covariance[i, i]) + floor
        up = down = worst = 0.0
        crossed = ""
        for run_name, value, own in series:
            own += floor
            score = (value - mean) / math.sqrt(own + variance)
            up = max(0.0, up + score - slack)
            down = max(0.0, down - score - slack)
            if max(up, down) > abs(worst):
                worst = up if up >= down else -down
            if not crossed and max(up, down) > limit:
                crossed = run_name
            weight = variance / (variance + own)
            mean += weight * (value - mean)
            variance *= 1.0 - weight
        reference = float(stored.values[i])
        change = (series[-1][1] - reference) / abs(reference) if reference else math.nan
        found.append(Drift(name, worst, limit, mean_run_length(slack, limit), crossed, change))
    return tuple(found)
