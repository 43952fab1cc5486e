"""`CheckResult`: everything `flighttest check` reports of a plan, as pure data."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from flighttest.plan.model import CellPlan, Leg, Plan
from flighttest.vehicle.model import Vehicle

# Between steps: mode change, the autopilot's transit, mode change and entry. Transit speed is the autopilot's own, taken low.
MODE_CHANGE_S = 1.5
TRANSIT_M_S = 2.0
TAKE_OFF_S, LANDING_S = 12.0, 12.0
# Hover power of multirotors of 1 to 10 kg lies between 120 and 220 W/kg; what is flown here costs little more.
HOVER_POWER_W_KG = 170.0
HOVER_POWER_DOUBT = 0.3
# A lithium battery is landed with a fifth left.
USABLE_SHARE = 0.8


@dataclass(frozen=True)
class TimelineRow:
    """One leg: when it starts (s from take-off, resets included), its phases as (name, s), where, heading and battery."""

    start_s: float
    leg: str
    kind: str
    duration_s: float
    phases: tuple[tuple[str, float], ...]
    start_m: tuple[float, float, float]
    heading_rad: float
    voltage_v: float | None
    direction: str = ""


@dataclass(frozen=True)
class EnvelopeRow:
    """One distinct step: where it takes the vehicle at most, m in the zone's height and about the start, with the link lost too.

    far_m: largest distance from the start over ground; height_m, lost_height_m: (lowest, highest).
    """

    cell: CellPlan
    height_m: tuple[float, float]
    lost_height_m: tuple[float, float]
    far_m: float
    lost_far_m: float
    speed_m_s: float
    useful_s: float


@dataclass(frozen=True)
class BatteryNeed:
    """What the flight needs. energy_wh None where the mass is not declared; capacity_wh None where no capacity is."""

    air_s: float
    energy_wh: float | None
    doubt: float
    capacity_wh: float | None
    packs: int | None
    sentence: str


@dataclass(frozen=True)
class CheckResult:
    """What a plan asks of vehicle, zone and battery. refusals: (leg id, sentence, remedy); ok when there are none.

    flying_s: legs alone; duration_s: with resets, take-off and landing. expected_std: standard error of each parameter the
    script should identify, where somebody with a prior's Fisher information has filled it in.
    """

    name: str
    doc: str
    vehicle: str
    legs: int
    timeline: tuple[TimelineRow, ...]
    envelope: tuple[EnvelopeRow, ...]
    refusals: tuple[tuple[str, str, str], ...]
    notes: tuple[str, ...]
    flying_s: float
    duration_s: float
    battery: BatteryNeed
    expected_std: Mapping[str, float] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether every leg may be flown."""
        return not self.refusals


def check(plan: Plan) -> CheckResult:
    """Timeline, duration, battery and predicted envelope of a compiled plan."""
    timeline: list[TimelineRow] = []
    now = TAKE_OFF_S if any(not leg.motors_off for leg in plan.legs) else 0.0
    where = plan.reset.to_m
    for leg in plan.legs:
        if not leg.motors_off:
            now += reset_s(plan, leg, where)
            where = leg.start_m
        timeline.append(_row(leg, now))
        now += leg.duration_s
    on_ground = sum(leg.duration_s for leg in plan.legs if leg.motors_off)
    total = now + (LANDING_S if any(not leg.motors_off for leg in plan.legs) else 0.0)
    return CheckResult(
        name=plan.script.name,
        doc=plan.script.doc,
        vehicle=plan.vehicle.name,
        legs=len(plan.legs),
        timeline=tuple(timeline),
        envelope=tuple(_envelope(cell) for cell in plan.cells),
        refusals=plan.refusals,
        notes=plan.notes,
        flying_s=plan.duration_s,
        duration_s=total,
        battery=battery_need(plan.vehicle, total - on_ground),
    )


def reset_s(plan: Plan, leg: Leg, where_m: tuple[float, float, float]) -> float:
    """How long it takes to bring the vehicle from a place to a leg's start and settle, s: an estimate."""
    return 2.0 * MODE_CHANGE_S + math.dist(where_m, leg.start_m) / TRANSIT_M_S + plan.reset.settle_s


def _row(leg: Leg, now: float) -> TimelineRow:
    rate = leg.cell.get("rate_rad_s", 0.0) if leg.kind == "yaw_rate_step" else 0.0
    return TimelineRow(
        start_s=now,
        leg=leg.id,
        kind=leg.kind,
        duration_s=leg.duration_s,
        phases=tuple((phase.name, phase.end_s - phase.start_s) for phase in leg.phases),
        start_m=leg.start_m,
        heading_rad=leg.heading_rad,
        voltage_v=leg.voltage_v,
        direction="left" if rate > 0 else "right" if rate < 0 else "",
    )


def _envelope(cell: CellPlan) -> EnvelopeRow:
    def far(low: tuple[float, float, float], high: tuple[float, float, float]) -> float:
        return max(math.hypot(max(-low[0], high[0]), max(-low[1], high[1])), 0.0)

    base = cell.start_m[2]
    return EnvelopeRow(
        cell=cell,
        height_m=(base + cell.low_m[2], base + cell.high_m[2]),
        lost_height_m=(base + cell.lost_low_m[2], base + cell.lost_high_m[2]),
        far_m=far(cell.low_m, cell.high_m),
        lost_far_m=far(cell.lost_low_m, cell.lost_high_m),
        speed_m_s=cell.speed_m_s,
        useful_s=cell.useful_s,
    )


def battery_need(vehicle: Vehicle, air_s: float) -> BatteryNeed:
    """Energy for this time in the air, and how many of the declared packs that is."""
    energy = None if vehicle.mass_kg is None else HOVER_POWER_W_KG * vehicle.mass_kg * air_s / 3600.0
    capacity = _capacity_ah(vehicle.components.get("battery", {}))
    capacity_wh = None if capacity is None else capacity * vehicle.nominal_voltage_v
    packs = None if energy is None or capacity_wh is None else max(1, math.ceil(energy / (USABLE_SHARE * capacity_wh)))
    minutes = f"{air_s / 60.0:.0f} min in the air"
    if energy is None:
        sentence = f"{minutes}; declare mass_kg for an estimate of the energy"
    elif packs is None:
        sentence = f"{minutes}, about {energy:.0f} Wh; declare the battery's capacity (model: 6S 10 Ah) for the number of packs"
    else:
        sentence = f"{minutes}, about {energy:.0f} Wh: {packs} pack{'s' if packs > 1 else ''} of {capacity_wh:.0f} Wh"
    return BatteryNeed(air_s, energy, HOVER_POWER_DOUBT, capacity_wh, packs, sentence)


def _capacity_ah(fields: Mapping[str, Any]) -> float | None:
    """Capacity a battery's declaration states: a field of its own, or words such as `6S 10 Ah` and `5200 mAh`."""
    for key, value in fields.items():
        if "capacity" in key and isinstance(value, (int, float)) and value > 0:
            return float(value) / 1000.0 if "mah" in key or value > 200 else float(value)
    found = re.search(r"(\d+(?:\.\d+)?)\s*(m?)ah\b", " ".join(str(v) for v in fields.values()), re.IGNORECASE)
    return None if found is None else float(found[1]) * (0.001 if found[2] else 1.0)
