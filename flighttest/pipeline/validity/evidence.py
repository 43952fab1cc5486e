"""What `status` tests beside the paper's parameters: delays, parameters of terms that joined, effects that the model does not have."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from flighttest.diagnose import Diagnosis, Finding, Located, Verdict
from flighttest.diagnose.selection.comparison import log_odds_asked
from flighttest.diagnose.selection.detectability import POWER
from flighttest.errors import FitError
from flighttest.estimation.uncertainty.distributions import NORMAL_95, quantile
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.body import DELAY_PARAM
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import PAPER_TERMS, Model
from flighttest.pipeline.diagnosis.diagnose import run_diagnosis
from flighttest.pipeline.results import SILENT, Progress
from flighttest.pipeline.validity.known_mismatch import KnownMismatch, as_old_as_the_model
from flighttest.recording import Recording
from flighttest.report.numbers import join, percent
from flighttest.segments import Segment
from flighttest.validity.compare import FALSE_ALARM, discrepancy
from flighttest.validity.model import SCRIPTS, SUBSETS, Appeared, NotSeen, SubsetTest, Untested
from flighttest.vehicle.model import Vehicle

# Conditions of a day, not of a vehicle: the wind, and what an accelerometer is off by each time it is switched on.
OF_THE_DAY = ("steady_wind", "accelerometer_bias")
# Standard errors that a coefficient must be large to be named, of the fewest candidates: of more it is larger.
ASKED = math.sqrt(2.0 * log_odds_asked(1))
NAMELESS = "something without a name"
SOUND = (Verdict.NOTHING_MISSING.name, Verdict.EXPLAINED.name)
NOT_DIAGNOSED = "effects that the model does not have: it was never diagnosed, so that they may be as old as it is (`flighttest diagnose`)"


def subsets_of(model: Model) -> dict[str, tuple[str, ...]]:
    """Parameters that are tested together: the paper's four subsets, the delays, and each term that joined by itself."""
    known = catalogue()
    found = {**SUBSETS, "delay": tuple(n for n in DELAY_PARAM.values() if n in model.names)}
    found |= {t: tuple(p.name for p in known[t].params) for t in model.terms if t in known and t not in PAPER_TERMS}
    return {s: names for s, names in found.items() if names and s not in OF_THE_DAY}


def untested(
    stored: ModelFile,
    subsets: Mapping[str, Sequence[str]],
    tests: Sequence[SubsetTest],
    stds: Mapping[str, float | None],
    spread: Mapping[str, float],
) -> tuple[Untested, ...]:
    """Parameters of the model that no test is about, with the smallest relative change that would have raised the alarm. stds: standard
    errors from the new recording alone; spread: relative, what campaigns of an unchanged vehicle differ by."""
    determined = {n for t in tests for n in t.shifts}
    level = tests[0].level if tests else FALSE_ALARM / max(len(subsets), 1)
    known = catalogue()
    found = []
    for subset, names in subsets.items():
        for name in (n for n in names if n not in determined and n in stored.parameters):
            kept, new = stored.parameters[name], stds.get(name)
            smallest = None
            if new is not None and kept.std is not None and kept.value:
                doubt = float(discrepancy((name,), [kept.value], spread)[0, 0])  # type: ignore[arg-type]
                smallest = -quantile(level / 2.0, 1e4) * math.sqrt(new**2 + kept.std**2 + doubt) / abs(kept.value)
            fly = (
                SCRIPTS[subset]
                if subset in SCRIPTS
                else (known[subset].reveals,)
                if subset in known
                else ("spot_check",)
            )
            found.append(Untested(name, subset, smallest, tuple(fly)))
    return tuple(found)


def untested_sentences(missed: Sequence[Untested]) -> tuple[str, ...]:
    """One sentence for each subset: which of its parameters are not tested, and from which change on they would have shown."""
    found = []
    for subset in dict.fromkeys(u.subset for u in missed):
        mine = [u for u in missed if u.subset == subset]
        determined = [
            f"{u.parameter} would have shown from {percent(u.smallest, 0)} on" for u in mine if u.smallest is not None
        ]
        blind = [u.parameter for u in mine if u.smallest is None]
        if blind:
            determined.append(f"{join(blind)} not at all")
        found.append(f"{subset}: {', '.join(determined)}; fly {join(mine[0].fly)}")
    return tuple(found)


def effects(
    segments: Sequence[Segment],
    recordings: Sequence[Recording],
    stored: ModelFile,
    vehicle: Vehicle | None,
    progress: Progress = SILENT,
) -> Diagnosis | None:
    """The diagnosis of a new recording from the stored model on; None where that was never diagnosed itself, or there is too little."""
    if not stored.diagnosed:
        return None
    try:
        return run_diagnosis(segments, recordings, stored, vehicle, progress)
    except FitError:
        return None


def appeared(found: Diagnosis, stored: ModelFile) -> tuple[Appeared, ...]:
    """Effects that a new recording shows and the model does not have; none for a model whose own flights were never diagnosed, nor what
    those left alike or would not have shown (`as_old`)."""
    if not stored.diagnosed:
        return ()
    known = KnownMismatch(found, stored)
    smallest = stored.diagnosed.get("smallest_detectable") or {}
    new = []
    for f in _named(found, stored):
        if known.of_finding(f) or _too_small_to_tell(f, stored):
            continue
        level = smallest.get(f.term) if isinstance(smallest, Mapping) else None
        unseen = f.term in (stored.diagnosed.get("untestable") or ())
        before = (
            "not seen before, since the model's own flights could not have shown it: it may be as old as they are"
            if unseen
            else f"the model's own flights showed none, and would have from {level:.2g} on"
            if isinstance(level, int | float) and math.isfinite(level)
            else "the model's own flights showed none"
        )
        new.append(Appeared(f.term, f.title, f"{f.sentence}; {before}", unseen))
    measured = [place for place in _nameless(found, stored, known) if place.repeated and not known.of_place(place)]
    if not new and measured:
        new.append(Appeared("", NAMELESS, measured[0].sentence, False))
    return tuple(new)


def doubtful(found: Diagnosis, stored: ModelFile) -> str:
    """A mismatch without a name over a floor that no repeated step measures, in a sentence; empty where there is none. Gusts make one, too:
    of eight unchanged vehicles in spot checks flown once, two differed by 2.0 and 2.3 such floors (docs/validity.md)."""
    known = KnownMismatch(found, stored)
    places = [place for place in _nameless(found, stored, known) if not known.of_place(place)]
    return "" if not places or any(place.repeated for place in places) else places[0].sentence


def shows_more(found: Diagnosis, stored: ModelFile) -> bool:
    """Whether a new recording shows what the model does not have, or may."""
    return bool(appeared(found, stored) or doubtful(found, stored))


def as_old(found: Diagnosis, stored: ModelFile) -> tuple[str, ...]:
    """What a new recording shows and the model does not have, but its own flights left alike: one sentence for each
    name, and one for what has none."""
    if not stored.diagnosed:
        return ()
    known = KnownMismatch(found, stored)
    named = [(f.term, known.of_finding(f)) for f in _named(found, stored)]
    said = [as_old_as_the_model(term, [where]) for term, where in named if where]
    others = {known.of_place(place) for place in _nameless(found, stored, known)} - {"", *(where for _, where in named)}
    small = [_too_small_to_tell(f, stored) for f in _named(found, stored) if not known.of_finding(f)]
    return (*said, *filter(None, small), *([as_old_as_the_model(NAMELESS, sorted(others))] if others else ()))


def _too_small_to_tell(named: Finding, stored: ModelFile) -> str:
    """Why an effect is no evidence of a change, in a sentence: one as large may have been in the model's own flights without showing.
    Empty where they would have shown it, or nothing is known of what they would have shown."""
    levels = (stored.diagnosed or {}).get("smallest_detectable")
    level = levels.get(named.term) if isinstance(levels, Mapping) else None
    sizes = [p for p in catalogue()[named.term].amplitudes if p.name in named.parameters]
    if not isinstance(level, int | float) or not 0.0 < level < math.inf or len({p.unit for p in sizes}) != 1:
        return ""
    rows = {p.name: named.parameters[p.name] for p in sizes}
    may_be = {name: may_have_been_missed(level, row["std"]) for name, row in rows.items()}
    name = max(rows, key=lambda n: abs(rows[n]["value"]) / may_be[n])
    unit = f" {sizes[0].unit}" if sizes[0].unit != "1" else ""
    if not abs(rows[name]["value"]) < may_be[name]:
        return ""
    size, most = f"{rows[name]['value']:.2g} ± {NORMAL_95 * rows[name]['std']:.2g}{unit}", f"{may_be[name]:.2g}{unit}"
    return (
        f"whether {named.term} came: {name} is {size}, and one of up to {most} may have been in the model's own flights without showing; "
        "`flighttest diagnose` of both together describes it"
    )


def may_have_been_missed(level: float, std: float) -> float:
    """Smallest estimate that is a change: an unchanged coefficient of any size is missed by one diagnosis and exceeds this in the next in
    `FALSE_ALARM` of the cases at most. level: size that would have been named in four of five cases; std: of the new estimate.

    A diagnosis names an estimate that is `ASKED` or more of its standard errors large, so that its standard error follows from the level.
    """
    before = level / (ASKED + POWER)
    return ASKED * before - quantile(FALSE_ALARM, 1e4) * math.hypot(before, std)


def _named(found: Diagnosis, stored: ModelFile) -> Sequence[Finding]:
    """Effects found that the model does not have and that are the vehicle's."""
    return [f for f in found.findings if f.term not in stored.model.terms and f.term not in OF_THE_DAY]


def _nameless(found: Diagnosis, stored: ModelFile, known: KnownMismatch) -> Sequence[Located]:
    """Where a recording differs from a model whose own flights left nothing unexplained, if it has no name; a name for what was there
    before names nothing that stays beside it."""
    sound = (stored.diagnosed or {}).get("verdict") in SOUND
    as_before = found.verdict is Verdict.PARTLY and all(known.of_finding(f) for f in found.findings)
    return found.located if sound and (found.verdict is Verdict.UNKNOWN_PHYSICS or as_before) else ()


def not_seen(found: Diagnosis, stored: ModelFile) -> tuple[NotSeen, ...]:
    """Every effect of the catalogue that neither the model has nor a new recording shows, with the smallest size that would have shown."""
    hidden = {u.term: u for u in found.untestable}
    elsewhere = {f.term for f in found.findings} | {*stored.model.terms, *PAPER_TERMS, *OF_THE_DAY}
    known = catalogue()
    return tuple(
        NotSeen(
            term=t,
            family=known[t].family,
            smallest=found.smallest_detectable.get(t),
            unit=found.smallest_units.get(t, ""),
            hidden=t in hidden,
            fly=known[t].reveals if t not in hidden or hidden[t].recorded else "",
        )
        for t in sorted({*found.not_needed, *hidden}, key=lambda t: (known[t].family, t))
        if t not in elsewhere
    )
