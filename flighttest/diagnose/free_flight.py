"""Diagnosis of free flight: translation by equation error (`equation_search`), attitude loops by output error on part of the windows.

Flights are compared in the frame of their own air: in a steady horizontal wind w the motion is that of velocity v - w in still air, so
that one model without wind is fitted, drawn and written for flights in several winds. The final model's translation keeps the values
and errors of the equation error estimate; output error evaluates it over the windows and fits the attitude loops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from flighttest.diagnose.block import SEED, Answer, Asked, answer
from flighttest.diagnose.equation_search import OFFSET_TERM, EquationSearch, NamedByEquations, find_terms
from flighttest.diagnose.findings import finding, parameter_table
from flighttest.diagnose.mass import mass_test
from flighttest.diagnose.model import Diagnosis, Finding, Rival, TermVerdict, Untestable, brief, short
from flighttest.diagnose.records import CandidateRow, FlightWindRow, FloorRow, HeldOutRow, ParameterRow
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, NoiseFloor, floor_of
from flighttest.diagnose.residuals.locate import locate, regime_curves, residual_map
from flighttest.diagnose.residuals.overlays import overlays
from flighttest.diagnose.run import UNMOVED, compensated_voltage, moved_parameters, sentence_of, verdict_of
from flighttest.diagnose.selection.candidates import usual_size
from flighttest.diagnose.selection.detectability import PLAUSIBLE, POWER, UNSEEN, missing_channels
from flighttest.diagnose.selection.held_out import excess, held_out_groups
from flighttest.estimation.equation_error import Whitened, block_rows, whiten
from flighttest.estimation.estimator import Estimator
from flighttest.estimation.linearisation import FloatArray, Linearisation
from flighttest.estimation.solver import Start, solve
from flighttest.estimation.uncertainty.covariance import Covariance, interval_factor
from flighttest.estimation.uncertainty.distributions import normal_quantile
from flighttest.identify.diagnostics.identifiability import Estimated, judge
from flighttest.identify.fit import Estimate, Fit, fit, has_attitude_references
from flighttest.identify.free_flight import FreeFlight, stretches
from flighttest.identify.motion_equations import Equations
from flighttest.identify.selection import able, problem_of
from flighttest.identify.winds import CHANCE, WIND_TERM
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

SHORTEST_S = 30.0  # of stretches: below, 30 blocks of a second do not carry a sandwich over a dozen parameters
ATTITUDE_WINDOWS = 40  # that the attitude loops are searched on: 100 s of windows
MEANS_S = 0.5  # residuals are held out as means over this long: shorter ones are noise of differentiated velocity
DRAWS = 200
FROM_EQUATIONS = "what is left beside every variable recorded: gusts and noise of the free flight itself"
NO_COLUMN = (
    "free flight by equation error does not show it: its state has an unknown start, or it has no linear coefficient"
)


def is_free_flight(segments: Sequence[Segment]) -> bool:
    """Whether every usable segment is a window of free flight, and stretches of `SHORTEST_S` or more can be estimated from."""
    usable = [s for s in segments if s.usable]
    if not usable or any(s.kind != "free" for s in usable):
        return False
    return sum(float(np.ptp(s.t_s)) for s in stretches(usable)) >= SHORTEST_S


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
    loops = has_attitude_references(usable)
    model = replace(model, attitude_loops=loops)
    pool = tuple(
        t
        for t in catalogue().values()
        if t.id not in model.terms and (only is None or t.id in only) and block_of(t) != "delay"
    )
    translation = tuple(t for t in pool if block_of(t) == "translation")
    start = {k: v[0] for k, v in (previous or {}).items()}
    alone = replace(model, attitude_loops=False)
    found = find_terms(flown, alone, translation, weather=weather, start=start, progress=progress)
    answers, asked = _attitude(usable, model, pool, found, previous or {}, progress)
    return _Assembly(usable, model, pool, found, answers, asked, progress).made(previous or {})


def in_still_air(segments: Sequence[Segment], found: EquationSearch) -> tuple[Segment, ...]:
    """Segments in the frame of their flight's air: velocity less the wind, position less its way since the segment's start."""
    winds = {w.flight: (w.north, w.west) for w in found.winds}
    made = []
    for s in segments:
        wind, y = winds.get(s.run), dict(s.y)
        if wind is not None:
            for axis, w in zip("xy", wind, strict=True):
                if f"v_{axis}_m_s" in y:
                    y[f"v_{axis}_m_s"] = y[f"v_{axis}_m_s"] - w
                if f"p_{axis}_m" in y:
                    y[f"p_{axis}_m"] = y[f"p_{axis}_m"] - w * (s.t_s - s.t_s[0])
        made.append(replace(s, y=y))
    return tuple(made)


def values_of(found: FreeFlight, model: Model) -> dict[str, float]:
    """Estimated values by name under a model without the winds of single flights; what was held as well."""
    return {n: v for n, v in found.values.items() if n in model.names and "@" not in n and not n.startswith("w_")}


def _spread_out(segments: Sequence[Segment], most: int) -> tuple[Segment, ...]:
    """At most so many segments, evenly over all flights and times."""
    if len(segments) <= most:
        return tuple(segments)
    return tuple(segments[i] for i in np.linspace(0, len(segments) - 1, most).round().astype(int))


def _attitude(
    segments: tuple[Segment, ...],
    model: Model,
    pool: tuple[Term, ...],
    found: EquationSearch,
    previous: Mapping[str, tuple[float, float | None]],
    progress: Callable[[str], None],
) -> tuple[list[Answer], Asked | None]:
    """The search of the attitude loops, as in any diagnosis, on `ATTITUDE_WINDOWS` windows."""
    if not model.attitude_loops:
        return [], None
    some = _spread_out(segments, ATTITUDE_WINDOWS)
    progress("fitting the attitude loops")
    base = fit(some, model, select="all", frozen=_held(found.base, model), robust=False)
    groups, _ = held_out_groups(some)
    asked = Asked(some, model, pool, base, groups, previous, progress)
    answers = []
    for block in ("roll_pitch", "yaw"):
        try:
            answers.append(answer(block, asked))
        except KeyboardInterrupt:
            answers.append(Answer(complete=False))
            break
    return answers, asked


def _held(found: FreeFlight, model: Model) -> dict[str, float]:
    inside = {
        n: float(np.clip(v, model.param[n].lower, model.param[n].upper)) for n, v in values_of(found, model).items()
    }
    return {n: v for n, v in inside.items() if n not in ("T_d", "T_d_attitude", "T_d_yaw_rate")}


class _Assembly:
    """One diagnosis of what the equations and the attitude loops show."""

    def __init__(
        self,
        segments: tuple[Segment, ...],
        model: Model,
        pool: tuple[Term, ...],
        found: EquationSearch,
        answers: list[Answer],
        asked: Asked | None,
        progress: Callable[[str], None],
    ) -> None:
        self.segments, self.model, self.pool, self.found, self.progress = segments, model, pool, found, progress
        self.answers, self.asked = answers, asked
        self.searches = [a.search for a in answers if a.search is not None]
        self.complete = all(a.complete for a in answers)
        own = [t for t in found.final.model.terms if t not in model.terms and t != WIND_TERM]
        self.loops = [t for s in self.searches for t in s.evidence]
        self.final = model.with_terms(*own, *self.loops)
        self.air = in_still_air(segments, found)

    def made(self, previous: Mapping[str, tuple[float, float | None]]) -> Diagnosis:
        """Everything that terminal, JSON and report show."""
        found = self.found
        self.progress(f"fitting {' + '.join(self.final.terms)}")
        fitted = self._fit()
        # Without the rows that only residuals' maps need, a diagnosis of an hour would not be one of seconds.
        before_rows, after_rows = (
            self._rows(self.segments, found.base, self.model),
            self._rows(self.air, found.final, self.final),
        )
        floor = _floor(after_rows, self.air)
        places = locate(before_rows, self.segments, floor, SEED)
        left = [p for p in locate(after_rows, self.air, floor, SEED) if p.regime]
        first, last = excess(before_rows, floor), excess(after_rows, floor)
        above = {p.channel for p in places}
        shares = [min(last[n] / e, 1.0) for n, e in first.items() if short(n) in above and e > 0]
        shares += [s for a in self.answers for s in a.shares]
        share = float(np.mean(shares)) if shares else 0.0
        located = [*places, *(p for a in self.answers for p in a.located)]
        staying = [*left, *(c for a in self.answers for c in a.staying)]
        held = held_out_table(found) if found.named else {}
        before, after = _table(found.base, self.model), parameter_table(fitted)
        findings = [self._finding(n, held, after) for n in found.named.values()]
        findings += [
            finding(s, t, after, self.asked.groups, SEED) for s in self.searches for t in s.evidence if self.asked
        ]
        unseen, levels = self._unseen()
        verdict = verdict_of(bool(findings), share, bool(located), bool(staying))
        accepted = (*found.named, *self.loops)
        tried = {*found.offered, *(t.id for a in self.answers if a.complete and a.search for t in a.search.pool)}
        hidden = {u.term: u.why for u in unseen}
        units = {p.name: p.unit for t in self.pool for p in t.params}
        return Diagnosis(
            verdict=verdict,
            sentence=sentence_of(verdict, findings, share, located, self.complete) + moved_parameters(previous, after),
            located=tuple(located),
            findings=tuple(findings),
            not_needed=tuple(sorted(tried - set(accepted) - set(hidden) - set(found.beside_wind))),
            untestable=tuple(unseen),
            unexplained={"excess_share": float(min(share, 1.0)) if located else 0.0},
            smallest_detectable={k: v for k, (v, _) in levels.items() if k not in hidden},
            smallest_units={k: name if units.get(name, "1") == "1" else f"{units[name]} ({name})" for k, (_, name) in levels.items()},
            model=self.final,
            values={k: v for k, v in fitted.values.items() if k in self.final.names},
            fit=fitted,
            accepted=accepted,
            before=before,
            after=after,
            heldout={**held, **{k: v for a in self.answers for k, v in a.heldout.items()}},
            noise_floor={
                **{short(c): FloorRow({"value": v, "from": FROM_EQUATIONS}) for c, v in floor.std.items()},
                **{k: v for a in self.answers for k, v in a.floors.items()},
            },
            baselines={},
            residual_map=(
                *residual_map(before_rows, after_rows, self.segments, floor), *(c for a in self.answers for c in a.cells),
            ),
            regimes=(
                *regime_curves(places, before_rows, after_rows, self.segments), *(c for a in self.answers for c in a.curves),
            ),
            overlays=(*overlays(before_rows, after_rows, self.segments), *(o for a in self.answers for o in a.overlaid)),
            candidates=tuple(self._candidates(hidden)),
            cost={"added_parameters": len(after) - len(before), "held_out_groups": _groups(found)[1]},
            mass=mass_test(previous, {n: (row["value"], row["scatter"]) for n, row in after.items()}),
            notes=(*(n for a in self.answers for n in a.notes), *self._notes(), *compensated_voltage(after)),
            complete=self.complete,
            runs=tuple(dict.fromkeys(s.run for s in self.segments)),
            winds=tuple(_wind_rows(found)),
        )  # fmt: skip

    def _fit(self) -> Fit:
        """The final model: attitude loops by output error, the translation as the equations have it."""
        held = _held(self.found.final, self.final)
        shapes: dict[str, float] = {}
        start: dict[str, float] = {}
        for s in self.searches:
            assert s.now is not None
            start |= {n: v for n, v in s.now.at.values.items() if n in self.final.names and n not in held}
            shapes |= {n: start[n] for t in s.named for n in s.held(t) if n in start}
        made = fit(self.air, self.final, select="all", frozen={**held, **shapes}, start=start, robust=False)
        return with_equation_error(made, self.found.final)

    def _rows(self, segments: Sequence[Segment], found: FreeFlight, model: Model) -> Linearisation:
        """Residuals of the windows at the estimate, their own noise and disturbances found."""
        model = replace(model, attitude_loops=False)
        estimator = Estimator(tuple(segments), "translation", able)
        known = {n: v for n, v in found.values.items() if n in model.names}
        at = estimator.fit(model, estimator.start(model, known), [])
        return estimator.linearise(model, at, [])

    def _finding(
        self, named: NamedByEquations, held: Mapping[str, Mapping[str, HeldOutRow]], table: Mapping[str, ParameterRow]
    ) -> Finding:
        term = catalogue()[named.term]
        if named.term == WIND_TERM:
            rows = _table(self.found.final, None)
            parameters = {n: rows[n] for n in rows if n.startswith("w_")}
        else:
            parameters = {n: v for n, v in table.items() if self.final.term_of(n) == named.term}
        scale = {c: named.size[c] / self.found.final.rms[c] for c in named.size if self.found.final.rms.get(c)}
        channel = max(scale, key=lambda c: scale[c]) if scale else "a_z_m_s2"
        told = ", ".join(_told(n, v) for n, v in parameters.items())
        sentence = f"{term.plain} ({told}); {named.size.get(channel, 0.0):.2g} m/s^2 RMS of {short(channel)} beside the rest of the model"
        rivals = tuple(Rival(r, TermVerdict.CONFUSABLE, 1.0, _separated(r, named.term)) for r in named.rivals)
        if rivals:
            sentence += f"; {', '.join(r.term for r in rivals)} would explain it as well: {rivals[0].separated_by}"
        return Finding(
            term=named.term,
            title=term.title,
            family=term.family,
            verdict=TermVerdict.CONFUSABLE if rivals else TermVerdict.SUPPORTED,
            equation=term.equation,
            plain=term.plain,
            parameters=parameters,
            heldout={c: rows["all"] for c, rows in held.items()},
            evidence={
                "delta_bic": -2.0 * named.nats,
                "log_evidence": named.nats,
                "probability": 1.0 / (1.0 + float(np.exp(-min(named.nats, 700.0)))) / (1 + len(rivals)),
                "floors": float(scale.get(channel, 0.0)),
                "where": {"channel": short(channel), "kind": "free"},
                "heldout_gain": _gain(held.get(short(channel), {}).get("all")),
                "p_value": named.p_value,
                "rms_force_m_s2": float(np.sqrt(sum(v**2 for v in named.size.values()))),
                "rms_force_left_m_s2": None,
            },
            rivals=rivals,
            sentence=sentence,
            source=term.source,
            doubt=term.doubt,
        )

    def _unseen(self) -> tuple[list[Untestable], dict[str, tuple[float, str]]]:
        """What could not be seen and why; of the rest the smallest coefficient that would have been named."""
        found = self.found
        unseen = [u for a in self.answers for u in a.unseen]
        levels = {k: v for a in self.answers for k, v in a.levels.items()}
        asked = {t.id for a in self.answers if a.search for t in a.search.pool}
        least = -normal_quantile(0.5 * CHANCE / max(len(found.offered), 1)) + POWER
        known = {t.id: t for t in self.pool}
        for s in found.screened:
            sizes = {
                n: (least * e, least * e / abs(usual_size(p)))
                for p in known[s.term].amplitudes
                for n, e in s.std.items()
                if n == p.name and usual_size(p)
            }
            if not sizes:
                continue
            name = min(sizes, key=lambda n: sizes[n][1])
            levels[s.term] = sizes[name][0], name
            if sizes[name][1] > PLAUSIBLE:
                unseen.append(Untestable(s.term, UNSEEN, known[s.term].reveals))
        told = {*found.named, *self.loops, *asked, *(u.term for u in unseen), *(s.term for s in found.screened)}
        for t in self.pool:
            if t.id in told or t.id in found.refused or t.id in found.final.model.terms:
                continue
            missing = missing_channels(t, self.segments)
            if t.id == WIND_TERM:
                continue  # every flight was declared still
            if missing:
                unseen.append(Untestable(t.id, f"not recorded: {', '.join(missing)}", t.reveals, False))
            elif block_of(t) == "translation" and t.id not in found.offered:
                unseen.append(Untestable(t.id, NO_COLUMN, t.reveals))
            else:
                unseen.append(Untestable(t.id, UNMOVED, t.reveals))
        return unseen, levels

    def _candidates(self, hidden: Mapping[str, str]) -> list[CandidateRow]:
        rows: list[CandidateRow] = []
        for n in self.found.named.values():
            size = max(n.size.values(), default=0.0)
            rows.append(CandidateRow(
                term=n.term, verdict=TermVerdict.SUPPORTED, delta_bic=-2.0 * n.nats, probability=1.0, floors=None,
                why=f"{size:.2g} m/s^2 RMS, p {n.p_value:.1g}",
            ))  # fmt: skip
        for term, (nats, why) in self.found.refused.items():
            if term not in self.found.named:
                rows.append(CandidateRow(
                    term=term, verdict=TermVerdict.NOT_NEEDED, delta_bic=-2.0 * nats, probability=0.0, floors=None, why=why,
                ))  # fmt: skip
        done = {r["term"] for r in rows}
        for s in self.found.screened:
            if s.term not in done:
                verdict = TermVerdict.UNTESTABLE if s.term in hidden else TermVerdict.NOT_NEEDED
                why = hidden.get(s.term, f"score test: p {s.p_value:.2g}")
                rows.append(CandidateRow(
                    term=s.term, verdict=verdict, delta_bic=0.0, probability=0.0, floors=None, why=why,
                ))  # fmt: skip
        return [*rows, *(c for a in self.answers for c in a.candidates)]

    def _notes(self) -> list[str]:
        found, notes = self.found, []
        if self.asked is not None and len(self.asked.segments) < len(self.segments):
            notes.append(
                f"attitude loops were searched on {len(self.asked.segments)} of {len(self.segments)} windows, spread over all flights"
            )
        if found.beside_wind:
            notes.append(
                f"{' and '.join(found.beside_wind)} {'is' if len(found.beside_wind) == 1 else 'are'} estimated beside the wind, which "
                "tilts the vehicle as they do, and no finding"
            )
        if found.winds and len(found.final.flights) > 1:
            notes.append(
                "the model is one in still air: the wind of each flight is in the table of winds, not in the model"
            )
        for c, noise in found.final.noise.items():
            period = 1.0 / _rate(found)
            density = np.sqrt(noise.spectrum(np.array([0.1, 1.0, 0.4 / period]), period))
            notes.append(
                f"noise of {short(c)} in these flights: {density[0]:.2g}, {density[1]:.2g} and {density[2]:.2g} m/s^2 per root Hz at 0.1, "
                f"1 and {0.4 / period:.0f} Hz"
            )
        notes += pairs_of_flights(found)
        return notes


def pairs_of_flights(found: EquationSearch) -> list[str]:
    """Pairs of flights that would part what these could not."""
    said = []
    if found.winds and not found.turned and not found.declared:
        said.append(
            "a wind and an attitude offset tilt the vehicle alike at one heading: a second flight at another heading, or one in still air "
            "(--weather FLIGHT=still), diagnosed together with this one tells them apart"
        )
    offered = {*found.offered} - {*found.named}
    if "ground_effect" in offered and not any(s.term == "ground_effect" and s.p_value < CHANCE for s in found.screened):
        said.append(
            "ground effect shows between a low and a high flight: hover below one rotor diameter and above three, diagnosed together"
        )
    if len(found.final.flights) == 1:
        said.append(
            "a payload shows as K of a loaded over K of an unloaded flight of the same battery: diagnose the one with the other's --model"
        )
    return said


def with_equation_error(made: Fit, found: FreeFlight) -> Fit:
    """A fit whose translation was held at an estimate by equation error, with that estimate's standard errors and covariance."""
    names = [n for n in found.names if n in made.estimates and made.estimates[n].source == "frozen"]
    estimates = dict(made.estimates)
    dof = float(max(found.blocks - len(found.names), 1))
    std = found.std
    reveals = {p.name: t.reveals for t in made.model.built_terms for p in t.params}
    for n in names:
        e, p, half = estimates[n], made.model.param[n], interval_factor(dof) * std[n]
        known_std = std[n] if np.isfinite(std[n]) and n not in found.priors else None
        at_bound = not p.lower < e.value < p.upper
        known = judge(
            p, Estimated(e.value, known_std, n in found.priors, at_bound), made.voltage_spread_v, reveals.get(n, "")
        )
        interval = None if known_std is None else (max(e.value - half, p.lower), min(e.value + half, p.upper))
        estimates[n] = Estimate(
            n, e.symbol, e.unit, e.value, known_std, interval, "fit" if known_std is not None else "assumed", known.identifiable,
            known.why, known.fly, known_std,
        )  # fmt: skip
    kept = [n for n in names if estimates[n].std is not None]
    at = [found.names.index(n) for n in kept]
    # The information about held parameters is in the linearisation at this point, which later comparisons read.
    fixed = [n for n in made.model.names if n not in (*kept, *made.covariance.names)]
    problem = problem_of(made.problem.segments, made.model, select="all", values=made.values, fixed=fixed)
    begin = Start(made.values, made.noise, made.solution.local)
    solution = solve(problem, begin, robust=False, estimate_noise=False, max_iterations=0)
    made = replace(made, problem=problem, solution=replace(solution, status=made.status))
    return replace(
        made, estimates=estimates, covariance=_joined(made.covariance, kept, found.covariance[np.ix_(at, at)], dof)
    )


def _joined(loops: Covariance, names: Sequence[str], matrix: FloatArray, dof: float) -> Covariance:
    """Covariance of the attitude loops and of the translation, which share no parameter."""
    k, q = len(loops.names), len(names)

    def both(a: FloatArray, b: FloatArray) -> FloatArray:
        whole = np.zeros((k + q, k + q))
        whole[:k, :k], whole[k:, k:] = a, b
        return whole

    more = None if loops.discrepancy is None else both(loops.discrepancy, np.zeros((q, q)))
    return Covariance(
        (*loops.names, *names), both(loops.matrix, matrix), both(loops.model, matrix), np.append(loops.dof, np.full(q, dof)), more,
    )  # fmt: skip


def _table(found: FreeFlight, model: Model | None) -> dict[str, ParameterRow]:
    """Estimated parameters as rows; `model` None: those of single flights, too."""
    rows: dict[str, ParameterRow] = {}
    factor = interval_factor(float(max(found.blocks - len(found.names), 1)))
    for n, std in found.std.items():
        if model is not None and n not in model.names:
            continue
        value, p = found.values[n], found.model.param[n.split("@")[0]]
        if np.isfinite(std):
            rows[n] = {
                "value": value, "std": std, "unit": p.unit, "interval_95": [value - factor * std, value + factor * std], "scatter": std,
            }  # fmt: skip
    return rows


def _told(name: str, row: ParameterRow) -> str:
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    return f"{name} {row['value']:.3g} ± {brief(0.5 * (row['interval_95'][1] - row['interval_95'][0]))}{unit}"


def _separated(rival: str, term: str) -> str:
    if {rival, term} == {WIND_TERM, OFFSET_TERM}:
        return "fly a second heading, or declare a flight in still air"
    return f"fly {catalogue()[rival].reveals}"


def _wind_rows(found: EquationSearch) -> list[FlightWindRow]:
    return [
        FlightWindRow(
            flight=w.flight, w_north=w.north, w_west=w.west, w_north_std=w.north_std, w_west_std=w.west_std, speed_m_s=w.speed,
            speed_std=w.speed_std, from_deg=w.from_deg, verdict=w.verdict, declared="still" if w.flight in found.declared else "unknown",
        )
        for w in found.winds
    ]  # fmt: skip


def _floor(rows: Linearisation, segments: Sequence[Segment]) -> NoiseFloor:
    """The floor of free flight: what the final model leaves of each channel is its noise, whatever its spectrum.

    What a variable orders in it is no noise, and is still found by `locate`. Never below what sensors resolve.
    """
    least = floor_of(rows, segments, RESOLUTION)
    left = {
        name: float(np.sqrt(np.mean(rows.unprofiled_residual[rows.channel == c] ** 2)))
        for c, name in enumerate(rows.channels)
    }
    return NoiseFloor({c: max(v, left.get(c, 0.0)) for c, v in least.std.items()}, frozenset(), {})


def _rate(found: EquationSearch) -> float:
    return 1.0 / float(np.median(np.concatenate([np.diff(s.t_s) for s in found.flown])))


def _groups(found: EquationSearch) -> tuple[int, str]:
    many = len(found.final.flights)
    return (many, "flights") if many >= 3 else (5, "pieces of the flight")


def _gain(row: HeldOutRow | None) -> float:
    if row is None or not row["rmse_before"] > row["floor"]:
        return 0.0
    return float((row["rmse_before"] ** 2 - row["rmse_after"] ** 2) / (row["rmse_before"] ** 2 - row["floor"] ** 2))


def held_out_table(found: EquationSearch) -> dict[str, dict[str, HeldOutRow]]:
    """Channel (short) to RMS errors of means over half a second, of groups not used, without and with what is named.

    Parameters without a group by one Gauss-Newton step from the estimate with it; a flight's own wind is taken as estimated.
    """
    errors = [_left_out(found, one) for one in (found.base, found.final)]
    table: dict[str, dict[str, HeldOutRow]] = {}
    rng = np.random.default_rng(SEED)
    for channel in errors[0]:
        (before, group, _), (after, _, inside) = (e[channel] for e in errors)
        n = min(before.size, after.size)
        before, after, group = before[:n], after[:n], group[:n]
        members = [np.flatnonzero(group == g) for g in np.unique(group)]
        sums = np.array([[np.sum(before[m] ** 2), np.sum(after[m] ** 2), m.size] for m in members])
        drawn = sums[rng.integers(0, len(members), (DRAWS, len(members)))].sum(axis=1)
        gains = np.sqrt(drawn[:, 0] / drawn[:, 2]) - np.sqrt(drawn[:, 1] / drawn[:, 2])
        table[short(channel)] = {
            "all": HeldOutRow(
                rmse_before=float(np.sqrt(np.mean(before**2))), rmse_after=float(np.sqrt(np.mean(after**2))),
                floor=float(np.sqrt(np.mean(inside**2))), gain_95=[float(v) for v in np.quantile(gains, [0.025, 0.975])],
            )
        }  # fmt: skip
    return table


def _left_out(found: EquationSearch, one: FreeFlight) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Channel to (means of the residual as predicted without their group, their group, means of the residual of the whole estimate)."""
    names = list(dict.fromkeys(n.split("@")[0] for n in one.names))
    own = tuple(n for n in names if n not in one.names)
    with np.errstate(all="ignore"):
        streams, columns = Equations(one.model, found.flown).streams(one.values, names, own)
    place = [columns.index(n) for n in one.names]
    count, kind = _groups(found)
    period = 1.0 / _rate(found)
    rows = block_rows(one.seconds, period)
    many = max(round(MEANS_S / period), 1)
    parts: list[Whitened] = []
    pieces: list[tuple[str, FloatArray, FloatArray, int]] = []
    for s in streams:
        cut_at = [0, s.residual.size] if kind == "flights" else np.linspace(0, s.residual.size, count + 1).astype(int)
        for k, (a, b) in enumerate(pairwise(cut_at)):
            group = s.group if kind == "flights" else k
            piece = replace(s, residual=s.residual[a:b], columns=s.columns[a:b][:, place], group=group)
            parts.append(whiten([piece], dict(one.noise), rows))
            pieces.append((s.channel, piece.residual, piece.columns, group))
    information = [p.information() for p in parts]
    made: dict[str, list[tuple[FloatArray, FloatArray, FloatArray]]] = {}
    for g in sorted({p[3] for p in pieces}):
        others = [i for i, p in zip(information, pieces, strict=True) if p[3] != g]
        hessian, score = sum(h for h, _ in others), sum(s for _, s in others)
        scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
        delta = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-8, hermitian=True) @ (score / scale) / scale
        for channel, residual, jacobian, group in pieces:
            if group != g or residual.size < many:
                continue
            n = residual.size // many * many
            means = [v[:n].reshape(-1, many).mean(axis=1) for v in (residual - jacobian @ delta, residual)]
            made.setdefault(channel, []).append((means[0], np.full(means[0].size, g), means[1]))
    return {
        c: (np.concatenate([m[0] for m in v]), np.concatenate([m[1] for m in v]), np.concatenate([m[2] for m in v]))
        for c, v in made.items()
    }
