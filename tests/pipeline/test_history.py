"""Which model is in use: a spot check does not take the place of a campaign, a new campaign does."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flighttest.errors import InputError
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.physics.model import Model
from flighttest.pipeline.store import history, lineage
from flighttest.pipeline.store.history import (
    DEFAULT_RUNS,
    StoredFit,
    campaigns,
    folder_of_runs,
    reference_model,
    watched,
)

NAMES = ("omega_phi", "sigma_r", "K", "alpha")
VALUES = {"omega_phi": 25.0, "sigma_r": 21.0, "K": 54.0, "alpha": 1.7}


def model(scale=1.0, names=NAMES, runs=("a",), components="P1"):
    std = {n: 0.01 * VALUES[n] * scale for n in names}
    return ModelFile(
        Model(),
        {n: StoredParameter(VALUES[n], "", std[n]) for n in names},
        VALUES,
        tuple(names),
        np.diag([std[n] ** 2 for n in names]),
        {},
        {"components": {"propellers": {"id": components}}},
        runs,
    )


def campaign(name, **options):
    return StoredFit(Path(name), model(**options))


@pytest.mark.parametrize(
    ("second", "kept"),
    [
        ({"scale": 0.9}, "second"),
        ({"scale": 1.9}, "second"),
        ({"scale": 5.0}, "first"),
        ({"names": ("K",)}, "first"),
        ({"scale": 5.0, "components": "P2"}, "second"),
        ({"names": ("K",), "components": "P2"}, "first"),
    ],
)
def test_what_takes_the_place_of_a_model(second, kept):
    found = reference_model([campaign("first"), campaign("second", runs=("b",), **second)])
    assert found.folder.name == kept


def test_nothing_flown_nothing_stands():
    assert reference_model([]) is None


def test_what_came_out_sharply_is_compared_though_two_responses_cannot_say_how_sharply():
    made = model()
    doubted = {
        **made.parameters,
        "omega_phi": replace(made.parameters["omega_phi"], identifiable=False),
        "sigma_r": replace(made.parameters["sigma_r"], identifiable=False, std=8.0),
        "alpha": replace(made.parameters["alpha"], identifiable=False, std=0.6),
    }
    found = watched(replace(made, parameters=doubted), "run")
    assert found.names == ("omega_phi", "K", "alpha")
    assert found.known.names == ("omega_phi", "K"), "alpha only helps to determine the thrust at the voltage flown"
    assert found.dof[0] == 1.0


def test_a_loop_whose_delay_hangs_at_its_bound_is_not_compared():
    made = model()
    stuck = StoredParameter(0.0, "s", None, None, "fit", False)
    found = watched(replace(made, parameters={**made.parameters, "T_d_attitude": stuck}), "run")
    assert "omega_phi" not in found.names
    assert "K" in found.names


def test_unidentified_parameters_do_not_count():
    first = campaign("first")
    weak = {**first.model.parameters, "alpha": replace(first.model.parameters["alpha"], identifiable=False)}
    second = StoredFit(Path("second"), replace(first.model, parameters=weak, runs=("b",)))
    assert reference_model([first, second]).folder.name == "first"


def test_of_several_vehicles_in_a_folder_the_model_is_of_the_one_asked_about(tmp_path, monkeypatch):
    for name, vehicle in (("1-thrust", "heron"), ("2-thrust", "stork")):
        run = tmp_path / name
        run.mkdir()
        (run / "manifest.yaml").write_text(f"format: run/1\nvehicle: {{name: {vehicle}}}\n")
        (run / "fit.yaml").touch()
    monkeypatch.setattr(history.model_file, "read", lambda path: model(runs=(path.parent.name,)))
    assert [c.folder.name for c in campaigns(tmp_path, "stork")] == ["2-thrust"]
    assert lineage.in_use(tmp_path, "heron").runs == ("1-thrust",)
    assert lineage.in_use(tmp_path, "stork").runs == ("2-thrust",)
    with pytest.raises(InputError, match="holds 2 vehicles: heron and stork"):
        lineage.in_use(tmp_path)
    with pytest.raises(InputError, match="a run with a fit of a vehicle called crow"):
        lineage.in_use(tmp_path, "crow")


def test_a_fit_with_other_terms_is_no_later_estimate_of_the_same_parameters():
    """Of a model with quadratic drag the paper's model of a spot check has 27 % less d_x: that is no drift."""
    stored = model(runs=("1",))
    assert campaign("2", runs=("2",)).follows(stored)
    other = replace(stored, model=Model(("body", "linear_drag", "quadratic_drag")))
    assert not campaign("2", runs=("2",)).follows(other)


def test_runs_are_looked_for_beside_the_first_recording_that_is_one(tmp_path, monkeypatch):
    run = tmp_path / "elsewhere" / "a-run"
    run.mkdir(parents=True)
    (run / "manifest.yaml").touch()
    monkeypatch.chdir(run)
    assert folder_of_runs([tmp_path / "log.BIN", run]) == run.parent == folder_of_runs([Path()])
    assert folder_of_runs([Path("..", "a-run")]) == Path("..")
    assert folder_of_runs([tmp_path, "not a path"]) == DEFAULT_RUNS
