"""Golden recordings of a real ArduCopter (tests/data/README.md): both ways of recording a flight give the same numbers and fit."""

from pathlib import Path

import numpy as np
import pytest

from flighttest.identify.fit import fit
from flighttest.pipeline.recordings.sources import open_recording
from flighttest.segments import cut

TLOGS = ("thrust", "roll_pitch", "yaw_rate")


@pytest.fixture(scope="module")
def data(repository):
    return repository / "tests" / "data"


@pytest.fixture(scope="module")
def onboard(data):
    return open_recording(data / "sitl.BIN.xz")


@pytest.fixture(scope="module")
def ground(data):
    return {name: open_recording(data / f"sitl_{name}.tlog.xz") for name in TLOGS}


@pytest.fixture(scope="module")
def onboard_segments(onboard):
    return _steps(onboard)


@pytest.fixture(scope="module")
def ground_segments(ground):
    return tuple(s for recording in ground.values() for s in _steps(recording))


def _steps(recording):
    """Without the windows between them: what flies the vehicle back is recorded by the onboard log alone."""
    return tuple(s for s in cut(recording) if s.kind != "free")


def test_version_parameters_and_clocks(onboard, ground):
    for recording in (onboard, *ground.values()):
        assert "4.7.0-dev (2598e9d4)" in recording.provenance.firmware
        assert len(recording.provenance.parameters) == 1354
        assert recording.provenance.parameters["GUID_OPTIONS"] == 8.0
    assert onboard.provenance.clock["method"] == "vehicle"
    for recording in ground.values():
        assert recording.provenance.clock["method"] == "timesync"
        assert recording.provenance.clock["error_s"] <= 0.002


# 0.6 s after the first roll step of +0.3 rad, heading south: NED/FRD on the wire and in the log, NWU/FLU here.
GOLDEN = {
    "roll_rad": 0.2947, "pitch_rad": -0.0014, "yaw_rad": -3.1324, "p_rad_s": 0.056, "f_z_m_s2": 10.103, "v_x_m_s": 0.0013,
    "v_y_m_s": 1.0702, "v_z_m_s": -0.0328, "p_x_m": -0.0336, "p_y_m": 0.2889, "p_z_m": 4.9009, "voltage_v": 24.527,
    "roll_ref_rad": 0.3, "throttle": 0.1474, "roll_shaped_rad": 0.2923,
}  # fmt: skip


@pytest.mark.parametrize("name", GOLDEN)
def test_numbers_on_the_wire_and_in_the_log_become_the_same_channels(onboard, ground, name):
    step = next(m.t_s for m in ground["roll_pitch"].markers if m.kind == "phase" and m.label == "step")
    for recording in (onboard, ground["roll_pitch"]):
        t_s, values = recording.channel(name)
        assert np.interp(step + 0.6, t_s, values) == pytest.approx(GOLDEN[name], abs=1e-3)


def test_both_recordings_hold_the_same_responses(onboard_segments, ground_segments):
    seen = {s.name: s for s in ground_segments}
    assert len(onboard_segments) == len(ground_segments) == 16
    for mine in onboard_segments:
        theirs = seen[mine.name]
        assert (mine.kind, dict(mine.cell), mine.flaws) == (theirs.kind, dict(theirs.cell), ())
        assert theirs.flaws == ()
        # The link's delay: the ground's stamp is that of sending, the log's that of arrival.
        assert 0.0 < mine.t_step_s - theirs.t_step_s < 0.012
        assert mine.name.split("/")[0] in TLOGS
    kinds = [s.kind for s in onboard_segments]
    assert [kinds.count(k) for k in ("throttle_step", "roll_step", "pitch_step", "yaw_rate_step")] == [7, 3, 3, 3]


def test_the_vehicle_turns_to_the_side_it_was_asked_to(onboard_segments):
    for s in onboard_segments:
        if s.kind == "throttle_step":
            continue
        channel = {"roll_step": "roll_rad", "pitch_step": "pitch_rad", "yaw_rate_step": "r_rad_s"}[s.kind]
        asked = next(iter(s.cell.values()))
        late = (s.t_s > s.t_step_s + 0.6) & (s.t_s < s.t_step_s + 0.9)
        assert np.mean(s.y[channel][late]) == pytest.approx(asked, rel=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["onboard_segments", "ground_segments"])
def test_a_fit_finds_the_vehicle(source, request):
    found = fit(request.getfixturevalue(source))
    value = {name: e.value for name, e in found.estimates.items()}
    assert all(np.isfinite(v) for v in value.values())
    # Full flights, 115 responses: omega 11.0, zeta 1.07, sigma_r 6.8, K 57 (hover at 0.18 and 22.2 V), drag 0.45; the firmware's shaping
    # and angle loops, no motor lag (sigma_t at its bound or near it).
    for axis in ("phi", "theta"):
        assert value[f"omega_{axis}"] == pytest.approx(11.0, rel=0.05)
        assert value[f"zeta_{axis}"] == pytest.approx(1.07, rel=0.03)
    assert value["sigma_r"] == pytest.approx(6.8, rel=0.1)
    assert value["sigma_t"] > 80.0
    assert value["K"] == pytest.approx(58.5, rel=0.06)
    assert 0.5 < value["alpha"] < 2.8
    assert value["d_x"] == pytest.approx(0.45, rel=0.05)
    assert value["d_y"] == pytest.approx(0.46, rel=0.06)
    assert 0.02 < value["T_d_attitude"] < 0.045
    assert value["T_d_thrust"] < 0.012


def test_trimming_keeps_frames_whole_and_leaves_other_legs_out(data, tmp_path: Path):
    import importlib.util
    import lzma

    spec = importlib.util.spec_from_file_location("trim", data / "trim.py")
    trim = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(trim)
    whole = lzma.decompress((data / "sitl_yaw_rate.tlog.xz").read_bytes())
    part = trim.trim_tlog(whole, ["yaw_rate/yaw+1.00/r1"])
    assert 0 < len(part) < 0.8 * len(whole)
    (tmp_path / "one.tlog").write_bytes(part)
    kept = cut(open_recording(tmp_path / "one.tlog"))
    assert [(s.name, s.flaws) for s in kept] == [("yaw_rate/yaw+1.00/r1", ())]
    log = lzma.decompress((data / "sitl.BIN.xz").read_bytes())
    (tmp_path / "one.BIN").write_bytes(trim.trim_log(log, ["yaw_rate/yaw+1.00/r1"]))
    assert [(s.name, s.flaws) for s in cut(open_recording(tmp_path / "one.BIN"))] == [("yaw_rate/yaw+1.00/r1", ())]
