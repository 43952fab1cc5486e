"""The wind of each flight, drag shared by all: one vehicle, flown in several weathers, or in none.

In one flight at one heading a wind is a tilt that holds against drag, and so is an attitude offset. Several flights of one
vehicle share drag and offset and differ in the wind; flights that are known to be in still air tie the offset down.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from flighttest.estimation.responses import relative_thrust
from flighttest.estimation.uncertainty.distributions import chi2_beyond
from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.identify.free_flight.estimate import estimate
from flighttest.identify.free_flight.estimated import FreeFlight
from flighttest.identify.free_flight.stretches import recorded, stretches
from flighttest.identify.models.model_blocks import FlightWindRow
from flighttest.physics.blocks import VELOCITY
from flighttest.physics.model import Model
from flighttest.segments.model import Segment

STILL_STD_M_S = 0.2  # draught of a closed hall (ISO 7730, 2005: below 0.25 m/s)
CHANCE = 0.01  # that still air is called wind
TURNED_RAD = 0.5  # headings that differ by less do not part a wind from an offset
WIND = ("w_north", "w_west")
WIND_TERM = "steady_wind"
# What a steady wind looks like at one heading: a tilted thrust axis, and the in-plane force of rotors in a wind, thrust times velocity
# through the air (Mahony, Kumar, Corke 2012), which is a tilt of the thrust axis as well.
BESIDE_WIND = ("attitude_offset", "thrust_scaled_drag")


class WindVerdict(Enum):
    """What is reported of the air in one flight; the value is what model.yaml and diagnosis.json carry."""

    WIND = "wind"
    NONE_SEEN = "none seen"
    STILL = "still"  # declared, and the data do not contradict it


@dataclass(frozen=True)
class FlightWind:
    """Velocity of the air in one flight, m/s, world; std of each; chi2: of what drag shows of them against none; factor_95: half a 95 %
    interval in standard errors."""

    flight: str
    north: float
    west: float
    north_std: float
    west_std: float
    chi2: float
    verdict: WindVerdict
    factor_95: float

    @property
    def speed(self) -> float:
        """m/s."""
        return float(np.hypot(self.north, self.west))

    @property
    def speed_std(self) -> float:
        """Standard error of the speed, m/s."""
        share = np.array([self.north, self.west]) / max(self.speed, 1e-9)
        return float(np.hypot(share[0] * self.north_std, share[1] * self.west_std))

    @property
    def from_deg(self) -> float:
        """Compass direction it comes from, degrees."""
        return float(np.degrees(np.arctan2(self.west, -self.north)) % 360.0)


@dataclass(frozen=True)
class Winds:
    """Every flight's wind, and the fit that they are of; turned: whether headings varied enough to part wind from attitude offset."""

    flights: tuple[FlightWind, ...]
    fit: FreeFlight
    turned: bool
    declared: frozenset[str]


def winds(segments: Sequence[Segment], model: Model, weather: Mapping[str, str] | None = None) -> Winds | None:
    """Wind per flight by equation error; None where no free flight has attitude, velocity and throttle, or drag is not seen.

    weather: flight to 'still', a prior of no wind with a standard deviation of 0.2 m/s; other flights have none but that of usual winds.
    """
    flown = [s for s in stretches([s for s in segments if s.kind == "free"]) if recorded(s, VELOCITY)]
    if not flown:
        return None
    tried = Model(
        ("body", "linear_drag", WIND_TERM, *BESIDE_WIND), nominal_voltage_v=model.nominal_voltage_v, attitude_loops=False,
        rotor_height_m=model.rotor_height_m,
    )  # fmt: skip
    declared, priors = still_air(weather)
    free = [n for n in tried.names if n != "w_up" and (n != "alpha" or _voltage_varies(flown))]
    found = estimate(flown, tried, free=free, per_flight=WIND, priors=priors)
    drag = [found.values[n] / found.std[n] for n in ("d_x", "d_y") if n in found.std and found.std[n] > 0]
    if not drag or max(drag) < 2.0:
        return None
    return Winds(tuple(winds_of(found, headings_of(flown), declared)), found, turned(flown), declared)


def winds_of(
    found: FreeFlight, headings: Mapping[str, float], declared: frozenset[str] = frozenset()
) -> list[FlightWind]:
    """The wind of every flight in an estimate with `w_north` and `w_west` per flight. headings: of flights that keep theirs, as of
    `headings_of`; declared: flights declared to be in still air.

    A wind is force over drag, and a force over a drag that may be none says nothing of it (Fieller 1954: its interval has no end). At one
    heading the axes of the body are tested apart, and only those whose drag is distinguished from none.
    """
    made = []
    for flight in found.flights:
        at = [found.names.index(f"{n}@{flight}") for n in WIND]
        w = np.array([found.values[found.names[i]] for i in at])
        covariance = found.covariance[np.ix_(at, at)]
        std = np.sqrt(np.diag(covariance))
        to_body, yaw = np.eye(2), headings.get(flight)
        if yaw is not None:
            to_body = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
            speeds = np.abs(to_body @ w).tolist()
            to_body = to_body[[_drag_is_seen(found, axis, speed) for axis, speed in zip("xy", speeds, strict=True)]]
        along, known = to_body @ w, to_body @ covariance @ to_body.T
        chi2 = float(along @ np.linalg.pinv(known) @ along) if np.isfinite(std).all() else 0.0
        calm = WindVerdict.STILL if flight in declared else WindVerdict.NONE_SEEN
        verdict = WindVerdict.WIND if along.size and chi2_beyond(chi2, along.size) < CHANCE else calm
        made.append(
            FlightWind(flight, float(w[0]), float(w[1]), float(std[0]), float(std[1]), chi2, verdict, found.factor())
        )
    return made


def _drag_is_seen(found: FreeFlight, axis: str, speed_m_s: float) -> bool:
    """Whether the drag along an axis of the body is above none at the level at which winds are tested: per velocity, at hover thrust and
    at a speed through the air, d + c_H g + k |v|."""
    slope = {f"d_{axis}": 1.0, "c_h": G_M_S2, f"k_{axis}": speed_m_s}
    at = {found.names.index(n): weight for n, weight in slope.items() if n in found.names}
    weights, own = np.array(list(at.values())), list(at)
    drag = float(sum(found.values[found.names[i]] * weight for i, weight in at.items()))
    std = float(np.sqrt(weights @ found.covariance[np.ix_(own, own)] @ weights))
    return drag > found.factor(1.0 - CHANCE) * std


def headings_of(flown: Sequence[Segment]) -> dict[str, float]:
    """Mean yaw, rad, of each flight that keeps its heading (`turned`)."""
    found = {}
    for run in dict.fromkeys(s.run for s in flown):
        own = [s for s in flown if s.run == run]
        if not turned(own):
            yaw = np.concatenate([s.y["yaw_rad"][np.isfinite(s.y["yaw_rad"])] for s in own])
            found[run] = float(np.angle(np.mean(np.exp(1j * yaw))))
    return found


def any_wind(winds: Sequence[FlightWind]) -> bool:
    """Whether one of several flights has a wind by its own interval; of a single flight the comparison of models decides, since its
    interval holds what looks like a wind at one heading, too."""
    return len(winds) == 1 or any(w.verdict is WindVerdict.WIND for w in winds)


def wind_rows(flights: Sequence[FlightWind], declared: frozenset[str]) -> list[FlightWindRow]:
    """The wind of each flight as model.yaml and diagnosis.json have it. declared: flights declared to be in still air."""
    return [
        FlightWindRow(
            flight=w.flight,
            w_north=w.north,
            w_west=w.west,
            w_north_std=w.north_std,
            w_west_std=w.west_std,
            speed_m_s=w.speed,
            speed_std=w.speed_std,
            factor_95=w.factor_95,
            from_deg=w.from_deg,
            verdict=w.verdict.value,
            declared="still" if w.flight in declared else "unknown",
        )
        for w in flights
    ]


def still_air(weather: Mapping[str, str] | None) -> tuple[frozenset[str], dict[str, tuple[float, float]]]:
    """Flights declared 'still', and the prior of their wind: none, with a standard deviation of 0.2 m/s."""
    declared = frozenset(f for f, what in (weather or {}).items() if what == "still")
    return declared, {f"{n}@{f}": (0.0, STILL_STD_M_S) for f in declared for n in WIND}


def _voltage_varies(flown: Sequence[Segment]) -> bool:
    every = [s.y["voltage_v"][np.isfinite(s.y["voltage_v"])] for s in flown if "voltage_v" in s.y]
    joined = np.concatenate(every) if every else np.zeros(0)
    return bool(joined.size) and float(np.ptp(joined)) > 0.0


def turned(flown: Sequence[Segment]) -> bool:
    """Whether headings lie further apart than `TURNED_RAD`, over all flights."""
    yaw = np.concatenate([s.y["yaw_rad"][np.isfinite(s.y["yaw_rad"])] for s in flown])
    mean = np.angle(np.mean(np.exp(1j * yaw)))
    off = np.abs(np.angle(np.exp(1j * (yaw - mean))))
    return bool(np.quantile(off, 0.9) > TURNED_RAD / 2)


def in_still_air(segments: Sequence[Segment], winds: Sequence[FlightWind]) -> tuple[Segment, ...]:
    """Segments in the frame of their flight's air: velocity less the wind, position less its way since the segment's start; and how fast
    each flight is in that frame on the average, which the autopilot has trimmed."""
    known = {w.flight: (w.north, w.west) for w in winds}
    made = []
    for s in segments:
        wind, y = known.get(s.run), dict(s.y)
        if wind is not None:
            for axis, w in zip("xy", wind, strict=True):
                if f"v_{axis}_m_s" in y:
                    y[f"v_{axis}_m_s"] = y[f"v_{axis}_m_s"] - w
                if f"p_{axis}_m" in y:
                    y[f"p_{axis}_m"] = y[f"p_{axis}_m"] - w * (s.t_s - s.t_s[0])
        made.append(replace(s, y=y))
    trimmed = {run: _mean_body_velocity([s for s in made if s.run == run]) for run in {s.run for s in made}}
    return tuple(replace(s, context=replace(s.context, trimmed_m_s=trimmed[s.run])) for s in made)


def _mean_body_velocity(segments: Sequence[Segment]) -> tuple[float, float, float]:
    """Of all samples with attitude and velocity, times the root of thrust over hover thrust: forward, left and up, m/s; zero where there
    are none."""
    needed = ("roll_rad", "pitch_rad", "yaw_rad", "v_x_m_s", "v_y_m_s", "v_z_m_s")
    every = [
        np.stack([*(s.y[n] for n in needed), np.sqrt(np.maximum(relative_thrust(s), 0.0))])
        for s in segments
        if all(n in s.y for n in needed)
    ]
    known = np.concatenate(every, axis=1) if every else np.zeros((7, 0))
    known = known[:, np.isfinite(known).all(axis=0)]
    if not known.size:
        return 0.0, 0.0, 0.0
    body = np.einsum("nij,ni,n->nj", rotation_from_euler(known[:3].T), known[3:6].T, known[6])
    forward, left, up = body.mean(axis=0).tolist()
    return forward, left, up
