"""Diagnosis of free flight: every part of the model by its prediction errors (`equation_search`).

Flights are compared in the frame of their own air: in a steady horizontal wind w the motion is that of velocity v - w in still air, so
that one model without wind is fitted, drawn and written for flights in several winds. The final model keeps the values and errors of
these estimates; output error evaluates it over the windows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flighttest.diagnose.block import SEED, merged
from flighttest.diagnose.conclusion import (
    UNMOVED,
    UNTRIED,
    compensated_voltage,
    moved_parameters,
    predicted_worse,
    sentence_of,
    verdict_of,
)
from flighttest.diagnose.findings import parameter_table
from flighttest.diagnose.free_flight.equation_search import PART_IN_WORDS, EquationSearch, find_terms
from flighttest.diagnose.free_flight.prediction import groups_left_out, held_out_table
from flighttest.diagnose.free_flight.reported import candidates_of, findings_of, notes_of_search, smallest_of, table_of
from flighttest.diagnose.mass import mass_test
from flighttest.diagnose.model import Diagnosis, Located, Untestable, short
from flighttest.diagnose.records import FloorRow, MapCell, Overlay, RegimeCurve
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, NoiseFloor, floor_of
from flighttest.diagnose.residuals.locate import locate, regime_curves, residual_map
from flighttest.diagnose.residuals.overlays import overlays
from flighttest.diagnose.selection.detectability import UNSEEN, missing_channels, why_unseen
from flighttest.diagnose.selection.held_out import excess
from flighttest.errors import FitError
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import Linearisation
from flighttest.identify.fit import has_attitude_references
from flighttest.identify.free_flight import FreeFlight, stretches
from flighttest.identify.free_flight.equation_fit import fit_of_estimates
from flighttest.identify.free_flight.winds import WIND_TERM, in_still_air, wind_rows
from flighttest.identify.selection import able
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

FROM_EQUATIONS = "what is left beside every variable recorded: gusts and noise of the free flight itself"
NO_COLUMN = "the accelerometer shows forces without the velocity, whose latency is then in the drag alone"
LOOPS = ("roll_pitch", "yaw")


def diagnose_free_flight(
    segments: Sequence[Segment],
    model: Model,
    *,
    previous: Mapping[str, tuple[float, float | None]] | None = None,
    weather: Mapping[str, str] | None = None,
    only: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """The diagnosis of recordings that are free flight alone (`is_free_flight`).

    model: the base; previous: its parameters, name to (value, std), where it was fitted before; weather: flight to 'still'; only: ids
    of the candidates. FitError where there is nothing to estimate from.
    """
    usable = tuple(s for s in segments if s.usable and s.t_s.size >= 8)
    flown = stretches(usable)
    model = replace(model, attitude_loops=has_attitude_references(usable))
    pool = tuple(
        t
        for t in catalogue().values()
        if t.id not in model.terms and (only is None or t.id in only) and block_of(t) != "delay"
    )
    start = {k: v[0] for k, v in (previous or {}).items()}
    parts = ("translation", *(LOOPS if model.attitude_loops else ()))
    searches: list[EquationSearch] = []
    notes = []
    for part in parts:
        of = replace(model, attitude_loops=False) if part == "translation" else model
        if part == LOOPS[0]:  # moments of the air are by the velocity through it
            flown = stretches(in_still_air(usable, searches[0].winds))
        try:
            searches.append(find_terms(flown, of, pool, part=part, weather=weather, start=start, progress=progress))
        except FitError:
            if part == "translation":
                raise
            notes.append(f"nothing in this recording moves the {PART_IN_WORDS[part]}: it is left out")
        except KeyboardInterrupt:
            if not searches:
                raise
            searches[-1].complete = False
        if not searches[-1].complete:
            break
    return _Assembly(usable, model, pool, searches, notes, progress).made(previous or {})


class _Assembly:
    """One diagnosis of what the searches of the parts show, the translation first."""

    def __init__(
        self,
        segments: tuple[Segment, ...],
        model: Model,
        pool: tuple[Term, ...],
        searches: Sequence[EquationSearch],
        notes: Sequence[str],
        progress: Callable[[str], None],
    ) -> None:
        self.segments, self.model, self.pool, self.searches, self.progress = segments, model, pool, searches, progress
        self.notes = notes
        self.found = searches[0]
        self.complete = all(s.complete for s in searches)
        joined = (t for s in searches for t in s.final.model.terms if t not in model.terms and t != WIND_TERM)
        self.final = model.with_terms(*joined)
        self.air = in_still_air(segments, self.found.winds)

    def made(self, previous: Mapping[str, tuple[float, float | None]]) -> Diagnosis:
        """Everything that terminal, JSON and report show."""
        self.progress(f"fitting {' + '.join(self.final.terms)}")
        fitted = fit_of_estimates(self.air, self.final, [s.final for s in self.searches])
        compared = [_Compared.of(s, self.segments, self.air, self.model, self.final) for s in self.searches]
        located = [place for c in compared for place in c.places]
        staying = [place for c in compared for place in c.left]
        shares = [share for c in compared for share in c.shares]
        share = float(np.mean(shares)) if shares else float(bool(staying))
        tables = [held_out_table(s.flown, s.base, s.final) if s.named else {} for s in self.searches]
        held = merged(tables)
        before = merged(table_of(s.base, self.model) for s in self.searches)
        after = parameter_table(fitted)
        findings = [f for s, t in zip(self.searches, tables, strict=True) for f in findings_of(s, t, after)]
        unseen, levels = self._unseen()
        verdict = verdict_of(bool(findings), share, bool(located), bool(staying))
        accepted = tuple(t for s in self.searches for t in s.named)
        tried = {t for s in self.searches for t in s.offered}
        hidden = {u.term: u.why for u in unseen}
        units = {p.name: p.unit for t in self.pool for p in t.params}
        return Diagnosis(
            verdict=verdict,
            sentence=sentence_of(verdict, findings, share, located, self.complete)
            + predicted_worse(held)
            + moved_parameters(previous, after),
            located=tuple(located),
            findings=tuple(findings),
            not_needed=tuple(sorted(tried - set(accepted) - set(hidden) - set(self.found.beside_wind))),
            untestable=tuple(unseen),
            unexplained={"excess_share": float(min(share, 1.0)) if located else 0.0},
            smallest_detectable={k: v for k, (v, _) in levels.items() if np.isfinite(v) and hidden.get(k) != UNSEEN},
            smallest_units={k: name if units.get(name, "1") == "1" else f"{units[name]} ({name})" for k, (_, name) in levels.items()},
            model=self.final,
            values={k: v for k, v in fitted.values.items() if k in self.final.names},
            fit=fitted,
            accepted=accepted,
            before=before,
            after=after,
            heldout=held,
            noise_floor={
                short(c): FloorRow({"value": v, "from": FROM_EQUATIONS}) for each in compared for c, v in each.floor.std.items()
            },
            baselines={},
            residual_map=tuple(cell for c in compared for cell in c.cells),
            regimes=tuple(curve for c in compared for curve in c.curves),
            overlays=tuple(one for c in compared for one in c.overlaid),
            candidates=tuple(row for s in self.searches for row in candidates_of(s, hidden)),
            cost={"added_parameters": len(after) - len(before), "held_out_groups": groups_left_out(self.found.final)[1]},
            mass=mass_test(previous, {n: (row["value"], row["scatter"]) for n, row in after.items()}),
            notes=(*self.notes, *(n for s in self.searches for n in notes_of_search(s)), *compensated_voltage(after)),
            complete=self.complete,
            runs=tuple(dict.fromkeys(s.run for s in self.segments)),
            winds=tuple(wind_rows(self.found.winds, self.found.declared)),
        )  # fmt: skip

    def _unseen(self) -> tuple[list[Untestable], dict[str, tuple[float, str]]]:
        """What could not be seen and why; of the rest the smallest coefficient that would have been named."""
        unseen: list[Untestable] = []
        levels: dict[str, tuple[float, str]] = {}
        for s in self.searches:
            for term, name, size in smallest_of(s, self.pool):
                levels[term.id] = size, name
                if why := why_unseen(term, size, name):
                    unseen.append(Untestable(term.id, why, term.reveals))
        # Where every flight was declared still, nothing is asked of the wind.
        words = {WIND_TERM, *self.final.terms, *(u.term for u in unseen)}
        words |= {t for s in self.searches for t in (*s.named, *s.refused, *(one.term for one in s.screened))}
        return unseen + [self._not_tried(t) for t in self.pool if t.id not in words], levels

    def _not_tried(self, term: Term) -> Untestable:
        if missing := missing_channels(term, self.segments):
            return Untestable(term.id, f"not recorded: {', '.join(missing)}", term.reveals, False)
        if block_of(term) == "translation" and term.id not in self.found.offered:
            return Untestable(term.id, NO_COLUMN, term.reveals)
        return Untestable(term.id, UNMOVED if self.complete else UNTRIED, term.reveals)


@dataclass(frozen=True)
class _Compared:
    """Where one part of the model and the recordings differ before its search (places, shares: of each channel's excess what stays) and
    after (left); floor: what is noise of it."""

    places: list[Located]
    left: list[Located]
    shares: list[float]
    floor: NoiseFloor
    cells: list[MapCell]
    curves: list[RegimeCurve]
    overlaid: list[Overlay]

    @classmethod
    def of(
        cls,
        search: EquationSearch,
        segments: tuple[Segment, ...],
        air: tuple[Segment, ...],
        model: Model,
        final: Model,
    ) -> _Compared:
        """segments, model: before; air, final: after."""
        before, after = _rows(segments, search.base, model), _rows(air, search.final, final)
        floor = free_flight_floor(after, air)
        places = locate(before, segments, floor, SEED)
        # Of mean squares above the floor where they are: as the floor is what is left, often none.
        above, first, last = {p.channel for p in places}, excess(before, floor), excess(after, floor)
        return cls(
            places,
            [p for p in locate(after, air, floor, SEED) if p.regime],
            [min(last[n] / e, 1.0) for n, e in first.items() if short(n) in above and e > 0],
            floor,
            residual_map(before, after, segments, floor),
            regime_curves(places, before, after, segments),
            overlays(before, after, segments),
        )


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
    if found.part == "translation":
        model = replace(model, attitude_loops=False)
    estimator = Estimator(segments, found.part, able)
    at = estimator.fit(model, estimator.start(model, {n: v for n, v in found.values.items() if n in model.names}), [])
    return estimator.linearise(model, at, [])
