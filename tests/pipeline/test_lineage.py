"""One model in use per vehicle: accepted, found by the vehicle's name, with those before it; never another vehicle's."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from flighttest.errors import InputError, ModelError
from flighttest.identify.models import model_file
from flighttest.physics.model import Model
from flighttest.pipeline.flights import after_landing as campaign
from flighttest.pipeline.planning.checking import prior_model
from flighttest.pipeline.results import Status
from flighttest.pipeline.store import lineage
from flighttest.pipeline.store.flown_with import FlownWith, keep, rerun_options
from flighttest.pipeline.store.history import DEFAULT_RUNS
from flighttest.pipeline.store.models import accept_command, twin_command
from flighttest.report.sections.diagnosis import missing_sections
from flighttest.vehicle.model import DEFAULT_VEHICLE

PAPER = ("body", "linear_drag")


def write_model(
    folder, terms=PAPER, vehicle="heron", runs=("a",), unknown=(), components="P1", name="model.yaml", **values
):
    model = Model(terms)
    known = {**model.start(), **values}
    data = {
        "format": "model/1",
        "vehicle": {"name": vehicle},
        "terms": list(terms),
        "parameters": {
            n: {
                "value": known[n],
                "unit": model.param[n].unit,
                "std": 0.01 * abs(known[n]) + 1e-6,
                "identifiable": n not in unknown,
            }
            for n in model.names
        },
        "fingerprint": {"components": {"propellers": {"id": components}}},
        "runs": list(runs),
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(yaml.safe_dump(data))
    return folder


def joined(text):
    """Without spaces: a command that is longer than a line goes on behind a backslash."""
    return "".join(text.replace("\\\n", "").split())


def test_an_accepted_model_is_its_vehicles_and_keeps_those_before_it(call, tmp_path):
    out = tmp_path / "runs"
    first, second = (
        write_model(tmp_path / "one"),
        write_model(tmp_path / "two", (*PAPER, "quadratic_drag"), runs=("b",)),
    )
    assert call("accept", first, "--out", out)[0] == 0
    assert call("accept", second, "--out", out)[0] == 0
    used = lineage.in_use(out, "heron")
    assert used.model.terms == (*PAPER, "quadratic_drag")
    assert used.vehicle_name == "heron"
    code, text, _ = call("models", out, "--json")
    (reported,) = json.loads(text)["vehicles"]
    assert code == 0
    assert [m["runs"] for m in reported["models"]] == [["a"], ["b"]]
    assert reported["models"][1]["joined"] == ["quadratic_drag"]
    assert reported["models"][0]["ended"] == ["quadratic_drag joined"]
    # The copy is the vehicle's: what becomes of the folder does not touch it.
    (second / "model.yaml").unlink()
    assert lineage.in_use(out).model.terms == (*PAPER, "quadratic_drag")


def test_where_a_model_was_accepted_is_said_with_what_uses_it(call, tmp_path, monkeypatch):
    """`status` was said to use the model, looked in runs/, and asked for the --vehicle that had been given."""
    out, vehicle = tmp_path / "elsewhere", tmp_path / "vehicle.yaml"
    vehicle.write_text("format: vehicle/1\nname: heron\n")
    model = write_model(tmp_path / "one")
    monkeypatch.chdir(tmp_path)
    assert "useitforthisvehicle,eachwith--outelsewhere" in joined(call("accept", model, "--out", "elsewhere")[1])
    code, _, said = call("status", "--vehicle", vehicle)
    assert code == 2
    assert "with --out" in said
    assert "name it with --vehicle" not in said
    assert "name it with --vehicle" in call("status")[2]
    assert out.is_dir()
    assert "each with" not in call("accept", model, "--out", "runs")[1]


def test_a_model_that_is_in_use_is_not_accepted_again(call, tmp_path):
    out, folder = tmp_path / "runs", write_model(tmp_path / "one")
    answers = [call("accept", folder, "--out", out)[1] for _ in range(2)]
    assert all("is now model 1 of heron" in answer for answer in answers)
    assert len(lineage.lineage_of(out, "heron").generations) == 1
    call("accept", write_model(tmp_path / "two", K=61.0), "--out", out)
    assert len(lineage.lineage_of(out, "heron").generations) == 2


def test_a_model_diagnosed_again_to_the_same_values_takes_the_place_of_the_older_file(tmp_path):
    out, first, second = tmp_path / "runs", write_model(tmp_path / "one"), write_model(tmp_path / "two")
    data = yaml.safe_load((second / "model.yaml").read_text())
    (second / "model.yaml").write_text(yaml.safe_dump({**data, "diagnosed": {"untestable": ["ground_effect"]}}))
    lineage.take_into_use(first, out)
    whole, made = lineage.take_into_use(second, out)
    assert lineage.in_use(out, "heron").diagnosed == {"untestable": ["ground_effect"]}
    assert (made.number, made.source) == (1, str(second))
    assert lineage.lineage_of(out, "heron") == whole


def test_an_accepted_model_comes_with_the_command_for_its_twin(call, tmp_path):
    out = tmp_path / "runs"
    (out / "flown").mkdir(parents=True)
    (out / "flown" / "script.yaml").write_text("")
    code, text, _ = call("accept", write_model(out / "flown", runs=("flown", "a log")), "--out", out)
    assert code == 0
    said = joined(text)
    assert f"flighttesttwin{out}/models/heron/001.yaml--verify{out}/flown" in said
    assert "flynext" not in said


@pytest.mark.parametrize(
    ("firmware", "here", "backend"),
    [
        ("ArduCopter 4.7.0-dev (265753db)", True, " --backend sitl"),
        ("ArduCopter 4.7.0-dev (265753db)", False, ""),
        ("ArduCopter 4.7.0-dev (simulate)", True, ""),
    ],
)
def test_a_twin_flies_under_the_firmware_that_flew_where_there_is_one(tmp_path, monkeypatch, firmware, here, backend):
    program = tmp_path / "arducopter"
    program.write_text("")
    program.chmod(0o755 if here else 0o644)
    monkeypatch.setenv("ARDUCOPTER", str(program))
    (tmp_path / "flown").mkdir()
    (tmp_path / "flown" / "script.yaml").write_text("")
    path = write_model(tmp_path / "one") / "model.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"fingerprint": {"firmware": firmware}}))
    command = twin_command(path, [tmp_path / "flown", tmp_path / "a log"])
    assert command == f"flighttest twin {path} --verify {tmp_path}/flown{backend}"
    assert twin_command(path, [tmp_path / "a log"]) == ""


def test_what_is_to_fly_after_accept_and_status_flies_the_vehicle_of_the_models_flights(call, tmp_path):
    """Without these options the command would fly the built-in vehicle as it is: another vehicle."""
    out = tmp_path / "runs"
    flown = FlownWith("sim", airframe="rotor", hide=("quadratic_drag:k_x=0.05",))
    keep(out / "flown", flown)
    write_model(out / "flown", runs=("flown",))
    (out / "flown" / "next.yaml").write_text("")
    options = f" --airframe rotor --hide quadratic_drag:k_x=0.05 --out {out}"
    _, text, _ = call("accept", out / "flown", "--out", out)
    assert "".join(f"flynextflighttest run {out}/flown/next.yaml{options}".split()) in joined(text)
    _, text, _ = call("status", "--out", out, "--json")
    (row,) = json.loads(text)["reflights"]
    assert row["command"] == f"flighttest run spot_check{options}"
    (out / "flown" / "diagnosis.json").write_text('{"next_reason": {"fits_zone": false}}')
    assert "fly next" not in call("accept", out / "flown", "--out", out)[1]


def test_commands_of_a_log_that_names_no_vehicle_come_with_what_is_needed_first(call, tmp_path):
    """`flighttest accept diagnosis` was printed where it is refused, and a flight with a vehicle file that holds no zone."""
    out, folder = tmp_path / "runs", write_model(tmp_path / "diagnosis", vehicle=None)
    (folder / "next.yaml").write_text("")
    first, command = accept_command(folder, out).split("\n")
    assert "name: ..." in first
    assert command == f"flighttest accept {folder} --out {out} --vehicle vehicle.yaml"
    assert call("accept", folder, "--out", out)[0] == 2
    vehicle = tmp_path / "vehicle.yaml"
    vehicle.write_text("format: vehicle/1\nname: heron\n")
    code, text, _ = call("accept", folder, "--out", out, "--vehicle", vehicle)
    assert code == 0
    assert "whataflightneeds" in joined(text)
    assert accept_command(write_model(tmp_path / "named"), out) == f"flighttest accept {tmp_path}/named --out {out}"


def test_the_options_are_those_of_the_newest_run_that_says_them(tmp_path):
    keep(tmp_path / "old", FlownWith("udpin:0.0.0.0:14550"))
    keep(tmp_path / "new", FlownWith("tcp:127.0.0.1:5760"))
    runs = [tmp_path / "old", tmp_path / "new", tmp_path / "log.csv"]
    assert rerun_options(runs, DEFAULT_RUNS) == " --connect tcp:127.0.0.1:5760"
    assert rerun_options(runs, DEFAULT_RUNS, Path("v.yaml")) == " --vehicle v.yaml --connect tcp:127.0.0.1:5760"
    assert rerun_options(runs[2:], DEFAULT_RUNS, Path("v.yaml")) == " --vehicle v.yaml"
    (tmp_path / "new" / "command.yaml").write_text("no mapping")
    assert rerun_options(runs, DEFAULT_RUNS) == " --connect udpin:0.0.0.0:14550"


def test_a_component_change_ends_a_model_by_name(tmp_path):
    lineage.take_into_use(write_model(tmp_path / "one"), tmp_path)
    whole, _ = lineage.take_into_use(write_model(tmp_path / "two", components="P2"), tmp_path)
    assert whole.generations[0].ended == ("propellers P1 is now P2",)


def test_a_model_of_a_vehicle_that_is_not_known_has_no_name(tmp_path):
    folder = write_model(tmp_path / "one", vehicle=None)
    with pytest.raises(InputError, match="not known which vehicle") as reported:
        lineage.take_into_use(folder, tmp_path)
    assert "--vehicle" in reported.value.hint
    (tmp_path / "vehicle.yaml").write_text("format: vehicle/1\nname: stork\n")
    whole, _ = lineage.take_into_use(folder, tmp_path, tmp_path / "vehicle.yaml")
    assert whole.vehicle == "stork"
    with pytest.raises(InputError, match="is a model of heron, not of stork"):
        lineage.take_into_use(write_model(tmp_path / "two"), tmp_path, tmp_path / "vehicle.yaml")


def test_a_model_that_determines_less_does_not_replace_one_that_determines_more(tmp_path):
    lineage.take_into_use(write_model(tmp_path / "one"), tmp_path)
    with pytest.raises(InputError, match="determines less than the model in use, of alpha") as reported:
        lineage.take_into_use(write_model(tmp_path / "two", runs=("b",), unknown=("alpha",)), tmp_path)
    both = f"flighttest diagnose {tmp_path / 'a'} {tmp_path / 'two'} -o {tmp_path / 'two' / 'together'} --accept"
    assert both in reported.value.hint
    # A run whose flight is in the model already is named once.
    old = lineage.lineage_of(tmp_path, "heron").current
    again = lineage.joint_fit_command(tmp_path, model_file.read(old), tmp_path / "a")
    assert again.count(f" {tmp_path / 'a'} ") == 1
    # Also where a term joined: the two heights of a ground effect determine less of the drag than a campaign.
    longer = (*PAPER, "ground_effect")
    with pytest.raises(InputError, match="of alpha"):
        lineage.take_into_use(write_model(tmp_path / "two", longer, runs=("b",), unknown=("alpha",)), tmp_path)
    assert len(lineage.lineage_of(tmp_path, "heron").generations) == 1
    lineage.take_into_use(write_model(tmp_path / "two", longer, runs=("a", "b"), unknown=("alpha",)), tmp_path)
    assert len(lineage.lineage_of(tmp_path, "heron").generations) == 2


def test_a_folder_stands_for_the_improved_model_before_the_first_fit(tmp_path):
    folder = write_model(tmp_path / "run", name="fit.yaml")
    assert model_file.read(folder).path.endswith("fit.yaml")
    write_model(folder, (*PAPER, "quadratic_drag"))
    assert model_file.read(folder).path.endswith("model.yaml")
    with pytest.raises(ModelError, match="holds no model"):
        model_file.read(tmp_path)


def test_plans_are_made_with_the_accepted_model_of_this_vehicle_only(tmp_path):
    assert prior_model(None, tmp_path, DEFAULT_VEHICLE)[1] is None
    lineage.take_into_use(write_model(tmp_path / "one"), tmp_path)
    assert prior_model(None, tmp_path, DEFAULT_VEHICLE)[1] is None
    lineage.take_into_use(write_model(tmp_path / "two", vehicle="paper"), tmp_path)
    assert prior_model(None, tmp_path, DEFAULT_VEHICLE)[1] == tmp_path / "models" / "paper" / "001.yaml"


def test_export_takes_a_folder_and_finds_the_model_in_use(call, tmp_path):
    out = tmp_path / "runs"
    folder = write_model(tmp_path / "one")
    assert call("export", folder, "--to", "json", "-o", tmp_path / "a")[0] == 0
    code, _, err = call("export", "--to", "json", "-o", tmp_path / "b", "--out", out)
    assert (code, "no model was given" in err) == (2, True)
    call("accept", folder, "--out", out)
    assert call("export", "--to", "json", "-o", tmp_path / "b", "--out", out)[0] == 0
    assert (tmp_path / "b" / "model.json").read_bytes() == (tmp_path / "a" / "model.json").read_bytes()


@pytest.mark.parametrize(
    "text",
    [
        "format: other/1\n",
        "format: lineage/1\nvehicle: heron\nmodels: [{number: 1}]\n",
        "[",
        "format: lineage/1\nvehicle: heron\n",
        "format: lineage/1\nvehicle: heron\nmodels: [{number: 1, file: ../x.yaml, accepted: x}]\n",
        "format: lineage/1\nvehicle: heron\nmodels: [{number: 1, file: .inf, accepted: x}]\n",
    ],
)
def test_a_damaged_lineage_is_one_clear_error(call, tmp_path, text):
    folder = tmp_path / "models" / "heron"
    folder.mkdir(parents=True)
    (folder / "lineage.yaml").write_text(text)
    code, _, err = call("models", tmp_path)
    assert code == 2
    assert "lineage.yaml" in err
    assert lineage.LINEAGE_REPAIR in " ".join(err.split())


@pytest.mark.parametrize("name", ["a b", "..", "a/b", "ü"])
def test_any_name_has_a_folder_of_its_own(tmp_path, name):
    assert lineage.folder_of(tmp_path, name).parent == tmp_path / "models"
    assert lineage.folder_of(tmp_path, name) != lineage.folder_of(tmp_path, name + "_")


def fitted(*, good, known=True):
    estimates = {"K": SimpleNamespace(identifiable=known), "alpha": SimpleNamespace(identifiable=False)}
    return SimpleNamespace(status=SimpleNamespace(good=good), estimates=estimates)


def test_a_model_of_which_nothing_is_known_is_not_offered(tmp_path):
    """After a take-over in the first step, with one response: "none of the 15 parameters is known", and the command to accept them."""
    found = campaign.Analysis((), (), fitted(good=True, known=False))
    assert campaign.how_to_accept(found, Status.UNUSABLE, tmp_path, "heron", tmp_path, keep=False) == ""


def test_what_a_campaign_found_is_accepted_where_that_was_asked_for(tmp_path):
    """Of a vehicle that is known; of an unknown one the command reports what is missing, and nothing is lost."""
    found = campaign.Analysis((), (), fitted(good=True))

    def accepting(folder, name, status=Status.DONE, keep=True):
        return campaign.how_to_accept(found, status, folder, name, tmp_path, keep)

    heron, unnamed = write_model(tmp_path / "1"), write_model(tmp_path / "2", vehicle=None)
    assert accepting(heron, "heron", keep=False) == f"flighttest accept {heron} --out {tmp_path}"
    assert "did not end as planned" in accepting(heron, "heron", Status.UNUSABLE)
    assert "--vehicle vehicle.yaml" in accepting(unnamed, "")
    assert lineage.lineages(tmp_path) == []
    assert "done: body + linear_drag is now model 1 of heron." in accepting(heron, "heron")
    assert lineage.in_use(tmp_path, "heron").runs == ("a",)


def test_the_improved_model_is_judged_by_its_own_fit(tmp_path):
    """The base, which lacks what was found, had stopped before it converged, and the command that accepts the model was not printed."""
    poor, good = fitted(good=False), fitted(good=True)

    def accepting(fit, improved):
        found = campaign.Analysis((), (), fit, improved=improved)
        return campaign.how_to_accept(found, Status.DONE, tmp_path, "heron", tmp_path, keep=False)

    assert accepting(poor, good).startswith("flighttest accept")
    assert accepting(good, poor) == accepting(poor, None) == ""
    assert campaign.status_of(campaign.Analysis((), (), poor, improved=good), usable=True) is Status.DONE
    assert campaign.status_of(campaign.Analysis((), (), good, improved=poor), usable=True) is Status.UNEXPLAINED


def test_the_last_screen_shows_what_was_missing_with_its_interval_and_the_errors_without_and_with_it():
    finding = {
        "term": "ground_effect",
        "verdict": "SUPPORTED",
        "parameters": {"R2_m2": {"value": 0.0941, "std": 0.018, "unit": "m^2", "interval_95": [0.058, 0.13]}},
    }
    held = {"f_z": {"all": {"rmse_before": 0.113, "rmse_after": 0.103, "floor": 0.11, "gain_95": [0.007, 0.014]}}}
    (section,) = missing_sections({"findings": [finding], "heldout": held})
    shown = str(section)
    assert all(word in shown for word in ("ground_effect", "0.058 to 0.130", "0.113", "0.103", "0.11"))
    assert missing_sections({"findings": []}) == ()
