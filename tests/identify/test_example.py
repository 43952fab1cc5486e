"""The documented planner runs on an export and keeps what it promises."""

import subprocess
import sys

from flighttest.identify.export import export
from flighttest.identify.model_file import from_fit


def test_the_planner_reaches_its_target_with_the_exported_model(found, tmp_path, repository):
    export(from_fit(found), "casadi", tmp_path)
    run = subprocess.run(
        [sys.executable, str(repository / "examples" / "mpc.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    away = float(run.stdout.split("flown with it: ")[1].split(" m")[0])
    assert away < 0.5
    assert "warm-started iteration" in run.stdout
