"""Thrust or mass: more mass divides K and every drag coefficient by one ratio, less thrust touches K alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flighttest.estimation.uncertainty.distributions import chi2_beyond

FORCES = ("K", "d_x", "d_y", "d_z")
DRAG_KNOWN = 0.02  # relative standard error below which drag separates mass from thrust
SIGNIFICANT = 0.01


@dataclass(frozen=True)
class MassTest:
    """Which of the two changed. common_ratio, its std: of all forces, were it one; same_ratio_p: of that; drag_unchanged_p: of drag as it
    was (both None where drag is not known well enough to decide)."""

    answer: Literal["thrust", "mass", "thrust or mass"]
    common_ratio: float
    common_ratio_std: float
    same_ratio_p: float | None = None
    drag_unchanged_p: float | None = None


def change(old: float, old_std: float, new: float, new_std: float) -> tuple[float, float]:
    """Logarithm of new over old, both above zero, and its variance."""
    return float(np.log(new / old)), max((new_std / new) ** 2 + (old_std / old) ** 2, 1e-10)


def thrust_or_mass(changes: Mapping[str, tuple[float, float]]) -> MassTest:
    """changes: name among `FORCES`, K included, to its `change`."""
    y, variance = (np.array(column) for column in zip(*changes.values(), strict=True))
    weight = 1.0 / variance
    common, std = float(np.sum(weight * y) / np.sum(weight)), float(1.0 / np.sqrt(np.sum(weight)))
    ratio = float(np.exp(common)), std * float(np.exp(common))
    drag = [k for k, name in enumerate(changes) if name != "K"]
    if not drag or np.sqrt(variance[drag]).min() > DRAG_KNOWN:
        return MassTest("thrust or mass", *ratio)
    same = chi2_beyond(float(np.sum(weight * (y - common) ** 2)), len(y) - 1)
    still = chi2_beyond(float(np.sum(weight[drag] * y[drag] ** 2)), len(drag))
    if same > SIGNIFICANT > still:
        return MassTest("mass", *ratio, same, still)
    if still > SIGNIFICANT > same:
        return MassTest("thrust", *ratio, same, still)
    return MassTest("thrust or mass", *ratio, same, still)
