"""A model that a short flight was held against keeps what the flight could not determine."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.identify.fit import fit
from flighttest.identify.models import model_file
from flighttest.identify.models.informative_prior import carry_over, known_before


def test_what_a_yaw_flight_does_not_tell_stays_as_it_was(found, flown, tmp_path):
    base = model_file.from_fit(found)
    turns = [replace(s, run="another flight") for s in flown if s.kind == "yaw_rate_step"]
    assert known_before(fit(turns, found.model), None) == {}
    names = known_before(fit(turns, found.model), base)
    assert {"omega_phi", "zeta_theta", "d_x", "T_d_thrust"} <= set(names)
    assert "sigma_r" not in names
    short = fit(turns, found.model, frozen=names)
    path = tmp_path / "model.yaml"
    model_file.write(path, carry_over(model_file.as_data(short), base, list(names)))
    stored = model_file.read(path, whole=True)
    for name in names:
        kept, known = stored.parameters[name], base.parameters[name]
        assert kept.value == pytest.approx(known.value, rel=1e-6)
        assert kept.std == pytest.approx(known.std, rel=1e-5)
        assert kept.identifiable
    a, b = (stored.order.index(n) for n in ("d_x", "d_y"))
    c, d = (base.order.index(n) for n in ("d_x", "d_y"))
    assert stored.covariance[a, b] == pytest.approx(base.covariance[c, d], rel=1e-4)
    assert stored.parameters["sigma_r"].value == pytest.approx(short.estimates["sigma_r"].value, rel=1e-6)
    delays = [stored.parameters[n].value for n in ("T_d_attitude", "T_d_yaw_rate", "T_d_thrust")]
    assert stored.parameters["T_d"].value == pytest.approx(np.mean(delays), rel=1e-5)
    assert any("as the base model has them" in note for note in stored.notes)
    assert np.linalg.eigvalsh(stored.covariance).min() > -1e-9


def test_a_model_of_these_very_flights_adds_nothing(found, flown):
    """Held at the values of a fit to the same log, a diagnosis' model lost what it had found, and predicted worse than the base."""
    turns = fit([s for s in flown if s.kind == "yaw_rate_step"], found.model)
    base = model_file.from_fit(found)
    assert known_before(turns, base) == {}
    assert "d_x" in known_before(turns, replace(base, runs=(*base.runs, "another flight")))


def test_what_absorbs_a_term_is_not_kept_from_a_model_without_it(found, flown):
    base = replace(model_file.from_fit(found), runs=("another flight",))
    turns = fit([s for s in flown if s.kind == "yaw_rate_step"], found.model + "quadratic_drag")
    names = known_before(turns, base)
    assert "omega_phi" in names
    assert not {"d_x", "d_y"} & set(names)
