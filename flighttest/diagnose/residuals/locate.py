"""Where simulation and recording part: by channel, maneuver, cell and phase, and by the variable that explains the residual."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS, WORDS
from flighttest.diagnose.model import Located, brief, flown, short
from flighttest.diagnose.records import MapCell, Overlay, Regime, RegimeCurve
from flighttest.diagnose.residuals.discrepancy import correlation_times
from flighttest.diagnose.residuals.lack_of_fit import NoiseFloor, power_of_noise
from flighttest.estimation.drift import DRIFT
from flighttest.estimation.linearisation import IntArray, Linearisation
from flighttest.estimation.responses import attitude_angles, zero_order_hold
from flighttest.frames import compass_from_yaw, rotation_from_euler, wrap_angle
from flighttest.physics.blocks import VELOCITY
from flighttest.segments.model import Segment

FloatArray = NDArray[np.float64]

TRANSIENT_S = 0.5
BINS = 8
FLIPS = 199
LEAST_EXPLAINED = 0.1
MOST_PLACES = 6
ORDERED = 0.25
LEAST_RESPONSES = 12
WORST = 2  # responses of each channel that are overlaid

VARIABLES = {
    "speed_forward_m_s": ("forward speed", "m/s"), "speed_left_m_s": ("speed to the left", "m/s"),
    "speed_up_m_s": ("vertical speed", "m/s"), "tilt_rad": ("tilt", "rad"), "heading_rad": ("heading", "rad"),
    "p_rad_s": ("roll rate", "rad/s"), "q_rad_s": ("pitch rate", "rad/s"), "r_rad_s": ("yaw rate", "rad/s"),
    "height_m": ("height", "m"), "throttle": ("throttle", ""), "throttle_rate_1_s": ("throttle rate", "1/s"),
    "voltage_v": ("battery voltage", "V"), "time_since_takeoff_s": ("time since take-off", "s"),
    "time_since_command_s": ("time since the last command", "s"),
}  # fmt: skip

# Channels that a variable is made of: as measured, it holds what their models leave, and orders that by itself.
MADE_OF = {
    "speed_forward_m_s": VELOCITY, "speed_left_m_s": VELOCITY, "speed_up_m_s": VELOCITY[2:], "tilt_rad": ("roll_rad", "pitch_rad"),
    "r_rad_s": ("r_rad_s",),
}  # fmt: skip


def regime_variables(segment: Segment) -> dict[str, FloatArray]:
    """What may explain a residual, sampled at the segment's times; only what was recorded."""
    t, y = segment.t_s, segment.y
    found: dict[str, FloatArray] = {}
    angles = [y.get(f"{a}_rad") for a in ("roll", "pitch", "yaw")]
    velocity = [y.get(f"v_{a}_m_s") for a in "xyz"]
    if all(a is not None for a in angles):
        rotation = rotation_from_euler(attitude_angles(segment))
        found["tilt_rad"] = np.arccos(np.clip(rotation[:, 2, 2], -1, 1))
        found["heading_rad"] = wrap_angle(np.asarray(angles[2]))
        if all(v is not None for v in velocity):
            body = np.einsum("nji,nj->ni", rotation, np.stack([np.asarray(v) for v in velocity], axis=1))
            found["speed_forward_m_s"], found["speed_left_m_s"] = body[:, 0], body[:, 1]
            found["speed_up_m_s"] = np.asarray(velocity[2])
    height = y.get("height_m", y.get("p_z_m"))
    if height is not None:
        found["height_m"] = np.asarray(height)
    found |= {name: np.asarray(y[name]) for name in ("p_rad_s", "q_rad_s", "r_rad_s", "voltage_v") if name in y}
    if "throttle" in segment.u:
        throttle = segment.u["throttle"]
        found["throttle"] = zero_order_hold(throttle, t)
        found["throttle_rate_1_s"] = (found["throttle"] - zero_order_hold(throttle, t - 0.1)) / 0.1
    edges_all = np.unique(np.concatenate([e for e, _ in segment.u.values()])) if segment.u else np.empty(0)
    if edges_all.size:
        last = edges_all[np.clip(np.searchsorted(edges_all, t, side="right") - 1, 0, None)]
        found["time_since_command_s"] = np.clip(t - last, 0.0, 10.0)
    if np.isfinite(segment.time_since_takeoff_s):
        found["time_since_takeoff_s"] = segment.since_takeoff_s
    return found


def sampled(rows: Linearisation, segments: Sequence[Segment]) -> dict[str, FloatArray]:
    """Variables at every row; NaN for priors and where not recorded."""
    tables = [regime_variables(s) for s in segments]
    found = {name: np.full(rows.sample.size, np.nan) for name in VARIABLES}
    order = np.argsort(rows.segment, kind="stable")
    starts = np.searchsorted(rows.segment[order], np.arange(len(segments) + 1))
    for i, table in enumerate(tables):
        at = order[starts[i] : starts[i + 1]]
        at = at[rows.sample[at] >= 0]
        for name, values in table.items():
            found[name][at] = values[rows.sample[at]]
    return {k: v for k, v in found.items() if np.isfinite(v).any()}


def phase_of(rows: Linearisation, segments: Sequence[Segment]) -> NDArray[np.str_]:
    """'before', 'transient' or 'steady' per row ('flight' in windows of free flight)."""
    found = np.full(rows.sample.size, "flight", dtype="<U9")
    for i, s in enumerate(segments):
        at = np.flatnonzero((rows.segment == i) & (rows.sample >= 0))
        if s.kind != "free" and at.size:
            since = s.t_s[rows.sample[at]] - s.t_step_s
            found[at] = np.where(since < 0, "before", np.where(since < TRANSIENT_S, "transient", "steady"))
    return found


def residual_map(
    before: Linearisation, after: Linearisation, segments: Sequence[Segment], floor: NoiseFloor
) -> list[MapCell]:
    """RMS over the noise floor by channel, kind, cell and phase, of both models."""
    phase = phase_of(before, segments)
    phases = {p: phase == p for p in ("before", "transient", "steady", "flight")}
    found: list[MapCell] = []
    by_cell: dict[Any, list[int]] = {}
    for i, s in enumerate(segments):
        by_cell.setdefault(s.cell_key if s.kind != "free" else ("free", ()), []).append(i)
    for key, members in sorted(by_cell.items(), key=lambda kv: str(kv[0])):
        inside = np.isin(before.segment, members)
        for c, name in enumerate(before.channels):
            here = inside & (before.channel == c)
            for p, inside_phase in phases.items():
                at = np.flatnonzero(here & inside_phase)
                if not at.size:
                    continue
                found.append(
                    {
                        "channel": short(name),
                        "kind": key[0],
                        "cell": dict(key[1]),
                        "phase": p,
                        "samples": int(at.size),
                        "before_floors": float(np.sqrt(np.mean(before.unprofiled_residual[at] ** 2)) / floor.of(name)),
                        "after_floors": float(np.sqrt(np.mean(after.unprofiled_residual[at] ** 2)) / floor.of(name)),
                    }
                )
    return found


def explained_by(
    residual: FloatArray, variable: FloatArray, response: IntArray, seed: int, flight: IntArray | None = None
) -> tuple[float, float]:
    """(share of the variance between bins of a variable, less what chance makes of it; probability of as much by chance: signs flipped, of
    each flight's mean and of what whole responses differ from it by). What is the same in every bin is explained by nothing.

    flight (n,): which one a sample is of, None where all are of one. Flights differ in vehicle, pack, load and weather at once, so that two
    of them, and any number of responses of theirs, do not show which of these it was.
    """
    good = np.isfinite(variable)
    if good.sum() < 10 * BINS or np.ptp(variable[good]) <= 0:
        return 0.0, 1.0
    r, x, group = residual[good] - np.mean(residual[good]), variable[good], response[good]
    _, of = np.unique(np.zeros(r.size) if flight is None else flight[good], return_inverse=True)
    mean = (np.bincount(of, r) / np.bincount(of))[of]
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1]))
    which = np.searchsorted(edges, x, side="right")
    n_bins = edges.size + 1
    _, member = np.unique(group, return_inverse=True)
    n_groups, n_flights = int(member.max()) + 1, int(of.max()) + 1
    sums = np.zeros((n_groups + n_flights, n_bins))
    np.add.at(sums, (member, which), r - mean)
    np.add.at(sums, (n_groups + of, which), mean)
    count = np.bincount(which, minlength=n_bins).astype(float)
    total = float(r @ r)
    if total <= 0:
        return 0.0, 1.0
    weight = 1.0 / np.maximum(count, 1.0)
    value = float(np.sum(sums.sum(axis=0) ** 2 * weight)) / total
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, n_groups + n_flights))
    null = np.sum((signs @ sums) ** 2 * weight, axis=1) / total
    return value - float(np.mean(null)), float((1 + np.sum(null >= value)) / (FLIPS + 1))


def _beside_disturbance(rows: Linearisation, at: IntArray, floor: float) -> float:
    """Mean square of the residual at these rows with each response's disturbance estimated, in the channel's unit squared; divided by the
    power of its own high frequencies over the floor's, where that is above one."""
    at = at[np.lexsort((rows.sample[at], rows.segment[at]))]
    residual = rows.residual[at] * rows.scale[at]
    return float(np.mean(residual**2)) / max(power_of_noise(residual, rows.segment[at]) / floor, 1.0) ** 2


def _lasting(segments: Sequence[Segment], which: NDArray[np.intp]) -> float:
    """RMS of how long these responses last, s."""
    return float(np.sqrt(np.mean([(segments[i].t_s[-1] - segments[i].t_s[0]) ** 2 for i in which])))


def _others(variables: Mapping[str, FloatArray], channel: str, at: IntArray) -> dict[str, FloatArray]:
    """Variables at these rows, but those that the channel's own measurements make."""
    return {name: x[at] for name, x in variables.items() if channel not in MADE_OF.get(name, ())}


def locate(rows: Linearisation, segments: Sequence[Segment], floor: NoiseFloor, seed: int = 0) -> list[Located]:
    """The places where the mismatch is, worst first: above the floor beyond chance (`NoiseFloor.exceeded`), or ordered by a variable.

    In free flight no repeats show how far a response's disturbance alone drives a velocity away, nor how heavy the tails of the noise are:
    unless a variable orders the whole, what is left beside each response's own disturbance, which is part of the noise model, is compared
    with the floor, or with the power of its own high frequencies where that is more. What a channel's measurements make is no variable of
    its own residual (`MADE_OF`).
    """
    tau = correlation_times(rows, rows.unprofiled_residual, segments)
    variables = sampled(rows, segments)
    names, kind_of = np.unique([s.kind for s in segments], return_inverse=True)
    kinds = kind_of[rows.segment]
    flight = np.unique([s.run for s in segments], return_inverse=True)[1][rows.segment]
    maneuvers = {
        kind: Counter(s.maneuver or s.kind for s in segments if s.kind == kind) for kind in {s.kind for s in segments}
    }
    places = []
    for c, name in enumerate(rows.channels):
        for number, kind in enumerate(names):
            at = np.flatnonzero((rows.channel == c) & (kinds == number))
            if at.size < 40:
                continue
            r = rows.unprofiled_residual[at]
            lasts_s = 0.0 if kind == "free" else _lasting(segments, np.unique(rows.segment[at]))
            least = floor.at(name, str(kind), lasts_s)
            excess = float(np.sum(r**2)) / least**2 - at.size
            here = _others(variables, name, at)
            mean_square = _beside_disturbance(rows, at, least) if kind == "free" else float(np.mean(r**2))
            if floor.exceeded(name, str(kind), mean_square, at.size / tau[c], lasts_s) or ordered_by_a_variable(
                name, r, here, rows.segment[at], least, seed, flight[at]
            ):
                places.append((excess, name, str(kind), at, least))
    found = []
    for _, name, kind, at, least in sorted(places, key=lambda p: -p[0])[:MOST_PLACES]:
        r = rows.unprofiled_residual[at]
        others = _others(variables, name, at)
        scores = {v: explained_by(r, x, rows.segment[at], seed, flight[at]) for v, x in others.items()}
        best = max(scores, key=lambda v: (scores[v][1] <= 0.05, scores[v][0])) if scores else ""
        orders = Orders(best, variables[best][at], *scores[best]) if best else Orders()
        flown_as = maneuvers[kind].most_common(1)[0][0]
        found.append(located_at(name, flown_as, kind, r, orders, least, floor.repeated(name, kind)))
    return found


def ordered_by_a_variable(
    channel: str,
    r: FloatArray,
    variables: Mapping[str, FloatArray],
    response: IntArray,
    floor: float,
    seed: int,
    flight: IntArray | None = None,
) -> bool:
    """Whether a variable orders the residual although repeats differ as much: they differed in that variable. flight: as of `explained_by`.

    A quarter of the variance or more, in no sign flip of the responses as much, and in RMS no less than half the floor (the channel's
    unit) nor than estimators wander by, since that is slow, and so are voltage and time.
    """
    if np.unique(response).size < LEAST_RESPONSES:
        return False
    least = max(0.5 * floor, DRIFT.get(channel, 0.0))
    for x in variables.values():
        share, p_value = explained_by(r, x, response, seed, flight)
        if share >= ORDERED and p_value <= 1 / (FLIPS + 1) and share * float(np.var(r)) >= least**2:
            return True
    return False


@dataclass(frozen=True)
class Orders:
    """The variable that explains a residual best, at its samples, if any: which share of the variance, and its p-value."""

    variable: str = ""
    x: FloatArray | None = None
    share: float = 0.0
    p_value: float = 1.0


def located_at(
    name: str, maneuver: str, kind: str, r: FloatArray, orders: Orders, floor: float, repeated: bool
) -> Located:
    """A mismatch in words and numbers. r: (n,) residual of a channel in one kind of maneuver; floor: what repeats differ by, or, where
    nothing was repeated, what may be noise."""
    x, variable, share, p_value = orders.x, orders.variable, orders.share, orders.p_value
    unit = CHANNELS[name].unit
    rmse = float(np.sqrt(np.mean(r**2)))
    words = WORDS.get(name, short(name))
    ordered = x is not None and share >= LEAST_EXPLAINED and p_value <= 0.05
    known = f" where repeats differ by {floor:.3g}" if repeated else f" where {brief(floor)} may be noise (no repeats)"
    if ordered and rmse <= floor:  # two figures that are the same say nothing
        known = f", no more than {'repeats differ by' if repeated else 'may be noise (no repeats)'}, but ordered"
    head = f"{words.capitalize()} in {flown(kind)}: {rmse:.3g} {unit}{known}"
    regime: Regime = {}
    excess_share, sample_share, peak = 1.0, 1.0, float(r[np.argmax(np.abs(r))])
    if x is not None and ordered:
        label, _ = VARIABLES[variable]
        good = np.isfinite(x)
        power, error = np.where(good, r**2 - floor**2, 0.0), "excess error"
        if power.sum() <= 0.0:  # ordered by the variable, though repeats differ by more
            power, error = np.where(good, r**2, 0.0), "error"
        total = float(power.sum())
        best = (0.0, "", 0.0, 1.0, 1.0)
        for q in np.linspace(0.05, 0.95, 19):
            level = float(np.quantile(x[good], q))
            for side, inside in (("below", x <= level), ("above", x >= level)):
                part, size = float(power[inside & good].sum()) / total, float(np.mean(inside & good))
                if part - size > best[0]:
                    best = (part - size, side, level, part, size)
        regime["variable"] = variable
        inside = np.ones(r.size, dtype=bool)
        if best[1]:
            regime["below" if best[1] == "below" else "above"] = best[2]
            excess_share, sample_share = min(best[3], 1.0), best[4]
            inside = (x <= best[2]) if best[1] == "below" else (x >= best[2])
        bins = np.array_split(np.argsort(x[inside & good]), 5)
        means = [float(np.mean(r[inside & good][b])) for b in bins if b.size]
        peak = max(means, key=abs) if means else peak
        where = f", {_where(variable, best[1], best[2])}" if best[1] else f", along {label}"
        head += (
            f"{where}, up to {peak:+.2g} {unit}; {100 * excess_share:.0f} % of the {error} lies in {100 * sample_share:.0f} % of the "
            f"samples; {label} explains {100 * share:.0f} % of the residual's variance"
        )
    return Located(
        short(name), maneuver, kind, regime, excess_share, sample_share, head, rmse, floor, unit, peak, share, p_value,
        repeated,
    )  # fmt: skip


def _where(variable: str, side: str, level: float) -> str:
    """A part of a regime in words: angles in degrees, headings by the compass."""
    label, unit = VARIABLES[variable]
    if variable == "heading_rad":
        return f"on headings {'right' if side == 'below' else 'left'} of {compass_from_yaw(level):.0f} deg"
    if unit == "rad":
        level, unit = math.degrees(level), "deg"
    return f"{side} {label} {level:.3g} {unit}".rstrip()


def regime_curves(
    located: Sequence[Located], before: Linearisation, after: Linearisation, segments: Sequence[Segment], bins: int = 12
) -> list[RegimeCurve]:
    """Mean residual of both models in bins of the variable that explains each located mismatch."""
    variables = sampled(before, segments)
    names = {short(n): c for c, n in enumerate(before.channels)}
    found: list[RegimeCurve] = []
    for place in located:
        variable = place.regime.get("variable")
        if variable is None or variable not in variables:
            continue
        kinds = np.array([s.kind == place.kind for s in segments])
        at = np.flatnonzero(
            (before.channel == names[place.channel]) & kinds[before.segment] & np.isfinite(variables[variable])
        )
        if at.size < 5 * bins:
            continue
        x = variables[variable][at]
        edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))
        which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2)

        def mean(values: FloatArray, which: NDArray[np.intp] = which, n: int = edges.size - 1) -> list[float]:
            count = np.maximum(np.bincount(which, minlength=n), 1)
            return [float(v) for v in np.bincount(which, values, minlength=n) / count]

        label, unit = VARIABLES[variable]
        found.append(
            {
                "channel": place.channel, "maneuver": place.maneuver, "kind": place.kind, "variable": variable, "label": label,
                "variable_unit": unit,
                "unit": place.unit, "x": mean(x), "before": mean(before.unprofiled_residual[at]),
                "after": mean(after.unprofiled_residual[at]), "floor": place.floor,
            }
        )  # fmt: skip
    return found


def overlays(before: Linearisation, after: Linearisation, segments: Sequence[Segment]) -> list[Overlay]:
    """Per channel, the responses of the base model with the largest mean square: time since the step, measured, and both predictions."""
    found: list[Overlay] = []
    for c, name in enumerate(before.channels):
        at = before.channel == c
        count = np.bincount(before.segment[at], minlength=len(segments))
        power = np.bincount(
            before.segment[at], before.unprofiled_residual[at] ** 2, minlength=len(segments)
        ) / np.maximum(count, 1)
        for i in np.argsort(-power)[:WORST]:
            rows = np.flatnonzero(at & (before.segment == i))
            if rows.size < 3:
                continue
            rows = rows[np.argsort(before.sample[rows])]
            segment = segments[int(i)]
            sample = before.sample[rows]
            measured = np.asarray(segment.y[name])[sample]
            found.append(
                {
                    "channel": short(name), "unit": CHANNELS[name].unit, "segment": segment.name, "kind": segment.kind,
                    "t_s": (segment.t_s[sample] - segment.t_step_s).tolist(), "measured": measured.tolist(),
                    "before": (measured - before.unprofiled_residual[rows]).tolist(),
                    "after": (measured - after.unprofiled_residual[rows]).tolist(),
                }
            )  # fmt: skip
    return found
