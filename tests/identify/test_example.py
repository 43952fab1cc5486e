"""The documented planner runs on an export and keeps what it promises."""

import importlib.util
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from flighttest.identify.models.export import export
from flighttest.identify.models.model_file import from_fit


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


@pytest.fixture
def mpc(repository, monkeypatch):
    """The planner as a module, over a short horizon and without a compiler: quick enough for here."""
    spec = importlib.util.spec_from_file_location("mpc", repository / "examples" / "mpc.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "HORIZON", 10)
    monkeypatch.setattr(module.shutil, "which", lambda _name: None)
    return module


def test_a_plan_with_an_improved_model_converges_however_fast_its_lags(found, tmp_path, mpc):
    base = from_fit(found)
    model = base.model.with_terms("reference_shaping", "thrust_extra_lag")
    values = model.start(base.values) | {
        "sigma_t": 150.0,
        "thrust_extra_tau": 0.008,
        "shaping_accel": 18.1,
        "shaping_tc": 0.157,
    }
    export(replace(base, model=model, values=values), "casadi", tmp_path)
    planner = mpc.Planner(tmp_path)
    assert planner.steps >= 15  # 0.2 s at 150 1/s: the four of the paper's lags diverged, and the plan with them
    assert planner.plan(planner.x_hover.copy(), np.array([1.0, -0.5, 0.5])) < mpc.MOST_ITERATIONS
    assert planner.gap < mpc.TOLERANCE


def test_a_plan_that_does_not_converge_is_said_to_be_none(found, tmp_path, mpc, monkeypatch):
    export(from_fit(found), "casadi", tmp_path)
    planner = mpc.Planner(tmp_path)
    monkeypatch.setattr(mpc, "MOST_ITERATIONS", 1)
    with pytest.raises(mpc.NoPlanError, match="after 1 iterations it still changes by"):
        planner.plan(planner.x_hover.copy(), np.array([8.0, -4.0, 2.0]))
