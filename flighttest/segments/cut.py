"""Cut a recording into step responses and windows of free flight.

The step is always where the recorded reference has its edge. Marks, where there are any, name which edges were meant and what they are
called. What they leave, or all where there are none, is cut by its references alone: into steps, and into windows of free flight.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import INPUTS
from flighttest.recording import Recording
from flighttest.segments import edges as ed
from flighttest.segments.airborne import control_lost, flights, takeoffs
from flighttest.segments.align import Aligned, prepare_motion, sample
from flighttest.segments.edges import BY_HAND, EXACT, IN_PIECE, FoundStep, References, Tolerance
from flighttest.segments.marks import Marked, marked
from flighttest.segments.model import Flaw, Segment, SegmentContext
from flighttest.segments.quality import flaws_of

FloatArray = NDArray[np.float64]

WINDOW_S = 2.5
_SHORTEST_WINDOW_S = 1.2
_REACH_BACK_S = 1.0  # inputs are kept this long before the first sample, so that delays can reach back
_DELAY_MAX_S = 0.5  # what was asked for this long before a window no longer shows in it
_MARK_EARLY_S = 0.3  # a mark and the target that follows it leave in any order
_MARK_LATE_S = 3.0
_SAME_CELL = {"amplitude_rad": 0.012, "rate_rad_s": 0.03, "throttle_0": 0.004, "throttle_1": 0.004, "height_m": 0.2}
_ENDED = {"LINK_LOST": Flaw.LINK_LOST, "TAKE_OVER": Flaw.TAKE_OVER, "NOT_SETTLED": Flaw.NOT_SETTLED}
# A step that the gate ended shows what there is to see from here on: the delay, and ten time constants of a slow thrust lag.
_ENOUGH_S = 0.6
_FREE_STRETCH_S = 15.0  # a longer stretch without steps is a flight of its own
_PAUSE_S = 1.0
_IDLE = 0.02
_MANY = 2  # times as many steps by hand's tolerance as by a script's: then no script was flown
_FEW_STEPS = 3  # a flight with fewer steps than this is a free flight that happens to hold still


def cut(recording: Recording) -> tuple[Segment, ...]:
    """All segments of a recording in order of time, usable or not (see `Segment.flaws`)."""
    aligned = prepare_motion(recording)
    if aligned is None or aligned.t_s.size < 5:
        return ()
    references = ed.references_of(recording)
    marks = marked(recording)
    found = _by_marks(references, marks, aligned) if marks else []
    found += _by_references(recording, references, aligned, marks, [response for response, _ in found])
    cutter = _Cutter(recording, references, aligned)
    segments = [cutter.segment(response, mark) for response, mark in found]
    return _named(s for s in segments if s.usable or not s.between_steps)


def _responses(references: References | None, exact: Tolerance = EXACT) -> list[tuple[list[ed.Plateau], list[ed.Edge]]]:
    if references is None or references.t_s.size < 2:
        return []
    found = ed.chains(ed.plateaus(references, exact), exact, references.period_s)
    by_hand = ed.chains(ed.plateaus(references, BY_HAND), BY_HAND, references.period_s)
    # Sticks are moved on the ground too, before take-off and between flights: there throttle comes up from nothing.
    by_hand = [
        (row, edges) for row, edges in by_hand if not any(row[e.before].values[ed.THROTTLE] <= _IDLE for e in edges)
    ]
    # One constant target makes no script: steps beside a throttle that drifts are found with the tolerance for flights by hand only.
    if _MANY * _steps_of(found) > _steps_of(by_hand):
        return found
    # A throttle that rests and moves on is a step where roll and pitch are asked to stay. Where that was not recorded a position loop flies
    # so: its throttle of 0.71 to 0.74 made five "steps" of figures of eight, between which 20 s of 55 were not used.
    return by_hand if np.isfinite(references.values[:, [ed.ROLL, ed.PITCH]]).any(axis=0).all() else []


def _steps_of(rows: Sequence[tuple[list[ed.Plateau], list[ed.Edge]]]) -> int:
    return sum(len(edges) for _, edges in rows)


def _by_marks(
    references: References | None, marks: Sequence[Marked], aligned: Aligned
) -> list[tuple[FoundStep, Marked | None]]:
    rows = _responses(references)
    every = [(r, row, edges) for row, edges in rows for r in ed.responses(row, edges)]
    found: list[tuple[FoundStep, Marked | None]] = []
    for mark in marks:
        if mark.t_step_s is not None:
            response = _at_step(rows, mark)
            found.append((response or _missed(mark, mark.t_step_s), mark))
            continue
        late = min(mark.start_s + _MARK_LATE_S, mark.end_s)
        near = [
            r for r, _, _ in every
            if mark.start_s - _MARK_EARLY_S <= r.t_step_s < late and (not mark.kinds or r.kind in mark.kinds)
        ]  # fmt: skip
        if mark.numbered:
            near = _in_piece(references, mark)
        if near and (mark.record_s is None or mark.numbered):
            found.append((near[0], mark))
        elif mark.record_s is not None:
            spans = _recorded(aligned, references, *mark.record_s)
            found += [(window, mark) for span in spans for window in windows(*span)]
        elif mark.kinds:
            found.append((_missed(mark, mark.start_s), mark))
    return found


def _at_step(rows: Sequence[tuple[list[ed.Plateau], list[ed.Edge]]], mark: Marked) -> FoundStep | None:
    """The response whose step is nearest to where a mark puts it, up to the end of its chain or of the mark."""
    assert mark.t_step_s is not None
    best: tuple[float, FoundStep] | None = None
    for row, edges in rows:
        for k, edge in enumerate(edges):
            distance = abs(edge.t_s - mark.t_step_s)
            if distance > _MARK_EARLY_S or (best is not None and distance >= best[0]):
                continue
            if edge.channel == ed.THROTTLE:
                response = ed.throttle_response(row, edges, k)
            else:
                last = max(
                    j
                    for j, e in enumerate(edges)
                    if j == k or (e.channel == edge.channel and k < j and e.t_s < mark.end_s)
                )
                response = ed.step_response(row, edges, k, last)
            if mark.kinds and response.kind not in mark.kinds:
                continue
            best = distance, replace(response, end_s=min(response.end_s, max(mark.end_s, response.t_step_s)))
    return best[1] if best is not None else None


def _in_piece(references: References | None, mark: Marked) -> list[FoundStep]:
    """Responses inside a numbered piece of a table, which may begin only just before its step."""
    if references is None:
        return []
    inside = (references.t_s >= mark.start_s - 1e-9) & (references.t_s < mark.end_s)
    piece = replace(references, t_s=references.t_s[inside], values=references.values[inside])
    found = [r for row, edges in _responses(piece, IN_PIECE) for r in ed.responses(row, edges)]
    return [replace(r, end_s=min(r.end_s, mark.end_s)) for r in found]


def _missed(mark: Marked, t_s: float) -> FoundStep:
    """A marked step of which the references show nothing clean: kept, so that its absence is seen."""
    end = min(mark.end_s, t_s + 1.5)
    kind = mark.kinds[0] if mark.kinds else "free"
    return FoundStep(kind, {}, t_s, t_s - 0.3, max(end, t_s))


def _by_references(
    recording: Recording,
    references: References | None,
    aligned: Aligned,
    marks: Sequence[Marked],
    marked: Sequence[FoundStep],
) -> list[tuple[FoundStep, Marked | None]]:
    """Steps beside the marks, and windows of what neither of them holds. marked: the responses of the marks."""
    spans = _flown_with_targets(recording, references)
    every = [r for row, edges in _responses(references) for r in ed.responses(row, edges)]
    steps = [replace(r, end_s=min(r.end_s, b)) for r in every for a, b in spans if a <= r.start_s and r.t_step_s < b]
    # What a mark's own leg does beside its step (its onset, its return) is no step of its own.
    steps = [r for r in steps if not any(m.start_s - _MARK_EARLY_S <= r.t_step_s < m.end_s for m in marks)]
    if len(steps) < _FEW_STEPS and not marks:
        steps, whole = [], list(spans)
    else:
        whole = [rest for span in spans for rest in _without(span, (*marked, *steps))]
    # Between steps the vehicle holds still for a while, of which little is learnt, or is brought back, which is free flight too.
    free = [
        replace(window, between=bool(marks or steps) and b - a < _FREE_STRETCH_S)
        for a, b in whole
        for piece in _recorded(aligned, references, a, b)
        for window in windows(*piece)
        if b - a >= _FREE_STRETCH_S or not (marks or steps) or ed.reference_moves(references, window)
    ]
    return [(r, None) for r in (*steps, *free)]


def _flown_with_targets(recording: Recording, references: References | None) -> tuple[tuple[float, float], ...]:
    """(begin, end) of each flight, s, as far as targets came where they are repeated: where none came, what was asked for is not known."""
    spans = flights(recording)
    if references is None or not references.streamed:
        return spans
    known = references.t_s[np.isfinite(references.values).any(axis=1)]
    if not known.size:
        return spans
    first, last = float(known[0]), float(known[-1]) + references.period_s
    return tuple((max(a, first), min(b, last)) for a, b in spans if a < last and first < b) or spans


def _without(span: tuple[float, float], taken: Iterable[FoundStep]) -> list[tuple[float, float]]:
    """What responses leave of a stretch."""
    found, begin = [], span[0]
    for r in sorted(taken, key=lambda r: r.start_s):
        if begin < min(r.start_s, span[1]):
            found.append((begin, min(r.start_s, span[1])))
        begin = max(begin, r.end_s)
    return [*found, (begin, span[1])] if begin < span[1] else found


def _recorded(
    aligned: Aligned, references: References | None, start_s: float, end_s: float
) -> list[tuple[float, float]]:
    """The parts of a stretch in which samples were recorded and what shows in them was asked for by known targets: a log that pauses
    between flights gives no windows there, and after a take-over the vehicle still does for a while what somebody else wanted."""
    t = aligned.t_s[(aligned.t_s >= start_s) & (aligned.t_s <= end_s)]
    if t.size < 2:
        return []
    pauses = np.flatnonzero(np.diff(t) > _PAUSE_S)
    first = start_s if t[0] - start_s <= _PAUSE_S else float(t[0])
    last = end_s if end_s - t[-1] <= _PAUSE_S else float(t[-1])
    bounds = [first, *(x for i in pauses for x in (float(t[i]), float(t[i + 1]))), last]
    pieces = [(_known_from(references, a), b) for a, b in zip(bounds[::2], bounds[1::2], strict=True)]
    return [(a, b) for a, b in pieces if a < b]


def _known_from(references: References | None, start_s: float) -> float:
    """The first moment from start_s on at which the targets of the last `_DELAY_MAX_S` are known; start_s where none are repeated."""
    if references is None or not references.streamed:
        return start_s
    known = references.t_s[np.isfinite(references.values).any(axis=1)]
    if not known.size:
        return start_s
    i = min(int(np.searchsorted(known, start_s)), known.size - 1)
    silent = np.flatnonzero(np.diff(known[: i + 1]) > _PAUSE_S)
    begun = float(known[silent[-1] + 1] if silent.size else known[0])
    return max(start_s, begun + _DELAY_MAX_S)


def windows(start_s: float, end_s: float, length_s: float = WINDOW_S) -> list[FoundStep]:
    """Consecutive windows of free flight; a short rest at the end joins the last one or is left."""
    count = int((end_s - start_s) / length_s)
    if count == 0:
        return [FoundStep("free", {}, start_s, start_s, end_s)] if end_s - start_s >= _SHORTEST_WINDOW_S else []
    bounds = start_s + length_s * np.arange(count + 1)
    if end_s - bounds[-1] >= _SHORTEST_WINDOW_S:
        bounds = np.append(bounds, end_s)
    return [FoundStep("free", {}, float(a), float(a), float(b)) for a, b in pairwise(bounds)]


def _median_throttle(references: References | None, flown: Sequence[tuple[float, float]]) -> float | None:
    """Over the time in the air; None where no throttle was recorded there."""
    if references is None:
        return None
    throttle = references.values[:, INPUTS.index("throttle")]
    held_s = np.zeros(throttle.size)
    for begin, end in flown:
        held_s += np.diff(np.clip(references.t_s, begin, end), append=end)
    held_s[~np.isfinite(throttle)] = 0.0
    order = np.argsort(throttle)
    reached = np.cumsum(held_s[order])
    if not reached.size or reached[-1] <= 0.0:
        return None
    return float(throttle[order][np.searchsorted(reached, 0.5 * reached[-1])])


class _Cutter:
    """Makes segments of one recording."""

    def __init__(self, recording: Recording, references: References | None, aligned: Aligned) -> None:
        self.recording = recording
        self.references = references
        self.aligned = aligned
        self.streamed = "roll_ref_rad" not in recording.provenance.derived
        up = [m.t_s for m in recording.markers if m.label == "take-off"]
        flown = flights(recording)
        self.takeoffs_s = up[:1] or list(takeoffs(recording))
        self.hover_throttle = _median_throttle(references, flown)
        self.lost = control_lost(recording)

    def segment(self, response: FoundStep, mark: Marked | None) -> Segment:
        t_s, y = sample(self.aligned, response.start_s, response.end_s)
        flaws, notes = flaws_of(self.recording, self.references, response, t_s, y, self.streamed)
        inputs = self._inputs(response)
        flaws = flaws if inputs else (*flaws, Flaw.NOTHING_ASKED)
        if any(a < response.end_s and response.start_s < b for a, b in self.lost):
            flaws = (*flaws, Flaw.CONTROL_LOST)
        if mark is not None and response.kind != "free" and not response.cell and Flaw.REFERENCE_MOVED not in flaws:
            flaws = (*flaws, Flaw.REFERENCE_MOVED)
        if mark is not None and mark.outcome not in ("", "FLOWN"):
            ended = _ENDED.get(mark.outcome, Flaw.ABORTED)
            recorded_s = response.end_s - response.t_step_s
            if mark.outcome == "REFUSED" and response.kind != "free" and recorded_s >= _ENOUGH_S:
                # Until the gate refused a target, the vehicle did what it was asked.
                if not flaws:
                    notes = (
                        f"the gate ended it {recorded_s:.2f} s after the step; what was recorded until then is used",
                    )
            elif ended not in flaws:
                flaws = (*flaws, ended)
        yaw = y["yaw_rad"] if "yaw_rad" in y else np.full(t_s.size, np.nan)
        known = np.flatnonzero(np.isfinite(yaw))
        heading = float(np.interp(response.t_step_s, t_s[known], yaw[known])) if known.size else float("nan")
        return Segment(
            name=mark.name if mark is not None else "",
            run=self.recording.name,
            kind=response.kind,
            cell=dict(response.cell),
            repeat=mark.repeat if mark is not None else 0,
            t_step_s=response.t_step_s,
            t_s=t_s,
            y=y,
            u=inputs,
            flaws=flaws,
            notes=notes,
            maneuver=(mark.maneuver if mark is not None and mark.maneuver else response.kind),
            heading_rad=float((heading + np.pi) % (2 * np.pi) - np.pi),
            time_since_takeoff_s=response.t_step_s - self._takeoff_s(response.t_step_s),
            context=self._context(response),
        )

    def _context(self, response: FoundStep) -> SegmentContext:
        provenance = self.recording.provenance
        error_s = provenance.clock.get("error_s")
        return SegmentContext(
            later_edges_s=response.later_edges_s,
            between_steps=response.between,
            by_hand=response.by_hand or response.kind == "free",
            filters=dict(provenance.filters),
            reference_clock=provenance.reference_clock,
            clock_error_s=None if error_s is None else float(error_s),
            edge_error_s=self._edge_error_s(),
            derived=dict(provenance.derived),
            compatibility=self.aligned.compatibility,
            voltage_samples=self._voltage_samples(response),
            hover_throttle=self.hover_throttle,
        )

    def _takeoff_s(self, t_s: float) -> float:
        """Of the flight that a time lies in; the time itself where the vehicle never flew."""
        return max((up for up in self.takeoffs_s if up <= t_s), default=self.takeoffs_s[0] if self.takeoffs_s else t_s)

    def _edge_error_s(self) -> float:
        """Half a row of a table: a row holds what was asked for last, since when within the row before was not recorded."""
        if self.recording.provenance.importer != "table":
            return 0.0
        rates = [s.rate_hz for s in self.recording.series.values() if len(s) > 2]
        return float(0.5 / max(rates, default=np.inf))

    def _voltage_samples(self, response: FoundStep) -> tuple[FloatArray, FloatArray] | None:
        """The battery's own samples about a response: at 10 Hz they are few, and the time base's values are chords between them."""
        battery = self.recording.series.get("battery")
        if battery is None or "voltage_v" not in battery.columns:
            return None
        reach = slice(*np.searchsorted(battery.t_s, [response.start_s - _REACH_BACK_S, response.end_s + _REACH_BACK_S]))
        return battery.t_s[reach], battery.columns["voltage_v"][reach]

    def _inputs(self, response: FoundStep) -> dict[str, tuple[FloatArray, FloatArray]]:
        """References as they changed, from the last change before the window's reach."""
        references = self.references
        if references is None:
            return {}
        a = max(int(np.searchsorted(references.t_s, response.start_s - _REACH_BACK_S, side="right")) - 1, 0)
        b = int(np.searchsorted(references.t_s, response.end_s, side="right"))
        out: dict[str, tuple[FloatArray, FloatArray]] = {}
        for i, name in enumerate(INPUTS):
            values = references.values[a:b, i]
            known = np.isfinite(values)
            # What was asked for before a stretch without any target is over; the first target after it stands for that stretch.
            # A hole inside the response is a flaw of it (`quality`); the last target stands for the hole.
            before = np.flatnonzero(~known & (references.t_s[a:b] <= response.start_s))
            if before.size and known[before[-1] :].any():
                known[: before[-1]] = False
            if known.any():
                edges = ed.compressed(references.t_s[a:b][known], values[known])
                out[name] = ed.between_polls(*edges) if name in self.recording.provenance.polled else edges
        return out


def _named(segments: Iterable[Segment]) -> tuple[Segment, ...]:
    """Repeats share a cell (the first one's numbers); names are unique; repeats are counted where no mark numbers them."""
    cells: dict[str, list[dict[str, float]]] = {}
    counted: Counter[object] = Counter()
    used: Counter[str] = Counter()
    out: list[Segment] = []
    for segment in sorted(segments, key=lambda s: s.t_step_s):
        known = cells.setdefault(segment.kind, [])
        cell = next((c for c in known if _same(c, dict(segment.cell))), None)
        if cell is None:
            cell = {name: round(value, 4) for name, value in segment.cell.items()}
            known.append(cell)
        segment = replace(segment, cell=cell)
        counted[segment.cell_key] += 1
        label = segment.name or _label(segment)
        used[label] += 1
        name = label if used[label] == 1 else f"{label} #{used[label]}"
        out.append(replace(segment, name=name, repeat=segment.repeat or counted[segment.cell_key]))
    return tuple(out)


def _same(a: dict[str, float], b: dict[str, float]) -> bool:
    return a.keys() == b.keys() and all(abs(a[k] - b[k]) <= _SAME_CELL.get(k, 1e-3) for k in a)


def _label(segment: Segment) -> str:
    if segment.kind == "free":
        return "free"
    values = segment.cell
    if "throttle_0" in values:
        return f"{segment.kind} {values['throttle_0']:.2f}-{values['throttle_1']:.2f}"
    return f"{segment.kind} {next(iter(values.values())):+.2f}"
