"""What a flight was flown with, kept in its run folder: so that the command that goes on with it needs no other words."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from flighttest.datafiles import read_yaml, write_whole
from flighttest.documents import write_text
from flighttest.errors import RecordingError
from flighttest.pipeline.store.history import DEFAULT_RUNS
from flighttest.pipeline.vehicles.live import BUILTIN

COMMAND_NAME = "command.yaml"
VEHICLE_NAME = "vehicle.yaml"


@dataclass(frozen=True)
class FlownWith:
    """The words of a command line for what flies, and without which the preflight refuses. link: a URL, or the built-in vehicle's name.
    Waived checks are not among them: those are waived for one flight, and for what goes on with it."""

    link: str
    vehicle: Path | None = None
    airframe: str = "paper"
    hide: tuple[str, ...] = ()
    set_params: bool = False
    extend_fence: bool = False
    signing_key: Path | None = None
    sysid: int | None = None

    @property
    def settings(self) -> str:
        """Of `words` those that do not name the vehicle."""
        options = [
            name for name, given in (("--set-params", self.set_params), ("--extend-fence", self.extend_fence)) if given
        ]
        options += [f"--signing-key {shlex.quote(str(self.signing_key))}"] if self.signing_key is not None else []
        options += [f"--sysid {self.sysid}"] if self.sysid is not None else []
        return "".join(f" {option}" for option in options)

    @property
    def words(self) -> str:
        """For the end of a command line: a space and the options, '' for the built-in vehicle as it is."""
        options = [f"--vehicle {shlex.quote(str(self.vehicle))}"] if self.vehicle is not None else []
        if self.link != BUILTIN or self.vehicle is not None:
            options.append(f"--connect {shlex.quote(self.link)}")
        if self.airframe != "paper":
            options.append(f"--airframe {shlex.quote(self.airframe)}")
        options += [f"--hide {shlex.quote(one)}" for one in self.hide]
        return "".join(f" {option}" for option in options) + self.settings


def keep(run_dir: Path, flown: FlownWith) -> None:
    """Write it into a run folder, with a copy of the vehicle file."""
    run_dir.mkdir(parents=True, exist_ok=True)
    data: dict[str, object] = {"format": "command/1", "connect": flown.link}
    if flown.vehicle is not None:
        shutil.copyfile(flown.vehicle, run_dir / VEHICLE_NAME)
        data["vehicle"] = str(flown.vehicle.absolute())
    data |= {"airframe": flown.airframe, "hide": list(flown.hide)}
    data |= {"set_params": flown.set_params, "extend_fence": flown.extend_fence}
    if flown.signing_key is not None:
        data["signing_key"] = str(flown.signing_key.absolute())
    if flown.sysid is not None:
        data["sysid"] = flown.sysid
    write_whole(run_dir / COMMAND_NAME, write_text(data))


def flown_with(run_dir: Path) -> FlownWith | None:
    """What a run was flown with: by the vehicle file's own place, else its copy. None where the run does not hold it."""
    path = run_dir / COMMAND_NAME
    if not path.is_file():
        return None
    data = read_yaml(path, RecordingError, "command", "name the vehicle and the link on the command line")
    hide = data.get("hide") if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(data.get("connect"), str) or not isinstance(hide or [], list):
        raise RecordingError(f"{path} is not a command/1 file", "name the vehicle and the link on the command line")
    named = Path(str(data["vehicle"])) if data.get("vehicle") else None
    if named is not None and not named.is_file():
        named = run_dir / VEHICLE_NAME
    key, sysid = data.get("signing_key"), data.get("sysid")
    return FlownWith(
        data["connect"],
        named,
        str(data.get("airframe") or "paper"),
        tuple(map(str, hide or [])),
        set_params=data.get("set_params") is True,
        extend_fence=data.get("extend_fence") is True,
        signing_key=Path(str(key)) if key else None,
        sysid=sysid if isinstance(sysid, int) else None,
    )


def words_of(run_dir: Path) -> str:
    """The options that fly a run's vehicle again, '' where it is the built-in one or not known."""
    try:
        found = flown_with(run_dir)
    except RecordingError:  # a hint must not fail
        return ""
    return found.words if found is not None else ""


def out_words(out: Path) -> str:
    """The option that names a folder of runs, '' for the usual one."""
    return f" --out {shlex.quote(str(out))}" if out != DEFAULT_RUNS else ""


def rerun_options(runs: Sequence[Path], out: Path, vehicle: Path | None = None) -> str:
    """The options that fly the vehicle of the newest of these runs again, into the same folder of runs. vehicle: its vehicle file of now.
    Where no run holds what flew, the vehicle file alone; '' without one."""
    for run_dir in reversed(runs):
        try:
            found = flown_with(run_dir)
        except RecordingError:  # a hint must not fail
            continue
        if found is not None:
            return (replace(found, vehicle=vehicle) if vehicle is not None else found).words + out_words(out)
    return f" --vehicle {shlex.quote(str(vehicle))}" if vehicle is not None else ""
