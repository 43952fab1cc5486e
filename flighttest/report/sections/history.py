"""Runs on one page: each parameter over runs, with the changes of components marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flighttest.report.document import Bullets, Cell, Document, Figure, Panel, Section, Table, Trace
from flighttest.report.numbers import join, percent, to_error, unit


@dataclass(frozen=True)
class HistoryPoint:
    """One run of the history. parameters: name to (value, half width of its 95 % interval); components in one line each; completed: flown
    to its end; campaign: runs that were fitted together, which carry the same estimates."""

    run: str
    when: str
    vehicle: str
    script: str
    outcome: str
    parameters: Mapping[str, tuple[float, float]]
    components: Mapping[str, str]
    completed: bool = False
    campaign: tuple[str, ...] = ()


def history_document(points: Sequence[HistoryPoint], units: Mapping[str, str], broken: Sequence[str] = ()) -> Document:
    """Each parameter over runs, with the changes of components marked. broken: what could not be read, and why."""
    damage = (Section("broken", "What cannot be read", (Bullets(tuple(broken)),)),) if broken else ()
    if not points and broken:
        return Document("Runs on this machine", "None of the runs here can be read.", "bad", damage)
    if not points:
        return Document(
            "Runs on this machine", "There are no runs here yet; `flighttest run thrust` makes one.", "warn"
        )
    marks = changes_between(points)
    # A run folder's name begins with its date and ends with its script: shown once. Numbers are those under the pictures.
    dated = all(p.run[:4].isdigit() for p in points)
    vehicles = list(dict.fromkeys(p.vehicle for p in points if p.vehicle))
    several = len({p.vehicle for p in points}) > 1
    heads = (
        "", "run", *(() if dated else ("when", "script")), *(("vehicle",) if several else ()), "changed before it", "how it ended",
    )  # fmt: skip
    rows = tuple(
        (
            f"{i}",
            p.run,
            *(() if dated else (p.when, p.script)),
            *((p.vehicle or Cell("unknown", "quiet"),) if several else ()),
            Cell("; ".join(marks.get(p.run, ())), "warn"),
            Cell("flown", "quiet") if p.completed else p.outcome,
        )
        for i, p in enumerate(points, 1)
    )
    pictures, latest, moved = [], [], []
    numbered = list(enumerate(points, 1))
    for vehicle in vehicles:
        mine = [(i, p) for i, p in numbered if p.vehicle == vehicle]
        pictures += _over_runs(mine, units, marks, vehicle if several else "")
        latest += _latest_of(mine, units, vehicle if several else "")
        moved += [f"{n} of {vehicle}" if several else n for n in _moved(mine)]
    fitted = sum(1 for p in points if p.parameters)
    of = f" of {vehicles[0]}" if len(vehicles) == 1 and not several else ""
    verdict = f"{len(points)} run{'s' if len(points) != 1 else ''}{of}, {fitted} with a fit."
    if moved:
        verdict += f" Since the first run these changed by more than both 95 % intervals: {join(moved)}."
    elif latest:
        verdict += " No parameter changed since the first run by more than both 95 % intervals."
    if broken:
        verdict += f" {len(broken)} cannot be read: see below."
    listed = Section("runs", "Runs", (Table(heads, rows, ("right",)),))
    return Document(
        "Runs on this machine", verdict, "warn" if broken else "plain", (*pictures, listed, *damage, *latest)
    )


def _campaigns(mine: Sequence[tuple[int, HistoryPoint]]) -> dict[str, list[tuple[int, HistoryPoint]]]:
    """Parameter to the numbered runs that have an estimate of it; runs that were fitted together carry the same, and count once."""
    before = [p.campaign for _, p in mine]
    own = [(i, p) for k, (i, p) in enumerate(mine) if not p.campaign or p.campaign not in before[:k]]
    names = list(dict.fromkeys(n for _, p in own for n in p.parameters))
    return {n: [(i, p) for i, p in own if n in p.parameters] for n in names}


def _moved(mine: Sequence[tuple[int, HistoryPoint]]) -> list[str]:
    """Parameters whose last 95 % interval and the first do not overlap."""
    ends = {n: (runs[0][1].parameters[n], runs[-1][1].parameters[n]) for n, runs in _campaigns(mine).items()}
    return [n for n, ((a, half_a), (b, half_b)) in ends.items() if abs(b - a) > half_a + half_b]


def _titled(name: str, title: str, mine: Sequence[tuple[int, HistoryPoint]], vehicle: str) -> tuple[str, str]:
    """Id and heading of a section about one vehicle."""
    return (f"{name}-{mine[0][0]}", f"{title} of {vehicle}") if vehicle else (name, title)


def _over_runs(
    mine: Sequence[tuple[int, HistoryPoint]],
    units: Mapping[str, str],
    marks: Mapping[str, Sequence[str]],
    vehicle: str,
) -> list[Section]:
    """Each parameter over the runs of one vehicle, by their numbers; of a run of an unknown vehicle nothing is drawn."""
    panels = tuple(_history_panel(n, runs, units.get(n, ""), marks) for n, runs in _campaigns(mine).items())
    if not panels:
        return []
    caption = "Each campaign's estimate with its 95 % interval; dashed: a component changed before this run."
    name, title = _titled("history", "Parameters over runs", mine, vehicle)
    return [Section(name, title, (Figure(name, panels, caption, 3, 230),))]


def _latest_of(mine: Sequence[tuple[int, HistoryPoint]], units: Mapping[str, str], vehicle: str) -> list[Section]:
    """The latest estimate of each parameter of one vehicle."""
    rows = tuple(_latest(n, runs, units.get(n, "")) for n, runs in _campaigns(mine).items())
    if not rows:
        return []
    heads = ("parameter", "latest", "unit", "run", "since the first")
    name, title = _titled("latest", "Latest estimates", mine, vehicle)
    return [Section(name, title, (Table(heads, rows, ("left", "right", "left", "right", "right")),))]


def _latest(name: str, numbered: Sequence[tuple[int, HistoryPoint]], unit_text: str) -> tuple[Cell | str, ...]:
    (_, first), (number, last) = numbered[0], numbered[-1]
    (before, _), (now, half) = first.parameters[name], last.parameters[name]
    change = percent((now - before) / abs(before)) if len(numbered) > 1 and before else "-"
    return name, f"{to_error(now, half)} ± {to_error(half, half)}", unit(unit_text), f"{number}", change


def changes_between(points: Sequence[HistoryPoint]) -> dict[str, tuple[str, ...]]:
    """Run to the components that differ from the run before it (of the same vehicle)."""
    found: dict[str, tuple[str, ...]] = {}
    last: dict[str, HistoryPoint] = {}
    for p in points:
        before = last.get(p.vehicle) if p.vehicle else None
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
