"""`flighttest check`: scripts compiled against a zone with a prior model, without a vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flighttest.errors import InputError
from flighttest.identify.expected_information import (
    Expected,
    PlannedInformation,
    expected_of_information,
    planned_information,
)
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.parallel import in_parallel
from flighttest.pipeline.planning.predictor import ModelPredictor
from flighttest.pipeline.results import Result, Status
from flighttest.pipeline.store.history import DEFAULT_RUNS, check_runs
from flighttest.pipeline.store.lineage import lineage_of
from flighttest.plan import Plan, compile_plan
from flighttest.plan import check as check_plan
from flighttest.report.document import Cell, Section, Table
from flighttest.report.numbers import number, percent, unit
from flighttest.report.render.plain import plain
from flighttest.report.sections.check import check_document
from flighttest.script.load import load_script
from flighttest.script.model import Script
from flighttest.script.profiles import PROFILES
from flighttest.script.shipped import resolve
from flighttest.vehicle.load import load_vehicle
from flighttest.vehicle.model import DEFAULT_VEHICLE, Vehicle

HOVERS = (0.03, 0.97)  # of full throttle: a model that hovers outside is not of this vehicle


def predictor_for(model: Path | ModelFile | None, vehicle: Vehicle) -> ModelPredictor:
    """The fitted model where one is given, else the paper's, its thrust gain set by the vehicle's hover throttle."""
    if model is not None:
        stored = model_file.read(model) if isinstance(model, Path) else model
        # A model of free flights alone has no attitude loops, and a script is flown through them: the paper's are used.
        return ModelPredictor(replace(stored.model, attitude_loops=True), stored.values)
    base = ModelPredictor().model
    gain = base.g_m_s2 / vehicle.hover_throttle
    return ModelPredictor(replace(base, nominal_voltage_v=vehicle.nominal_voltage_v), {"K": gain})


def prior_model(
    model: Path | ModelFile | None, out: Path, vehicle: Vehicle
) -> tuple[ModelPredictor, Path | ModelFile | None]:
    """The model given, else the accepted one of this vehicle as far as it has its thrust, else the paper's as `predictor_for` has it; and
    where it is from, None for the paper's."""
    accepted = lineage_of(out, vehicle.name).current if model is None and vehicle.name else None
    if accepted is not None and hovers(found := predictor_for(accepted, vehicle), vehicle):
        return found, accepted
    return predictor_for(model, vehicle), model


def hovers(prior: ModelPredictor, vehicle: Vehicle) -> bool:
    """Whether a model hovers at a throttle that a vehicle has."""
    return bool(HOVERS[0] < float(prior.hover_throttle(np.array([vehicle.nominal_voltage_v]))[0]) < HOVERS[1])


def plans(
    scripts: Sequence[str], vehicle: Vehicle, predictor: ModelPredictor, *, angle_boost: bool = False
) -> tuple[Plan, ...]:
    """Load and compile; ScriptError lists everything wrong with a script."""
    loaded = [load_script(resolve(name)) for name in scripts]
    return tuple(compile_plan(script, vehicle, predictor, angle_boost=angle_boost) for script in loaded)


def check(
    scripts: Sequence[str],
    vehicle: Path | None,
    model: Path | ModelFile | None,
    *,
    out: Path = DEFAULT_RUNS,
    verbose: bool = False,
) -> Result:
    """Plan, duration, battery and predicted envelope of every script, against the zone. out: where the vehicle's accepted model may be."""
    check_runs(out)
    declared = load_vehicle(vehicle) if vehicle is not None else DEFAULT_VEHICLE
    prior, source = prior_model(model, out, declared)
    hover = float(prior.hover_throttle(np.array([declared.nominal_voltage_v]))[0])
    if not hovers(prior, declared):
        whose = "the vehicle as declared" if model is None else _source(model)
        raise InputError(
            f"{whose}: at this vehicle's {declared.nominal_voltage_v:g} V the model hovers at {100 * hover:.1f} % throttle: it is of "
            "another vehicle, or its thrust is not identified",
            "name the vehicle with --vehicle, or another model",
        )

    def rehearsed(some: Sequence[Script]) -> list[tuple[Plan, PlannedInformation]]:
        made = [compile_plan(script, declared, prior) for script in some]
        return list(zip(made, planned_information(made, prior.model, prior.values), strict=True))

    loaded = [load_script(resolve(name)) for name in scripts]
    compiled, planned = zip(*in_parallel(rehearsed, loaded, [_steps_asked(script) for script in loaded]), strict=True)
    forecast = [expected_of_information([one], prior.model, prior.values) for one in planned]
    altogether = expected_of_information(planned, prior.model, prior.values)
    results = tuple(
        replace(check_plan(plan), expected_std={e.name: e.std for e in expected if e.std is not None and _useful(e)})
        for plan, expected in zip(compiled, forecast, strict=True)
    )
    zone = declared.zone
    spans = ", ".join(
        f"{n} {low:g} to {high:g}" for n, (low, high) in (("x", zone.x_m), ("y", zone.y_m), ("z", zone.z_m))
    )
    facts = {
        "vehicle": declared.name + ("" if vehicle is not None else " (the built-in one: no --vehicle was given)"),
        "zone": f"{spans} m, margin {zone.margin_m:g} m",
        "prior": _source(source) if source is not None else "the paper's model, scaled to the hover throttle",
    }
    refused = any(not r.ok for r in results)
    data: dict[str, Any] = {"scripts": [plain(r) for r in results], "ok": not refused}
    data["expected"] = {r.name: [plain(e) for e in expected] for r, expected in zip(results, forecast, strict=True)}
    document = check_document(results, facts, verbose=verbose)
    together = _expected_section(altogether)
    if together is not None:
        document = replace(document, sections=(*document.sections, together))
    return Result(document, data, Status.BAD_INPUT if refused else Status.DONE, compiled)


def _source(model: Path | ModelFile) -> str:
    """Where a model is from, as facts and errors name it."""
    return str(model) if isinstance(model, Path) else model.path or "the model given"


def _steps_asked(script: Script) -> int:
    """How many steps a script asks for."""
    cells = (PROFILES[maneuver.profile].cells(maneuver.settings, 1.0) for maneuver in script.steps)
    return script.repeat.each * sum(len(some) for some in cells)


def _useful(expected: Expected) -> bool:
    """Whether a script determines anything worth printing about a parameter."""
    return expected.std is not None and expected.std < max(0.5 * abs(expected.value), 1e-9)


def _expected_section(altogether: Sequence[Expected]) -> Section | None:
    """What all scripts together would make known, what more repeats would buy, and which steps determine most."""
    if not altogether:
        return None
    rows: list[tuple[Cell | str, ...]] = []
    for e in altogether:
        if e.std is None or e.std_twice is None:
            rows.append((e.name, "-", unit(e.unit), "-", "-", Cell("not identifiable here", "quiet")))
            continue
        share = percent(e.std / abs(e.value)) if e.value else "-"
        best = "; ".join(cell for cell, _ in e.best[:2])
        rows.append((e.name, number(e.std, 2), unit(e.unit), share, number(e.std_twice, 2), best))
    head = ("parameter", "expected error", "unit", "of its value", "with twice the repeats", "most informative steps")
    table = Table(head, tuple(rows), ("left", "right", "left", "right", "right", "left"), detail=(4, 5))
    lead = (
        "Standard errors to expect from these scripts, with the prior model and the noise of a usual outdoor vehicle."
    )
    return Section("expected", "What it would make known", (table,), lead)
