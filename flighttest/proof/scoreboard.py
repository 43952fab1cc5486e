"""The scoreboard of sealed trials: counts with binomial intervals, power curve, calibration, confusion, every miss with its reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import stats

from flighttest.identify.free_flight.winds import WIND_TERM
from flighttest.proof.outcome import BASE, Outcome
from flighttest.proof.records import (
    Calibration,
    ConfusionRow,
    Counted,
    Magnitudes,
    Miss,
    NameRates,
    NoiseRow,
    PowerRow,
    Scores,
)

COUNTS = 2.0  # noise floors an effect must have to count; below it is in the power curve only
ABSENT = 0.5  # below this it is not there
BINS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
ODDS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
HIGH_R2 = 0.95
LEAST_COVERED, MOST_COVERED = 0.90, 0.99
LEAST_FORCE_M_S2 = 0.02  # a true force below it is no measure of a magnitude


def share_interval(k: int, n: int) -> tuple[float, float]:
    """95 % Clopper-Pearson interval of a share."""
    if n == 0:
        return 0.0, 1.0
    low = float(stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return low, high


def right(outcome: Outcome, effect: str) -> bool:
    """Whether the class of a hidden effect was named."""
    return bool(set(outcome.classes.get(effect, (effect,))) & set(outcome.named))


def first_right(outcome: Outcome) -> bool:
    """Whether the class of the (first) hidden effect ranks first."""
    effect = next(iter(outcome.hide))
    return bool(outcome.named) and outcome.named[0] in outcome.classes.get(effect, (effect,))


def wrong(outcome: Outcome) -> set[str]:
    """What was named and neither hidden, however small, nor such that the oracle cannot distinguish it from what was."""
    return set(outcome.named) - set(outcome.hide) - {i for c in outcome.classes.values() for i in c}


@dataclass(frozen=True)
class Groups:
    """The trials that were flown, by what they are counted for. clean: nothing there, or too little; hiding: something of the catalogue,
    of whatever size; single, pairs, outside: what is hidden is large enough to count; natural: pairs
    of campaigns, whose flag is counted."""

    flown: Sequence[Outcome]
    clean: Sequence[Outcome]
    hiding: Sequence[Outcome]
    single: Sequence[Outcome]
    pairs: Sequence[Outcome]
    outside: Sequence[Outcome]
    natural: Sequence[Outcome]

    @classmethod
    def of(cls, outcomes: Sequence[Outcome]) -> Groups:
        """Of all trials."""
        natural = [o for o in outcomes if o.kind == "natural" and not o.error]
        flown = [o for o in outcomes if o.kind != "natural" and not o.error]
        large = {kind: [o for o in flown if o.kind == kind and _all_count(o)] for kind in ("single", "pair", "outside")}
        return cls(
            flown,
            [o for o in flown if all(s < ABSENT for s in o.sizes.values()) and o.kind != "outside"],
            [o for o in flown if o.kind in ("single", "pair")],
            large["single"],
            large["pair"],
            large["outside"],
            natural,
        )


def _all_count(outcome: Outcome) -> bool:
    return bool(outcome.sizes) and all(s >= COUNTS for s in outcome.sizes.values())


def _count(outcomes: Sequence[Outcome], holds: Any) -> Counted:
    """(of how many it holds, how many there are)."""
    return sum(bool(holds(o)) for o in outcomes), len(outcomes)


def score(outcomes: Sequence[Outcome]) -> Scores:
    """Every number of the scoreboard, as plain data."""
    groups = Groups.of(outcomes)
    return {
        "trials": len(outcomes),
        "flown": len(groups.flown) + len(groups.natural),
        "not_flown": [{"index": o.index, "why": o.error} for o in outcomes if o.error],
        "by_noise": _by_noise(groups.flown),
        **_names(groups),
        **_magnitudes(groups),
        **_calibration(groups),
        "power": _power(groups.hiding),
        "confusion": _confusion(groups.single),
        "misses": [miss for o in (*groups.flown, *groups.natural) for miss in _misses(o)],
    }


def _names(groups: Groups) -> NameRates:
    seen = [o for o in groups.outside if o.located is not None]
    return {
        "first": _count(groups.single, first_right),
        "absorbed": _count([o for o in groups.single if o.base_r2 > HIGH_R2], first_right),
        "false_alarms": _count(groups.clean, wrong),
        "nothing_hidden": sum(o.kind == "clean" for o in groups.clean),
        "pairs": _count(groups.pairs, lambda o: all(right(o, e) for e in o.hide)),
        "outside_misnamed": _count(groups.outside, lambda o: o.named),
        "outside_located": _count(seen, lambda o: o.located),
        # Of whatever size: a wrong name is wrong beside a small effect, too.
        "extra_names": _count(groups.hiding, wrong),
        "changes": _count([o for o in groups.natural if o.hide], _as_known),
        "unchanged": _count([o for o in groups.natural if not o.hide], _as_known),
        "wind_changes": _count([o for o in groups.natural if o.hide and WIND_TERM in o.values], _as_known),
        "wind_unchanged": _count([o for o in groups.natural if not o.hide and WIND_TERM in o.values], _as_known),
    }


def _as_known(outcome: Outcome) -> bool:
    """Whether what is said of a pair, a change or none, is what is known of it."""
    return set(outcome.hide) == set(outcome.named)


def _by_noise(flown: Sequence[Outcome]) -> list[NoiseRow]:
    """Apart where some of the trials have the noise of real recordings."""
    rows: list[NoiseRow] = []
    for noise, real in (("of real recordings", True), ("synthetic", False)) if any(o.real_noise for o in flown) else ():
        some = Groups.of([o for o in flown if o.real_noise is real])
        first, alarms = _count(some.single, first_right), _count(some.clean, wrong)
        rows.append({"noise": noise, "trials": len(some.flown), "first": first, "false_alarms": alarms})
    return rows


def _magnitudes(groups: Groups) -> Magnitudes:
    counted = [*groups.single, *groups.pairs]
    forces = [(true, found) for o in groups.single for e, (true, found) in o.forces.items() if right(o, e)]
    ratios = [abs(found / true - 1.0) for true, found in forces if true > LEAST_FORCE_M_S2 and found > 0]
    named = [table for o in counted for table in o.values.values()]
    errors = [_relative_error(table) for table in named if any(v[0] for v in table.values())]
    return {
        "force_ratio_median_error": _median(ratios),
        "force_ratios": len(ratios),
        "value_median_error": _median(errors),
        "values": len(errors),
        "gain_median": _median([o.gain for o in counted]),
        "cpu_median_s": _median([o.cpu_s for o in groups.flown if o.cpu_s]),
        "wall_median_s": _median([o.wall_s for o in groups.flown if o.wall_s]),
    }


def _calibration(groups: Groups) -> Calibration:
    """Coverage of the intervals, and calibration of the probabilities beside names."""
    counted = (*groups.single, *groups.pairs)
    named = [(e, k, v) for o in counted for e, table in o.values.items() for k, v in table.items()]
    base = [(BASE, k, v) for o in groups.clean for k, v in o.values.get(BASE, {}).items()]
    named, base = ([v for v in table if np.isfinite(v[2][2:]).all()] for table in (named, base))
    # Wide intervals hold anything: how wide they are belongs beside how many hold.
    widths = [(v[3] - v[2]) / 2 / abs(v[0]) for _, _, v in named if v[0]]
    by_parameter: dict[str, list[bool]] = {}
    for effect, name, value in (*named, *base):
        by_parameter.setdefault(f"{effect}: {name}", []).append(_holds(value))
    stated = [
        (p, t not in (wrong(o) if o.kind != "outside" else {t})) for o in groups.flown for t, p in o.probability.items()
    ]
    covered = [o.coverage for o in groups.flown if np.isfinite(o.coverage)]
    return {
        "values_inside": _inside(named),
        "base_inside": _inside(base),
        "value_median_width": _median(widths),
        "inside_by_parameter": {k: (sum(v), len(v)) for k, v in sorted(by_parameter.items())},
        "reliability": [
            {
                "from": low,
                "to": high,
                "stated": _mean([p for p, _ in some]),
                "right": (sum(r for _, r in some), len(some)),
            }
            for low, high in pairwise(ODDS)
            if (some := [(p, r) for p, r in stated if low < p <= high])
        ],
        "brier": _mean([(p - r) ** 2 for p, r in stated]),
        "coverage_mean": _mean(covered),
        "coverage_within": (sum(LEAST_COVERED <= c <= MOST_COVERED for c in covered), len(covered)),
    }


def _holds(value: tuple[float, float, float, float]) -> bool:
    true, _, low, high = value
    return low <= true <= high


def _inside(values: Sequence[tuple[str, str, tuple[float, float, float, float]]]) -> Counted:
    return sum(_holds(v) for _, _, v in values), len(values)


def _relative_error(values: Mapping[str, tuple[float, float, float, float]]) -> float:
    """Largest relative error of an effect's parameters, of those that are not zero."""
    return max(abs(v[1] / v[0] - 1.0) for v in values.values() if v[0])


def _median(values: Sequence[float]) -> float | None:
    known = [v for v in values if np.isfinite(v)]
    return float(np.median(known)) if known else None


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _power(hiding: Sequence[Outcome]) -> list[PowerRow]:
    power: list[PowerRow] = []
    for low, high in pairwise(BINS):
        inside = [(o, e) for o in hiding for e, s in o.sizes.items() if low <= s < high]
        power.append({"from": low, "to": high, "n": len(inside), "named": sum(right(o, e) for o, e in inside)})
    return power


def _confusion(single: Sequence[Outcome]) -> list[ConfusionRow]:
    table = Counter((next(iter(o.hide)), o.named[0] if o.named else "nothing") for o in single)
    return [{"hidden": h, "named": n, "count": c} for (h, n), c in sorted(table.items())]


def _misses(outcome: Outcome) -> Iterator[Miss]:
    """What should have been named and was not; what should not have been and was."""
    why = f"named {', '.join(outcome.named) or 'nothing'}"
    if outcome.kind == "natural":
        missed = [] if _as_known(outcome) else [("a change" if outcome.hide else "nothing", 0.0)]
    elif outcome.kind in ("single", "pair"):
        missed = [(e, s) for e, s in outcome.sizes.items() if s >= COUNTS and not right(outcome, e)]
    elif outcome.named:
        missed = [(next(iter(outcome.hide), "nothing"), max(outcome.sizes.values(), default=0.0))]
    else:
        missed = []
    for effect, size in missed:
        alike = list(outcome.classes.get(effect, ())) if outcome.kind != "outside" else []
        yield {"index": outcome.index, "hidden": effect, "size": size, "why": why, "class": alike}
