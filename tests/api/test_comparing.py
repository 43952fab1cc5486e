"""The verbs that compare, and those about runs and the tool: the data of the command, a table and a figure."""

import copy
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import flighttest as ft
from flighttest.cli.main import call
from flighttest.diagnose import Verdict
from flighttest.diagnose.records import FROM_REPEATS
from flighttest.identify.models import model_file
from flighttest.pipeline import twin
from flighttest.pipeline.diagnosis import against


def printed(capsys, *words):
    assert call([*map(str, words), "--json"]) in (0, 3)
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_models_are_compared_as_the_command_does(repository, tmp_path, capsys):
    fitted = ft.fit(ft.read(repository / "tests" / "data" / "sitl_thrust.tlog.xz"))
    first = fitted.model.write(tmp_path / "model.yaml")
    data = copy.deepcopy(dict(fitted.model.data))
    data["parameters"]["K"]["value"] *= 1.5
    model_file.write(tmp_path / "other.yaml", data)
    found = ft.compare(first, tmp_path / "other.yaml")
    assert found.differing == ("K",)
    assert found.to_frame().loc["K", "z"] > 3.0
    assert len(found.plot().data) == 1
    assert json.loads(json.dumps(found.data)) == printed(capsys, "compare", first, tmp_path / "other.yaml")


@pytest.mark.slow
def test_recorded_commands_run_on_a_changed_vehicle(fitted, log):
    found = ft.replay(fitted.model, log, changes={"omega_phi": "-40%"})
    frame = found.to_frame()
    assert found.effects["roll_rad"].size == frame.loc["roll_rad", "size"] > 0.01
    assert frame.loc["pitch_rad", "size"] == 0.0
    assert len(found.plot().data) > 0
    with pytest.raises(ft.InputError):
        ft.replay(fitted.model, log, changes={"no_such": 1.0})
    with pytest.raises(ft.InputError, match="no recording was given"):
        ft.replay(fitted.model)


@pytest.fixture
def nothing_found(monkeypatch, fitted):
    """The search for terms is tested elsewhere: here it finds none. Gives the weather that each search was given."""
    weathers = []

    def no_search(_segments, _recordings, stored, _vehicle, _progress, weather=None):
        weathers.append(weather)
        model = fitted.fit.model
        floor = {c.rsplit("_", 1)[0]: {"value": q.rmse, "from": FROM_REPEATS} for c, q in fitted.fit.quality.items()}
        return SimpleNamespace(
            model=model, values=model.start(), accepted=(), untestable=(), noise_floor=floor, sentence="-",
            verdict=Verdict.NOTHING_MISSING, fit=fitted.fit,
        )  # fmt: skip

    monkeypatch.setattr(against, "run_diagnosis", no_search)
    monkeypatch.setattr(twin, "run_diagnosis", no_search)
    return weathers


@pytest.mark.slow
def test_a_simulator_is_opposed_to_reality(log, nothing_found):
    series = {
        g: type(s)(s.t_s, {n: v * (1.5 if n == "roll_rad" else 1.0) for n, v in s.columns.items()})
        for g, s in log.series.items()
    }
    simulated = ft.Recording("simulated", series, log.markers, type(log.provenance)("made", "table"))
    found = ft.against(log, simulated, weather={"simulated": "still"})
    assert nothing_found == [{log.name: "unknown"}, {"simulated": "still"}]
    assert found.lacks == ()
    assert {d.name for d in found.differences if d.differs} == set(found.data["other_value"])
    assert found.to_frame().loc["omega_phi", "real"] == pytest.approx(found.model.values["omega_phi"])
    assert [t.name for t in found.plot("prediction").data] == ["corrected", "real, fitted", "simulator"]
    with pytest.raises(ft.InputError, match="on both sides"):
        ft.against(log, [log])


@pytest.mark.usefixtures("nothing_found")
def test_a_twin_of_a_log_is_compared_on_its_recorded_commands(fitted, log):
    seen = []
    found = ft.twin(fitted.model, log, progress=seen.append)
    assert found.flown == ()
    assert found.nothing_missing == (found.status.name == "DONE") == found.sentence.startswith("NOTHING_MISSING")
    frame = found.to_frame()
    assert np.allclose(frame["rmse"] / frame["floor"], frame["ratio"])
    assert [t.name for t in found.plot().data] == ["twin", "refitted"]
    assert "comparing the twin with the recordings" in seen


@pytest.mark.slow
def test_a_log_becomes_a_run_and_is_listed(log_file, repository, tmp_path, capsys):
    made = ft.import_log(log_file, tmp_path / "runs" / "2026-01-01T00-00-00-roll_pitch")
    assert made.recording.has("roll_rad")
    assert made.to_frame().loc["attitude", "rate_hz"] > 1.0
    assert len(made.plot("attitude").data) == 3
    found = ft.runs(tmp_path / "runs")
    assert list(found.to_frame().index) == [made.run.name]
    assert json.loads(json.dumps(found.data)) == printed(capsys, "runs", tmp_path / "runs")
    page = Path(ft.report(made.run))
    assert page == made.run / "report.html"
    assert page.stat().st_size > 1_000_000
    thrust = ft.import_log(
        repository / "tests" / "data" / "sitl_thrust.tlog.xz", tmp_path / "runs" / "2026-01-02T00-00-00-thrust"
    )
    ft.report(thrust.run)
    assert len(ft.runs(tmp_path / "runs").plot().data) > 0


def test_what_is_installed_is_a_table():
    found = ft.doctor()
    assert found.ok
    assert found.to_frame().loc["numpy", "ok"]


def test_a_real_vehicle_arms_only_where_that_is_said(tmp_path):
    with pytest.raises(ft.InputError, match=r"may be a real vehicle.*give arm=True"):
        ft.run("thrust", connect="udpin:127.0.0.1:1", runs=tmp_path)
