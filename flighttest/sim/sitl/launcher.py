"""A real ArduPilot SITL as a vehicle on this machine: find `arducopter`, start it, wait until it can arm, stop it.

Nothing of ArduPilot comes with this package. Where no binary is found, the error names where one looks for it and who explains how to
build one. Every vehicle runs in a folder of its own with ports of its own, so several can fly at once.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from types import TracebackType

from flighttest.errors import InputError, LinkError
from flighttest.sim.sitl.crew import GroundCrew
from flighttest.sim.sitl.probe import ArmingProbe, Readiness

DOCUMENTATION = "https://ardupilot.org/dev/docs/sitl-simulator-software-in-the-loop.html"
_HOST = "127.0.0.1"
_BUILT = Path("build/sitl/bin/arducopter")
_PORTS = range(17000, 29000, 20)  # below the ephemeral range; a vehicle takes ten in a row
_SCRIPTING = b"Scripting: "  # begins what a firmware with scripts prints about them
_PORTS_EACH = 10
_LAST_PORT = 65535
_STOP_PATIENCE_S = 5.0
_LOG_NAME = "arducopter.log"
# Near sea level: the firmware corrects thrust for air density, so a high take-off place would change K.
SEA_LEVEL_HOME = (50.8780, 4.7000, 10.0, 0.0)


def sitl_dir() -> Path:
    """The folder of shipped airframes, parameters and scripts: inside the installed package, else beside it in a source tree."""
    package = Path(str(resources.files("flighttest")))
    installed = package / "data" / "sitl"
    return installed if installed.is_dir() else package.parent / "sitl"


def find_arducopter(environment: Mapping[str, str] | None = None) -> Path:
    """The `arducopter` binary: ARDUCOPTER, else PATH, else built in a checkout at ARDUPILOT_HOME or ~/ardupilot. LinkError if none."""
    env = os.environ if environment is None else environment
    named = env.get("ARDUCOPTER")
    if named:
        if os.access(named, os.X_OK) and Path(named).is_file():
            return Path(named).resolve()
        raise LinkError(f"ARDUCOPTER={named} is not a program", "point it at the built binary `arducopter`")
    on_path = shutil.which("arducopter", path=env.get("PATH"))
    if on_path:
        return Path(on_path).resolve()
    checkouts = [Path(env["ARDUPILOT_HOME"])] if env.get("ARDUPILOT_HOME") else []
    checkouts.append(Path(env.get("HOME") or "~").expanduser() / "ardupilot")
    for checkout in checkouts:
        if os.access(checkout / _BUILT, os.X_OK):
            return (checkout / _BUILT).resolve()
    raise LinkError(
        "no ArduPilot SITL here: no `arducopter` in ARDUCOPTER, on PATH, or built in ARDUPILOT_HOME or ~/ardupilot",
        f"build one as ArduPilot explains at {DOCUMENTATION}, or fly the built-in vehicle: --connect sim",
    )


@dataclass(frozen=True)
class SitlAirframe:
    """A vehicle for SITL: parameter files (later ones win), and a frame file of ArduPilot's own physics, if any."""

    parameters: tuple[str, ...]
    frame: str | None = None


AIRFRAMES: dict[str, SitlAirframe] = {
    "stock": SitlAirframe(("copter.parm", "stock.parm")),
    "sagging": SitlAirframe(("copter.parm", "sagging.parm"), "sagging.json"),
    "paper": SitlAirframe(("copter.parm", "paper.parm"), "paper.json"),
    "rotor": SitlAirframe(("copter.parm", "json.parm")),  # on our physics only: see `sitl_physics`
}


@dataclass(frozen=True)
class SitlOptions:
    """One SITL vehicle.

    airframe: a name in AIRFRAMES. speedup: vehicle seconds per second at most. parameters: values on top of the airframe's files.
    physics_port: UDP port of an outside physics (`json_backend`) that replaces ArduPilot's own, with rate_hz steps per vehicle second
    (0: ArduPilot's default); scripts: Lua files to run. home: latitude deg, longitude deg, height above sea level m, heading deg.
    frame: a folder with vehicle.json and vehicle.parm, flown instead of the airframe's. folder: where it runs and leaves its onboard
    logs; None: a temporary one, removed at the end. ground_crew: gives it a full pack after each landing (the third port is then
    taken). port: TCP port of `Sitl.url`, the first of ten in a row; 0: wherever ten are free.
    """

    airframe: str = "paper"
    speedup: float = 1.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    parameter_files: tuple[Path, ...] | None = None
    physics_port: int | None = None
    rate_hz: int = 0
    scripts: tuple[Path, ...] = ()
    home: tuple[float, float, float, float] = SEA_LEVEL_HOME
    folder: Path | None = None
    ground_crew: bool = False
    port: int = 0
    frame: Path | None = None

    def __post_init__(self) -> None:
        if self.airframe not in AIRFRAMES:
            raise InputError(f"no SITL airframe is called {self.airframe!r}", f"there are {', '.join(AIRFRAMES)}")
        if not self.speedup > 0.0:
            raise InputError(f"speedup {self.speedup} is not above 0")


class Sitl:
    """A running SITL vehicle, stopped when the `with` block ends. url: where a ground program connects; folder: where it runs."""

    def __init__(self, process: subprocess.Popen[bytes], base_port: int, folder: Path, temporary: bool) -> None:
        self._process, self.base_port, self.folder, self._temporary = process, base_port, folder, temporary
        self.url = f"tcp:{_HOST}:{base_port}"
        self.ready_after_s = float("nan")
        self.crew: GroundCrew | None = None

    @property
    def alive(self) -> bool:
        """Whether the firmware runs."""
        return self._process.poll() is None

    @property
    def onboard_logs(self) -> tuple[Path, ...]:
        """Dataflash logs written so far, oldest first."""
        return tuple(sorted((self.folder / "logs").glob("*.BIN")))

    def output(self, lines: int = 8) -> str:
        """The last lines the firmware printed."""
        path = self.folder / _LOG_NAME
        text = path.read_text(errors="replace") if path.is_file() else ""
        return "\n".join([line for line in text.splitlines() if line.strip()][-lines:])

    def wait_ready(self, timeout_s: float = 120.0, until: Callable[[Readiness], bool] | None = None) -> None:
        """Wait until it can arm in GUIDED; LinkError with the firmware's own reason after timeout_s, s of this machine's time.

        It listens on a second port of its own, so the port of `url` stays free for the ground program.
        """
        started = time.monotonic()
        end = started + timeout_s
        done = until or (lambda state: state.ready)
        probe: ArmingProbe | None = None
        state = Readiness()
        try:
            while time.monotonic() < end:
                if not self.alive:
                    raise LinkError(
                        f"ArduPilot SITL ended by itself (code {self._process.returncode}):\n{self.output()}",
                        "check the parameter and frame files it was given",
                    )
                try:
                    probe = probe or ArmingProbe(_HOST, self.base_port + 2)
                    state = probe.poll(0.2)
                except OSError:
                    # Not listening yet, or hung up while it starts again.
                    if probe is not None:
                        probe.close()
                        probe = None
                    time.sleep(0.05)
                    continue
                if done(state):
                    self.ready_after_s = time.monotonic() - started
                    return
        finally:
            if probe is not None:
                probe.close()
        raise LinkError(
            f"ArduPilot SITL cannot arm after {timeout_s:.0f} s: {state.missing}",
            "a busy machine needs more time or a smaller speedup",
        )

    def wait(self) -> None:
        """Until it ends by itself."""
        self._process.wait()

    def stop(self) -> None:
        """End it; a second call does nothing."""
        if self.crew is not None:
            self.crew.stop()
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._temporary:
            shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Sitl:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()


def launch(
    options: SitlOptions | None = None,
    *,
    speedup: float | None = None,
    wait_s: float = 120.0,
    binary: Path | None = None,
) -> Sitl:
    """Start a SITL vehicle and wait until it can arm (wait_s = 0: do not wait). LinkError where there is none or it will not fly."""
    chosen = options or SitlOptions()
    program = binary or find_arducopter()
    if chosen.scripts and _SCRIPTING not in program.read_bytes():
        raise LinkError(
            f"{program} was built without scripting, which gives it the battery of an external physics: it cannot arm without",
            "build it without --disable-scripting",
        )
    temporary = chosen.folder is None
    named = Path(tempfile.mkdtemp(prefix="flighttest-sitl-")) if chosen.folder is None else chosen.folder
    folder = named.resolve()  # the firmware runs in it, and reads its files by their names on the command line
    folder.mkdir(parents=True, exist_ok=True)
    try:
        base = _asked_for(chosen.port) if chosen.port else free_ports()
        words = command(chosen, program, base, folder, speedup)
        with (folder / _LOG_NAME).open("wb") as log:
            # A session of its own: Ctrl-C goes to us, and we stop it in order.
            process = subprocess.Popen(
                words,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
    except BaseException:
        if temporary:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    vehicle = Sitl(process, base, folder, temporary)
    try:
        if wait_s > 0.0:
            vehicle.wait_ready(wait_s)
        if chosen.ground_crew:
            vehicle.crew = GroundCrew(_HOST, base + 3)
    except BaseException:
        vehicle.stop()
        raise
    return vehicle


def command(options: SitlOptions, program: Path, base: int, folder: Path, speedup: float | None = None) -> list[str]:
    """The command line, after writing into `folder` the files it refers to."""
    airframe, shipped = AIRFRAMES[options.airframe], sitl_dir()
    sources = options.parameter_files or tuple(shipped / name for name in airframe.parameters)
    if options.frame is not None:
        sources = (shipped / "copter.parm", options.frame / "vehicle.parm")
    files = [str(_existing(path)) for path in sources]
    if options.parameters:
        extra = folder / "extra.parm"
        extra.write_text("".join(f"{name} {value:.9g}\n" for name, value in options.parameters.items()))
        files.append(str(extra))
    if options.physics_port is not None:
        model = f"JSON:{_HOST}"
    elif airframe.frame or options.frame is not None:
        # The firmware looks for a frame file in its working directory.
        file = shipped / str(airframe.frame) if options.frame is None else options.frame / "vehicle.json"
        shutil.copyfile(_existing(file), folder / file.name)
        model = f"x:{file.name}"
    else:
        model = "x"
    if options.scripts:
        (folder / "scripts").mkdir(exist_ok=True)
        for script in options.scripts:
            shutil.copyfile(_existing(script), folder / "scripts" / script.name)
    home = ",".join(f"{value:.7g}" for value in options.home)
    words = [str(program), "--model", model, "--speedup", f"{speedup or options.speedup:g}", "--wipe"]
    words += ["--defaults", ",".join(files), "--home", home, "-I0", "--base-port", str(base)]
    # Without `:wait` on the first port the firmware boots at once instead of at the first connection.
    words += ["--serial0", "tcp:0", "--rc-in-port", str(base + 5), "--irlock-port", str(base + 6)]
    words += ["--sim-port-in", str(base + 7), "--sim-port-out", str(options.physics_port or base + 8)]
    if options.rate_hz:
        words += ["--rate", str(options.rate_hz)]
    return words


def free_ports(candidates: Sequence[int] = _PORTS) -> int:
    """The first of ten TCP ports in a row that are free."""
    offset = os.getpid() % len(candidates)  # two programs started together begin their search at different places
    for base in (*candidates[offset:], *candidates[:offset]):
        if all(_is_free(base + i) for i in range(_PORTS_EACH)):
            return base
    raise LinkError("no ten free TCP ports in a row", "stop other simulators")


def _asked_for(base: int) -> int:
    """A port that is asked for, if it and the nine after it are free."""
    taken = [base + i for i in range(_PORTS_EACH) if base + i > _LAST_PORT or not _is_free(base + i)]
    if taken:
        raise LinkError(
            f"port {taken[0]} cannot be used; a SITL at {base} needs {base} to {base + _PORTS_EACH - 1}",
            "stop the program that uses it, or give another port (0 takes free ones)",
        )
    return base


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, port))
        except OSError:
            return False
    return True


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise InputError(f"{path} does not exist", "reinstall, or name an existing file")
    return path.resolve()
