"""One block of the model (roll and pitch, yaw rate, or translation): its search, and what the diagnosis reports of it.

Blocks share nothing but the recordings, so that they can be searched in parallel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.model import Located, TermVerdict, Untestable, brief, flown, short
from flighttest.diagnose.records import (
    FROM_REPEATS,
    FROM_RESIDUAL,
    CandidateRow,
    FloorRow,
    HeldOutRow,
    MapCell,
    Overlay,
    RegimeCurve,
)
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, floor_of
from flighttest.diagnose.residuals.locate import locate, regime_curves, residual_map
from flighttest.diagnose.residuals.mismatch import step_errors
from flighttest.diagnose.residuals.overlays import overlays
from flighttest.diagnose.selection.baselines import baselines
from flighttest.diagnose.selection.detectability import detectable, missing_channels, untestable
from flighttest.diagnose.selection.fitted_models import FittedModels
from flighttest.diagnose.selection.held_out import HeldOut, excess, gains_held_out, horizon_rmse
from flighttest.diagnose.selection.proposals import LEAST_PREDICTED
from flighttest.diagnose.selection.search import Search, silent
from flighttest.diagnose.step_error import StepError
from flighttest.estimation.estimator import Estimator, part_of
from flighttest.identify.dead_time import onset_delay, start_values
from flighttest.identify.fit import Fit
from flighttest.identify.selection import able
from flighttest.physics.compose import block_of
from flighttest.physics.core import Term
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

# Held at off in the attitude model until it is needed, so that roll and pitch are always compared on the same responses.
COUPLING = "roll_pitch_coupling"
PLAIN = {"roll_pitch": "roll or pitch", "yaw": "the yaw rate", "translation": "the throttle"}


SEED = 0  # of sign flips and resampling: the same recordings give the same diagnosis


V = TypeVar("V")


@dataclass(frozen=True)
class Asked:
    """What every block is asked about: responses, base model, candidates, the base model's fit, which responses are held out together."""

    segments: tuple[Segment, ...]
    model: Model
    pool: tuple[Term, ...]
    base: Fit
    groups: NDArray[np.intp]
    previous: Mapping[str, tuple[float, float | None]]
    tell: Callable[[str], None]


@dataclass
class BlockAnswer:
    """What was found in one block, for `run` to put together. search: as it ended, None where nothing moves the block.

    shares: of each channel's excess what stays; staying: channels (short) whose mismatch stays. The rest as in `Diagnosis`.
    """

    search: Search | None = None
    complete: bool = True
    notes: list[str] = field(default_factory=list)
    located: list[Located] = field(default_factory=list)
    unseen: list[Untestable] = field(default_factory=list)
    levels: dict[str, tuple[float, str]] = field(default_factory=dict)
    heldout: dict[str, dict[str, HeldOutRow]] = field(default_factory=dict)
    floors: dict[str, FloorRow] = field(default_factory=dict)
    cells: list[MapCell] = field(default_factory=list)
    errors: list[StepError] = field(default_factory=list)
    left: list[StepError] = field(default_factory=list)
    curves: list[RegimeCurve] = field(default_factory=list)
    overlaid: list[Overlay] = field(default_factory=list)
    candidates: list[CandidateRow] = field(default_factory=list)
    baselines: dict[str, dict[str, float]] = field(default_factory=dict)
    shares: list[float] = field(default_factory=list)
    staying: set[str] = field(default_factory=set)


def answer(block: str, asked: Asked) -> BlockAnswer:
    """Search one block.

    An interrupt (KeyboardInterrupt) ends the search; what is known is reported.
    """
    made = BlockAnswer()
    estimator = Estimator(asked.segments, block, able)
    model = asked.model
    own = model.with_terms(COUPLING) if block == "roll_pitch" else model
    if not estimator.problem(own).parts:
        made.notes.append(f"nothing in this recording moves {PLAIN[block]}: it is left out")
        return made
    inactive = frozenset({COUPLING}) if block == "roll_pitch" and COUPLING not in model.terms else frozenset()
    pool = tuple(t for t in asked.pool if _acts(t, estimator, own) and not missing_channels(t, asked.segments))
    origin = start_values(asked.segments, model, onset_delay(asked.segments))
    models = FittedModels(estimator, pool, inactive, origin)
    search = Search(models, asked.groups, lambda text: asked.tell(f"{block}: {text}"))
    try:
        begun = estimator.start(own, asked.base.values)
        # Of a channel that the base could not be fitted to (a pitch that nothing moved) the usual noise.
        begun = replace(begun, noise=begun.noise | asked.base.noise, nuisance=dict(asked.base.start.nuisance))
        search.run(own, begun)
    except KeyboardInterrupt:
        made.complete = False
    if search.now is not None and search.floor is not None:
        made.search = search
        _tell(made, search, asked)
        search.progress = silent  # what goes to another process takes no screen along
    return made


def _tell(made: BlockAnswer, search: Search, asked: Asked) -> None:
    """Put into an answer what a search came to: the model before and after, what was named and what was not."""
    segments = asked.segments
    base, now, floor = search.base, search.now, search.floor
    assert base is not None
    assert now is not None
    assert floor is not None
    unchanged = now is base
    before_held = base.held_out(asked.groups)
    after_held = before_held if unchanged else now.held_out(asked.groups)
    horizons_b = horizon_rmse(before_held, segments)
    horizons_a = horizons_b if unchanged else horizon_rmse(after_held, segments)
    for name, h in gains_held_out(before_held, after_held, asked.groups, floor, SEED).items():
        steps_b, steps_a = horizons_b.get(name, {}), horizons_a.get(name, {})
        made.heldout[short(name)] = {
            "all": _held(h),
            **{k: {"rmse_before": steps_b[k], "rmse_after": steps_a[k]} for k in steps_b if k in steps_a},
        }
        made.floors[short(name)] = {
            "value": floor.of(name),
            "from": FROM_REPEATS if name in floor.from_repeats else FROM_RESIDUAL,
        }
    first, last = excess(base.rows, floor), excess(now.rows, floor)
    places = locate(base.rows, segments, floor_of(base.rows, segments, RESOLUTION), SEED)
    made.located += places
    above = {place.channel for place in places}
    made.shares += [min(last[n] / e, 1.0) for n, e in first.items() if short(n) in above and e > 0]
    left = places if unchanged else locate(now.rows, segments, floor_of(now.rows, segments, RESOLUTION), SEED)
    made.staying |= {place.channel for place in left}
    made.curves += regime_curves(places, base.rows, now.rows, segments)
    made.cells += residual_map(base.rows, now.rows, segments, floor)
    made.errors += step_errors(base.rows, segments)
    made.left += step_errors(now.rows, segments)
    made.overlaid += overlays(base.rows, now.rows, segments)
    seen = detectable(search)
    made.levels |= seen
    if made.complete or search.candidates:  # of what an interrupt kept from being screened nothing is known
        made.unseen += untestable(search, seen)
    made.candidates += _candidates(search)
    made.baselines |= baselines(search.estimator, base, now, segments, asked.previous)


def _acts(term: Term, estimator: Estimator, model: Model) -> bool:
    """Whether a term changes what this estimator compares."""
    if (block_of(term) == "translation") != (estimator.block == "translation"):
        return False
    tried = model if term.id in model.terms else model.with_terms(term)
    known = {name for block in tried.blocks if part_of(block.name) == estimator.block for name in block.params}
    return any(p.name in known for p in term.params)


def _held(h: HeldOut) -> HeldOutRow:
    return {"rmse_before": h.rmse_before, "rmse_after": h.rmse_after, "floor": h.floor, "gain_95": list(h.gain_95)}


def _candidates(search: Search) -> list[CandidateRow]:
    """Every candidate's evidence, for the table of what was ruled out and why."""
    found: list[CandidateRow] = []
    for e in {**search.rejected, **search.evidence}.values():
        named = e.term in search.evidence
        why = f"{brief(e.floors)} noise floors in {short(e.place[0])} of {flown(e.place[1])}" if named else e.why_not
        found.append(
            {
                "term": e.term, "verdict": TermVerdict.SUPPORTED if named else TermVerdict.NOT_NEEDED, "delta_bic": -2.0 * e.nats,
                "probability": e.probability, "floors": e.floors, "why": why,
            }
        )  # fmt: skip
    done = {f["term"] for f in found}
    if search.subsets is None or search.sizes is None:
        return found
    alone = [s for s in search.scored if len(s.members) == 1]
    for s, size in zip(alone, search.sizes.least(alone), strict=True):
        (term,) = search.subsets.terms(s)
        if term not in done:
            probability = 1.0 / (1.0 + float(np.exp(min(-s.log_odds, 700.0))))
            why = f"screened: log odds {s.log_odds:.1f} beside the final model"
            if small := s.log_odds > 0.0 and size < LEAST_PREDICTED:
                why += f", but an effect of {size:.2g} noise floors, too small to be distinguished from a clean vehicle"
            found.append(
                {
                    "term": term, "verdict": TermVerdict.NOT_NEEDED, "delta_bic": -2.0 * s.log_odds, "probability": probability,
                    "floors": float(size) if small else None, "why": why,
                }
            )  # fmt: skip
    return found


def listed(answers: Sequence[BlockAnswer], what: str) -> list[Any]:
    """One of the blocks' lists (a field of `BlockAnswer`), one after the other."""
    return [each for a in answers for each in getattr(a, what)]


def merged(tables: Iterable[Mapping[str, V]]) -> dict[str, V]:
    """Tables in one; of a key that occurs twice the last."""
    return {key: value for table in tables for key, value in table.items()}
