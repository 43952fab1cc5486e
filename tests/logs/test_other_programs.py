"""MATLAB files and ROS 2 bags, written by the libraries that define them, become recordings."""

import io
import json

import numpy as np
import pytest
import scipy.io
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer

from flighttest.errors import RecordingError
from flighttest.logs import import_log

T = np.arange(0.0, 4.0, 0.02)
ROLL = 0.2 * np.sin(T)

STAMPED = "std_msgs/Header header\n"
TYPES = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
IMU = (
    STAMPED + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    "geometry_msgs/Vector3 angular_velocity\ngeometry_msgs/Vector3 linear_acceleration" + TYPES
)
TARGET = STAMPED + "geometry_msgs/Quaternion orientation\ngeometry_msgs/Vector3 body_rate\nfloat32 thrust" + TYPES
BATTERY = STAMPED + "float32 voltage\nfloat32 current" + TYPES


def header(t_s):
    return {"stamp": {"sec": int(t_s), "nanosec": int(t_s % 1 * 1e9)}, "frame_id": "map"}


def quaternion(roll):
    return {"x": np.sin(roll / 2), "y": 0.0, "z": 0.0, "w": np.cos(roll / 2)}


@pytest.fixture
def bag(tmp_path):
    """An IMU at 50 Hz, targets at 25 Hz, a battery at 1 Hz; times of an epoch, recorded 3 ms after their stamps."""
    path = tmp_path / "flight.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=4000)
        imu = writer.register_msgdef("sensor_msgs/msg/Imu", IMU)
        target = writer.register_msgdef("mavros_msgs/msg/AttitudeTarget", TARGET)
        battery = writer.register_msgdef("sensor_msgs/msg/BatteryState", BATTERY)

        def write(topic, schema, t_s, message):
            now_s = 1_700_000_000.0 + t_s
            writer.write_message(topic, schema, {"header": header(now_s), **message}, int((now_s + 0.003) * 1e9))

        for i, (t, roll) in enumerate(zip(T, ROLL, strict=True)):
            rates = {"x": 0.2 * np.cos(t), "y": 0.0, "z": 0.1}
            write("/imu/data", imu, t, {"orientation": quaternion(roll), "orientation_covariance": [0.0] * 9,
                  "angular_velocity": rates, "linear_acceleration": {"x": 0.0, "y": 0.1, "z": 9.8}})  # fmt: skip
            if i % 2 == 0:
                write("/target", target, t + 0.001, {"orientation": quaternion(0.1), "body_rate": rates, "thrust": 0.4})
            if i % 50 == 0:
                write("/battery", battery, t, {"voltage": 24.0 - t, "current": -10.0})
        writer.finish()
    return path


def test_a_ros_bag_of_known_messages_needs_no_column_map(bag):
    found = import_log(bag)
    assert found.series["attitude"].rate_hz == pytest.approx(50.0, rel=1e-3)
    t, roll = found.channel("roll_rad")
    assert np.allclose(roll, ROLL, atol=1e-6)
    assert np.allclose(t - t[0], T, atol=1e-5)
    assert found.series["reference"].rate_hz == pytest.approx(25.0, rel=1e-3)
    assert np.allclose(found.channel("roll_ref_rad")[1], 0.1)
    assert np.allclose(found.channel("throttle")[1], 0.4)
    assert np.allclose(found.channel("current_a")[1], 10.0), "drawn is positive"
    assert len(found.series["battery"]) == 4
    assert float(found.channel("throttle")[0][0] - t[0]) == pytest.approx(0.001, abs=1e-5)


def test_a_ros_bag_is_read_through_a_column_map_too(bag, tmp_path):
    columns = tmp_path / "columns.yaml"
    columns.write_text(
        "format: columns/1\nframe: {world: ENU, body: FLU}\ncolumns:\n"
        "  p_rad_s: {from: /imu/data.angular_velocity.x}\n  f_z_m_s2: {from: /imu/data.linear_acceleration.z}\n"
    )
    found = import_log(bag, columns)
    assert set(found.series) == {"rates", "specific_force"}
    assert np.allclose(found.channel("p_rad_s")[1], 0.2 * np.cos(T))


def test_half_a_bag_is_read_as_far_as_it_goes(bag, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(bag.read_bytes()[: bag.stat().st_size * 7 // 10])
    found = import_log(cut)
    assert any("damaged after" in loss for loss in found.provenance.losses)
    assert 0.5 * T.size < len(found.series["attitude"]) < T.size
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 10)
    with pytest.raises(RecordingError, match="damaged"):
        import_log(junk)


def test_json_messages_are_columns(tmp_path):
    path = tmp_path / "json.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("state", "jsonschema", b"{}")
        channel = writer.register_channel("/state", "json", schema)
        for t, roll in zip(T, ROLL, strict=True):
            writer.add_message(channel, int(t * 1e9), json.dumps({"roll": roll, "name": "x"}).encode(), int(t * 1e9))
        writer.finish()
    columns = tmp_path / "columns.yaml"
    columns.write_text("format: columns/1\nframe: {world: NWU, body: FLU}\ncolumns:\n  roll_rad: {from: /state.roll}\n")
    assert np.allclose(import_log(path, columns).channel("roll_rad")[1], ROLL)


def test_a_pointer_of_git_lfs_says_how_to_fetch_the_log(tmp_path):
    path = tmp_path / "00000001.BIN"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:d509\nsize 3188569\n")
    with pytest.raises(RecordingError) as caught:
        import_log(path)
    assert "git lfs pull" in caught.value.hint


def test_a_database_bag_says_how_to_convert_it(tmp_path):
    path = tmp_path / "bag.db3"
    path.write_bytes(b"SQLite format 3\0" + bytes(100))
    with pytest.raises(RecordingError) as caught:
        import_log(path)
    assert "ros2 bag convert" in caught.value.hint


def saved(folder, content):
    path = folder / "flight.mat"
    scipy.io.savemat(path, content)
    return path


def test_vectors_named_as_channels(tmp_path):
    found = import_log(saved(tmp_path, {"t": T, "roll_rad": ROLL, "voltage_v": 24.0 - 0.1 * T, "note": "x"}))
    assert np.allclose(found.channel("roll_rad")[1], ROLL)
    assert np.allclose(found.channel("roll_rad")[0], T)


def test_structures_with_times_of_their_own(tmp_path):
    slow = T[::10]
    content = {
        "log": {
            "att": {"t": T, "roll_rad": ROLL, "q": np.tile([1.0, 0, 0, 0], (T.size, 1))},
            "bat": {"time": slow, "voltage_v": 24.0 - slow},
        }
    }
    found = import_log(saved(tmp_path, content))
    assert np.allclose(found.channel("roll_rad")[1], ROLL)
    assert np.allclose(found.channel("voltage_v")[1], 24.0 - slow)
    assert len(found.series["battery"]) == slow.size


@pytest.mark.parametrize("timed", [True, False])
def test_structures_inside_structures_are_named_by_dots_at_any_depth(tmp_path, timed):
    """Of a log with `log.time` and `log.position.x`, `log.time` alone was there."""
    slow = T[::10]
    log = {
        "position": {"x": 2 * T},
        "loops": {"outer": {"gain": 3 * T, "roll_rad": ROLL}},
        "short": {"x": np.arange(5.0)},
        "bat": {"time": slow, "v": 24.0 - slow} if timed else {},
    }
    content = {"log": {"time": T, **log}} if timed else {"log": log}
    columns = tmp_path / "columns.yaml"
    columns.write_text(
        "format: columns/1\nframe: {world: NWU, body: FLU}\n"
        + ("" if timed else f"rate_hz: {1.0 / (T[1] - T[0])}\n")
        + "columns:\n  p_x_m: log.position.x\n  v_x_m_s: log.loops.outer.gain\n  roll_rad: roll_rad\n"
        + ("  voltage_v: log.bat.v\n" if timed else "")
    )
    found = import_log(saved(tmp_path, content), columns)
    for name, values in (("p_x_m", 2 * T), ("v_x_m_s", 3 * T), ("roll_rad", ROLL)):
        t_s, got = found.channel(name)
        assert np.allclose(got, values)
        assert np.allclose(t_s - t_s[0], T - T[0])
    if timed:
        assert np.allclose(found.channel("voltage_v")[1], 24.0 - slow)


def test_simulinks_structure_and_a_timeseries_through_a_column_map(tmp_path):
    content = {
        "out": {"time": T, "signals": {"values": np.stack([ROLL, 2 * ROLL], axis=1), "label": "angles"}},
        "ts": {"Time": T[::2], "Data": np.cos(T[::2])},
    }
    columns = tmp_path / "columns.yaml"
    columns.write_text(
        "format: columns/1\nframe: {world: NWU, body: FLU}\ncolumns:\n"
        "  roll_rad: {from: 'out.angles[0]'}\n  pitch_rad: {from: 'out.angles[1]', unit: deg}\n  v_x_m_s: {from: ts}\n"
    )
    found = import_log(saved(tmp_path, content), columns)
    assert np.allclose(found.channel("roll_rad")[1], ROLL)
    assert np.allclose(found.channel("pitch_rad")[1], np.radians(2 * ROLL))
    assert np.allclose(found.channel("v_x_m_s")[1], np.cos(T[::2]))


def test_matlab_files_that_cannot_be_read_say_why(tmp_path):
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file" + bytes(200))
    with pytest.raises(RecordingError, match=r"7\.3") as caught:
        import_log(path)
    assert "-v7" in caught.value.hint
    held = io.BytesIO()
    scipy.io.savemat(held, {"t": T, "roll_rad": ROLL})
    for size in (40, 130, 300, 2000):
        path.write_bytes(held.getvalue()[:size])
        with pytest.raises(RecordingError):
            import_log(path)
    with pytest.raises(RecordingError, match="no vectors"):
        import_log(saved(tmp_path, {"a": 1.0, "b": "text"}))


def test_a_vector_of_another_length_than_the_times_is_no_column_and_it_is_said(tmp_path):
    """`there is no column 'controller_roll'; it has t_s, pose_x, ...` was said of a file that holds it."""
    path, columns = tmp_path / "flight.mat", tmp_path / "map.yaml"
    scipy.io.savemat(path, {"time": T, "roll": ROLL, "command": {"roll": ROLL[:-7]}})
    columns.write_text("format: columns/1\ncolumns: {t_s: time, roll_rad: roll, roll_ref_rad: command.roll}\n")
    with pytest.raises(RecordingError, match=f"it has {T.size - 7} values, where the times have {T.size}") as caught:
        import_log(path, columns)
    assert "times of its own samples" in str(caught.value.hint)
    columns.write_text("format: columns/1\ncolumns: {t_s: time, roll_rad: roll, roll_ref_rad: command.rol}\n")
    with pytest.raises(RecordingError, match=r"there is no column 'command\.rol'"):
        import_log(path, columns)


def test_a_damaged_matlab_file_never_reaches_the_compiled_reader(tmp_path):
    """A number type that does not exist ended the process in a bus error; field names of no length divide by zero."""
    path = saved(tmp_path, {"log": {"att": {"t": T, "roll_rad": ROLL}}})
    data = path.read_bytes()
    doubles = data.index(bytes([9, 0, 0, 0]) + int(8 * T.size).to_bytes(4, "little"))
    length = data.index(bytes([5, 0, 4, 0]))
    for at, value in ((doubles, 200), (doubles, 8), (length + 4, 0)):
        hurt = bytearray(data)
        hurt[at] = value
        path.write_bytes(hurt)
        with pytest.raises(RecordingError, match="damaged"):
            import_log(path)
    for keyword in ({}, {"do_compression": True}):
        scipy.io.savemat(
            path, {"log": {"t": T, "roll_rad": ROLL, "c": np.array(["a", 2.0], object), "s": "text"}}, **keyword
        )
        assert len(import_log(path).series["attitude"]) == T.size


def test_a_bag_that_says_it_unpacks_to_gigabytes_is_refused(bag, monkeypatch):
    monkeypatch.setattr("flighttest.logs.tables.ros_bag.UNPACKED_BYTES", 1000)
    monkeypatch.setattr("flighttest.logs.tables.ros_bag.UNPACKED_TIMES", 1)
    with pytest.raises(RecordingError, match="unpacks to more"):
        import_log(bag)
