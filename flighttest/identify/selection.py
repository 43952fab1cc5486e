"""Data selection: which segments feed which block of the model, and the estimation problem made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from flighttest.errors import FitError
from flighttest.estimation.level import refusal, taken_as_level
from flighttest.estimation.problem import Problem
from flighttest.estimation.responses import attitude_is_known, dead_channels, never_changing
from flighttest.physics.blocks import Block
from flighttest.physics.model import Model
from flighttest.segments.model import Flaw, Segment

Select = Literal["paper", "all"]

LEVEL_STEPS = ("throttle_step", "yaw_rate_step")
STEP_KIND = {"roll": "roll_step", "pitch": "pitch_step", "yaw": "yaw_rate_step"}
ATTITUDE_STEP_MAX_RAD = 0.35  # larger steps may saturate the rate: the paper's Pi_1 uses 0.2 and 0.3 rad
FEW_STEPS = 6  # fewer steps than this of a block, beside free flight, are no campaign
LEAST_CHANGE = 0.02  # of a reference that moves: rad, rad/s or throttle
DRAG_STEP_MIN_RAD = 0.25  # the paper's Pi_4 uses 0.3 and 0.5 rad


NOTHING_ASKED = Flaw.NOTHING_ASKED.value
LOG_REFERENCES = "log them (ArduPilot: RATE, CTUN; telemetry: ATTITUDE_TARGET), or name their columns in a column map"


def nothing_asked(segments: Sequence[Segment]) -> bool:
    """Whether there are segments, and none of them has a reference or a throttle: no model can be fitted to them."""
    return bool(segments) and not any(s.u for s in segments)


def able(segments: Sequence[Segment], block: Block) -> list[int]:
    """Positions of the segments in which a block's references move."""
    return [i for i, s in enumerate(segments) if _can_feed(s, block)]


def segments_for(
    segments: Sequence[Segment], block: Block, select: Select, among: Sequence[int] | None = None
) -> list[int]:
    """Positions of the segments that feed a block, among those that are `able` to.

    select: 'paper' (Pi_1 from tilt steps up to 0.35 rad, Pi_4 from those above 0.25 rad, free flight only where there are no steps) or
    'all' (every segment in which its references move).
    """
    members = able(segments, block) if among is None else list(among)
    return _as_in_the_paper(segments, members, block) if select == "paper" else members


def problem_of(
    segments: Sequence[Segment],
    model: Model,
    *,
    select: Select = "paper",
    values: Mapping[str, float] | None = None,
    fixed: Sequence[str] = (),
    ties: Mapping[str, str] | None = None,
) -> Problem:
    """The estimation problem of the usable ones of these segments (`segments_for` for select, `Problem.build` for the rest).

    FitError when none of them feeds any block.
    """
    usable = tuple(s for s in segments if s.usable)
    dead = dead_channels(usable)
    fed = {block.name: segments_for(usable, block, select) for block in model.blocks}
    problem = Problem.build(usable, model, fed=fed, values=values, fixed=fixed, ties=ties, dead=dead)
    if not problem.parts:
        if nothing_asked(usable):
            raise FitError(NOTHING_ASKED, LOG_REFERENCES)
        why = "".join(f"; {one}" for one in (never_changing(dead) if dead else "", refusal(usable)) if one)
        raise FitError(
            f"no usable segment excites any part of the model{why}",
            "see `flighttest segment` for what was recorded, and why segments were rejected",
        )
    return problem


def _change(segment: Segment, name: str) -> float:
    """Largest change of a reference within what the segment's samples can show."""
    if name not in segment.u:
        return 0.0
    times, values = segment.u[name]
    seen = values[(times > segment.t_s[0] - 0.3) & (times < segment.t_s[-1])]
    before = values[times <= segment.t_s[0] - 0.3][-1:]
    both = np.concatenate([before, seen])
    return float(np.ptp(both)) if both.size else 0.0


def _can_feed(segment: Segment, block: Block) -> bool:
    if block.name == "translation":
        return "throttle" in segment.u and (
            segment.kind in LEVEL_STEPS or attitude_is_known(segment) or taken_as_level(segment)
        )
    return all(n in segment.u for n in block.inputs) and moves(segment, block)


def moves(segment: Segment, block: Block) -> bool:
    """Whether any reference of a block changes in a segment."""
    return any(_change(segment, n) > LEAST_CHANGE for n in block.inputs)


def changes(segments: Sequence[Segment], reference: str) -> bool:
    """Whether a reference changes in any of these segments."""
    return any(_change(s, reference) > LEAST_CHANGE for s in segments)


def _amplitude(segment: Segment) -> float:
    return abs(float(segment.cell.get("amplitude_rad", np.nan)))


def _as_in_the_paper(segments: Sequence[Segment], members: list[int], block: Block) -> list[int]:
    """Which of the segments that could feed a block do, by the paper's rules; none is left without data if any exists."""
    if block.name == "translation":
        tilt = ("roll_step", "pitch_step")
        chosen = [
            i for i in members
            if segments[i].kind in ("throttle_step", "tilt_throttle")
            or (segments[i].kind in tilt and not _amplitude(segments[i]) < DRAG_STEP_MIN_RAD)
        ]  # fmt: skip
        steps = chosen or [i for i in members if segments[i].kind in tilt]
    else:
        kinds = {kind for axis, kind in STEP_KIND.items() if axis in block.name}
        every = [i for i in members if segments[i].kind in kinds]
        steps = [i for i in every if not _amplitude(segments[i]) > ATTITUDE_STEP_MAX_RAD] or every
    free = [i for i in members if segments[i].kind == "free"]
    if len(steps) < FEW_STEPS and free:
        # A pilot's flight with the odd step in it, no campaign: the flight is the data.
        return sorted({*steps, *free})
    return steps or members
