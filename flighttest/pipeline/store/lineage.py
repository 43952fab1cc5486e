"""The one model in use of each vehicle, and those before it: RUNS/models/VEHICLE/lineage.yaml, and a copy of each accepted model."""

from __future__ import annotations

import datetime
import hashlib
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from flighttest.datafiles import read_yaml, write_whole
from flighttest.documents import write_text
from flighttest.errors import FlighttestError, InputError, ModelError
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.model import PAPER_TERMS
from flighttest.pipeline.recordings.fingerprints import fingerprint_of_run
from flighttest.pipeline.store.history import AS_GOOD, campaigns, reference_model
from flighttest.pipeline.store.identities import (
    LINEAGE_NAME,
    LINEAGE_REPAIR,
    MODELS_DIR,
    NAME_IT,
    known_in,
    only_vehicle,
    recognised,
    run_folders,
)
from flighttest.recording.store import read_manifest
from flighttest.report.numbers import join
from flighttest.validity.declared import declared_changes
from flighttest.vehicle.identity import from_data
from flighttest.vehicle.load import load_vehicle

FORMAT = "lineage/1"


@dataclass(frozen=True)
class Generation:
    """One accepted model. file: its copy, beside lineage.yaml; source: what was accepted; runs: recordings it was fitted to.

    joined, left: terms by which it differs from the one before (the first: from the paper's model); ended: why the next took its place,
    one sentence each, and when.
    """

    number: int
    file: str
    accepted: str
    source: str
    runs: tuple[str, ...] = ()
    terms: tuple[str, ...] = ()
    joined: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    ended: tuple[str, ...] = ()
    ended_on: str = ""


@dataclass(frozen=True)
class Lineage:
    """All accepted models of one vehicle, oldest first."""

    vehicle: str
    folder: Path
    generations: tuple[Generation, ...] = field(default=())

    @property
    def current(self) -> Path | None:
        """The file of the model in use."""
        return self.folder / self.generations[-1].file if self.generations else None


def folder_of(out: Path, vehicle: str) -> Path:
    """Where a vehicle's models are; a name that is none for a folder gets a part of its hash."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", vehicle).strip("._") or "vehicle"
    tail = "" if plain == vehicle else f"-{hashlib.sha256(vehicle.encode()).hexdigest()[:6]}"
    return out / MODELS_DIR / f"{plain}{tail}"


def lineage_of(out: Path, vehicle: str) -> Lineage:
    """The accepted models of a vehicle; none where nothing was accepted yet."""
    folder = folder_of(out, vehicle)
    path = folder / LINEAGE_NAME
    return _read(path) if path.is_file() else Lineage(vehicle, folder)


def lineages(out: Path) -> list[Lineage]:
    """Of every vehicle in a folder of runs, by name."""
    return sorted((_read(p) for p in (out / MODELS_DIR).glob(f"*/{LINEAGE_NAME}")), key=lambda one: one.vehicle)


def _read(path: Path) -> Lineage:
    data = read_yaml(path, ModelError, "lineage", LINEAGE_REPAIR)
    if not isinstance(data, dict) or data.get("format") != FORMAT or not isinstance(data.get("vehicle"), str):
        raise ModelError(f"{path} is not a {FORMAT} file", LINEAGE_REPAIR)
    made = []
    rows = data.get("models")
    if not isinstance(rows, list):
        raise ModelError(f"{path}: it has no list of models", LINEAGE_REPAIR)
    for row in rows:
        try:
            made.append(_generation(row))
        except (TypeError, KeyError, ValueError, AttributeError) as error:
            raise ModelError(f"{path}: an entry in its list of models is incomplete", LINEAGE_REPAIR) from error
        if not isinstance(row["file"], str) or Path(made[-1].file).name != made[-1].file:
            raise ModelError(f"{path}: {made[-1].file!r} is not a file name in its folder", LINEAGE_REPAIR)
    return Lineage(data["vehicle"], path.parent, tuple(made))


def _generation(row: Mapping[str, Any]) -> Generation:
    def listed(key: str) -> tuple[str, ...]:
        return tuple(map(str, row.get(key) or ()))

    return Generation(
        int(row["number"]), str(row["file"]), str(row["accepted"]), str(row.get("source") or ""), listed("runs"), listed("terms"),
        listed("joined"), listed("left"), listed("ended"), str(row.get("ended_on") or ""),
    )  # fmt: skip


def model_of(out: Path, vehicle: str) -> ModelFile | None:
    """The model in use of a vehicle: the one accepted last; where none was, the last good fit of its own runs."""
    if not vehicle:
        return None
    accepted = lineage_of(out, vehicle).current
    if accepted is not None:
        return model_file.read(accepted)
    found = reference_model(campaigns(out, vehicle))
    return found.model if found is not None else None


def in_use(out: Path, vehicle: str = "") -> ModelFile:
    """The model in use of a vehicle, or of the only one in a folder of runs. InputError where there is none or it is not known whose."""
    if not vehicle:
        vehicle = only_vehicle([*(one.vehicle for one in lineages(out)), *known_in(out)], out)
    found = model_of(out, vehicle)
    if found is None:
        whose = f" of a vehicle called {vehicle}" if vehicle else ""
        remedy = "name the folder where its model was accepted with --out" if vehicle else NAME_IT
        raise InputError(
            f"no model was given, and {out} holds neither an accepted model nor a run with a fit{whose}",
            f"name one with --model, fly: flighttest run thrust, or {remedy}",
        )
    return found


def take_into_use(path: Path, out: Path, vehicle: Path | None = None) -> tuple[Lineage, Generation]:
    """Make the model of a run or diagnosis folder, or a model file, its vehicle's model in use. InputError where the vehicle is not known
    or another one's, or where the model determines less than the one in use, of an unchanged vehicle and without its flights. A model
    with the values of the one in use takes its place, under its number."""
    if not path.exists():
        raise InputError(
            f"{path}: there is no such model or folder", "name what `flighttest diagnose -o` or `run` wrote"
        )
    stored = model_file.read(path, whole=True)
    name = _whose(stored, path, out, vehicle)
    before = lineage_of(out, name)
    last = before.generations[-1] if before.generations else None
    now = datetime.datetime.now().isoformat(sep=" ", timespec="seconds")
    made = Generation(
        number=len(before.generations) + 1,
        file=f"{len(before.generations) + 1:03d}.yaml",
        accepted=now,
        source=str(path),
        runs=tuple(map(str, stored.runs)),
        terms=tuple(stored.model.terms),
        joined=tuple(t for t in stored.model.terms if t not in PAPER_TERMS),
    )
    generations = list(before.generations)
    if last is not None and before.current is not None:
        old = model_file.read(before.current)
        if (old.runs, old.values, old.fingerprint) == (stored.runs, stored.values, stored.fingerprint):
            # Diagnosed again, it may hold more beside its values (what its flights could have shown): the newest is the one in use.
            again = replace(last, accepted=now, source=str(path))
            whole = Lineage(name, before.folder, (*generations[:-1], again))
            _write(whole, stored, again)
            return whole, again
        made = replace(
            made,
            joined=tuple(t for t in made.terms if t not in last.terms),
            left=tuple(t for t in last.terms if t not in made.terms),
        )
        changes, _ = declared_changes(old.fingerprint, stored.fingerprint)
        lost = worse(stored, old)
        if lost and not changes:
            raise InputError(
                f"{path} determines less than the model in use, of {join(lost)}",
                f"fit its flights with those of the model in use: {joint_fit_command(out, old, path)}; "
                "or declare in vehicle.yaml what has changed",
            )
        generations[-1] = replace(last, ended=tuple(_ended(changes, made)), ended_on=now)
    whole = Lineage(name, before.folder, (*generations, made))
    _write(whole, stored, made)
    return whole, made


def modelled_vehicle(stored: ModelFile, out: Path) -> str:
    """Name of the vehicle that a model is of, else what its autopilot is called; '' where neither is known."""
    of = from_data(stored.vehicle)
    return recognised(of, known_in(out)) or of.key


def _whose(stored: ModelFile, path: Path, out: Path, vehicle: Path | None) -> str:
    declared = load_vehicle(vehicle, to_fly=False).name if vehicle is not None else ""
    of, name = from_data(stored.vehicle), modelled_vehicle(stored, out)
    # What its autopilot is called is no name against that of a vehicle file.
    if declared and name and declared != name and (of.name or name != of.key):
        raise InputError(f"{path} is a model of {name}, not of {declared}", f"give the vehicle file of {name}")
    if not (declared or name):
        raise InputError(f"{path}: it is not known which vehicle this is a model of", NAME_IT)
    return declared or name


def worse(new: ModelFile, old: ModelFile) -> list[str]:
    """What a model determines less well than another one, by `AS_GOOD`. Nothing where it is fitted to the other's flights too: a term that
    joined widens what it is confused with, and rightly so."""
    if set(map(str, old.runs)) <= set(map(str, new.runs)):
        return []
    mine, theirs = _known(new), _known(old)
    return [n for n, std in theirs.items() if n not in mine or mine[n] > AS_GOOD * std]


def joint_fit_command(out: Path, old: ModelFile, path: Path) -> str:
    """The command that diagnoses a run with the flights of a model, and accepts what comes out."""
    runs = [*(out / str(r) for r in old.runs if str(r) != path.name), path]
    words = " ".join(shlex.quote(str(r)) for r in runs)
    return f"flighttest diagnose {words} -o {shlex.quote(str(path / 'together'))} --accept"


def _known(stored: ModelFile) -> dict[str, float]:
    """The parameters that a model determines, with their standard errors."""
    kept = {n: p for n, p in stored.parameters.items() if n in stored.model.names}  # without T_d, a mean of others
    return {n: p.std for n, p in kept.items() if p.identifiable and p.std is not None}


def _ended(changes: Sequence[Any], made: Generation) -> list[str]:
    """Why a model ended: what changed on the vehicle, else what its successor has that it had not."""
    reasons = [f"{c.name} {c.before} is now {c.after}" for c in changes]
    if made.joined:
        reasons.append(f"{join(made.joined)} joined")
    if made.left:
        reasons.append(f"{join(made.left)} left")
    return reasons or ["flown again"]


def _write(whole: Lineage, stored: ModelFile, made: Generation) -> None:
    """The copy first, then the list that names it: a program killed between them leaves the model before in use."""
    whole.folder.mkdir(parents=True, exist_ok=True)
    data = read_yaml(Path(stored.path), ModelError, "model file", LINEAGE_REPAIR)
    data["vehicle"] = {**(data.get("vehicle") or {}), "name": whole.vehicle}
    model_file.write(whole.folder / made.file, data)
    rows = [{k: list(v) if isinstance(v, tuple) else v for k, v in asdict(one).items()} for one in whole.generations]
    known = {k: v for k, v in data["vehicle"].items() if k != "name"}
    text = write_text({"format": FORMAT, "vehicle": whole.vehicle, "identity": known, "models": rows})
    write_whole(whole.folder / LINEAGE_NAME, text)


def stale_since(one: Lineage, out: Path) -> tuple[str, ...]:
    """What the newest run of a vehicle declares otherwise than its model in use, one sentence each."""
    if one.current is None:
        return ()
    fingerprint = model_file.read(one.current).fingerprint
    for run in reversed(run_folders(out)):
        try:
            manifest = read_manifest(run)
        except FlighttestError:
            continue
        if (manifest.get("vehicle") or {}).get("name") == one.vehicle:
            changes, _ = declared_changes(fingerprint, fingerprint_of_run(manifest))
            return tuple(f"{c.name} {c.before} is now {c.after} ({run.name})" for c in changes)
    return ()
