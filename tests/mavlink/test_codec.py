"""Signs, units and masks of the codec, against numbers worked out by hand and against a stream made message by message."""

import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flighttest.errors import RecordingError
from flighttest.mavlink import (
    CopterMode,
    columns_of,
    decode_stream,
    mark_text,
    mode_name,
    offset_m,
    parse_mark,
    target_message,
)
from flighttest.mavlink.dialect import dialect, firmware_version, parser
from flighttest.mavlink.targets import REFERENCE_FIELDS, reference_columns
from flighttest.mavlink.telemetry import RULES, motor_columns, rules_of

NOSE_DOWN_LEFT = {"roll_rad": 0.2, "pitch_rad": 0.3, "yaw_rad": 0.5}


def wire(message: Any, system: int = 1, component: int = 1) -> Any:
    """A message as it comes out of the other end of a link."""
    frame = bytes(message.pack(parser(system, component)))
    (decoded,) = parser(0, 0).parse_buffer(frame)
    return decoded


def target(**changes: Any) -> Any:
    fields = {
        "t_vehicle_s": 12.3456, "system": 1, **NOSE_DOWN_LEFT, "yaw_rate_rad_s": None, "throttle": 0.18,
    } | changes  # fmt: skip
    return wire(target_message(**fields), 245, 191)


def test_a_target_in_frd_and_ned() -> None:
    m = target()
    w, x, y, z = m.q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(2 * (w * y - z * x))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    # NED/FRD: roll kept, pitch and yaw of the other sign.
    assert (roll, pitch, yaw) == pytest.approx((0.2, -0.3, -0.5), abs=1e-6)
    assert math.hypot(*m.q) == pytest.approx(1.0, abs=1e-6)
    assert m.type_mask == 7
    assert m.thrust == pytest.approx(0.18)
    assert m.time_boot_ms == 12345
    assert (m.target_system, m.target_component) == (1, 1)


@pytest.mark.parametrize("ms", [4007, 4015, 1_000_003, 53_751])
def test_whole_milliseconds_are_stamped_as_they_are(ms: int) -> None:
    assert target(t_vehicle_s=ms * 1e-3).time_boot_ms == ms  # 4.007 * 1e3 is 4006.9999999999995


def test_a_yaw_rate_to_the_left_is_negative_in_frd_and_needs_all_rates() -> None:
    m = target(yaw_rate_rad_s=1.5)
    assert m.type_mask == 0
    assert m.body_yaw_rate == pytest.approx(-1.5)
    assert m.body_roll_rate == m.body_pitch_rate == 0.0


@pytest.mark.parametrize("rate", [None, -2.0, 1.0])
def test_what_is_sent_is_what_is_read_back(rate: float | None) -> None:
    m = target(yaw_rate_rad_s=rate)
    back = reference_columns({name: np.array([getattr(m, name)]) for name in REFERENCE_FIELDS})
    assert back["roll_ref_rad"][0] == pytest.approx(0.2, abs=1e-6)
    assert back["pitch_ref_rad"][0] == pytest.approx(0.3, abs=1e-6)
    assert back["yaw_rate_ref_rad_s"][0] == pytest.approx(rate or 0.0, abs=1e-6)
    assert back["throttle"][0] == pytest.approx(0.18)


def test_ignored_parts_are_not_numbers() -> None:
    raw = {
        "type_mask": np.array([128 | 64]),
        "q": np.array([[1.0, 0, 0, 0]]),
        "body_yaw_rate": np.array([1.0]),
        "thrust": np.array([0.5]),
    }
    back = reference_columns(raw)
    assert math.isnan(back["roll_ref_rad"][0])
    assert math.isnan(back["throttle"][0])
    assert back["yaw_rate_ref_rad_s"][0] == -1.0


def rule(message: str, group: str) -> Any:
    return next(r for r in RULES if r.message == message and r.group == group)


CASES = [
    (dialect.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0), "attitude",
     {"roll_rad": 0.1, "pitch_rad": -0.2, "yaw_rad": -0.3}),
    (dialect.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0), "rates",
     {"p_rad_s": 1.0, "q_rad_s": -2.0, "r_rad_s": -3.0}),
    (dialect.MAVLink_highres_imu_message(10**6, 1.0, 2.0, -9.8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 63), "specific_force",
     {"f_x_m_s2": 1.0, "f_y_m_s2": -2.0, "f_z_m_s2": 9.8}),
    (dialect.MAVLink_scaled_imu_message(1000, 100, 0, -1000, 0, 0, 0, 0, 0, 0), "specific_force",
     {"f_x_m_s2": 0.980665, "f_y_m_s2": 0.0, "f_z_m_s2": 9.80665}),
    (dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 4.0, 5.0, -6.0), "position",
     {"p_x_m": 1.0, "p_y_m": -2.0, "p_z_m": 3.0}),
    (dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 4.0, 5.0, -6.0), "velocity",
     {"v_x_m_s": 4.0, "v_y_m_s": -5.0, "v_z_m_s": 6.0}),
    (dialect.MAVLink_global_position_int_message(1000, 473977000, 85456000, 500000, 12500, 100, 200, -300, 0), "velocity",
     {"v_x_m_s": 1.0, "v_y_m_s": -2.0, "v_z_m_s": 3.0}),
    (dialect.MAVLink_global_position_int_message(1000, 473977000, 85456000, 500000, 12500, 100, 200, -300, 0), "height",
     {"height_m": 12.5}),
    (dialect.MAVLink_battery_status_message(0, 0, 0, 0, [11100, 11000, *[65535] * 8], 1250, 0, 0, 50), "battery",
     {"voltage_v": 22.1, "current_a": 12.5}),
    (dialect.MAVLink_battery_status_message(0, 0, 0, 0, [22100, *[65535] * 9], -1, 0, 0, 50), "battery",
     {"voltage_v": 22.1, "current_a": math.nan}),
    (dialect.MAVLink_sys_status_message(0, 0, 0, 0, 22100, 1250, 50, 0, 0, 0, 0, 0, 0), "battery",
     {"voltage_v": 22.1, "current_a": 12.5}),
    (dialect.MAVLink_distance_sensor_message(1000, 20, 700, 123, 0, 0, 25, 0), "height", {"height_m": 1.23}),
    (dialect.MAVLink_servo_output_raw_message(1000, 0, 1000, 1400, 2050, 900, 0, 0, 0, 0), "motors",
     {"motor_1": 0.0, "motor_2": 0.4, "motor_3": 1.0, "motor_4": 0.0}),
]  # fmt: skip


@pytest.mark.parametrize(("message", "group", "expected"), CASES, ids=lambda v: v if isinstance(v, str) else "")
def test_each_message_by_hand(message: Any, group: str, expected: dict[str, float]) -> None:
    m = wire(message)
    found = columns_of(rule(m.get_type(), group), m)
    assert found == pytest.approx(expected, nan_ok=True, abs=1e-6)


@pytest.mark.parametrize("rule", [r for r in RULES if r.elementwise], ids=lambda r: f"{r.group}-{r.message}")
def test_one_message_is_converted_as_many_are(rule: Any) -> None:
    """To the last bit: what the gate judges in flight is what the recording shows."""
    rng = np.random.default_rng(0)
    many = {name: rng.normal(size=50).astype(np.float32) for name in rule.fields}
    columns = rule.convert(many)
    for i in range(50):
        one = columns_of(rule, SimpleNamespace(**{name: float(values[i]) for name, values in many.items()}))
        assert one == {name: values[i] for name, values in columns.items()}


def test_an_output_that_is_off_is_no_motor_at_rest() -> None:
    found = motor_columns(np.array([[0.0, 1000.0, 1500.0, 2000.0]]))
    assert [float(found[f"motor_{k}"][0]) for k in range(1, 5)] == pytest.approx([np.nan, 0.0, 0.5, 1.0], nan_ok=True)


def test_what_does_not_belong_is_left_out() -> None:
    second_battery = wire(dialect.MAVLink_battery_status_message(1, 0, 0, 0, [9000, *[65535] * 9], 0, 0, 0, 50))
    assert columns_of(rule("BATTERY_STATUS", "battery"), second_battery) is None
    forward = wire(dialect.MAVLink_distance_sensor_message(1000, 20, 700, 123, 0, 0, 0, 0))
    assert columns_of(rule("DISTANCE_SENSOR", "height"), forward) is None
    too_far = wire(dialect.MAVLink_distance_sensor_message(1000, 20, 700, 700, 0, 0, 25, 0))
    assert columns_of(rule("DISTANCE_SENSOR", "height"), too_far) is None
    for port, fourth in ((1, 1400), (0, 0)):
        others = wire(dialect.MAVLink_servo_output_raw_message(1000, port, 1400, 1400, 1400, fourth, 0, 0, 0, 0))
        assert columns_of(rule("SERVO_OUTPUT_RAW", "motors"), others) is None
    no_fix = wire(dialect.MAVLink_global_position_int_message(1000, 0, 0, 0, 0, 0, 0, 0, 0))
    assert columns_of(rule("GLOBAL_POSITION_INT", "velocity"), no_fix) is None


def test_preference_is_the_order_of_the_table() -> None:
    assert [r.message for r in rules_of("specific_force")] == ["HIGHRES_IMU", "SCALED_IMU", "RAW_IMU"]


def test_degrees_on_a_flat_earth() -> None:
    north, west = offset_m(47.0, 8.0, 47.001, 8.001)
    assert north == pytest.approx(111.319, abs=0.01)
    assert west == pytest.approx(-111.319 * math.cos(math.radians(47.0)), abs=0.01)


def test_marks_and_names() -> None:
    assert mark_text("thrust/0.05-0.40/r3", "step") == "FT thrust/0.05-0.40/r3 step"
    assert parse_mark("FT thrust/0.05-0.40/r3 step") == ("thrust/0.05-0.40/r3", "step")
    assert parse_mark("FT too many words here") is None
    with pytest.raises(ValueError, match="does not fit"):
        mark_text("x" * 60, "step")
    assert mode_name(CopterMode.GUIDED_NOGPS) == "GUIDED_NOGPS"
    assert mode_name(99) == "mode 99"
    version = dialect.MAVLink_autopilot_version_message(
        0, 0x04070000, 0, 0, 0, list(b"97009754"), [0] * 8, [0] * 8, 0, 0, 0
    )
    assert firmware_version(wire(version)) == "4.7.0-dev (97009754)"


DELAY_S, UPLINK_S, OFFSET_S = 0.015, 0.010, 1.7e9


def flight(timesync: bool = True, stamp: bool = False, start_s: float = 5.0) -> Iterator[tuple[float, Any]]:
    """40 s of a vehicle whose clock is the ground's minus OFFSET_S, with a yaw rate step sent when its clock shows start_s + 20."""
    for k in range(4000):
        t = start_s + 0.01 * k
        ground = OFFSET_S + t
        jitter = 0.004 * ((k * 7919) % 11) / 11
        yield (
            ground + DELAY_S + jitter,
            wire(dialect.MAVLink_attitude_message(round(t * 1e3), 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)),
        )
        if k % 100 == 0:
            beat = dialect.MAVLink_heartbeat_message(2, 3, 129 if k > 500 else 1, 20 if k > 1000 else 0, 4, 3)
            yield ground + DELAY_S, wire(beat)
            if timesync:
                yield ground, wire(dialect.MAVLink_timesync_message(0, k + 1), 245, 191)
                yield (
                    ground + UPLINK_S + DELAY_S,
                    wire(dialect.MAVLink_timesync_message(int((t + UPLINK_S) * 1e9), k + 1)),
                )
        if k % 2 == 0:
            sent = target(t_vehicle_s=t if stamp else 0.0, roll_rad=0.3 if k >= 2000 else 0.0, pitch_rad=0.0)
            yield ground, sent
        if k == 2000:
            yield ground, wire(dialect.MAVLink_statustext_message(6, b"FT a/b/r1 step"), 245, 191)
        if k == 2100:
            yield ground + DELAY_S, wire(dialect.MAVLink_statustext_message(6, b"Arming motors"))


@pytest.mark.parametrize(
    ("timesync", "stamp", "error_s"), [(True, False, 0.004), (False, True, 0.002), (False, False, 0.017)]
)
def test_sent_times_are_on_the_vehicles_clock_as_well_as_the_link_allows(
    timesync: bool, stamp: bool, error_s: float
) -> None:
    decoded = decode_stream(flight(timesync, stamp))
    reference = decoded.series["reference"]
    edge = reference.t_s[np.flatnonzero(np.diff(reference.columns["roll_ref_rad"]) > 0.1)[0] + 1]
    assert abs(edge - 25.0) < error_s
    assert decoded.reference_clock in ("ground", "vehicle")
    assert decoded.clock.error_s >= abs(edge - 25.0) or decoded.clock.error_s > 0.01


def in_step(offset_s: float = 0.0, imu: bool = True) -> Iterator[tuple[float, Any]]:
    """A simulator in lock-step, or (offset_s) a vehicle whose ms are rounded down: ATTITUDE, HIGHRES_IMU, a slow battery, targets."""
    for k in range(1500):
        t = 5.0 + 0.02 * k
        vehicle = t + offset_s
        yield OFFSET_S + t, target(t_vehicle_s=t, roll_rad=0.3 if k >= 1000 else 0.0, pitch_rad=0.0)
        if k % 50 == 0:
            yield OFFSET_S + t, wire(dialect.MAVLink_heartbeat_message(2, 3, 129, 20, 4, 3))
            yield OFFSET_S + t, wire(dialect.MAVLink_timesync_message(0, k + 1), 245, 191)
            yield OFFSET_S + t, wire(dialect.MAVLink_timesync_message(int(t * 1e9), k + 1))
        # The vehicle's step of 20 ms ends before the ground's clock moves: what it sends seems to come from the future.
        for ahead in (0.01, 0.02):
            now = vehicle + ahead
            yield (
                OFFSET_S + t,
                wire(dialect.MAVLink_attitude_message(int(now * 1e3 + 1e-6), 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)),
            )
            if imu:
                us = round(now * 1e6)
                yield OFFSET_S + t, wire(dialect.MAVLink_highres_imu_message(us, 0, 0, -9.8, *[0.0] * 10, 63))
            if ahead == 0.01 and k % 5 == 0:
                cells = [23000, *[65535] * 9]
                yield OFFSET_S + t, wire(dialect.MAVLink_battery_status_message(0, 0, 0, 0, cells, 100, 0, 0, 50))


def freely_first() -> Iterator[tuple[float, Any]]:
    """A simulator that ran at twenty times the ground's pace until lock-step began."""
    for k in range(100):
        t = 0.02 * k
        yield OFFSET_S + 5.0 - (5.0 - t) / 20.0, wire(dialect.MAVLink_attitude_message(round(t * 1e3), *[0.0] * 6))


@pytest.mark.parametrize("imu", [True, False])
@pytest.mark.parametrize("before", [False, True])
def test_times_of_a_simulator_in_lock_step_are_exact(imu: bool, before: bool) -> None:
    decoded = decode_stream([*(freely_first() if before else ()), *in_step(imu=imu)])
    reference = decoded.series["reference"]
    edge = reference.t_s[np.flatnonzero(np.diff(reference.columns["roll_ref_rad"]) > 0.1)[0] + 1]
    assert edge == pytest.approx(25.0, abs=2e-6)
    assert decoded.series["attitude"].t_s[100 * before] == pytest.approx(5.01, abs=1e-9)
    assert decoded.clock.error_s == 0.0


def test_what_rounding_took_from_millisecond_stamps_is_put_back() -> None:
    decoded = decode_stream(in_step(offset_s=0.7e-3))
    assert decoded.series["attitude"].t_s[10] == pytest.approx(decoded.series["specific_force"].t_s[10], abs=1e-6)


def test_a_message_without_a_stamp_goes_by_the_one_before_it() -> None:
    battery = decode_stream(in_step()).series["battery"]
    np.testing.assert_allclose(battery.t_s, 5.01 + 0.1 * np.arange(300), atol=1e-6)


def test_a_links_delay_does_not_make_the_battery_late() -> None:
    stream = []
    for at, message in flight():
        stream.append((at, message))
        if message.get_type() == "ATTITUDE" and message.time_boot_ms % 100 == 0:
            cells = [message.time_boot_ms, *[65535] * 9]
            stream.append((at, wire(dialect.MAVLink_battery_status_message(0, 0, 0, 0, cells, 100, 0, 0, 50))))
    battery = decode_stream(stream).series["battery"]
    assert np.abs(battery.t_s - battery.columns["voltage_v"]).max() < 1e-6


def test_a_stream_becomes_channels_and_marks() -> None:
    decoded = decode_stream(flight())
    attitude = decoded.series["attitude"]
    assert attitude.t_s[0] == 5.0
    assert len(attitude) == 4000
    state = decoded.series["state"].columns
    assert set(state["armed"]) == {0.0, 1.0}
    assert [m.label for m in decoded.markers if m.kind == "mode"] == ["STABILIZE", "GUIDED_NOGPS"]
    step = next(m for m in decoded.markers if m.kind == "phase")
    assert (step.label, step.data["leg"]) == ("step", "a/b/r1")
    assert step.t_s == pytest.approx(25.0, abs=0.01)
    assert any(m.kind == "note" and m.label == "Arming motors" for m in decoded.markers)
    assert decoded.vehicle_system == 1


def test_a_reboot_is_said_and_only_the_longest_run_is_read() -> None:
    first = [(t, m) for t, m in flight() if t < OFFSET_S + 15.0]
    second = [(t + 100.0, m) for t, m in flight(start_s=2.0)]
    decoded = decode_stream([*first, *second])
    assert decoded.series["attitude"].t_s[0] == 2.0
    assert any("restarted" in loss for loss in decoded.losses)


def test_nothing_to_decode_is_an_error_with_a_remedy() -> None:
    with pytest.raises(RecordingError, match="no autopilot HEARTBEAT"):
        decode_stream([])
    beats = [(0.0, wire(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)))]
    with pytest.raises(RecordingError, match="vehicle's time"):
        decode_stream(beats)
