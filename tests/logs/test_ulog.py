import numpy as np
import pytest

from flighttest.errors import RecordingError
from flighttest.logs import import_log


def test_px4_topics_become_channels(tmp_path, ulog_bytes):
    (tmp_path / "a.ulg").write_bytes(ulog_bytes())
    r = import_log(tmp_path / "a.ulg")
    assert r.provenance.importer == "ulg"
    assert r.provenance.losses == ()
    assert r.provenance.parameters["THR_MDL_FAC"] == pytest.approx(0.3)
    assert r.channel("roll_rad")[1][0] == pytest.approx(0.1)
    assert r.channel("pitch_ref_rad")[1][0] == pytest.approx(-0.2)
    assert r.channel("yaw_rate_ref_rad_s")[1][0] == pytest.approx(-0.5)
    assert r.channel("throttle")[1][0] == pytest.approx(0.4)
    f = [r.channel(n)[1][0] for n in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")]
    assert f == pytest.approx([0.5, -0.25, 9.75])
    assert r.channel("r_rad_s")[1][0] == pytest.approx(-0.3)
    assert r.channel("armed")[1][0] == 1.0
    assert [r.channel(f"motor_{k}")[1][0] for k in range(1, 5)] == pytest.approx([0.4, 0.5, 0.6, 0.7])
    assert r.series["attitude"].t_s[0] == pytest.approx(1.0)
    assert [m.label for m in r.markers if m.kind == "mode"] == ["OFFBOARD"]


def test_six_motors_are_not_four(tmp_path, ulog_bytes):
    (tmp_path / "a.ulg").write_bytes(ulog_bytes(fifth=0.5))
    assert not import_log(tmp_path / "a.ulg").has("motor_1")


def test_damage_never_crashes(attempt, tmp_path, ulog_bytes):
    rng = np.random.default_rng(11)
    data = ulog_bytes()
    path = tmp_path / "a.ulg"
    read = 0
    for _ in range(30):
        hurt = bytearray(data[: rng.integers(8, len(data))] if rng.random() < 0.5 else data)
        for place in rng.integers(0, len(hurt), rng.integers(1, 20)):
            hurt[place] = rng.integers(0, 256)
        path.write_bytes(hurt)
        r = attempt(path)
        read += not isinstance(r, RecordingError)
        assert not isinstance(r, RecordingError) or "a.ulg" in str(r)
    assert read > 3
