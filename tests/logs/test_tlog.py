import struct
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v10 import ardupilotmega as v1
from pymavlink.dialects.v20 import ardupilotmega as v2

from flighttest.errors import RecordingError
from flighttest.logs import import_log, tlog
from flighttest.logs.timing import clock_steps
from flighttest.mavlink.tlog_frames import fields_of, good_checksums, split

EPOCH_S = 1_750_000_000.0


class TlogWriter:
    def __init__(self, dialect=v2):
        self.dialect = dialect
        self.data = bytearray()
        self.senders = {}

    def add(self, t_s, message, system=1, component=1):
        mav = self.senders.setdefault(
            (system, component), self.dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        )
        frame = message.pack(mav)
        mav.seq = (mav.seq + 1) % 256
        self.data += struct.pack(">Q", round((EPOCH_S + t_s) * 1e6)) + frame


def link(dialect=v2, seconds=4.0, up_s=0.0, down_s=0.01, parameter=True, kind=v2.MAV_TYPE_QUADROTOR):
    """A vehicle, of a MAV_TYPE, that began 20 s before its log, attitude at 50 Hz, and a ground that asks for a roll step at 2 s."""
    w = TlogWriter(dialect)
    for k in range(round(seconds * 50)):
        t = k / 50.0
        boot = 20.0 + t
        if k % 50 == 0:
            w.add(t + down_s, dialect.MAVLink_heartbeat_message(kind, 3, 128 | 1, 20, 4, 3))
            w.add(t, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), system=255, component=190)
        w.add(t + down_s, dialect.MAVLink_attitude_message(round(boot * 1e3), 0.1, 0.2, 0.3, 0.01, 0.02, 0.03))
        roll = 0.25 if t >= 2.0 else 0.0
        q = [np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0]
        target = dialect.MAVLink_set_attitude_target_message(round(boot * 1e3), 1, 1, 0, q, 0.0, 0.0, -0.5, 0.3)
        w.add(t - up_s + 1e-4 * (k % 5), target, system=255, component=190)  # no real clock steps in whole ms
    if parameter:
        w.add(seconds, dialect.MAVLink_param_value_message(b"INS_ACCEL_FILTER", 30.0, 9, 1, 0))
    return w


@pytest.mark.parametrize("dialect", [v1, v2])
def test_both_directions_land_on_the_vehicles_clock(tmp_path, dialect):
    (tmp_path / "a.tlog").write_bytes(link(dialect).data)
    r = import_log(tmp_path / "a.tlog")
    assert r.provenance.importer == "tlog"
    assert r.provenance.reference_clock == "ground"
    assert r.provenance.losses == ()
    assert r.provenance.filters["specific_force"] == 30.0
    attitude = r.series["attitude"]
    assert attitude.t_s[0] == pytest.approx(20.0)
    assert [attitude.columns[n][0] for n in ("roll_rad", "pitch_rad", "yaw_rad")] == pytest.approx([0.1, -0.2, -0.3])
    t, roll = r.channel("roll_ref_rad")
    assert t[np.flatnonzero(np.diff(roll) > 0.1)[0] + 1] == pytest.approx(22.0, abs=0.015)
    assert r.channel("yaw_rate_ref_rad_s")[1][0] == pytest.approx(0.5)
    assert r.provenance.clock["error_s"] > 0


@pytest.mark.parametrize("targets", [True, False])
def test_what_every_ground_station_records_holds_references_where_there_are_no_better_ones(tmp_path, targets):
    """ArduCopter's NAV_CONTROLLER_OUTPUT is its attitude target, in degrees; four of five telemetry logs at 4 Hz had no ATTITUDE_TARGET
    and were refused."""
    w = TlogWriter()
    for k in range(80):
        t, boot_ms = k / 4.0, round((20.0 + k / 4.0) * 1e3)
        if k % 4 == 0:
            w.add(t, v2.MAVLink_heartbeat_message(2, 3, 128 | 1, 5, 4, 3))
        w.add(t, v2.MAVLink_attitude_message(boot_ms, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
        w.add(t, v2.MAVLink_nav_controller_output_message(10.0, 5.0, 90, 0, 0, 0.0, 0.0, 0.0))
        w.add(t, v2.MAVLink_vfr_hud_message(0.0, 0.0, 90, 37, 10.0, 0.0))
        if targets:
            q = [np.cos(0.1), np.sin(0.1), 0.0, 0.0]
            w.add(t, v2.MAVLink_attitude_target_message(boot_ms, 0, q, 0.0, 0.0, -0.5, 0.31))
    (tmp_path / "a.tlog").write_bytes(w.data)
    r = import_log(tmp_path / "a.tlog")
    found = {n: r.channel(n)[1][5] for n in ("roll_ref_rad", "pitch_ref_rad", "roll_shaped_rad", "throttle")}
    if targets:
        assert found == pytest.approx(
            {"roll_ref_rad": 0.2, "pitch_ref_rad": 0.0, "roll_shaped_rad": 0.2, "throttle": 0.31}
        )
        assert r.channel("yaw_rate_ref_rad_s")[1][5] == pytest.approx(0.5)
        assert r.provenance.reference_clock == "vehicle"
        return
    roll, pitch = np.radians([10.0, 5.0])
    expected = {"roll_ref_rad": roll, "pitch_ref_rad": -pitch, "roll_shaped_rad": roll, "throttle": 0.37}
    assert found == pytest.approx(expected)
    assert not r.has("yaw_rate_ref_rad_s")
    assert "NAV_CONTROLLER_OUTPUT" in r.provenance.derived["roll_shaped_rad"]
    assert "VFR_HUD" in r.provenance.derived["throttle"]
    assert r.provenance.reference_clock == "ground"  # delays hold the error of the clock


def test_an_accelerometer_filter_that_was_not_recorded_is_assumed_and_said(tmp_path):
    (tmp_path / "a.tlog").write_bytes(link(parameter=False).data)
    r = import_log(tmp_path / "a.tlog")
    assert r.provenance.filters["specific_force"] == 20.0
    assert any("INS_ACCEL_FILTER was not recorded" in loss for loss in r.provenance.losses)


def test_frames_and_fields_are_pymavlinks():
    w = link(seconds=2.0)
    w.add(3.0, v2.MAVLink_battery_status_message(0, 0, 0, 2500, [16000] * 10, -1, 5, -1, 100))
    frames = split(bytes(w.data))
    assert frames.lost == ()
    attitude = frames.where(frames.kind == 30)
    assert good_checksums(attitude, 30).all()
    assert fields_of(attitude, 30)["pitch"][7] == np.float32(0.2)
    battery = fields_of(frames.where(frames.kind == 147), 147)
    assert battery["voltages"].shape == (1, 10)
    assert battery["current_battery"][0] == -1
    targets = fields_of(frames.where(frames.kind == 82), 82)
    assert targets["q"].shape == (100, 4)


def test_a_wrong_checksum_drops_the_message_and_is_reported(tmp_path):
    w = link()
    data = bytearray(w.data)
    at = split(bytes(data)).where(slice(20, 21)).payload[0]
    data[at + 2] ^= 0x10
    (tmp_path / "a.tlog").write_bytes(data)
    r = import_log(tmp_path / "a.tlog")
    assert any("1 of" in loss and "checksum" in loss for loss in r.provenance.losses)


def test_lost_bytes_are_counted_and_located(tmp_path):
    data = bytearray(link().data)
    before, place = (int(x) for x in split(bytes(data)).at[[49, 50]])
    del data[place + 4 : place + 20]
    (tmp_path / "a.tlog").write_bytes(data)
    r = import_log(tmp_path / "a.tlog")
    # The frame before the hole counts as lost too: nothing confirms where it ends.
    assert any("bytes could not be read" in loss and f"at {before}" in loss for loss in r.provenance.losses)
    assert len(r.series["attitude"]) + len(r.series["reference"]) >= 397


def test_messages_that_never_arrived_are_reported(tmp_path):
    w = link()
    frames = split(bytes(w.data))
    keep = np.ones(frames.at.size, dtype=bool)
    keep[100:130] = False
    ends = np.append(frames.at[1:], len(w.data))
    (tmp_path / "a.tlog").write_bytes(
        b"".join(bytes(w.data[a:b]) for a, b, k in zip(frames.at, ends, keep, strict=True) if k)
    )
    assert any("never arrived" in loss for loss in import_log(tmp_path / "a.tlog").provenance.losses)


def test_of_several_vehicles_one_is_read_and_the_others_named(tmp_path):
    w = link()
    w.add(4.0, v2.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), system=7)
    (tmp_path / "a.tlog").write_bytes(w.data)
    r = import_log(tmp_path / "a.tlog")
    assert any("several vehicles; system 1 was read, not 7" in loss for loss in r.provenance.losses)


@pytest.mark.parametrize("data", [bytes(4000), b"no frames in here, only text " * 50])
def test_what_holds_no_frame_is_refused(tmp_path, data):
    (tmp_path / "a.tlog").write_bytes(data)
    with pytest.raises(RecordingError, match="no MAVLink frame"):
        import_log(tmp_path / "a.tlog")


def test_damage_never_crashes(attempt, tmp_path):
    rng = np.random.default_rng(7)
    data = bytes(link(seconds=2.0).data)
    path = tmp_path / "a.tlog"
    for _ in range(30):
        hurt = bytearray(data[: rng.integers(1, len(data))] if rng.random() < 0.5 else data)
        for place in rng.integers(0, len(hurt), rng.integers(1, 30)):
            hurt[place] = rng.integers(0, 256)
        path.write_bytes(hurt)
        r = attempt(path)
        assert str(path) in str(r) if isinstance(r, RecordingError) else r.provenance.losses


def test_what_is_restored_after_landing_does_not_describe_the_flight(tmp_path):
    dialect, w = v2, link()
    w.add(4.01, dialect.MAVLink_param_value_message(b"GUID_OPTIONS", 8.0, 9, 1, 0))
    w.add(4.5, dialect.MAVLink_heartbeat_message(2, 3, 129, 20, 4, 3))
    w.add(5.0, dialect.MAVLink_heartbeat_message(2, 3, 1, 20, 4, 3))
    w.add(5.5, dialect.MAVLink_param_value_message(b"GUID_OPTIONS", 0.0, 9, 1, 0))
    w.add(5.6, dialect.MAVLink_param_value_message(b"MOT_SPIN_MIN", 0.15, 9, 1, 0))
    (tmp_path / "a.tlog").write_bytes(w.data)
    parameters = import_log(tmp_path / "a.tlog").provenance.parameters
    assert parameters["GUID_OPTIONS"] == 8.0
    assert parameters["MOT_SPIN_MIN"] == pytest.approx(0.15), "first heard of after landing, and true all the same"


def read(w, path):
    path.write_bytes(w.data)
    return import_log(path)


def test_targets_for_another_vehicle_are_not_this_ones(tmp_path):
    w = link()
    for k in range(200):
        t = k / 50.0
        target = v2.MAVLink_set_attitude_target_message(0, 7, 1, 0, [0.9, np.sqrt(0.19), 0.0, 0.0], 0, 0, 0, 0.9)
        w.add(t + 0.003, target, system=255, component=190)
    r = read(w, tmp_path / "a.tlog")
    assert set(np.round(r.channel("roll_ref_rad")[1], 3)) == {0.0, 0.25}
    assert r.channel("throttle")[1].max() == pytest.approx(0.3)


def test_targets_of_a_companion_computer_under_the_vehicles_own_id_count(tmp_path):
    w = TlogWriter()
    w.data = bytearray()
    for k in range(200):
        t = k / 50.0
        if k % 50 == 0:
            w.add(t, v2.MAVLink_heartbeat_message(2, 3, 129, 20, 4, 3))
        w.add(t + 0.01, v2.MAVLink_attitude_message(round((20 + t) * 1e3), 0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
        w.add(t, v2.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0, 0, 0], 0, 0, 0, 0.4), component=240)
    assert read(w, tmp_path / "a.tlog").channel("throttle")[1][0] == pytest.approx(0.4)


def test_what_a_gimbal_and_a_camera_say_under_the_vehicles_id_is_not_the_vehicles(tmp_path):
    w = link()
    for k in range(40):
        t = k / 10.0
        w.add(t + 0.02, v2.MAVLink_heartbeat_message(26, 3, 0, 0, 4, 3), component=154)
        w.add(t + 0.02, v2.MAVLink_attitude_message(round(t * 1e3), 0.7, 0.0, 0.0, 0.0, 0.0, 0.0), component=100)
    r = read(w, tmp_path / "a.tlog")
    assert set(r.channel("mode")[1]) == {20.0}
    assert set(r.channel("armed")[1]) == {1.0}
    assert r.channel("roll_rad")[1].max() == pytest.approx(0.1)
    assert not any("restarted" in loss for loss in r.provenance.losses)


@pytest.mark.parametrize(("kind", "beats"), [(5, 400), (2, 400)])
def test_of_several_systems_the_one_that_flew_is_read(tmp_path, kind, beats):
    w = TlogWriter()
    for k in range(beats):  # an antenna tracker, or a vehicle that stays on the ground
        w.add(k / 100.0, v2.MAVLink_heartbeat_message(kind, 3, 0, 0, 4, 3), system=2)
    w.data += link().data
    assert read(w, tmp_path / "a.tlog").provenance.clock["system"] == 1


def test_targets_in_a_mode_that_drops_them_are_no_reference(tmp_path):
    w = TlogWriter()
    for k in range(400):
        t = k / 50.0
        if k % 50 == 0:
            w.add(t + 0.01, v2.MAVLink_heartbeat_message(2, 3, 129, 20 if t < 5.0 else 5, 4, 3))
        w.add(t + 0.01, v2.MAVLink_attitude_message(round((20 + t) * 1e3), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        target = v2.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0, 0, 0], 0, 0, 0, 0.4)
        w.add(t, target, system=255, component=190)
    r = read(w, tmp_path / "a.tlog")
    t_s, throttle = r.channel("throttle")
    assert t_s[np.isfinite(throttle)][-1] == pytest.approx(24.0, abs=0.05)
    assert any("the autopilot drops what is sent in another mode" in loss for loss in r.provenance.losses)


def test_a_battery_that_is_not_measured_is_no_battery_at_zero_volts(tmp_path):
    w = link()
    for k in range(40):
        w.add(k / 10.0 + 0.02, v2.MAVLink_sys_status_message(0, 0, 0, 0, 0, -1, -1, 0, 0, 0, 0, 0, 0))
        w.add(k / 10.0 + 0.02, v2.MAVLink_rangefinder_message(0.0, 0.0))
    r = read(w, tmp_path / "a.tlog")
    assert not r.has("voltage_v")
    assert not r.has("height_m")
    assert any("no battery monitor" in loss for loss in r.provenance.losses)


def test_cells_beyond_the_tenth_are_counted(tmp_path):
    w = link()
    for k in range(40):
        battery = v2.MAVLink_battery_status_message(0, 0, 0, 0, [4000] * 10, 100, 0, 0, 50, 0, 0, [4000, 4000, 0, 0])
        w.add(k / 10.0 + 0.02, battery)
    assert read(w, tmp_path / "a.tlog").channel("voltage_v")[1][0] == pytest.approx(48.0)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, -5.0, 2e7])
def test_a_ground_clock_that_was_set_while_it_recorded_moves_nothing(tmp_path, step_s):
    data = bytes(link(seconds=40.0, down_s=0.03).data)
    frames = split(data)
    out = bytearray()
    for a, b, stamp in zip(frames.at, np.append(frames.at[1:], len(data)), frames.stamp_us, strict=True):
        later = step_s if stamp > (EPOCH_S + 1.0) * 1e6 else 0.0
        out += struct.pack(">Q", int(stamp + later * 1e6)) + data[a + 8 : b]
    (tmp_path / "a.tlog").write_bytes(out)
    r = import_log(tmp_path / "a.tlog")
    t_s, roll = r.channel("roll_ref_rad")
    assert t_s[np.flatnonzero(np.diff(roll) > 0.1)[0] + 1] == pytest.approx(22.0, abs=0.005)
    assert r.series["state"].t_s[-1] == pytest.approx(59.0, abs=0.05)
    assert any("was set 1 times" in loss for loss in r.provenance.losses)


def test_a_link_that_stalls_is_no_step_of_the_clock(tmp_path):
    data = bytes(link(seconds=40.0).data)
    frames = split(data)
    begin, end = (EPOCH_S + 10.0) * 1e6, (EPOCH_S + 14.0) * 1e6
    out = bytearray()
    for a, b, stamp in zip(frames.at, np.append(frames.at[1:], len(data)), frames.stamp_us, strict=True):
        out += struct.pack(">Q", int(end if begin < stamp < end else stamp)) + data[a + 8 : b]
    (tmp_path / "a.tlog").write_bytes(out)
    made_s = np.arange(2000) / 50.0
    jitter_s = np.random.default_rng(0).uniform(0.005, 0.02, made_s.size)
    assert not clock_steps(np.where((made_s > 10) & (made_s < 14), 14.0, made_s) + jitter_s, made_s).any()
    assert not any("clock" in loss for loss in import_log(tmp_path / "a.tlog").provenance.losses)


def test_thrust_that_was_a_climb_rate_is_no_throttle(tmp_path):
    w = link()
    w.add(4.0, v2.MAVLink_param_value_message(b"GUID_OPTIONS", 0.0, 9, 1, 0))
    bare = read(w, tmp_path / "a.tlog")
    assert not bare.has("throttle")
    assert any("climb rates" in loss for loss in bare.provenance.losses)
    for k in range(200):
        t = k / 50.0
        own = v2.MAVLink_attitude_target_message(round((20 + t) * 1e3), 0, [1.0, 0, 0, 0], 0, 0, 0, 0.42)
        w.add(t + 0.01, own)
    r = read(w, tmp_path / "a.tlog")
    assert r.channel("throttle")[1][-1] == pytest.approx(0.42)
    assert r.channel("roll_ref_rad")[1][-1] == pytest.approx(0.25)
    assert "climb rates" in r.provenance.derived["throttle"]


def test_frames_that_overtook_one_another_are_no_loss():
    order = np.arange(2000)
    order[100:1900:50], order[101:1901:50] = order[101:1901:50].copy(), order[100:1900:50].copy()
    frames = SimpleNamespace(sender=np.full(2000, 257), sequence=order % 256)
    assert tlog.missing_messages(frames) == []
    lossy = SimpleNamespace(sender=np.full(1800, 257), sequence=order[order % 10 != 0] % 256)
    (said,) = tlog.missing_messages(lossy)
    assert "(10.0 %)" in said
