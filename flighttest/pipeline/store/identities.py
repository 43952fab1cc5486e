"""Which vehicle recordings, runs and models are of. Nothing is taken to be of a vehicle because it lies beside its runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from flighttest.datafiles import read_yaml
from flighttest.errors import FlighttestError, InputError, ModelError
from flighttest.recording import Recording
from flighttest.recording.manifest import Manifest
from flighttest.recording.store import MANIFEST_NAME, read_manifest
from flighttest.report.numbers import join
from flighttest.vehicle.identity import Identity, from_data, identity
from flighttest.vehicle.model import Vehicle

MODELS_DIR = "models"  # in a folder of runs: the accepted models of each vehicle (see `lineage`)
LINEAGE_NAME = "lineage.yaml"
LINEAGE_REPAIR = "restore the file, or move its folder away and accept a model again"
WRITE_NAME_FIRST = (
    "first write the vehicle's name into vehicle.yaml (`format: vehicle/1` and `name: ...` are enough), then"
)
NAME_IT = "name it with --vehicle vehicle.yaml (`format: vehicle/1` and `name: ...` are enough)"


def run_folders(folder: Path) -> list[Path]:
    """Run folders below a folder, by name, which begins with their date."""
    if not folder.is_dir():
        return []
    return sorted(p for p in folder.iterdir() if (p / MANIFEST_NAME).is_file())


def of_manifest(manifest: Manifest) -> Identity:
    """Of a run, by its manifest."""
    vehicle = manifest.get("vehicle") or {}
    block = vehicle if isinstance(vehicle, Mapping) else {"name": vehicle}
    return identity(block, manifest.get("parameters") or {}, str(manifest.get("autopilot") or ""))


def of_recording(recording: Recording) -> Identity:
    """Of one recording, by what it carries."""
    source = recording.provenance
    return identity(source.vehicle, source.parameters, source.autopilot)


def identity_of(recordings: Sequence[Recording], vehicle: Vehicle | None) -> Identity:
    """Of recordings together: the vehicle file's name first, of everything else what the newest recording has; of none where they are of
    two vehicles."""
    found = Identity()
    declared = vehicle is not None and bool(vehicle.name)
    if not declared and len({of_recording(r).key for r in recordings} - {""}) > 1:
        return found
    for one in map(of_recording, recordings):
        found = Identity(
            one.name or found.name,
            one.autopilot or found.autopilot,
            found.sysid if one.sysid is None else one.sysid,
            one.calibration or found.calibration,
        )
    return replace(found, name=vehicle.name) if vehicle is not None and vehicle.name else found


def known_in(folder: Path) -> dict[str, list[Identity]]:
    """The named vehicles of a folder of runs, and what their runs and accepted models hold of their autopilots."""
    found: dict[str, list[Identity]] = {}
    for path in sorted((folder / MODELS_DIR).glob(f"*/{LINEAGE_NAME}")):
        data = read_yaml(path, ModelError, "lineage", LINEAGE_REPAIR)
        if isinstance(data, dict) and isinstance(data.get("vehicle"), str):
            kept = data.get("identity")
            found.setdefault(data["vehicle"], []).append(from_data(kept if isinstance(kept, dict) else {}))
    for run in run_folders(folder):
        try:
            one = of_manifest(read_manifest(run))
        except FlighttestError:
            continue
        if one.name:
            found.setdefault(one.name, []).append(one)
    return found


def recognised(one: Identity, known: Mapping[str, Iterable[Identity]]) -> str:
    """What a vehicle is called: its own name, else that of the one whose autopilot it is, else by its autopilot; '' where it is unknown."""
    if one.name:
        return one.name
    names = [name for name, others in known.items() if any(one.same_board(other) for other in others)]
    return names[0] if len(names) == 1 else one.key


def whose(recordings: Sequence[Recording], vehicle: Vehicle | None, folder: Path | None = None) -> str:
    """The one vehicle that recordings are of, '' where it is not known. InputError where they are of two."""
    vehicle = vehicle if vehicle is not None and vehicle.name else None
    known = known_in(folder) if folder is not None else {}
    named = [recognised(of_recording(r), known) for r in recordings]
    for recording, name in zip(recordings, named, strict=True):
        other = vehicle.name if vehicle is not None else next((n for n in named if n), "")
        if name and name != other and (recording.provenance.vehicle.get("name") or vehicle is None):
            raise InputError(
                f"recordings of two vehicles: {recording.name} is of {name}, not of {other}",
                "give the recordings of one vehicle, with its own vehicle file",
            )
    return vehicle.name if vehicle is not None else next((n for n in named if n), "")


def only_vehicle(names: Sequence[str], folder: Path) -> str:
    """The vehicle that is meant where none is named: the only one there is. InputError where there are several."""
    distinct = sorted({n for n in names if n})
    if len(distinct) > 1:
        raise InputError(f"{folder} holds {len(distinct)} vehicles: {join(distinct)}", NAME_IT)
    return distinct[0] if distinct else ""
