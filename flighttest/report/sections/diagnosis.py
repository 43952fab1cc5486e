"""Sections about a diagnosis: where the mismatch is, what is missing, its evidence, the next flight; from the data of diagnosis.json."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

from flighttest.diagnose.model import channel_words
from flighttest.diagnose.records import ABOVE_FLOOR, FROM_REPEATS, DiagnosisData, HeldOutRow, ParameterRow, RivalRow
from flighttest.identify.models.model_blocks import FlightWindRow
from flighttest.report.document import OMITTED, Align, Bullets, Cell, Code, PageBlock, Paragraph, Section, Table, Tone
from flighttest.report.numbers import interval, number, percent, to_error, unit
from flighttest.report.sections.diagnosis_figures import before_after, heat_map, regimes

BASELINE_WORDS = {"with what was left out": "improved model"}  # a key of diagnosis.json
DIGITS = 0.1  # of an error: two digits of this are the last of three that it is printed with
NORMAL_95 = 1.96  # standard errors: of winds in files that do not state their factor, and of drops
FEW_PLACES = 2  # where a mismatch is, which a terminal names without being asked
_VERDICT_TONES: dict[str, Tone] = {
    "EXPLAINED": "good",
    "NOTHING_MISSING": "good",
    "PARTLY": "warn",
    "UNKNOWN_PHYSICS": "warn",
}
TERM_TONES: dict[str, Tone] = {"SUPPORTED": "good", "CONFUSABLE": "warn", "NOT_NEEDED": "quiet", "UNTESTABLE": "quiet"}
TERM_WORDS = {
    "SUPPORTED": "supported",
    "CONFUSABLE": "cannot be distinguished from a rival",
    "NOT_NEEDED": "not needed",
    "UNTESTABLE": "could not be seen",
}


def verdict_tone(data: DiagnosisData, otherwise: Tone = "plain") -> Tone:
    """The tone of a diagnosis' verdict: what was interrupted is none to rely on."""
    return "warn" if data.get("complete") is False else _VERDICT_TONES.get(str(data.get("verdict")), otherwise)


def diagnosis_sections(data: DiagnosisData, next_script: str = "") -> tuple[Section, ...]:
    """data: diagnosis/1 with whatever it holds of the optional parts; next_script: the text of next.yaml."""
    found = [
        _located(data),
        _findings(data),
        winds_table(data.get("winds", ())),
        _improvement(data),
        _limits(data),
        _next(data, next_script),
    ]
    return tuple(s for s in found if s is not None)


def missing_sections(data: DiagnosisData) -> tuple[Section, ...]:
    """For one screen: what the model lacks, with values and intervals, and the prediction error without and with it."""
    findings = data.get("findings") or ()
    if not findings:
        return ()
    rows: list[tuple[Cell | str, ...]] = []
    for item in findings:
        verdict = str(item.get("verdict", ""))
        name: Cell | str = Cell(str(item["term"]), TERM_TONES.get(verdict, "plain"))
        for row in _parameters(item.get("parameters") or {}).rows or (("-", "-", "", "-"),):
            rows.append((name, *row))
            name = ""
    align: tuple[Align, ...] = ("left", "left", "right", "left", "right")
    blocks: list[PageBlock] = [Table(("term", "parameter", "value", "unit", "95 % interval"), tuple(rows), align)]
    held = _heldout_rows(data)
    if held:
        caption = "RMSE on responses that were not used for the choice, before and after adding what is missing."
        heads = ("channel", "before", "after", "noise floor", "drop")
        blocks.append(Table(heads, tuple(held), ("left", "right", "right", "right", "right"), caption))
    return (Section("missing", "What the model lacked", tuple(blocks)),)


def _located(data: DiagnosisData) -> Section:
    located = data.get("located") or ()
    blocks: list[PageBlock] = [figure for figure in (heat_map(data), regimes(data)) if figure is not None]
    if not located:
        blocks.append(Paragraph("Nowhere above the noise floor."))
    else:
        sentences = tuple(_sentence(str(i["sentence"])) for i in located if i.get("sentence"))
        more = len(sentences) - FEW_PLACES
        places = f"{more} more place{'s' if more > 1 else ''}: --all lists them."
        blocks.append(Bullets(sentences, " ".join((*sentences[:FEW_PLACES], places)) if more > 0 else ""))
    aside = data.get("set_aside") or {}
    if aside.get("sentence"):
        blocks.append(Paragraph(_sentence(str(aside["sentence"])), "warn"))
    weaker = sorted(
        {str(f.get("from")) for f in (data.get("noise_floor") or {}).values() if f.get("from") != FROM_REPEATS}
    )
    if weaker:
        blocks.append(Paragraph(f"Noise floor from: {', '.join(weaker)}.", "quiet"))
    return Section("located", "Where simulation and recording differ", tuple(blocks))


def _sentence(text: str) -> str:
    text = _squares(text)
    first = text.partition(" ")[0]
    named = "_" in first or first.endswith(":")  # a channel, a parameter or a term, which is written as it is
    return (text if named else text[:1].upper() + text[1:]) + ("" if text.endswith(".") else ".")


def _squares(text: str) -> str:
    return re.sub(r"\b(s|m|rad)\^2", r"\1²", text)


def _findings(data: DiagnosisData) -> Section:
    findings = data.get("findings") or ()
    blocks: list[PageBlock] = []
    for item in findings:
        verdict = str(item.get("verdict", ""))
        head = f"{item.get('title') or item['term']} ({item['term']}): {TERM_WORDS.get(verdict, verdict.lower())}."
        blocks.append(Paragraph(head, TERM_TONES.get(verdict, "plain")))
        sentence = item.get("sentence") or item.get("plain")
        if sentence:
            blocks.append(Paragraph(_sentence(str(sentence))))
        if item.get("equation"):
            blocks.append(Code(str(item["equation"]), brief=OMITTED))
        if item.get("parameters"):
            table = _parameters(item["parameters"])
            blocks.append(
                replace(table, brief=OMITTED) if sentence else table
            )  # the sentence has the values and their errors
        lines = [_rival(r) for r in item.get("rivals") or ()]
        if item.get("doubt"):
            lines.append(f"doubt: {item['doubt']}")
        if lines:
            blocks.append(Bullets(tuple(lines), brief=OMITTED if verdict == "SUPPORTED" else ""))
    for shape in data.get("unknown") or ():
        blocks.append(Paragraph(_sentence(str(shape.get("sentence") or "something without a name")), "warn"))
        if shape.get("formula"):
            blocks.append(Code(str(shape["formula"]), "a description of the residual, not a physical law"))
    if data.get("mass"):
        blocks.append(Paragraph(_sentence(str(data["mass"].get("sentence", ""))), "warn"))
    if not blocks:
        searched = "of what was searched before the interruption " if data.get("complete") is False else ""
        explains = (
            "explains this mismatch"
            if data.get("verdict") == "UNKNOWN_PHYSICS"
            else "is needed to explain these recordings"
        )
        blocks.append(Paragraph(f"No physics of the catalogue {searched}{explains}."))
    return Section("findings", "What physics is missing", tuple(blocks))


def winds_table(winds: Sequence[FlightWindRow]) -> Section | None:
    """The wind of each flight, where free flight shows one."""
    rows = []
    for w in winds:
        seen, factor = w["verdict"] == "wind", w.get("factor_95", NORMAL_95)
        rows.append(
            (
                w["flight"],
                f"{w['w_north']:.2f} ± {factor * w['w_north_std']:.2f}",
                f"{w['w_west']:.2f} ± {factor * w['w_west_std']:.2f}",
                f"{w['speed_m_s']:.1f} ± {factor * w['speed_std']:.1f}",
                f"{w['from_deg']:.0f}°" if seen else "",
                Cell(w["verdict"], "good" if seen else "quiet"),
            )
        )
    if not rows:
        return None
    columns = ("flight", "to north, m/s", "to west, m/s", "speed, m/s", "from", "")
    windy = sum(w["verdict"] == "wind" for w in winds)
    lead = f"Wind is seen in {windy} of {len(rows)} flight{'s' if len(rows) > 1 else ''}."
    table = Table(columns, tuple(rows), ("left", "right", "right", "right", "right", "left"))
    return Section("winds", "Wind of each flight", (table,), lead)


def _parameters(parameters: Mapping[str, ParameterRow]) -> Table:
    rows = []
    for name, value in parameters.items():
        low, high = (value.get("interval_95") or (None, None))[:2]
        std = value.get("std")
        span = f"{to_error(low, std)} to {to_error(high, std)}" if low is not None and high is not None else "-"
        rows.append((name, to_error(value.get("value"), std), unit(str(value.get("unit", ""))), span))
    align: tuple[Align, ...] = ("left", "right", "left", "right")
    return Table(("parameter", "value", "unit", "95 % interval"), tuple(rows), align)


def _rival(rival: RivalRow) -> str:
    text = f"rival: {rival.get('term', '?')}"
    if rival.get("verdict"):
        text += f", {TERM_WORDS.get(str(rival['verdict']), str(rival['verdict']).lower())}"
    if rival.get("separated_by"):
        text += f"; separated by {rival['separated_by']}"
    return text


def _improvement(data: DiagnosisData) -> Section | None:
    blocks: list[PageBlock] = []
    rows = _heldout_rows(data)
    if rows:
        align: tuple[Align, ...] = ("left", "right", "right", "right", "right")
        caption = "RMSE on responses that were not used for the choice; drop: before minus after, 95 % interval."
        blocks.append(Table(("channel", "before", "after", "noise floor", "drop"), tuple(rows), align, caption))
    figure = before_after(data)
    if figure is not None:
        blocks.append(figure)
    moved = _moved(data)
    if moved is not None:
        blocks.append(replace(moved, brief=OMITTED))
    baselines = _baselines(data)
    if baselines is not None:
        blocks.append(replace(baselines, brief=OMITTED))
    if not blocks or not (data.get("findings") or ()):
        return None
    return Section("improvement", "Does it fit better?", tuple(blocks))


def _heldout_rows(data: DiagnosisData) -> list[tuple[Cell | str, ...]]:
    held = {name: h.get("all") or cast(HeldOutRow, h) for name, h in data.get("heldout", {}).items()}
    if not held:
        held = {name: h for item in data.get("findings") or () for name, h in item.get("heldout", {}).items()}
    rows: list[tuple[Cell | str, ...]] = []
    for channel, h in held.items():
        low, high = (h.get("gain_95") or (None, None))[:2]
        drop, better = "-", False
        if low is not None and high is not None:
            before = h.get("rmse_before") or 0.0
            drop = interval(low, high, max((high - low) / (2.0 * NORMAL_95), DIGITS * before))
            better = low > 0.05 * DIGITS * before  # which is seen in the last digit
        after = Cell(number(h.get("rmse_after"), 3), "good" if better else "plain")
        rows.append((channel_words(channel), number(h.get("rmse_before"), 3), after, number(h.get("floor"), 3), drop))
    return rows


def _moved(data: DiagnosisData) -> Table | None:
    """Base parameters before and after: they move when they no longer absorb what was missing."""
    before, after = data.get("before") or {}, data.get("after") or {}
    rows = []
    for name, a in after.items():
        b = before.get(name)
        old = "-" if b is None else to_error(b.get("value"), b.get("std"))
        rows.append((name, old, to_error(a.get("value"), a.get("std")), unit(str(a.get("unit", "")))))
    if not rows:
        return None
    caption = "Parameters of the base model, and of the improved model."
    return Table(
        ("parameter", "before", "after", "unit"), tuple(rows), ("left", "right", "right", "left"), caption, fold=True
    )


def _baselines(data: DiagnosisData) -> Table | None:
    table = data.get("baselines") or {}
    names = list(dict.fromkeys(n for entry in table.values() for n in entry))
    if not names:
        return None
    rows = tuple(
        (channel_words(channel), *(number(entry.get(n), 3) for n in names)) for channel, entry in table.items()
    )
    numbers: list[Align] = ["right" for _ in names]
    heads = ("channel", *(BASELINE_WORDS.get(n, n) for n in names))
    return Table(heads, rows, ("left", *numbers), "RMSE of simpler predictions beside it.", fold=True)


def _limits(data: DiagnosisData) -> Section:
    blocks: list[PageBlock] = []
    candidates = [c for c in data.get("candidates") or () if c.get("verdict") == "NOT_NEEDED"]
    not_needed = [str(t) for t in data.get("not_needed") or ()]
    if not_needed:
        effects = "1 effect" if len(not_needed) == 1 else f"{len(not_needed)} effects"
        brief = f"Looked for and not needed: {effects} of the catalogue."
        blocks.append(Bullets((f"Looked for and not needed: {', '.join(not_needed)}.",), brief))
    if candidates:
        rows = tuple(
            (str(c["term"]), number(c.get("delta_bic"), 3), number(c.get("probability"), 2), str(c.get("why", "")))
            for c in candidates
        )
        align: tuple[Align, ...] = ("left", "right", "right", "left")
        caption = "Candidates that were tried and not taken."
        blocks.append(
            Table(
                ("candidate", "-2 log evidence", "probability by evidence", "why not"),
                rows,
                align,
                caption,
                fold=True,
                brief=OMITTED,
            )
        )
    unseen = tuple(
        (str(u.get("term", "")), _squares(str(u.get("why", ""))), str(u.get("fly") or "-"))
        for u in data.get("untestable") or ()
    )
    if unseen:
        caption = "These flights could not have shown them; that does not mean that they are absent."
        brief = f"Could not be seen in these flights (they may be present): {', '.join(u[0] for u in unseen)}."
        blocks.append(Table(("could not be seen", "why", "fly"), unseen, caption=caption, brief=brief))
    smallest = data.get("smallest_detectable") or {}
    if smallest:
        units = data.get("smallest_units", {})
        lines = tuple(
            (str(k), number(v, 2) if isinstance(v, int | float) else str(v), unit(str(units.get(k, ""))))
            for k, v in smallest.items()
        )
        caption = "The smallest effect that would have been detected."
        blocks.append(
            Table(("effect", "smallest", ""), lines, ("left", "right", "left"), caption, fold=True, brief=OMITTED)
        )
    left = data.get("unexplained")
    if left:
        blocks.append(Paragraph(f"Unexplained: {percent(left['excess_share'])} of the {left.get('of', ABOVE_FLOOR)}."))
    notes = tuple(_sentence(str(n)) for n in data.get("notes") or ())
    if notes:
        blocks.append(Bullets(notes))
    return Section("limits", "What was ruled out, and what cannot be determined", tuple(blocks))


def _next(data: DiagnosisData, script: str) -> Section | None:
    name = data.get("next_flight")
    if not name:
        return None
    named = name.get("sentence") or name.get("script") if isinstance(name, Mapping) else None
    reason = data.get("next_reason") or {}
    path = shlex.quote(str(data.get("next_path") or name))
    command = str(named or f"flighttest run {path}{data.get('next_options', '')}")
    # A command that cannot be flown is not shown as one.
    blocks: list[PageBlock] = [] if reason.get("fits_zone") is False else [Code(command)]
    if reason.get("sentence"):
        blocks.append(Paragraph(str(reason["sentence"])))
    if reason.get("zone"):
        blocks.append(Paragraph(str(reason["zone"]), "plain" if reason.get("fits_zone") else "warn"))
    if script:
        blocks.append(Code(script, "the script", "--all shows the script."))
    return Section("next", "Fly this next", tuple(blocks))
