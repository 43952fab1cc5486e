"""Start a real ArduPilot SITL for flighttest: `python sitl/launch.py [--airframe NAME] [--speedup N] [--fly [SCRIPT...]]`.

Prints the address a ground program connects to and keeps the vehicle running until Ctrl-C; with --fly, flies scripts on it and ends.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from flighttest.errors import FlighttestError
from flighttest.sim.options import SimOptions
from flighttest.sim.sitl.launcher import AIRFRAMES, Sitl, SitlOptions, launch, sitl_dir
from flighttest.sim.sitl.physics import PhysicsSitl, launch_on_physics

DEMO = ("roll_pitch", "yaw_rate", "thrust")
PROGRAM = "from flighttest.cli.main import main; main()"


def start(airframe: str, speedup: float, folder: Path | None) -> Sitl | PhysicsSitl:
    """The vehicle that is asked for, ready to arm."""
    if airframe == "rotor":
        return launch_on_physics(SimOptions(airframe="rotor", speed=speedup), folder=folder)
    return launch(SitlOptions(airframe=airframe, speedup=speedup, folder=folder, ground_crew=True))


def main() -> int:
    """Read the command line, start, wait or fly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--airframe", choices=sorted(AIRFRAMES), default="paper", help="see sitl/README.md")
    parser.add_argument("--speedup", type=float, default=5.0, help="vehicle seconds per second (default: %(default)s)")
    parser.add_argument("--folder", type=Path, help="where it runs and leaves its onboard logs (default: temporary)")
    parser.add_argument("--fly", nargs="*", metavar="SCRIPT", help=f"fly these (default: {' '.join(DEMO)})")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders go (default: %(default)s)")
    words = parser.parse_args()
    try:
        with start(words.airframe, words.speedup, words.folder) as vehicle:
            print(f"ArduCopter SITL, airframe {words.airframe}, ready at {vehicle.url}", flush=True)
            if words.fly is None:
                print("Ctrl-C stops it", flush=True)
                vehicle.wait()
                return 0
            vehicle_file = sitl_dir() / f"{words.airframe}.yaml"
            run = [sys.executable, "-c", PROGRAM, "run", *(words.fly or DEMO), "--yes", "--set-params"]
            run += ["--connect", vehicle.url, "--out", str(words.out), "--vehicle", str(vehicle_file)]
            return subprocess.run(run, check=False).returncode
    except FlighttestError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 0


if __name__ == "__main__":
    raise SystemExit(main())
