"""The model that a diagnosis leaves behind."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from flighttest.diagnose.conclusion import moved_parameters
from flighttest.diagnose.mass import mass_test
from flighttest.estimation.solver import Start
from flighttest.physics.model import Model
from flighttest.pipeline.diagnosis import diagnose as diagnosis


@pytest.mark.parametrize("known", [{}, {"d_x": 0.3}])
def test_the_model_file_of_a_diagnosis_holds_its_own_fit_but_for_what_the_base_model_knew(monkeypatch, known):
    asked = []
    held = SimpleNamespace(values={"d_x": 0.3})

    def fit_of_estimates(segments, model, estimates, **options):
        asked.append((segments, model, estimates, options))
        return held

    monkeypatch.setattr(diagnosis, "fit_of_estimates", fit_of_estimates)
    monkeypatch.setattr(diagnosis, "known_before", lambda _fitted, _base: known)
    own = SimpleNamespace(values={"K": 50.0}, start=Start({"K": 50.0}), problem=SimpleNamespace(segments=("one",)))
    found = SimpleNamespace(values={}, model=Model(("linear_drag",)), fit=own, held=("loops",))
    fitted, kept = diagnosis.refit(found)
    assert kept == tuple(known)
    assert fitted is (held if known else own)
    for segments, model, estimates, options in asked:
        assert (segments, model, estimates) == (("one",), found.model, ("loops",))
        assert options["frozen"] == known
        assert options["start"] == own.start
    assert len(asked) == len(known)


def test_what_the_model_in_use_only_assumed_has_not_changed(monkeypatch):
    """After throttle steps alone, 'zeta_theta +234 %' was said of a start value that no flight had determined."""
    asked = {}
    monkeypatch.setattr(diagnosis, "search", lambda *_, **options: asked.update(options))
    monkeypatch.setattr(diagnosis, "held_against_zone", lambda found, *_: found)
    known = SimpleNamespace(value=45.0, scatter=0.2, identifiable=True)
    assumed = SimpleNamespace(value=0.39, scatter=None, identifiable=False)
    stored = SimpleNamespace(parameters={"K": known, "zeta_theta": assumed}, model=Model(), runs=())
    diagnosis.run_diagnosis([], [], stored, None)
    previous = asked["previous"]
    assert previous["K"] == (45.0, 0.2)
    now = {"K": {"value": 50.0, "scatter": 0.2}, "zeta_theta": {"value": 1.3, "scatter": 0.01}}
    said = moved_parameters(previous, now)
    assert "K +11 %" in said
    assert "zeta_theta" not in said
    assert mass_test({"K": (45.0, math.inf)}, {"K": (50.0, 0.2)}) == {}


@pytest.mark.parametrize(("runs", "said"), [(("one",), False), (("one", "two"), True), ((), True)])
def test_nothing_is_said_of_the_mass_against_a_model_of_the_same_recordings(monkeypatch, runs, said):
    """ "Thrust per mass changed by -52.8 %" was said of a recording and its own fit."""
    monkeypatch.setattr(diagnosis, "search", lambda *_, **__: _Found({"thrust_ratio": 0.5}))
    monkeypatch.setattr(diagnosis, "held_against_zone", lambda found, *_: found)
    stored = SimpleNamespace(parameters={}, model=Model(), runs=runs)
    found = diagnosis.run_diagnosis([SimpleNamespace(run="one")], [], stored, None)
    assert bool(found.mass) is said


@dataclass(frozen=True)
class _Found:
    mass: dict[str, float]
