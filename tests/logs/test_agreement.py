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
    made |= {
        f"{r}_rad_s": np.gradient(made[f"{a}_rad"], T) for r, a in zip("pqr", ("roll", "pitch", "yaw"), strict=True)
    }
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
