"""What earlier flights leave to the next: steps that are missing, parameters that have not been restored."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flighttest.errors import InputError
from flighttest.flight import legs_flown
from flighttest.flight.preparation.changes import LeftParameter
from flighttest.flight.preparation.fence import FenceSet, fence_set
from flighttest.pipeline.store.history import vehicle_name
from flighttest.pipeline.store.identities import run_folders
from flighttest.plan import Plan
from flighttest.recording.store import MANIFEST_NAME, read_manifest


def script_of(run_dir: Path | None) -> Path:
    """The script that a run keeps. InputError where there is none."""
    if run_dir is None:
        raise InputError("nothing to fly", "name a SCRIPT, or a run with --resume")
    read_manifest(run_dir)
    path = run_dir / "script.yaml"
    if not path.is_file():
        raise InputError(f"{run_dir} keeps no script.yaml", "only a run that was flown can be resumed")
    return path


def resumed_runs(run_dir: Path | None) -> list[Path]:
    """A run and those that it resumed itself, first flown first; those that are not there any more are left out."""
    found: list[Path] = []
    while run_dir is not None and run_dir not in found and (run_dir / MANIFEST_NAME).is_file():
        found.insert(0, run_dir)
        before = read_manifest(run_dir).get("resumes")
        if not before:
            break
        named = Path(str(before))
        run_dir = named if named.is_dir() else run_dir.parent / named.name
    return found


def left_behind(folder: Path, vehicle: str) -> dict[str, LeftParameter]:
    """Parameters that the last flight of a vehicle set and did not restore (its program may have been killed). Only by a record that was
    written for this run folder: a manifest copied from elsewhere is no evidence of this vehicle."""
    last = next((run for run in reversed(run_folders(folder)) if vehicle_name(run) == vehicle), None)
    if last is None:
        return {}
    manifest = read_manifest(last)
    values = manifest.get("parameters_left", manifest.get("parameters_changed")) or {}
    record = manifest.get("parameters_set") or {}
    given, hardware = record.get("given") or {}, record.get("hardware") or {}
    if record.get("run") != last.name:
        return {}
    return {
        name: LeftParameter(float(value), float(given[name]), str(hardware.get(name, "")))
        for name, value in values.items()
        if name in given
    }


def fence_behind(folder: Path, vehicle: str) -> FenceSet | None:
    """The fence that the last flight of a vehicle gave it and did not take away, by a record written for this run folder."""
    last = next((run for run in reversed(run_folders(folder)) if vehicle_name(run) == vehicle), None)
    return fence_set(read_manifest(last).get("fence_set") or {}, last.name) if last is not None else None


def flown_in(runs: Sequence[Path]) -> frozenset[str]:
    """Ids of the legs that were flown to their end in any of the runs."""
    return frozenset().union(*(legs_flown(run) for run in runs))


def worth_resuming(run_dir: Path, compiled: Sequence[Plan]) -> list[str]:
    """What the operator should read before going on with a run. InputError when it flew another script or another vehicle, or lacks
    nothing."""
    manifest = read_manifest(run_dir)
    script = manifest.get("script") or {}
    before = str(script.get("name", ""))
    names = [plan.script.name for plan in compiled]
    if before not in names:
        raise InputError(
            f"{run_dir} is a flight of {before or 'no script'}, not of {', '.join(names)}",
            f"leave the script out: flighttest run --resume {run_dir}",
        )
    flew, flies = str((manifest.get("vehicle") or {}).get("name", "")), compiled[0].vehicle.name
    if flew and flew != flies:
        raise InputError(
            f"{run_dir} is a flight of the vehicle {flew}, not of {flies}", "give the --vehicle it was flown with"
        )
    flown = flown_in(resumed_runs(run_dir))
    if all(leg.id in flown for plan in compiled for leg in plan.legs):
        raise InputError(
            f"{run_dir}: nothing is missing, all its steps were flown", "see them with `flighttest report`"
        )
    if script.get("sha256") in (None, *(plan.script.sha256 for plan in compiled)):
        return []
    return [f"the script {before} was changed since {run_dir} was flown: steps of one name may not be the same step"]
