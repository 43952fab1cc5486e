"""`flighttest check`: scripts compiled against a zone with a prior model, without a vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flighttest.identify import model_file
from flighttest.pipeline.predictor import ModelPredictor
from flighttest.pipeline.results import Result, Status
from flighttest.plan.compile import compile_plan
from flighttest.plan.model import CellPlan, Plan
from flighttest.report.document import Block, Bullets, Cell, Document, Facts, Paragraph, Section, Table
from flighttest.report.numbers import duration, join
from flighttest.script.load import load_script
from flighttest.script.shipped import resolve
from flighttest.vehicle.default import DEFAULT_VEHICLE
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import Vehicle

RESET_S = 6.0  # flying back, beside the settling the script asks for: typical of the built-in vehicle and of ArduCopter in GUIDED


def predictor_for(model: Path | None, vehicle: Vehicle) -> ModelPredictor:
    """The fitted model where one is given, else the paper's, its thrust gain set by the vehicle's hover throttle."""
    if model is not None:
        stored = model_file.read(model)
        return ModelPredictor(stored.model, stored.values)
    base = ModelPredictor()
    gain = base.model.g_m_s2 / vehicle.hover_throttle
    from dataclasses import replace

    return ModelPredictor(replace(base.model, nominal_voltage_v=vehicle.nominal_voltage_v), {"K": gain})


def plans(
    scripts: Sequence[str], vehicle: Vehicle, predictor: ModelPredictor, angle_boost: bool = False
) -> tuple[Plan, ...]:
    """Load and compile; ScriptError lists everything wrong with a script."""
    loaded = [load_script(resolve(name)) for name in scripts]
    return tuple(compile_plan(script, vehicle, predictor, angle_boost=angle_boost) for script in loaded)


def flight_time_s(plan: Plan) -> float:
    """All legs with what lies between them."""
    flown = [leg for leg in plan.legs if not leg.motors_off]
    return plan.duration_s + len(flown) * (plan.reset.settle_s + RESET_S)


def check(scripts: Sequence[str], vehicle: Path | None, model: Path | None, *, verbose: bool = False) -> Result:
    """Plan, duration and predicted envelope of every script, against the zone."""
    declared = load_vehicle(vehicle) if vehicle is not None else DEFAULT_VEHICLE
    compiled = plans(scripts, declared, predictor_for(model, declared))
    refused = sum(len(plan.refusals) for plan in compiled)
    total_s = sum(flight_time_s(plan) for plan in compiled)
    legs = sum(len(plan.legs) for plan in compiled)
    names = join([plan.script.name for plan in compiled])
    if refused:
        verdict = f"{refused} step{'s' if refused != 1 else ''} refused; {legs} can be flown as written in {names}."
    else:
        verdict = f"{names}: {legs} steps fit the zone, about {duration(total_s)} of flight."
    zone = declared.zone
    facts = {
        "vehicle": declared.name + ("" if vehicle is not None else " (the built-in one: no --vehicle was given)"),
        "zone": f"x {zone.x_m[0]:g} to {zone.x_m[1]:g} m, y {zone.y_m[0]:g} to {zone.y_m[1]:g} m, z {zone.z_m[0]:g} to {zone.z_m[1]:g} m, "
        f"margin {zone.margin_m:g} m",
        "prior model": str(model) if model is not None else "the paper's, scaled to the hover throttle",
    }
    sections = tuple(_section(plan, verbose) for plan in compiled)
    data = {"scripts": [plan_data(plan) for plan in compiled], "refused": refused, "flight_time_s": total_s}
    document = Document("check", verdict, "bad" if refused else "good", sections, facts)
    return Result(document, data, Status.BAD_INPUT if refused else Status.DONE, compiled)


def _section(plan: Plan, verbose: bool) -> Section:
    script = plan.script
    what = f" Identifies {join(list(script.identifies))}." if script.identifies else ""
    lead = f"{script.doc}; {len(plan.legs)} steps, about {duration(flight_time_s(plan))} of flight.{what}"
    blocks: list[Block] = []
    if plan.refusals:
        blocks.append(
            Bullets(
                tuple(
                    f"refused: {leg}: {what}" + (f"; {remedy}" if remedy else "") for leg, what, remedy in plan.refusals
                )
            )
        )
    blocks += [Paragraph(note, "warn") for note in plan.notes]
    rows = tuple(_row(cell) for cell in plan.cells)
    columns = (
        "step",
        "times",
        "hold s",
        "record s",
        "useful s",
        "start m",
        "heights m",
        "out to m",
        "link lost m",
        "then",
    )
    align = ("left", *("right" for _ in range(9)), "left")
    caption = (
        "useful: what is left of the record after the delay; out: furthest from the start along the ground; "
        "lost: when the link is lost at the worst moment."
    )
    blocks.append(Table(columns, rows, align, caption, roomy=(5, 10)))  # type: ignore[arg-type]
    if verbose:
        lines = tuple(
            (
                leg.id,
                f"{leg.duration_s:.2f}",
                ", ".join(f"{p.name} {p.start_s:.2f}-{p.end_s:.2f}" for p in leg.phases),
                "-" if leg.voltage_v is None else f"{leg.voltage_v:.1f}",
            )
            for leg in plan.legs
        )
        blocks.append(Table(("leg", "s", "phases, s", "V"), lines, ("left", "right", "left", "right")))
    reset = plan.reset
    blocks.append(
        Facts(
            (
                (
                    "between steps",
                    f"back to {reset.to_m[0]:g}, {reset.to_m[1]:g}, {reset.to_m[2]:g} m by {reset.by}, {reset.settle_s:g} s still",
                ),
            )
        )
    )
    return Section(script.name, script.name, tuple(blocks), lead)


def _row(cell: CellPlan) -> tuple[Cell | str, ...]:
    def reach(low: tuple[float, float, float], high: tuple[float, float, float]) -> float:
        return max(abs(low[0]), abs(high[0]), abs(low[1]), abs(high[1]))

    start = cell.start_m[2]
    lengths = [(name, length) for name, length in cell.held_s if name != "entry"]
    hold, record = (lengths[:-1], lengths[-1:]) if len(lengths) > 1 else ([], lengths)
    return (
        cell.label,
        str(cell.legs),
        "+".join(f"{length:.2f}" for _, length in hold) or "-",
        "".join(f"{length:.2f}" for _, length in record) or "-",
        Cell(f"{cell.useful_s:.2f}", "warn" if cell.shortened else "plain"),
        f"{start:.1f}",
        f"{start + cell.low_m[2]:.1f}-{start + cell.high_m[2]:.1f}",
        f"{reach(cell.low_m, cell.high_m):.1f}",
        f"{reach(cell.lost_low_m, cell.lost_high_m):.1f}",
        f"{start + cell.lost_high_m[2]:.1f}",
        ", ".join(f"{name} {length:.2f} s" for name, length, _ in cell.stops),
    )


def plan_data(plan: Plan) -> dict[str, Any]:
    """A plan as plain data (the command's JSON, and plan.json of a run)."""
    return {
        "script": plan.script.name,
        "sha256": plan.script.sha256,
        "identifies": list(plan.script.identifies),
        "rate_hz": plan.rate_hz,
        "duration_s": plan.duration_s,
        "flight_time_s": flight_time_s(plan),
        "refusals": [{"leg": leg, "what": what, "remedy": remedy} for leg, what, remedy in plan.refusals],
        "notes": list(plan.notes),
        "legs": [
            {
                "id": leg.id,
                "kind": leg.kind,
                "cell": dict(leg.cell),
                "repeat": leg.repeat,
                "start_m": list(leg.start_m),
                "heading_rad": leg.heading_rad,
                "duration_s": leg.duration_s,
                "t_step_s": leg.t_step_s,
                "voltage_v": leg.voltage_v,
                "phases": [
                    {"name": p.name, "start_s": p.start_s, "end_s": p.end_s, "record": p.record} for p in leg.phases
                ],
            }
            for leg in plan.legs
        ],
        "cells": [
            {
                "label": c.label,
                "kind": c.kind,
                "legs": c.legs,
                "held_s": dict(c.held_s),
                "useful_s": c.useful_s,
                "start_m": list(c.start_m),
                "low_m": list(c.low_m),
                "high_m": list(c.high_m),
                "lost_low_m": list(c.lost_low_m),
                "lost_high_m": list(c.lost_high_m),
                "speed_m_s": c.speed_m_s,
                "shortened": c.shortened,
            }
            for c in plan.cells
        ],
    }
