"""Commands of a table that its vehicle did not answer: signs and directions that are not what the names say."""

import numpy as np
import pytest

from flighttest import read
from flighttest.frames import G_M_S2
from flighttest.logs.tables.commanded import misread_commands, sampled_throttle

T = np.arange(0.0, 60.0, 0.02)
REFERENCES = {"roll_ref_rad": "roll_rad", "pitch_ref_rad": "pitch_rad", "yaw_rate_ref_rad_s": "r_rad_s"}


def followed(asked, rng, delay_s=0.1, lag_s=0.1):
    """What a first-order lag makes of a command after a delay, disturbed."""
    did = np.zeros(T.size)
    late = round(delay_s / 0.02)
    for k in range(1, T.size):
        did[k] = did[k - 1] + 0.02 / lag_s * (asked[max(k - 1 - late, 0)] - did[k - 1])
    return did + rng.normal(0.0, 0.01, T.size)


def flown(seed=1, begins_s=0.0):
    """Attitude that follows its references, and thrust that follows its throttle from begins_s on; at rest with idle motors before."""
    rng = np.random.default_rng(seed)
    steps = {n: np.repeat(rng.choice([-0.3, 0.0, 0.3], 60), 50) for n in REFERENCES}
    table = dict(steps) | {REFERENCES[n]: followed(v, rng) for n, v in steps.items()}
    throttle = 0.4 + np.repeat(rng.choice([-0.1, 0.0, 0.1], 60), 50)
    thrust = followed(25.0 * throttle, rng)
    tilt = np.cos(table["roll_rad"]) * np.cos(table["pitch_rad"])
    waits = begins_s > T
    climbs = np.where(waits, 0.0, thrust * tilt - G_M_S2)
    speed = np.cumsum(climbs) * 0.02
    force = np.where(waits, G_M_S2, thrust) + rng.normal(0.0, 0.2, T.size)
    return table | {"throttle": np.where(waits, 0.0, throttle), "v_z_m_s": speed, "f_z_m_s2": force}


def test_what_the_vehicle_followed_is_not_reported():
    for table in (flown(), flown(begins_s=10.0)):
        assert misread_commands(T, table) == []
        assert misread_commands(T[::-1], {n: v[::-1] for n, v in table.items()}) == []


@pytest.mark.parametrize("name", list(REFERENCES))
@pytest.mark.parametrize(("factor", "said"), [(-1.0, "is -"), (57.3, "is 5"), (np.radians(1.0), "is 0.01")])
def test_a_reference_of_another_sign_or_unit_is_reported(name, factor, said):
    """pitch_ref_rad with its sign turned gave omega_theta 3.3 rad/s in place of 25 without a word."""
    table = flown()
    (line,) = misread_commands(T, table | {name: factor * table[name]})
    assert line.startswith(f"{name} {said}")
    assert REFERENCES[name] in line
    assert "column map" in line


def test_references_in_each_others_place_are_reported():
    table = flown()
    swapped = table | {"roll_ref_rad": table["pitch_ref_rad"], "pitch_ref_rad": table["roll_ref_rad"]}
    assert ["another order" in line for line in misread_commands(T, swapped)] == [True, True]


def test_an_attitude_that_turns_over_is_not_compared():
    """Roll jumps by a turn at the horizontal; a vehicle that lies on its back follows nothing."""
    table = flown()
    over = (T > 40.0) & (T < 58.0)
    fallen = table | {"roll_rad": np.where(over, 3.1, table["roll_rad"])}
    fallen["roll_ref_rad"] = np.where(over, -1.5, table["roll_ref_rad"])
    assert misread_commands(T, fallen) == []
    fallen["roll_ref_rad"] = np.where(over, 0.0, -table["roll_ref_rad"])
    assert any(line.startswith("roll_ref_rad is -") for line in misread_commands(T, fallen))


@pytest.mark.parametrize("left_out", [(), ("f_z_m_s2",)])
def test_a_throttle_that_falls_with_thrust_is_reported(left_out):
    table = {n: v for n, v in flown().items() if n not in left_out}
    (line,) = misread_commands(T, table | {"throttle": 1.0 - table["throttle"]})
    assert "throttle falls where" in line
    assert "scale: -1, offset: 1" in line


def test_what_only_mostly_rises_as_the_throttle_falls_is_not_reported():
    """Gusts and a pilot who catches a fall: the correlation is -0.6 in flights whose throttle is right."""
    table = flown()
    rough = np.repeat(np.random.default_rng(3).normal(0.0, 3.0, 120), 25)
    caught = table | {"f_z_m_s2": 2 * G_M_S2 - table["f_z_m_s2"] + rough}
    assert misread_commands(T, caught) == []


def test_full_throttle_at_rest_is_reported():
    """Most of a hover shows nothing of its throttle's direction, a stand before take-off does."""
    table = flown(begins_s=10.0) | {"f_z_m_s2": np.full(T.size, G_M_S2)}
    assert misread_commands(T, table) == []
    (line,) = misread_commands(T, table | {"throttle": 1.0 - table["throttle"]})
    assert "at rest" in line
    assert "10.0 s" in line
    assert "scale: -1, offset: 1" in line


def test_short_tables_and_constant_commands_say_nothing():
    table = flown()
    inverted = table | {"throttle": 1.0 - table["throttle"]}
    assert misread_commands(T[:200], {n: v[:200] for n, v in inverted.items()}) == []
    for begins_s in (0.0, 10.0):
        assert misread_commands(T, flown(begins_s=begins_s) | {"throttle": np.full(T.size, 1.0)}) == []
    assert misread_commands(T, table | {n: np.full(T.size, np.nan) for n in ("throttle", *REFERENCES)}) == []


def test_the_import_of_a_table_reports_them(tmp_path):
    table = flown(begins_s=10.0)
    table |= {"t_s": T, "throttle": 1.0 - table["throttle"], "pitch_ref_rad": -table["pitch_ref_rad"]}
    path = tmp_path / "flight.csv"
    rows = np.stack(list(table.values()), axis=1)
    np.savetxt(path, rows, fmt="%.6g", delimiter=",", header=",".join(table), comments="")
    said = "; ".join(read(path).provenance.losses)
    assert "throttle is 0.98 or more" in said
    assert "pitch_ref_rad is -" in said


def sampled_every(period_s):
    """A throttle that wanders, and what a table of 50 Hz holds of it where it was sampled so slowly and repeated; idle for 10 s."""
    rng = np.random.default_rng(3)
    at = np.arange(0.0, T[-1] + period_s, period_s)
    samples = 0.4 + 0.02 * np.cumsum(rng.normal(0.0, 1.0, at.size)) / np.sqrt(at.size)
    samples[(at > 20.0) & (at < 30.0)] = 0.0
    return at, samples, samples[np.searchsorted(at, T, side="right") - 1]


def test_a_throttle_that_was_measured_slowly_is_a_line_between_its_samples():
    """Rotor speeds by the telemetry of motor controllers, three a second in a table of 91 Hz, were cut into 54 throttle steps of a hover
    and 137 of a flight at speed; K was at its bound of 1 m/s^2."""
    at, samples, held = sampled_every(0.34)
    line, said = sampled_throttle(T, held)
    assert "every 0.34 s" in said
    assert "commands" in said
    flying = (T < 19.5) | ((T > 31.0) & (at[-2] > T))
    late = np.abs(np.interp(T, at, samples) - line)[flying]
    assert np.max(late) < np.max(np.abs(held - line)[flying])
    assert float(np.median(line[(T > 21.5) & (T < 29.0)])) == 0.0


def test_the_import_of_a_table_draws_that_line(tmp_path):
    held = sampled_every(0.34)[2]
    path = tmp_path / "flight.csv"
    rows = np.stack([T, held, np.zeros(T.size)], axis=1)
    np.savetxt(path, rows, delimiter=",", header="t_s,throttle,roll_rad", comments="")
    recording = read(path)
    assert any("repeated between" in loss for loss in recording.provenance.losses)
    t, throttle = recording.channel("throttle")
    np.testing.assert_allclose(throttle, np.interp(t, T, sampled_throttle(T, held)[0]), atol=1e-9)


@pytest.mark.parametrize("period_s", [0.02, 0.1, 1.0])
def test_a_throttle_that_was_commanded_is_held(period_s):
    assert sampled_throttle(T, sampled_every(period_s)[2]) is None


def test_a_few_values_at_an_even_pace_are_commands():
    assert sampled_throttle(T[:200], sampled_every(0.34)[2][:200]) is None


def test_a_throttle_that_is_new_at_uneven_times_is_held():
    rng = np.random.default_rng(5)
    at = np.cumsum(rng.uniform(0.1, 0.6, 300))
    held = rng.normal(0.4, 0.02, 301)[np.searchsorted(at, T, side="right")]
    assert sampled_throttle(T, held) is None
