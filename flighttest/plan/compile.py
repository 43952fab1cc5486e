"""Script to `Plan`: cells, durations, starts, stops, headings, order. Pure: the same script and vehicle give the same plan."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flighttest.plan.batched import Request, fly_rows
from flighttest.plan.clearance import Clearance, Placement, box, place, worst
from flighttest.plan.fit_zone import FittedCell, Setting, fit_cells, row_of, useful_s
from flighttest.plan.free_flight import fly_waypoints
from flighttest.plan.model import CellPlan, Leg, Phase, Plan, Predictor
from flighttest.plan.rehearse import Rehearsal, reaction_s
from flighttest.plan.remedy import remedy
from flighttest.script.model import Script
from flighttest.script.profiles import PROFILES, Piece, StepCell, Timeline
from flighttest.vehicle.model import Vehicle, Zone

# The paper flew from 24.5 V down to 21.5 V on a battery of 22.2 V nominal: what a script that states no voltages may meet.
FULL_SHARE, EMPTY_SHARE = 24.5 / 22.2, 21.5 / 22.2
# A battery is never quite as in the script.
VOLTAGE_DOUBT = 0.012
# Of the nominal voltage: what the paper's 21 V on 22.2 V is, for scripts that name no lowest voltage.
LOWEST_SHARE = 0.945
STOP_STEP_S = 0.04


@dataclass(frozen=True)
class _Slot:
    """One leg before it is built: which cell, which repeat, the battery expected then."""

    cell: int
    repeat: int
    voltage_v: float


def compile_plan(script: Script, vehicle: Vehicle, predictor: Predictor, *, angle_boost: bool = False) -> Plan:
    """Compile a script for a vehicle. What cannot be flown is in `refusals` and not among the legs.

    predictor: a prior model of this vehicle (see `Predictor`). angle_boost: the autopilot divides throttle by the cosine of the
    tilt by itself; `Leg.flown_with` sets it later as well.
    """
    zone = vehicle.zone
    if script.limits.floor_m is not None:
        zone = replace(zone, z_m=(min(script.limits.floor_m, zone.z_m[0]), zone.z_m[1]))
    vehicle = replace(vehicle, zone=zone)
    limits = script.limits
    if not limits.voltage_min_v:
        limits = replace(limits, voltage_min_v=LOWEST_SHARE * vehicle.nominal_voltage_v)
    unit = vehicle.hover_throttle if script.throttle_unit == "hover" else 1.0
    cells = [cell for maneuver in script.steps for cell in PROFILES[maneuver.profile].cells(maneuver.settings, unit)]
    cells = _distinct(cells)
    span = script.repeat.over_voltage_v or (
        vehicle.nominal_voltage_v * FULL_SHARE,
        vehicle.nominal_voltage_v * EMPTY_SHARE,
    )
    setting = Setting(
        predictor=predictor,
        clearance=Clearance.of(zone, script.limits),
        voltages_v=(span[0] * (1.0 + VOLTAGE_DOUBT), span[1] * (1.0 - VOLTAGE_DOUBT)),
        hover_throttle=vehicle.hover_throttle,
        throttle=script.limits.throttle,
        speed_max_m_s=script.limits.speed_max_m_s,
    )
    fitted = fit_cells(cells, setting)
    paths = [i for i, f in enumerate(fitted) if f.cell.waypoints]
    for i, f in zip(paths, fly_waypoints([fitted[i] for i in paths], setting), strict=True):
        fitted[i] = f
    slots = _order(len(cells), script, span)
    places = [_places(f, i, script, setting) for i, f in enumerate(fitted)]
    refusals = _refusals(script, fitted, places, setting)
    refused = {label for label, _, _ in refusals}
    slots = [slot for slot in slots if _leg_id(script, cells[slot.cell], slot.repeat) not in refused]
    legs, stops = _legs(script, fitted, places, slots, setting, zone.heading_rad, angle_boost)
    fenced = sum(any(p.fence and p.excess is None for p in placed) for placed in places)
    return Plan(
        script=script,
        vehicle=vehicle,
        legs=legs,
        limits=limits,
        reset=replace(script.reset, to_m=_inside(script.reset.to_m, setting.clearance)),
        rate_hz=script.rate_hz,
        refusals=refusals,
        notes=(*_notes(fitted, fenced, script, setting), *_home(zone)),
        cells=tuple(
            _cell_plan(f, places[i][0], setting, stops.get(i, ()), sum(slot.cell == i for slot in slots))
            for i, f in enumerate(fitted)
        ),
        reaction_s=reaction_s(predictor),
        fenced=fenced,
    )


def _distinct(cells: list[StepCell]) -> list[StepCell]:
    """Cells with labels of their own: the same step asked for twice is flown twice, under two names."""
    seen: dict[str, int] = {}
    found = []
    for cell in cells:
        seen[cell.label] = seen.get(cell.label, 0) + 1
        found.append(cell if seen[cell.label] == 1 else replace(cell, label=f"{cell.label} #{seen[cell.label]}"))
    return found


def _order(count: int, script: Script, span: tuple[float, float]) -> list[_Slot]:
    """Which cell when. Interleaved: each repeat flies every cell once, shuffled by the script's own hash, so that the battery's
    discharge is not collinear with the size of the step."""
    repeats = range(1, script.repeat.each + 1)
    pairs: list[tuple[int, int]] = []
    if script.repeat.order == "sequential":
        pairs = [(cell, repeat) for cell in range(count) for repeat in repeats]
    else:
        shuffle = random.Random(script.sha256)
        for repeat in repeats:
            row = list(range(count))
            shuffle.shuffle(row)
            pairs += [(cell, repeat) for cell in row]
    last = max(len(pairs) - 1, 1)
    return [_Slot(cell, repeat, span[0] + (span[1] - span[0]) * k / last) for k, (cell, repeat) in enumerate(pairs)]


def _places(f: FittedCell, index: int, script: Script, setting: Setting) -> list[Placement]:
    """A placement for each repeat. Headings rotate over repeats; cells start the rotation at different ones, so that heading and
    voltage are not collinear either. A heading under which the step does not fit gives way to the next that does."""
    headings = script.reset.heading_rad
    if f.cell.motors_off:
        return [Placement(script.reset.to_m, headings[0], None)] * script.repeat.each
    wish = script.reset.to_m
    height = None
    if f.cell.height_m is not None:
        # The height asked for is that at the step, not at the start: take off what T_0 loses until then.
        drops = []
        for track in f.nominal:
            k = int(np.searchsorted(track.t_s, _step_s(f.lead) + 1e-9)) - 1
            drops.append(float(track.p_m[max(k, 0), 2]))
        height = f.cell.height_m - sum(drops) / max(len(drops), 1)
    found = []
    cache: dict[int, Placement] = {}
    for repeat in range(script.repeat.each):
        first = (repeat + index) % len(headings)
        if first not in cache:
            order = [headings[(first + k) % len(headings)] for k in range(len(headings))]
            if f.cell.waypoints:
                # A path has its place; it is not moved.
                excess = worst(f.nominal, f.lost, setting.clearance, np.zeros(3), fence=True)
                alone = worst(f.nominal, f.lost, setting.clearance, np.zeros(3), fence=False)
                cache[first] = Placement(f.cell.waypoints[0][1:], order[0], excess, fence=alone is not None)
            else:
                cache[first] = place(f.nominal, f.lost, setting.clearance, wish, order, height)
        found.append(cache[first])
    return found


def _refusals(
    script: Script, fitted: Sequence[FittedCell], places: Sequence[Sequence[Placement]], setting: Setting
) -> tuple[tuple[str, str, str], ...]:
    found: list[tuple[str, str, str]] = []
    for f, placed in zip(fitted, places, strict=True):
        hint: str | None = None
        for repeat, placement in enumerate(placed, start=1):
            name = _leg_id(script, f.cell, repeat)
            if f.complaint:
                found.append((name, f.complaint, f.remedy))
            if placement.excess is not None:
                if hint is None:
                    hint = remedy(f, setting, script.reset.to_m, list(script.reset.heading_rad), placement)
                found.append((name, f"it leaves the zone by {placement.excess.words}", hint))
    return tuple(found)


def _legs(
    script: Script,
    fitted: Sequence[FittedCell],
    places: Sequence[Sequence[Placement]],
    slots: Sequence[_Slot],
    setting: Setting,
    zone_heading: float,
    angle_boost: bool,
) -> tuple[tuple[Leg, ...], dict[int, tuple[tuple[str, float, float], ...]]]:
    flying = [slot for slot in slots if not fitted[slot.cell].cell.motors_off and not fitted[slot.cell].cell.waypoints]
    rows = [row_of(fitted[slot.cell].cell, fitted[slot.cell].lead, setting, slot.voltage_v) for slot in flying]
    flown = fly_rows(Request(rows, STOP_STEP_S), setting.predictor) if rows else None
    hover = setting.predictor.hover_throttle(np.array([slot.voltage_v for slot in slots])) if slots else np.zeros(0)
    at = {id(slot): j for j, slot in enumerate(flying)}
    stops: dict[int, tuple[tuple[str, float, float], ...]] = {}
    legs = []
    for k, slot in enumerate(slots):
        f, placement = fitted[slot.cell], places[slot.cell][slot.repeat - 1]
        pieces = f.lead
        if id(slot) in at and flown is not None:
            row_stops = _stop_pieces(f.cell, flown, at[id(slot)])
            stops.setdefault(slot.cell, tuple((p.name, p.duration_s, _strength(p)) for p in row_stops))
            pieces = (*f.lead, *row_stops, *f.cell.tail)
        timeline = Timeline(pieces, float(hover[k]), angle_boost)
        phases = _phases(pieces)
        legs.append(
            Leg(
                id=_leg_id(script, f.cell, slot.repeat),
                maneuver=script.name,
                kind=f.cell.kind,
                cell=f.cell.values,
                repeat=slot.repeat,
                start_m=placement.start_m,
                heading_rad=_wrap(zone_heading + placement.heading_rad),
                duration_s=timeline.duration_s,
                t_step_s=_step_s(pieces),
                phases=phases,
                profile=None if f.cell.waypoints or f.cell.motors_off else timeline,
                waypoints=f.cell.waypoints,
                voltage_v=slot.voltage_v if script.repeat.over_voltage_v else None,
                motors_off=f.cell.motors_off,
            )
        )
    # What is recorded on the ground comes before take-off.
    return tuple(sorted(legs, key=lambda leg: not leg.motors_off)), stops


def _stop_pieces(cell: StepCell, flown: Rehearsal, j: int) -> tuple[Piece, ...]:
    pieces = []
    if cell.counter is not None and flown.counter_s[j] > 0.0:
        pieces.append(replace(cell.counter, duration_s=round(float(flown.counter_s[j]), 3)))
    if flown.vertical_s[j] > 0.0:
        pieces.append(Piece("stop", round(float(flown.vertical_s[j]), 3), throttle=float(flown.vertical_throttle[j])))
    return tuple(pieces)


def _strength(piece: Piece) -> float:
    """What a stop does: its throttle, or the tilt of a counter-step, rad."""
    if isinstance(piece.throttle, float):
        return piece.throttle
    tilts = [wave for wave in (piece.roll_rad, piece.pitch_rad) if isinstance(wave, float) and wave != 0.0]
    return tilts[0] if tilts else 0.0


def _phases(pieces: Sequence[Piece]) -> tuple[Phase, ...]:
    phases, start = [], 0.0
    for piece in pieces:
        phases.append(Phase(piece.name, start, start + piece.duration_s, piece.record))
        start += piece.duration_s
    return tuple(phases)


def _step_s(pieces: Sequence[Piece]) -> float:
    t = 0.0
    for piece in pieces:
        if piece.record:
            return t
        t += piece.duration_s
    return 0.0


def _leg_id(script: Script, cell: StepCell, repeat: int) -> str:
    return f"{script.name}/{cell.label}/r{repeat}"


def _wrap(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def _cell_plan(
    f: FittedCell, placement: Placement, setting: Setting, stops: tuple[tuple[str, float, float], ...], legs: int
) -> CellPlan:
    # A path lies in the zone, all others about their start.
    about = np.asarray(placement.start_m if f.cell.waypoints else (0.0, 0.0, 0.0))

    def corner(values: object) -> tuple[float, float, float]:
        x, y, z = np.asarray(values, dtype=float) - about
        return float(x), float(y), float(z)

    low, high = box(f.nominal) if f.nominal else (about, about)
    lost_low, lost_high = box(f.lost) if f.lost else (low, high)
    return CellPlan(
        label=f.cell.label,
        kind=f.cell.kind,
        legs=legs,
        held_s=tuple((piece.name, piece.duration_s) for piece in f.lead),
        recorded_from=next((k for k, piece in enumerate(f.lead) if piece.record), len(f.lead)),
        stops=stops,
        useful_s=useful_s(f, setting),
        start_m=placement.start_m,
        low_m=corner(low),
        high_m=corner(high),
        lost_low_m=corner(lost_low),
        lost_high_m=corner(lost_high),
        speed_m_s=f.speed_m_s,
        shortened=f.shortened,
    )


def _notes(fitted: Sequence[FittedCell], fenced: int, script: Script, setting: Setting) -> tuple[str, ...]:
    notes = []
    shortened = [f.cell.label for f in fitted if f.shortened]
    if shortened:
        notes.append(
            f"{len(shortened)} of {len(fitted)} steps are shorter than asked for, to stay inside zone, heights and speed"
        )
    if fenced:
        notes.append(
            f"{fenced} of {len(fitted)} steps drift past the zone's margin when the link is lost: the autopilot's fence has to stop them"
        )
    asked_m, to_m = script.reset.to_m, _inside(script.reset.to_m, setting.clearance)
    if to_m != asked_m:
        where = "outside the zone's margin or the script's heights"
        climbs = f"the vehicle takes off to {to_m[2]:g} m, and each step starts as near to it as it fits"
        notes.append(f"reset.to ({asked_m[2]:g} m high) lies {where}: {climbs}")
    return tuple(notes)


def _inside(place_m: tuple[float, float, float], clearance: Clearance) -> tuple[float, float, float]:
    """The place nearest to one, zone frame, inside the zone's margin and the script's heights: the take-off must not leave them, either."""
    x, y, z = np.clip(place_m, clearance.inner_low, clearance.inner_high)
    return float(x), float(y), float(z)


def _home(zone: Zone) -> tuple[str, ...]:
    outside_m = zone.outside_m((0.0, 0.0, 0.0)) if zone.origin is None else 0.0
    words = f"home, where it takes off, is {outside_m:.0f} m outside of the flight zone: `run` refuses that unless `zone` is waived"
    return (words,) if outside_m > 0.0 else ()
