"""A load that swings as stretches of steered flight begin: how it is looked for. Its plant shares no line with the equations."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flighttest.diagnose.answer import SearchSupport
from flighttest.diagnose.free_flight import equation_search
from flighttest.diagnose.free_flight.equation_screen import screen
from flighttest.diagnose.free_flight.equation_search import find_terms
from flighttest.diagnose.free_flight.estimates import ModelEstimates
from flighttest.identify.free_flight import estimate, stretches
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.sim.plants.slung import SlungLoad
from tests.identify.test_free_flight import flight

LOAD = catalogue()["slung_payload"]
ALONE = Model(attitude_loops=False)


@cache
def parted(ratio, seed):
    """Stretches of 10 s; ratio: of the load's mass to the vehicle's, 0 for none."""
    load = SlungLoad(1.0, {"payload_ratio": ratio, "cable_m": 0.8, "swing_damping": 0.02}) if ratio else None
    return stretches([w for k, w in enumerate(flight(90.0, seed, load=load)) if k % 5])


def screened(ratio, seed):
    (found,) = screen(parted(ratio, seed), estimate(parted(ratio, seed), ALONE), [LOAD])
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "named"), [(0.15, ["slung_payload"]), (0.0, [])])
def test_a_load_that_no_score_test_shows_is_estimated_once_nothing_else_is_left(monkeypatch, ratio, named):
    """The noise of a model without a load holds its swing: p 0.06 for one that 220 nats showed."""

    def blind(*args):
        return tuple(replace(s, p_value=0.5, nats=0.0) for s in screen(*args))

    monkeypatch.setattr(equation_search, "screen", blind)
    found = find_terms(parted(ratio, 7), ALONE, (LOAD, catalogue()["attitude_offset"]))
    assert list(found.named) == named
    assert ("slung_payload" in found.refused) is not bool(named)
    if named:
        assert found.final.values["payload_ratio"] == pytest.approx(ratio, abs=0.02)


@pytest.mark.slow
def test_residuals_of_an_estimate_are_about_the_states_that_were_predicted():
    asked = ModelEstimates(parted(0.15, 7), "translation", {}, (), SearchSupport())
    found = asked.estimate(ALONE.with_terms(LOAD), {"cable_m": 0.8})
    for channel, rms in found.rms.items():
        left = np.concatenate([s.residual for s in asked.streams(found) if s.channel == channel])
        assert float(np.sqrt(np.mean(left**2))) == pytest.approx(rms, rel=1e-6)


@pytest.mark.slow
def test_of_the_settings_of_a_term_those_that_physics_does_not_allow_come_last():
    """A load of negative mass on 3.2 m of cable has p 0.08 here, one of positive mass on 0.8 m p 0.42."""
    assert screened(0.0, 6).coefficients["payload_ratio"] > 0.0


def test_the_score_test_of_a_load_includes_what_it_swung_by():
    """With a load at rest as each stretch begins."""
    found = screened(0.15, 3)
    assert found.shape["cable_m"] == 0.8
    assert found.coefficients["payload_ratio"] > 0.1
