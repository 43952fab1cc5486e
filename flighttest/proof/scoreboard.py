"""The scoreboard of sealed trials: counts with binomial intervals, power curve, confusion matrix, every miss with its reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import stats

from flighttest.proof.cases import Generator, Kind
from flighttest.proof.trial import Outcome

COUNTS = 2.0  # noise floors an effect must have to count; below it is in the power curve only
ABSENT = 0.5  # below this it is not there
BINS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
HIGH_R2 = 0.95
LEAST_COVERED, MOST_COVERED = 0.90, 0.99
NONE_FLOWN = "none flown"


def interval(k: int, n: int) -> tuple[float, float]:
    """95 % Clopper-Pearson interval of a share."""
    if n == 0:
        return 0.0, 1.0
    low = float(stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return low, high


def share(k: int, n: int) -> str:
    """'19 of 20, 95 % (75 to 100)'."""
    if n == 0:
        return NONE_FLOWN
    low, high = interval(k, n)
    return f"{k} of {n}, {100 * k / n:.0f} % (95 % interval {100 * low:.0f} to {100 * high:.0f})"


def right(outcome: Outcome, effect: str) -> bool:
    """Whether the class of a hidden effect was named."""
    return bool(set(outcome.classes.get(effect, (effect,))) & set(outcome.named))


def first_right(outcome: Outcome, effect: str) -> bool:
    """Whether the class of a hidden effect ranks first."""
    return bool(outcome.named) and outcome.named[0] in outcome.classes.get(effect, (effect,))


def score(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Every number of the scoreboard, as plain data."""
    flown = [o for o in outcomes if not o.error]
    clean = [o for o in flown if all(s < ABSENT for s in o.sizes.values()) and o.kind != "outside"]
    single = [o for o in flown if o.kind == "single" and any(s >= COUNTS for s in o.sizes.values())]
    pairs = [o for o in flown if o.kind == "pair" and sum(s >= COUNTS for s in o.sizes.values()) == 2]
    outside = [o for o in flown if o.kind == "outside" and any(s >= COUNTS for s in o.sizes.values())]
    first = [o for o in single if first_right(o, next(iter(o.hide)))]
    absorbed = [o for o in single if o.base_r2 > HIGH_R2]
    power = []
    for low, high in pairwise(BINS):
        inside = [(o, e) for o in flown if o.kind in ("single", "pair") for e, s in o.sizes.items() if low <= s < high]
        power.append({"from": low, "to": high, "n": len(inside), "named": sum(right(o, e) for o, e in inside)})
    ratios = [
        found / true
        for o in single
        for e, (true, found) in o.forces.items()
        if true > 0.02 and found > 0 and right(o, e)
    ]
    values = [v for o in single + pairs for e, v in o.values.items() if o.sizes.get(e, 0.0) >= COUNTS]
    misses = [_relative(v) for v in values if any(true for true, _, _ in v.values())]
    spans = [abs(found - true) <= 1.96 * std for v in values for true, found, std in v.values() if np.isfinite(std)]
    # Wide intervals hold anything: how wide they are belongs beside how many hold.
    widths = [std / abs(true) for v in values for true, _, std in v.values() if true and np.isfinite(std)]
    gains = [o.gain for o in single + pairs if np.isfinite(o.gain)]
    covered = [o.coverage for o in flown if np.isfinite(o.coverage)]
    # Of whatever size: a wrong name is wrong beside a small effect, too.
    hiding = [o for o in flown if o.kind in ("single", "pair")]
    extra = sum(bool(set(o.named) - _hidden(o)) for o in hiding)
    return {
        "trials": len(outcomes),
        "flown": len(flown),
        "not_flown": [{"index": o.index, "why": o.error} for o in outcomes if o.error],
        "first": (len(first), len(single)),
        "absorbed": (sum(first_right(o, next(iter(o.hide))) for o in absorbed), len(absorbed)),
        "false_alarms": (sum(bool(set(o.named) - _hidden(o)) for o in clean), len(clean)),
        "nothing_hidden": sum(o.kind == "clean" for o in clean),
        "pairs": (sum(all(right(o, e) for e in o.hide) for o in pairs), len(pairs)),
        "outside_misnamed": (sum(bool(o.named) for o in outside), len(outside)),
        "outside_located": (sum(o.located for o in outside), len(outside)),
        "extra_names": (extra, len(hiding)),
        "force_ratio_median_error": float(np.median(np.abs(np.array(ratios) - 1))) if ratios else None,
        "force_ratios": len(ratios),
        "value_median_error": float(np.median(misses)) if misses else None,
        "values": len(misses),
        "values_inside": (sum(spans), len(spans)),
        "value_median_std": float(np.median(widths)) if widths else None,
        "coverage_mean": float(np.mean(covered)) if covered else None,
        "coverage_within": (sum(LEAST_COVERED <= c <= MOST_COVERED for c in covered), len(covered)),
        "gain_median": float(np.median(gains)) if gains else None,
        "power": power,
        "confusion": _confusion(single),
        "misses": _misses(flown),
    }


def _relative(values: Mapping[str, tuple[float, float, float]]) -> float:
    """Largest relative error of an effect's parameters, of those that are not zero."""
    return max(abs(found / true - 1.0) for true, found, _ in values.values() if true)


def _confusion(single: Sequence[Outcome]) -> list[dict[str, Any]]:
    table: dict[tuple[str, str], int] = {}
    for o in single:
        key = next(iter(o.hide)), (o.named[0] if o.named else "nothing")
        table[key] = table.get(key, 0) + 1
    return [{"hidden": h, "named": n, "count": c} for (h, n), c in sorted(table.items())]


def _misses(flown: Sequence[Outcome]) -> list[dict[str, Any]]:
    found = []
    for o in flown:
        for e, size in o.sizes.items():
            if o.kind in ("single", "pair") and size >= COUNTS and not right(o, e):
                why = "named nothing" if not o.named else f"named {', '.join(o.named)}"
                found.append(
                    {"index": o.index, "hidden": e, "size": size, "why": why, "class": list(o.classes.get(e, ()))}
                )
        if not o.sizes and o.kind == "clean" and o.named:
            found.append(
                {"index": o.index, "hidden": "nothing", "size": 0.0, "why": f"named {', '.join(o.named)}", "class": []}
            )
        if o.kind == "outside" and o.named:
            found.append(
                {"index": o.index, "hidden": next(iter(o.hide)), "size": max(o.sizes.values(), default=0.0),
                 "why": f"named {', '.join(o.named)}", "class": []}
            )  # fmt: skip
    return found


def _hidden(outcome: Outcome) -> set[str]:
    """What may rightly be named: what was hidden, however small, and what the oracle cannot tell from it."""
    return set(outcome.hide) | {i for c in outcome.classes.values() for i in c}


def markdown(outcomes: Sequence[Outcome], seed: int, generator: Generator = "rotor", kind: Kind | None = None) -> str:
    """docs/proof.md; kind: the only one of the trials."""
    s = score(outcomes)
    alone = f" of kind `{kind}`" if kind else ""
    lines = [
        "# Proof",
        "",
        "Generated by `flighttest prove`; every number below was computed from sealed trials. What is hidden was drawn from the seed, "
        "written apart and hashed before the diagnosis began.",
        "",
        f"- generator: `{generator}`; seed {seed}; {s['trials']} trials{alone}, {s['flown']} flown; code: {code_of(outcomes)}",
        *(f"- {what}: {found}" for what, found in _rates(s) if not found.startswith(NONE_FLOWN)),
        "",
        *(_tables(s) if any(p["n"] for p in s["power"]) else ()),
        "## Misses",
        "",
        *(
            [f"- trial {m['index']}: {m['hidden']} ({m['size']:.1f} floors): {m['why']}" for m in s["misses"]]
            or ["None."]
        ),
        "",
        "## Seals",
        "",
        "| trial | SHA-256 of the truth | hidden | size, floors | named |",
        "|---|---|---|---|---|",
        *(
            f"| {o.index} | `{o.sha256[:16]}` | {', '.join(o.hide) or 'nothing'} | "
            f"{', '.join(f'{v:.1f}' for v in o.sizes.values()) or '-'} | {', '.join(o.named) or o.error or 'nothing'} |"
            for o in outcomes
        ),
        "",
    ]
    return "\n".join(lines)


def code_of(outcomes: Sequence[Outcome]) -> str:
    """The commit of all trials, or how many are of which."""
    counts = Counter(o.code for o in outcomes)
    return next(iter(counts), "") if len(counts) < 2 else ", ".join(f"{c} ({n} trials)" for c, n in counts.items())


def _rates(s: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield f"right class first (effect at least {COUNTS:g} noise floors after the refit)", share(*s["first"])
    yield f"the same where the base fit alone has R2 above {HIGH_R2}", share(*s["absorbed"])
    clean = f"false alarms on clean trials (nothing hidden in {s['nothing_hidden']}, else less than {ABSENT:g} noise floors)"
    yield clean, share(*s["false_alarms"])
    yield "two effects, both named", share(*s["pairs"])
    yield "physics outside the catalogue, wrongly named", share(*s["outside_misnamed"])
    yield "physics outside the catalogue, located", share(*s["outside_located"])
    yield "something named that was not hidden, where something was", share(*s["extra_names"])
    if s["force_ratios"]:
        error = _percent(s["force_ratio_median_error"])
        yield "magnitude (RMS force the base model leaves)", f"median error {error} over {s['force_ratios']} effects"
    if s["values"]:
        error = _percent(s["value_median_error"])
        yield "worst parameter of a named effect", f"median error {error} over {s['values']} effects"
        width = _percent(s["value_median_std"])
        inside = f"{share(*s['values_inside'])}; standard error {width} of the value in the median"
        yield "parameters of named effects inside their 95 % intervals", inside
    if s["gain_median"] is not None:
        yield "of the error above the noise floor on held-out steps, gone", f"median {_percent(s['gain_median'])}"
    if s["coverage_mean"] is not None:
        covered = f"between {LEAST_COVERED:.0%} and {MOST_COVERED:.0%} in {share(*s['coverage_within'])}"
        yield (
            "held-out repeats inside the 95 % intervals of the diagnosed model",
            f"mean {_percent(s['coverage_mean'])}; {covered}",
        )


def _tables(s: Mapping[str, Any]) -> Iterator[str]:
    yield from ("## Power", "", "| effect size, noise floors | hidden | named |", "|---|---|---|")
    yield from (f"| {p['from']:g} to {p['to']:g} | {p['n']} | {share(p['named'], p['n'])} |" for p in s["power"])
    yield from (
        "",
        "## Confusion (single effects that count)",
        "",
        "| hidden | named first | trials |",
        "|---|---|---|",
    )
    yield from (f"| {c['hidden']} | {c['named']} | {c['count']} |" for c in s["confusion"])
    yield ""


def _percent(value: float | None) -> str:
    return "unknown" if value is None or not np.isfinite(value) else f"{100 * value:.0f} %"
