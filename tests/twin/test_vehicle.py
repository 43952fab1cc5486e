"""The vehicle of a model: its plant is the model, its noise the fit's residuals, and a model that cannot fly is refused."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import ModelError
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.model import Model
from flighttest.physics.simulate import simulate
from flighttest.sim.build import build_plant, build_vehicle
from flighttest.sim.options import SimOptions
from flighttest.sim.plants.plant import Command
from flighttest.twin.vehicle import simulator_options

NOISE = {
    "roll_rad": 0.004,
    "pitch_rad": 0.004,
    "r_rad_s": 0.01,
    "v_x_m_s": 0.05,
    "v_y_m_s": 0.05,
    "v_z_m_s": 0.05,
    "f_z_m_s2": 0.2,
}
QUADRATIC = {p.name: 0.05 for t in Model(("quadratic_drag",)).built_terms for p in t.params}


def stored(terms=("linear_drag", "quadratic_drag"), **values):
    model = Model(terms)
    full = model.start({"omega_phi": 12.0, "K": 40.0, "T_d_thrust": 0.05, **values})
    valid = {"voltage_v": [21.0, 24.0]}
    return ModelFile(model, {}, full, (), np.zeros((0, 0)), valid, noise={"channels": NOISE}, path="model.yaml")


def test_the_plant_moves_as_the_model_is_simulated():
    file = stored(**QUADRATIC)
    plant = build_plant(SimOptions.from_json(simulator_options(file).to_json()))
    hover = plant.hover_throttle
    while plant.motion.on_ground or plant.motion.pz < 2.0:
        plant.advance(0.005, Command(throttle=1.2 * hover, spinning=True))
    start = plant.states
    volts = []
    for _ in range(160):
        volts.append(plant.motion.voltage)
        plant.advance(0.005, Command(0.3, -0.2, 0.5, hover, spinning=True))
    t = 0.005 * np.arange(161)
    held = {"roll_ref_rad": 0.3, "pitch_ref_rad": -0.2, "yaw_rate_ref_rad_s": 0.5, "throttle": hover}
    references = {n: (np.array([-1.0]), np.array([v])) for n, v in held.items()}
    without_delay = file.values | {n: 0.0 for n in file.values if n.startswith("T_d")}
    made = simulate(file.model, without_delay, t, start, references, {"voltage_v": (t, np.array([*volts, volts[-1]]))})
    m = plant.motion
    assert (m.roll, m.pitch, m.yaw) == pytest.approx(
        [made[n][-1] for n in ("roll_rad", "pitch_rad", "yaw_rad")], abs=1e-6
    )
    assert (m.vx, m.vy, m.vz) == pytest.approx([made[f"v_{a}_m_s"][-1] for a in "xyz"], abs=2e-3)
    assert plant.delays.thrust_s == 0.05


def test_its_instruments_are_as_noisy_as_the_residuals_of_the_fit():
    vehicle = build_vehicle(simulator_options(stored(), seed=4))
    rolls, forces = [], []
    for _ in range(12000):
        vehicle.tick()
        forces.append(vehicle.sensors.accel.z)
        if vehicle.ticks % 400 == 0:
            rolls.append(vehicle.sensors.attitude(vehicle.time_s)[0])
    assert np.std(forces[400:]) == pytest.approx(NOISE["f_z_m_s2"], rel=0.1)
    assert np.std(rolls) == pytest.approx(NOISE["roll_rad"], rel=0.5)


def test_a_model_without_attitude_loops_cannot_fly():
    file = stored()
    blind = replace(file, model=replace(file.model, attitude_loops=False))
    with pytest.raises(ModelError, match=r"model.yaml: the model has no attitude loops"):
        simulator_options(blind)
