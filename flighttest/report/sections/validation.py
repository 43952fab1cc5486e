"""The paper's section 4 for this flight: Figure 5, and errors by horizon for the model and its simplifications."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flighttest.identify.validation.ablations import GROUPS, UNITS, Variation
from flighttest.identify.validation.validate import Validation
from flighttest.report.document import OMITTED, Align, Bullets, Cell, Figure, Panel, Role, Section, Table, Trace
from flighttest.report.numbers import number, unit

FloatArray = NDArray[np.float64]
ROLES: dict[Variation, Role] = {
    Variation.FULL: "model",
    Variation.LINEARISED: "linearised",
    Variation.NO_DRAG: "no_drag",
    Variation.NO_BATTERY: "no_battery",
    Variation.ONLY_DELAY: "only_delay",
    Variation.HOLD: "reference",
    Variation.PREVIOUS: "before",
}
FIRST_GROUPS = 2  # of errors
NAMES = {  # of a table's rows, each in one line
    Variation.LINEARISED: "linearised",
    Variation.NO_BATTERY: "no battery",
    Variation.HOLD: "last value",
}
ROLL = (("roll rate", "p_rad_s", "roll rate, rad/s"), ("roll", "roll_rad", "roll, rad"))
HEIGHT = ("height", "p_z_m", "height, m")
PITCH = (("pitch rate", "q_rad_s", "pitch rate, rad/s"), ("pitch", "pitch_rad", "pitch, rad"))
PANELS = (
    ("yaw rate", "r_rad_s", "yaw rate, rad/s"),
    ("yaw", "yaw_rad", "yaw, rad"),
    ("acceleration north", "a_x_m_s2", "acceleration north, m/s²"),
    ("acceleration west", "a_y_m_s2", "acceleration west, m/s²"),
    ("acceleration up", "a_z_m_s2", "acceleration up, m/s²"),
)


def validation_sections(found: Validation, of: str = "") -> tuple[Section, ...]:
    """Figure 5, sentences, and one table per group of channels. of: which part of the flights, where it is not all of them."""
    mark = f"-{of.replace(' ', '-')}" if of else ""
    figure = _figure5(found, f"figure5{mark}")
    count = len(found.segments)
    kind = f"step{'s' if count != 1 else ''}" if of == "steps" else f"stretch{'es' if count != 1 else ''} of flight"
    lead = f"{found.starts} starts in {count} {kind}; only recorded commands and voltage drive the models."
    title = f"Prediction of {of}" if of else "Prediction against these flights"
    sections = [Section(f"validation{mark}", title, (figure, Bullets(found.sentences)), lead)]
    title = f"Errors by horizon, {of}" if of else "Errors by horizon"
    sections.append(Section(f"horizons{mark}", title, _tables(found)))
    return tuple(sections)


def _figure5(found: Validation, name: str) -> Figure:
    f = found.figure
    panels = []
    places = ("p_x_m", "p_y_m", "p_z_m")
    if all(c in f.measured for c in places):
        above = [Trace(-f.measured["p_y_m"], f.measured["p_x_m"], "measured", "measured")]
        above += [
            Trace(-made["p_y_m"], made["p_x_m"], variation.value, ROLES[variation])
            for variation, made in f.simulated.items()
            if all(c in made for c in places) and variation is not Variation.HOLD
        ]
        panels.append(Panel("position seen from above", "east, m", "north, m", tuple(above), equal=True))
    for title, channel, label in (HEIGHT, *(PITCH if _pitches(f.measured) else ROLL), *PANELS):
        if channel not in f.measured:
            continue
        lines = [Trace(f.t_s, f.measured[channel], "measured", "measured")]
        for variation, made in f.simulated.items():
            if channel in made:
                shown = variation is not Variation.HOLD
                n = min(len(f.t_s), len(made[channel]))
                lines.append(Trace(f.t_s[:n], made[channel][:n], variation.value, ROLES[variation], shown=shown))
        panels.append(Panel(title, "time, s", label, tuple(lines)))
    caption = (
        f"The {f.t_s[-1]:.1f} s of the flight with the most motion ({f.segment}): measured, and each model run open loop from the same "
        "start."
    )
    return Figure(name, tuple(panels), caption, 2, 270)


def _pitches(measured: Mapping[str, FloatArray]) -> bool:
    """Whether the stretch moves more in pitch than in roll."""
    moved = {name: float(np.ptp(measured[name])) for name in ("roll_rad", "pitch_rad") if name in measured}
    return moved.get("pitch_rad", 0.0) > moved.get("roll_rad", 0.0)


def _tables(found: Validation) -> tuple[Table, ...]:
    """Position and velocity, then what else was compared, which a terminal leaves out for one screen."""
    names = tuple(GROUPS)
    first, rest = (_table(found, groups) for groups in (names[:FIRST_GROUPS], names[FIRST_GROUPS:]))
    return tuple(t for t in (first, replace(rest, brief=OMITTED, caption="")) if t.rows) or (first,)


def _table(found: Validation, groups: Sequence[str]) -> Table:
    horizons = sorted({e.horizon_s for e in found.errors})
    variations = [v for v in Variation if any(e.variation is v for e in found.errors)]
    rows: list[tuple[Cell | str, ...]] = []
    for group in groups:
        best = {
            h: min((r for v in variations if (r := found.rmse(v, group, h)) is not None), default=None)
            for h in horizons
        }
        if all(b is None for b in best.values()):
            continue
        for index, v in enumerate(variations):
            cells = []
            for h in horizons:
                value = found.rmse(v, group, h)
                cells.append(Cell(number(value, 3), "good" if value is not None and value == best[h] else "plain"))
            head = f"{group}, {unit(UNITS[group])}" if index == 0 else ""
            rows.append((head, NAMES.get(v, v.value), *cells))
    numbers: list[Align] = ["right" for _ in horizons]
    caption = "Root mean square error after each horizon; green: the smallest in its column."
    full = [e for e in found.errors if e.variation is Variation.FULL and e.few]
    few = {e.horizon_s: e.few for e in sorted(full, key=lambda e: -e.count)}
    if few:
        caption += " Uncertain: " + "; ".join(f"after {h:g} s, {words}" for h, words in sorted(few.items())) + "."
    return Table(("", "model", *(f"{h:g} s" for h in horizons)), tuple(rows), ("left", "left", *numbers), caption)
