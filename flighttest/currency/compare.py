"""Are two sets of estimates the same vehicle? Per parameter subset, with a stated false-alarm rate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from flighttest.currency.model import SUBSETS, FloatArray, SubsetTest

# Chance that an unchanged vehicle raises any alarm in one campaign, shared over the subsets tested (Bonferroni).
FALSE_ALARM = 0.01
# Campaigns of one vehicle differ by more than the fit's own errors, since the model is not the vehicle: wind and the operating
# point move the best-fitting parameters. An allowance, relative, as one standard deviation; a vehicle's own history (five
# unchanged runs or more) takes its place.
DISCREPANCY: dict[str, float] = {
    "K": 0.008,
    "alpha": 0.06,
    "sigma_t": 0.03,
    "omega_phi": 0.02,
    "omega_theta": 0.02,
    "zeta_phi": 0.04,
    "zeta_theta": 0.04,
    "sigma_r": 0.03,
    "d_x": 0.20,
    "d_y": 0.20,
    "d_z": 0.20,
}
DEFAULT_DISCREPANCY = 0.05


@dataclass(frozen=True)
class Estimates:
    """Parameter names, values (n,) and covariance (n, n), SI. Parameters that are not identifiable are left out by the caller."""

    name: str
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray

    def select(self, wanted: Sequence[str]) -> Estimates:
        """The same with these parameters only, in this order."""
        index = [self.names.index(n) for n in wanted]
        return Estimates(self.name, tuple(wanted), self.values[index], self.covariance[np.ix_(index, index)])


def discrepancy(names: Sequence[str], values: FloatArray, spread: Mapping[str, float] | None = None) -> FloatArray:
    """Diagonal covariance (n, n) of what campaigns of one unchanged vehicle differ by; `spread` overrides the table (relative, 1 sigma)."""
    table = {**DISCREPANCY, **(spread or {})}
    relative = np.array([table.get(n, DEFAULT_DISCREPANCY) for n in names])
    return np.diag((relative * np.abs(values)) ** 2)


def subset_tests(
    stored: Estimates,
    new: Estimates,
    *,
    spread: Mapping[str, float] | None = None,
    false_alarm: float = FALSE_ALARM,
    subsets: Mapping[str, tuple[str, ...]] = SUBSETS,
) -> tuple[SubsetTest, ...]:
    """Test every subset both sides know something about."""
    shared = {s: tuple(n for n in names if n in stored.names and n in new.names) for s, names in subsets.items()}
    testable = {s: names for s, names in shared.items() if names}
    level = false_alarm / max(len(testable), 1)
    return tuple(_test(s, stored.select(names), new.select(names), spread, level) for s, names in testable.items())


def _test(
    subset: str, stored: Estimates, new: Estimates, spread: Mapping[str, float] | None, level: float
) -> SubsetTest:
    # The allowance scales with both estimates: on the stored one alone, a drag that came out low would raise false alarms.
    typical = np.hypot(stored.values, new.values) / math.sqrt(2.0)
    covariance = stored.covariance + new.covariance + discrepancy(stored.names, typical, spread)
    delta = new.values - stored.values
    std = np.sqrt(np.diag(covariance))
    # Scaled before solving: the parameters differ by orders of magnitude.
    whitened = np.linalg.solve(covariance / np.outer(std, std), delta / std)
    statistic = max(float(np.dot(whitened, delta / std)), 0.0)
    p_value = float(stats.chi2.sf(statistic, len(delta)))
    shifts = {
        n: (float(d / abs(v)) if v else math.nan, float(d / s))
        for n, d, v, s in zip(stored.names, delta, stored.values, std, strict=True)
    }
    alarm = p_value < level
    return SubsetTest(
        subset, statistic, len(delta), p_value, level, alarm, shifts, _sentence(subset, alarm, shifts, p_value)
    )


_WORDS = {
    "K": "thrust per throttle",
    "alpha": "dependence of thrust on voltage",
    "sigma_t": "speed of the thrust response",
    "omega_phi": "speed of the roll response",
    "omega_theta": "speed of the pitch response",
    "zeta_phi": "damping of the roll response",
    "zeta_theta": "damping of the pitch response",
    "sigma_r": "speed of the yaw rate response",
    "d_x": "drag forward",
    "d_y": "drag sideways",
    "d_z": "drag in climb",
}


def in_words(parameter: str, change: float) -> str:
    """'thrust per throttle fell 6 %'."""
    verb = "rose" if change > 0 else "fell"
    return f"{_WORDS.get(parameter, parameter)} {verb} {abs(change) * 100:.1f} %"


def _sentence(subset: str, alarm: bool, shifts: Mapping[str, tuple[float, float]], p_value: float) -> str:
    if not alarm:
        return f"{subset}: as before"
    ordered = sorted(((abs(z), n, c) for n, (c, z) in shifts.items()), reverse=True)
    moved = [(n, c) for size, n, c in ordered if size > 2.0] or [(n, c) for _, n, c in ordered[:1]]
    words = ", ".join(in_words(n, c) for n, c in moved)
    return f"{words} (chance of this without a change: {p_value:.1g})"


def thrust_or_mass(stored: Estimates, new: Estimates) -> str:
    """'thrust', 'mass' or 'thrust or mass'.

    More mass divides K and the drag coefficients by one ratio; less thrust touches K alone. Told apart only where the drag is
    known better than 2 % on both sides.
    """
    names = [n for n in ("d_x", "d_y", "d_z") if n in stored.names and n in new.names]
    if "K" not in stored.names or "K" not in new.names or not names:
        return "thrust or mass"
    ratios, errors = [], []
    for n in names:
        i, j = stored.names.index(n), new.names.index(n)
        relative = math.hypot(
            math.sqrt(stored.covariance[i, i]) / abs(stored.values[i]),
            math.sqrt(new.covariance[j, j]) / abs(new.values[j]),
        )
        if relative < 0.02:
            ratios.append(float(new.values[j] / stored.values[i]))
            errors.append(relative)
    if not ratios:
        return "thrust or mass"
    weights = 1.0 / np.square(errors)
    drag = float(np.average(ratios, weights=weights)) - 1.0
    thrust = float(new.values[new.names.index("K")] / stored.values[stored.names.index("K")]) - 1.0
    return "mass" if abs(drag - thrust) < abs(drag) else "thrust"
