"""What an estimate must be like to be what its name says."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flighttest.diagnose.plausible import does_not_stand_out, impossible, never_reached
from made_rows import rows_of

from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model


def test_a_pure_pole_is_at_its_usual_value_and_not_at_a_bound():
    names, std = ("attitude_pole_share", "attitude_pole_tau"), np.array([0.1, 0.001])
    judged = Model(("linear_drag", "attitude_extra_pole")), names
    assert impossible("attitude_extra_pole", *judged, {names[0]: 1.0, names[1]: 0.05}, std) == ""
    assert "bound" in impossible("attitude_extra_pole", *judged, {names[0]: -2.0, names[1]: 0.05}, std)


def test_a_load_of_negative_mass_and_a_shape_at_its_bound_are_refused():
    model = Model(("linear_drag", "slung_payload", "quadratic_drag"))
    names = ("payload_ratio", "cable_m", "k_x", "k_y", "k_z")
    std = np.array([0.01, 0.1, 0.01, 0.01, 0.01])
    good = {"payload_ratio": 0.1, "cable_m": 1.0, "k_x": 0.02, "k_y": 0.02, "k_z": -0.005}
    assert impossible("slung_payload", model, names, good, std) == ""
    assert impossible("quadratic_drag", model, names, good, std) == ""  # one of three, by chance
    assert "does not allow" in impossible("slung_payload", model, names, good | {"payload_ratio": -0.03}, std)
    assert "bound" in impossible("slung_payload", model, names, good | {"cable_m": 15.0}, std)
    assert "does not allow" in impossible("quadratic_drag", model, names, good | {"k_z": -0.1}, std)


def test_a_load_of_no_weight_is_what_its_free_start_states_make_of_a_wander(rng):
    model, term = Model(("slung_payload",)), catalogue()["slung_payload"]
    names = ("payload_ratio",)
    column = rng.normal(size=(4000, 1))

    def refused(size):
        rows = replace(rows_of(rng.normal(size=4000), column * 100), names=names)  # a standard error of 0.00016
        return does_not_stand_out(term, model, names, {"payload_ratio": size}, rows, -500.0)

    assert "start states are free" in refused(0.003)
    assert refused(0.05) == ""


def test_a_wind_that_only_rises_is_refused():
    model, values = Model(("steady_wind",)), {"w_up": 0.5, "w_north": 1.0}
    assert "without the rest" in impossible("steady_wind", model, ("w_up",), values, np.array([0.01]))
    assert impossible("steady_wind", model, ("w_up", "w_north"), values, np.array([0.01, 0.01])) == ""


def test_a_size_within_its_error_is_believed_only_where_much_else_speaks_for_it(rng):
    model, names = Model(("steady_wind",)), ("w_north",)
    rows = replace(rows_of(rng.normal(size=4000), rng.normal(size=(4000, 1))), names=names)  # a standard error of 0.016
    asked = (catalogue()["steady_wind"], model, names)
    assert "stand out" in does_not_stand_out(*asked, {"w_north": 0.04}, rows, -30.0)
    assert does_not_stand_out(*asked, {"w_north": 0.1}, rows, -30.0) == ""
    assert does_not_stand_out(*asked, {"w_north": 0.04}, rows, -300.0) == ""


@pytest.mark.parametrize(
    ("term", "limit", "reached"),
    [
        ("motor_saturation", {"T_max": 0.45}, True),
        ("motor_saturation", {"T_max": 0.55}, False),
        # A step of 0.4 rad asks for 20 / (2 0.5) 0.4 = 8 rad/s.
        ("rate_limit", {"rate_max": 7.0}, True),
        ("rate_limit", {"rate_max": 9.0}, False),
        ("reference_shaping", {}, True),
    ],
)
def test_a_limit_that_nothing_went_beyond_is_none(term, limit, reached):
    t = np.linspace(0.0, 1.0, 21)
    roll = np.where(t < 0.5, 0.0, 0.4 * (1 - np.exp(-(t - 0.5) / 0.1)))
    references = {"roll_ref_rad": (np.array([0.0, 0.5]), np.array([0.0, 0.4])), "throttle": (t[:1], np.array([0.5]))}
    step = SimpleNamespace(t_s=t, y={"roll_rad": roll}, u=references)
    values = {"omega_phi": 20.0, "zeta_phi": 0.5, **limit}
    assert (never_reached(catalogue()[term], values, [step]) == "") is reached
