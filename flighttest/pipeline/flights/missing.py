"""What a flight lacks of its plan and of its record, why, and the command that flies it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from flighttest.flight import FlightOutcome, FlightResult, FlightState, LegOutcome
from flighttest.flight.gate import LOST_CONTROL, refusal_sentences
from flighttest.pipeline.store.resuming import flown_in
from flighttest.plan import Plan
from flighttest.report.numbers import join

# What wind or link may have caused.
_PASSING = frozenset({LegOutcome.NOT_SETTLED, LegOutcome.LINK_LOST, LegOutcome.REFUSED})


def steps_missing(plan: Plan, ended: FlightResult, earlier: Sequence[Path]) -> int:
    """How many steps of a plan no flight has, where another flight may help. earlier: the runs it goes on with."""
    to_the_end = ended.outcome in (FlightOutcome.COMPLETED, FlightOutcome.NOTHING_FLOWN)
    again = not to_the_end or any(leg.outcome in _PASSING for leg in ended.legs)
    return len({leg.id for leg in plan.legs} - flown_in([*earlier, ended.run_dir])) if again else 0


def resume_command(
    plan: Plan, ended: FlightResult, earlier: Sequence[Path], scripts: Sequence[str], options: str
) -> str:
    """The command that flies what a campaign lacks, '' where that is nothing, or another flight would end as this one did. scripts: the
    words for this script and those after it, where these were not flown. options: without which this flight's preflight would have
    refused; the vehicle and the link are in the run."""
    if not _resumable(ended) or not (scripts or steps_missing(plan, ended, earlier)):
        return ""
    return f"flighttest run --resume {shlex.join([str(ended.run_dir), *scripts])}{options}"


def _resumable(ended: FlightResult) -> bool:
    """Whether the flight ended between two steps, with a take-over, or by a gate to which wind, link or battery gave its reason. A vehicle
    that was out of control is looked at first."""
    if ended.outcome is FlightOutcome.ABORTED_BY_GATE:
        return not any(LOST_CONTROL & set(leg.refused) for leg in ended.legs)
    return ended.outcome.orderly or ended.outcome in (FlightOutcome.TAKE_OVER, FlightOutcome.NOTHING_FLOWN)


def unlike_the_plan(
    plan: Plan, ended: FlightResult, earlier: Sequence[Path], lacking: Sequence[str], resume: str
) -> list[str]:
    """What a flight lacks of its plan, and a campaign of its scripts, with the command that flies it where that may help."""
    notes = [] if ended.as_planned else [f"{plan.script.name}: {ended.sentence}"]
    missing = steps_missing(plan, ended, earlier) if resume else 0
    parts = [f"{missing} of {len(plan.legs)} steps are missing"] if missing else []
    if lacking:
        parts.append(f"{join(list(lacking))} {'was' if len(lacking) == 1 else 'were'} not flown")
    if parts:
        down = ended.left in (FlightState.LANDED, FlightState.NOT_ARMED)
        when = "" if down else " when the vehicle is down"
        flies = f": `{resume}` flies {'what is missing' if lacking else 'them'}{when}" if resume else ""
        notes.append(f"{', '.join(parts)}{flies}")
    return [*notes, *unflown_steps(ended)]


def first_news(ends: Sequence[FlightResult]) -> str:
    """What an answer begins with, before what was found in the recordings; '' where there is nothing of the kind."""
    return " ".join(filter(None, (_left_in_air(ends), _record_lacks(ends))))


def _left_in_air(ends: Sequence[FlightResult]) -> str:
    """A sentence on a vehicle that was left otherwise than on the ground or, by agreement, with the pilot; else ''."""
    last = ends[-1] if ends else None
    if last is None or last.as_planned or last.left in (FlightState.NOT_ARMED, FlightState.LANDED):
        return ""
    sentence = last.how_left
    return f"{sentence[0].upper()}{sentence[1:]}."


def _record_lacks(ends: Sequence[FlightResult]) -> str:
    """A sentence where a disk did not take the whole record; else ''."""
    found = "; ".join(e.incomplete for e in ends if e.incomplete)
    return f"The record is not complete: {found}." if found else ""


def unflown_steps(ended: FlightResult) -> list[str]:
    """Why steps that were tried are missing: one sentence for each reason."""
    flown = {leg.leg for leg in ended.legs if leg.outcome is LegOutcome.FLOWN}
    reasons: dict[str, list[str]] = {}
    for leg in {leg.leg: leg for leg in ended.legs if leg.leg not in flown}.values():
        why = refusal_sentences(leg.refused) or leg.why[:1]
        reasons.setdefault(f"{leg.outcome.value}: {'; '.join(why)}" if why else leg.outcome.value, []).append(leg.leg)
    return [
        f"{legs[0]}{f' and {len(legs) - 1} more' if len(legs) > 1 else ''} not flown: {reason}"
        for reason, legs in reasons.items()
    ]
