"""Vehicles are distinguished: nothing is taken to be of a vehicle because it lies beside its runs."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from flighttest.cli import main as cli_main
from flighttest.errors import InputError, VehicleError
from flighttest.pipeline.flights.run import FlightRequest, declared_vehicle
from flighttest.pipeline.store.history import campaigns
from flighttest.pipeline.store.identities import identity_of, known_in, recognised, whose
from flighttest.recording import Provenance, Recording, Series
from flighttest.recording.store import open_run, write_recording
from flighttest.vehicle.identity import identity
from flighttest.vehicle.load import load_vehicle, parse_vehicle
from flighttest.vehicle.model import Vehicle

BOARD = "39001f000c51313433393330" + 12 * "0"
OFFSETS = {"INS_ACCOFFS_X": 0.0123456, "INS_ACCOFFS_Y": -0.0345678, "INS_ACCOFFS_Z": 0.0567891, "MAV_SYSID": 1.0}
DEFAULTS = {"INS_ACCOFFS_X": 0.001, "INS_ACCOFFS_Y": 0.001, "INS_ACCOFFS_Z": 0.001, "MAV_SYSID": 1.0}


def recording(name, vehicle="", autopilot="", **parameters):
    source = Provenance(
        "x", "table", vehicle={"name": vehicle} if vehicle else {}, autopilot=autopilot, parameters=parameters
    )
    return Recording(name, {"attitude": Series(np.arange(9.0), {"roll_rad": np.zeros(9)})}, (), source)


def kept(folder, one):
    (folder / one.name).mkdir(parents=True)
    write_recording(folder / one.name, one)
    return folder / one.name


def test_a_log_is_known_by_its_autopilot_and_else_unknown(tmp_path):
    kept(tmp_path, recording("1", "heron", BOARD, **OFFSETS))
    kept(tmp_path, recording("2", "stork", **{**OFFSETS, "INS_ACCOFFS_X": 0.0987654}))

    def name(**known):
        return whose([recording("new", **known)], None, tmp_path)

    assert name(autopilot=BOARD) == "heron"
    assert name(**OFFSETS) == "heron"
    assert name(**{**OFFSETS, "INS_ACCOFFS_X": 0.0987654}) == "stork"
    assert name() == ""
    assert name(**DEFAULTS) == "", "what every simulator has separates none"
    assert name(**{**OFFSETS, "MAV_SYSID": 7.0}).startswith("autopilot calibrated"), "another system id"
    models = tmp_path / "models" / "crow"
    models.mkdir(parents=True)
    board = {"autopilot": "cd" + BOARD[2:]}
    (models / "lineage.yaml").write_text(yaml.safe_dump({"format": "lineage/1", "vehicle": "crow", "identity": board}))
    assert name(autopilot="cd" + BOARD[2:]) == "crow", "by its accepted model alone"
    assert name(autopilot="ab" + BOARD[2:], **OFFSETS) == f"autopilot ab{BOARD[2:24]}", "another board"


def test_two_vehicles_in_one_call_are_refused(tmp_path):
    a, b = recording("a", "heron"), recording("b", "stork")
    with pytest.raises(InputError, match="recordings of two vehicles: b is of stork, not of heron"):
        whose([a, b], None)
    with pytest.raises(InputError, match="recordings of two vehicles"):
        whose([a], Vehicle("crow", None, "", 22.2, 0.2))
    assert identity_of([a, b], None).name == "", "a model of both is of neither"
    assert whose([a, recording("c")], None) == "heron"


def test_a_run_keeps_the_number_of_its_autopilot(tmp_path):
    run = kept(tmp_path, recording("1", "heron", BOARD))
    assert open_run(run).provenance.autopilot == BOARD
    assert recognised(identity({}, {}, BOARD), known_in(tmp_path)) == "heron"


def test_the_fit_of_an_unknown_log_is_of_no_vehicle_beside_it(tmp_path, monkeypatch):
    for name, vehicle in (("1", "heron"), ("2", "")):
        (kept(tmp_path, recording(name, vehicle)) / "fit.yaml").touch()
    monkeypatch.setattr("flighttest.pipeline.store.history.model_file.read", lambda path: _Fit(path))
    assert [c.folder.name for c in campaigns(tmp_path, "heron")] == ["1"]


class _Fit:
    def __init__(self, path: Path) -> None:
        self.runs = (path.parent.name,)


def test_status_of_an_unknown_recording_asks_whose_it_is(tmp_path, capsys):
    run = kept(tmp_path, recording("1"))
    assert cli_main.call(["status", str(run), "--out", str(tmp_path), "--json"]) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert "unknown vehicle" in error["message"]
    assert "--vehicle" in error["hint"]


def test_whatever_answers_at_a_url_is_not_the_built_in_vehicle():
    found = declared_vehicle(FlightRequest(("thrust",), connect="tcp:127.0.0.1:5760"))
    assert (found.name, dict(found.components), found.mass_kg) == ("", {}, None)
    assert declared_vehicle(FlightRequest(("thrust",))).name == "paper"


def test_for_recordings_a_name_is_enough(tmp_path):
    text = yaml.safe_dump({"format": "vehicle/1", "name": "heron", "mass_kg": 1.2})
    found = parse_vehicle(text, to_fly=False)
    assert (found.name, found.mass_kg, found.flies) == ("heron", 1.2, False)
    (tmp_path / "v.yaml").write_text(text)
    with pytest.raises(VehicleError, match="zone"):
        load_vehicle(tmp_path / "v.yaml")


def test_the_history_draws_no_two_vehicles_in_one_picture(tmp_path, capsys):
    for name, vehicle in (("1", "heron"), ("2", "stork"), ("3", "")):
        kept(tmp_path, recording(name, vehicle))
    assert cli_main.call(["runs", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert all(word in out for word in ("heron", "stork", "unknown"))
