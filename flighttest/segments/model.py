"""`Segment`: one step response or free-flight window on one regular or irregular time base."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from flighttest.segments.compatibility import Compatibility

FloatArray = NDArray[np.float64]
T = TypeVar("T")


class Flaw(Enum):
    """Why a segment cannot be used. The value is the sentence shown to the reader."""

    GAP = "samples are missing in the middle of the response"
    NOT_SETTLED = "the vehicle had not settled before the step"
    TAKE_OVER = "the flight mode changed during the response (a take-over, a failsafe, a mission)"
    CLIPPED = "a sensor or a command was at its limit"
    WRONG_MODE = "the autopilot was not in the maneuver's mode"
    LINK_LOST = "targets stopped arriving during the response"
    LATE = "a target left more than 0.1 s late during the response"
    TOO_SHORT = "less than 0.3 s was recorded after the step"
    TOO_FEW = "fewer than eight samples were recorded during the response"
    CONTROL_LOST = "control was lost: the attitude left what was asked for"
    ABORTED = "the flight was aborted during the response"
    NOT_A_NUMBER = "a channel has fewer than four values during the response"
    NOTHING_ASKED = "neither references nor a throttle were recorded: nothing says what the vehicle was asked for"
    REFERENCE_MOVED = "another reference moved during the response"


@dataclass(frozen=True)
class SegmentContext:
    """What was recorded beside a response and what is known of how it was recorded; defaults: nothing is known.

    later_edges_s: further edges of the same input inside the response. between_steps: a window in which the vehicle is brought back.
    by_hand: a pilot or another controller chose the references. filters: channel group to cut-off, Hz (as `Provenance.filters`).
    reference_clock: 'vehicle' or 'ground', where references are stamped, '' where that is not known; clock_error_s: between the two
    clocks, None where it is not known; edge_error_s: what is not known of the time of an edge in a table. derived: channel name to the
    sentence on how it was derived. compatibility: what was corrected by kinematics. voltage_samples: (t_s (n,), voltage_v (n,)) as
    recorded, in and about the segment; None where the voltage is not that of the recording. hover_throttle: median of the flight, None
    where that is not known. trimmed_m_s: velocity through the air, forward, left, up in body axes, times the root of thrust over hover
    thrust, at which the autopilot has trimmed the moments of the air away: the mean of a flight, none of a hover.
    """

    later_edges_s: tuple[float, ...] = ()
    between_steps: bool = False
    by_hand: bool = False
    filters: Mapping[str, float] = field(default_factory=dict)
    reference_clock: str = ""
    clock_error_s: float | None = None
    edge_error_s: float = 0.0
    derived: Mapping[str, str] = field(default_factory=dict)
    compatibility: Compatibility | None = None
    voltage_samples: tuple[FloatArray, FloatArray] | None = None
    hover_throttle: float | None = None
    trimmed_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Segment:
    """One response, from before its step until its record ends.

    kind: roll_step, pitch_step, yaw_rate_step, throttle_step, tilt_throttle or free (a window of free flight).
    cell: what distinguishes it from other steps of its kind (amplitude_rad, rate_rad_s, throttle_0, throttle_1; signed; axis of the tilt
    in tilt_throttle: 0 roll, 1 pitch);
    repeats share a cell. t_step_s: the input step, as recorded.

    t_s: (n,) s, vehicle clock, the sample times. y: channel name to (n,) samples at t_s; NaN where missing. References
    are not sampled but kept as they changed: `u` maps each of `channels.INPUTS` that was recorded to (t_edge_s (m,), value (m,)), held from
    each edge to the next; the first edge lies at or before t_s[0] - 0.5 s where the recording allows, so that delays can
    reach back. time_since_takeoff_s: at the step. flaws: empty when the segment may be fitted.
    """

    name: str
    run: str
    kind: str
    cell: Mapping[str, float]
    repeat: int
    t_step_s: float
    t_s: FloatArray
    y: Mapping[str, FloatArray]
    u: Mapping[str, tuple[FloatArray, FloatArray]]
    flaws: tuple[Flaw, ...] = ()
    notes: tuple[str, ...] = ()
    maneuver: str = ""
    heading_rad: float = float("nan")
    time_since_takeoff_s: float = float("nan")
    context: SegmentContext = field(default_factory=SegmentContext)

    def once(self, key: Hashable, work: Callable[[], T]) -> T:
        """The result of `work`, done once under a key for as long as this segment lives: a diagnosis prepares the same segments for dozens
        of models. It stays behind when the segment goes to another process."""
        known = self._worked_out
        if key not in known:
            known[key] = work()
        found: T = known[key]
        return found

    @cached_property
    def _worked_out(self) -> dict[Hashable, Any]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """The fields, without what was worked out."""
        return {name: value for name, value in self.__dict__.items() if name != "_worked_out"}

    @property
    def usable(self) -> bool:
        """True when there is no reason against fitting this segment."""
        return not self.flaws

    @property
    def steered(self) -> bool:
        """Whether a pilot or another controller flew what this was cut from, instead of a script that asked for steps."""
        return self.kind == "free" or self.context.by_hand

    @property
    def between_steps(self) -> bool:
        """Whether it is a window between steps, in which the vehicle is brought back: no flight that anybody meant to be looked at."""
        return self.context.between_steps

    @property
    def seconds(self) -> float:
        """How long after its step the record ends, s."""
        return float(self.t_s[-1]) - self.t_step_s

    def until(self, seconds: float) -> Segment:
        """The same response whose record ends so long after its step, s; itself where it is no longer."""
        kept = self.t_s <= self.t_step_s + seconds
        if kept.all():
            return self
        return replace(self, t_s=self.t_s[kept], y={name: values[kept] for name, values in self.y.items()})

    @property
    def since_takeoff_s(self) -> FloatArray:
        """(n,) s since take-off at each sample; since the first sample where the take-off is not known."""
        known = np.isfinite(self.time_since_takeoff_s)
        return self.t_s - (self.t_step_s - self.time_since_takeoff_s if known else self.t_s[0])

    @property
    def cell_key(self) -> tuple[str, tuple[tuple[str, float], ...]]:
        """Hashable identity of the cell: repeats of one step share it. A step by hand repeats no other: what comes before it, and with it,
        is not scripted."""
        own = {"at_s": self.t_step_s} if self.context.by_hand and self.kind != "free" else {}
        return self.kind, tuple(sorted((k, round(v, 4)) for k, v in {**self.cell, **own}.items()))
