"""What a flight lacks of its plan and of its record, why, and the command that flies it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from flighttest.flight import FlightOutcome, FlightResult, FlightState, LegOutcome
from flighttest.pipeline.store.resuming import flown_in
from flighttest.plan import Plan
from flighttest.report.numbers import join


def steps_missing(plan: Plan, ended: FlightResult, earlier: Sequence[Path]) -> int:
    """How many steps of a plan no flight has, where another flight may help. earlier: the runs it goes on with."""
    again = ended.outcome is not FlightOutcome.COMPLETED or any(
        leg.outcome in (LegOutcome.NOT_SETTLED, LegOutcome.LINK_LOST) for leg in ended.legs
    )
    return len({leg.id for leg in plan.legs} - flown_in([*earlier, ended.run_dir])) if again else 0


def resume_command(
    plan: Plan, ended: FlightResult, earlier: Sequence[Path], scripts: Sequence[str], options: str
) -> str:
    """The command that flies what a campaign lacks, '' where that is nothing, or the flight ended neither between two steps nor with a
    take-over. scripts: the words for this script and those after it, where these were not flown. options: without
    which this flight's preflight would have refused; the vehicle and the link are in the run."""
    resumable = ended.outcome.orderly or ended.outcome is FlightOutcome.TAKE_OVER
    if not resumable or not (scripts or steps_missing(plan, ended, earlier)):
        return ""
    return f"flighttest run --resume {shlex.join([str(ended.run_dir), *scripts])}{options}"


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


def record_lacks(ends: Sequence[FlightResult]) -> str:
    """A sentence where a disk did not take the whole record; else ''."""
    found = "; ".join(e.incomplete for e in ends if e.incomplete)
    return f"The record is not complete: {found}." if found else ""


def unflown_steps(ended: FlightResult) -> list[str]:
    """Why steps that were tried are missing: one sentence for each reason."""
    flown = {leg.leg for leg in ended.legs if leg.outcome is LegOutcome.FLOWN}
    reasons: dict[str, list[str]] = {}
    for leg in {leg.leg: leg for leg in ended.legs if leg.leg not in flown}.values():
        reasons.setdefault(": ".join([leg.outcome.value, *leg.why[:1]]), []).append(leg.leg)
    return [
        f"{legs[0]}{f' and {len(legs) - 1} more' if len(legs) > 1 else ''} not flown: {reason}"
        for reason, legs in reasons.items()
    ]
