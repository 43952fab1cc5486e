import gzip
import lzma

import numpy as np
import pytest

from flighttest.errors import RecordingError
from flighttest.logs import import_log


def test_channels_are_si_and_nwu(flight, tmp_path):
    r = import_log(flight().save(tmp_path / "a.BIN"))
    assert r.provenance.importer == "ardupilot_bin"
    assert r.provenance.firmware == "ArduCopter V4.6.0 (0123abcd)"
    assert r.provenance.filters == {"specific_force": 20.0}
    assert r.provenance.parameters["ATC_RAT_RLL_P"] == pytest.approx(0.135)
    assert r.provenance.losses == ()
    rates = r.series["rates"]
    np.testing.assert_allclose(
        [rates.columns[n][0] for n in ("p_rad_s", "q_rad_s", "r_rad_s")], np.radians([10.0, -20.0, -30.0]), rtol=1e-6
    )
    f = r.series["specific_force"]
    np.testing.assert_allclose(
        [f.columns[n][0] for n in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")], [0.1, -0.2, 9.8], rtol=1e-6
    )
    assert np.radians(-1.0) == pytest.approx(r.channel("pitch_rad")[1][0])
    assert r.channel("yaw_rad")[1][0] == pytest.approx(-np.pi / 2)
    v = r.series["velocity"].columns
    assert (v["v_x_m_s"][0], v["v_y_m_s"][0], v["v_z_m_s"][0]) == (1.0, -2.0, 3.0)
    assert r.channel("p_z_m")[1][0] == 5.0
    assert r.channel("voltage_v")[1][0] == 23.5
    assert r.series["attitude"].t_s[0] == pytest.approx(50.0001)


def test_the_reference_is_guia_at_its_arrival(flight, tmp_path):
    r = import_log(flight().save(tmp_path / "a.BIN"))
    t, roll = r.channel("roll_ref_rad")
    edge = int(np.flatnonzero(np.diff(roll) > 0.1)[0]) + 1
    assert t[edge] == pytest.approx(51.0)
    assert roll[edge] == pytest.approx(0.2)
    assert "roll_ref_rad" not in r.provenance.derived
    assert r.provenance.reference_clock == "vehicle"


def test_marks_of_any_sender_become_legs_and_phases(flight, tmp_path):
    r = import_log(flight().save(tmp_path / "a.BIN"))
    legs = [m for m in r.markers if m.kind == "leg"]
    assert [m.label for m in legs] == ["roll_pitch/roll+0.20/r1"]
    assert [m.label for m in r.markers if m.kind == "phase"] == ["step"]
    assert [m.label for m in r.markers if m.kind == "mode"] == ["GUIDED_NOGPS"]
    assert "take-off" in [m.label for m in r.markers]


def test_the_first_of_several_imus_is_taken_and_named(flight, tmp_path):
    r = import_log(flight().save(tmp_path / "a.BIN"))
    assert len(r.series["specific_force"]) == 400
    assert "instance 0 of 0, 1" in r.provenance.clock["IMU"]


def test_without_guia_the_autopilots_targets_are_taken_and_it_is_said(flight, tmp_path):
    w = flight()
    kind = w.kinds["GUIA"][0]
    data = bytes(w.data).replace(b"\xa3\x95" + bytes([kind]), b"\xa3\x95\xc9")
    (tmp_path / "a.BIN").write_bytes(data)
    r = import_log(tmp_path / "a.BIN")
    assert "is taken for the reference" in r.provenance.derived["roll_ref_rad"]
    t, roll = r.channel("roll_ref_rad")
    assert t[np.flatnonzero(np.diff(roll) > 0.1)[0] + 1] == pytest.approx(51.0, abs=0.002)
    assert any("type 201" in loss for loss in r.provenance.losses)


def test_a_clock_that_wraps_goes_on(flight, tmp_path):
    start = 2**32 - 1_500_000
    r = import_log(flight(wrap=True, start_us=start).save(tmp_path / "a.BIN"))
    assert any("wrapped" in loss for loss in r.provenance.losses)
    straight = import_log(flight(start_us=start).save(tmp_path / "b.BIN"))
    for group, series in straight.series.items():
        np.testing.assert_allclose(r.series[group].t_s, series.t_s, atol=1e-6)
    assert straight.provenance.losses == ()


def test_after_a_restart_the_longest_run_is_read_and_it_is_said(flight, tmp_path):
    two = bytes(flight(1.0, start_us=90_000_000).data) + bytes(flight(2.0).data)
    (tmp_path / "a.BIN").write_bytes(two)
    r = import_log(tmp_path / "a.BIN")
    assert any("restarted" in loss for loss in r.provenance.losses)
    assert r.t_span_s[0] == pytest.approx(50.0, abs=0.01)
    assert r.t_span_s[1] == pytest.approx(52.0, abs=0.02)


def test_a_damaged_time_stamp_is_dropped(flight, tmp_path):
    w = flight()
    whole = import_log(w.save(tmp_path / "a.BIN"))
    data = bytearray(w.data)
    kind = w.kinds["IMU"][0]
    at = data.find(b"\xa3\x95" + bytes([kind]), len(data) // 2)
    data[at + 3 + 6] ^= 0x40
    (tmp_path / "b.BIN").write_bytes(data)
    r = import_log(tmp_path / "b.BIN")
    assert any("damaged time stamp" in loss for loss in r.provenance.losses)
    assert r.t_span_s == whole.t_span_s


@pytest.mark.parametrize(("suffix", "pack"), [(".gz", gzip.compress), (".xz", lzma.compress)])
def test_compressed_logs_are_read_as_they_are(flight, attempt, tmp_path, suffix, pack):
    data = bytes(flight(1.0).data)
    plain, packed = tmp_path / "a.BIN", tmp_path / f"b.BIN{suffix}"
    plain.write_bytes(data)
    packed.write_bytes(pack(data))
    a, b = import_log(plain), import_log(packed)
    assert a.provenance.sha256 == b.provenance.sha256 != ""
    np.testing.assert_array_equal(a.channel("f_z_m_s2")[1], b.channel("f_z_m_s2")[1])
    packed.write_bytes(pack(data)[:-2000])
    cut_off = attempt(packed)
    assert isinstance(cut_off, RecordingError) or any("compressed" in loss for loss in cut_off.provenance.losses)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.BIN", b"", "empty"),
        ("a.BIN", b"\xa3\x95\x80" + bytes(500), "dataflash"),
        ("a.BIN", bytes(5000), "not a kind of log"),
        ("a.xyz", b"hello world, this is no log", "not a kind of log"),
        ("a.log", b"[2024-07-29] Current time [s], Position x [m]", "no dataflash log of ArduPilot as text"),
    ],
)
def test_what_is_no_log_is_refused_with_a_remedy(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RecordingError, match=words) as caught:
        import_log(tmp_path / name)
    assert caught.value.hint


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        import_log(tmp_path / "none.BIN")
    with pytest.raises(RecordingError, match="folder"):
        import_log(tmp_path)


def test_damage_never_crashes_and_is_never_silent(flight, attempt, tmp_path):
    rng = np.random.default_rng(5)
    data = bytes(flight(0.6).data)
    path = tmp_path / "a.BIN"
    reported = 0
    for _ in range(60):
        hurt = bytearray(data[: rng.integers(1, len(data))] if rng.random() < 0.5 else data)
        for place in rng.integers(0, len(hurt), rng.integers(1, 30)):
            hurt[place] = rng.integers(0, 256)
        if rng.random() < 0.5 and len(hurt) > 1000:
            a = int(rng.integers(0, len(hurt) - 500))
            del hurt[a : a + int(rng.integers(1, 400))]
        path.write_bytes(hurt)
        r = attempt(path)
        if isinstance(r, RecordingError):
            assert str(path) in str(r)
            continue
        reported += bool(r.provenance.losses)
        assert np.diff(r.t_span_s)[0] < 5.0
    assert reported > 20


def test_old_logs_are_read(shared_data):
    r = import_log(shared_data / "arducopter_logs" / "copter_3.2_2014.BIN")
    assert "3.3-dev" in r.provenance.firmware
    assert r.has("roll_rad", "f_z_m_s2", "throttle", "roll_ref_rad", "mode", "armed")
    assert 0.0 <= np.nanmin(r.channel("throttle")[1]) <= np.nanmax(r.channel("throttle")[1]) <= 1.0
    late = import_log(shared_data / "arducopter_logs" / "copter_3.4_mechanical_failure.bin")
    assert 15.0 < np.nanmedian(late.channel("voltage_v")[1]) < 17.0


@pytest.mark.parametrize(
    ("codes", "labels", "values", "expected"),
    [
        ("Ihhh", "TimeMS,ThrIn,AngBst,ThrOut", (480, 20, 720), 0.70),  # 3.2
        ("Ihhh", "TimeMS,ThrIn,AngBst,ThrOut", (480, -3000, 900), 1.0),  # its height controller asked for 3900
        ("Qhhf", "TimeUS,ThrIn,AngBst,ThrOut", (480, 20, 720.0), 0.70),  # 3.3
        ("Qfff", "TimeUS,ThrIn,AngBst,ThrOut", (0.70, 0.02, 0.72), 0.70),
        ("Qffff", "TimeUS,ThI,ABst,ThO,ThH", (0.70, 0.02, 0.72, 0.71), 0.70),  # 3.4 and later
    ],
)
def test_the_throttle_asked_for_is_no_pilots_stick(dataflash, tmp_path, codes, labels, values, expected):
    """In a mode that holds the height the stick rests at its middle: thrust per throttle was fitted to it."""
    log = with_attitude(dataflash())
    log.format("CTUN", codes, labels)
    ticks_per_s = 1000 if codes[0] == "I" else 1_000_000
    for k in range(100):
        log.write("ATT", 10_000_000 + 20_000 * k, 0, 0, 0, 0, 0, 0)
        log.write("CTUN", round((10 + 0.02 * k) * ticks_per_s), *values)
    r = import_log(log.save(tmp_path / "a.bin"))
    assert r.channel("throttle")[1] == pytest.approx(expected, abs=1e-6)
    assert r.channel("throttle_out")[1] == pytest.approx(0.9 if values[1] == -3000 else 0.72, abs=1e-6)
    assert r.provenance.derived["throttle"].startswith("what went to the motors less the boost for tilt")


def two_rates(log, codes, labels, ctun, out):
    """Throttle in RATE at 50 Hz, by a function of the row, and in CTUN at 10 Hz."""
    log = with_attitude(log)
    log.format("CTUN", codes, labels)
    log.format("RATE", "Qfffffff", "TimeUS,RDes,R,PDes,P,YDes,Y,AOut")
    for k in range(100):
        us = 10_000_000 + 20_000 * k
        log.write("ATT", us, 0, 0, 0, 0, 0, 0)
        log.write("RATE", us, 0, 0, 0, 0, 0, 0, out(k))
        if k % 5 == 0:
            log.write("CTUN", us, *ctun)
    return log


def test_the_throttle_is_read_where_it_is_logged_most_often(dataflash, tmp_path):
    """What a mode that holds its height asks for goes to the motors through a filter of 2 Hz, and was read at 10 Hz beside rates of 400: a
    vehicle's motors had a lag of 0.18 s for 0.055 s."""
    ctun = (0.9, 0.02, 0.4, 0.4)
    log = two_rates(dataflash(), "Qffff", "TimeUS,ThI,ABst,ThO,ThH", ctun, lambda k: 0.4 + 0.001 * k)
    _, throttle = import_log(log.save(tmp_path / "a.bin")).channel("throttle")
    assert np.count_nonzero(np.diff(throttle)) == 99
    assert throttle[[0, -1]] == pytest.approx([0.38, 0.479], abs=1e-6)


def test_the_throttle_of_the_rate_message_has_the_range_of_its_time(dataflash, tmp_path):
    log = two_rates(dataflash(), "Qhhf", "TimeUS,ThrIn,AngBst,ThrOut", (480, 20, 720.0), lambda _: 720.0)
    assert import_log(log.save(tmp_path / "a.bin")).channel("throttle_out")[1] == pytest.approx(0.72)


def test_values_no_vehicle_can_have_are_dropped_and_reported(flight, tmp_path):
    w = flight()
    data = bytearray(w.data)
    at = data.find(b"\xa3\x95" + bytes([w.kinds["ATT"][0]]), len(data) // 2)
    data[at + 3 + 12 : at + 3 + 16] = b"\x00\x00\x80\x7e"  # roll of 8.5e37 degrees
    (tmp_path / "a.BIN").write_bytes(data)
    r = import_log(tmp_path / "a.BIN")
    assert any(loss.startswith("roll_rad: 1 values are impossible") for loss in r.provenance.losses)
    assert np.isnan(r.channel("roll_rad")[1]).sum() == 1


def test_what_is_restored_after_landing_does_not_describe_the_flight(flight, tmp_path):
    w = flight()
    w.write("PARM", 54_000_000, "GUID_OPTIONS", 8.0, 0.0)
    w.write("EV", 54_100_000, 11)
    w.write("PARM", 54_200_000, "GUID_OPTIONS", 0.0, 0.0)
    assert import_log(w.save(tmp_path / "a.bin")).provenance.parameters["GUID_OPTIONS"] == 8.0


def with_attitude(log):
    log.format("ATT", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
    return log


def estimated(log, statuses):
    """1 s per solution status, at 50 Hz, always flying north at 1 m/s by the EKF's estimate."""
    with_attitude(log)
    log.format("XKF1", "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD")
    log.format("XKF4", "QBHB", "TimeUS,C,SS,PI")
    for k in range(50 * len(statuses)):
        us = 10_000_000 + 20_000 * k
        log.write("ATT", us, 0, 0, 0, 0, 0, 0)
        log.write("XKF4", us, 0, statuses[k // 50], 0)
        log.write("XKF1", us, 0, 1.0, 0.5, -2.0, 1.0, 0.5, -3.0)
    return log


CONSTANT_POSITION, WITH_GPS = 0xA5, 0x33F


def test_where_the_ekf_had_no_aiding_its_horizontal_motion_is_not_used(dataflash, tmp_path):
    r = import_log(estimated(dataflash(), [CONSTANT_POSITION, WITH_GPS]).save(tmp_path / "a.bin"))
    t_s, north = r.channel("v_x_m_s")
    assert np.isnan(north[t_s < 11.0]).all()
    assert np.isfinite(north[t_s >= 11.0]).all()
    assert np.isfinite(r.channel("v_z_m_s")[1]).all()
    assert any("for 50% of the time the EKF had neither GPS" in loss for loss in r.provenance.losses)


def test_without_any_aiding_there_is_no_horizontal_motion(dataflash, tmp_path):
    r = import_log(estimated(dataflash(), [CONSTANT_POSITION]).save(tmp_path / "a.bin"))
    assert set(r.series["velocity"].columns) == {"v_z_m_s"}
    assert set(r.series["position"].columns) == {"p_z_m"}
    assert r.has("height_m")


def test_of_two_batteries_the_one_that_shows_its_voltage_is_read(dataflash, tmp_path):
    log = with_attitude(dataflash())
    log.format("BAT", "QBff", "TimeUS,Inst,Volt,Curr")
    for k in range(100):
        log.write("ATT", 10_000_000 + 20_000 * k, 0, 0, 0, 0, 0, 0)
        log.write("BAT", 10_000_000 + 20_000 * k, 0, 0.0, 12.0)
        log.write("BAT", 10_000_000 + 20_000 * k, 1, 23.0, 0.0)
    assert import_log(log.save(tmp_path / "a.bin")).channel("voltage_v")[1].min() == pytest.approx(23.0)


@pytest.mark.parametrize(
    ("labels", "functions", "expected"),
    [
        ("C1,C2,C3,C4,C5,C6", {}, [0.1, 0.2, 0.3, 0.4]),
        ("Ch1,Ch2,Ch3,Ch4,Ch5,Ch6", {}, [0.1, 0.2, 0.3, 0.4]),  # Copter 3.2
        ("C1,C2,C3,C4,C5,C6", {1: 36, 2: 34, 4: 33, 6: 35}, [0.4, 0.2, 0.6, 0.1]),
        ("C1,C2,C3,C4,C5,C6", {k: 32 + k for k in range(1, 7)}, None),  # six motors
        ("C1,C2", {}, None),
    ],
)
def test_the_commands_of_four_motors_are_those_of_the_outputs_that_they_are_on(
    dataflash, tmp_path, labels, functions, expected
):
    log = with_attitude(dataflash())
    log.format("PARM", "QNff", "TimeUS,Name,Value,Default")
    count = labels.count(",") + 1
    log.format("RCOU", "Q" + "H" * count, f"TimeUS,{labels}")
    for output, function in functions.items():
        log.write("PARM", 10_000_000, f"SERVO{output}_FUNCTION", float(function), 0.0)
    for k in range(100):
        log.write("ATT", 10_000_000 + 20_000 * k, 0, 0, 0, 0, 0, 0)
        log.write("RCOU", 10_000_000 + 20_000 * k, *(1100 + 100 * n for n in range(count)))
    r = import_log(log.save(tmp_path / "a.bin"))
    found = [r.channel(f"motor_{k}")[1][0] for k in range(1, 5)] if r.has("motor_1") else None
    assert found == (expected and pytest.approx(expected))


def test_rates_without_an_attitude_are_no_level_attitude(dataflash, tmp_path):
    log = with_attitude(dataflash())
    log.format("GUIA", "QBffffffff", "TimeUS,Type,Roll,Pitch,Yaw,RollRt,PitchRt,YawRt,Thrust,ClimbRt")
    for k in range(100):
        log.write("ATT", 10_000_000 + 20_000 * k, 0, 5, 0, 0, 0, 0)
        log.write("GUIA", 10_000_000 + 20_000 * k, 6, 0, 0, 0, 30.0 if 40 < k < 50 else 0.0, 0, 10.0, 0.3, 0)
    r = import_log(log.save(tmp_path / "a.bin"))
    assert not r.has("roll_ref_rad")
    assert r.channel("yaw_rate_ref_rad_s")[1][0] == pytest.approx(-np.radians(10.0))
    assert r.channel("throttle")[1][0] == pytest.approx(0.3)


def test_where_no_command_was_logged_the_yaw_rate_asked_for_is_that_of_the_heading_target(dataflash, tmp_path):
    """RATE.YDes holds the correction of the heading error: beside it sigma_r was fitted to what the yaw rate itself had caused."""
    log = with_attitude(dataflash())
    log.format("RATE", "Qfffffff", "TimeUS,RDes,R,PDes,P,YDes,Y,AOut")
    # 30 deg/s for a second, 8 degrees within a sample (400 deg/s), and full stick of a brisk vehicle: 250 deg/s
    turned = np.concatenate([np.full(50, 350.0), 350.0 + 0.6 * np.arange(1, 51), np.full(50, 388.0)])
    heading = np.concatenate([turned, 388.0 + 5.0 * np.arange(1, 11)]) % 360.0
    for k, desired in enumerate(heading):
        log.write("ATT", 10_000_000 + 20_000 * k, 0, 0, 0, 0, desired, 10.0)
        log.write("RATE", 10_000_000 + 20_000 * k, 0, 0, 0, 0, 57.0, 20.0, 0)
    r = import_log(log.save(tmp_path / "a.bin"))
    t_s, asked = r.channel("yaw_rate_ref_rad_s")
    since = t_s - r.channel("yaw_rad")[0][0]
    assert asked[(since > 0.02) & (since < 0.98)] == pytest.approx(0.0, abs=1e-9)
    clockwise = -np.radians(30.0)  # through north
    assert asked[(since > 1.0) & (since < 1.98)] == pytest.approx(clockwise, rel=1e-4)
    (reset,) = asked[(since > 1.985) & (since < 1.995)]
    assert np.isnan(reset)  # the target was set anew
    assert asked[(since > 2.02) & (since < 2.98)] == pytest.approx(0.0, abs=1e-9)
    assert asked[since > 3.0] == pytest.approx(-np.radians(250.0), rel=1e-4)
    assert r.channel("yaw_rate_shaped_rad_s")[1] == pytest.approx(-np.radians(57.0))
    assert "own target" in r.provenance.derived["yaw_rate_ref_rad_s"]


@pytest.mark.parametrize(
    ("subsystem", "code", "said"),
    [
        (12, 1, "autopilot error: crash check (12/1)"), (16, 0, "autopilot error resolved: EKF check (16/0)"),
        (10, 0, "autopilot error: flight mode refused (10/0)"), (77, 3, "autopilot error: unknown subsystem (77/3)"),
    ],
)  # fmt: skip
def test_an_error_of_the_autopilot_has_a_name(flight, tmp_path, subsystem, code, said):
    w = flight()
    w.format("ERR", "QBB", "TimeUS,Subsys,ECode")
    w.write("ERR", 54_100_000, subsystem, code)
    assert said in [m.label for m in import_log(w.save(tmp_path / "a.BIN")).markers]
