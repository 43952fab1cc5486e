"""The facade against what design and a real SITL say of ArduCopter: modes, arming, targets, timeouts, landing, safety."""

import itertools
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

STABILIZE, ALT_HOLD, GUIDED, LOITER, RTL, LAND, BRAKE, NOGPS = 0, 2, 4, 5, 6, 9, 17, 20


def test_early_mode_is_undone_and_arming_refused_with_a_reason(bare):
    c = bare.Client(noise=0.0)
    c.run(1.0)
    assert c.mode(NOGPS) == 0
    c.run(7.0)
    assert c.last("HEARTBEAT").custom_mode == STABILIZE
    assert c.command(400, 1) == 4
    assert c.texts[-1].startswith("Arm: ")
    c.run(16.5)
    assert c.mode(GUIDED) == 0  # disarmed, any mode may be chosen
    assert c.command(400, 1) == 4
    assert c.texts[-1] == "Arm: Need Position Estimate"
    assert c.mode(NOGPS) == 0
    c.run(1.0)
    assert c.last("HEARTBEAT").custom_mode == NOGPS
    assert c.command(400, 1) == 0
    assert c.mode(GUIDED) == 4  # armed, without a position
    assert "requires position" in c.texts[-1]


def test_only_heartbeat_and_texts_come_unasked(bare):
    c = bare.Client(noise=0.0)
    c.run(60.0)
    assert set(c.got) == {"HEARTBEAT", "STATUSTEXT", "TIMESYNC"}
    assert 58 <= len(c.got["HEARTBEAT"]) <= 62


def test_intervals_are_kept_and_too_fast_is_denied(bare):
    c = bare.Client(**bare.QUIET)
    c.run(1.0)
    assert c.command(511, 30, 5000.0) == 0
    assert c.command(511, 105, 10000.0) == 0
    c.run(2.0)
    assert len(c.got["ATTITUDE"]) == pytest.approx(400, abs=2)
    stamps = [m.time_usec for m in c.got["HIGHRES_IMU"]]
    assert {b - a for a, b in itertools.pairwise(stamps)} == {10000}
    assert c.command(511, 30, 2500.0) == 2
    assert "too fast" in c.texts[-1]
    assert c.command(511, 331, 10000.0) == 2
    assert c.texts[-1] == "No ap_message for mavlink id (331)"
    assert c.command(511, 30, -1.0) == 0
    before = len(c.got["ATTITUDE"])
    c.run(0.5)
    assert len(c.got["ATTITUDE"]) == before


def test_local_position_is_silent_without_gps(bare):
    c = bare.Client(noise=0.0, gps_s=5.0)
    assert c.command(511, 32, 20000.0) == 0
    c.run(4.9)
    assert "LOCAL_POSITION_NED" not in c.got
    c.run(0.5)
    assert "LOCAL_POSITION_NED" in c.got
    blind = bare.Client(noise=0.0, parameters={"SIM_GPS1_ENABLE": 0})
    assert blind.command(511, 32, 20000.0) == 0
    blind.run(50.0)
    assert "LOCAL_POSITION_NED" not in blind.got
    assert blind.mode(LOITER) == 0
    assert blind.command(400, 1) == 4


def test_parameters(bare):
    c = bare.Client(**bare.QUIET)
    c.send(dialect.MAVLink_param_request_list_message(1, 1))
    listed = c.got["PARAM_VALUE"]
    assert len(listed) == listed[0].param_count == len({m.param_id for m in listed})
    assert {"GUID_OPTIONS", "ATC_ANGLE_BOOST", "LOG_BITMASK", "INS_ACCEL_FILTER"} <= {m.param_id for m in listed}
    assert c.set("GUID_TIMEOUT", 0.2) == pytest.approx(0.2)
    assert c.last("PARAM_VALUE").param_index == 0xFFFF
    assert c.set("ANGLE_MAX", 3000) is None  # a name of 4.6: silence
    before = len(c.got["PARAM_VALUE"])
    c.send(dialect.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    c.send(dialect.MAVLink_param_request_read_message(7, 1, b"GUID_OPTIONS", -1))  # another system
    assert len(c.got["PARAM_VALUE"]) == before
    c.send(dialect.MAVLink_param_request_read_message(1, 1, b"GUID_OPTIONS", -1))
    assert c.last("PARAM_VALUE").param_value == 0


def test_motors_lift_two_seconds_after_arming(bare):
    c = bare.Client(**bare.QUIET)
    c.run(1.0)
    c.set("GUID_OPTIONS", 8)
    c.mode(NOGPS)
    assert c.command(400, 1) == 0
    c.run(1.8, lambda: c.target(throttle=0.3))
    assert c.motion.pz == 0.0
    c.run(1.0, lambda: c.target(throttle=0.3))
    assert c.motion.pz > 0.1


def test_targets_in_another_mode_are_dropped(bare):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne()
    c.mode(LOITER)
    c.run(1.0, lambda: c.target(roll=0.4, throttle=hover))
    assert abs(c.motion.roll) < 0.05
    assert c.last("HEARTBEAT").custom_mode == LOITER


@pytest.mark.parametrize(
    ("mask", "size", "taken"),
    [
        (7, 1.0, True),
        (0, 1.0, True),
        (128, 1.0, True),
        (3, 1.0, False),
        (4, 1.0, False),
        (71, 1.0, False),
        (7, 1.01, False),
    ],
)
def test_type_mask_table(bare, mask, size, taken):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne()
    c.run(0.4, lambda: c.target(throttle=hover))
    c.run(0.5, lambda: c.target(roll=0.3, throttle=1.3 * hover, mask=mask, size=size))
    climbs = c.motion.vz > 0.3
    assert climbs is taken
    assert (abs(c.motion.roll) > 0.2) is (taken and mask != 128)


def test_yaw_rate_with_mask_0_advances_the_target_between_messages(bare):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne()
    c.command(511, 83, 20000.0)
    c.target(throttle=hover, mask=0, yaw_rate=0.5)
    c.run(0.2)
    start = c.motion.yaw
    c.run(1.0)
    assert c.motion.r == pytest.approx(0.5, abs=0.01)
    assert c.motion.yaw - start == pytest.approx(0.5, abs=0.01)
    q = c.last("ATTITUDE_TARGET").q
    yaw_ned = math.atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] ** 2 + q[3] ** 2))
    assert yaw_ned == pytest.approx(-c.motion.yaw, abs=0.1)


def test_yaw_rate_is_positive_to_the_left_and_roll_flies_right(bare):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne()
    c.run(1.0, lambda: c.target(roll=0.2, throttle=hover))
    assert c.motion.vy < -0.5  # right of north is east: negative west
    c.command(511, 30, 20000.0)
    c.command(511, 105, 20000.0)
    c.run(0.2, lambda: c.target(pitch=0.2, throttle=hover))
    a = c.last("ATTITUDE")
    assert a.pitch < -0.1  # nose down is negative in FRD
    assert c.last("HIGHRES_IMU").zacc < -8.0


def test_targets_that_stop_are_held_then_level_and_level_height(bare):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne()
    assert c.set("GUID_TIMEOUT", 0.5) == 0.5
    c.run(0.3, lambda: c.target(roll=0.2, throttle=1.2 * hover))
    c.run(0.4)
    assert c.motion.roll == pytest.approx(0.2, abs=0.05)
    c.run(4.0)
    assert abs(c.motion.roll) < 0.01
    assert abs(c.motion.vz) < 0.1
    assert c.last("HEARTBEAT").custom_mode == NOGPS
    c.run(0.5, lambda: c.target(roll=-0.2, throttle=hover))
    assert c.motion.roll == pytest.approx(-0.2, abs=0.05)


def test_thrust_is_a_climb_rate_without_bit_3(bare):
    c = bare.Client(**bare.QUIET)
    c.airborne()
    c.set("GUID_OPTIONS", 0)
    c.run(3.0, lambda: c.target(throttle=0.5))
    assert abs(c.motion.vz) < 0.1
    c.run(3.0, lambda: c.target(throttle=0.75))
    assert c.motion.vz == pytest.approx(1.25, abs=0.15)  # half of WP_SPD_UP


def test_land_disarms_itself_but_thrust_mode_never_does(bare):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne(2.0)
    assert c.command(400, 0) == 4  # plain disarm in the air
    c.run(4.0, lambda: c.target(throttle=0.9 * hover))
    c.run(14.0, lambda: c.target(throttle=0.0))
    assert c.motion.on_ground
    assert c.vehicle.armed
    assert c.command(400, 0) == 4  # landing is not detected in thrust mode
    assert c.mode(LAND) == 0
    c.run(4.0)
    assert not c.vehicle.armed
    assert c.last("HEARTBEAT").base_mode & 128 == 0
    c = bare.Client(**bare.QUIET)
    c.airborne(2.0)
    assert c.command(400, 0, 21196) == 0
    assert not c.vehicle.armed


def test_fence_brakes(bare):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne(4.0)
    for name, value in (("FENCE_ENABLE", 1), ("FENCE_ALT_MAX", 7), ("FENCE_ACTION", 4), ("FENCE_TYPE", 3)):
        assert c.set(name, value) == value
    c.run(2.0, lambda: c.target(throttle=1.3 * hover))
    assert c.last("HEARTBEAT").custom_mode == BRAKE
    assert any("fence" in t for t in c.texts)


def test_pilot_takes_over_by_the_mode_switch(bare):
    c = bare.Client(**bare.QUIET)
    c.airborne()
    c.set("SIM_PILOT_MODE", LOITER)
    assert c.last("HEARTBEAT").custom_mode == LOITER


def test_a_fallen_vehicle_is_disarmed_by_the_crash_check(bare):
    c = bare.Client(**bare.QUIET)
    hover = c.airborne(3.0)
    c.run(1.2, lambda: c.target(roll=1.0, throttle=0.2 * hover))
    assert c.motion.on_ground
    c.run(6.0, lambda: c.target(throttle=0.0))
    assert not c.vehicle.armed
    assert any(t.startswith("Crash") for t in c.texts)


def test_timesync_and_version_and_stubs(bare):
    c = bare.Client(**bare.QUIET)
    c.run(2.0)
    c.send(dialect.MAVLink_timesync_message(0, 123456789))
    answer = c.last("TIMESYNC")
    assert (answer.ts1, answer.tc1) == (123456789, 2_000_000_000)
    assert c.command(512, 148) == 0
    assert c.last("AUTOPILOT_VERSION").flight_sw_version >> 24 == 4
    c.send(dialect.MAVLink_mission_request_list_message(1, 1, 0))
    assert c.last("MISSION_COUNT").count == 1, "home is the first item of every mission"
    assert c.command(31010) == 3  # unknown here


def test_position_targets_in_both_frames(bare):
    c = bare.Client(**bare.QUIET)
    c.airborne(5.0)
    assert c.mode(GUIDED) == 0
    c.send(
        dialect.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 0b100111111000, 3, -2, -6, 0, 0, 0, 0, 0, 0, 1.0, 0
        )
    )
    c.run(10.0)
    assert (c.motion.px, c.motion.py, c.motion.pz) == pytest.approx((3.0, 2.0, 6.0), abs=0.1)
    assert c.motion.yaw == pytest.approx(-1.0, abs=0.02)
    c.command(511, 33, 100000.0)
    c.run(0.2)
    here = c.last("GLOBAL_POSITION_INT")
    c.send(
        dialect.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, 0b110111111000, here.lat + 449, here.lon, 5.0, 0, 0, 0, 0, 0, 0, 0, 0
        )
    )
    c.run(10.0)
    assert c.motion.px == pytest.approx(8.0, abs=0.15)  # 449e-7 deg of latitude are 5 m
    assert c.motion.pz == pytest.approx(5.0, abs=0.1)
    assert c.command(115, 90, 0, 1, 0) == 0
    c.run(4.0)
    assert c.motion.yaw == pytest.approx(-math.pi / 2, abs=0.02)
    c.mode(RTL)
    c.run(60.0)
    assert not c.vehicle.armed
    assert math.hypot(c.motion.px, c.motion.py) < 0.5


def low_throttle_then_guided(bare):
    """A vehicle in the air, in GUIDED, whose last attitude target was a stop's; and the throttle with which it hovers."""
    c = bare.Client(**bare.QUIET)
    hover = c.airborne(6.0)
    c.run(0.3, lambda: c.target(throttle=0.3 * hover))
    assert c.mode(GUIDED) == 0
    return c, hover


def test_guided_does_not_go_on_with_the_attitude_target_of_the_mode_before(bare):
    """It flew the throttle of a stop until GUID_TIMEOUT: 3 s, to the ground."""
    c, _ = low_throttle_then_guided(bare)
    c.run(2.0)
    assert c.motion.pz > 4.0
    assert abs(c.motion.vz) < 0.5


def test_an_attitude_target_in_guided_has_its_own_throttle_from_the_start(bare):
    """For the delay of a target it flew with the throttle of the last one before GUIDED: that of a stop, with which it fell."""
    c, hover = low_throttle_then_guided(bare)
    c.run(5.0)
    height, climb = c.motion.pz, c.motion.vz
    c.target(throttle=hover)
    c.run(0.1)  # as long as the delay
    assert abs(c.motion.vz - climb) < 0.05
    assert c.motion.pz == pytest.approx(height, abs=0.02)


def test_a_landed_vehicle_with_an_empty_battery_gets_a_full_one(bare):
    c = bare.Client(**bare.QUIET, voltage_v=22.6)
    c.airborne(2.0)
    assert c.vehicle.plant.battery.voltage < 22.6
    c.mode(LAND)
    c.run(12.0)
    assert not c.vehicle.armed
    assert c.vehicle.plant.battery.voltage > 25.0
    assert "SIM battery replaced" in c.texts
    kept = bare.Client(**bare.QUIET, voltage_v=22.6, parameters={"SIM_BATT_SWAP": 0})
    kept.run(10.0)
    assert kept.motion.voltage < 22.7


def test_nothing_the_vehicle_sends_shows_what_is_hidden(bare):
    def sent(**options):
        c = bare.Client(**bare.QUIET, **options)
        c.send(dialect.MAVLink_param_request_list_message(1, 1))
        c.command(512, 148)
        c.airborne(3.0)
        return (
            [(m.param_id, m.param_value) for m in c.got["PARAM_VALUE"]],
            c.last("AUTOPILOT_VERSION").to_dict(),
            c.texts,
        )

    hide = {"angle_boost": {}, "reference_shaping": {}, "steady_wind": {"w_north": 1.0}}
    for airframe in ("paper", "rotor"):
        assert sent(airframe=airframe, hide=hide) == sent(airframe=airframe)
