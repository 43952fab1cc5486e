"""Sections about a diagnosis: the five verbs of the design, from the data of diagnosis.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flighttest.report.document import (
    Align,
    Block,
    Bullets,
    Cell,
    Code,
    Figure,
    Panel,
    Paragraph,
    Section,
    Table,
    Tone,
    Trace,
)
from flighttest.report.numbers import number, percent, to_error, unit
from flighttest.report.views import Overlay

VERDICT_TONES: dict[str, Tone] = {
    "EXPLAINED": "good",
    "NOTHING_MISSING": "good",
    "PARTLY": "warn",
    "UNKNOWN_PHYSICS": "warn",
}
TERM_TONES: dict[str, Tone] = {"SUPPORTED": "good", "CONFUSABLE": "warn", "NOT_NEEDED": "quiet", "UNTESTABLE": "quiet"}
TERM_WORDS = {
    "SUPPORTED": "supported",
    "CONFUSABLE": "cannot be told from a rival",
    "NOT_NEEDED": "not needed",
    "UNTESTABLE": "could not be seen",
}


def diagnosis_sections(
    data: Mapping[str, Any],
    terms: Mapping[str, Mapping[str, Any]],
    overlays: Sequence[Overlay] = (),
    next_script: str = "",
) -> tuple[Section, ...]:
    """data: diagnosis/1; terms: id to the catalogue's entry (see `pipeline.about.term_data`); overlays: worst responses before, after."""
    found = [_located(data.get("located") or ())]
    findings = data.get("findings") or ()
    found.append(_findings(findings, terms))
    shown = _improvement(findings, overlays)
    if shown is not None:
        found.append(shown)
    found.append(_ruled_out(data, terms))
    follow = _next(data, next_script)
    if follow is not None:
        found.append(follow)
    return tuple(found)


def _located(located: Sequence[Mapping[str, Any]]) -> Section:
    if not located:
        return Section("located", "Where they differ", (Paragraph("Nowhere above the noise floor."),))
    blocks: list[Block] = [Bullets(tuple(str(item["sentence"]) for item in located if item.get("sentence")))]
    heat = _heat(located)
    if heat is not None:
        blocks.append(heat)
    return Section("located", "Where they differ", tuple(blocks))


def _heat(located: Sequence[Mapping[str, Any]]) -> Figure | None:
    shares = {(str(i.get("channel", "")), str(i.get("maneuver", ""))): i.get("excess_share") for i in located}
    channels = sorted({c for c, _ in shares})
    maneuvers = sorted({m for _, m in shares})
    values = [[float(shares.get((c, m)) or float("nan")) for m in maneuvers] for c in channels]
    if not any(v == v for row in values for v in row):
        return None
    trace = Trace(maneuvers, channels, "share of the excess error", "other", "heat", z=values)
    caption = "Share of the error above the noise floor, by channel and maneuver."
    return Figure("located", (Panel("", "maneuver", "", (trace,)),), caption, 1, 120 + 40 * len(channels))


def _findings(findings: Sequence[Mapping[str, Any]], terms: Mapping[str, Mapping[str, Any]]) -> Section:
    if not findings:
        return Section(
            "findings",
            "What was left out",
            (Paragraph("No physics of the catalogue is needed to explain these recordings."),),
        )
    blocks: list[Block] = []
    for item in findings:
        term_id = str(item["term"])
        entry = terms.get(term_id, {})
        verdict = str(item.get("verdict", ""))
        head = f"{term_id}: {TERM_WORDS.get(verdict, verdict.lower())}."
        blocks.append(Paragraph(f"{head} {str(entry.get('plain', '')).capitalize()}", TERM_TONES.get(verdict, "plain")))
        if entry.get("equation"):
            blocks.append(Code(str(entry["equation"])))
        if item.get("parameters"):
            blocks.append(_parameters(item["parameters"], entry))
        lines = [_rival(r) for r in item.get("rivals") or ()]
        if lines:
            blocks.append(Bullets(tuple(lines)))
    return Section("findings", "What was left out", tuple(blocks))


def _parameters(parameters: Mapping[str, Mapping[str, Any]], entry: Mapping[str, Any]) -> Table:
    known = {p["name"]: p for p in entry.get("parameters", ())}
    rows = []
    for name, value in parameters.items():
        about = known.get(name, {})
        units = unit(str(value.get("unit") or about.get("unit", "")))
        rows.append(
            (
                name,
                to_error(value.get("value"), value.get("std")),
                to_error(value.get("std"), value.get("std")),
                units,
                str(about.get("doc", "")),
            )
        )
    align: tuple[Align, ...] = ("left", "right", "right", "left", "left")
    return Table(("parameter", "value", "std", "unit", "what it is"), tuple(rows), align)


def _rival(rival: Mapping[str, Any]) -> str:
    text = f"rival: {rival.get('term', '?')}"
    if rival.get("verdict"):
        text += f", {TERM_WORDS.get(str(rival['verdict']), str(rival['verdict']).lower())}"
    if rival.get("separated_by"):
        text += f"; separated by {rival['separated_by']}"
    return text


def _improvement(findings: Sequence[Mapping[str, Any]], overlays: Sequence[Overlay]) -> Section | None:
    rows: list[tuple[Cell | str, ...]] = []
    for item in findings:
        for channel, h in (item.get("heldout") or {}).items():
            low, high = (h.get("gain_95") or (None, None))[:2]
            gain = "-" if low is None or high is None else f"{percent(low, 2)} to {percent(high, 2)}"
            rows.append(
                (
                    str(item["term"]),
                    str(channel),
                    number(h.get("rmse_before"), 3),
                    Cell(number(h.get("rmse_after"), 3), "good"),
                    number(h.get("floor"), 3),
                    gain,
                )
            )
    if not rows and not overlays:
        return None
    blocks: list[Block] = []
    if rows:
        align: tuple[Align, ...] = ("left", "left", "right", "right", "right", "right")
        caption = "RMSE on responses the choice was not made on; gain: how much of it went away, 95 %."
        blocks.append(Table(("with", "channel", "before", "after", "noise floor", "gain"), tuple(rows), align, caption))
    worst = [_overlay(o) for o in overlays if o.before is not None][:6]
    if worst:
        blocks.append(
            Figure(
                "before-after",
                tuple(worst),
                "The responses that were worst before: measured, model before and after.",
                2,
                280,
            )
        )
    return Section("improvement", "Does it fit better?", tuple(blocks))


def _overlay(o: Overlay) -> Panel:
    assert o.before is not None
    traces = (
        Trace(o.t_s, o.measured, "measured", "measured"),
        Trace(o.t_s, o.before, "before", "before"),
        Trace(o.t_s, o.simulated, "after", "after"),
    )
    return Panel(o.segment, "time since the step, s", o.channel, traces)


def _ruled_out(data: Mapping[str, Any], terms: Mapping[str, Mapping[str, Any]]) -> Section:
    blocks: list[Block] = []
    not_needed = [str(t) for t in data.get("not_needed") or ()]
    if not_needed:
        blocks.append(Paragraph(f"Looked for and not needed: {', '.join(not_needed)}."))
    rows = tuple(
        (str(u.get("term", "")), str(u.get("why", "")), str(u.get("fly") or "-")) for u in data.get("untestable") or ()
    )
    if rows:
        caption = "This data could not have shown them: not seen is not the same as absent."
        blocks.append(Table(("could not be seen", "why", "fly"), rows, caption=caption))
    smallest = data.get("smallest_detectable") or {}
    if smallest:
        lines = tuple((str(k), _smallest(k, v, terms)) for k, v in smallest.items())
        blocks.append(Table(("effect", "smallest that would have been noticed"), lines, fold=len(lines) > 8))
    left = (data.get("unexplained") or {}).get("excess_share")
    if left is not None:
        blocks.append(Paragraph(f"Left unexplained: {percent(float(left), 2)} of the error above the noise floor."))
    return Section("limits", "What was ruled out, and what cannot be told", tuple(blocks))


def _smallest(term: str, value: Any, terms: Mapping[str, Mapping[str, Any]]) -> str:
    if isinstance(value, int | float):
        return number(float(value), 2)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {number(v, 2) if isinstance(v, int | float) else v}" for k, v in value.items())
    return str(value)


def _next(data: Mapping[str, Any], script: str) -> Section | None:
    name = data.get("next_flight")
    if not name:
        return None
    said = name.get("sentence") or name.get("script") if isinstance(name, Mapping) else None
    text = str(said or f"flighttest run {name}")
    blocks: list[Block] = [Code(text)]
    if script:
        blocks.append(Code(script, "the script"))
    return Section("next", "Fly this next", tuple(blocks))
