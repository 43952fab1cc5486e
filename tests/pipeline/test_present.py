"""`status --connect`: the vehicle as it is now against a model's fingerprint; it asks, and does nothing else."""

import json

import pytest
import yaml

from flighttest.cli import main as cli_main
from flighttest.link.port import MavlinkPort
from flighttest.pipeline.vehicles import live as present
from flighttest.vehicle.fingerprint import fingerprint


@pytest.fixture(scope="module")
def seen():
    """The built-in vehicle as read, and the names of all messages that were sent to it."""
    sent = []
    usual = MavlinkPort.send

    def watched(port, message):
        sent.append((message.get_type(), getattr(message, "command", None)))
        return usual(port, message)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MavlinkPort, "send", watched)
        found = present.read_vehicle("sim")
    return found, sent


@pytest.mark.slow
def test_it_asks_and_does_nothing_else(seen):
    found, sent = seen
    assert found.firmware.startswith("ArduCopter")
    assert len(found.parameters) > 50
    assert {name for name, _ in sent} <= {
        "HEARTBEAT",
        "TIMESYNC",
        "PARAM_REQUEST_LIST",
        "PARAM_REQUEST_READ",
        "COMMAND_LONG",
    }
    assert {command for name, command in sent if name == "COMMAND_LONG"} <= {512}, "REQUEST_MESSAGE alone"


@pytest.fixture
def status(seen, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(present, "read_vehicle", lambda *_: seen[0])

    def run(change=None, components=None):
        carried = fingerprint(None, seen[0].firmware, {**seen[0].parameters, **(change or {})}).as_data()
        model = {
            "format": "model/1",
            "terms": ["body"],
            "parameters": {"K": {"value": 54.5, "unit": "m/s^2", "std": 0.2}},
            "fingerprint": {**carried, **({"components": components} if components else {})},
        }
        (tmp_path / "model.yaml").write_text(yaml.safe_dump(model))
        argv = ["status", "--connect", "sim", "--model", str(tmp_path / "model.yaml"), "--out", str(tmp_path), "--json"]
        code = cli_main.call(argv)
        return code, json.loads(capsys.readouterr().out)

    return run


@pytest.mark.slow
def test_a_changed_parameter_of_the_vehicle_makes_the_model_stale(status):
    code, found = status()
    assert (code, found["verdict"]) == (0, "CURRENT")
    code, found = status({"MOT_SPIN_MIN": 0.25})
    assert (code, found["verdict"]) == (4, "STALE")
    assert [c["name"] for c in found["changes"]] == ["MOT_SPIN_MIN"]


def test_parameters_alone_do_not_tell_of_components(status):
    code, found = status(components={"propellers": {"id": "P1"}})
    assert (code, found["verdict"]) == (0, "UNKNOWN")
    assert "parameters that shape the response are what they were" in found["sentence"]


def test_what_every_flight_sets_is_no_change(seen):
    assert int(seen[0].parameters["GUID_OPTIONS"]) & 8


def test_doctor_reaches_the_built_in_vehicle(capsys):
    cli_main.call(["doctor", "--connect", "sim", "--json"])
    (vehicle,) = [c for c in json.loads(capsys.readouterr().out)["checks"] if c["what"] == "vehicle"]
    assert vehicle["ok"], vehicle
    assert vehicle["found"].startswith("sim: ArduCopter")


def test_the_built_in_vehicle_has_no_log_to_fetch(capsys, tmp_path):
    assert cli_main.call(["fetch-log", "--connect", "sim", "-o", str(tmp_path / "run"), "--json"]) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert "keeps no onboard log" in error["message"]
    assert "--backend sitl" in error["hint"]
    assert not (tmp_path / "run").exists()
