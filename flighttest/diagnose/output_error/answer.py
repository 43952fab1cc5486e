"""One part of the model by output error: its search, and what the diagnosis reports of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from flighttest.diagnose.answer import SEED, Asked, PartAnswer
from flighttest.diagnose.model import Finding, short
from flighttest.diagnose.output_error.reported import candidate_rows, finding
from flighttest.diagnose.records import FROM_REPEATS, FROM_RESIDUAL, ParameterRow
from flighttest.diagnose.residuals.lack_of_fit import RESOLUTION, floor_of, step_errors
from flighttest.diagnose.residuals.locate import locate, overlays, regime_curves, residual_map
from flighttest.diagnose.selection.baselines import baselines
from flighttest.diagnose.selection.candidates import acts_in
from flighttest.diagnose.selection.comparison import held_out_errors
from flighttest.diagnose.selection.detectability import detectable, missing_channels, untestable
from flighttest.diagnose.selection.fitted_models import FittedModels
from flighttest.diagnose.selection.held_out import excess, gains_held_out, horizon_rmse
from flighttest.diagnose.selection.search import Search, silent
from flighttest.estimation.estimator import Estimator
from flighttest.identify.dead_time import onset_delay, start_values
from flighttest.identify.selection import able

# Held at off in the attitude model until it is needed, so that roll and pitch are always compared on the same responses.
COUPLING = "roll_pitch_coupling"
PLAIN = {"roll_pitch": "roll or pitch", "yaw": "the yaw rate", "translation": "the throttle"}


@dataclass
class OutputErrorAnswer(PartAnswer):
    """Of a search as it ended."""

    search: Search = field(kw_only=True)

    def findings(self, asked: Asked, table: Mapping[str, ParameterRow]) -> list[Finding]:
        """Of every accepted term against the same model without it."""
        return [finding(self.search, term, table, asked.groups, SEED) for term in self.accepted]


def by_output_error(block: str, asked: Asked) -> PartAnswer:
    """Search one block of the model, whose base `asked.base` has.

    An interrupt (KeyboardInterrupt) ends the search; what is known is reported.
    """
    estimator = Estimator(asked.segments, block, able)
    model = asked.model
    own = model.with_terms(COUPLING) if block == "roll_pitch" else model
    if not estimator.problem(own).parts:
        return PartAnswer(notes=[f"nothing in this recording moves {PLAIN[block]}: it is left out"])
    assert asked.base is not None
    inactive = frozenset({COUPLING}) if block == "roll_pitch" and COUPLING not in model.terms else frozenset()
    pool = tuple(t for t in asked.pool if acts_in(t, own, block) and not missing_channels(t, asked.segments))
    origin = start_values(asked.segments, model, onset_delay(asked.segments))
    models = FittedModels(estimator, pool, inactive, origin)
    search = Search(models, asked.groups, lambda text: asked.support.progress(f"{block}: {text}"))
    complete = True
    try:
        begun = estimator.start(own, asked.base.values)
        # Of a channel that the base could not be fitted to (a pitch that nothing moved) the usual noise.
        begun = replace(begun, noise=begun.noise | asked.base.noise, nuisance=dict(asked.base.start.nuisance))
        search.run(own, begun)
    except KeyboardInterrupt:
        complete = False
    if search.now is None or search.floor is None:
        return PartAnswer(complete=complete)
    made = OutputErrorAnswer(complete=complete, search=search)
    _tell(made, search, asked)
    search.progress = silent  # what goes to another process takes no screen along
    return made


def _tell(made: OutputErrorAnswer, search: Search, asked: Asked) -> None:
    """Put into an answer what a search came to: the model before and after, what was named and what was not."""
    segments = asked.segments
    base, now, floor = search.base, search.now, search.floor
    assert base is not None
    assert now is not None
    assert floor is not None
    made.terms = tuple(t for t in now.model.terms if t in search.members)
    made.accepted = {term: e.nats for term, e in search.evidence.items()}
    nameless = [search.rejected[t] for t in made.terms if t in search.rejected and t not in search.named]
    made.notes = [f"{e.term} is in the model and no finding: {e.why_not}" for e in nameless]
    made.null = {n: now.at.values[n] for term in made.terms for n in search.held(term)}
    made.tried = frozenset(made.terms) | (frozenset(t.id for t in search.pool) if made.complete else frozenset())
    unchanged = now is base
    before_held, after_held = held_out_errors(base, now, search.estimator, asked.groups)
    horizons_b = horizon_rmse(before_held, segments)
    horizons_a = horizons_b if unchanged else horizon_rmse(after_held, segments)
    for name, h in gains_held_out(before_held, after_held, asked.groups, floor, SEED).items():
        steps_b, steps_a = horizons_b.get(name, {}), horizons_a.get(name, {})
        made.heldout[short(name)] = {
            "all": h,
            **{k: {"rmse_before": steps_b[k], "rmse_after": steps_a[k]} for k in steps_b if k in steps_a},
        }
        made.floors[short(name)] = {
            "value": floor.of(name),
            "from": FROM_REPEATS if name in floor.from_repeats else FROM_RESIDUAL,
        }
    first, last = excess(base.rows, floor), excess(now.rows, floor)
    left = locate(now.rows, segments, floor_of(now.rows, segments, RESOLUTION), SEED)
    # What has no name is no mismatch: where nothing has, the place is where the model differs with it.
    places = locate(base.rows, segments, floor_of(base.rows, segments, RESOLUTION), SEED) if search.named else left
    made.located += places
    above = {place.channel for place in places}
    made.shares |= {short(n): min(last[n] / e, 1.0) for n, e in first.items() if short(n) in above and e > 0}
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
    made.candidates += candidate_rows(search)
    made.baselines |= baselines(search.estimator, base, now, segments, asked.previous)
