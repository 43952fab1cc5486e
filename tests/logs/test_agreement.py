"""Columns that contradict each other: units and frames that are not what the names say."""

import numpy as np
import pytest

from flighttest.frames import G_M_S2, rotation_from_euler
from flighttest.logs.tables.agreement import disagreements

T = np.arange(0.0, 60.0, 0.02)


def flown(rng):
    """A vehicle that sways and climbs, seen by noisy sensors; every channel the derivative of the one it belongs to."""
    roll, pitch, yaw = 0.2 * np.sin(1.3 * T), 0.15 * np.sin(0.9 * T + 1.0), 0.3 * np.sin(0.4 * T)
    rotation = rotation_from_euler(np.stack([roll, pitch, yaw], axis=1))
    thrust = G_M_S2 + 1.5 * np.sin(0.7 * T)
    world = rotation[:, :, 2] * thrust[:, None] - [0.0, 0.0, G_M_S2]
    velocity = np.cumsum(world, axis=0) * 0.02
    position = np.cumsum(velocity, axis=0) * 0.02
    made = {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw}
    turning = np.einsum("nji,njk->nik", rotation, np.gradient(rotation, T, axis=0))
    made |= {"p_rad_s": turning[:, 2, 1], "q_rad_s": turning[:, 0, 2], "r_rad_s": turning[:, 1, 0]}
    made |= {"f_x_m_s2": 0 * T, "f_y_m_s2": 0 * T, "f_z_m_s2": thrust}
    made |= {f"v_{a}_m_s": velocity[:, k] for k, a in enumerate("xyz")}
    made |= {f"p_{a}_m": position[:, k] for k, a in enumerate("xyz")}
    noise = {"rad_s": 0.01, "m_s2": 0.1, "m_s": 0.005, "rad": 0.001, "m": 0.02}
    unit = {n: next(v for u, v in noise.items() if n.endswith(f"_{u}")) for n in made}
    return {n: v + rng.normal(0.0, unit[n], T.size) for n, v in made.items()}


def test_a_flight_in_the_units_of_its_names_agrees():
    assert disagreements(T, flown(np.random.default_rng(1))) == []


@pytest.mark.parametrize(
    ("names", "factor", "said"),
    [
        (("p_rad_s", "q_rad_s", "r_rad_s"), 57.3, "p_rad_s is 57"),
        (("v_x_m_s", "v_y_m_s", "v_z_m_s"), 100.0, "v_x_m_s is"),
        (("v_z_m_s",), -1.0, "v_z_m_s is -"),
        (("pitch_rad", "q_rad_s"), -1.0, "the forward acceleration of v_x_m_s and v_y_m_s is -"),
        (("f_x_m_s2", "f_y_m_s2", "f_z_m_s2"), -1.0, "what attitude and specific force make of it"),
    ],
)
def test_another_unit_or_sign_is_reported(names, factor, said):
    table = flown(np.random.default_rng(2))
    table |= {n: table[n] * factor for n in names}
    assert any(said in line and "column map" in line for line in disagreements(T, table))


FORCE = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")
VELOCITY = ("v_x_m_s", "v_y_m_s", "v_z_m_s")


@pytest.mark.parametrize("left_out", [FORCE, (*FORCE, *VELOCITY)])
def test_tilt_and_motion_of_two_frames_are_reported_without_an_accelerometer(left_out):
    """A table of NED and FRD, declared as NWU and FLU, was imported without a word, and fitted: K 1 m/s^2, drag 5 1/s."""
    table = {n: v for n, v in flown(np.random.default_rng(6)).items() if n not in left_out}
    for n in ("p_x_m", "p_y_m", "p_z_m"):
        table[n] = np.convolve(
            table[n], np.ones(25) / 25, mode="same"
        )  # motion capture: twice differentiated, noise is all
        table[n][[*range(50), *range(-50, 0)]] = np.nan
    assert disagreements(T, table) == []
    other = ("v_y_m_s", "v_z_m_s", "p_y_m", "p_z_m", "pitch_rad", "yaw_rad", "q_rad_s", "r_rad_s")
    turned = table | {n: -table[n] for n in other if n in table}
    said = disagreements(T, turned)
    assert any("forward acceleration" in line and "is -" in line and "column map" in line for line in said)


@pytest.mark.parametrize(("first", "second"), [("v_x_m_s", "v_y_m_s"), ("q_rad_s", "r_rad_s"), ("p_rad_s", "q_rad_s")])
def test_two_axes_in_each_others_place_are_reported(first, second):
    table = flown(np.random.default_rng(7))
    swapped = table | {first: table[second], second: table[first]}
    said = disagreements(T, swapped)
    assert any(line.startswith(first) and "another order" in line and "column map" in line for line in said)
    assert any(line.startswith(second) and "another order" in line for line in said)


def test_a_quaternion_in_another_order_is_reported():
    from scipy.spatial.transform import Rotation

    table = flown(np.random.default_rng(8))
    turns = Rotation.from_euler("ZYX", np.stack([table[n] for n in ("yaw_rad", "pitch_rad", "roll_rad")], axis=1))
    x, y, z, w = turns.as_quat().T
    yaw, pitch, roll = Rotation.from_quat(np.stack([y, z, w, x], axis=1)).as_euler("ZYX").T
    said = disagreements(T, table | {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw})
    assert any("another order" in line for line in said)


def test_axes_that_move_together_are_not_taken_for_each_other():
    """Along a diagonal line each velocity goes with the other's position, too."""
    rng = np.random.default_rng(9)
    line = np.sin(0.5 * T)
    table = {"p_x_m": line, "p_y_m": 0.8 * line + 0.15 * np.sin(1.1 * T)}
    table |= {"v_x_m_s": np.gradient(line, T), "v_y_m_s": np.gradient(table["p_y_m"], T)}
    for noise in (0.0, 0.5, 1.0, 2.0):
        noisy = table | {n: table[n] + rng.normal(0.0, noise, T.size) for n in ("v_x_m_s", "v_y_m_s")}
        assert disagreements(T, noisy) == []


def turning(rng):
    """A flight that turns by 2 rad/s meanwhile: rates go with no rate of an angle in another unit."""
    yaw = 2.0 * T
    roll, pitch = 0.2 * np.sin(1.3 * T), 0.15 * np.sin(0.9 * T + 1.0)
    rotation = rotation_from_euler(np.stack([roll, pitch, yaw], axis=1))
    turns = np.einsum("nji,njk->nik", rotation, np.gradient(rotation, T, axis=0))
    table = {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": np.angle(np.exp(1j * yaw))}
    table |= {"p_rad_s": turns[:, 2, 1], "q_rad_s": turns[:, 0, 2], "r_rad_s": turns[:, 1, 0]}
    return {n: v + rng.normal(0.0, 1e-3, T.size) for n, v in table.items()}


@pytest.mark.parametrize(("factor", "said"), [(np.radians(1.0), "in radians, taken for"), (57.3, "in degrees, taken")])
def test_an_attitude_in_another_unit_is_reported_where_it_goes_with_nothing(factor, said):
    """Of an octocopter's flight whose attitude was in radians and declared as degrees nothing was said: with p and q in other axes
    than the angles' the correlation was 0.7, and the ratio of 57 was not looked at."""
    table = turning(np.random.default_rng(10))
    assert disagreements(T, table) == []
    angles = ("roll_rad", "pitch_rad", "yaw_rad")
    (line,) = disagreements(T, table | {n: factor * table[n] for n in angles})
    assert said in line
    assert "p_rad_s" in line
    assert "column map" in line
    rates = ("p_rad_s", "q_rad_s", "r_rad_s")
    noise = np.random.default_rng(11)
    rough = {n: noise.normal(0.0, 1.0, T.size) for n in rates}
    assert disagreements(T, table | rough) == []
    one_alone = table | rough | {"p_rad_s": table["p_rad_s"]}
    assert disagreements(T, one_alone | {n: factor * table[n] for n in angles}) == []


def test_what_hardly_moves_or_is_hardly_there_says_nothing():
    rng = np.random.default_rng(3)
    still = {n: rng.normal(0.0, 0.01, T.size) for n in flown(rng)}
    assert disagreements(T, still | {"f_z_m_s2": G_M_S2 + still["f_z_m_s2"]}) == []
    few = {n: np.where(np.arange(T.size) < 50, v, np.nan) for n, v in flown(rng).items()}
    assert disagreements(T, few | {"v_z_m_s": -few["v_z_m_s"]}) == []


def test_rows_in_any_order_say_the_same():
    table = flown(np.random.default_rng(4)) | {"v_z_m_s": -flown(np.random.default_rng(4))["v_z_m_s"]}
    mixed = np.random.default_rng(5).permutation(T.size)
    assert disagreements(T[mixed], {n: v[mixed] for n, v in table.items()}) == disagreements(T, table) != []
