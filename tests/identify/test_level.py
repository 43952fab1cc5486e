"""Recordings without measured roll and pitch: level flight is assumed where nothing recorded contradicts it, and the fit notes it."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import FitError
from flighttest.estimation.level import taken_as_level, tilt_rad
from flighttest.identify.fit import fit
from flighttest.physics.model import Model
from flighttest.pipeline.identification.fitting import fit as fitted
from tests.identify.test_optima import climbed


def blind(**more):
    """A flight up and down of which roll and pitch were not recorded, with further channels by name: functions of t (n,)."""
    found = []
    for s in climbed(0.0):
        y = {c: v for c, v in s.y.items() if c not in ("roll_rad", "pitch_rad")}
        y["v_x_m_s"] = 0.05 * np.sin(2.0 * s.t_s)
        found.append(replace(s, y=y | {name: made(s.t_s) for name, made in more.items()}))
    return found


@pytest.mark.slow
def test_level_flight_is_assumed_and_the_doubt_stated():
    seen = fit(climbed(0.0), Model(attitude_loops=False))
    found = fit(blind(), Model(attitude_loops=False))
    assert found.values["K"] == pytest.approx(seen.values["K"], rel=0.01)
    assert any("taken as level" in note and "K is not known better than to" in note for note in found.notes)
    assert found.estimates["K"].std > seen.estimates["K"].std
    assert not found.estimates["d_x"].identifiable


@pytest.mark.slow
def test_of_half_an_attitude_nothing_horizontal_moves_the_vertical():
    """Recorded roll alone turned lateral motion, which is not compared, into a climb: lateral drag and disturbances took up its errors."""
    rolling = fit(blind(roll_rad=lambda t: 0.1 * np.sin(3.0 * t)), Model(attitude_loops=False))
    level = fit(blind(), Model(attitude_loops=False))
    assert rolling.solution.insensitive == level.solution.insensitive
    assert {"d_x", "d_y"} <= set(rolling.solution.insensitive)
    assert rolling.values["K"] == pytest.approx(level.values["K"], rel=1e-6)


@pytest.mark.parametrize(
    "says",
    [
        {"v_x_m_s": lambda t: 3.0 * np.sin(2.0 * t)},
        {"a_y_m_s2": lambda t: 3.0 * np.ones(t.size)},
        {"pitch_rad": lambda t: 0.3 * np.sin(3.0 * t)},
    ],
)
def test_what_contradicts_level_flight_is_one_clear_error(says):
    with pytest.raises(FitError, match="neither of measured roll and pitch nor level"):
        fit(blind(**says), Model(attitude_loops=False))


def test_references_and_positions_contradict_it_too():
    s = blind()[0]
    assert taken_as_level(s)
    asked = (s.t_s[:1] - 1.0, np.array([0.25]))
    assert not taken_as_level(replace(s, u={**s.u, "roll_ref_rad": asked}))
    rng = np.random.default_rng(0)
    y = {c: v for c, v in s.y.items() if not c.startswith("v_")}
    circle = 2.0 * np.sin(1.5 * s.t_s) + 0.001 * rng.standard_normal(s.t_s.size)
    assert tilt_rad(replace(s, y=y | {"p_x_m": circle})) == pytest.approx(2.0 * 1.5**2 / 9.81 / np.sqrt(2), rel=0.5)


def test_a_differentiated_position_is_no_tilt():
    rng = np.random.default_rng(0)
    s = blind()[0]
    noisy = replace(s, y=s.y | {"v_x_m_s": 0.08 * rng.standard_normal(s.t_s.size)})
    assert taken_as_level(noisy)


@pytest.mark.slow
def test_the_crazyflies_of_a_damaged_propeller_are_fitted(shared_data):
    folder = shared_data / "propeller_damage" / "motor_data" / "normal_flight"
    found = fitted([folder / "E9_log00"]).value
    assert any("6 of 6 segments are taken as level" in note for note in found.notes)
