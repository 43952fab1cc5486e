"""The ground crew swaps the pack of a SITL vehicle after each landing, and only then."""

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flighttest.sim.sitl.crew import GroundCrew


def beat(armed: bool) -> object:
    return dialect.MAVLink_heartbeat_message(2, 3, 89 | (128 if armed else 0), 20, 3, 3)


def test_a_full_pack_after_each_landing() -> None:
    crew = GroundCrew("127.0.0.1", 1)  # no listener there
    crew.stop()
    asked = crew.take(beat(False))
    assert asked.get_type() == "PARAM_REQUEST_READ"
    assert asked.param_id == "SIM_BATT_VOLTAGE"
    assert crew.take(dialect.MAVLink_param_value_message(b"SIM_BATT_VOLTAGE", 25.2, 9, 1354, 65535)) is None
    assert crew.take(beat(False)) is None
    assert crew.take(beat(True)) is None
    first = crew.take(beat(False))
    assert (first.get_type(), first.param_id) == ("PARAM_SET", "SIM_BATT_VOLTAGE")
    assert 25.1 < first.param_value < 25.2, "the firmware swaps the pack only when the value changes"
    assert crew.take(beat(False)) is None
    crew.take(beat(True))
    assert crew.take(beat(False)).param_value == 25.2
    assert crew.swapped == 2
