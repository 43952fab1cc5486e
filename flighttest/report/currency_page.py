"""Currency on one screen: what changed, why it matters, what to fly and how long it takes; and the history page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flighttest.currency.model import Currency, Verdict
from flighttest.report.document import (
    Block,
    Bullets,
    Cell,
    Code,
    Document,
    Figure,
    Panel,
    Paragraph,
    Section,
    Table,
    Tone,
    Trace,
)
from flighttest.report.numbers import duration, join, percent, to_error, unit

TONES: dict[Verdict, Tone] = {Verdict.CURRENT: "good", Verdict.STALE: "bad", Verdict.UNKNOWN: "warn"}


def status_document(
    found: Currency, facts: Mapping[str, str], scripts: Mapping[str, str], minutes: Mapping[str, float]
) -> Document:
    """facts: what was compared; scripts: what to fly to the path of the script; minutes: flying time per script."""
    sections = []
    if found.changes:
        rows = tuple(
            (c.name, c.kind, c.before, c.after, c.since or "-", join(c.touches), join(c.narrower))
            for c in found.changes
        )
        table = Table(("what", "", "the model's", "today's", "since", "touches", "at least fly"), rows)
        reasons = tuple(
            dict.fromkeys(c.because if c.name in c.because else f"{c.name}: {c.because}" for c in found.changes)
        )
        sections.append(Section("declared", "What changed", (table, Bullets(reasons))))
    if found.tests:
        sections.append(_tests(found))
    if found.drifts:
        drift_rows = tuple(
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
        sections.append(
            Section(
                "drift",
                "Drift over runs",
                (
                    Table(
                        ("parameter", "now", "excursion", "limit", ""),
                        drift_rows,
                        ("left", "right", "right", "right", "left"),
                        caption,
                    ),
                ),
            )
        )
    if found.battery is not None:
        sections.append(
            Section(
                "battery", "Battery", (Paragraph(found.battery.sentence, "bad" if found.battery.alarm else "plain"),)
            )
        )
    if found.could_also_be:
        sections.append(Section("rivals", "What else could look like it", (Bullets(found.could_also_be),)))
    if found.fly:
        sections.append(_fly(found, scripts, minutes))
    if found.cannot_tell:
        sections.append(Section("unknown", "What could not be compared", (Bullets(found.cannot_tell),)))
    return Document("Is the model current?", found.sentence, TONES[found.verdict], tuple(sections), dict(facts))


def _tests(found: Currency) -> Section:
    rows = []
    for t in found.tests:
        for index, (name, (change, z)) in enumerate(t.shifts.items()):
            moved = t.alarm and abs(z) > 2
            rows.append(
                (
                    t.subset if index == 0 else "",
                    name,
                    Cell(percent(change), "bad" if moved else "plain"),
                    f"{z:+.1f}",
                    percent(t.detectable[name]) if name in t.detectable else "-",
                    f"{t.p_value:.2g}" if index == 0 else "",
                    Cell("changed" if t.alarm else "as before", "bad" if t.alarm else "good") if index == 0 else "",
                )
            )
    level = found.tests[0].level
    caption = (
        "shows from: a smaller change may have happened unseen. p: chance of such a difference without a change; "
        f"alarm below {level:.2g}, which an unchanged vehicle raises in {level * len(found.tests):.0%} of campaigns."
    )
    table = Table(
        ("subset", "parameter", "change", "z", "shows from", "p", ""),
        tuple(rows),
        ("left", "left", "right", "right", "right", "right", "left"),
        caption,
    )
    return Section("tests", "The new recording against the model", (table,))


def _fly(found: Currency, scripts: Mapping[str, str], minutes: Mapping[str, float]) -> Section:
    def words(names: Sequence[str]) -> str:
        known = [minutes[n] for n in names if n in minutes]
        tail = f" (about {duration(sum(known) * 60)} of flight)" if len(known) == len(names) and known else ""
        return f"{join(list(names))}{tail}"

    blocks: list[Block] = [
        Paragraph(f"The paper's rule, after any change of a component: fly all of it again: {words(found.fly)}.")
    ]
    if found.fly_narrow and set(found.fly_narrow) != set(found.fly):
        blocks.append(Paragraph(f"Enough, if nothing else was touched: {words(found.fly_narrow)}."))
    blocks.append(Code(f"flighttest run {' '.join(scripts.get(n, n) for n in found.fly)}"))
    for name, path in scripts.items():
        if name not in found.fly:
            blocks.append(Code(f"flighttest run {path}", f"{name}:"))
    return Section("fly", "What to fly", tuple(blocks))


@dataclass(frozen=True)
class HistoryPoint:
    """One run of the history. parameters: name to (value, half width of its 95 % interval); components in one line each."""

    run: str
    when: str
    vehicle: str
    script: str
    outcome: str
    parameters: Mapping[str, tuple[float, float]]
    components: Mapping[str, str]


def history_document(points: Sequence[HistoryPoint], units: Mapping[str, str]) -> Document:
    """Each parameter over runs, with the changes of components marked."""
    if not points:
        return Document(
            "Runs on this machine", "There are no runs here yet; `flighttest run thrust` makes one.", "warn"
        )
    marks = changes_between(points)
    # A run folder's name begins with its date and ends with its script: said once. Numbers are those under the pictures.
    dated = all(p.run[:4].isdigit() for p in points)
    heads = ("", "run", *(() if dated else ("when", "script")), "vehicle", "how it ended", "changed before it")
    rows = tuple(
        (
            f"{i}",
            p.run,
            *(() if dated else (p.when, p.script)),
            p.vehicle,
            p.outcome,
            Cell("; ".join(marks.get(p.run, ())), "warn"),
        )
        for i, p in enumerate(points, 1)
    )
    sections = [Section("runs", "Runs", (Table(heads, rows, ("right",)),))]
    names = list(dict.fromkeys(n for p in points for n in p.parameters))
    panels = tuple(
        _history_panel(
            name, [(i, p) for i, p in enumerate(points, 1) if name in p.parameters], units.get(name, ""), marks
        )
        for name in names
    )
    if panels:
        latest = next(p for p in reversed(points) if p.parameters)
        table = Table(
            ("parameter", "latest", "unit"),
            tuple(
                (n, f"{to_error(v, s)} +- {to_error(s, s)}", unit(units.get(n, "")))
                for n, (v, s) in latest.parameters.items()
            ),
            ("left", "right", "left"),
            f"from {latest.run}",
        )
        caption = "Each run's estimate with its 95 % interval; dashed: a component changed before this run."
        sections.append(Section("history", "Parameters over runs", (Figure("history", panels, caption, 3, 230), table)))
    fitted = sum(1 for p in points if p.parameters)
    verdict = f"{len(points)} run{'s' if len(points) != 1 else ''}, {fitted} with a fit."
    return Document("Runs on this machine", verdict, "plain", tuple(sections))


def changes_between(points: Sequence[HistoryPoint]) -> dict[str, tuple[str, ...]]:
    """Run to the components that differ from the run before it (of the same vehicle)."""
    found: dict[str, tuple[str, ...]] = {}
    last: dict[str, HistoryPoint] = {}
    for p in points:
        before = last.get(p.vehicle)
        if before is not None and before.components and p.components:
            names = [
                n for n in {**before.components, **p.components} if before.components.get(n) != p.components.get(n)
            ]
            if names:
                found[p.run] = tuple(
                    f"{n}: {before.components.get(n, 'none')} to {p.components.get(n, 'none')}" for n in names
                )
        last[p.vehicle] = p
    return found


def _history_panel(
    name: str, numbered: Sequence[tuple[int, HistoryPoint]], unit_text: str, marks: Mapping[str, Sequence[str]]
) -> Panel:
    x, points = [i for i, _ in numbered], [p for _, p in numbered]
    values = [p.parameters[name][0] for p in points]
    spread = [p.parameters[name][1] for p in points]
    traces = [Trace(x, values, name, "model", "errorbars", spread=spread, group="estimate, 95 %")]  # type: ignore[arg-type]
    low = min(v - s for v, s in zip(values, spread, strict=True))
    high = max(v + s for v, s in zip(values, spread, strict=True))
    for i, p in numbered:
        if p.run in marks:
            traces.append(
                Trace([i - 0.5, i - 0.5], [low, high], "; ".join(marks[p.run]), "limit", group="component changed")
            )
    label = f"{name}, {unit(unit_text)}" if unit(unit_text) else name
    return Panel(name, "run", label, tuple(traces))
