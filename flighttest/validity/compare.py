"""Are two sets of estimates the same vehicle? Per parameter subset, with a stated false-alarm rate."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flighttest.estimation.uncertainty.distributions import beyond, fisher_beyond, quantile
from flighttest.identify import mass
from flighttest.validity.between_campaigns import DELAY_STD_S, prior
from flighttest.validity.model import SUBSETS, WORDS, FloatArray, SubsetTest

# Chance that an unchanged vehicle raises any alarm in one campaign, shared over the subsets tested (Bonferroni).
FALSE_ALARM = 0.01
# Without one of these a subset is not tested.
LEADING: dict[str, tuple[str, ...]] = {"thrust": ("K",), "attitude": ("omega_phi", "omega_theta")}
DOUBLED = 1.0  # relative change: a comparison that would not show a parameter doubled contains no information on it
KNOWN_STD = 0.1  # relative standard error below which thrust per throttle at the voltage flown counts as known


@dataclass(frozen=True)
class Estimates:
    """Parameter names, values (n,) and covariance (n, n), SI. Parameters that are not identifiable are left out by the caller.

    dof: (n,) Student-t degrees of freedom of each standard error, None for many. log_voltage: ln(U / U_n) of the throttle's estimate,
    NaN where it is not known. weak: K and alpha, where each alone is not identified: together they may still determine what a
    throttle gives at a voltage.
    """

    name: str
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    dof: FloatArray | None = None
    log_voltage: float = math.nan
    weak: frozenset[str] = frozenset()

    @property
    def known(self) -> Estimates:
        """Without the weak ones."""
        return self.select([n for n in self.names if n not in self.weak]) if self.weak else self

    def select(self, wanted: Sequence[str]) -> Estimates:
        """The same with these parameters only, in this order."""
        index = [self.names.index(n) for n in wanted]
        dof = None if self.dof is None else self.dof[index]
        covariance = self.covariance[np.ix_(index, index)]
        weak = self.weak & set(wanted)
        return Estimates(self.name, tuple(wanted), self.values[index], covariance, dof, self.log_voltage, weak)

    def at_voltage(self, log_voltage: float, alpha: float) -> Estimates:
        """The same with thrust per throttle at another voltage in K's place: K (U/U_n)^alpha.

        K and alpha are all but collinear over the short span of voltage of one flight, while what a throttle gives at the voltage flown
        is known well. alpha: is used where it was not estimated here.
        """
        if "K" not in self.names or not math.isfinite(log_voltage):
            return self
        i = self.names.index("K")
        turn = np.eye(len(self.names))
        if "alpha" in self.names:
            j = self.names.index("alpha")
            alpha = float(self.values[j])
        gain = math.exp(alpha * log_voltage)
        values = self.values.copy()
        values[i] *= gain
        turn[i, i] = gain
        if "alpha" in self.names:
            turn[i, j] = values[i] * log_voltage
        covariance = turn @ self.covariance @ turn.T
        determined = math.sqrt(float(covariance[i, i])) < KNOWN_STD * abs(float(values[i]))
        return replace(self, values=values, covariance=covariance, weak=self.weak - {"K"} if determined else self.weak)


@dataclass(frozen=True)
class MatchedPairs:
    """Like steps against like (see `alike`). before: the model's estimates, without a covariance; after: those at which the model misses
    the new steps as it missed its own, with the covariance of the difference; steps: how many kinds of step were compared."""

    before: Estimates
    after: Estimates
    steps: int

    def compared(self, names: Sequence[str], leading: Sequence[str], others: Sequence[str]) -> tuple[str, ...]:
        """Those of a subset's names that are determined; none where `others`, those of the estimates, hold a leading one that is not."""
        determined = tuple(n for n in names if n in self.after.names)
        needed = [n for n in leading if n in others] if leading else []
        return determined if set(needed or leading or determined) <= set(determined) else ()


def discrepancy(
    names: Sequence[str], values: FloatArray, spread: Mapping[str, float] | None, alpha_away: float = 0.0
) -> FloatArray:
    """Diagonal covariance (n, n) of what campaigns of one unchanged vehicle differ by beyond their errors.

    spread: relative, one sigma, in place of the stated prior. alpha_away: alpha times the logarithmic voltage over which K had to be
    carried from the stored model's data, where a discrepancy of alpha shows in K.
    """
    table = {n: (spread or {}).get(n, prior(n)) for n in (*names, "alpha")}
    relative = np.array([math.hypot(table[n], table["alpha"] * alpha_away if n == "K" else 0.0) for n in names])
    delay = np.array([n.startswith("T_d") for n in names])
    return np.diag(np.where(delay, DELAY_STD_S, relative * np.abs(values)) ** 2)


def subset_tests(
    stored: Estimates,
    new: Estimates,
    *,
    spread: Mapping[str, float] | None = None,
    false_alarm: float = FALSE_ALARM,
    subsets: Mapping[str, tuple[str, ...]] = SUBSETS,
    matched: MatchedPairs | None = None,
) -> tuple[SubsetTest, ...]:
    """Test every subset both sides determine, by like steps or by the estimates: by what would have shown the smaller change;
    parameters that only the other comparison determines are a test of their own.

    Thrust per throttle is compared at the voltage of the new recording.
    """
    alpha = float(stored.values[stored.names.index("alpha")]) if "alpha" in stored.names else 0.0
    away = alpha * (new.log_voltage - stored.log_voltage)
    before, after = stored.at_voltage(new.log_voltage, alpha).known, new.at_voltage(new.log_voltage, alpha).known
    shared = {s: tuple(n for n in names if n in before.names and n in after.names) for s, names in subsets.items()}
    # A lag alone does not show that the thrust is what it was, nor a damping that the loop is as fast.
    testable = {s: names for s, names in shared.items() if set(names) & set(LEADING.get(s, names))}
    pairs = (
        {s: matched.compared(n, LEADING.get(s, ()), shared[s]) for s, n in subsets.items()}
        if matched is not None
        else {}
    )
    pairs = {s: names for s, names in pairs.items() if names}
    # Like steps repeat what a model gets wrong about them: no more is left of it than the prior.
    left = {n: min(v, prior(n)) for n, v in (spread or {}).items()}
    carried = away if math.isfinite(away) else 0.0

    def by_steps(subset: str, names: Sequence[str], level: float) -> SubsetTest:
        assert matched is not None
        test = _test(subset, matched.before.select(names), matched.after.select(names), left, 0.0, level)
        return replace(test, matched=matched.steps)

    def by_estimates(subset: str, names: Sequence[str], level: float) -> SubsetTest:
        return _test(subset, before.select(names), after.select(names), spread, carried, level)

    # Per subset the comparison that detects the smaller change (at any level), and what the other alone determines beside it: of drag the
    # like steps of a spot check determine d_z alone, and d_x and d_y 22 % higher went by.
    chosen: list[tuple[Callable[[str, Sequence[str], float], SubsetTest], str, tuple[str, ...]]] = []
    for subset in subsets:
        ways = [(by_steps, pairs[subset])] if subset in pairs else []
        ways += [(by_estimates, testable[subset])] if subset in testable else []
        seen = [(_finest(way(subset, names, false_alarm), LEADING.get(subset, ())), way, names) for way, names in ways]
        ways = [(way, names) for least, way, names in sorted(seen, key=lambda one: one[0]) if least <= DOUBLED]
        determined: set[str] = set()
        for way, names in ways:
            own = tuple(n for n in names if n not in determined)
            if own:
                chosen.append((way, subset, own))
            determined |= set(own)
    level = false_alarm / max(len(chosen), 1)
    return tuple(way(subset, names, level) for way, subset, names in chosen)


def _finest(test: SubsetTest, leading: Sequence[str]) -> float:
    """The smallest change of a leading parameter that would have raised the alarm."""
    sizes = [v for n, v in test.detectable.items() if n in leading or not leading]
    return min(sizes, default=math.inf)


def _test(
    subset: str, stored: Estimates, new: Estimates, spread: Mapping[str, float] | None, away: float, level: float
) -> SubsetTest:
    # The discrepancy scales with both estimates: on the stored one alone, a drag that came out low would raise false alarms.
    typical = np.hypot(stored.values, new.values) / math.sqrt(2.0)
    covariance = stored.covariance + new.covariance + discrepancy(stored.names, typical, spread, away)
    delta = new.values - stored.values
    std = np.sqrt(np.diag(covariance))
    # Scaled before solving: the parameters differ by orders of magnitude.
    whitened = np.linalg.solve(covariance / np.outer(std, std), delta / std)
    statistic = max(float(np.dot(whitened, delta / std)), 0.0)
    dof = _dof(stored, new, std**2)
    p_value = _chance(statistic, delta / std, dof)
    share = level / (2.0 * delta.size * (1.0 if delta.size == 1 else 2.0))
    needed = [-quantile(share, float(one)) for one in dof]
    detectable = {
        n: float(k * s / abs(v)) for n, k, s, v in zip(stored.names, needed, std, stored.values, strict=True) if v
    }
    shifts = {
        n: (float(d / abs(v)) if v else math.nan, float(d / s))
        for n, d, v, s in zip(stored.names, delta, stored.values, std, strict=True)
    }
    alarm = p_value < level
    return SubsetTest(
        subset,
        statistic,
        len(delta),
        p_value,
        level,
        alarm,
        shifts,
        _sentence(subset, alarm, shifts, p_value),
        detectable,
    )


def _chance(statistic: float, z: FloatArray, dof: FloatArray) -> float:
    """Chance of all parameters, or of the single one that moved most, being this far off in an unchanged vehicle.

    Most changes move one parameter (propellers: K), which a test of all together dilutes, and some move several a little.
    """
    together = fisher_beyond(statistic / z.size, z.size, float(np.min(dof)))
    if z.size == 1:
        return together
    single = min(map(beyond, z.tolist(), dof.tolist())) * z.size
    return min(2.0 * min(together, single), 1.0)


MANY = 1e4  # degrees of freedom that are as good as infinite


def _dof(stored: Estimates, new: Estimates, total: FloatArray) -> FloatArray:
    """Degrees of freedom (n,) of the sum of both variances and the discrepancy, `total` (Welch, Satterthwaite)."""
    doubt = np.full(total.shape, 1.0 / MANY)
    for side in (stored, new):
        if side.dof is not None:
            doubt += (np.diag(side.covariance) / total) ** 2 / np.maximum(side.dof, 1.0)
    return np.asarray(1.0 / doubt)


def in_words(parameter: str, change: float) -> str:
    """'thrust per throttle fell 6 %'."""
    verb = "rose" if change > 0 else "fell"
    return f"{WORDS.get(parameter, parameter)} {verb} {abs(change) * 100:.1f} %"


def _sentence(subset: str, alarm: bool, shifts: Mapping[str, tuple[float, float]], p_value: float) -> str:
    if not alarm:
        return f"{subset}: as before"
    ordered = sorted(((abs(z), n, c) for n, (c, z) in shifts.items()), reverse=True)
    moved = [(n, c) for size, n, c in ordered if size > 2.0] or [(n, c) for _, n, c in ordered[:1]]
    words = ", ".join(in_words(n, c) for n, c in moved)
    return f"{words} (chance of this without a change: {p_value:.1g})"


def thrust_or_mass_words(stored: Estimates, new: Estimates) -> str:
    """'thrust', 'mass' or 'thrust or mass' (see `identify.mass`)."""
    changes: dict[str, tuple[float, float]] = {}
    for name in (n for n in mass.FORCES if n in stored.names and n in new.names):
        i, j = stored.names.index(name), new.names.index(name)
        old, now = float(stored.values[i]), float(new.values[j])
        if old > 0 and now > 0:
            changes[name] = mass.change(old, math.sqrt(stored.covariance[i, i]), now, math.sqrt(new.covariance[j, j]))
    return mass.thrust_or_mass(changes).answer if "K" in changes else "thrust or mass"
