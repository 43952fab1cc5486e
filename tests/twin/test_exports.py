"""An identified model as a vehicle of other simulators, flown without them where that is possible."""

import ctypes
import importlib.util
import json
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
from flighttest.sim.sitl.launcher import SitlOptions, command
from flighttest.twin import ardupilot, fmu, rotorpy
from flighttest.twin.firmware import Axis, FirmwareFrame

QUADRATIC = {
    "omega_phi": 14.617, "omega_theta": 13.493, "zeta_phi": 0.61, "zeta_theta": 0.5675, "sigma_r": 6.186, "sigma_t": 15.77, "K": 51.58,
    "alpha": 1.619, "d_x": 0.314, "d_y": 0.307, "d_z": 0.4185, "k_x": 0.0515, "k_y": 0.049, "k_z": 0.0607,
    "T_d_attitude": 0.0638, "T_d_yaw_rate": 0.0639, "T_d_thrust": 0.0632,
}  # fmt: skip


def stored(*terms, **values):
    model = Model(("linear_drag", *terms))
    full = model.start({"T_d_attitude": 0.06, "T_d_yaw_rate": 0.05, "T_d_thrust": 0.0437, **values})
    parameters = {n: StoredParameter(full[n], model.param[n].unit, None) for n in model.names}
    return ModelFile(model, parameters, full, (), np.zeros((0, 0)), {}, {"mass_kg": 2.0}, path="model.yaml")


STEP_S, COUNT = 0.02, 100


def inputs_at(file, k):
    """Inputs of step k: a tilt, a turn and a climb."""
    hover = dict(zip(file.model.system.inputs, fmu.hover_input(file).tolist(), strict=True))
    u = hover | {"roll_ref_rad": 0.3 * (k > 5), "yaw_rate_ref_rad_s": 0.5 * (k > 9)}
    u["throttle"] *= 1.2 if k > 20 else 1.0
    return u


def stepped_by_casadi(file):
    """States after COUNT steps of STEP_S by the exported CasADi function, its inputs delayed here."""
    system, step, given = file.model.system, functions(file)["step"], fmu.inputs_of(file)
    hover = dict(zip(system.inputs, fmu.hover_input(file).tolist(), strict=True))
    x = np.array(fmu.start_state(file))
    sent = {n: [(-1e9, hover[n])] for n in given}
    late = {n: max(file.delays_s.get(system.input_delay[n], 0.0), 0.0) for n in given}
    for k in range(COUNT):
        now, end, u = k * STEP_S, k * STEP_S + STEP_S, inputs_at(file, k)
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
    return dict(zip(system.states, x.tolist(), strict=True))


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

    given = fmu.inputs_of(file)
    for k in range(COUNT):
        u = inputs_at(file, k)
        refs, values = array(given, [float(u[n]) for n in given])
        assert unit.fmi2SetReal(me, refs, ctypes.c_size_t(len(given)), values) == 0
        assert unit.fmi2DoStep(me, ctypes.c_double(k * STEP_S), ctypes.c_double(STEP_S), 0) == 0
    seen = ["p_x_m", "p_y_m", "p_z_m", "v_x_m_s", "v_z_m_s", "yaw_rad"]
    refs, values = array(seen, [0.0] * len(seen))
    assert unit.fmi2GetReal(me, refs, ctypes.c_size_t(len(seen)), values) == 0
    expected = stepped_by_casadi(file)
    assert list(values) == pytest.approx([expected[n] for n in seen], abs=1e-8)
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
    # A vehicle with these parameters, flown in RotorPy 3.0 on the test maneuver, was up to 0.073 m/s from the model's own simulation.
    flown = stored("quadratic_drag", **QUADRATIC)
    assert 0.073 < rotorpy.left_error(flown)["velocity_m_s"] < 0.085
    assert "whole airflow" in exporting.export(flown, "rotorpy", tmp_path).data["left_out_sentences"][2]
    with pytest.raises(ModelError, match="no attitude loops"):
        rotorpy.write_vehicle(replace(file, model=replace(file.model, attitude_loops=False)), tmp_path)


def test_a_target_that_is_not_known_is_a_usage_error(tmp_path, capsys):
    (tmp_path / "m.yaml").write_text("")
    assert call(["export", str(tmp_path / "m.yaml"), "--to", "gazebo"]) == 2
    assert "gazebo" in capsys.readouterr().err


def test_ardupilots_frame_has_the_models_hover_drag_and_moments(tmp_path):
    file = stored("quadratic_drag", "ground_effect", alpha=1.6, d_x=0.4, d_y=0.4, k_x=0.05, k_y=0.05, w_north=3.0)
    file = replace(file, valid={"voltage_v": [21.0, 24.0]})
    (frame, parameters), made = ardupilot.write_frame(file, tmp_path)
    f = json.loads(frame.read_text())
    weight = 2.0 * 9.81
    # SIM_Frame.cpp and SIM_Motor.cpp: thrust, drag at the reference speed, and what a full output turns
    at_middle = 9.81 / (file.values["K"] * (22.5 / 22.2) ** 1.6)
    assert at_middle * weight / f["hoverThrOut"] / weight * (22.5 / f["maxVoltage"]) ** 2 == pytest.approx(
        1.0, rel=1e-6
    )
    lean, speed = np.radians(f["refAngle"]), f["refSpd"]
    momentum = (
        np.cos(lean) * f["mdrag_coef"] * speed * np.cos(lean) * np.sqrt(weight / np.cos(lean) * 1.225 * f["disc_area"])
    )
    area = (weight * np.tan(lean) - momentum) / (0.5 * 1.225 * speed**2)
    assert 0.5 * 1.225 * area / 2.0 == pytest.approx(0.05, rel=1e-6)
    assert f["mdrag_coef"] * np.sqrt(1.225 * f["disc_area"] * weight) / 2.0 == pytest.approx(0.4, rel=1e-6)
    full = weight / f["hoverThrOut"] * (22.5 / f["maxVoltage"]) ** 2 * 0.5 * np.sqrt(0.5) * f["diagonal_size"]
    gain = made.loops.axes["roll"].gain * (22.5 / 22.2) ** 1.6  # of the motors in the middle of the voltages
    assert full / f["moment_inertia"][0] == pytest.approx(gain, rel=1e-6)
    # The rotors' drag brakes a yaw rate by less than 2 % of the speed of a yaw rate loop (6 1/s).
    assert 0.4 * f["mass"] * f["diagonal_size"] ** 2 / f["moment_inertia"][2] < 0.02 * 6.0
    lines = dict(line.split() for line in parameters.read_text().splitlines())
    late = 1.0 / file.values["sigma_t"] + max(
        0.0437 - made.loops.link_delay_s, 0.0
    )  # of which the firmware itself makes 10 ms
    assert float(lines["PILOT_THR_FILT"]) == pytest.approx(1.0 / (2 * np.pi * (late - 0.010)), rel=1e-5)
    assert made.lacking == ("ground_effect",)
    assert made.thrust_share == pytest.approx((22.5 / 21.0) ** -0.4 - 1.0, abs=0.06)
    assert 0.01 < made.velocity_m_s < 0.5


def test_ardupilots_frame_lacks_the_moments_of_the_air_and_no_loop_of_the_firmware():
    assert ardupilot.not_in_frame(stored("airflow_moment", "rate_limit")) == ("airflow_moment",)


def test_what_ardupilots_frame_is_of_the_model_is_stated_with_what_it_differs_by():
    file = replace(stored("quadratic_drag", "ground_effect", **QUADRATIC), valid={"voltage_v": [21.0, 25.0]})
    made = ardupilot.exported(file)
    model, values = ardupilot.frame_model(file, made.loops)
    assert not {"ground_effect", "linear_drag", "quadratic_drag"} & {*model.terms}
    assert values["K"] * (23.0 / 22.2) ** 2 == pytest.approx(file.values["K"] * (23.0 / 22.2) ** file.values["alpha"])
    # The filter and the firmware's delay are together as late as the model's lag and delay.
    late = [1.0 / v["sigma_t"] + v["T_d_thrust"] for v in (values, file.values)]
    assert late[0] == pytest.approx(late[1], abs=1e-9)
    assert values["T_d_thrust"] == pytest.approx(
        min(made.loops.link_delay_s, 0.0632) + ardupilot.FIRMWARE_THRUST_DELAY_S
    )
    # Drag goes with the root of the thrust, and thrust with the square of the voltage.
    assert 0.1 < made.force_m_s2 < 1.5
    assert 0.01 < made.velocity_m_s < 0.5
    # A frame's moment of yaw in hover has no voltage in it, the vehicle's goes with its thrust.
    assert made.yaw_share > 2.0 * made.loops.axes["yaw"].error
    assert ardupilot.TILT_SHARE < made.tilt_share < 0.5 * made.yaw_share


def test_ardupilots_wind_comes_from_where_the_models_air_does_not_go():
    assert ardupilot.sim_wind(stored("steady_wind", w_north=3.0))["SIM_WIND_DIR"] == pytest.approx(180.0)
    west = ardupilot.sim_wind(stored("steady_wind", w_west=2.0))
    assert (west["SIM_WIND_DIR"], west["SIM_WIND_SPD"]) == pytest.approx((90.0, 2.0))
    assert ardupilot.sim_wind(stored()) == {}


def test_an_export_to_ardupilot_says_what_it_lacks_and_how_it_flies(tmp_path, capsys, monkeypatch):
    file = stored("ground_effect")
    axes = {n: Axis(400.0, 0.001, 0.05, 0.01, {}) for n in ("roll", "pitch", "yaw")}
    monkeypatch.setattr(ardupilot, "step_error", lambda *_args: 0.01)
    monkeypatch.setattr(ardupilot, "frame_of", lambda *_args, **_more: FirmwareFrame(axes, {}, (), ()))
    said = exporting.export(file, "ardupilot", tmp_path).data["left_out_sentences"]
    assert said[0] == "ArduPilot's frame has no ground_effect"
    assert "off over the voltages" in said[1]
    doubtful = {**file.parameters, "alpha": replace(file.parameters["alpha"], identifiable=False)}
    doubted = exporting.export(replace(file, parameters=doubtful), "ardupilot", tmp_path / "doubted")
    assert "not known (alpha)" in doubted.data["left_out_sentences"][1]
    assert said[-1] == f"fly it: flighttest sim --backend sitl --frame {tmp_path}"
    with pytest.raises(ModelError, match="no attitude loops"):
        ardupilot.write_frame(replace(file, model=replace(file.model, attitude_loops=False)), tmp_path)
    assert call(["sim", "--frame", str(tmp_path)]) == 2
    assert "give --frame DIR with --backend sitl" in capsys.readouterr().err
    empty = tmp_path / "empty"
    empty.mkdir()
    assert call(["sim", "--backend", "sitl", "--frame", str(empty)]) == 2
    assert "holds no vehicle.json" in capsys.readouterr().err


def test_an_exported_frame_flies_instead_of_an_airframe(tmp_path):
    made = tmp_path / "made"
    made.mkdir()
    for name in ("vehicle.json", "vehicle.parm"):
        (made / name).write_text("")
    words = command(SitlOptions(frame=made), tmp_path / "arducopter", 17000, tmp_path)
    assert words[words.index("--model") + 1] == "x:vehicle.json"
    assert words[words.index("--defaults") + 1].endswith(f"copter.parm,{made}/vehicle.parm")
    assert (tmp_path / "vehicle.json").is_file()
