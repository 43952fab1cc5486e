"""The model that a diagnosis leaves behind."""

from types import SimpleNamespace

import pytest

from flighttest.physics.model import Model
from flighttest.pipeline import diagnosis


@pytest.mark.parametrize("known", [{}, {"d_x": 0.3}])
def test_the_model_file_of_a_diagnosis_holds_what_its_intervals_hold(monkeypatch, known):
    asked = []

    def identify(_segments, _model, **options):
        asked.append(options)
        return SimpleNamespace(values={}, noise=None)

    monkeypatch.setattr(diagnosis, "identify", identify)
    monkeypatch.setattr(diagnosis, "known_before", lambda _fitted, _base: known)
    after = {"K": {"std": 0.5, "scatter": 0.3}, "d_z": {"std": 0.1, "scatter": 0.2}}
    found = SimpleNamespace(values={}, model=Model(("linear_drag",)), after=after)
    assert diagnosis.refit(found, [])[1] == tuple(known)
    assert len(asked) == 1 + bool(known)
    for options in asked:
        assert options["doubt"] == pytest.approx({"K": 0.4, "d_z": 0.0})
