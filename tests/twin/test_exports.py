"""An identified model as a vehicle of other simulators, flown without them where that is possible."""

import ctypes
import importlib.util
import shutil
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from flighttest.cli.main import call
from flighttest.errors import InputError, ModelError
from flighttest.identify.models.export import functions
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.physics.model import Model
from flighttest.pipeline.identification import exporting
from flighttest.twin import fmu, rotorpy


def stored(*terms, **values):
    model = Model(("linear_drag", *terms))
    full = model.start({"T_d_attitude": 0.06, "T_d_yaw_rate": 0.05, "T_d_thrust": 0.0437, **values})
    parameters = {n: StoredParameter(full[n], model.param[n].unit, None) for n in model.names}
    return ModelFile(model, parameters, full, (), np.zeros((0, 0)), {}, {"mass_kg": 2.0}, path="model.yaml")


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_the_unit_steps_as_the_casadi_function_with_its_inputs_delayed(tmp_path):
    file = stored("thrust_fade", "reference_shaping")
    with zipfile.ZipFile(fmu.write_fmu(file, tmp_path)) as archive:
        archive.extractall(tmp_path)
    root = ElementTree.parse(tmp_path / "modelDescription.xml").getroot()
    ref = {v.get("name"): int(v.get("valueReference")) for v in root.iter("ScalarVariable")}
    assert "time_s" not in ref
    (library,) = (tmp_path / "binaries").rglob("flighttest_model.*")
    unit = ctypes.CDLL(str(library))
    unit.fmi2Instantiate.restype = ctypes.c_void_p
    assert unit.fmi2Instantiate(b"a", 1, b"another", b"", None, 0, 0) is None
    me = ctypes.c_void_p(unit.fmi2Instantiate(b"a", 1, root.get("guid").encode(), b"", None, 0, 0))
    unit.fmi2SetupExperiment(me, 0, ctypes.c_double(), ctypes.c_double(0.0), 0, ctypes.c_double())
    unit.fmi2EnterInitializationMode(me)
    unit.fmi2ExitInitializationMode(me)

    def array(names, values):
        return (ctypes.c_uint * len(names))(*(ref[n] for n in names)), (ctypes.c_double * len(values))(*values)

    system, step = file.model.system, functions(file)["step"]
    given = fmu.inputs_of(file)
    hover = dict(zip(system.inputs, fmu.hover_input(file).tolist(), strict=True))
    x = np.array(fmu.start_state(file))
    sent = {n: [(-1e9, hover[n])] for n in given}
    late = {n: max(file.delays_s.get(system.input_delay[n], 0.0), 0.0) for n in given}
    h = 0.02
    for k in range(100):
        now, end = k * h, k * h + h
        u = hover | {"roll_ref_rad": 0.3 * (k > 5), "yaw_rate_ref_rad_s": 0.5 * (k > 9)}
        u["throttle"] *= 1.2 if k > 20 else 1.0
        refs, values = array(given, [float(u[n]) for n in given])
        assert unit.fmi2SetReal(me, refs, ctypes.c_size_t(len(given)), values) == 0
        assert unit.fmi2DoStep(me, ctypes.c_double(now), ctypes.c_double(h), 0) == 0
        for n in given:
            if sent[n][-1][1] != u[n]:
                sent[n].append((now, float(u[n])))
        while now < end - 1e-12:
            until = min([e + late[n] for n in given for e, _ in sent[n] if e + late[n] > now + 1e-12] + [end])
            held = {n: [v for e, v in sent[n] if e + late[n] <= now + 1e-12][-1] for n in given}
            parts = max(int(np.ceil((until - now) / fmu.MOST_STEP_S - 1e-9)), 1)
            for i in range(parts):
                clock = {"time_s": now + (i + 0.5) * (until - now) / parts}
                x = np.asarray(step(x, [(held | clock)[n] for n in system.inputs], (until - now) / parts)).ravel()
            now = until
    seen = ["p_x_m", "p_y_m", "p_z_m", "v_x_m_s", "v_z_m_s", "yaw_rad"]
    refs, values = array(seen, [0.0] * len(seen))
    assert unit.fmi2GetReal(me, refs, ctypes.c_size_t(len(seen)), values) == 0
    assert list(values) == pytest.approx([x[list(system.states).index(n)] for n in seen], abs=1e-8)
    assert abs(values[3]) + abs(values[4]) > 0.5
    unit.fmi2FreeInstance(me)


def test_without_a_compiler_there_is_no_unit(tmp_path, monkeypatch):
    monkeypatch.setattr(fmu.shutil, "which", lambda _name: None)
    with pytest.raises(InputError, match="no C compiler is found"):
        fmu.write_fmu(stored(), tmp_path)


def test_rotorpys_commands_close_the_attitude_loops_as_identified(tmp_path):
    file = stored("rate_limit")
    path = rotorpy.write_vehicle(file, tmp_path)
    spec = importlib.util.spec_from_file_location("made", path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    assert made.quad_params["mass"] == 2.0
    assert isinstance(made.quad_params["rotor_pos"]["r1"], np.ndarray)
    commands, dt = made.Commands(made.IDENTIFIED | {"motor_s": 0.0, "spin_drag": [0.0] * 3}), 0.001
    half, w, inertia = np.zeros(3), np.zeros(3), np.array(made.IDENTIFIED["inertia_kg_m2"])
    rolls, thrusts = [], []
    for k in range(800):  # a rigid body that turns about one axis
        state = {"q": np.array([*np.sin(half / 2), np.cos(half[0] / 2)]), "w": w}
        asked = commands(k * dt, dt, state, 0.2 * (k > 0), 0.0, 0.0, 0.2)
        rolls.append(half[0])
        thrusts.append(asked["cmd_thrust"])
        w = w + dt * np.array([asked["cmd_moment"][0] / inertia[0], 0.0, 0.0])
        half = half + dt * w
    loop = made.IDENTIFIED
    damped = loop["omega_phi"] * np.sqrt(1 - loop["zeta_phi"] ** 2)
    t = np.arange(800) * dt - 0.06 - dt
    free = np.exp(-loop["zeta_phi"] * loop["omega_phi"] * t) * (
        np.cos(damped * t) + loop["zeta_phi"] / np.sqrt(1 - loop["zeta_phi"] ** 2) * np.sin(damped * t)
    )
    assert np.abs(np.array(rolls) - np.where(t > 0, 0.2 * (1 - free), 0.0)).max() < 0.004
    assert thrusts[-1] == pytest.approx(2.0 * loop["K"] * 0.2, rel=1e-6)


def test_what_a_simulator_cannot_hold_is_said_with_the_error_it_leaves(tmp_path):
    file = stored("rate_limit", rate_max=2.0)
    assert rotorpy.lacking(file) == ("rate_limit",)
    assert rotorpy.left_error(file)["attitude_rad"] > 0.1
    assert rotorpy.left_error(stored())["attitude_rad"] == rotorpy.STEPS_RAD
    assert 0.001 < rotorpy.left_error(stored())["velocity_m_s"] < 0.1
    assert (
        "RotorPy's vehicle has no rate_limit"
        in exporting.export(file, "rotorpy", tmp_path).data["left_out_sentences"][0]
    )
    with pytest.raises(ModelError, match="no attitude loops"):
        rotorpy.write_vehicle(replace(file, model=replace(file.model, attitude_loops=False)), tmp_path)


def test_a_target_that_is_not_known_is_a_usage_error(tmp_path, capsys):
    (tmp_path / "m.yaml").write_text("")
    assert call(["export", str(tmp_path / "m.yaml"), "--to", "gazebo"]) == 2
    assert "gazebo" in capsys.readouterr().err
