"""A mismatch that a model had in its own flights, alike, is no change of the vehicle.

A diagnosis may leave a fifth of what it found (`EXPLAINED_SHARE`), over a noise floor that repeats measure as finely as they repeat. From
the model on, a later flight finds that rest again, and has nothing else to find. So what is found is held against what the model's own
flights left of the same steps, or those most like them, curve from curve: it was there where more than half of it goes with that, and
less than half stays. Both sides are after a fit to their own flights, so that what a parameter takes up is in neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from flighttest.channels import CHANNELS
from flighttest.diagnose import Diagnosis, Finding, Located
from flighttest.diagnose.model import flown, short
from flighttest.diagnose.step_error import StepError, between, errors_from
from flighttest.identify.models.model_file import ModelFile
from flighttest.report.numbers import join

UNITS = {short(name): channel.unit for name, channel in CHANNELS.items()}
NEW = 0.5  # of what was found, beside what the model's own flights left: more of it came than was there


class KnownMismatch:
    """What a model's own flights left, against what a new diagnosis found."""

    def __init__(self, found: Diagnosis, stored: ModelFile) -> None:
        """found: from this model on; stored: a model that keeps what its flights left, else nothing is known."""
        self.before = errors_from((stored.diagnosed or {}).get("left"))
        self.found = found

    def of_place(self, place: Located) -> str:
        """Where a mismatch without a name was there before, in words; empty where it came, or nothing is known of it."""
        if not self.before:
            return ""
        apart, now = self._apart(place.channel, place.kind)
        size = place.rmse**2 - place.floor**2
        return "" if _came(apart, now, size) else _alike(place.channel, place.kind, apart, now)

    def of_finding(self, finding: Finding) -> str:
        """The same of a mismatch that has a name now."""
        if not self.before:
            return ""
        channel, kind = finding.evidence["where"]["channel"], finding.evidence["where"]["kind"]
        if channel not in self.found.noise_floor:
            return ""
        apart, now = self._apart(channel, kind)
        size = (finding.evidence["floors"] * self.found.noise_floor[channel]["value"]) ** 2
        return "" if _came(apart, now, size) else _alike(channel, kind, apart, now)

    def _apart(self, channel: str, kind: str) -> tuple[float, float]:
        """(mean square of what such steps are missed by beside what the model's own flights left, with it), in the channel's unit squared;
        NaN where these flew no such step twice."""
        apart, now = [], []
        steps = [e for e in self.found.errors if (short(e.channel), e.kind) == (channel, kind)]
        for step in steps:
            known = nearest(self.before, step)
            if known is None:
                return math.nan, math.nan
            apart.append(step.responses * between(step, known))
            now.append(step.responses * step.power)
        count = sum(e.responses for e in steps)
        return (sum(apart) / count, sum(now) / count) if count else (math.nan, math.nan)


def nearest(errors: Sequence[StepError], step: StepError) -> StepError | None:
    """The same channel's error in the step most like this one; None where there is none of its kind."""
    same = [e for e in errors if (e.channel, e.kind) == (step.channel, step.kind) and set(e.cell) == set(step.cell)]
    return min(same, key=lambda e: math.dist([e.cell[k] for k in step.cell], list(step.cell.values())), default=None)


def _came(apart: float, now: float, size: float) -> bool:
    """Whether what was found is not what was there. now, apart: mean squares with and without what was there; size: of what was found.

    It was there where more of it than `NEW` goes with that, and no more than `NEW` stays: what only repeats differ by never goes, and an
    effect that came beside an old mismatch stays. NaN, where nothing is known: it came.
    """
    return not (now - apart > NEW * size and apart <= NEW * size)


def _alike(channel: str, kind: str, apart: float, now: float) -> str:
    left, unit = math.sqrt(max(apart, 0.0)), UNITS[channel]
    return f"{channel} of {flown(kind)} ({left:.2g} of {math.sqrt(now):.2g} {unit} is beside that)"


def as_old_as_the_model(what: str, places: Sequence[str]) -> str:
    """A sentence on what was there before. places: in the words of `KnownMismatch`."""
    return (
        f"whether {what} came: the model's own flights were missed alike in {join(list(places))}, so that it may be as old as they are; "
        "`flighttest diagnose` of both together describes it"
    )
