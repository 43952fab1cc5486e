"""One part of the model by prediction errors (`equation_search`), and what the diagnosis reports of it.

Flights are compared in the frame of their own air: in a steady horizontal wind w the motion is that of velocity v - w in still air, so
that one model without wind is fitted, drawn and written for flights in several winds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flighttest.diagnose.answer import SEED, TOGETHER, Asked, PartAnswer, merged
from flighttest.diagnose.free_flight.equation_search import PART_IN_WORDS, EquationSearch, find_terms
from flighttest.diagnose.free_flight.prediction import held_out_table
from flighttest.diagnose.free_flight.reported import (
    candidates_of,
    findings_of,
    held_at_null,
    notes_of_search,
    smallest_of,
    table_of,
)
from flighttest.diagnose.model import Finding, Untestable, short
from flighttest.diagnose.records import WITH_GUSTS, FloorRow, ParameterRow
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, NoiseFloor, floor_of
from flighttest.diagnose.residuals.locate import locate, overlays, regime_curves, residual_map
from flighttest.diagnose.selection.detectability import missing_channels, why_unseen
from flighttest.errors import FitError
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import Linearisation
from flighttest.identify.free_flight import FreeFlight, stretches
from flighttest.identify.free_flight.winds import WIND_TERM, FlightWind, in_still_air
from flighttest.identify.selection import able
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FROM_EQUATIONS = "what is left beside every variable recorded: gusts and noise of the free flight itself"
ONE_HEADING = "at one heading a wind and an attitude offset tilt the vehicle alike"
NO_COLUMN = "the accelerometer shows forces without the velocity, whose latency is then in the drag alone"


@dataclass
class PredictionErrorAnswer(PartAnswer):
    """Of a search as it ended."""

    search: EquationSearch = field(kw_only=True)

    def findings(self, asked: Asked, table: Mapping[str, ParameterRow]) -> list[Finding]:
        """Of every named term beside the rest of the model."""
        del asked
        return findings_of(self.search, self.heldout, table)


def by_prediction_errors(part: str, asked: Asked, winds: Sequence[FlightWind] = ()) -> PartAnswer:
    """Search one part of the model on the stretches of what was asked about. winds: of each flight, as the translation showed them.

    FitError where the translation cannot be estimated. An interrupt (KeyboardInterrupt) ends the search; what is known is reported.
    """
    loops = part != "translation"
    # Moments of the air are by the velocity through it.
    segments = in_still_air(asked.segments, winds) if loops else asked.segments
    model = asked.model if loops else replace(asked.model, attitude_loops=False)
    start = {k: v[0] for k, v in asked.previous.items()}
    try:
        search = find_terms(
            stretches(segments, part), model, asked.pool, part=part, weather=asked.weather, start=start, support=asked.support,
        )  # fmt: skip
    except FitError:
        if not loops:
            raise
        return PartAnswer(notes=[f"nothing in this recording moves the {PART_IN_WORDS[part]}: it is left out"])
    made = PredictionErrorAnswer(complete=search.complete, search=search, held=search.final.held, winds=search.winds)
    made.error = WITH_GUSTS
    made.null = merged(held_at_null(search, t) for t in asked.pool if t.id in search.final.model.terms)
    made.terms = tuple(t for t in search.final.model.terms if t not in model.terms and t != WIND_TERM)
    made.accepted = {t: n.nats for t, n in search.named.items()}
    known = {*search.named, *search.refused, *made.terms, *(one.term for one in search.screened)}
    made.tried = frozenset({*known, *({WIND_TERM} & {*search.offered})})
    made.notes = notes_of_search(search)
    made.before = table_of(search.base, asked.model)
    made.heldout = held_out_table(search.flown, search.base, search.final) if search.named else {}
    made.candidates = candidates_of(search)
    for term, name, size in smallest_of(search, asked.pool):
        made.levels[term.id] = size, name
        if why := why_unseen(term, size, name):
            made.unseen.append(Untestable(term.id, why, term.reveals))
    if not (loops or search.turned or search.declared) and WIND_TERM in {*search.offered} - {*search.named}:
        made.unseen = [u for u in made.unseen if u.term != WIND_TERM]
        made.unseen.append(Untestable(WIND_TERM, ONE_HEADING, catalogue()[WIND_TERM].reveals))
    if not loops:
        made.unseen += [
            Untestable(t.id, NO_COLUMN, t.reveals)
            for t in asked.pool
            if block_of(t) == part and t.id not in search.offered and not missing_channels(t, asked.segments)
        ]
    _compare(made, asked.segments, segments if loops else in_still_air(segments, search.winds))
    return made


def _compare(made: PredictionErrorAnswer, segments: tuple[Segment, ...], air: tuple[Segment, ...]) -> None:
    """Put into an answer where its part of the model and the recordings differ before the search (segments) and after it (air)."""
    search = made.search
    final = search.final.model.without_terms(WIND_TERM) if search.winds else search.final.model
    before, after = _rows(segments, search.base, search.base.model), _rows(air, search.final, final)
    floor = free_flight_floor(after, air)
    made.located = locate(before, segments, floor, SEED)
    made.staying = {p.channel for p in locate(after, air, floor, SEED) if p.regime}
    made.shares = {TOGETHER: _share_left(before, after, floor)}
    made.floors = {short(c): FloorRow({"value": v, "from": FROM_EQUATIONS}) for c, v in floor.std.items()}
    made.cells = residual_map(before, after, segments, floor)
    made.curves = regime_curves(made.located, before, after, segments)
    made.overlaid = overlays(before, after, segments)


def _share_left(before: Linearisation, after: Linearisation, floor: NoiseFloor) -> float:
    """Of the squared error of all channels, each in its noise floors, what stays: as that floor is what is left, nothing is above it."""
    first, last = (
        sum(
            float(np.mean(rows.unprofiled_residual[rows.channel == c] ** 2)) / floor.of(name) ** 2
            for c, name in enumerate(rows.channels)
        )
        for rows in (before, after)
    )
    return min(last / first, 1.0) if first > 0.0 else 1.0


def free_flight_floor(rows: Linearisation, segments: Sequence[Segment]) -> NoiseFloor:
    """The floor of free flight: what the final model leaves of each channel is its noise, whatever its spectrum.

    What a variable orders in it is no noise, and is still found by `locate`. Never below what sensors resolve.
    """
    least = floor_of(rows, segments, RESOLUTION)
    left = {
        name: float(np.sqrt(np.mean(rows.unprofiled_residual[rows.channel == c] ** 2)))
        for c, name in enumerate(rows.channels)
    }
    return NoiseFloor({c: max(v, left.get(c, 0.0)) for c, v in least.std.items()}, frozenset(), {})


def _rows(segments: tuple[Segment, ...], found: FreeFlight, model: Model) -> Linearisation:
    """Residuals of the windows at an estimate, their own noise and disturbances found. Without the rows that only residuals' maps need, a
    diagnosis of an hour would not be one of seconds."""
    estimator = Estimator(segments, found.part, able)
    at = estimator.fit(model, estimator.start(model, {n: v for n, v in found.values.items() if n in model.names}), [])
    return estimator.linearise(model, at, [])
