"""Validity on one screen: what changed, why it matters, what to fly and how long it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flighttest.report.document import (
    Align,
    Bullets,
    Cell,
    Document,
    Figure,
    PageBlock,
    Panel,
    Paragraph,
    Role,
    Section,
    Table,
    Tone,
    Trace,
)
from flighttest.report.numbers import duration, join, join_some, number, percent, unit
from flighttest.validity.model import WORDS, Assessment, NotSeen, ValidityVerdict

TONES: dict[ValidityVerdict, Tone] = {
    ValidityVerdict.CURRENT: "good",
    ValidityVerdict.STALE: "bad",
    ValidityVerdict.UNKNOWN: "warn",
}


@dataclass(frozen=True)
class Reflight:
    """One way on. what: whom it is for; minutes: in the air; command: what flies it."""

    what: str
    scripts: tuple[str, ...]
    minutes: float
    command: str


FEW_CHANGES = 6  # rows of changes on a terminal
_FIRST = (
    "component",
    "mass",
    "firmware",
    "frame",
    "voltage",
)  # what a person changed, before what a parameter list shows


def status_document(
    found: Assessment, facts: Mapping[str, str], flights: Sequence[Reflight], *, brief: bool = False
) -> Document:
    """What changed, why it matters, what to fly and how long it takes. facts: what was compared; brief: for one screen of a terminal."""
    sections = []
    if found.changes:
        sections.append(_changes(found, brief))
    if found.tests:
        sections.append(_tests(found) if brief else _tests_in_full(found))
    for title, unseen in (("New", False), ("Not seen before", True)):
        listed = tuple(a.sentence for a in found.appeared if a.unseen is unseen)
        if listed:
            sections.append(_listed("unseen" if unseen else "appeared", title, listed, brief))
    if found.not_seen:
        sections.append(_not_seen(found.not_seen, brief))
    if found.impact:
        sections.append(_listed("matters", "Why it matters", found.impact, brief))
    if flights and (found.fly or found.verdict is ValidityVerdict.UNKNOWN):
        sections.append(_fly(flights, brief))
    if found.battery is not None and not (brief and found.tests and found.battery.resistance_ohm is not None):
        tone: Tone = "bad" if found.battery.alarm else "plain"
        sections.append(Section("battery", "" if brief else "Battery", (Paragraph(found.battery.sentence, tone),)))
    if any(d.crossed_at for d in found.drifts) or (found.drifts and not brief):
        sections.append(_drifts(found))
    if found.could_also_be:
        sections.append(_listed("rivals", "It could also be", found.could_also_be, brief))
    if found.cannot_tell:
        sections.append(_not_compared(found.cannot_tell, brief))
    return Document(
        "Is the model current?",
        found.sentence + ("" if brief else _detectable(found)),
        TONES[found.verdict],
        tuple(sections),
        dict(facts),
    )


def _detectable(found: Assessment) -> str:
    """The change of the thrust gain that would have been detected, in a sentence; '' where that was not tested, or changed."""
    least = next((t.detectable["K"] for t in found.tests if "K" in t.detectable and not t.alarm), None)
    return "" if least is None else f" A change of {WORDS['K']} would have been detected from {percent(least)} on."


def _listed(name: str, title: str, items: tuple[str, ...], brief: bool) -> Section:
    """A heading and its sentences; in one paragraph where the screen is small."""
    if brief:
        return Section(name, "", (Paragraph(f"{title}: {'; '.join(items)}."),))
    return Section(name, title, (Bullets(items),))


def _not_compared(items: tuple[str, ...], brief: bool) -> Section:
    """What these recordings could not show; on a terminal how much of it, unless everything is asked for."""
    what = (
        f"{len(items)} things could not be compared: --all lists them"
        if len(items) > 1
        else "1 thing could not be compared: --all lists it"
    )
    return Section("unknown", "" if brief else "What could not be compared", (Bullets(items, what if brief else ""),))


def _not_seen(effects: Sequence[NotSeen], brief: bool) -> Section:
    """New effects that were looked for: from which size on each would have shown; on a terminal those that could be there all the same."""
    rows = tuple(
        (
            e.family,
            e.term,
            Cell("not at all" if e.smallest is None else _size(e), "warn" if e.hidden else "plain"),
            e.fly or "a channel is missing",
        )
        for e in effects
    )
    hidden = [e for e in effects if e.hidden]
    many = len(effects) - len(hidden)
    seen = f"{many or 'No'} effect{'s' if many > 1 else ''} that the model does not have would have shown at twice the usual size or less"
    later = [f"{e.term} from {_size(e)} on" for e in hidden if e.smallest is not None]
    never = [e.term for e in hidden if e.smallest is None]
    rest = (f"; {join(later)}" if later else "") + (f"; {join_some(never)} not at all" if never else "")
    caption = (
        "Effects that neither the model has nor the new recording shows, and the size from which on each would have shown, of several "
        "coefficients the one that shows first."
    )
    table = Table(
        ("", "effect", "shows from", "script that shows it"),
        rows,
        ("left", "left", "right", "left"),
        caption,
        fold=True,
        brief=f"{seen}{rest}: --all lists them, with what to fly.",
    )
    return Section("effects", "" if brief else "New effects", (table,))


def _size(effect: NotSeen) -> str:
    return f"{number(effect.smallest or 0.0, 2)} {unit(effect.unit)}".strip()


def _changes(found: Assessment, brief: bool) -> Section:
    ordered = sorted(found.changes, key=lambda c: (_FIRST.index(c.kind) if c.kind in _FIRST else len(_FIRST), c.name))
    shown = ordered[:FEW_CHANGES] if brief and len(ordered) > FEW_CHANGES + 1 else ordered
    rows = [(c.name, Cell(c.before, "quiet"), Cell(c.after, "bad"), join(c.touches)) for c in shown]
    rest = ordered[len(shown) :]
    if rest:
        touched = join(tuple(dict.fromkeys(s for c in rest for s in c.touches)))
        rows.append((f"and {len(rest)} more", Cell("(all with --json)", "quiet"), Cell(""), touched))
    since = tuple(dict.fromkeys(c.since for c in ordered if c.since))
    blocks: list[PageBlock] = [Table(("what", "the model's", "today's", "touches"), tuple(rows))]
    reasons = [c for c in ordered if c.kind in _FIRST or not brief]
    sentences = tuple(dict.fromkeys(c.because if c.name in c.because else f"{c.name}: {c.because}" for c in reasons))
    if sentences:
        blocks.append(Bullets(sentences))
    one_flight = len(since) == 1 and not any(c.dated for c in ordered)
    title = f"What changed {since[0]}" if one_flight else "What changed"
    if since and not one_flight:
        when = {c.since: [d.name for d in ordered if d.since == c.since] for c in ordered if c.since}
        blocks.append(Paragraph("; ".join(f"{join(names)}: {s}" for s, names in when.items()), "quiet"))
    return Section("declared", title, tuple(blocks))


def _tests(found: Assessment) -> Section:
    """One line per subset: what moved most."""
    rows = []
    for t in found.tests:
        name = max(t.shifts, key=lambda n: abs(t.shifts[n][1]))
        change = t.shifts[name][0]
        rows.append(
            (
                t.subset,
                WORDS.get(name, name),
                Cell(f"{change * 100:+.1f} %", "bad" if t.alarm else "plain"),
                f"{t.detectable[name] * 100:.1f} %" if name in t.detectable else "-",
                f"{t.p_value:.1g}",
                Cell("changed" if t.alarm else "as before", "bad" if t.alarm else "good"),
            )
        )
    if found.battery is not None and found.battery.resistance_ohm is not None:
        now, before = found.battery.resistance_ohm, found.battery.reference_ohm
        moved = f"{(now[0] / before[0] - 1.0) * 100:+.1f} %" if before and before[0] else "-"
        word = ("changed" if found.battery.alarm else "as before") if before else "not known before"
        bad: Tone = "bad" if found.battery.alarm else "plain"
        last = Cell(word, "bad" if found.battery.alarm else "good" if before else "quiet")
        rows.append(("battery", "internal resistance", Cell(moved, bad), "-", "-", last))
    align: tuple[Align, ...] = ("left", "left", "right", "right", "right", "left")
    heads = ("subset", "largest change in", "change", "shows from", "p-value", "")
    return Section("tests", "", (Table(heads, tuple(rows), align, _caption(found, brief=True)),))


def _caption(found: Assessment, *, brief: bool = False) -> str:
    level, matched = found.tests[0].level, max(t.matched for t in found.tests)
    rate = f"{level * len(found.tests) * 100:.0f} %"
    if brief:
        return f"A change below 'shows from' may not be detected. False alarms: {rate} of campaigns."
    how = f"matched steps: {matched} kinds; " if matched else ""
    return (
        f"shows from: a smaller change may not have been detected; {how}p-value: chance of this difference without change; alarm below "
        f"{level:.2g}, which an unchanged vehicle raises in {rate} of campaigns."
    )


def _tests_in_full(found: Assessment) -> Section:
    rows = []
    for t in found.tests:
        for index, (name, (change, z)) in enumerate(t.shifts.items()):
            first = index == 0
            rows.append(
                (
                    t.subset if first else "",
                    name,
                    Cell(percent(change), "bad" if t.alarm and abs(z) > 2 else "plain"),
                    f"{z:+.1f}",
                    percent(t.detectable[name]) if name in t.detectable else "-",
                    (f"{t.matched} kinds of step" if t.matched else "estimates") if first else "",
                    f"{t.p_value:.2g}" if first else "",
                    Cell("changed" if t.alarm else "as before", "bad" if t.alarm else "good") if first else "",
                )
            )
    blocks: list[PageBlock] = [_shifts(found)]
    blocks.append(
        Table(
            ("subset", "parameter", "change", "z", "shows from", "compared by", "p-value", ""),
            tuple(rows),
            ("left", "left", "right", "right", "right", "left", "right", "left"),
            _caption(found),
        )
    )
    return Section("tests", "The new flight against the model", tuple(blocks))


def _shifts(found: Assessment) -> Figure:
    """The change of each parameter, with the smallest detectable change as its bar."""
    traces = []
    sides: tuple[tuple[str, bool, Role], ...] = (("changed", True, "limit"), ("as before", False, "other"))
    for name, alarm, role in sides:
        moved = [
            (parameter, 100.0 * change, 100.0 * t.detectable.get(parameter, float("nan")))
            for t in found.tests
            if t.alarm is alarm
            for parameter, (change, _) in t.shifts.items()
        ]
        if moved:
            names, changes, least = ([m[k] for m in moved] for k in range(3))
            traces.append(Trace(names, changes, name, role, "errorbars", spread=np.asarray(least, dtype=float)))
    caption = (
        "Point: change of the new flight's estimate from the model's. Bar: the change that would be detected; a smaller one may not "
        "have been."
    )
    return Figure("shifts", (Panel("change of each parameter", "", "change, %", tuple(traces)),), caption, 1, 340)


def _drifts(found: Assessment) -> Section:
    rows = tuple(
        (
            d.parameter,
            percent(d.change),
            f"{d.excursion:+.1f}",
            f"{d.limit:.1f}",
            Cell(d.crossed_at or "within", "bad" if d.crossed_at else "good"),
        )
        for d in found.drifts
    )
    caption = (
        "CUSUM over runs, in standard deviations; an unchanged vehicle crosses one of these limits once in about "
        f"{found.drifts[0].false_alarm_every / len(found.drifts):.0f} runs."
    )
    align: tuple[Align, ...] = ("left", "right", "right", "right", "left")
    table = Table(("parameter", "now", "excursion", "limit", ""), rows, align, caption)
    return Section("drift", "Drift over runs", (table,))


def _fly(flights: Sequence[Reflight], brief: bool) -> Section:
    rows = tuple((f.what, duration(f.minutes * 60.0), Cell(f.command, "good")) for f in flights)
    heads = ("what to fly" if brief else "", "in the air", "command")
    return Section("fly", "" if brief else "What to fly", (Table(heads, rows, ("left", "right", "left")),))
