"""The script that a diagnosis proposes, fitted to the zone of the vehicle that would fly it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from flighttest.diagnose import Diagnosis
from flighttest.diagnose.next_flight import Flyable, as_shipped
from flighttest.diagnose.records import NextReason
from flighttest.documents import PlainData, write_text
from flighttest.errors import FlighttestError
from flighttest.physics.model import Model
from flighttest.pipeline.planning.checking import hovers, predictor_for
from flighttest.pipeline.planning.predictor import ModelPredictor
from flighttest.plan import compile_plan
from flighttest.recording import Recording
from flighttest.recording.manifest import VehicleData, ZoneData
from flighttest.script.load import parse_script
from flighttest.script.model import ResetData, Script, ScriptData
from flighttest.vehicle.model import Vehicle, Zone

SIZES = (
    1.0,
    0.8,
    0.6,
    0.4,
)  # of a maneuver: tilts, times, and heights and throttles away from the lowest and from hover
ROOM_KEYS = ("amplitude_rad", "tilt_rad", "hold_s", "dash_s")
THROTTLES = ("throttle_0", "throttle_1", "throttle")
GROWTH = (1.25, 1.5, 2.0, 3.0, 4.0)  # of a zone in which nothing fits


def flyable_in(recordings: Sequence[Recording], vehicle: Vehicle | None) -> Flyable:
    """What a vehicle's zone has space for of a script: the largest of `SIZES` of which every step can be flown."""
    where = vehicle if vehicle is not None and vehicle.flies else flown_vehicle(recordings)
    if where is None:
        return as_shipped
    zone_of = where

    def fitted(script: ScriptData, model: Model, values: Mapping[str, float]) -> tuple[ScriptData, float] | None:
        prior = _prior(model, values, zone_of)
        for size in SIZES:
            made = sized(script, size, zone_of)
            if not compile_plan(parse_script(write_text(made), "next.yaml"), zone_of, prior).refusals:
                return made, size
        return None

    return fitted


def sized(script: ScriptData, size: float, vehicle: Vehicle) -> ScriptData:
    """A script's data at another size, its start inside the zone."""
    zone = vehicle.zone
    hover = 1.0 if script.get("throttle_unit") == "hover" else vehicle.hover_throttle

    def scaled(key: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {k: scaled(key, v) for k, v in value.items()}
        each = value if isinstance(value, list) else [value]
        if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in each):
            return value
        least = min(each) if key == "height_m" else hover if key in THROTTLES else 0.0
        moves = key in ROOM_KEYS or key == "height_m" or key in THROTTLES
        made = [round(least + size * (v - least), 4) for v in each] if moves else each
        return made if isinstance(value, list) else made[0]

    steps: list[dict[str, PlainData]] = [
        {p: {k: scaled(k, v) for k, v in s.items()} if isinstance(s, Mapping) else s for p, s in step.items()}
        for step in script["steps"]
    ]
    reset = script.get("reset", ResetData()).copy()
    if "to" in reset:
        spans = (zone.x_m, zone.y_m, zone.z_m)
        inside = [lo + zone.margin_m <= v <= hi - zone.margin_m for v, (lo, hi) in zip(reset["to"], spans, strict=True)]
        reset["to"] = [v if ok else sum(s) / 2.0 for v, ok, s in zip(reset["to"], inside, spans, strict=True)]
    made = script.copy()
    if size < 1.0 or reset != script.get("reset"):
        made["steps"] = steps
        if reset:
            made["reset"] = reset
    return made


def larger_zone(script: Script, vehicle: Vehicle, prior: ModelPredictor) -> str:
    """The smallest of some larger zones in which a script can be flown, in words; '' where none of them is enough."""
    for growth in GROWTH:
        low, high = vehicle.zone.z_m
        x_m, y_m = _grown(vehicle.zone.x_m, growth), _grown(vehicle.zone.y_m, growth)
        zone = replace(vehicle.zone, x_m=x_m, y_m=y_m, z_m=(low, low + growth * (high - low)))
        if not compile_plan(script, replace(vehicle, zone=zone), prior).refusals:
            words = [f"{n} {a:g} to {b:g}" for n, (a, b) in (("x", zone.x_m), ("y", zone.y_m), ("z", zone.z_m))]
            return f"A zone of {', '.join(words)} m would do."
    return ""


def _grown(span: tuple[float, float], growth: float) -> tuple[float, float]:
    """A span about its middle."""
    middle, half = sum(span) / 2.0, growth * (span[1] - span[0]) / 2.0
    return middle - half, middle + half


def held_against_zone(found: Diagnosis, recordings: Sequence[Recording], vehicle: Vehicle | None) -> Diagnosis:
    """The diagnosis, whose proposal has in `next_reason` and in the script's doc whether it fits the zone of this vehicle, or else of the
    one that was flown last. As it was where neither is known: a script is planned for the zone it is flown in anyway."""
    where = vehicle if vehicle is not None and vehicle.flies else flown_vehicle(recordings)
    if where is None or not found.next_script:
        return found
    words: NextReason
    zone = f"the zone of {where.name}" if where.name else "the vehicle's zone"
    try:
        script = parse_script(write_text(found.next_script), "next.yaml")
        prior = _prior(found.model, found.values, where)
        plan = compile_plan(script, where, prior)
    except FlighttestError as error:
        words = {"fits_zone": None, "zone": f"Whether it fits {zone} is not known: {error.message}."}
        return replace(found, next_reason={**found.next_reason, **words})
    asked = len(plan.legs) + len({leg for leg, _, _ in plan.refusals})
    if not plan.refusals:
        words = {"fits_zone": True, "zone": f"All its {asked} steps fit {zone}."}
        return replace(found, next_reason={**found.next_reason, **words})
    leg, what, remedy = plan.refusals[0]
    short = f"{asked - len(plan.legs)} of its {asked} steps do not fit {zone}"
    words = {
        "fits_zone": False,
        "zone": f"As it is it cannot be flown: {short}. {leg}: {what}; {remedy}. `flighttest check` names them all. "
        f"{larger_zone(script, where, prior)}".strip(),
    }
    doc = f"{found.next_script.get('doc', '')}; {short}".removeprefix("; ")
    return replace(found, next_script={**found.next_script, "doc": doc}, next_reason={**found.next_reason, **words})


def flown_vehicle(recordings: Sequence[Recording]) -> Vehicle | None:
    """The vehicle of the last recording that keeps its zone; None where none does."""
    for recording in reversed(recordings):
        kept = recording.provenance.vehicle
        zone = kept.get("zone")
        if isinstance(zone, Mapping):
            try:
                return _vehicle(kept, zone)
            except (KeyError, TypeError, ValueError):  # written by hand, or by another version
                continue
    return None


def _vehicle(kept: VehicleData, zone: ZoneData) -> Vehicle:
    def span(name: Literal["x_m", "y_m", "z_m"]) -> tuple[float, float]:
        low, high = (float(v) for v in zone[name])
        return low, high

    return Vehicle(
        name=str(kept["name"]),
        connect=None,
        firmware=str(kept.get("firmware", "")),
        nominal_voltage_v=float(kept["nominal_voltage_v"]),
        hover_throttle=float(kept["hover_throttle"]),
        zone=Zone(float(zone["heading_rad"]), span("x_m"), span("y_m"), span("z_m"), float(zone["margin_m"])),
    )


def _prior(model: Model, values: Mapping[str, float], vehicle: Vehicle) -> ModelPredictor:
    """The diagnosis' own model, where it has this vehicle's hover throttle; else the usual one."""
    made = ModelPredictor(replace(model, attitude_loops=True), values)
    return made if hovers(made, vehicle) else predictor_for(None, vehicle)
