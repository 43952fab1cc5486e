"""What a plan asks of zone and battery, as a document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flighttest.frames import compass_from_yaw
from flighttest.plan import CheckResult, EnvelopeRow
from flighttest.report.document import OMITTED, Align, Bullets, Cell, Document, PageBlock, Paragraph, Section, Table
from flighttest.report.numbers import duration, join, number

MAX_REFUSALS = 8


def check_document(results: Sequence[CheckResult], facts: Mapping[str, str], *, verbose: bool = False) -> Document:
    """All scripts on one page; the verdict: whether everything may be flown."""
    refused = sum(len(r.refusals) for r in results)
    legs = sum(r.legs for r in results)
    names = join([r.name for r in results])
    total_s = sum(r.duration_s for r in results)
    if refused:
        steps = "1 step is" if refused == 1 else f"{refused} steps are"
        verdict = f"{steps} refused; {legs} can be flown as written in {names}."
    else:
        verdict = f"{names}: all {legs} steps stay in the zone; about {duration(total_s)} from take-off to landing."
    sections = tuple(_section(r, verbose) for r in results)
    return Document("check", verdict, "bad" if refused else "good", sections, dict(facts))


def _section(result: CheckResult, verbose: bool) -> Section:
    steps = f"{result.legs} step{'s' if result.legs != 1 else ''}, {duration(result.duration_s)}"
    lead = f"{'; '.join(filter(None, [result.doc, steps]))}. Battery: {result.battery.sentence}."
    blocks: list[PageBlock] = []
    if result.refusals:
        blocks.append(Bullets(_refusals(result)))
    blocks += [Paragraph(note, "warn") for note in result.notes]
    blocks.append(_envelope(result.envelope))
    if result.expected_std:
        words = "; ".join(f"{name} ± {number(std, 2)}" for name, std in result.expected_std.items())
        blocks.append(Bullets((f"Expected standard errors from this script: {words}.",), OMITTED))
    if verbose:
        blocks.append(_timeline(result))
    return Section(result.name, result.name, tuple(blocks), lead)


def _refusals(result: CheckResult) -> tuple[str, ...]:
    """One line per reason: the repeats of a step are refused for the same one."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for leg, what, remedy in result.refusals:
        reasons.setdefault((what, remedy), []).append(leg)
    lines = []
    for (what, remedy), legs in list(reasons.items())[:MAX_REFUSALS]:
        more = f" and {len(legs) - 1} more" if len(legs) > 1 else ""
        lines.append(f"refused: {legs[0]}{more}: {what}" + (f"; {remedy}" if remedy else ""))
    if len(reasons) > MAX_REFUSALS:
        lines.append(f"... and {len(reasons) - MAX_REFUSALS} more reasons (see --json)")
    return tuple(lines)


def _envelope(rows: Sequence[EnvelopeRow]) -> Table:
    columns = (
        "step",
        "times",
        "hold s",
        "record s",
        "useful s",
        "start m",
        "height m",
        "out m",
        "lost: up m",
        "out m",
        "then",
    )
    numbers: tuple[Align, ...] = ("right",) * 9
    caption = (
        "useful: what is left of the record after the delay; height: lowest and highest in the zone; out: furthest from "
        "the start along the ground; lost: with the link lost at the worst moment."
    )
    return Table(
        columns, tuple(_row(row) for row in rows), ("left", *numbers, "left"), caption, fold=True, detail=(5, 10)
    )


def _row(row: EnvelopeRow) -> tuple[Cell | str, ...]:
    pieces, first = row.cell.held_s, row.cell.recorded_from
    before = [length for name, length in pieces[:first] if name != "entry"]
    record = sum(length for _, length in pieces[first:])
    return (
        row.cell.label,
        str(row.cell.legs),
        "+".join(f"{length:.2f}" for length in before) or "-",
        f"{record:.2f}" if record else "-",
        Cell(f"{row.useful_s:.2f}", "warn" if row.cell.shortened else "plain"),
        f"{row.cell.start_m[2]:.1f}",
        f"{row.height_m[0]:.1f}-{row.height_m[1]:.1f}",
        f"{row.far_m:.1f}",
        f"{row.lost_height_m[1]:.1f}",
        f"{row.lost_far_m:.1f}",
        ", ".join(f"{name} {length:.2f} s" for name, length, _ in row.cell.stops),
    )


def _timeline(result: CheckResult) -> Table:
    rows = tuple(
        (
            duration(r.start_s),
            r.leg + (f" ({r.direction})" if r.direction else ""),
            ", ".join(f"{name} {length:.2f}" for name, length in r.phases),
            f"{compass_from_yaw(r.heading_rad):.0f}",
            "-" if r.voltage_v is None else f"{r.voltage_v:.1f}",
        )
        for r in result.timeline
    )
    align: tuple[Align, ...] = ("right", "left", "left", "right", "right")
    return Table(("at", "leg", "phases, s", "heading deg", "battery V"), rows, align)
