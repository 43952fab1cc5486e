"""`flighttest accept` and `flighttest models`: which model of a vehicle is in use, and which were before it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from flighttest.errors import FlighttestError, LinkError
from flighttest.identify.models import model_file
from flighttest.pipeline.results import Result
from flighttest.pipeline.store.flown_with import out_words, rerun_options
from flighttest.pipeline.store.history import check_runs, when
from flighttest.pipeline.store.identities import WRITE_NAME_FIRST
from flighttest.pipeline.store.lineage import (
    Generation,
    Lineage,
    in_use,
    lineages,
    modelled_vehicle,
    stale_since,
    take_into_use,
)
from flighttest.report.document import Cell, Document, Paragraph, Section, Table
from flighttest.report.numbers import join
from flighttest.sim.sitl.launcher import find_arducopter
from flighttest.vehicle.load import load_vehicle

SIMULATED = "(simulate"  # in the firmware's version: the built-in autopilot's
NEXT_NAME = "next.yaml"  # the flight that a diagnosis proposes, beside its model


def accept(path: Path, out: Path, vehicle: Path | None = None) -> Result:
    """The model of a run or diagnosis folder, or a model file, becomes its vehicle's model in use."""
    whole, made = take_into_use(path, out, vehicle)
    facts = {
        "vehicle": whole.vehicle,
        "model": str(whole.current),
        "flights": join(list(made.runs)) or "not stated",
        "terms": ", ".join(made.terms),
    }
    if made.joined:
        facts["joined"] = ", ".join(made.joined)
    if len(whole.generations) > 1:
        before = whole.generations[-2]
        facts["before it"] = f"model {before.number}: {'; '.join(before.ended)}"
    where = f", each with{words}" if (words := out_words(out)) else ""
    facts["now"] = f"status, run, check, validate and export use it for this vehicle{where}"
    command = twin_command(whole.current, [out / name for name in made.runs]) if whole.current is not None else ""
    if command:
        facts["its twin"] = command
    script = path / NEXT_NAME
    if script.is_file() and _fits_zone(path):
        flies = rerun_options([*(out / name for name in made.runs), path], out, vehicle)
        facts["fly next"] = f"{_first_to_fly(vehicle)}flighttest run {shlex.quote(str(script))}{flies}"
    document = Document("accept", _sentence(whole, made), "good", (), facts)
    return Result(document, {"vehicle": whole.vehicle, "file": str(whole.current), **asdict(made)}, value=whole)


def twin_command(model: Path, flown: Sequence[Path]) -> str:
    """The command that flies the scripts of these runs on a model's twin, under the real ArduCopter where one flew and one is on this
    machine; '' where none of them has a script."""
    scripted = [shlex.quote(str(run)) for run in flown if (run / "script.yaml").is_file()]
    if not scripted:
        return ""
    stored = model_file.read(model, whole=True)
    firmware = str(stored.fingerprint.get("firmware") or "")
    backend = ""
    if firmware.startswith("ArduCopter") and SIMULATED not in firmware and stored.model.attitude_loops:
        with suppress(LinkError):
            find_arducopter()
            backend = " --backend sitl"
    return f"flighttest twin {shlex.quote(str(model))} --verify {' '.join(scripted)}{backend}"


def _first_to_fly(vehicle: Path | None) -> str:
    """What a vehicle file needs before its vehicle can fly; '' where it can, or none is given."""
    try:
        if vehicle is not None:
            load_vehicle(vehicle)
    except FlighttestError:  # enough for recordings
        return f"first add to {vehicle} what a flight needs (zone, hover throttle, firmware, nominal voltage), then\n"
    return ""


def _fits_zone(folder: Path) -> bool:
    """Whether the flight that a folder's diagnosis proposes fits the vehicle's zone; so where that is not stored."""
    try:
        reason = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8")).get("next_reason") or {}
    except (OSError, ValueError, AttributeError):
        return True
    return reason.get("fits_zone") is not False


def accept_command(folder: Path, out: Path) -> str:
    """The command that makes a folder's model its vehicle's, behind what has to be stated first where the vehicle is not known."""
    command = f"flighttest accept {shlex.quote(str(folder))}{out_words(out)}"
    return (
        command
        if modelled_vehicle(model_file.read(folder), out)
        else f"{WRITE_NAME_FIRST}\n{command} --vehicle vehicle.yaml"
    )


def accepted(path: Path, out: Path, vehicle: Path | None) -> str:
    """Accept, in one sentence, with the command that flies its twin; why not, where it could not be: what was flown and found stays."""
    try:
        whole, made = take_into_use(path, out, vehicle)
    except FlighttestError as error:
        return f"not accepted: {error.message}; {error.hint}"
    command = twin_command(whole.current, [out / name for name in made.runs]) if whole.current is not None else ""
    done = f"done: {_sentence(whole, made)} ({whole.current})"
    return f"{done}. Its twin:\n{command}" if command else done


def _sentence(whole: Lineage, made: Generation) -> str:
    return f"{' + '.join(made.terms)} is now model {made.number} of {whole.vehicle}."


def named_or_in_use(model: Path | None, out: Path, vehicle: Path | None = None) -> Path:
    """A model as it was named, else the file of the vehicle's model in use."""
    if model is not None:
        return model
    return Path(in_use(out, load_vehicle(vehicle, to_fly=False).name if vehicle is not None else "").path)


def models(out: Path) -> Result:
    """The lineage of each vehicle: which flights, which terms joined when, what ended each."""
    check_runs(out)
    found = lineages(out)
    sections, data = [], []
    for one in found:
        since = stale_since(one, out)
        sections.append(_section(one, since))
        data.append(
            {
                "vehicle": one.vehicle,
                "current": str(one.current) if one.current else None,
                "changed_since": list(since),
                "models": [asdict(g) for g in one.generations],
            }
        )
    if not found:
        verdict = "No model was accepted yet; `flighttest accept RUN` makes the model of a run its vehicle's."
        return Result(Document("models", verdict, "warn"), {"vehicles": []})
    count = sum(len(one.generations) for one in found)
    verdict = f"{count} model{'s' if count != 1 else ''} of {join([one.vehicle for one in found])}."
    return Result(Document("models", verdict, "plain", tuple(sections)), {"vehicles": data})


def _section(one: Lineage, since: tuple[str, ...]) -> Section:
    rows: list[tuple[Cell | str, ...]] = []
    for g in one.generations:
        last = g is one.generations[-1]
        ended: Cell | str = "; ".join(g.ended)
        if last:
            ended = Cell("in use", "good") if not since else Cell("in use, stale", "bad")
        moved = "; ".join([*(f"{t} joined" for t in g.joined), *(f"{t} left" for t in g.left)])
        rows.append((f"{g.number}", g.accepted[:16], _flights(g.runs), moved or "as before", ended))
    table = Table(("", "accepted", "flights", "terms", "ended by"), tuple(rows), ("right",))
    note = (Paragraph(f"Changed since: {'; '.join(since)}.", "bad"),) if since else ()
    lead = f"in use: {one.current}"
    return Section(f"models-{one.folder.name}", one.vehicle, (table, *note), lead)


def _flights(runs: Sequence[str]) -> str:
    """The flights of a model in short: the day of the first, and the scripts where the runs are named by them."""
    day = when(runs[0])[:10] if runs else ""
    if not day or any(not when(r) for r in runs):
        return ", ".join(runs)
    return f"{day} {', '.join(r[len('2026-01-01T00-00-00-') :] for r in runs)}"
