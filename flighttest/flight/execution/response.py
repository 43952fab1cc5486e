"""How late thrust follows throttle, seen while flying: what the plan's prior assumes, measured on this vehicle.

Climb rate after a throttle step is the integral of the commanded thrust, shifted by the thrust's mean age (delay and lag together) and
damped by the air; so one step whose height and climb rate were heard gives the age by a line fit, without any model of the vehicle. Of a
tilted thrust its vertical part does the same, as long as the tilt is moderate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from flighttest.frames import G_M_S2
from flighttest.plan import AttitudeTarget, Plan

FloatArray = NDArray[np.float64]

_AGES_S = np.arange(0.0, 0.405, 0.005)
_LEVEL_RAD = 0.02
_TILT_MAX_RAD = 0.45  # beyond it, what the air does to a fast vehicle is no small thing beside the thrust
_SHORTEST_S = 0.5
_EXCURSION = 0.2  # of the hover throttle: less than this shows no age
_MISFIT_MAX_M_S = 0.25  # rms; a gust, or a throttle that is not followed, would be taken for an age


@dataclass(frozen=True)
class Learnt:
    """The vehicle's thrust, estimated from a hover and the legs flown so far.

    hover_throttle at voltage_v; thrust_age_s: from sending a throttle to its mean effect, None as long as no leg determined it.
    """

    hover_throttle: float
    voltage_v: float
    thrust_age_s: float | None = None


class Replanner(Protocol):
    """Plans the same script again for what was learnt in flight. Passed in: the control holds no model."""

    def due(self, learnt: Learnt) -> bool:
        """Whether the present plan rests on something else than this. Quick."""
        ...

    def plan(self, learnt: Learnt) -> Plan:
        """The plan for it; a leg that still fits keeps its id. Takes about a second."""
        ...


@dataclass
class ThrottleTrace:
    """What was sent and seen during one leg. hover_throttle: what holds the height now; angle_boost: the autopilot divides throttle by
    the cosine of the tilt by itself, so that all of it acts upwards."""

    hover_throttle: float
    angle_boost: bool = False
    _sent: list[tuple[float, float]] = field(default_factory=list)
    _seen: list[tuple[float, float, float]] = field(default_factory=list)
    _upright: float = 1.0

    def sent(self, t_s: float, target: AttitudeTarget) -> None:
        """A target that left at t_s."""
        upright = math.cos(target.roll_rad) * math.cos(target.pitch_rad)
        self._upright = min(self._upright, upright)
        self._sent.append((t_s, target.throttle * (1.0 if self.angle_boost else upright)))

    def seen(self, t_s: float, climb_m_s: float | None, height_m: float | None) -> None:
        """Climb rate and height heard at t_s; repeated or missing ones are passed over."""
        if climb_m_s is None or height_m is None or (self._seen and t_s <= self._seen[-1][0]):
            return
        self._seen.append((t_s, climb_m_s, height_m))

    def age_s(self) -> float | None:
        """Mean age of the thrust, s; None where this leg does not show it (tilted far, too short, too even, or not explained by it)."""
        if self._upright < math.cos(_TILT_MAX_RAD) or len(self._sent) < 10 or len(self._seen) < 10:
            return None
        sent, seen = np.array(self._sent), np.array(self._seen)
        push = sent[:, 1] / self.hover_throttle - 1.0
        if seen[-1, 0] - seen[0, 0] < _SHORTEST_S or float(np.max(np.abs(push))) < _EXCURSION:
            return None
        speed = np.concatenate([[0.0], np.cumsum(G_M_S2 * push[:-1] * np.diff(sent[:, 0]))])
        climb, risen = seen[:, 1], seen[:, 2] - seen[0, 2]
        rest = [risen, np.ones(len(seen))]
        if self._upright < math.cos(_LEVEL_RAD):
            # The speed that tilt brings grows with time, and its drag has a part that acts up or down.
            rest.append((seen[:, 0] - seen[0, 0]) ** 2)
        misfits = []
        for age in _AGES_S:
            commanded = np.interp(seen[:, 0] - age, sent[:, 0], speed)
            columns = np.column_stack([commanded, *rest])
            found, *_ = np.linalg.lstsq(columns, climb, rcond=None)
            misfits.append(float(np.mean((climb - columns @ found) ** 2)))
        best = int(np.argmin(misfits))
        if best == len(_AGES_S) - 1 or math.sqrt(misfits[best]) > _MISFIT_MAX_M_S:
            return None
        return float(_AGES_S[best])


def hover_off(measured: float, used: float, path: str) -> str:
    """A sentence on a hover throttle that is not the one of the vehicle file at `path`, '' where none was given."""
    if path:
        return f"hover throttle measured {measured:.3f}, {used:.3f} in {path}: more than 10 % off; correct it there"
    return f"hover throttle measured {measured:.3f}, assumed {used:.3f}: more than 10 % off; state it in a vehicle file (--vehicle)"
