import pytest
import yaml

from flighttest.errors import ScriptError
from flighttest.script import shipped
from flighttest.script.load import load_script
from flighttest.script.shipped import maneuvers_dir, resolve, shipped_names

ASKED_FOR = {"roll_pitch", "yaw_rate", "thrust", "free_flight", "tilt_throttle", "ground_effect", "spot_check"}


@pytest.mark.parametrize("name", shipped_names())
def test_each_loads_and_is_named_as_its_file(name):
    script = load_script(resolve(name))
    assert script.name == name
    assert 20 < len(script.doc) < 140


def test_what_the_design_names_is_there():
    assert set(shipped_names()) >= ASKED_FOR


@pytest.mark.parametrize("typed", ["thrust", "thrust.yaml", "maneuvers/thrust.yaml"])
def test_found_from_any_folder(typed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert resolve(typed) == maneuvers_dir() / "thrust.yaml"


def test_a_file_of_ones_own_goes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "thrust.yaml").write_text("format: maneuver/1\nsteps: [rest]\n")
    assert resolve("thrust.yaml").resolve() == (tmp_path / "thrust.yaml").resolve()


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("thrst", "did you mean `thrust`"),
        ("zzz", "shipped maneuvers: "),
        ("a/b/thrust", "no script"),
        ("", "folder"),
        ("x" * 5000, "is not a path|no script"),
        ("\0", "is not a path|no script"),
    ],
)
def test_what_is_not_there_is_said(typed, said):
    with pytest.raises(ScriptError, match=said):
        resolve(typed)


def test_installed_folder_goes_before_the_source_tree(tmp_path, monkeypatch):
    (tmp_path / "data" / "maneuvers").mkdir(parents=True)
    monkeypatch.setattr(shipped.resources, "files", lambda package: tmp_path)
    assert maneuvers_dir() == tmp_path / "data" / "maneuvers"
    assert shipped_names() == ()


def test_the_thrust_script_is_the_papers():
    data = yaml.safe_load(resolve("thrust").read_text())
    pairs = {
        (a, b)
        for item in data["steps"]
        for a in item["throttle_pair"]["throttle_0"]
        for b in item["throttle_pair"]["throttle_1"]
    }
    assert len(pairs) == 18
    assert {a for a, _ in pairs} == {0.05, 0.10, 0.15, 0.20, 0.25, 0.30}
    assert {b for _, b in pairs} == {0.10, 0.20, 0.25, 0.30, 0.35, 0.40}
    assert data["repeat"]["each"] * len(pairs) == 72
