"""Sections about an identified model as a vehicle: what still differs from the recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np

from flighttest.channels import CHANNELS, WORDS
from flighttest.report.document import Bullets, Cell, Figure, PageBlock, Panel, Section, Table, Trace
from flighttest.report.numbers import join, number, unit
from flighttest.report.sections.against import (
    DifferenceRow,
    StepRow,
    comparison_figure,
    difference_table,
    steps_section,
    titled,
)

_WORDS = WORDS | {"p_z_m": "height"}
_PANELS = 3  # channels drawn of each stretch


class ChannelRow(TypedDict):
    """Error of the twin in one channel, in its unit; ratio: in noise floors; fitted: what fitting these recordings would leave."""

    rmse: float
    floor: float
    ratio: float
    fitted: float


class FlownRow(TypedDict):
    """Steps that both flew, by the channel they drive (`twin.flown.flown_errors`)."""

    rmse: float
    floor: float
    ratio: float
    later_s: float
    later_std_s: float
    steps: float


class TwinData(TypedDict, total=False):
    """A twin beside recordings (format twin/1). near_floor: ratio up to which it flies as recorded; above: channels beyond it; assumed:
    parameters that no flight determined."""

    format: str
    verdict: str
    near_floor: float
    terms: list[str]
    titles: dict[str, str]
    lacks: list[str]
    differing: list[str]
    channels: dict[str, ChannelRow]
    flown_channels: dict[str, FlownRow]
    above: list[str]
    parameters: list[DifferenceRow]
    notes: list[str]
    steps: list[StepRow]
    diagnosis: SideVerdict
    backend: str
    flown: list[str]
    flights: int
    assumed: list[str]
    losses: list[str]


class SideVerdict(TypedDict):
    """What the diagnosis of the recordings found."""

    verdict: str
    sentence: str


class EffectRow(TypedDict):
    """What a change does in one channel, in its unit (`twin.replay.Effect`); every number is null where nothing of it was recorded."""

    error: float
    shift: float
    size: float
    uncertainty: float


class ReplayData(TypedDict):
    """Recorded commands on a twin (format replay/1)."""

    format: str
    changes: list[str]
    effects: dict[str, EffectRow]
    starts: int
    horizon_s: float
    terms: list[str]
    losses: list[str]


class StretchData(TypedDict):
    """One stretch of a replay over time since its start; by channel (n,)."""

    segment: str
    t_s: list[float]
    measured: dict[str, list[float]]
    twin: dict[str, list[float]]
    changed: dict[str, list[float]]
    half: dict[str, list[float]]


def verify_sentence(data: TwinData) -> str:
    """The answer in one sentence."""
    channels = judged(data)
    worst = max(channels, key=lambda c: channels[c]["ratio"], default=None)
    if data["verdict"] == "NOTHING_MISSING":
        largest = f", {number(channels[worst]['ratio'], 3)} of {WORDS.get(worst, worst)}" if worst is not None else ""
        return (
            f"The twin flies as recorded. Its error is at most {data['near_floor']:g} noise floors in every "
            f"channel{largest and f' (largest{largest})'}, and no parameter differs beyond its error."
        )
    parts = []
    if data["lacks"]:
        parts.append(f"it lacks {join([titled(data['titles'], t) for t in data['lacks']])}")
    others = [p["name"] for p in data["parameters"] if p["differs"] and p["term"] not in data["lacks"]]
    if others:
        parts.append(f"{join(others)} differ{'s' if len(others) == 1 else ''}")
    if data["above"]:
        errors = [f"{WORDS.get(c, c)} {number(channels[c]['ratio'], 3)}" for c in data["above"]]
        parts.append(f"its error is above {data['near_floor']:g} noise floors in {join(errors)}")
    return f"The twin does not fly as recorded: {'; '.join(parts)}."


def judged(data: TwinData) -> dict[str, ChannelRow | FlownRow]:
    """Errors that the verdict is of: under the real firmware the steps' own channels as flown, the rest by the model."""
    flown = data.get("flown_channels", {}) if data.get("backend") == "sitl" else {}
    return {**data["channels"], **flown}


def verify_sections(data: TwinData) -> tuple[Section, ...]:
    """Error by channel, parameters, steps."""
    rows = tuple(
        (
            WORDS.get(c, c),
            number(v["floor"], 2),
            number(v["rmse"], 3),
            Cell(number(v["ratio"], 3), "bad" if c in data["above"] else "good"),
            number(v["fitted"], 3),
        )
        for c, v in data["channels"].items()
    )
    caption = (
        "RMS error of the model on the recorded commands, each response from its own measured start with a constant disturbance of its "
        "own; also in noise floors, and for comparison after a fit to these recordings. Noise floor: the difference between repeats of one "
        "step; where no step was repeated and nothing is missing, the residual of the fit."
    )
    table = Table(
        ("channel", "noise floor", "twin", "in floors", "refitted"),
        rows,
        ("left", "right", "right", "right", "right"),
        caption,
    )
    tables = [table]
    flown = data.get("flown_channels", {})
    if flown:
        tables.append(_flown_table(data, flown))
    lines = [*data["notes"]]
    if data["assumed"]:
        lines.append(f"no flight of the model determined {join(data['assumed'])}: the twin uses assumed values")
    lines.append(f"the recordings by themselves: {data['diagnosis']['sentence']}")
    flights = data["flights"]
    where = " under the real firmware" if data.get("backend") == "sitl" else ""
    how = (
        f"{flights} script{'s' if flights != 1 else ''} flown on the twin{where}"
        if flights
        else "recorded commands alone, nothing flown"
    )
    errors = {"twin": {c: v["ratio"] for c, v in judged(data).items()}}
    picture = comparison_figure(data["parameters"], errors, "recorded", "twin")
    blocks: list[PageBlock] = [Bullets(tuple(lines)), difference_table(data["parameters"], "recorded", "twin")]
    found = [] if picture is None else [Section("picture", "", (picture,))]
    found += [
        Section("channels", "Twin against recordings", tuple(tables), f"Compared: {how}."),
        Section("parameters", "Parameters", tuple(blocks)),
    ]
    steps = steps_section(data.get("steps", ()))
    return (*found, steps) if steps is not None else tuple(found)


def _flown_table(data: TwinData, flown: Mapping[str, FlownRow]) -> Table:
    """Steps that recording and twin both flew, by the channel they drive."""
    rows = tuple(
        (
            WORDS.get(c, c),
            number(v["floor"], 2),
            number(v["rmse"], 3),
            Cell(number(v["ratio"], 3), "bad" if v["ratio"] > data["near_floor"] else "good"),
            f"{number(1e3 * v['later_s'], 2)} ± {number(1e3 * v['later_std_s'], 2)}",
            str(int(v["steps"])),
        )
        for c, v in flown.items()
    )
    caption = (
        "Steps as flown, no model between: RMS of each recorded response less the mean of the twin's of the same step, each from its own "
        "state before it and moved in time to where it fits best (recorded later by: the mean of that, with its standard error); "
        "also in units of the scatter between repeats of the recording."
    )
    return Table(
        ("flown steps", "repeats", "twin", "in floors", "recorded later by, ms", "steps"),
        rows,
        ("left", "right", "right", "right", "right", "right"),
        caption,
    )


def replay_sentence(data: ReplayData) -> str:
    """What the change does, where it shows most."""
    effects = {c: e for c, e in data["effects"].items() if e["error"] is not None}
    if not effects:
        return "Nothing of the recording can be compared with the twin."
    if not data["changes"]:
        worst = max(effects, key=lambda c: effects[c]["error"] / (effects[c]["uncertainty"] or np.inf))
        return f"The twin as identified: after {data['horizon_s']:g} s its {_off(worst, effects[worst]['error'])} off (RMS)."
    most = max(effects, key=lambda c: effects[c]["size"] / max(effects[c]["error"], effects[c]["uncertainty"], 1e-9))
    e = effects[most]
    head = f"With {'; '.join(data['changes'])}:"
    if e["size"] <= max(e["error"], e["uncertainty"]):
        return f"{head} no difference above the twin's own error against this recording."
    plus_minus = f"{_value(most, e['size'])} (RMS), ± {_value(most, e['uncertainty'])} by the model's uncertainty"
    own = f"Without the change the twin's error is {_value(most, e['error'])}."
    return f"{head} after {data['horizon_s']:g} s the {_WORDS.get(most, most)} differs by {plus_minus}. {own}"


def _value(channel: str, value: float) -> str:
    return f"{number(value, 2)} {unit(CHANNELS[channel].unit)}"


def _off(channel: str, value: float) -> str:
    return f"{_WORDS.get(channel, channel)} is {_value(channel, value)}"


def replay_sections(data: ReplayData, shown: Sequence[StretchData]) -> tuple[Section, ...]:
    """The stretches where the change shows most, and its effect by channel."""
    rows: list[tuple[Cell | str, ...]] = []
    for c, e in data["effects"].items():
        if e["size"] is None:
            continue
        seen = e["size"] > max(e["error"], e["uncertainty"])
        cells = [number(e[k], 2) for k in ("error", "shift", "size", "uncertainty")]
        rows.append(
            (
                _WORDS.get(c, c),
                unit(CHANNELS[c].unit),
                cells[0],
                cells[1],
                Cell(cells[2], "warn" if seen else "plain"),
                cells[3],
            )
        )
    caption = (
        f"At most {data['horizon_s']:g} s after each of {data['starts']} starts. Error: RMS of the twin as identified against the "
        "recording; mean change and change: the changed twin against the unchanged one, mean and RMS; uncertainty: 95 % half width by the "
        "covariance of the model's parameters. Marked: changes above both."
    )
    columns = ("channel", "unit", "error", "mean change", "change", "uncertainty")
    table = Table(columns, tuple(rows), ("left", "left", "right", "right", "right", "right"), caption)
    lead = "; ".join(data["changes"]) or "The twin as identified"
    found = [Section("effects", "Recorded commands on the twin", (table,), f"{lead}.")]
    figure = _stretches(data, shown)
    return (Section("stretches", "Where it shows most", (figure,)), *found) if figure is not None else tuple(found)


def _stretches(data: ReplayData, shown: Sequence[StretchData]) -> Figure | None:
    ranked = sorted(
        (c for c, e in data["effects"].items() if e["size"] is not None),
        key=lambda c: -data["effects"][c]["size"] / max(data["effects"][c]["error"], 1e-9),
    )
    panels = []
    for s in shown:
        t = np.asarray(s["t_s"], dtype=float)
        for c in [c for c in ranked if c in s["measured"]][:_PANELS]:
            changed, half = np.asarray(s["changed"][c], dtype=float), np.asarray(s["half"][c], dtype=float)
            lines = [
                Trace(t, changed - half, "95 % of the model", "band", group="95 % of the model"),
                Trace(t, changed + half, "95 % of the model", "band", group="95 % of the model"),
                Trace(t, np.asarray(s["measured"][c], dtype=float), "recorded", "measured"),
                Trace(t, np.asarray(s["twin"][c], dtype=float), "twin", "before"),
            ]
            if data["changes"]:
                lines.append(Trace(t, changed, "twin with the change", "after"))
            label = f"{_WORDS.get(c, c)}, {unit(CHANNELS[c].unit)}"
            panels.append(Panel(s["segment"], "time since the start, s", label, tuple(lines)))
    if not panels:
        return None
    caption = "The stretches where the change shows most: recorded, the twin as identified, and with the change."
    return Figure("stretches", tuple(panels), caption, _PANELS, 270)
