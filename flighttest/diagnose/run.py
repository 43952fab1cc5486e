"""`diagnose`: segments in, `Diagnosis` out. The order of the five verbs, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flighttest.diagnose.another_way import another_way
from flighttest.diagnose.baselines import baselines
from flighttest.diagnose.bench import BLOCKS, Bench
from flighttest.diagnose.findings import finding, parameter_table
from flighttest.diagnose.judge import compare, excess_share, held_out, held_out_groups, horizon_rmse
from flighttest.diagnose.locate import locate, regime_curves, residual_map
from flighttest.diagnose.mass import mass_test
from flighttest.diagnose.model import Diagnosis, Untestable, Verdict, brief, flown, short
from flighttest.diagnose.next_flight import Question, propose
from flighttest.diagnose.noise import floor_of
from flighttest.diagnose.overlays import overlays
from flighttest.diagnose.pairs import look_ahead
from flighttest.diagnose.remainders import drop_remainders
from flighttest.diagnose.rivals import detectable, missing_channels, rivals_of, untestable
from flighttest.diagnose.rows import RESOLUTION
from flighttest.diagnose.search import Search
from flighttest.diagnose.strays import set_aside
from flighttest.diagnose.unknown import describe
from flighttest.errors import FitError
from flighttest.identify.fit import default_model, has_attitude_references
from flighttest.identify.onset import onset_delay, start_values
from flighttest.physics.body import DELAY_PARAM
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

LEAST_SEGMENTS = 4
EXPLAINED_SHARE = 0.2  # of the excess may stay when the mismatch counts as explained
# Held at off in the attitude model until it is needed, so that roll and pitch are always compared on the same responses.
COUPLING = "roll_pitch_coupling"
PLAIN = {"roll_pitch": "roll or pitch", "yaw": "the yaw rate", "translation": "the throttle"}
# Start delays never fall on a sample: there the derivative by the delay is one-sided.
OFF_GRID_S = 1.7e-4
DELAYS_DIFFER_S = 0.01


def diagnose(
    segments: Sequence[Segment],
    model: Model | None = None,
    *,
    previous: Mapping[str, tuple[float, float | None]] | None = None,
    nominal_voltage_v: float | None = None,
    filters: Mapping[str, float] | None = None,
    only: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Locate what the model misses in these recordings and name it.

    segments: of one vehicle, from one or several recordings, marked steps or windows of free flight. model: the base (default:
    the paper's). previous: its parameters, name to (value, std), to compare with a former state of the vehicle. only: ids of the
    candidates (default: the whole catalogue). FitError when there is too little to say anything. An interrupt (KeyboardInterrupt)
    ends the search and returns what is known, with complete=False.
    """
    tell = progress or (lambda _text: None)
    usable = tuple(s for s in segments if s.usable and s.t_s.size >= 8)
    if len(usable) < LEAST_SEGMENTS:
        raise FitError(
            f"only {len(usable)} usable responses, at least {LEAST_SEGMENTS} are needed",
            "fly more steps or a longer flight, or see `flighttest segment` for why responses were rejected",
        )
    if model is None:
        model = default_model(usable)
        if nominal_voltage_v:
            model = Model(model.terms, nominal_voltage_v, attitude_loops=model.attitude_loops)
    if model.attitude_loops and not has_attitude_references(usable):
        model = Model(
            model.terms, model.nominal_voltage_v, model.g_m_s2, model.channel_delays, False, dict(model.extra)
        )
    known = catalogue()
    pool = tuple(
        t
        for t in known.values()
        if t.id not in model.terms and (only is None or t.id in only) and block_of(t) != "delay"
    )
    starts = _starts(usable, model, previous)
    usable, aside = set_aside(usable, model, starts, filters)
    groups, group_name = held_out_groups(usable)
    searches: list[Search] = []
    complete, notes = True, []
    for block in BLOCKS:
        if block != "translation" and not model.attitude_loops:
            continue
        bench = Bench(usable, block, filters)
        own = Model(
            (*model.terms, COUPLING) if block == "roll_pitch" else model.terms,
            model.nominal_voltage_v, model.g_m_s2, model.channel_delays, model.attitude_loops, dict(model.extra),
        )  # fmt: skip
        if not bench.problem(own).parts:
            notes.append(f"nothing in this recording moves {PLAIN[block]}: it is left out")
            continue
        dormant = frozenset({COUPLING}) if block == "roll_pitch" and COUPLING not in model.terms else frozenset()
        here = tuple(t for t in pool if _acts(t, bench, own) and not missing_channels(t, usable))
        search = Search(
            bench, here, groups, dormant, progress=lambda text, b=block: tell(f"{b}: {text}"), look_ahead=look_ahead  # type: ignore[misc]
        )  # fmt: skip
        try:
            search.run(own, min((bench.start(own, values) for values in starts), key=lambda state: state.objective))
            drop_remainders(search)
            search, as_well = another_way(search)
            if as_well:
                notes.append(as_well)
        except KeyboardInterrupt:
            complete = False
            notes.append("interrupted: candidates not tried are not in this answer")
        if search.now is not None and search.floor is not None:
            searches.append(search)
        if not complete:
            break
    if not searches and not complete:
        raise KeyboardInterrupt  # before anything was known
    if not searches:
        raise FitError(
            "no reference moves in any of the responses, so that no part of the model can be tried",
            "a diagnosis needs recorded references: throttle, roll, pitch or yaw rate",
        )
    found = _assembled(usable, model, searches, pool, groups, group_name, previous or {}, complete, notes, seed, tell)
    if not aside:
        return found
    count = len(aside["segments"])
    said = (
        "1 response that something pushed once is"
        if count == 1
        else f"{count} responses that something pushed once are"
    )
    return replace(found, sentence=f"{found.sentence} {said} set aside.", set_aside=aside)


def _acts(term: Term, bench: Bench, model: Model) -> bool:
    """Whether a term changes what this bench compares."""
    if (block_of(term) == "translation") != (bench.block == "translation"):
        return False
    known = bench.problem(model if term.id in model.terms else model.with_terms(term)).names
    return any(p.name in known for p in term.params)


def _starts(
    segments: Sequence[Segment], model: Model, previous: Mapping[str, tuple[float, float | None]] | None
) -> list[dict[str, float]]:
    """From the shape of the responses, and from the previous model where there is one (it may be of another vehicle)."""
    shape = dict(start_values(segments, model, onset_delay(segments)))
    found = [shape]
    if previous:
        found.append({**shape, **{k: float(v[0]) for k, v in previous.items() if k in model.names}})
    return [{k: v + OFF_GRID_S if k.startswith("T_d") else v for k, v in values.items()} for values in found]


def _assembled(
    segments: tuple[Segment, ...],
    model: Model,
    searches: Sequence[Search],
    pool: Sequence[Term],
    groups: Any,
    group_name: str,
    previous: Mapping[str, tuple[float, float | None]],
    complete: bool,
    notes: list[str],
    seed: int,
    tell: Callable[[str], None],
) -> Diagnosis:
    tell("comparing before and after")
    accepted: list[str] = []
    located, findings, unseen = [], [], []
    levels: dict[str, tuple[float, str]] = {}
    heldout: dict[str, dict[str, Any]] = {}
    floors: dict[str, dict[str, Any]] = {}
    cells, curves, overlaid, candidates = [], [], [], []
    before_table: dict[str, Any] = {}
    after_table: dict[str, Any] = {}
    shares: list[float] = []  # of each channel's excess, what stays: channels count alike, whatever their floors
    staying: set[str] = set()
    values = dict(model.start())
    base_rmse: dict[str, dict[str, float]] = {}
    for search in searches:
        base, now, floor, bench = search.base, search.now, search.floor, search.bench
        assert base is not None
        assert now is not None
        assert floor is not None
        accepted += list(search.judged)
        values |= now.state.values
        before_held, after_held = held_out(base.rows, base.names, groups), held_out(now.rows, now.names, groups)
        for name, h in compare(base.rows, before_held, now.rows, after_held, groups, floor, seed).items():
            steps_b = horizon_rmse(base.rows, before_held, segments).get(name, {})
            steps_a = horizon_rmse(now.rows, after_held, segments).get(name, {})
            heldout[short(name)] = {
                "all": _held(h),
                **{k: {"rmse_before": steps_b[k], "rmse_after": steps_a[k]} for k in steps_b if k in steps_a},
            }
            floors[short(name)] = {
                "value": floor.of(name),
                "from": "repeats"
                if name in floor.from_repeats
                else "high-frequency residual and usual drift of estimates (weaker: no repeats were flown)",
            }
        first, last = excess_share(base.rows, floor), excess_share(now.rows, floor)
        places = locate(base.rows, segments, floor_of(base.rows, segments, RESOLUTION), seed)
        located += places
        above = {place.channel for place in places}
        shares += [min(last[n] / e, 1.0) for n, e in first.items() if short(n) in above and e > 0]
        left = locate(now.rows, segments, floor_of(now.rows, segments, RESOLUTION), seed)
        staying |= {place.channel for place in left}
        curves += regime_curves(places, base.rows, now.rows, segments)
        cells += residual_map(base.rows, now.rows, segments, floor)
        overlaid += overlays(base.rows, now.rows, segments)
        before_table |= parameter_table(base)
        after_table |= parameter_table(now)
        for name in search.judged:
            findings.append(finding(search, name, rivals_of(search, name), groups, seed))
        if search.ground is not None:
            seen = detectable(search)
            levels |= seen
            unseen += untestable(search, seen)
        candidates += _candidates(search)
        base_rmse |= baselines(bench, base, now, segments, previous)
    for term in pool:
        missing = missing_channels(term, segments)
        if missing and term.id not in {u.term for u in unseen}:
            unseen.append(Untestable(term.id, f"not recorded: {', '.join(missing)}", term.reveals))
    notes += _delays(after_table)
    tried = {t.id for s in searches for t in s.pool}
    named = {f.term for f in findings} | {u.term for u in unseen}
    share = float(np.mean(shares)) if shares else 0.0
    verdict = _verdict(bool(findings), share, bool(located), bool(staying))
    formulas: list[dict[str, Any]] = []
    if verdict in (Verdict.UNKNOWN_PHYSICS, Verdict.PARTLY):
        tell("describing what has no name")
        for search in searches:
            formulas += describe(search, segments, groups, _with_forces(staying))
    tell("choosing the next flight")
    proposal = _next(searches, findings, unseen, {t.id: t for t in pool}) if complete else {}
    final = Model(
        (*model.terms, *accepted),
        model.nominal_voltage_v,
        model.g_m_s2,
        model.channel_delays,
        model.attitude_loops,
        dict(model.extra),
    )
    return Diagnosis(
        verdict=verdict,
        sentence=_sentence(verdict, findings, share, located),
        located=tuple(located),
        findings=tuple(findings),
        not_needed=tuple(sorted(tried - named)),
        untestable=tuple(unseen),
        unexplained={"excess_share": float(min(share, 1.0)) if located else 0.0},
        smallest_detectable={k: v[0] for k, v in levels.items() if np.isfinite(v[0])},
        model=final,
        values={k: values[k] for k in final.names if k in values},
        accepted=tuple(accepted),
        before=before_table,
        after=after_table,
        heldout=heldout,
        noise_floor=floors,
        baselines=base_rmse,
        residual_map=tuple(cells),
        regimes=tuple(curves),
        overlays=tuple(overlaid),
        candidates=tuple(candidates),
        cost={"added_parameters": len(after_table) - len(before_table), "held_out_groups": group_name},
        unknown=tuple(formulas),
        mass=mass_test(previous, after_table),
        next_flight="next.yaml" if proposal else None,
        next_script=proposal.get("script"),
        next_reason={k: v for k, v in proposal.items() if k != "script"},
        notes=tuple(notes),
        complete=complete,
        runs=tuple(dict.fromkeys(s.run for s in segments)),
    )


def _next(
    searches: Sequence[Search], findings: Sequence[Any], unseen: Sequence[Untestable], terms: Mapping[str, Term]
) -> dict[str, Any]:
    """The flight that tells rivals apart; where there are none, one that shows what could not be seen."""
    for search in searches:
        assert search.now is not None
        values = {
            **search.now.model.start(),
            **{k: v for s in searches if s.now for k, v in s.now.state.values.items()},
        }
        asked = []
        for f in (f for f in findings if f.term in search.judged):
            for r in (r for r in f.rivals if r.verdict == "CONFUSABLE"):
                size = {n: search.now.state.values[n] for n in f.parameters}
                asked.append(Question(terms[f.term], terms[r.term], size))
        if asked and (made := propose(search, asked[:2], values)):
            return made
    hidden = [u for u in unseen if not u.why.startswith("not recorded")]
    for search in searches:
        assert search.now is not None
        values = {
            **search.now.model.start(),
            **{k: v for s in searches if s.now for k, v in s.now.state.values.items()},
        }
        here = {t.id for t in search.pool}
        asked = [
            Question(terms[u.term], None, {p.name: p.nominal for p in terms[u.term].params})
            for u in hidden
            if u.term in here
        ]
        if asked and (made := propose(search, asked[:1], values)):
            return made
    return {}


def _with_forces(channels: set[str]) -> set[str]:
    """A velocity that goes astray was pushed: its force is to be described."""
    return channels | {f"{force}_{c[2:]}" for c in channels if c.startswith("v_") for force in ("f", "a")}


def _delays(table: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Channel delays that differ: the model has one per channel, so this needs no term."""
    known = {n: (float(table[n]["value"]), float(table[n]["std"])) for n in DELAY_PARAM.values() if n in table}
    if len(known) < 2:
        return []
    (late, (most, most_std)), (early, (least, least_std)) = (
        max(known.items(), key=lambda kv: kv[1][0]), min(known.items(), key=lambda kv: kv[1][0])
    )  # fmt: skip
    if most - least < DELAYS_DIFFER_S or most - least < 4 * float(np.hypot(most_std, least_std)):
        return []
    return [
        f"channel_delay: {late} is {1000 * (most - least):.0f} ms longer than {early}; the model has a delay for each channel, "
        "so that no further term is needed"
    ]


def _held(h: Any) -> dict[str, Any]:
    return {"rmse_before": h.rmse_before, "rmse_after": h.rmse_after, "floor": h.floor, "gain_95": list(h.gain_95)}


def _candidates(search: Search) -> list[dict[str, Any]]:
    """Every candidate's score, for the table of what was ruled out and why."""
    found = [
        {
            "term": j.term, "verdict": "SUPPORTED", "delta_bic": j.bic, "floors": j.floors, "gain": j.gain, "p_value": j.p_value,
            "why": f"{brief(j.floors)} noise floors in {short(j.place[0])} of {flown(j.place[1])}",
        }
        for j in search.judged.values()
    ]  # fmt: skip
    found += [
        {
            "term": j.term, "verdict": "NOT_NEEDED", "delta_bic": j.bic, "floors": j.floors, "gain": j.gain, "p_value": j.p_value,
            "why": j.reason or "refitted: too small, or no better on what it has not seen",
        }
        for j in search.refused.values()
    ]  # fmt: skip
    done = {f["term"] for f in found}
    best: dict[str, Any] = {}
    for s in search.scores:
        if s.variant.term.id not in done and (s.variant.term.id not in best or s.bic < best[s.variant.term.id].bic):
            best[s.variant.term.id] = s
    for term, s in best.items():
        why = "no more than chance" if s.p_value > 0.01 else "the criterion does not fall enough for its parameters"
        found.append(
            {
                "term": term, "verdict": "NOT_NEEDED", "delta_bic": s.bic, "floors": None, "gain": None, "p_value": s.p_value, "why": why,
            }
        )  # fmt: skip
    return found


def _verdict(any_named: bool, share: float, located: bool, still: bool) -> Verdict:
    if not any_named:
        return Verdict.UNKNOWN_PHYSICS if located else Verdict.NOTHING_MISSING
    return Verdict.EXPLAINED if not still or share <= EXPLAINED_SHARE else Verdict.PARTLY


def _sentence(verdict: Verdict, findings: Sequence[Any], share: float, located: Sequence[Any]) -> str:
    names = ", ".join(f.title.lower() for f in findings)
    if verdict is Verdict.EXPLAINED:
        return f"Left out: {names}. With it {100 * max(0.0, 1 - share):.0f} % of the excess error is gone."
    if verdict is Verdict.PARTLY:
        return f"Left out: {names}; {100 * share:.0f} % of the excess error stays unexplained."
    if verdict is Verdict.NOTHING_MISSING:
        return "Nothing is missing above the noise floor; see the smallest effects that would have been noticed."
    return f"Something is missing that has no name here: {located[0].sentence}." if located else verdict.value
