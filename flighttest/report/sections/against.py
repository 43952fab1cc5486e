"""Sections about a simulator against reality, from the data of against.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict, cast

import numpy as np

from flighttest.channels import WORDS
from flighttest.report.document import (
    OMITTED,
    Align,
    Bullets,
    Cell,
    Figure,
    PageBlock,
    Panel,
    Role,
    Section,
    Table,
    Tone,
    Trace,
)
from flighttest.report.numbers import join, join_some, number, percent, to_error, unit

_KINDS: dict[str, tuple[str, Tone]] = {
    "LACKS": ("lacking", "bad"),
    "TOO_MUCH": ("not in reality", "bad"),
    "OTHER_VALUE": ("another value", "bad"),
    "SAME": ("same", "good"),
    "UNTESTED": ("not tested", "quiet"),
}
_STEPS_SHOWN = 40
_LARGEST = 6  # differences that a terminal shows where no more are beyond chance
_BARS: tuple[Role, ...] = ("before", "after")
Z_95 = 1.96


class DifferenceRow(TypedDict):
    """One parameter on both sides (`diagnose.against.Difference`)."""

    name: str
    term: str
    unit: str
    kind: str
    real: float | None
    real_std: float | None
    simulated: float | None
    simulated_std: float | None
    difference: float | None
    std: float | None
    interval_95: list[float] | None
    p_value: float | None
    why: str
    detectable: float | None
    differs: bool


class PredictionRow(TypedDict):
    """RMS errors of one channel on the real responses (`diagnose.against.Prediction`)."""

    before: float
    after: float
    fitted: float
    floor: float


class StepRow(TypedDict):
    """One step that both sides flew (`diagnose.against.StepDifference`)."""

    kind: str
    cell: dict[str, float]
    channel: str
    unit: str
    repeats: list[int]
    rms: float
    scatter: float | None


class SideData(TypedDict):
    """What one side's diagnosis found."""

    verdict: str
    sentence: str
    accepted: list[str]


class AgainstData(TypedDict, total=False):
    """against.json (format against/1). titles: term to its title; corrected: parameters of the corrected simulator."""

    format: str
    terms: list[str]
    titles: dict[str, str]
    lacks: list[str]
    too_much: list[str]
    other_value: list[str]
    parameters: list[DifferenceRow]
    prediction: dict[str, PredictionRow]
    held_out: bool
    corrected: dict[str, float]
    notes: list[str]
    real: SideData
    simulated: SideData
    steps: list[StepRow]
    losses: list[str]


def sentence(data: AgainstData) -> str:
    """The answer in one sentence."""
    titles = data["titles"]
    parts = []
    if data["lacks"]:
        parts.append(f"lacks {join([titled(titles, t) for t in data['lacks']])}")
    if data["too_much"]:
        parts.append(f"has {join([titled(titles, t) for t in data['too_much']])}, which reality does not have")
    if data["other_value"]:
        parts.append(f"has {join_some(list(data['other_value']))} with another value")
    rows = data["parameters"]
    tested = sum(r["p_value"] is not None for r in rows)
    if not parts:
        floors = [p["before"] / p["floor"] for p in data["prediction"].values() if p["floor"]]
        worst = (
            f" Its prediction error is at most {number(max(floors), 3)} noise floors in every channel."
            if floors
            else ""
        )
        return f"No difference between simulator and reality is beyond its error ({tested} parameters compared).{worst}"
    return f"The simulator {'; it '.join(parts)}."


def titled(titles: Mapping[str, str], term: str) -> str:
    """A term in words, with its id."""
    title = titles.get(term, term)
    return f"{title[:1].lower()}{title[1:]} ({term})"


def against_sections(data: AgainstData) -> tuple[Section, ...]:
    """Parameters, prediction errors, steps, and what each side's diagnosis found."""
    return tuple(
        s
        for s in (
            _picture(data),
            _parameters(data),
            _prediction(data),
            steps_section(data.get("steps", ())),
            _sides(data),
        )
        if s is not None
    )


def _picture(data: AgainstData) -> Section | None:
    judged = {c: p for c, p in data["prediction"].items() if p["floor"]}
    errors = {
        "simulator": {c: p["before"] / p["floor"] for c, p in judged.items()},
        "corrected": {c: p["after"] / p["floor"] for c, p in judged.items()},
    }
    figure = comparison_figure(data["parameters"], errors, "real", "simulated")
    return None if figure is None else Section("picture", "", (figure,))


def comparison_figure(
    parameters: Sequence[DifferenceRow], errors: Mapping[str, Mapping[str, float]], first: str, second: str
) -> Figure | None:
    """By channel the errors in noise floors, and by parameter the difference in its standard errors, the largest first. errors: by what
    they are of, by channel."""
    panels = []
    channels = list(dict.fromkeys(c for by_channel in errors.values() for c in by_channel))
    if channels:
        heads = [WORDS.get(c, c) for c in channels]
        bars = [
            Trace(heads, [by_channel.get(c, np.nan) for c in channels], name, role, "bars")
            for (name, by_channel), role in zip(errors.items(), _BARS, strict=False)
        ]
        floor = Trace([heads[0], heads[-1]], [1.0, 1.0], "noise floor", "limit")
        panels.append(Panel("prediction error", "", "noise floors", (*bars, floor)))
    tested = sorted(
        ((r, r["difference"] / r["std"]) for r in parameters if r["difference"] is not None and r["std"]),
        key=lambda pair: -abs(pair[1]),
    )
    if tested:
        heads = [r["name"] for r, _ in tested]
        sides = (("differs", "model", True), ("no difference beyond chance", "other", False))
        found = [
            Trace(heads, [z if r["differs"] is differs else np.nan for r, z in tested], name, cast(Role, role), "bars")
            for name, role, differs in sides
            if any(r["differs"] is differs for r, _ in tested)
        ]
        limits = [
            Trace([heads[0], heads[-1]], [sign * Z_95] * 2, "95 % of chance, for one alone", "limit")
            for sign in (1, -1)
        ]
        panels.append(Panel(f"parameters, {first} minus {second}", "", "standard errors", (*found, *limits)))
    if not panels:
        return None
    caption = (
        "Left: RMS prediction error of each channel, in noise floors. Right: difference of each parameter in its standard errors; of "
        "twenty parameters that are the same, one is beyond the dashed lines by chance."
    )
    return Figure("comparison", tuple(panels), caption, 2, 340)


def _parameters(data: AgainstData) -> Section:
    blocks: list[PageBlock] = [difference_table(data["parameters"], "real", "simulated")]
    if data["notes"]:
        blocks.insert(0, Bullets(tuple(data["notes"])))
    return Section("parameters", "Parameters of both sides", tuple(blocks))


def difference_table(parameters: Sequence[DifferenceRow], first: str, second: str) -> Table:
    """Every parameter on both sides, under these heads; the largest differences come first."""
    rows: list[tuple[Cell | str, ...]] = []
    for r in parameters:
        word, tone = _KINDS[r["kind"]]
        share = r["difference"] / abs(r["simulated"]) if r["difference"] is not None and r["simulated"] else None
        interval = r["interval_95"]
        rows.append(
            (
                r["name"],
                to_error(r["real"], r["real_std"]),
                to_error(r["simulated"], r["simulated_std"]),
                unit(r["unit"]),
                "-" if interval is None else f"{number(interval[0], 3)} to {number(interval[1], 3)}",
                percent(share) if share is not None and abs(share) < 10 else "-",
                Cell(word + _to(r), tone, r["why"]),
            )
        )
    align: tuple[Align, ...] = ("left", "right", "right", "left", "right", "right", "left")
    caption = (
        f"Both sides fitted in one model; difference: {first} minus {second}, 95 % interval. It differs where it is beyond "
        "chance at 1 % over all parameters together; 'same to': the difference that would be detected with a probability of 80 %."
    )
    return Table(
        ("parameter", first, second, "unit", "difference", "change", "verdict"),
        tuple(rows),
        align,
        caption,
        detail=(5,),
        brief_rows=max(_LARGEST, sum(r["differs"] for r in parameters)),
    )


def _to(r: DifferenceRow) -> str:
    """Of a parameter that is the same: to which difference."""
    least, size = r.get("detectable"), abs(r["simulated"] or 0.0)
    if r["kind"] != "SAME" or not least:
        return ""
    return f" to {percent(least / size)}" if size > least / 10.0 else f" to {number(least, 2)}"


def _prediction(data: AgainstData) -> Section | None:
    rows: list[tuple[Cell | str, ...]] = []
    for channel, p in data["prediction"].items():
        ratio = [v / p["floor"] if p["floor"] else None for v in (p["before"], p["after"], p["fitted"])]
        tones: list[Tone] = ["good" if r is not None and r <= 1.2 else "plain" for r in ratio]
        rows.append(
            (
                WORDS.get(channel, channel),
                number(p["floor"], 2),
                *(Cell(number(r, 3), t) for r, t in zip(ratio, tones, strict=True)),
            )
        )
    if not rows:
        return None
    seen = "of steps it was not corrected with" if data["held_out"] else "of the steps it was corrected with"
    caption = (
        f"RMS error on the real responses in noise floors: the simulator as it is; corrected in what differs, {seen}; and the same "
        "model fitted to these responses, the least that this correction can reach. Each response starts as measured, with a constant "
        "disturbance of its own."
    )
    columns = ("channel", "noise floor", "simulator", "corrected", "fitted")
    return Section(
        "prediction",
        "Prediction error of the simulator, before and after",
        (Table(columns, tuple(rows), ("left", "right", "right", "right", "right"), caption),),
    )


def steps_section(steps: Sequence[StepRow]) -> Section | None:
    """The steps that both sides flew, side by side."""
    rows: list[tuple[Cell | str, ...]] = []
    for s in steps[:_STEPS_SHOWN]:
        cell = ", ".join(f"{k.rsplit('_rad', 1)[0]} {number(v, 3)}" for k, v in s["cell"].items())
        ratio = s["rms"] / s["scatter"] if s["scatter"] else None
        repeats = f"{s['repeats'][0]}, {s['repeats'][1]}"
        rows.append(
            (f"{s['kind'].replace('_', ' ')}: {cell}", repeats, number(s["rms"], 2), unit(s["unit"]), number(ratio, 2))
        )
    if not rows:
        return None
    caption = (
        "Mean response of each step that both sides flew: RMS of the difference, and its ratio to the scatter of the repeats. No model "
        "is used, and differences of voltage between repeats are not corrected."
    )
    columns = ("step", "repeats", "difference", "unit", "over scatter")
    table = Table(columns, tuple(rows), ("left", "right", "right", "left", "right"), caption, True, (), OMITTED)
    return Section("steps", f"Step by step ({len(steps)} steps flown on both sides)", (table,))


def _sides(data: AgainstData) -> Section:
    lines = (f"real: {data['real']['sentence']}", f"simulated: {data['simulated']['sentence']}")
    return Section("sides", "Each side by itself", (Bullets(lines),), "What the base model lacks in each.")
