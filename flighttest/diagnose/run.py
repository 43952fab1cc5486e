"""`diagnose`: segments in, `Diagnosis` out. The order of the five verbs, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from flighttest.diagnose.answer import Asked, PartAnswer, SearchSupport, one_after_the_other
from flighttest.diagnose.assembly import assembled
from flighttest.diagnose.conclusion import pushed_once
from flighttest.diagnose.free_flight import by_prediction_errors
from flighttest.diagnose.kinematics import KinematicsAnswer, by_kinematics
from flighttest.diagnose.model import Diagnosis
from flighttest.diagnose.next_flight import Flyable, as_shipped
from flighttest.diagnose.output_error import by_output_error
from flighttest.diagnose.records import SetAside
from flighttest.diagnose.residuals.outlying import set_aside
from flighttest.diagnose.selection.held_out import held_out_groups
from flighttest.errors import FitError
from flighttest.estimation.estimator import BLOCKS
from flighttest.identify.diagnostics.local_optima import misfit
from flighttest.identify.fit import Fit, default_model, fit, has_attitude_references
from flighttest.identify.free_flight import parts_by_prediction_errors
from flighttest.identify.free_flight.equation_fit import LOOPS
from flighttest.identify.free_flight.winds import WIND_TERM, still_air
from flighttest.identify.selection import LOG_REFERENCES, NOTHING_ASKED, nothing_asked, problem_of
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

LEAST_SEGMENTS = 4
# How much of the work each block is, roughly.
SHARES = {"roll_pitch": 3.0, "yaw": 1.0, "translation": 5.0}


@dataclass(frozen=True)
class Support(SearchSupport):
    """What a caller supports a diagnosis with. flyable: what of a maneuver the zone has space for."""

    flyable: Flyable = as_shipped


def diagnose(
    segments: Sequence[Segment],
    model: Model | None = None,
    *,
    previous: Mapping[str, tuple[float, float | None]] | None = None,
    weather: Mapping[str, str] | None = None,
    only: Sequence[str] | None = None,
    support: Support = Support(),
) -> Diagnosis:
    """Locate what the model misses in these recordings and name it.

    segments: of one vehicle, from one or several recordings, marked steps or windows of free flight; which parts of the model are
    estimated by prediction errors, and which by output error, depends on who flew (`parts_by_prediction_errors`). model: the base
    (default: the paper's). previous: its parameters, name to (value, std), to compare with a former state of the vehicle. weather: flight
    to 'still' or 'unknown'. only: ids of the candidates (default: the whole catalogue). FitError when there is too little for any answer.
    An interrupt (KeyboardInterrupt) ends the search and returns what is known, with complete=False.
    """
    if nothing_asked(segments):
        raise FitError(NOTHING_ASKED, LOG_REFERENCES)
    usable = tuple(s for s in segments if s.usable)
    if len(usable) < LEAST_SEGMENTS:
        raise FitError(
            f"too few usable responses: {len(usable)}, at least {LEAST_SEGMENTS} are needed",
            "fly more steps or a longer flight, give several recordings of the vehicle together, or see `flighttest segment` for why "
            "responses were rejected",
        )
    if model is None:
        model = default_model(usable)
    if model.attitude_loops and not has_attitude_references(usable):
        model = replace(model, attitude_loops=False)
    problem_of(usable, model, select="all")  # FitError where nothing feeds any part of the model
    begun = _begun(usable, _Request(model, previous or {}, weather or {}, only, support))
    answers = [begun.sensors, *_searched(begun)]
    if not any(type(a) is not PartAnswer for a in answers):
        if not all(a.complete for a in answers):
            raise KeyboardInterrupt  # before anything was known
        raise FitError(
            "no reference moves in any of the responses, so that no part of the model can be tried",
            "a diagnosis needs recorded references: throttle, roll, pitch or yaw rate",
        )
    found = assembled(begun.asked, answers, support.flyable)
    if not begun.aside:
        return found
    alone = pushed_once(len(begun.aside["segments"]))
    return replace(found, sentence=f"{found.sentence} {alone}", set_aside=begun.aside)


@dataclass(frozen=True)
class _Request:
    """What a caller asks for, as `diagnose` documents it."""

    model: Model
    previous: Mapping[str, tuple[float, float | None]]
    weather: Mapping[str, str]
    only: Sequence[str] | None
    support: SearchSupport


@dataclass(frozen=True)
class _Begun:
    """What is known before any part of the model is searched: what the sensors show of themselves, which parts are by prediction errors,
    and what every part is asked about, without responses that were set aside."""

    sensors: PartAnswer
    by_prediction_errors: tuple[str, ...]
    asked: Asked
    aside: SetAside


def _begun(usable: tuple[Segment, ...], request: _Request) -> _Begun:
    model, weather, previous = request.model, request.weather, request.previous
    still = {s.run for s in usable} <= still_air(weather)[0]
    pool = tuple(t for t in _pool(model, request.only) if not (still and t.id == WIND_TERM))
    sensors = by_kinematics(usable, pool)
    recorded = usable
    if isinstance(sensors, KinematicsAnswer):
        usable = sensors.corrected(usable)
    own = parts_by_prediction_errors(usable)
    # By equations an accelerometer shows forces without the velocity: what they disagree in is a matter of kinematics alone.
    settled = {*sensors.accepted, *(sensors.tried if "translation" in own else ())}
    pool = tuple(t for t in pool if t.id not in settled)
    kept, aside = usable, SetAside()
    base = None if {*_blocks(model, own)} <= {*own} else _base(usable, model, own, previous, request.support)
    if base is not None:
        kept, aside = set_aside(usable, base.start.nuisance)
        if aside:
            base = _fitted(kept, base.model, base.values)
            names = {(s.run, s.name) for s in kept}
            recorded = tuple(s for s in recorded if (s.run, s.name) in names)
    asked = Asked(kept, recorded, model, pool, base, *held_out_groups(kept), previous, weather, request.support)
    return _Begun(sensors, own, asked, aside)


def _blocks(model: Model, own: Sequence[str]) -> tuple[str, ...]:
    """Parts of the model that are searched, in order; own: those by prediction errors. The loops of free flight are searched in the frame
    of the air that the translation shows."""
    order = own if "translation" in own else BLOCKS
    return tuple(b for b in order if b == "translation" or model.attitude_loops)


def _searched(begun: _Begun) -> list[PartAnswer]:
    """The answer of every part of the model: parts side by side, or, one waiting for the other, what each of them estimates."""
    own, asked = begun.by_prediction_errors, begun.asked
    blocks, way = _blocks(asked.model, own), asked.support.side_by_side
    if "translation" in own:
        way = one_after_the_other
    else:
        asked = replace(asked, support=replace(asked.support, side_by_side=one_after_the_other))

    def search(some: Sequence[str]) -> list[PartAnswer]:
        answers: list[PartAnswer] = []
        for block in some:
            winds = answers[0].winds if answers else ()
            try:
                answers.append(
                    by_prediction_errors(block, asked, winds) if block in own else by_output_error(block, asked)
                )
            except KeyboardInterrupt:
                answers.append(PartAnswer(complete=False))
            if not answers[-1].complete:
                break
        return answers + [PartAnswer(complete=False) for _ in some[len(answers) :]]

    return way(search, blocks, [SHARES[b] for b in blocks])


def _pool(model: Model, only: Sequence[str] | None) -> tuple[Term, ...]:
    """Candidates: terms of the catalogue that the base does not hold."""
    known = (t for t in catalogue().values() if t.id not in model.terms and block_of(t) != "delay")
    return tuple(t for t in known if only is None or t.id in only)


def _base(
    segments: Sequence[Segment],
    model: Model,
    own: Sequence[str],
    previous: Mapping[str, tuple[float, float | None]],
    support: SearchSupport,
) -> Fit | None:
    """The parts of the base model that are not by prediction errors (own); None where nothing moves any of them."""
    support.progress("fitting the base model")
    loops = model.attitude_loops and not {*LOOPS} & {*own}
    try:
        return _fitted(segments, replace(model, attitude_loops=loops), {k: v[0] for k, v in previous.items()})
    except FitError:
        if not own:
            raise
        return None


def _fitted(segments: Sequence[Segment], model: Model, start: Mapping[str, float]) -> Fit:
    """A model fitted to every response that can feed it: from the shape of the responses and, where that is better, from `start`, which
    may be of another vehicle."""
    found = fit(segments, model, select="all", robust=False)
    known = {k: v for k, v in start.items() if k in model.names}
    if not known:
        return found
    other = fit(segments, model, select="all", robust=False, start=known)
    return min(found, other, key=lambda f: misfit(f.problem, f.solution))
