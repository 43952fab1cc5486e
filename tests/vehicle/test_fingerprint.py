import pytest

from flighttest.vehicle.fingerprint import fingerprint, shaping_parameters
from flighttest.vehicle.model import DEFAULT_VEHICLE

SHAPING = [
    "ATC_RAT_RLL_P",
    "ATC_INPUT_TC",
    "ATC_ACCEL_R_MAX",
    "ATC_ACC_R_MAX",
    "ATC_ANGLE_BOOST",
    "ATC_THR_MIX_MAN",
    "INS_GYRO_FILTER",
    "INS_HNTCH_FREQ",
    "INS_HNTC2_ENABLE",
    "INS_ACCEL_FILTER",
    "SCHED_LOOP_RATE",
    "MOT_THST_EXPO",
    "MOT_SPIN_MIN",
    "MOT_BAT_VOLT_MAX",
    "MOT_SLEW_UP_TIME",
    "PILOT_THR_FILT",
    "BATT_VOLT_MULT",
    "BATT2_AMP_PERVLT",
    "GUID_OPTIONS",
    "FRAME_CLASS",
    "FRAME_TYPE",
    "MC_ROLLRATE_P",
    "THR_MDL_FAC",
    "MC_BAT_SCALE_EN",
]
HARMLESS = [
    "SR0_EXTRA1",
    "MAV1_POSITION",
    "WPNAV_SPEED",
    "WP_SPD_UP",
    "NTF_LED_BRIGHT",
    "LOG_BITMASK",
    "FENCE_ENABLE",
    "GUID_TIMEOUT",
    "BATT_LOW_VOLT",
    "BATT_FS_LOW_ACT",
    "INS_GYROFFS_X",
    "COMPASS_OFS_X",
    "STAT_RUNTIME",
    "RC1_MIN",
    "MOT_THST_HOVER",  # learned by the autopilot in every flight
    "SYSID_THISMAV",
]


@pytest.mark.parametrize("name", SHAPING)
def test_what_shapes_the_response_changes_the_digest(name):
    before = fingerprint(DEFAULT_VEHICLE, "ArduCopter V4.7.0", {name: 1.0, "SR0_EXTRA1": 4.0})
    after = fingerprint(DEFAULT_VEHICLE, "ArduCopter V4.7.0", {name: 1.1, "SR0_EXTRA1": 4.0})
    assert before.shaping_parameters == {name: 1.0}
    assert before.parameters_sha256 != after.parameters_sha256


@pytest.mark.parametrize("name", HARMLESS)
def test_harmless_parameters_are_left_out(name):
    assert shaping_parameters({name: 1.0}) == {}
    base = {"ATC_RAT_RLL_P": 0.1}
    assert (
        fingerprint(None, parameters={**base, name: 1.0}).parameters_sha256
        == fingerprint(None, parameters={**base, name: 2.0}).parameters_sha256
    )


def test_single_precision_does_not_change_the_digest():
    as_float32 = 0.13500000536441803
    assert (
        fingerprint(None, parameters={"ATC_RAT_RLL_P": 0.135}).parameters_sha256
        == fingerprint(None, parameters={"ATC_RAT_RLL_P": as_float32}).parameters_sha256
    )


def test_what_a_model_file_carries():
    found = fingerprint(
        DEFAULT_VEHICLE, "ArduCopter V4.7.0-dev (abc)", {"FRAME_CLASS": 2.0, "FRAME_TYPE": 1.0}
    ).as_data()
    assert found["frame"] == "class 2 type 1"
    assert found["firmware"] == "ArduCopter V4.7.0-dev (abc)"
    assert found["nominal_voltage_v"] == 22.2
    assert found["components"]["battery"]["model"] == "6S 10 Ah"
    assert set(found["shaping_parameters"]) == {"FRAME_CLASS", "FRAME_TYPE"}


def test_what_is_not_known_is_not_claimed():
    assert fingerprint(None).as_data() == {}
