"""What to fly after a change: the scripts, how long they take on this vehicle, and the command that flies them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import yaml

from flighttest.documents import write_text
from flighttest.identify.models.model_file import ModelFile
from flighttest.pipeline.planning.checking import predictor_for
from flighttest.plan import check as check_plan
from flighttest.plan import compile_plan
from flighttest.report.sections.validity import Reflight
from flighttest.script.load import load_script
from flighttest.script.shipped import resolve
from flighttest.validity.model import Assessment
from flighttest.validity.reflight import Need, needs
from flighttest.vehicle.model import DEFAULT_VEHICLE, Vehicle

SPOT_CHECK = "spot_check"
ABSOLUTE, RELATIVE = "thrust", "thrust_hover"  # the same steps, in throttle and in multiples of hover
NEAR = 0.25  # relative distance from the default vehicle's hover throttle within which absolute throttles serve


def minutes_of(names: Sequence[str], stored: ModelFile, vehicle: Vehicle | None) -> dict[str, float]:
    """Minutes from take-off to landing of each script, as the model and the vehicle's zone have it."""
    where = vehicle or DEFAULT_VEHICLE
    predictor = predictor_for(Path(stored.path), where) if stored.path else predictor_for(None, where)
    found = {}
    for name in names:
        script = load_script(resolve(name))
        plan = compile_plan(script, where, predictor)
        if plan.refusals:
            # A stale or half-known model may find no space for a step: the time it takes is that of the usual vehicle.
            plan = compile_plan(script, where, predictor_for(None, where))
        found[name] = check_plan(plan).duration_s / 60.0
    return found


def thrust_script(stored: ModelFile, vehicle: Vehicle | None) -> str:
    """The script that the model's own flights had; by the hover throttle where they have none."""
    if any(str(run).rstrip("/").endswith(RELATIVE) for run in stored.runs):
        return RELATIVE
    usual = DEFAULT_VEHICLE.hover_throttle
    if vehicle is not None and abs(vehicle.hover_throttle - usual) > NEAR * usual:
        return RELATIVE
    return ABSOLUTE


def reflights(
    found: Assessment, stored: ModelFile, vehicle: Vehicle | None, output: Path | None = None, options: str = ""
) -> tuple[tuple[Reflight, ...], dict[str, float], dict[str, Need]]:
    """What to fly, minutes per script, and how often each step where it is stale. output: folder for the scripts with those repeats;
    options: end of each command, by which it flies this vehicle."""
    thrust = thrust_script(stored, vehicle)

    def own(names: Sequence[str]) -> list[str]:
        return [thrust if n == ABSOLUTE else n for n in names]

    minutes = minutes_of((*own(found.fly), SPOT_CHECK), stored, vehicle)
    known = {n: (p.value, p.scatter) for n, p in stored.parameters.items() if p.scatter is not None}
    flown = {name: load_script(resolve(name)).repeat.each for name in found.fly}
    wanted = found.fly_narrow or found.fly
    repeats = {n.script: n for n in needs(wanted, known, flown)} if found.fly else {}

    def row(what: str, names: Sequence[str]) -> Reflight:
        return Reflight(
            what, tuple(names), sum(minutes[n] for n in names), f"flighttest run {' '.join(names)}{options}"
        )

    rows = []
    if found.fly:
        if set(wanted) != set(found.fly):
            rows.append(row("at least", own(wanted)))
        rows.append(row("all (the rule)", own(found.fly)))
        if output is not None:
            output.mkdir(parents=True, exist_ok=True)
            paths = []
            for name, need in repeats.items():
                paths.append(output / f"{name}_again.yaml")
                paths[-1].write_text(shortened(own([name])[0], need.repeats), encoding="utf-8")
            times = sum(minutes[own([n])[0]] * need.repeats / need.usual for n, need in repeats.items())
            each = ", ".join(f"{n}: {need.repeats} repeats, usually {need.usual}" for n, need in repeats.items())
            fewer = all(need.repeats <= need.usual for need in repeats.values())
            what = f"{'the shortest that serves' if fewer else 'for errors to plan with'} ({each})"
            rows.append(Reflight(what, tuple(repeats), times, f"flighttest run {' '.join(map(str, paths))}{options}"))
    if not any(test.alarm for test in found.tests):
        rows.append(row("first, to see" if found.fly else "to be sure", [SPOT_CHECK]))
    return tuple(rows), minutes, repeats


def shortened(script: str, repeats: int) -> str:
    """A shipped script with another number of repeats, as text."""
    data = yaml.safe_load(resolve(script).read_text(encoding="utf-8"))
    data["name"] = f"{data['name']}_again"
    data["repeat"] = {**data.get("repeat", {}), "each": repeats}
    return write_text(data)
