"""How late thrust follows throttle, and how it grows with it, seen while flying: what the plan's prior assumes, measured on this vehicle.

Climb rate after a throttle step is the integral of the commanded thrust, shifted by the thrust's mean age (delay and lag together) and
damped by the air; so one step whose height and climb rate were heard gives the age by a line fit, without any model of the vehicle. Of a
tilted thrust its vertical part does the same, as long as the tilt is moderate. Thrust at r times the hover throttle is taken as
r (1 + c (r - 1)) times the weight, the form of `throttle_curve`; the curvature c is one number of the same line fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
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
_SPEED_NOISE_M_S = 0.02  # of the climb rate as it is heard: a leg that fits better is not trusted more
_MISFIT_MAX_M_S = 0.25  # rms; a gust, or a throttle that is not followed, would be taken for an age


@dataclass(frozen=True)
class Learnt:
    """The vehicle's thrust, estimated from a hover and the legs flown so far.

    hover_throttle at voltage_v; thrust_age_s: from sending a throttle to its mean effect; curvature: of thrust over throttle, by which
    there is more of it at twice the hover throttle; both None as long as no leg determined them.
    """

    hover_throttle: float
    voltage_v: float
    thrust_age_s: float | None = None
    curvature: float | None = None

    @property
    def words(self) -> str:
        """For the operator."""
        parts = [f"hover throttle {self.hover_throttle:.3f} at {self.voltage_v:.1f} V"]
        if self.thrust_age_s is not None:
            parts.append(f"thrust {1e3 * self.thrust_age_s:.0f} ms after its command")
        if self.curvature is not None:
            more = "less" if self.curvature < 0.0 else "more"
            parts.append(f"{100.0 * abs(self.curvature):.0f} % {more} of it at twice that throttle than in proportion")
        return ", ".join(parts)


@dataclass(frozen=True)
class ThrustSeen:
    """What one leg showed. age_s, curvature: as in `Learnt`; weight: of the curvature, 1 / variance, 0 of a tilted leg, whose speed through
    the air changes the thrust as well."""

    age_s: float
    curvature: float
    weight: float


def learnt(hover_throttle: float, voltage_v: float, seen: Sequence[ThrustSeen]) -> Learnt:
    """What the legs seen so far say together: the median of the ages, and the weighted mean of the curvatures."""
    if not seen:
        return Learnt(hover_throttle, voltage_v)
    total = sum(one.weight for one in seen)
    curvature = sum(one.weight * one.curvature for one in seen) / total if total else None
    return Learnt(hover_throttle, voltage_v, median(one.age_s for one in seen), curvature)


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

    def thrust(self) -> ThrustSeen | None:
        """Age and curvature of the thrust; None where this leg does not show them (tilted far, too short, too even, or not explained by
        them)."""
        if self._upright < math.cos(_TILT_MAX_RAD) or len(self._sent) < 10 or len(self._seen) < 10:
            return None
        sent, seen = np.array(self._sent), np.array(self._seen)
        lift = sent[:, 1] / self.hover_throttle
        push, level = lift - 1.0, self._upright >= math.cos(_LEVEL_RAD)
        if seen[-1, 0] - seen[0, 0] < _SHORTEST_S or float(np.max(np.abs(push))) < _EXCURSION:
            return None
        straight, curved = (
            np.concatenate([[0.0], np.cumsum(G_M_S2 * part[:-1] * np.diff(sent[:, 0]))]) for part in (push, lift * push)
        )
        climb, risen = seen[:, 1], seen[:, 2] - seen[0, 2]
        rest = [risen, np.ones(len(seen))]
        if not level:
            # The speed that tilt brings grows with time, and its drag has a part that acts up or down.
            rest.append((seen[:, 0] - seen[0, 0]) ** 2)
        fits = []
        for age in _AGES_S:
            at = seen[:, 0] - age
            columns = np.column_stack([np.interp(at, sent[:, 0], curved), *rest])
            wanted = climb - np.interp(at, sent[:, 0], straight)
            found, *_ = np.linalg.lstsq(columns, wanted, rcond=None)
            fits.append((float(np.mean((wanted - columns @ found) ** 2)), float(found[0]), columns))
        best = int(np.argmin([misfit for misfit, _, _ in fits]))
        misfit, curvature, columns = fits[best]
        if best == len(_AGES_S) - 1 or math.sqrt(misfit) > _MISFIT_MAX_M_S:
            return None
        others = columns[:, 1:]
        alone = columns[:, 0] - others @ np.linalg.lstsq(others, columns[:, 0], rcond=None)[0]
        weight = float(alone @ alone) / (misfit + _SPEED_NOISE_M_S**2) if level else 0.0
        return ThrustSeen(float(_AGES_S[best]), curvature, weight)


def hover_off(measured: float, used: float, path: str) -> str:
    """A sentence on a hover throttle that is not the one of the vehicle file at `path`, '' where none was given."""
    if path:
        return f"hover throttle measured {measured:.3f}, {used:.3f} in {path}: more than 10 % off; correct it there"
    return f"hover throttle measured {measured:.3f}, assumed {used:.3f}: more than 10 % off; state it in a vehicle file (--vehicle)"
