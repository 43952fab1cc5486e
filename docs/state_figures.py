"""The table of a flight's states as a drawing in SVG: states as boxes on a grid, changes as arrows with their events."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from itertools import product

from flighttest.flight.execution.machine import TABLE, Event, FlightState

Edges = Mapping[tuple[str, str], tuple[str, ...]]

COLUMN, ROW, WIDE, HEAD, LINE, CHARACTER = 276.0, 250.0, 184.0, 26.0, 14.0, 7.4
MARGIN = 20.0
# Where each state stands: column and row.
PLACES = {
    "GROUND": (0, 0), "ARMING": (1, 0), "CLIMBING": (2, 0), "OFFERED": (0, 1), "RETURNING": (1, 1), "FLYING": (2, 1),
    "ASKING": (3, 1), "HANDED": (0, 2), "HOLDING": (2, 2), "LANDING": (3, 2),
}  # fmt: skip
# How far an arrow bends upwards, as a share of its length, where a straight one would pass through a box.
BENDS = {("OFFERED", "ASKING"): -0.21, ("RETURNING", "ASKING"): -0.16}
STYLE = (
    "rect{fill:#fff;stroke:#37474f}.start rect{stroke-width:2.5}path{fill:none;stroke:#607d8b}marker path{fill:#607d8b}"
    "text{font:11px sans-serif;fill:#222}.name{font-weight:bold}.end{fill:#8a3a1e}"
    ".event{paint-order:stroke;stroke:#fff;stroke-width:4px;text-anchor:middle;font-size:10px}"
)


def flight_states() -> str:
    """The drawing of the flight's states, without what changes nothing."""
    edges: dict[tuple[str, str], tuple[str, ...]] = {}
    for state, event in product(FlightState, Event):
        following = TABLE.get((state, event))
        if following is not None and not state.is_end and following.state is not state:
            change = (state.name, following.state.name)
            edges[change] = (*edges.get(change, ()), event.name)
    return drawing(
        "The states of a flight, the events that change them, and its ends", PLACES, edges, FlightState.GROUND.name
    )


def drawing(title: str, places: Mapping[str, tuple[int, int]], edges: Edges, start: str) -> str:
    """The drawing. places: column and row of each state; edges: (state, following state) to events; a following state without a place is
    an end, written into the box of the state before it. ValueError where a state of `edges` has no place."""
    missing = {before for before, _ in edges} - set(places)
    if missing:
        raise ValueError(f"no place in the drawing for {', '.join(sorted(missing))}")
    ends = {s: [(e, b) for (a, b), e in edges.items() if a == s and b not in places] for s in places}
    heights = {
        s: HEAD + sum(LINE * len(_end_lines(e, b)) for e, b in ends[s]) + (8.0 if ends[s] else 0.0) for s in places
    }
    middle = {s: (MARGIN + WIDE / 2 + COLUMN * c, 90.0 + ROW * r) for s, (c, r) in places.items()}
    width = 2 * MARGIN + WIDE + COLUMN * max(c for c, _ in places.values())
    height = max(middle[s][1] + heights[s] / 2 for s in places) + MARGIN
    drawn, labels = [], []
    for (a, b), events in edges.items():
        if b not in places:
            continue
        bend = BENDS.get((a, b), 0.0)
        if not bend and (b, a) in edges:
            bend = 0.1 if abs(middle[a][0] - middle[b][0]) > 1.0 else 0.16
        (path, at) = _arrow(middle[a], middle[b], (WIDE, heights[a]), (WIDE, heights[b]), bend)
        drawn.append(path)
        labels.append((at, events))
    boxes = [_box(s, middle[s], heights[s], ends[s], s == start) for s in places]
    words = []
    for (x, y), events in labels:
        for k, line in enumerate(_wrapped(events)):
            words.append(f'<text class="event" x="{x:.1f}" y="{y + 3 + 11 * k:.1f}">{escape(line)}</text>')
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}">',
            f"<title>{escape(title)}</title><style>{STYLE}</style>",
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
            '<path d="M0 0L8 4L0 8Z"/></marker></defs>',
            f'<rect x="0" y="0" width="{width:.0f}" height="{height:.0f}" style="stroke:none"/>',
            *drawn,
            *boxes,
            *words,
            "</svg>",
            "",
        ]
    )


def _end_lines(events: tuple[str, ...], end: str) -> list[str]:
    """The lines of a box about one end: events, then the end, as many to a line as fit."""
    lines = [""]
    for word in [f"{e}," for e in events[:-1]] + [events[-1], f"> {end}"]:
        if lines[-1] and (len(lines[-1]) + 1 + len(word)) * CHARACTER > WIDE - 8.0:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _wrapped(events: tuple[str, ...]) -> list[str]:
    return [", ".join(events[k : k + 2]) for k in range(0, len(events), 2)]


def _box(
    name: str, middle: tuple[float, float], height: float, ends: list[tuple[tuple[str, ...], str]], start: bool
) -> str:
    x, y = middle[0] - WIDE / 2, middle[1] - height / 2
    text = [f'<text class="name" x="{middle[0]:.1f}" y="{y + 17:.1f}" text-anchor="middle">{escape(name)}</text>']
    at = y + HEAD + LINE - 1.0
    for events, end in ends:
        for line in _end_lines(events, end):
            text.append(f'<text class="end" x="{x + 6:.1f}" y="{at:.1f}">{escape(line)}</text>')
            at += LINE
    rule = f'<path d="M{x:.1f} {y + HEAD:.1f}h{WIDE:.0f}"/>' if ends else ""
    kind = ' class="start"' if start else ""
    return f'<g{kind}><rect x="{x:.1f}" y="{y:.1f}" width="{WIDE:.0f}" height="{height:.1f}" rx="6"/>{rule}{"".join(text)}</g>'


def _arrow(
    a: tuple[float, float],
    b: tuple[float, float],
    size_a: tuple[float, float],
    size_b: tuple[float, float],
    bend: float,
) -> tuple[str, tuple[float, float]]:
    """An arrow from the border of one box to that of the other, and the point for its events."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    control = ((a[0] + b[0]) / 2 - 2 * bend * -dy, (a[1] + b[1]) / 2 - 2 * bend * dx)
    if bend < 0:  # above
        control = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2 + 2 * bend * abs(dx))

    def point(t: float) -> tuple[float, float]:
        return tuple((1 - t) ** 2 * a[i] + 2 * t * (1 - t) * control[i] + t**2 * b[i] for i in (0, 1))  # type: ignore[return-value]

    def outside(p: tuple[float, float], c: tuple[float, float], size: tuple[float, float]) -> bool:
        return abs(p[0] - c[0]) > size[0] / 2 + 1.0 or abs(p[1] - c[1]) > size[1] / 2 + 1.0

    steps = [k / 400 for k in range(401)]
    first = next(t for t in steps if outside(point(t), a, size_a))
    last = next(t for t in reversed(steps) if outside(point(t), b, size_b))
    points = [point(first + (last - first) * k / 12) for k in range(13)]
    path = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    return f'<path d="M{path}" marker-end="url(#tip)"/>', point(first + 0.5 * (last - first))
