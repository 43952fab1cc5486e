"""Exports in the programs that they are for, where these are installed (`pip install fmpy rotorpy`)."""

import importlib.util
import shutil

import numpy as np
import pytest

from flighttest.twin import fmu, rotorpy
from tests.twin.test_exports import COUNT, QUADRATIC, STEP_S, inputs_at, stepped_by_casadi, stored


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_the_unit_passes_fmpys_checks_and_is_the_casadi_function(tmp_path):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    validation = pytest.importorskip("fmpy.validation")
    fmi2 = pytest.importorskip("fmpy.fmi2")
    file = stored("quadratic_drag", "reference_shaping", **QUADRATIC)
    path = str(fmu.write_fmu(file, tmp_path))
    assert validation.validate_fmu(path) == []
    described = fmpy.read_model_description(path)
    ref = {v.name: v.valueReference for v in described.modelVariables}
    unit = fmi2.FMU2Slave(
        guid=described.guid, unzipDirectory=fmpy.extract(path, str(tmp_path / "unit")),
        modelIdentifier=described.coSimulation.modelIdentifier, instanceName="a",
    )  # fmt: skip
    unit.instantiate()
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    given = fmu.inputs_of(file)
    for k in range(COUNT):
        u = inputs_at(file, k)
        unit.setReal([ref[n] for n in given], [float(u[n]) for n in given])
        unit.doStep(currentCommunicationPoint=k * STEP_S, communicationStepSize=STEP_S)
    seen = ["p_x_m", "p_y_m", "p_z_m", "v_x_m_s", "v_y_m_s", "v_z_m_s", "yaw_rad"]
    values = unit.getReal([ref[n] for n in seen])
    unit.terminate()
    unit.freeInstance()
    expected = stepped_by_casadi(file)
    assert values == pytest.approx([expected[n] for n in seen], abs=1e-8)
    assert abs(expected["v_y_m_s"]) > 0.5
    assert len(fmpy.simulate_fmu(path, stop_time=1.0)) > 1


def test_a_vehicle_in_rotorpy_flies_within_the_stated_error(tmp_path):
    pytest.importorskip("rotorpy", reason="RotorPy is not installed")
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor")
    file = stored("quadratic_drag", **QUADRATIC)
    spec = importlib.util.spec_from_file_location("made", rotorpy.write_vehicle(file, tmp_path))
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    nominal_v, dt = file.model.nominal_voltage_v, 0.002
    edges = rotorpy.maneuver(float(file.model.hover_throttle(file.values, nominal_v)))
    state = {
        "x": np.array([0.0, 0.0, 5.0]), "v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3), "wind": np.zeros(3),
        "rotor_speeds": np.full(4, np.sqrt(file.model.g_m_s2 * made.quad_params["mass"] / 4.0 / made.quad_params["k_eta"])),
    }  # fmt: skip
    vehicle = multirotor.Multirotor(made.quad_params, initial_state=state, control_abstraction="cmd_ctbm")
    commands, states = made.Commands(made.IDENTIFIED), []
    names = ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle")
    for k in range(round(3.0 / dt) + 1):
        states.append((*state["v"], *made.euler(state["q"])))
        u = [edges[n][1][np.searchsorted(edges[n][0], k * dt + 1e-9, side="right") - 1] for n in names]
        state = vehicle.step(state, commands(k * dt, dt, state, *u, nominal_v), dt)
    own = rotorpy.test_maneuver(file.model, file.values, nominal_v)
    off = np.array(states)[::5] - np.stack(
        [own[n] for n in ("v_x_m_s", "v_y_m_s", "v_z_m_s", "roll_rad", "pitch_rad")], axis=-1
    )
    stated, most = rotorpy.left_error(file), np.abs(off).max(axis=0)
    assert 0.5 * stated["velocity_m_s"] < most[:3].max() < stated["velocity_m_s"]
    assert most[3:].max() < stated["attitude_rad"]
