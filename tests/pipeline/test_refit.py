"""The model that a diagnosis leaves behind."""

from types import SimpleNamespace

import pytest

from flighttest.estimation.solver import Start
from flighttest.physics.model import Model
from flighttest.pipeline.diagnosis import diagnose as diagnosis


@pytest.mark.parametrize("known", [{}, {"d_x": 0.3}])
def test_the_model_file_of_a_diagnosis_holds_its_own_fit_but_for_what_the_base_model_knew(monkeypatch, known):
    asked = []
    held = SimpleNamespace(values={"d_x": 0.3})

    def identify(_segments, model, **options):
        asked.append((model, options))
        return held

    monkeypatch.setattr(diagnosis, "identify", identify)
    monkeypatch.setattr(diagnosis, "known_before", lambda _fitted, _base: known)
    own = SimpleNamespace(values={"K": 50.0}, start=Start({"K": 50.0}))
    found = SimpleNamespace(values={}, model=Model(("linear_drag",)), fit=own)
    fitted, kept = diagnosis.refit(found, [])
    assert kept == tuple(known)
    assert fitted is (held if known else own)
    for model, options in asked:
        assert model == found.model
        assert options["frozen"] == known
        assert options["start"] == own.start
    assert len(asked) == len(known)
