"""What a model takes from the declaration of its vehicle."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.physics.model import Model
from flighttest.pipeline.identification.fitting import base_model
from flighttest.recording import Provenance, Recording, Series
from flighttest.vehicle.model import Vehicle


def recorded(**vehicle):
    return Recording("r", {}, (), Provenance("", "table", vehicle=vehicle))


def test_the_vehicle_file_comes_before_the_recordings_and_these_before_the_usual():
    declared = Vehicle("v", None, "ardupilot", 14.8, 0.3, rotor_height_m=0.5)
    kept = [recorded(), recorded(nominal_voltage_v=25.2, rotor_height_m=0.0), recorded(rotor_height_m=0.3)]
    assert base_model(kept, declared) == Model(nominal_voltage_v=14.8, rotor_height_m=0.5)
    assert base_model(kept, None) == Model(nominal_voltage_v=25.2, rotor_height_m=0.0)
    assert base_model([recorded(nominal_voltage_v="?")], None) == Model()
    assert base_model([], Vehicle("v", None, "ardupilot", 22.2, 0.3)) == Model(), "the usual is one and the same"
    assert base_model([], None, ["ground_effect"]).terms == ("body", "linear_drag", "ground_effect")


@pytest.mark.parametrize(
    ("highest_v", "nominal_v"), [(4.1, 3.7), (12.6, 11.1), (16.75, 14.8), (21.5, 22.2), (25.2, 22.2), (0.3, 22.2)]
)
def test_without_a_stated_nominal_voltage_it_is_that_of_the_recorded_battery(highest_v, nominal_v):
    """At 22.2 V the gain of a single cell is bound up with the exponent: fits of three hops ended between 92 and 605 m/s^2 for 14."""
    volts = np.linspace(0.8 * highest_v, highest_v, 50)
    read = replace(recorded(), series={"battery": Series(np.arange(50.0), {"voltage_v": volts})})
    assert base_model([read], None).nominal_voltage_v == pytest.approx(nominal_v)
    assert base_model([read], None, model=Model(nominal_voltage_v=7.4)).nominal_voltage_v == 7.4
    assert base_model([read, recorded(nominal_voltage_v=25.2)], None).nominal_voltage_v == 25.2


@pytest.mark.parametrize("rotor_height_m", [0.0, 0.4])
def test_ground_effect_counts_its_height_from_the_rotors(rotor_height_m):
    model = Model(("ground_effect",), rotor_height_m=rotor_height_m)
    assert model.constants["rotor_height_m"] == rotor_height_m
    values = model.start({"R2_m2": 0.16})
    system = model.system
    state = {"p_z_m": 0.8 - rotor_height_m, "a_t_m_s2": 9.0}
    x = [state.get(n, 0.0) for n in system.states]
    u = [{"voltage_v": 22.2}.get(n, 0.0) for n in system.inputs]
    x_dot, _ = system.function(x, u, [values[n] for n in model.names])
    up = float(x_dot[list(system.states).index("v_z_m_s")])
    assert up == pytest.approx(9.0 * 64 / 63 - model.g_m_s2, rel=1e-3), "R = 0.4 m, rotors 0.8 m above the ground"
