"""Whether a model is still valid, as an answer: verdict, changes, tests, and what to fly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from flighttest.documents import PlainData

FloatArray = NDArray[np.float64]

# Parameter subsets of the paper (section 3) and the shipped script that identifies each.
SUBSETS: dict[str, tuple[str, ...]] = {
    "attitude": ("omega_phi", "omega_theta", "zeta_phi", "zeta_theta"),
    "yaw": ("sigma_r",),
    "thrust": ("sigma_t", "K", "alpha"),
    "drag": ("d_x", "d_y", "d_z"),
}
SCRIPTS: dict[str, tuple[str, ...]] = {
    "attitude": ("roll_pitch",),
    "yaw": ("yaw_rate",),
    "thrust": ("thrust",),
    "drag": ("roll_pitch",),
}
ALL_SCRIPTS: tuple[str, ...] = ("roll_pitch", "yaw_rate", "thrust")


# What an operator reads for a parameter.
WORDS: dict[str, str] = {
    "K": "thrust per throttle",
    "alpha": "dependence of thrust on voltage",
    "sigma_t": "speed of the thrust response",
    "omega_phi": "speed of the roll response",
    "omega_theta": "speed of the pitch response",
    "zeta_phi": "damping of the roll response",
    "zeta_theta": "damping of the pitch response",
    "sigma_r": "speed of the yaw rate response",
    "d_x": "drag forward",
    "d_y": "drag sideways",
    "d_z": "drag in climb",
    "T_d_attitude": "delay of the attitude",
    "T_d_yaw_rate": "delay of the yaw rate",
    "T_d_thrust": "delay of the thrust",
    "hover_throttle": "the throttle that holds height",
    **{f"motor_{k}": f"command of motor {k} beside the others" for k in range(1, 5)},
}


class ValidityVerdict(Enum):
    """Whether the model still holds. The value is the sentence shown to the reader."""

    CURRENT = "the model still holds for this vehicle"
    STALE = "the model is stale: fly the named scripts again"
    UNKNOWN = "nothing here shows whether the model still holds"


@dataclass(frozen=True)
class DeclaredChange:
    """Something declared that differs between the model's vehicle and today's.

    kind: component, mass, firmware, parameter, voltage or frame. touches: subsets of `SUBSETS`; scripts: the paper's rule (all of
    them); narrower: scripts that would do, with the reason in `because`. since: the declared date where `dated`, else after which flight.
    """

    kind: str
    name: str
    before: str
    after: str
    touches: tuple[str, ...]
    scripts: tuple[str, ...]
    narrower: tuple[str, ...]
    because: str
    since: str = ""
    dated: bool = False


@dataclass(frozen=True)
class SubsetTest:
    """One parameter subset of a new recording against the stored model.

    statistic: squared Mahalanobis distance over `dof` parameters, p_value under "nothing changed", alarm when below `level`.
    shifts: parameter to (relative change, z). sentence: what an operator reads. detectable: parameter to the relative change that would
    have raised the alarm by itself: less may have happened unseen. alike: kinds of step that were flown both times and compared with one
    another; 0 where estimates were compared.
    """

    subset: str
    statistic: float
    dof: int
    p_value: float
    level: float
    alarm: bool
    shifts: Mapping[str, tuple[float, float]]
    sentence: str
    detectable: Mapping[str, float] = field(default_factory=dict)
    matched: int = 0


@dataclass(frozen=True)
class Untested:
    """A parameter of the model that a new recording does not test. smallest: relative change that would have shown, None where none would;
    fly: scripts that show it."""

    parameter: str
    subset: str
    smallest: float | None
    fly: tuple[str, ...]


@dataclass(frozen=True)
class Appeared:
    """An effect that a new recording shows and the model does not have. term: '' where it has no name; unseen: whether the model's own
    flights could not have shown it, so that it may be as old as they are."""

    term: str
    title: str
    sentence: str
    unseen: bool


@dataclass(frozen=True)
class NotSeen:
    """An effect that neither the model has nor a new recording shows. smallest: size in `unit` from which on it would have shown, None
    where none would; hidden: whether an effect of twice its usual size could have been there unseen; fly: script that shows it, '' where
    a channel that it needs was not recorded."""

    term: str
    family: str
    smallest: float | None
    unit: str
    hidden: bool
    fly: str


@dataclass(frozen=True)
class Drift:
    """A CUSUM over runs of one parameter: its largest excursion against the limit.

    false_alarm_every: mean number of unchanged runs between false alarms. crossed_at: name of the run, or empty.
    """

    parameter: str
    excursion: float
    limit: float
    false_alarm_every: float
    crossed_at: str
    change: float


@dataclass(frozen=True)
class BatteryCheck:
    """Internal resistance from voltage against current. resistance_ohm: (value, std); None where it cannot be determined, and why."""

    resistance_ohm: tuple[float, float] | None
    reference_ohm: tuple[float, float] | None
    alarm: bool
    sentence: str


@dataclass(frozen=True)
class Assessment:
    """The whole answer. impact: what the change means for a plan made with the model; fly: script names, in order."""

    verdict: ValidityVerdict
    sentence: str
    changes: tuple[DeclaredChange, ...] = ()
    tests: tuple[SubsetTest, ...] = ()
    drifts: tuple[Drift, ...] = ()
    battery: BatteryCheck | None = None
    impact: tuple[str, ...] = ()
    fly: tuple[str, ...] = ()
    fly_narrow: tuple[str, ...] = ()
    could_also_be: tuple[str, ...] = ()
    cannot_tell: tuple[str, ...] = ()
    appeared: tuple[Appeared, ...] = ()
    not_seen: tuple[NotSeen, ...] = ()
    untested: tuple[Untested, ...] = ()
    minutes: float | None = None
    evidence: Mapping[str, PlainData] = field(default_factory=dict)
