"""Logs of a Crazyflie: what its variables are called, and what its mixer makes of thrust and torque commands."""

import numpy as np
import pytest

from flighttest.logs import import_log
from flighttest.logs.tables.crazyflie import beyond_limits, crazyflie_map, mixed_commands
from flighttest.logs.tables.sheet import Sheet


def test_crazyflie_logs_are_known_without_a_map(shared_data):
    folder = shared_data / "propeller_damage"
    r = import_log(folder / "controller_data" / "normal_flight" / "E8_log00")
    assert r.provenance.losses == ()
    assert r.has("roll_ref_rad", "p_rad_s", "f_z_m_s2", "throttle", "p_x_m")
    assert np.median(r.channel("f_z_m_s2")[1]) == pytest.approx(9.81, abs=0.1)
    assert (
        3.3 < np.median(import_log(folder / "motor_data" / "normal_flight" / "E8_log00").channel("voltage_v")[1]) < 3.8
    )


def test_a_crazyflies_sensors_are_read_where_its_controller_was_not_logged():
    """controller_pid.c: r_roll = radians(gyro.x), r_pitch = -radians(gyro.y), r_yaw = radians(gyro.z), accelz = acc.z."""
    sensors, controller = ("gyro.x", "gyro.y", "gyro.z", "acc.z"), ("r_roll", "r_pitch", "r_yaw", "accelz")
    known = crazyflie_map(("timestamp", *sensors, "acc.x", "acc.y"))
    raw, filters = known.columns, known.filters_hz
    both = crazyflie_map((*sensors, *(f"controller.{n}" for n in controller))).columns
    for name, sensor, other in zip(("p_rad_s", "q_rad_s", "r_rad_s", "f_z_m_s2"), sensors, controller, strict=True):
        assert [raw[name].columns, both[name].columns] == [(sensor,), (f"controller.{other}",)]
    assert [raw["q_rad_s"].scale, both["q_rad_s"].scale] == pytest.approx([np.pi / 180.0, -1.0])
    assert filters == {"specific_force": 30.0, "rates": 80.0}  # sensors_bmi088_bmp388.c
    assert {raw[n].scale for n in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")} == {both["f_z_m_s2"].scale} == {9.80665}


def test_a_state_of_integers_and_the_geometric_controller_are_known():
    """stabilizer.c: mm, mm/s, ratePitch = -gyro.y in mrad/s; controller_lee.c: rad, rad/s, N."""
    state = tuple(f"stateEstimateZ.{n}" for n in ("x", "y", "z", "vx", "vy", "vz", "rateRoll", "ratePitch", "rateYaw"))
    lee = tuple(
        f"ctrlLee.{n}" for n in ("rpyx", "rpyy", "rpyz", "rpydx", "rpydy", "omegax", "omegay", "omegaz", "thrustSI")
    )
    known = crazyflie_map(("timestamp", *state)).columns
    assert [known[n].scale for n in ("p_z_m", "v_x_m_s", "p_rad_s", "q_rad_s", "r_rad_s")] == [
        1e-3,
        1e-3,
        1e-3,
        -1e-3,
        1e-3,
    ]
    both = crazyflie_map((*state, *lee)).columns
    for name in ("roll_rad", "pitch_rad", "yaw_rad", "roll_ref_rad", "pitch_ref_rad", "p_rad_s", "q_rad_s", "r_rad_s"):
        assert both[name].columns[0].startswith("ctrlLee.")
        assert both[name].scale == 1.0
    assert both["throttle"].columns == ("ctrlLee.thrustSI",)
    older = crazyflie_map((*state, "ctrlLee.thrustSi", "stateEstimate.pitch", "ctrlLee.rpyy")).columns
    assert older["throttle"].columns == ("ctrlLee.thrustSi",)
    assert older["pitch_rad"].columns == ("stateEstimate.pitch",)


@pytest.mark.parametrize(("share", "said"), [(0.005, False), (0.02, True)])
def test_a_motor_that_is_asked_for_more_than_it_has_is_said(share, said):
    roll = np.where(np.arange(1000) < 1000 * share, 30000.0, 0.0)
    raw = {f"controller.cmd_{axis}": np.zeros(2000) for axis in ("thrust", "roll", "pitch", "yaw")}
    raw["controller.cmd_thrust"][:1000] = 45000.0
    raw["controller.cmd_roll"][:1000], raw["controller.cmd_pitch"][:1000] = roll, -roll
    raw["controller.cmd_roll"][1000:] = 60000.0  # on the ground, with the motors off
    found = beyond_limits(Sheet("a", raw, crazyflie=True))
    assert bool(found) is said
    if said:
        assert found == [
            "motor 3 was asked for up to 1.14 of its range, for more than it has in 2 % of the flight: the thrust is less there than "
            "controller.cmd_thrust"
        ]
    del raw["controller.cmd_yaw"]
    assert beyond_limits(Sheet("a", raw, crazyflie=True)) == []


def test_motor_commands_follow_from_thrust_and_torques_within_what_a_motor_has():
    raw = {f"controller.cmd_{axis}": np.zeros(3) for axis in ("thrust", "roll", "pitch", "yaw")}
    raw["controller.cmd_thrust"][:2] = 0.6 * 65535
    raw["controller.cmd_roll"][1], raw["controller.cmd_yaw"][:] = 0.2 * 65535, 0.05 * 65535
    found = mixed_commands(Sheet("a", raw, crazyflie=True))
    np.testing.assert_allclose([found[f"motor_{k}"][0] for k in range(1, 5)], [0.65, 0.55, 0.65, 0.55])
    np.testing.assert_allclose([found[f"motor_{k}"][1] for k in range(1, 5)], [0.55, 0.45, 0.75, 0.65])
    assert all(m[2] == 0.0 for m in found.values()), "with the thrust off the motors are off"
    raw["controller.cmd_roll"][1] = 65535.0
    assert mixed_commands(Sheet("a", raw, crazyflie=True))["motor_3"][1] == 1.0
    del raw["controller.cmd_pitch"]
    assert mixed_commands(Sheet("a", raw, crazyflie=True)) == {}


def test_mixed_motor_commands_are_those_that_another_log_of_the_vehicle_recorded(shared_data):
    """Two undamaged flights of one plan, one with torque commands, one with motor commands: the motors share the load alike."""
    flown = [
        import_log(shared_data / "propeller_damage" / log / "normal_flight" / "E8_log00")
        for log in ("controller_data", "motor_data")
    ]
    assert "mixed" in flown[0].provenance.derived["motor_1"]
    assert "motor_1" not in flown[1].provenance.derived
    shares = []
    for r in flown:
        commands = np.array([r.channel(f"motor_{k}")[1] for k in range(1, 5)])
        mean = commands[:, commands.mean(axis=0) > 0.3].mean(axis=1)
        shares.append(mean / mean.mean())
    np.testing.assert_allclose(*shares, atol=0.015)
    assert np.ptp(shares[0]) > 0.15, "unlike enough that a wrong sign shows"
