"""The page of `flighttest demo`: what was found and how much better an unused flight is predicted, first; what was concealed, last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike

from flighttest.channels import CHANNELS, WORDS
from flighttest.diagnose.records import FindingRow
from flighttest.report.document import (
    Cell,
    Code,
    Document,
    Figure,
    PageBlock,
    Panel,
    Paragraph,
    Section,
    Table,
    Tone,
    Trace,
)
from flighttest.report.numbers import join, number, to_error, unit
from flighttest.report.sections.diagnosis import TERM_WORDS
from flighttest.report.sections.twin import TwinData, verify_sentence


class ErrorRow(TypedDict):
    """RMS errors of one channel on the flight that was not used, in its unit."""

    before: float
    after: float
    floor: float


class ShownStretch(TypedDict):
    """The stretch where the improvement shows most, over time since its start: measured, and both predictions (n,)."""

    segment: str
    channel: str
    t_s: ArrayLike
    measured: ArrayLike
    before: ArrayLike
    after: ArrayLike


class DemoData(TypedDict):
    """What the page of a demonstration shows (format demo/1)."""

    format: str
    hidden: dict[str, dict[str, float]]
    findings: list[FindingRow]
    as_hidden: bool
    prediction: dict[str, ErrorRow]
    shown: ShownStretch | None
    twin: TwinData
    twin_report: str
    unused: str
    runs: list[str]
    report: str


def demo_document(data: DemoData, commands: Sequence[tuple[str, str]], report: str) -> Document:
    """data: demo/1. commands: what each is for, and the command; they are the last lines, on the page and on a terminal."""
    found = bool(data["findings"])
    tone: Tone = "good" if found and data["as_hidden"] else "warn"
    sections = [_picture(data), _prediction(data), _twin(data), _truth(data), _go_on(commands, report)]
    return Document("demo", demo_sentences(data), tone, tuple(s for s in sections if s is not None))


def demo_sentences(data: DemoData) -> str:
    """What was found; what that is worth on a flight that was not used."""
    if not data["findings"]:
        return (
            "A simulated vehicle flew with physics that the base model does not have, and the diagnosis found nothing missing above the "
            "noise of its recordings. The effect is too small for these flights, or shows in others: `flighttest terms` names them."
        )
    first = (
        "A simulated vehicle flew with physics that the base model does not have; from its recordings alone the diagnosis named what was "
        f"missing: {join([_named(f) for f in data['findings']])}."
    )
    gains = {c: v["before"] / v["after"] for c, v in data["prediction"].items() if v["after"] > 0}
    if not gains:
        return first
    best = max(gains, key=lambda c: gains[c])
    v = data["prediction"][best]
    return (
        f"{first} On a flight that was not used, the improved model predicts the {WORDS.get(best, best)} to {_size(best, v['after'])} "
        f"(RMS), the base model to {_size(best, v['before'])}."
    )


def _named(finding: FindingRow) -> str:
    values = [
        f"{name} {to_error(p.get('value'), p.get('std'))} {unit(str(p.get('unit', '')))}".strip()
        for name, p in finding["parameters"].items()
    ]
    return f"{str(finding['title']).lower()} ({', '.join(values)})"


def _size(channel: str, value: float) -> str:
    return f"{number(value, 2)} {unit(CHANNELS[channel].unit)}"


def figure_of(data: DemoData) -> Figure | None:
    """The stretch of the unused flight where the improvement shows most: the responses, and both prediction errors."""
    s = data["shown"]
    if s is None:
        return None
    t = np.asarray(s["t_s"], dtype=float)
    measured, before, after = (np.asarray(y, dtype=float) for y in (s["measured"], s["before"], s["after"]))
    name, size = WORDS.get(s["channel"], s["channel"]), unit(CHANNELS[s["channel"]].unit)
    responses = (
        Trace(t, measured, "measured", "measured"),
        Trace(t, before, "base model", "before"),
        Trace(t, after, "improved model", "after"),
    )
    errors = (
        Trace(t, before - measured, "base model", "before"),
        Trace(t, after - measured, "improved model", "after"),
    )
    panels = (
        Panel("the same commands, from the same start", "time, s", f"{name}, {size}", responses),
        Panel("prediction minus measurement", "time, s", f"error of {name}, {size}", errors),
    )
    caption = f"{s['segment']}, a flight that neither model was fitted to: measured, and both models on the recorded commands."
    return Figure("response", panels, caption, 2, 320)


def _picture(data: DemoData) -> Section | None:
    figure = figure_of(data)
    return None if figure is None else Section("picture", "", (figure,))


def _prediction(data: DemoData) -> Section:
    rows = tuple(
        (
            WORDS.get(c, c),
            unit(CHANNELS[c].unit),
            number(v["before"], 3),
            Cell(number(v["after"], 3), "good" if v["after"] < 0.9 * v["before"] else "plain"),
            number(v["floor"], 3),
        )
        for c, v in data["prediction"].items()
    )
    columns = ("channel", "unit", "base model", "improved model", "noise floor")
    caption = (
        f"RMS error on {data['unused']}, which no fit and no diagnosis before this used, each response from its own measured start with a "
        "constant disturbance of its own. Noise floor: what the repeats of one step differ by in the flights before."
    )
    table = Table(columns, rows, ("left", "left", "right", "right", "right"), caption)
    return Section("prediction", "Prediction error on a flight that was not used", (table,))


def _twin(data: DemoData) -> Section:
    lead = (
        "The improved model flew the same script as a vehicle of its own, its twin, behind the same autopilot; channels, parameters and "
        f"steps side by side are in {data['twin_report']}."
    )
    tone: Tone = "good" if data["twin"]["verdict"] == "NOTHING_MISSING" else "warn"
    return Section("twin", "The twin beside that flight", (Paragraph(verify_sentence(data["twin"]), tone),), lead)


def _truth(data: DemoData) -> Section:
    """The only place where what was concealed is shown."""
    rows: list[tuple[Cell | str, ...]] = []
    findings = {f["term"]: f for f in data["findings"]}
    for term, values in data["hidden"].items():
        if term not in findings:
            rows.append((term, _given(values), Cell("not found", "bad"), "-", "-"))
    for term, finding in findings.items():
        given = data["hidden"].get(term)
        for name, p in finding["parameters"].items():
            low, high = (p.get("interval_95") or (None, None))[:2]
            span = "-" if low is None else f"{to_error(low, p['std'])} to {to_error(high, p['std'])}"
            truth = (given or {}).get(name)
            inside = truth is not None and low is not None and high is not None and low <= truth <= high
            hidden = number(truth, 3) if truth is not None else "nothing" if given is None else "its default"
            value = f"{to_error(p.get('value'), p.get('std'))} {unit(str(p.get('unit', '')))}".strip()
            rows.append((f"{term} {name}", hidden, Cell(value, "good" if inside else "plain"), span, _sure(finding)))
    concealed = "; ".join(f"{term} {_given(given)}".strip() for term, given in data["hidden"].items())
    names = join([_named(f) for f in data["findings"]]) or "nothing"
    blocks: list[PageBlock] = [
        Table(
            ("effect", "hidden", "found", "95 % interval", "probability"),
            tuple(rows),
            ("left", "right", "right", "left", "left"),
        ),
        Paragraph(f"hidden: {concealed}; found: {names}.", "good" if data["as_hidden"] else "warn"),
    ]
    lead = "The hidden values were given to the simulator only; the diagnosis had only the recordings."
    return Section("truth", "What was hidden, and what was found", tuple(blocks), lead)


def _given(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {number(value, 3)}" for name, value in values.items())


def _sure(finding: FindingRow) -> str:
    p = finding["evidence"].get("probability")
    probability = "-" if p is None else "above 99.9 %" if p > 0.999 else f"{100 * p:.1f} %"
    return (
        probability if finding["verdict"] == "SUPPORTED" else f"{probability}, {TERM_WORDS.get(finding['verdict'], '')}"
    )


def _go_on(commands: Sequence[tuple[str, str]], report: str) -> Section:
    blocks = tuple(Code(command, what_for) for what_for, command in commands)
    return Section("next", "Go on", blocks, f"The page with the picture is {report}.")
