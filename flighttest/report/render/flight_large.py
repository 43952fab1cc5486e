"""The flight to be read from two metres and in the sun: large figures, few colours, where the vehicle is in its zone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from flighttest.report.render.flight_view import VOLTAGE_NEAR_V, ZONE_NEAR_M, link_is_bad, link_words

_ROWS: dict[str, str] = {
    "0": "███|█ █|█ █|█ █|███", "1": "  █|  █|  █|  █|  █", "2": "███|  █|███|█  |███", "3": "███|  █|███|  █|███",
    "4": "█ █|█ █|███|  █|  █", "5": "███|█  |███|  █|███", "6": "███|█  |███|█ █|███", "7": "███|  █|  █|  █|  █",
    "8": "███|█ █|███|█ █|███", "9": "███|█ █|███|  █|███", "-": "   |   |███|   |   ", ".": " | | | |█", ":": " |█| |█| ",
    " ": "  |  |  |  |  ",
}  # fmt: skip
_MAP_COLUMNS, _MAP_ROWS = 31, 9
GOOD, WARN, BAD = "bold black on bright_green", "bold black on bright_yellow", "bold bright_white on red"


def large(facts: Any) -> RenderableType:
    """State, what moves and what comes next; height, distance to the wall, battery and time left in large figures; the zone from above."""
    if facts.alarm:
        style, head = BAD, facts.alarm
    elif facts.stopping:
        style, head = WARN, f"STOPPING {facts.mode}"
    else:
        style, head = GOOD, f"FLYING {facts.mode}"
    near = facts.zone_margin_m < ZONE_NEAR_M
    low = facts.voltage_v < facts.voltage_min_v + VOLTAGE_NEAR_V
    figures = Table.grid(padding=(0, 4))
    figures.add_row(
        _figure("height, m", _number(facts.height_m)), _figure("to the wall, m", _number(facts.zone_margin_m), near)
    )
    figures.add_row(_figure("battery, V", _number(facts.voltage_v), low), _figure("left", _minutes(facts.time_left_s)))
    both = Table.grid(padding=(0, 2))
    both.add_row(figures, zone_map(facts.place_m, facts.zone_m))
    now = f"{facts.leg} of {facts.legs}: {facts.doing}" + (f" ({facts.phase})" if facts.phase else "")
    return Group(
        Text(f" {head} ", style=style, justify="center"),
        Text(now, style="bold bright_white"),
        Text(f"then {facts.next}", style="bright_white") if facts.next else Text(),
        both,
        Text(link_words(facts), style=BAD if link_is_bad(facts) else "bold bright_white"),
        Text(facts.how_to_stop, style="bright_white"),
    )


def figure_rows(text: str) -> list[str]:
    """A number in block characters, five rows."""
    return [" ".join(_ROWS.get(c, _ROWS[" "]).split("|")[row] for c in text) for row in range(5)]


def zone_map(place_m: Sequence[float] | None, zone_m: Sequence[Sequence[float]] | None) -> Text:
    """The zone from above, x up and y to the left, with the vehicle where it is (at the edge and marked where it is outside)."""
    if zone_m is None:
        return Text()
    (x_low, x_high), (y_low, y_high) = zone_m
    grid = [["·"] * _MAP_COLUMNS for _ in range(_MAP_ROWS)]
    mark, style = "", "bold bright_white"
    if place_m is not None and all(map(math.isfinite, place_m)):
        x, y = place_m
        row = round((x_high - x) / (x_high - x_low) * (_MAP_ROWS - 1))
        column = round((y_high - y) / (y_high - y_low) * (_MAP_COLUMNS - 1))
        inside = x_low <= x <= x_high and y_low <= y <= y_high
        mark, style = ("@", style) if inside else ("X", BAD)
        grid[min(max(row, 0), _MAP_ROWS - 1)][min(max(column, 0), _MAP_COLUMNS - 1)] = mark
    words = f"zone {x_high - x_low:g} x {y_high - y_low:g} m, vehicle {mark or 'not known'}"
    return Text("\n".join(["".join(row) for row in grid] + [words]), style=style)


def _figure(words: str, number: str, bad: bool = False) -> Text:
    return Text("\n".join([words, *figure_rows(number), ""]), style="bold bright_red" if bad else "bold bright_white")


def _number(value: float) -> str:
    return f"{value:z.1f}" if math.isfinite(value) else "-"


def _minutes(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "-"
    minutes, rest = divmod(max(round(seconds), 0), 60)
    return f"{minutes}:{rest:02d}"
