"""The whole command line on a foreign table: import, segment, fit, validate, report, export, compare, status."""

import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from flighttest.cli import main as cli_main
from flighttest.pipeline.diagnosis import diagnose as diagnosis

TRUTH = {
    "omega_phi": 25.43,
    "zeta_phi": 0.44,
    "sigma_r": 21.54,
    "sigma_t": 20.36,
    "K": 54.55,
    "alpha": 1.71,
    "d_x": 0.39,
    "d_z": 0.51,
    "T_d": 0.1,
}


@pytest.fixture(scope="module")
def fitted(flight_csv, tmp_path_factory):
    """The model file of a fit of the whole flight, and what the command printed."""
    path, out = tmp_path_factory.mktemp("model") / "model.yaml", io.StringIO()
    with redirect_stdout(out):
        assert cli_main.call(["fit", str(flight_csv), "-o", str(path), "--json"]) == 0
    return path, json.loads(out.getvalue())


@pytest.fixture(scope="module")
def model(fitted):
    return fitted[0]


def test_fit_finds_the_vehicle(fitted):
    found = fitted[1]["parameters"]
    for name, value in TRUTH.items():
        assert found[name]["value"] == pytest.approx(value, rel=0.04), name
        assert found[name]["identifiable"]


@pytest.mark.slow
def test_import_makes_a_run_that_says_the_same_as_the_table(call, flight_csv, tmp_path):
    run = tmp_path / "run"
    code, out, _ = call("import", flight_csv, "-o", run, "--json")
    assert code == 0
    assert json.loads(out)["channels"]["attitude"]["rate_hz"] == pytest.approx(50.0)
    direct = json.loads(call("segment", flight_csv, "--json")[1])
    stored = json.loads(call("segment", run, "--json")[1])
    assert stored["used"] == direct["used"] > 40
    code, _, err = call("import", flight_csv, "-o", flight_csv.parent)
    assert code == 2
    assert "not a run folder" in " ".join(err.split())


def test_a_run_folder_is_not_overwritten_by_another_recording(call, tmp_path):
    run, rows = tmp_path / "läuf e", "\n".join(f"{0.02 * k},0.1" for k in range(50))
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(f"t_s,roll_rad\n{rows}\n{1.0 if name == 'a.csv' else 1.5},0.1\n")
    assert call("import", tmp_path / "a.csv", "-o", run)[0] == 0
    assert call("import", tmp_path / "a.csv", "-o", run)[0] == 0, "rebuilding it is no loss"
    code, _, err = call("import", tmp_path / "b.csv", "-o", run)
    assert code == 2
    assert "holds another recording already" in " ".join(err.split())
    assert yaml.safe_load((run / "manifest.yaml").read_text())["source"].endswith("a.csv")


def test_report_of_a_run_and_the_history(call, throttle_steps, flight_csv, tmp_path):
    run = tmp_path / "runs" / "2026-01-02T03-04-05-thrust"
    call("import", throttle_steps(flight_csv), "-o", run)
    before = sorted(run.rglob("*"))
    assert call("report", run, "-o", tmp_path / "page.html")[0] == 0
    assert sorted(run.rglob("*")) == before, "a run that is only read may be read-only"
    code, out, _ = call("report", run)
    assert code == 0
    assert (run / "report.html").stat().st_size > 1_000_000
    assert (run / "segments.parquet").is_file()
    assert (run / "fit.yaml").is_file()
    code, out, _ = call("runs", tmp_path / "runs", "--html", "--json")
    assert code == 0
    (listed,) = json.loads(out)["runs"]
    assert listed["when"] == "2026-01-02 03:04:05"
    assert listed["parameters"]["K"]["value"] == pytest.approx(54.55, rel=0.02)
    assert (tmp_path / "runs" / "history.html").is_file()


def test_damaged_runs_are_named_beside_the_others(call, tmp_path):
    runs, rows = tmp_path / "runs", "\n".join(f"{0.02 * k},0.1" for k in range(50))
    (tmp_path / "a.csv").write_text(f"t_s,roll_rad\n{rows}\n1.0,0.1\n")
    for name in ("good", "garbled", "lost", "bad_fit"):
        assert call("import", tmp_path / "a.csv", "-o", runs / name)[0] == 0
    (runs / "garbled" / "manifest.yaml").write_text("{[")
    (runs / "lost" / "manifest.yaml").unlink()
    (runs / "bad_fit" / "fit.yaml").write_text("format: other/1")
    code, out, _ = call("runs", runs, "--json")
    assert code == 0
    listed = json.loads(out)
    assert [r["run"] for r in listed["runs"]] == ["bad_fit", "good"]
    for name, reason in (
        ("lost", "no manifest.yaml"),
        ("garbled", "cannot be read"),
        ("bad_fit", "expected `model/1`"),
    ):
        (line,) = [b for b in listed["broken"] if b.startswith(str(runs / name))]
        assert reason in line
        assert line.partition("`")[0].count(str(runs / name)) == 1, "named once, before the command that mends it"
    code, out, _ = call("runs", runs)
    words = "".join(out.split()).replace("\\", "")  # which ends a line of a command
    for line in listed["broken"]:
        assert "".join(line.removeprefix(f"{runs}/").split()) in words
    for name in ("good", "bad_fit"):
        (runs / name / "manifest.yaml").unlink()
    assert "None of the runs here can be read" in call("runs", runs)[1]


def test_validate_export_and_compare(call, model, free_csv, worn_csv, tmp_path):
    code, out, _ = call("validate", model, free_csv, "-o", tmp_path / "v.html", "--json")
    assert code == 0
    assert {e["model"] for e in json.loads(out)["errors"]} >= {
        "FULL",
        "LINEARISED",
        "NO_DRAG",
        "NO_BATTERY",
        "ONLY_DELAY",
        "HOLD",
    }
    assert (tmp_path / "v.html").is_file()
    code, out, _ = call("export", model, "--to", "json", "-o", tmp_path / "x", "--json")
    assert code == 0
    assert (tmp_path / "x" / "model.json").is_file()
    code, out, _ = call("compare", model, worn_csv, "--json")
    assert code == 0
    assert "K" in json.loads(out)["differing"]
    assert "omega_phi" not in json.loads(out)["differing"]
    first = json.loads(out)["parameters"][0]
    assert first["different"]
    assert first["z"] == pytest.approx(first["difference"] / first["std"])
    code, out, _ = call("compare", model, model, "--json")
    assert json.loads(out)["differing"] == []
    assert max(abs(p["z"]) for p in json.loads(out)["parameters"] if p["z"] is not None) == 0.0


def test_the_gain_is_shown_as_it_is_compared(call, model, tmp_path):
    """Beside 13.0 and 6 m/s^2 a change of 2405 % was printed: at one voltage the second was 327 m/s^2."""
    document = yaml.safe_load(model.read_text())
    stored, alpha = document["parameters"]["K"]["value"], document["parameters"]["alpha"]["value"]
    document["constants"]["nominal_voltage_v"] *= 0.5
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(document))
    _, out, _ = call("compare", model, tmp_path / "other.yaml")
    (row,) = [line.split() for line in out.splitlines() if line.startswith("K ")]
    assert float(row[2]) == pytest.approx(stored * 2.0**alpha, rel=0.01)
    assert "K of the second is that at" in " ".join(out.split())
    assert "K of the second" not in call("compare", model, model)[1]


@pytest.fixture(scope="module")
def free_csv(synthetic, tmp_path_factory):
    """The first seconds of a flight: too few steps for anything but free flight."""
    return synthetic.write_csv(tmp_path_factory.mktemp("free") / "free.csv", seed=2, until_s=9.4)


@pytest.mark.slow
def test_a_program_is_reported_as_well_that_a_flight_was_fitted(call, model, flight_csv, tmp_path):
    rows = flight_csv.read_text().splitlines()
    (tmp_path / "flight.csv").write_text("\n".join(rows[:500]))
    code, out, _ = call("validate", model, tmp_path / "flight.csv", "--json")
    assert code == 0
    assert json.loads(out)["careful"].startswith("flight was used in the fit")


@pytest.mark.slow
def test_a_fit_says_what_makes_its_recordings_doubtful(call, free_csv, tmp_path):
    """It was among the notes of the model file alone."""
    out = " ".join(call("fit", free_csv, "-o", tmp_path / "model.yaml")[1].split())
    assert "careful the accelerometer's filter is not stated for free" in out


@pytest.mark.slow
def test_a_model_that_predicts_worse_than_none_is_called_so(call, model, free_csv, tmp_path):
    """0.70 m/s after 1 s, where the last measurement was off by 0.38, was said to be smaller than with no drag, on a green page."""
    document = yaml.safe_load(model.read_text())
    document["parameters"]["K"]["value"] *= 0.7
    (tmp_path / "weak.yaml").write_text(yaml.safe_dump(document))
    assert "worse than no model" not in " ".join(call("validate", model, free_csv)[1].split())
    assert "worse than no model" in " ".join(call("validate", tmp_path / "weak.yaml", free_csv)[1].split())


@pytest.mark.slow
def test_validate_counts_the_responses_that_segment_counts(call, model, worn_csv):
    """Of 39 responses 24 lie between steps, and `validate` reckoned with 15."""
    every = json.loads(call("segment", worn_csv, "--json")[1])["segments"]
    left_out = json.loads(call("validate", model, worn_csv, "--json")[1])["left_out"]
    assert left_out.startswith(f"of {len(every)} responses ")
    assert "between steps" in left_out


@pytest.mark.slow
def test_steps_beside_a_free_flight_are_validated_too(call, model, free_csv, throttle_steps, worn_csv, tmp_path):
    alone = json.loads(call("validate", model, free_csv, "--json")[1])
    assert alone["careful"] == alone["another_vehicle"] == ""
    assert "steps" not in alone
    assert alone["left_out"] == ""
    page = tmp_path / "v.html"
    code, out, _ = call("validate", model, free_csv, throttle_steps(worn_csv), "-o", page, "--json")
    assert code == 0
    both = json.loads(out)
    assert both["errors"] == alone["errors"]
    assert both["steps"]["starts"] > alone["starts"]
    assert {e["model"] for e in both["steps"]["errors"]} == {e["model"] for e in alone["errors"]}
    assert "Prediction of free flight" in page.read_text()
    assert "Prediction of steps" in page.read_text()


@pytest.mark.slow
def test_status_sees_worn_propellers_and_not_the_same_vehicle(call, model, flight_csv, worn_csv, tmp_path):
    code, out, _ = call("status", "--model", model, worn_csv, "--out", tmp_path, "-o", tmp_path / "status", "--json")
    assert code == 4
    found = json.loads(out)
    assert found["verdict"] == "STALE"
    assert [t["subset"] for t in found["tests"] if t["alarm"]] == ["thrust"]
    assert "thrust per throttle fell" in found["sentence"]
    assert "UNTESTABLE" in found["battery"]["sentence"]
    assert (tmp_path / "status" / "thrust_again.yaml").is_file()
    rows = {row["what"].split(" (")[0]: row for row in found["reflights"]}
    assert list(rows) == ["at least", "all", "the shortest that serves"]
    assert rows["at least"]["minutes"] == pytest.approx(found["minutes"]["thrust"])
    assert 0 < rows["the shortest that serves"]["minutes"] < rows["at least"]["minutes"]
    assert rows["the shortest that serves"]["command"].endswith("thrust_again.yaml")
    assert found["page"] == str(tmp_path / "status" / "status.html")
    assert found["compared"]["new flight"] == str(worn_csv)
    code, out, _ = call("status", "--model", model, flight_csv, "--out", tmp_path, "--json")
    assert code == 0
    assert json.loads(out)["verdict"] == "CURRENT"
    assert json.loads(out)["reflights"] == []


@pytest.mark.slow
def test_the_scripts_status_writes_can_be_flown(call, model, worn_csv, tmp_path):
    call("status", "--model", model, worn_csv, "--out", tmp_path, "-o", tmp_path / "status")
    for script in Path(tmp_path / "status").glob("*.yaml"):
        code, out, _ = call("check", script, "--json")
        assert code == 0, out


@pytest.mark.parametrize(
    "argv",
    [
        ("fit", "nowhere"),
        ("segment", "nowhere.BIN"),
        ("validate", "nowhere.yaml", "x"),
        ("status", "--model", "nowhere.yaml"),
        ("report", "nowhere"),
        ("export", "nowhere.yaml", "--to", "c"),
        ("compare", "a", "b"),
        ("check", "no_such_maneuver"),
        ("check", "thrust", "--vehicle", "nowhere.yaml"),
        ("diagnose", "nowhere"),
        ("import", "nowhere.csv", "-o", "x"),
    ],
)
def test_missing_files_are_bad_input(call, argv, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = call(*argv)
    assert code == 2, err
    assert "error:" in err


@pytest.mark.slow
def test_bad_fit_options_are_bad_input(call, flight_csv):
    for options in (
        ("--term", "nope"), ("--freeze", "alpha"), ("--tie", "d_y"), ("--freeze", "nope=1"), ("--freeze", "K=nan"),
        ("--freeze", "K=1e300"), ("--tie", "K=K"), ("--freeze", "K=50", "--freeze", "K=60"), ("--freeze", "K=50", "--tie", "K=alpha"),
        ("--tie", "K=omega_phi"), ("--tie", "d_x=d_y", "--tie", "d_y=d_x"),
    ):  # fmt: skip
        code, _, err = call("fit", flight_csv, *options)
        assert code in (2, 3), (options, err)
        assert "error:" in err


@pytest.mark.slow
def test_the_papers_one_delay_can_be_held(call, flight_csv):
    delays = ("T_d_attitude", "T_d_yaw_rate", "T_d_thrust", "T_d")
    code, out, _ = call("fit", flight_csv, "--freeze", "T_d=0.11", "--json")
    assert code == 0
    found = json.loads(out)["parameters"]
    assert [found[name]["value"] for name in delays] == [0.11] * 4
    assert {found[name]["source"] for name in delays} == {"frozen"}
    code, _, err = call("fit", flight_csv, "--freeze", "T_d=0.11", "--freeze", "T_d_thrust=0.1")
    assert code == 2
    assert "T_d_thrust is given too" in " ".join(err.split())


def test_a_column_map_that_is_named_is_read_even_where_the_log_needs_none(call, repository, tmp_path):
    log = repository / "tests" / "data" / "sitl_thrust.tlog.xz"
    for bad in (tmp_path / "none.yaml", log):
        code, _, err = call("segment", log, "--columns", bad)
        assert code in (2, 3)
        assert bad.name in err


@pytest.mark.slow
def test_a_misspelt_column_is_reported_by_every_command_that_reads_the_table(call, flight_csv, tmp_path):
    names, rows = flight_csv.read_text().split("\n", 1)
    path = tmp_path / "a.csv"
    path.write_text(names.replace(",roll_rad", ",rol_rad") + "\n" + rows)
    hint = "column 'rol_rad' is not a channel and was not read; did you mean roll_rad?"
    code, out, err = call("segment", path, "--json")
    assert code == 0
    assert json.loads(out)["losses"] == [f"a: {hint}"]
    assert hint in err
    code, out, _ = call("segment", path)
    assert f"{path}: {hint}" in out
    run = tmp_path / "run"
    call("import", path, "-o", run)
    assert hint not in call("segment", run)[1], "the import has reported it"
    rows = "".join(f"{0.02 * k},0.1,0.2\n" for k in range(300))
    for names, expected in (("t_s,rol_rad,pitch_rad", 3), ("t_s,rol_rad,throttle", 2), ("t_s,rol_rad,gyro", 2)):
        path.write_text(f"{names}\n{rows}")
        code, out, err = call("fit", path)
        assert code == expected
        assert hint in " ".join((out + err).split()), "where nothing can be fitted it is the reason"


def test_garbage_is_no_traceback(call, tmp_path):
    junk = tmp_path / "junk.bin"
    junk.write_bytes(bytes(range(256)) * 50)
    for suffix in (".bin", ".tlog", ".ulg", ".csv", ".parquet", ".xyz"):
        path = tmp_path / f"junk{suffix}"
        path.write_bytes(junk.read_bytes())
        code, _, err = call("fit", path)
        assert code in (2, 3), (suffix, err)
        assert "error:" in err


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("import", "nowhere.BIN", "-o", "x"), "there is no such file"),
        (("runs", "nowhere"), "there is no such folder"),
        (("status", "--model", "nowhere.yaml"), "cannot be read: No such file or directory"),
        (("run", "thrust", "--connect", "serial:/dev/ttyNOPE:57600", "--yes"), "57600: No such file or directory"),
    ],
)
def test_errors_name_the_thing_once_and_in_words(call, argv, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = call(*argv)
    assert code in (1, 2)
    assert words in err.replace("\n", " ")
    assert "Errno" not in err


def test_no_runs_yet_is_no_error(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("runs")[0] == 0


def test_a_proposal_of_an_earlier_diagnosis_does_not_stay(monkeypatch, tmp_path):
    def interrupt(*_args, **_more):
        raise KeyboardInterrupt

    (tmp_path / "next.yaml").write_text("format: maneuver/1")
    monkeypatch.setattr(diagnosis, "refit", interrupt)
    with pytest.raises(KeyboardInterrupt):
        diagnosis.write_diagnosis(SimpleNamespace(to_json=dict, next_script=None), [], [], None, None, tmp_path)
    assert not (tmp_path / "next.yaml").exists()
    assert (tmp_path / "diagnosis.json").exists()


@pytest.mark.parametrize("command", ["fit", "diagnose", "validate"])
def test_where_nothing_can_be_written_nothing_is_computed(call, model, flight_csv, tmp_path, monkeypatch, command):
    (tmp_path / "taken").write_text("a file, no folder")
    monkeypatch.setattr(
        "flighttest.pipeline.recordings.sources.read_log", lambda *_: pytest.fail("read before it was refused")
    )
    given = (model, flight_csv) if command == "validate" else (flight_csv,)
    code, _, err = call(command, *given, "-o", tmp_path / "taken" / "out")
    assert code == 2
    assert "cannot be written" in err.replace("\n", " ")


def test_a_program_hears_of_an_interrupt(call, monkeypatch, flight_csv):
    def interrupt(*_args, **_more):
        raise KeyboardInterrupt

    monkeypatch.setattr("flighttest.pipeline.identification.fitting.fit_segments", interrupt)
    code, out, _ = call("fit", flight_csv, "--json")
    assert code == 1
    assert "stopped" in json.loads(out)["error"]["message"]


@pytest.mark.slow
def test_what_to_fly_takes_time_also_where_the_model_finds_no_space(call, model, tmp_path):
    data = yaml.safe_load(model.read_text())
    data["parameters"]["K"]["value"] *= 4.0  # nonsense, with which no throttle step of the script stays in the zone
    (tmp_path / "odd.yaml").write_text(yaml.safe_dump(data))
    _, out, _ = call("status", "--model", tmp_path / "odd.yaml", "--json")
    assert json.loads(out)["minutes"]["spot_check"] > 1.3


def test_a_model_of_another_vehicle_plans_nothing(call, model, tmp_path):
    other = yaml.safe_load(model.read_text())
    other["parameters"]["K"]["value"] = 395.0
    path = tmp_path / "other.yaml"
    path.write_text(yaml.safe_dump(other))
    code, _, err = call("check", "spot_check", "--model", path)
    assert code == 2
    assert "another vehicle" in " ".join(err.split())
