"""What other programs get: CasADi files, C that compiles, and a description that fits both."""

import json
import shutil
import subprocess
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from flighttest.identify.models.export import export, functions
from flighttest.identify.models.model_file import from_fit

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def state_and_input(described):
    rng = np.random.default_rng(0)
    x = np.array(described["hover"]["x"]) + 0.1 * rng.standard_normal(len(described["states"]))
    return x, np.array(described["hover"]["u"])


def test_casadi_functions_load_and_are_the_model(found, tmp_path):
    export(from_fit(found), "casadi", tmp_path)
    described = json.loads((tmp_path / "model.json").read_text())
    dynamics = ca.Function.load(str(tmp_path / "dynamics.casadi"))
    step = ca.Function.load(str(tmp_path / "step.casadi"))
    slopes = ca.Function.load(str(tmp_path / "step_jacobian.casadi"))
    x, u = state_and_input(described)
    system = found.model.system
    p = [found.values[n] for n in system.params]
    assert np.allclose(np.asarray(dynamics(x, u)).ravel(), np.asarray(system.function(x, u, p)[0]).ravel(), rtol=1e-12)
    assert [s["name"] for s in described["states"]] == list(system.states)
    assert [i["name"] for i in described["inputs"]][:4] == [
        "roll_ref_rad",
        "pitch_ref_rad",
        "yaw_rate_ref_rad_s",
        "throttle",
    ]
    # One step of 5 ms is what many small ones give, to RK4's error.
    many = x
    for _ in range(50):
        many = step(many, u, 1e-4)
    assert np.allclose(np.asarray(step(x, u, 0.005)).ravel(), np.asarray(many).ravel(), atol=2e-6)
    a = np.asarray(slopes(x, u, 0.02)[0])
    nudge = 1e-6 * np.eye(x.size)
    difference = np.stack(
        [np.asarray(step(x + n, u, 0.02) - step(x - n, u, 0.02)).ravel() / 2e-6 for n in nudge], axis=1
    )
    assert np.allclose(a, difference, atol=1e-7)


def test_the_covariance_is_of_the_standard_errors_beside_it(found, tmp_path):
    """It was that of the scatter alone: of a natural frequency 0.0037 beside a standard error of 0.075."""
    export(from_fit(found), "json", tmp_path)
    described = json.loads((tmp_path / "model.json").read_text())
    order, matrix = described["covariance"]["order"], np.array(described["covariance"]["matrix"])
    for k, name in enumerate(order):
        assert np.sqrt(matrix[k, k]) == pytest.approx(described["parameters"][name]["std"], rel=1e-5)
    assert np.linalg.eigvalsh(matrix)[0] > -1e-9


def test_the_sensitivity_is_the_slope_by_the_parameters_of_the_covariance(found, tmp_path):
    stored = from_fit(found)
    export(stored, "casadi", tmp_path)
    described = json.loads((tmp_path / "model.json").read_text())
    order = described["sensitivity_order"]
    assert {"K", "sigma_t", "omega_phi"} <= set(order) <= set(described["covariance"]["order"])
    x, u = state_and_input(described)
    made = np.asarray(ca.Function.load(str(tmp_path / "step_sensitivity.casadi"))(x, u, 0.02))
    for name, slope in zip(order, made.T, strict=True):
        h = 1e-5 * max(abs(stored.values[name]), 1e-3)
        ends = [
            np.asarray(
                functions(replace(stored, values={**stored.values, name: stored.values[name] + d}))["step"](x, u, 0.02)
            )
            for d in (h, -h)
        ]
        assert np.allclose(slope, (ends[0] - ends[1]).ravel() / (2.0 * h), atol=1e-6), name


def test_hover_is_an_equilibrium(found, tmp_path):
    export(from_fit(found), "casadi", tmp_path)
    described = json.loads((tmp_path / "model.json").read_text())
    dynamics = ca.Function.load(str(tmp_path / "dynamics.casadi"))
    assert np.allclose(np.asarray(dynamics(described["hover"]["x"], described["hover"]["u"])).ravel(), 0.0, atol=1e-10)


def test_the_description_carries_numbers_units_delays_and_range(found, tmp_path):
    export(from_fit(found), "json", tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model.json"]
    described = json.loads((tmp_path / "model.json").read_text())
    assert described["parameters"]["K"]["unit"] == "m/s^2"
    assert described["delays_s"]["throttle"] == pytest.approx(found.values["T_d_thrust"])
    assert described["delays_s"]["voltage_v"] == 0.0
    assert len(described["covariance"]["matrix"]) == len(described["covariance"]["order"])
    assert described["valid"]["speed_max_m_s"] > 1


@pytest.mark.skipif(COMPILER is None, reason="no C compiler: install gcc or clang")
def test_c_compiles_without_a_warning_and_agrees(found, tmp_path):
    export(from_fit(found), "c", tmp_path)
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-O1"]
    built = subprocess.run(
        [str(COMPILER), *flags, "-o", "example", "example.c", "flighttest_model.c", "-lm"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    assert built.stderr == ""
    ran = subprocess.run([str(tmp_path / "example")], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout
    worst = float(ran.stdout.rsplit(":", 1)[1])
    assert worst < 1e-10
