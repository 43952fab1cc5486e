"""Did the mass change? A change of mass lies in the span of K and D, so it is no term but a test against a previous model."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from flighttest.diagnose.records import MassChange
from flighttest.estimation.uncertainty.distributions import normal_beyond, normal_quantile
from flighttest.identify.mass import FORCES, SIGNIFICANT, change, thrust_or_mass


def mass_test(
    previous: Mapping[str, tuple[float, float | None]], after: Mapping[str, tuple[float, float]], as_flown: float = 1.0
) -> MassChange:
    """Against the previous parameters: ratio of thrust, one common ratio of all forces and whether it fits; {} where nothing is comparable.

    as_flown: what turns the ratio of K, which is at the nominal voltage, into that of thrust at the voltage flown.
    """
    changes: dict[str, tuple[float, float]] = {}
    for name in FORCES:
        if name not in previous or name not in after:
            continue
        old, old_std = previous[name]
        new, new_std = after[name]
        if name == "K":
            new, new_std = new * as_flown, new_std * as_flown
        if old > 0 and new > 0 and (math.isfinite(old_std or 0.0)):
            changes[name] = change(old, old_std or 0.0, new, new_std)
    if "K" not in changes:
        return {}
    test = thrust_or_mass(changes)
    thrust, std = changes["K"][0], float(np.sqrt(changes["K"][1]))
    found: MassChange = {
        "thrust_ratio": float(np.exp(thrust)),
        "thrust_changed": normal_beyond(thrust / std) < SIGNIFICANT,
        "common_ratio": test.common_ratio,
        "common_ratio_std": test.common_ratio_std,
    }
    if not found["thrust_changed"]:
        least = 100 * std * normal_quantile(1.0 - SIGNIFICANT / 2)
        found["sentence"] = f"no change of thrust per mass is seen (one above {least:.1f} % would show)"
        return found
    changed = f"{100 * (float(np.exp(thrust)) - 1):+.1f} %"
    found["answer"] = test.answer
    if test.same_ratio_p is None:
        found["sentence"] = (
            f"thrust per mass changed by {changed}: thrust or mass, drag is not known well enough to decide"
        )
        return found
    words = {
        "mass": f"all forces per mass changed by one ratio: the mass changed by {100 * (1 / test.common_ratio - 1):+.1f} %",
        "thrust": f"thrust changed by {changed} and drag did not: propulsion, not mass",
        "thrust or mass": f"thrust per mass changed by {changed}: thrust or mass",
    }[test.answer]
    found["same_ratio_p"], found["drag_unchanged_p"] = test.same_ratio_p, test.drag_unchanged_p
    found["sentence"] = words
    return found
