"""Logs of vehicles that are no multirotors are refused by what their autopilot says it drives; quadplanes and VTOL aircraft are read."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as v2

from flighttest.errors import RecordingError
from flighttest.logs import import_log
from tests.logs.test_tlog import TlogWriter, link


def dataflash_of(flight, firmware, quadplane):
    log = flight(1.0)
    was = b"ArduCopter V4.6.0 (0123abcd)"
    log.data = log.data.replace(was, firmware.encode().ljust(len(was), b"\0"))
    if quadplane:
        log.write("PARM", 51_000_000, "Q_ENABLE", 1.0, 0.0)
    return log.data


@pytest.mark.parametrize(
    ("firmware", "kind"),
    [
        ("ArduPlane V4.5.0 (fa0f089f)", "a fixed-wing aircraft"),
        ("ArduRover V4.5.0 (fa0f089f)", "a rover or boat"),
        ("ArduSub V4.1.0 (fa0f089f)", "a submarine"),
        ("APM:Copter V3.4.4 (65ffe9d7)", ""),
    ],
)
def test_a_dataflash_log_names_the_firmware(tmp_path, flight, firmware, kind):
    path = tmp_path / "a.BIN"
    path.write_bytes(dataflash_of(flight, firmware, quadplane=False))
    if kind:
        with pytest.raises(RecordingError, match=f"the log of {kind} \\({firmware[:8]}.*model is that of a multirotor"):
            import_log(path)
    else:
        assert import_log(path).provenance.firmware == firmware


def test_a_quadplane_hovers_as_a_multirotor(tmp_path, flight):
    path = tmp_path / "a.BIN"
    path.write_bytes(dataflash_of(flight, "ArduPlane V4.5.0 (fa0f089f)", quadplane=True))
    assert import_log(path).provenance.firmware.startswith("ArduPlane")
    telemetry = link(kind=v2.MAV_TYPE_FIXED_WING)
    telemetry.add(4.0, v2.MAVLink_param_value_message(b"Q_ENABLE", 1.0, 9, 2, 1))
    (tmp_path / "a.tlog").write_bytes(telemetry.data)
    assert import_log(tmp_path / "a.tlog").provenance.parameters["Q_ENABLE"] == 1.0


def quadplane_log(modes):
    """A quadplane's telemetry whose HEARTBEATs, one a second, state these modes."""
    log = TlogWriter()
    for k in range(50 * len(modes)):
        t, boot_ms = k / 50.0, round((20.0 + k / 50.0) * 1e3)
        if k % 50 == 0:
            log.add(t, v2.MAVLink_heartbeat_message(v2.MAV_TYPE_FIXED_WING, 3, 128 | 1, modes[k // 50], 4, 3))
        log.add(t, v2.MAVLink_attitude_message(boot_ms, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
        log.add(t, v2.MAVLink_attitude_target_message(boot_ms, 0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.4))
    log.add(len(modes) - 0.1, v2.MAVLink_param_value_message(b"Q_ENABLE", 1.0, 9, 2, 1))
    return log.data


def test_what_a_quadplane_flies_on_its_wing_is_not_used(tmp_path):
    """Of a simulated one 84 s of 143 s of "free flight" were at up to 28 m/s in CIRCLE and GUIDED, called ACRO and AUTOTUNE; two effects of
    the autopilot were named by them."""
    (tmp_path / "a.tlog").write_bytes(quadplane_log([19, 19, 1, 1, 15, 15, 20, 20]))
    recording = import_log(tmp_path / "a.tlog")
    assert [m.label for m in recording.markers if m.kind == "mode"] == ["QLOITER", "CIRCLE", "GUIDED", "QLAND"]
    t, throttle = recording.channel("throttle")
    begin = recording.channel("mode")[0][0]
    asked = (t < begin + 1.9) | (t > begin + 6.1)
    assert np.isfinite(throttle[asked]).all()
    assert not np.isfinite(throttle[(t > begin + 2.1) & (t < begin + 5.9)]).any()
    assert any("quadplane" in loss for loss in recording.provenance.losses)


def test_a_quadplane_that_never_hovered_is_refused(tmp_path):
    (tmp_path / "a.tlog").write_bytes(quadplane_log([10, 10, 27]))
    with pytest.raises(RecordingError, match=r"never in a Q mode.*mode AUTO"):
        import_log(tmp_path / "a.tlog")


@pytest.mark.parametrize(
    ("mav_type", "kind"),
    [
        (v2.MAV_TYPE_FIXED_WING, "a fixed-wing aircraft"), (v2.MAV_TYPE_GROUND_ROVER, "a rover"), (v2.MAV_TYPE_SUBMARINE, "a submarine"),
        (v2.MAV_TYPE_HEXAROTOR, ""), (v2.MAV_TYPE_VTOL_TILTROTOR, ""), (v2.MAV_TYPE_GENERIC, ""),
    ],
)  # fmt: skip
def test_a_telemetry_log_holds_the_type_of_the_vehicle(tmp_path, mav_type, kind):
    path = tmp_path / "a.tlog"
    path.write_bytes(link(kind=mav_type).data)
    if kind:
        with pytest.raises(RecordingError, match=f"the log of {kind} "):
            import_log(path)
    else:
        assert "attitude" in import_log(path).series


@pytest.mark.parametrize(
    ("kinds", "vtol", "kind"),
    [((0, 2), False, "a fixed-wing aircraft"), ((3,), False, "a rover"), ((0, 1), False, ""), ((1, 2), True, ""), ((2,), True, "")],
)  # fmt: skip
def test_a_px4_log_holds_what_px4_takes_the_vehicle_for(tmp_path, ulog_bytes, kinds, vtol, kind):
    path = tmp_path / "a.ulg"
    path.write_bytes(ulog_bytes(kinds=kinds, vtol=vtol))
    if kind:
        with pytest.raises(RecordingError, match=f"the log of {kind} "):
            import_log(path)
    else:
        assert "attitude" in import_log(path).series


@pytest.mark.parametrize(("kinds", "used"), [((1, 2), False), ((2, 1), True)])
def test_what_a_vtol_aircraft_of_px4_flies_on_its_wing_is_not_used(tmp_path, ulog_bytes, kinds, used):
    path = tmp_path / "a.ulg"
    path.write_bytes(ulog_bytes(kinds=kinds, vtol=True))
    recording = import_log(path)
    assert np.isfinite(recording.channel("throttle")[1]).all() == used
    assert np.isfinite(recording.channel("roll_rad")[1]).all()
    assert any("VTOL" in loss for loss in recording.provenance.losses)
