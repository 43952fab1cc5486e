"""The script that a diagnosis proposes, held against the zone of the vehicle that would fly it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flighttest.diagnose import Diagnosis
from flighttest.documents import write_text
from flighttest.errors import FlighttestError
from flighttest.pipeline.checking import HOVERS, predictor_for
from flighttest.pipeline.predictor import ModelPredictor
from flighttest.plan import compile_plan
from flighttest.recording import Recording
from flighttest.script.load import parse_script
from flighttest.vehicle.model import Vehicle, Zone


def held_against_zone(found: Diagnosis, recordings: Sequence[Recording], vehicle: Vehicle | None) -> Diagnosis:
    """The diagnosis, whose proposal says in `next_reason` and in the script's doc whether it fits the zone of this vehicle, or else of the
    one that was flown last. As it was where neither is known: a script is planned for the zone it is flown in anyway."""
    where = vehicle if vehicle is not None and vehicle.flies else flown_vehicle(recordings)
    if where is None or not found.next_script:
        return found
    told: dict[str, Any]
    try:
        script = parse_script(write_text(found.next_script), "next.yaml")
        plan = compile_plan(script, where, _prior(found, where))
    except FlighttestError as error:
        told = {"fits_zone": None, "zone": f"Whether it fits the zone of {where.name} is not known: {error.message}."}
        return replace(found, next_reason={**found.next_reason, **told})
    asked = len(plan.legs) + len({leg for leg, _, _ in plan.refusals})
    if not plan.refusals:
        told = {"fits_zone": True, "zone": f"All its {asked} steps fit the zone of {where.name}."}
        return replace(found, next_reason={**found.next_reason, **told})
    leg, what, remedy = plan.refusals[0]
    short = f"{asked - len(plan.legs)} of its {asked} steps do not fit the zone of {where.name}"
    told = {
        "fits_zone": False,
        "zone": f"As it is it cannot be flown: {short}. {leg}: {what}; {remedy}. `flighttest check` names them all.",
    }
    doc = f"{found.next_script.get('doc', '')}; {short}".removeprefix("; ")
    return replace(found, next_script={**found.next_script, "doc": doc}, next_reason={**found.next_reason, **told})


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


def _vehicle(kept: Mapping[str, Any], zone: Mapping[str, Any]) -> Vehicle:
    def span(name: str) -> tuple[float, float]:
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


def _prior(found: Diagnosis, vehicle: Vehicle) -> ModelPredictor:
    """The diagnosis' own model, where it knows what this vehicle hovers at; else the usual one."""
    made = ModelPredictor(replace(found.model, attitude_loops=True), found.values)
    hover = float(made.hover_throttle(np.array([vehicle.nominal_voltage_v]))[0])
    return made if HOVERS[0] < hover < HOVERS[1] else predictor_for(None, vehicle)
