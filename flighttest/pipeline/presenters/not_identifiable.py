"""Why a fit determines nothing: ten lines at most, before any table."""

from __future__ import annotations

from collections.abc import Sequence

from flighttest.identify.fit import Estimate, Fit
from flighttest.report.document import Bullets, Section
from flighttest.report.numbers import join, number, unit
from flighttest.report.sections.fit import KIND_WORDS

MOST_REASONS = 6


def why_nothing(found: Fit, runs: Sequence[str]) -> Section | None:
    """What was flown, the reasons shared by most parameters, and what to fly. None where any parameter is known."""
    doubtful = [e for e in found.estimates.values() if e.source != "frozen"]
    if any(e.identifiable for e in doubtful) or not doubtful:
        return None
    lines = [_flown(found), *_reasons(doubtful)]
    scripts = list(dict.fromkeys(e.fly for e in doubtful if e.fly))
    if scripts:
        lines.append(
            f"steps would tell: `flighttest run {' '.join(scripts)}` flies them (with --vehicle and --connect, on this vehicle)"
        )
    lines.append(f"what the model misses: `flighttest diagnose {' '.join(runs)}`")
    return Section("why", "Why nothing is known", (Bullets(tuple(lines)),))


def _flown(found: Fit) -> str:
    segments = found.problem.segments
    counts: dict[str, int] = {}
    for s in segments:
        counts[s.kind] = counts.get(s.kind, 0) + 1
    kinds = [f"{n} x {KIND_WORDS.get(kind, kind)}" for kind, n in sorted(counts.items(), key=lambda row: -row[1])]
    seconds = sum(float(s.t_s[-1] - s.t_s[0]) for s in segments)
    return f"it rests on {number(seconds, 3)} s: {join(kinds)}"


def _reasons(doubtful: Sequence[Estimate]) -> list[str]:
    """Parameters by what is said of them, the reason of most first; those with a reason of their own by their errors."""
    alike: dict[str, list[Estimate]] = {}
    for e in doubtful:
        alike.setdefault("no segment determines them" if e.source == "assumed" else e.why, []).append(e)
    shared = sorted((row for row in alike.items() if len(row[1]) > 1), key=lambda row: -len(row[1]))
    single = [members[0] for _, members in alike.items() if len(members) == 1]
    wide = [e for e in single if e.std is not None]
    lines = [f"{join([e.name for e in members])}: {why}" for why, members in shared]
    lines += [f"{e.name}: {e.why}" for e in single if e.std is None]
    if wide:
        words = ", ".join(
            f"{e.name} {number(e.value, 2)} +- {number(e.std or 0.0, 2)} {unit(e.unit)}".strip() for e in wide
        )
        lines.insert(min(len(lines), MOST_REASONS - 1), f"too wide or in doubt, each for the reason below: {words}")
    rest = len(lines) - MOST_REASONS
    return lines if rest <= 0 else [*lines[:MOST_REASONS], f"and {rest} more below the table"]
